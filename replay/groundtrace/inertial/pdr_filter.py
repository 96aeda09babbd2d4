"""The filter of dead reckoning: position, azimuth and scale, step by step, and the track they make.

A step goes ``length * exp(scale)`` along ``heading + offset + mount``, where the heading is the
gyroscope's. Besides the position, the filter estimates the offset of the gyroscope's frame from the
map's, how fast that drifts, how far the sensor looks away from the walking direction, and by how
much all lengths are off. A magnetic azimuth corrects the offset alone; a known position corrects
everything that led there, by the covariances that steps have built up.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundtrace_codecs.events import SMOOTHED, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from .. import kernels
from .rotations import wrap_angle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .steps import PositionReference

#: Of a point without an update by a known place.
NO_NIS = float("nan")


class Track:
    """One track from its beginning: steps and known places in, points out.

    Parameters
    ----------
    filter_
        At the beginning.
    time_ns
        When that is.
    stage, number
        Go into the points.
    piece_s
        Longest piece that is smoothed, or gone again, at once [s].
    direction_rad
        What all azimuths may be off by together, as a standard deviation that nothing in the
        recording tells [rad]. It is in the covariance of points as far as no known places tell it.
    smooths
        Whether smoothed points are given.
    """

    def __init__(
        self,
        filter_: ReckoningFilter,
        time_ns: int,
        stage: str,
        number: int,
        piece_s: float,
        direction_rad: float = 0.0,
        *,
        smooths: bool = True,
    ) -> None:
        self.filter = filter_
        self.stage = stage
        self.number = number
        self.piece_s, self.smooths = piece_s, smooths
        self.direction_rad = direction_rad
        self._turn_rad = self._axis_rad = 0.0
        self._settled = self._stale = False
        self._anchors = Anchors()
        self._anchors.add(filter_.state[PLACE], float(filter_.covariance[0, 0]))
        self._knots = TrackHistory()
        self._knots.begin(time_ns, filter_.state, filter_.covariance)
        self._pieces = 0
        self._begin_piece()

    def _begin_piece(self) -> None:
        """Remember, from now on, what may have to be gone again."""
        self._begun = (self.filter.copy(), self.time_ns)
        self._pieces += 1
        # strides, and after how many of them fixes came
        self._strides = Strides()
        self._fixes: list[tuple[int, PositionReference]] = []

    @property
    def begun_ns(self) -> int:
        """Since when what the compass says of steps may become another thing."""
        return self._begun[1]

    @property
    def time_ns(self) -> int:
        """Until when the track goes."""
        return int(self._knots.rows["time_ns"][self._knots.count - 1])

    def begin(self) -> list[TrackPoint]:
        """Return the point where the track begins."""
        return [self._point(self._knots.moment(-1), None, self.stage)]

    def step(
        self, stride: Stride, turn_rad: float, axis_rad: float = 0.0, *, settled: bool
    ) -> list[TrackPoint]:
        """Go a step, after what the compass says of it; return its point.

        Parameters
        ----------
        stride
            The step.
        turn_rad
            The way ahead against the sensor's axis, counter-clockwise [rad].
        axis_rad
            What that may be off by, as a standard deviation [rad]; in the covariance of points as
            ``direction_rad`` is.
        settled
            Whether that will hardly change. Until then the steps before are gone again with it.
        """
        self._axis_rad = axis_rad
        self._strides.add(stride)
        if self._stale or (not self._settled and turn_rad != self._turn_rad):
            before = self._again(turn_rad)
        else:
            self._turn_rad = turn_rad
            before = self._go(self._strides.count - 1, self._strides.count)
        self._settled = self._settled or settled
        return [self._point(self._knots.moment(-1), before, self.stage), *self._smoothed_batch()]

    def resight(self, sights: Mapping[int, MagneticBearing]) -> None:
        """Take what the compass says of steps before by now, by time; the next step goes again.

        The direction of a piece that is not the first was told by sights that were off, too.
        """
        if self._strides.resight(sights):
            self._stale = True
            if self._pieces > 1:
                self._begun[0].covariance[OFFSET, OFFSET] += REOPENED_RAD**2

    def fix(self, fix: PositionReference) -> list[TrackPoint]:
        """Take in where the walker was at a time; return the point."""
        self._aim(fix)
        before = self._knots.moment(-1)
        nis = self._meet(fix)
        self._anchors.add(self.filter.state[PLACE], fix.sigma_m**2 * fix.repeats)
        self._fixes.append((self._strides.count, fix))
        return [
            self._point(self._knots.moment(-1), before, self.stage, nis),
            *self._smoothed_batch(),
        ]

    def stray(self, unheard: Unheard) -> None:
        """Go on as far as a walker may who is not heard."""
        one, knots = self.filter, self._knots
        transition = one.stray(unheard, self.time_ns, self._turn_rad)
        knots.add(unheard.until_ns, one.state, one.covariance, transition, shown=False)
        if not self.smooths:
            knots.keep_last()

    def resume(self, unheard: Unheard, turned_rad: float) -> list[TrackPoint]:
        """Go on to where a walker is heard again, in any direction; return the point, and others.

        ``turned_rad`` is by how much the gyroscope's frame is another one if they look ahead as
        before: the best guess where there is no compass.
        """
        before = self._knots.moment(-1)
        self.stray(unheard)
        point = self._point(self._knots.moment(-1), before, self.stage)
        smoothed = self._smoothed() if self.smooths else []
        self.filter.forget_direction(turned_rad)
        self._knots.begin(self.time_ns, self.filter.state, self.filter.covariance)
        self._begin_piece()
        return [point, *smoothed]

    def flush(self) -> list[TrackPoint]:
        """Return the track smoothed, as far as not said yet."""
        points = self._smoothed() if self.smooths else []
        self._knots.keep_last()
        return points

    def _again(self, turn_rad: float) -> TrackNode:
        """Go the piece under way again, as turn and sights are known by now.

        Return where the walker was before the last step.
        """
        self._stale, self._turn_rad, (filter_, time_ns) = False, turn_rad, self._begun
        self.filter = filter_.copy()
        self._knots.begin(time_ns, filter_.state, filter_.covariance)
        gone = 0
        for count, fix in self._fixes:
            if count > gone:
                self._go(gone, count)
            self._aim(fix)
            self._meet(fix)
            gone = count
        return self._go(gone, self._strides.count)

    def _aim(self, fix: PositionReference) -> None:
        """Turn a track that is lost, and all that is remembered of it, towards a known place."""
        one, knots = self.filter, self._knots
        if one.lost:
            angle_rad = one.angle_to(fix.position, fix.sigma_m) or 0.0
            state = (one.state, one.covariance, one.origin)
            kernels.reckoning.turn_track(*state, angle_rad, knots.rows[: knots.count])

    def _go(self, start: int, stop: int) -> TrackNode:
        """Go some of the strides, at least one; return where the walker was before the last.

        A track that is lost is turned as the compass says first.
        """
        one, knots, more = self.filter, self._knots, 2 * (stop - start)
        knots.make_room(more)
        kernels.reckoning.reckon(
            one.state,
            one.covariance,
            one.origin,
            self._strides.rows[start:stop],
            self._turn_rad,
            LOST_RAD,
            one.noise_record,
            knots.rows,
            knots.count,
            NS_PER_S,
            _room(),
        )
        knots.count += more
        before = knots.moment(-3)
        if not self.smooths:
            knots.keep_last()
        return before

    def _meet(self, fix: PositionReference) -> float:
        """Take a known place in; return the NIS."""
        one, knots = self.filter, self._knots
        waited = one.wait(max(0, fix.time_ns - self.time_ns) / NS_PER_S)
        knots.add(fix.time_ns, one.state, one.covariance, waited)
        scale = one.learns_scale and (fix.repeats == 1 or self._anchors.tell(one.noise.scale))
        nis = one.fix(fix.position, fix.sigma_m, fix.repeats, learns_scale=scale)
        last = knots.rows[knots.count - 1]
        last["state"], last["covariance"] = one.state, one.covariance
        if not self.smooths:
            knots.keep_last()
        return nis

    def _smoothed_batch(self) -> list[TrackPoint]:
        """Return smoothed points once there are enough, and begin another piece."""
        if not self._settled or self.time_ns - self.begun_ns <= self.piece_s * NS_PER_S:
            return []
        points = self._smoothed()[:-1] if self.smooths else []
        self._knots.keep_last()
        self._begin_piece()
        return points

    def _smoothed(self) -> list[TrackPoint]:
        stage, nodes = self.stage + SMOOTHED, self._knots.smoothed()
        return [
            self._point(now, before, stage)
            for before, now in zip([None, *nodes[:-1]], nodes, strict=True)
        ]

    def _point(
        self, now: TrackNode, before: TrackNode | None, stage: str, nis: float = NO_NIS
    ) -> TrackPoint:
        time_ns, x, y, (xx, xy, yy) = now
        # a turn about what holds the track, as a direction that is off makes it
        off_rad = self._anchors.left_rad(math.hypot(self.direction_rad, self._axis_rad))
        centre = self._anchors.centre
        right, up = -off_rad * (y - float(centre[1])), off_rad * (x - float(centre[0]))
        spread = (xx + right * right, xy + right * up, yy + up * up)
        vx = vy = math.nan
        if before is not None and time_ns > before.time_ns:
            elapsed_s = (time_ns - before.time_ns) / NS_PER_S
            vx, vy = (x - before.x_m) / elapsed_s, (y - before.y_m) / elapsed_s
        return TrackPoint(time_ns, self.number, x, y, vx, vy, spread, stage, nis)


Array = NDArray[np.float64]

#: Fixes that err alike teach lengths where they tell them so many times better than known before.
#: Chosen by judgement; logs of IPIN 2023 stay below it, a walk of 500 m in the open is above.
TELLING = 2.0
#: A place is known no better than this, as a variance [m2]. Chosen by judgement: a foot's breadth.
LEAST_M2 = 0.01


@dataclass(slots=True)
class Anchors:
    """Known places of a track, as far as they hold it against a turn.

    Attributes
    ----------
    weight
        Sum of the inverse variances of places [1/m2].
    centre
        Their mean with these weights, shape (2,) [m].
    information
        Weighted sum of the squares of how far they are from it: what they tell of a turn [1/rad2].
    """

    weight: float = 0.0
    centre: Array = field(default_factory=lambda: np.zeros(2))
    information: float = 0.0

    def add(self, position: Array, variance_m2: float) -> None:
        """Take a place where the track was held, shape (2,) [m]."""
        weight = 1 / max(variance_m2, LEAST_M2)
        apart, total = position - self.centre, self.weight + weight
        self.information += weight * self.weight / total * float(apart @ apart)
        self.centre, self.weight = self.centre + weight / total * apart, total

    def tell(self, scale: float) -> bool:
        """Return whether they tell a scale well enough to change what was known of it.

        Places that err alike, as fixes near a wall, pull a track together.
        """
        return self.information * scale**2 > TELLING**2

    def left_rad(self, before_rad: float) -> float:
        """Return what is left of a direction's standard deviation [rad]."""
        return before_rad / math.sqrt(1 + before_rad**2 * self.information)


