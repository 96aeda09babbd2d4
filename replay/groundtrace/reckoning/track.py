"""A walk under way: the filter of one track, its points, and what smoothing needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..trackers.api import SMOOTHED
from .filter import LOST_RAD, OFFSET, SIZE
from .knots import Knots

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .filter import ReckoningFilter
    from .knots import Moment

    Array = NDArray[np.float64]

#: Of a point without an update by a known place.
NO_NIS = float("nan")


class Sight(NamedTuple):
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
    """

    time_ns: int
    length_m: float
    heading_rad: float
    sight: Sight | None
    rested_s: float

    @property
    def row(self) -> tuple[float, ...]:
        """All but the time, as compiled functions lay it out."""
        return self.length_m, self.heading_rad, *(self.sight or UNSEEN), self.rested_s


#: Of a step of which the compass says nothing.
UNSEEN = Sight(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A known place, shape (2,) [m], when, and its standard deviation per axis [m]."""

    time_ns: int
    place: Array
    sigma_m: float


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
    smooth_s
        Longest piece that is smoothed at once [s]; 0 smooths nothing.
    """

    def __init__(
        self, filter_: ReckoningFilter, time_ns: int, stage: str, number: int, smooth_s: float
    ) -> None:
        self.filter = filter_
        self.stage = stage
        self.number = number
        self.smooth_s = smooth_s
        self._begun = (filter_.copy(), time_ns)
        self._turn_rad = 0.0
        self._taken: list[Stride | Fix] | None = []  # None once settled
        self._begin_knots(time_ns, 0)

    @property
    def time_ns(self) -> int:
        """Until when the track goes."""
        return int(self._knots.time_ns[self._knots.count - 1])

    def begin(self) -> list[TrackPoint]:
        """Return the point where the track begins."""
        return [self._point(self._knots.moment(-1), None, self.stage)]

    def step(self, stride: Stride, turn_rad: float, *, settled: bool) -> list[TrackPoint]:
        """Go a step, after what the compass says of it; return its point.

        Parameters
        ----------
        stride
            The step.
        turn_rad
            The way ahead against the sensor's axis, counter-clockwise [rad].
        settled
            Whether that will hardly change. Until then the steps before are gone again with it.
        """
        if self._taken is not None and turn_rad != self._turn_rad:
            before = self._again([*self._taken, stride], turn_rad)
        else:
            self._turn_rad = turn_rad
            before = self._go([stride])
        self._take(stride, settled=settled)
        return [self._point(self._knots.moment(-1), before, self.stage), *self._due()]

    def fix(self, time_ns: int, place: Array, sigma_m: float) -> list[TrackPoint]:
        """Take in where the walker was at a time, shape (2,) [m]; return the point."""
        fix = Fix(time_ns, place, sigma_m)
        self._aim(fix)
        before = self._knots.moment(-1)
        nis = self._meet(fix)
        self._take(fix, settled=False)
        return [self._point(self._knots.moment(-1), before, self.stage, nis), *self._due()]

    def finish(self) -> list[TrackPoint]:
        """Return the track smoothed, as far as not said yet."""
        points = self._smoothed() if self.smooth_s else []
        self._knots.keep_last()
        return points

    def _begin_knots(self, time_ns: int, more: int) -> None:
        """Begin with the knot where the track does, and room for some more."""
        self._knots = Knots()
        self._knots.make_room(1 + more)
        self._knots.add(time_ns, self.filter.state, self.filter.covariance, np.eye(SIZE))

    def _take(self, item: Stride | Fix, *, settled: bool) -> None:
        """Remember what may have to be gone again."""
        if settled:
            self._taken = None
        elif self._taken is not None:
            self._taken.append(item)

    def _again(self, taken: Sequence[Stride | Fix], turn_rad: float) -> Moment:
        """Go the track again from its beginning, as the sensor is known to be turned by now.

        Return where the walker was before the last step.
        """
        self._turn_rad, (filter_, time_ns) = turn_rad, self._begun
        self.filter = filter_.copy()
        self._begin_knots(time_ns, 2 * len(taken))
        before = self._knots.moment(-1)
        for kind, items in groupby(taken, type):
            if kind is Stride:
                before = self._go([item for item in items if isinstance(item, Stride)])
                continue
            for item in items:
                if isinstance(item, Fix):
                    self._aim(item)
                    self._meet(item)
        return before

    def _aim(self, fix: Fix) -> None:
        """Turn a track that is lost towards a known place."""
        if self.filter.lost:
            self._turn(self.filter.angle_to(fix.place, fix.sigma_m) or 0.0)

    def _go(self, taken: Sequence[Stride]) -> Moment:
        """Go some steps; return where the walker was before the last of them.

        A track that is lost is turned as the compass says first.
        """
        # compiled functions are not imported where pipelines are only listed
        from .track_kernels import REPEATS, SEEN, strides

        one, knots, noise = self.filter, self._knots, self.filter.noise
        knots.make_room(2 * len(taken))
        times = np.array([stride.time_ns for stride in taken], np.int64)
        rows, at = np.array([stride.row for stride in taken]), 0
        errors = (noise.drift, noise.wander, noise.length, noise.way)
        while at < len(rows):
            if one.lost and not math.isnan(rows[at, SEEN]):
                self._turn(float(rows[at, SEEN]) - float(one.state[OFFSET]))
                rows[at, REPEATS] = 1.0
            given = (times[at:], rows[at:], self._turn_rad, LOST_RAD, errors)
            gone = strides(one.state, one.covariance, *given, knots.columns, knots.count)
            at, knots.count = at + gone, knots.count + 2 * gone
        before = knots.moment(-3)
        if not self.smooth_s:
            knots.keep_last()
        return before

    def _meet(self, fix: Fix) -> float:
        """Take a known place in; return the NIS."""
        one, knots = self.filter, self._knots
        waited = one.wait(max(0, fix.time_ns - self.time_ns) / NS_PER_S)
        knots.add(fix.time_ns, one.state, one.covariance, waited)
        nis = one.fix(fix.place, fix.sigma_m)
        knots.pose[knots.count - 1], knots.spread[knots.count - 1] = one.state, one.covariance
        if not self.smooth_s:
            knots.keep_last()
        return nis

    def _due(self) -> list[TrackPoint]:
        """Return smoothed points once there are enough."""
        if self._taken is not None:
            return []
        if self.time_ns - int(self._knots.time_ns[0]) <= self.smooth_s * NS_PER_S:
            return []
        points = self._smoothed()[:-1]
        self._knots.keep_last()
        return points

    def _turn(self, angle_rad: float) -> None:
        """Turn all that is remembered about the beginning."""
        self.filter.turn(angle_rad)
        self._knots.turn(self.filter.origin, angle_rad)

    def _smoothed(self) -> list[TrackPoint]:
        stage, found = self.stage + SMOOTHED, self._knots.smoothed()
        return [
            self._point(now, before, stage)
            for before, now in zip([None, *found[:-1]], found, strict=True)
        ]

    def _point(
        self, now: Moment, before: Moment | None, stage: str, nis: float = NO_NIS
    ) -> TrackPoint:
        time_ns, x, y, spread = now
        vx = vy = math.nan
        if before is not None and time_ns > before.time_ns:
            elapsed_s = (time_ns - before.time_ns) / NS_PER_S
            vx, vy = (x - before.x_m) / elapsed_s, (y - before.y_m) / elapsed_s
        return TrackPoint(time_ns, self.number, x, y, vx, vy, spread, stage, nis)