#: What a direction may be off by that sights told which are other ones by now [rad]. Chosen by
#: judgement: nearly a radian, beyond which a track is lost.
REOPENED_RAD = 0.9
#: Rows of the state: place [m], offset [rad], its drift [rad/s], mount [rad], scale. Source:
#: definition.
PLACE, OFFSET, DRIFT, MOUNT, SCALE = slice(0, 2), 2, 3, 4, 5
#: Source: definition.
SIZE = 6
#: An offset less sure than this is not known at all: nothing can be linearised about it [rad].
#: Chosen by judgement: sin and its tangent then differ by a fifth.
LOST_RAD = 1.0


#: How long a walker keeps a direction: after a time t the mean cosine of the turn is exp(-t / this)
#: [s]. Chosen by judgement, between steps in buildings (logs of IPIN 2023 of odd trials: 14 to 9 s
#: over 1 to 12 s) and along a street (100 s).
PERSISTENCE_S = 20.0


class Unheard(NamedTuple):
    """A time in which nothing is heard of a walker, whose direction persists but for random turns.

    Attributes
    ----------
    since_ns
        When the last step before ended.
    until_ns
        Until when nothing is heard.
    pace_mps
        Speed before, for a scale of 1 [m/s].
    heading_rad
        Direction of that step by the gyroscope [rad].
    walking
        Part of the time for which nobody knows that the walker stood; below 1 they are not taken to
        have gone on ahead.
    """

    since_ns: int
    until_ns: int
    pace_mps: float
    heading_rad: float
    walking: float = 1.0

    def way(self, from_ns: int) -> tuple[float, float]:
        """Return the way along the direction before [m], and the variance per axis about it [m2].

        That of a persistent random walk from ``from_ns`` on (R. Fürth, Zeitschrift für Physik 2,
        1920), less what goes ahead.
        """
        lasts = PERSISTENCE_S
        start_s, end_s = ((t - self.since_ns) / NS_PER_S for t in (from_ns, self.until_ns))
        elapsed_s = max(end_s - start_s, 0.0) * self.walking
        ahead_s = lasts * (math.exp(-start_s / lasts) - math.exp(-max(start_s, end_s) / lasts))
        square_s2 = 2 * lasts * (elapsed_s - lasts * (1 - math.exp(-elapsed_s / lasts)))
        ahead_s *= self.walking == 1.0
        variance_s2 = max(square_s2 - ahead_s**2, 0.0) / 2
        return self.pace_mps * ahead_s, self.pace_mps**2 * variance_s2


@dataclass(frozen=True, slots=True)
class ReckoningNoise:
    """What the filter takes steps and sensors for, as standard deviations.

    Attributes
    ----------
    drift
        Of the gyroscope at the start [rad/s].
    mount
        Of the sensor's axis from the way [rad].
    length, scale
        Of one length, and of all of them together, as parts.
    way
        Of a single step from the azimuth [rad].
    wander
        Of the gyroscope's heading from step to step [rad]; not 0 where it is not to be trusted.
    """

    drift: float
    mount: float
    length: float
    scale: float
    way: float
    wander: float = 0.0

    @property
    def record(self) -> Any:
        """What compiled functions need of it, as :data:`.kernels.reckoning.NOISE` names it."""
        noise = np.zeros((), kernels.reckoning.NOISE)
        for name in noise.dtype.names or ():
            noise[name] = getattr(self, name)
        return noise[()]


class ReckoningFilter:
    """Follows one walker.

    Parameters
    ----------
    noise
        What steps and sensors are taken for.
    position
        Where the walk begins, shape (2,) [m].
    sigma_m
        Its standard deviation, per axis [m].
    learns_scale
        Whether known places calibrate the lengths.
    """

    def __init__(
        self, noise: ReckoningNoise, position: Array, sigma_m: float, *, learns_scale: bool
    ) -> None:
        self.noise = noise
        self.noise_record = noise.record
        self.learns_scale = learns_scale
        self.state = np.zeros(SIZE)
        self.state[PLACE] = position
        sigmas = [sigma_m, sigma_m, math.pi, noise.drift, noise.mount, noise.scale]
        self.covariance = np.diag(np.square(sigmas))
        self.origin = self.state[PLACE].copy()

    def copy(self) -> ReckoningFilter:
        """Return an independent copy."""
        made = copy.copy(self)
        made.state, made.covariance = self.state.copy(), self.covariance.copy()
        made.origin = self.origin.copy()
        return made

    @property
    def lost(self) -> bool:
        """Whether nothing has told the offset yet."""
        return float(self.covariance[OFFSET, OFFSET]) > LOST_RAD**2

    def azimuth(self, heading_rad: float) -> float:
        """Return the azimuth of a step whose heading the gyroscope says [rad]."""
        return heading_rad + float(self.state[OFFSET] + self.state[MOUNT])

    @property
    def azimuth_sigma_rad(self) -> float:
        """Standard deviation of an azimuth [rad]."""
        p = self.covariance
        variance = p[OFFSET, OFFSET] + p[OFFSET, MOUNT] + p[MOUNT, OFFSET] + p[MOUNT, MOUNT]
        return min(math.sqrt(max(float(variance), 0.0)), math.pi)

    def wait(self, elapsed_s: float) -> Array:
        """Let time pass; return the transition, shape (6, 6)."""
        room = _room()
        kernels.reckoning.wait(self.state, self.covariance, elapsed_s, self.noise.wander, room)
        return np.asarray(room[0])

    def rest(self, rested_s: float) -> None:
        """Take it that the gyroscope was zeroed at rest."""
        kernels.reckoning.zero_drift(self.state, self.covariance, rested_s, self.noise.drift)

    def step(self, length_m: float, heading_rad: float) -> Array:
        """Go a step; return the transition, shape (6, 6)."""
        room, given = _room(), (length_m, heading_rad, self.noise_record)
        kernels.reckoning.advance(self.state, self.covariance, *given, room)
        return np.asarray(room[0])

    def stray(self, unheard: Unheard, from_ns: int, turn_rad: float) -> Array:
        """Go as far as a walker may who is not heard; return the transition, shape (6, 6).

        Parameters
        ----------
        unheard
            What is known of that time.
        from_ns
            Since when nothing told more of the place.
        turn_rad
            The way ahead against the sensor's axis, counter-clockwise [rad].
        """
        length_m, variance_m2 = unheard.way(from_ns)
        transition = self.step(length_m, unheard.heading_rad + turn_rad)
        self.covariance[PLACE, PLACE] += variance_m2 * np.eye(2)
        return transition

    def forget_direction(self, turned_rad: float) -> None:
        """Take it that the gyroscope's frame is turned by anything, most likely so much [rad]."""
        self.state[OFFSET] += turned_rad
        self.covariance[OFFSET, :] = self.covariance[:, OFFSET] = 0.0
        self.covariance[OFFSET, OFFSET] = math.pi**2
        self.origin = self.state[PLACE].copy()

    def sight(self, offset_rad: float, sigma_rad: float, repeats: float) -> None:
        """Take a magnetic azimuth in, as the offset it asks for.

        Parameters
        ----------
        offset_rad, sigma_rad
            The offset, and its standard deviation [rad].
        repeats
            How many sights in a row err alike.
        """
        given = (offset_rad, sigma_rad, repeats)
        kernels.reckoning.azimuth_update(self.state, self.covariance, *given, _room())

    def fix(
        self, position: Array, sigma_m: float, repeats: float = 1.0, *, learns_scale: bool
    ) -> float:
        """Take a known place in; return the NIS (2 degrees of freedom).

        Parameters
        ----------
        position, sigma_m
            Where, shape (2,), and its standard deviation per axis [m].
        repeats
            How many places in a row err alike: each counts for that much less, and is as far off.
        learns_scale
            Whether it calibrates the lengths.
        """
        off = position - self.state[PLACE]
        alone = self.covariance[PLACE, PLACE] + sigma_m**2 * np.eye(2)
        sigma_m *= math.sqrt(repeats)
        spread = self.covariance[PLACE, PLACE] + sigma_m**2 * np.eye(2)
        gain = np.linalg.solve(spread, self.covariance[PLACE, :]).T
        if not learns_scale:
            gain[SCALE] = 0.0
        keep = np.eye(SIZE)
        keep[:, PLACE] -= gain
        self.state = self.state + gain @ off
        self.covariance = keep @ self.covariance @ keep.T + sigma_m**2 * gain @ gain.T
        return float(off @ np.linalg.solve(alone, off))

    def angle_to(self, position: Array, sigma_m: float) -> float | None:
        """Return by how much the walk must turn to lead towards a place [rad].

        None where walk and place are too near the beginning to tell.
        """
        gone, seen = self.state[PLACE] - self.origin, position - self.origin
        if min(float(np.linalg.norm(gone)), float(np.linalg.norm(seen))) < sigma_m:
            return None
        return wrap_angle(math.atan2(seen[1], seen[0]) - math.atan2(gone[1], gone[0]))


def _room() -> Array:
    """Return what compiled functions write over."""
    return np.empty((SIZE, SIZE, SIZE))


#: Rows that there is room for at least, once there is for any. Chosen by judgement: it bounds how
#: often arrays grow.
_LEAST = 64


class TrackNode(NamedTuple):
    """Where a walker was: time [ns], place [m], and its covariance (xx, xy, yy) [m2]."""

    time_ns: int
    x_m: float
    y_m: float
    spread: tuple[float, float, float]


@dataclass(slots=True)
class TrackHistory:
    """Knots of a track, in an array that has room for more.

    Attributes
    ----------
    count
        How many there are.
    rows
        They and the room, as :data:`.kernels.reckoning.KNOT` names their parts, shape (m,).
    """

    count: int = 0
    rows: NDArray[Any] = field(default_factory=lambda: np.empty(0, kernels.reckoning.KNOT))

    def begin(self, time_ns: int, state: Array, covariance: Array) -> None:
        """Forget all, and begin with the knot where a track does."""
        self.count = 0
        self.add(time_ns, state, covariance, np.eye(SIZE))

    def make_room(self, more: int) -> None:
        """Have room for some more."""
        if self.count + more > len(self.rows):
            rows = np.empty(max(2 * self.count + more, _LEAST), self.rows.dtype)
            rows[: self.count] = self.rows[: self.count]
            self.rows = rows

    def keep_last(self) -> None:
        """Forget all but the last."""
        self.rows[0] = self.rows[self.count - 1]
        self.count = 1

    def add(
        self,
        time_ns: int,
        state: Array,
        covariance: Array,
        transition: Array,
        *,
        shown: bool = True,
    ) -> None:
        """Add one that is as it was predicted."""
        self.make_room(1)
        knot = (time_ns, shown, state, covariance, state, covariance, transition)
        for name, value in zip(self.rows.dtype.names or (), knot, strict=True):
            self.rows[name][self.count] = value
        self.count += 1

    def moment(self, index: int) -> TrackNode:
        """Return where the walker was at one, counted from behind where negative."""
        at = index if index >= 0 else self.count + index
        return _nodes(self.rows[at : at + 1])[0]

    def smoothed(self) -> list[TrackNode]:
        """Return the shown ones as all knots tell them; the last is the filter's."""
        knots = self.rows[: self.count].copy()
        kernels.reckoning.smooth(knots, _room())
        return _nodes(knots[knots["shown"] > 0])


def _nodes(knots: NDArray[Any]) -> list[TrackNode]:
    """Return where the walker was at knots."""
    places, spreads = knots["state"][:, :2].tolist(), knots["covariance"][:, :2, :2].tolist()
    return [
        TrackNode(time_ns, x, y, (xx, xy, yy))
        for time_ns, (x, y), ((xx, xy), (_, yy)) in zip(
            knots["time_ns"].tolist(), places, spreads, strict=True
        )
    ]


class MagneticBearing(NamedTuple):
    """A magnetic azimuth, as the offset of the gyroscope's frame that it asks for.

    Attributes
    ----------
    offset_rad, sigma_rad
        The offset and its standard deviation [rad].
    repeats
        How many sights in a row err alike.
    """

    offset_rad: float
    sigma_rad: float
    repeats: float


class Stride(NamedTuple):
    """A step as the track takes it.

    Attributes
    ----------
    time_ns
        When it ends.
    length_m
        Its length [m].
    heading_rad
        Direction by the gyroscope, but for what the way is turned from the sensor [rad].
    sight
        What the compass says of it.
    rested_s
        How long the sensor has been at rest since the step before [s].
    unseen_rad2
        Variance of how far it may have turned since then beside what its samples say [rad2].
    """

    time_ns: int
    length_m: float
    heading_rad: float
    sight: MagneticBearing | None
    rested_s: float
    unseen_rad2: float = 0.0

    @property
    def row(self) -> tuple[float, ...]:
        """All of it, as :data:`.kernels.reckoning.STRIDE` names it."""
        sight = self.sight or UNSEEN
        way = (self.length_m, self.heading_rad)
        return self.time_ns, *way, *sight, self.rested_s, self.unseen_rad2


#: Of a step of which the compass says nothing.
UNSEEN = MagneticBearing(math.nan, math.nan, math.nan)


#: Columns of a stride that a sight fills. Source: definition.
SIGHT = ("offset_rad", "sigma_rad", "repeats")


@dataclass(slots=True)
class Strides:
    """Strides in columns that have room for more.

    Attributes
    ----------
    count
        How many there are.
    rows
        They and the room, as :data:`.kernels.reckoning.STRIDE` names their parts, shape (m,).
    """

    count: int = 0
    rows: NDArray[Any] = field(default_factory=lambda: np.empty(1, kernels.reckoning.STRIDE))

    def resight(self, sights: Mapping[int, MagneticBearing]) -> bool:
        """Take other sights of them, by time; return whether there are any."""
        rows = [k for k in range(self.count) if int(self.rows["time_ns"][k]) in sights]
        for row in rows:
            sight = sights[int(self.rows["time_ns"][row])]
            for name, value in zip(SIGHT, sight, strict=True):
                self.rows[name][row] = value
        return bool(rows)

    def add(self, stride: Stride) -> None:
        """Add one."""
        if self.count == len(self.rows):
            self.rows = np.concatenate([self.rows, np.empty_like(self.rows)])
        self.rows[self.count] = stride.row
        self.count += 1
