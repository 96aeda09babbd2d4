"""A walk under way: the filter of one track, its points, and what smoothing needs."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..inertial.smoothing import Knot, smoothed
from ..trackers.api import SMOOTHED
from .filter import OFFSET, PLACE, SIZE, State, turned_about

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .filter import ReckoningFilter

    Array = NDArray[np.float64]
    Known = Knot[State]

#: Of a point without an update by a known place.
NO_NIS = float("nan")


@dataclass(frozen=True, slots=True)
class Sight:
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


@dataclass(frozen=True, slots=True)
class Stride:
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
        self._knots = [self._knot(time_ns, np.eye(SIZE))]
        self._begun = (copy.deepcopy(filter_), self._knots[0])
        self._turn_rad = 0.0
        self._taken: list[Stride | Fix] | None = []  # None once settled

    @property
    def time_ns(self) -> int:
        """Until when the track goes."""
        return self._knots[-1].time_ns

    def begin(self) -> list[TrackPoint]:
        """Return the point where the track begins."""
        return [self._point(self._knots[-1], None, self.stage)]

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
            self._again(self._taken, turn_rad)
        self._turn_rad = turn_rad
        aimed = self._aimed(stride)
        before = self._knots[-1]
        self._go(aimed)
        self._take(stride, settled=settled)
        return [self._point(self._knots[-1], before, self.stage), *self._due()]

    def fix(self, time_ns: int, place: Array, sigma_m: float) -> list[TrackPoint]:
        """Take in where the walker was at a time, shape (2,) [m]; return the point."""
        fix = Fix(time_ns, place, sigma_m)
        self._aim(fix)
        before = self._knots[-1]
        nis = self._meet(fix)
        self._take(fix, settled=False)
        return [self._point(self._knots[-1], before, self.stage, nis), *self._due()]

    def finish(self) -> list[TrackPoint]:
        """Return the track smoothed, as far as not said yet."""
        points = self._smoothed() if self.smooth_s else []
        self._knots = self._knots[-1:]
        return points

    def _take(self, item: Stride | Fix, *, settled: bool) -> None:
        """Remember what may have to be gone again."""
        if settled:
            self._taken = None
        elif self._taken is not None:
            self._taken.append(item)

    def _again(self, taken: Sequence[Stride | Fix], turn_rad: float) -> None:
        """Go the track again from its beginning, as the sensor is known to be turned by now."""
        self._turn_rad, (filter_, knot) = turn_rad, self._begun
        self.filter, self._knots = copy.deepcopy(filter_), [knot]
        for item in taken:
            if isinstance(item, Stride):
                self._go(self._aimed(item))
            else:
                self._aim(item)
                self._meet(item)

    def _aimed(self, stride: Stride) -> Stride:
        """Turn a track that is lost as the compass says; return the step with what is new in it."""
        sight = stride.sight
        if sight is None or not self.filter.lost:
            return stride
        self._turn(sight.offset_rad - float(self.filter.state[OFFSET]))
        return replace(stride, sight=replace(sight, repeats=1.0))

    def _aim(self, fix: Fix) -> None:
        """Turn a track that is lost towards a known place."""
        if self.filter.lost:
            self._turn(self.filter.angle_to(fix.place, fix.sigma_m) or 0.0)

    def _go(self, stride: Stride) -> None:
        sight, forget = stride.sight, None
        if stride.rested_s > 0:
            forget = self.filter.rest(stride.rested_s)
        waited = self._wait(stride.time_ns)
        waited = waited if forget is None else waited @ forget
        predicted = self._knot(stride.time_ns, waited, shown=False)
        if sight is not None:
            self.filter.sight(sight.offset_rad, sight.sigma_rad, sight.repeats)
        self._remember(predicted)
        heading = stride.heading_rad + self._turn_rad
        moved = self.filter.step(stride.length_m, heading)
        self._remember(self._knot(stride.time_ns, moved))

    def _meet(self, fix: Fix) -> float:
        """Take a known place in; return the NIS."""
        predicted = self._knot(fix.time_ns, self._wait(fix.time_ns))
        nis = self.filter.fix(fix.place, fix.sigma_m)
        self._remember(predicted)
        return nis

    def _wait(self, time_ns: int) -> Array:
        return self.filter.wait(max(0, time_ns - self.time_ns) / NS_PER_S)

    def _knot(self, time_ns: int, transition: Array, *, shown: bool = True) -> Known:
        """Return what the filter says now."""
        state, spread = State(self.filter.state), self.filter.covariance
        return Knot(time_ns, shown, state, spread, state, spread, transition)

    def _remember(self, predicted: Known) -> None:
        """Keep a knot with what the filter has been told since."""
        k, state, spread = predicted, State(self.filter.state), self.filter.covariance
        if not self.smooth_s:
            self._knots.clear()
        self._knots.append(
            Knot(k.time_ns, k.shown, k.predicted, k.predicted_spread, state, spread, k.transition)
        )

    def _due(self) -> list[TrackPoint]:
        """Return smoothed points once there are enough."""
        if self._taken is not None:
            return []
        if self.time_ns - self._knots[0].time_ns <= self.smooth_s * NS_PER_S:
            return []
        points, self._knots = self._smoothed()[:-1], self._knots[-1:]
        return points

    def _turn(self, angle_rad: float) -> None:
        """Turn all that is remembered about the beginning."""
        turn = self.filter.turn(angle_rad)
        self._knots = [_turned(knot, self.filter.origin, angle_rad, turn) for knot in self._knots]

    def _smoothed(self) -> list[TrackPoint]:
        stage, before = self.stage + SMOOTHED, None
        points = []
        for knot, (pose, spread) in zip(self._knots, smoothed(self._knots), strict=True):
            if knot.shown:
                found = replace(knot, pose=pose, spread=spread)
                points.append(self._point(found, before, stage))
                before = found
        return points

    def _point(
        self, knot: Known, before: Known | None, stage: str, nis: float = NO_NIS
    ) -> TrackPoint:
        x, y = knot.pose.values[PLACE].tolist()
        (xx, xy), (_, yy) = knot.spread[PLACE, PLACE].tolist()
        vx = vy = math.nan
        if before is not None and knot.time_ns > before.time_ns:
            elapsed_s = (knot.time_ns - before.time_ns) / NS_PER_S
            vx, vy = ((knot.pose.values - before.pose.values)[PLACE] / elapsed_s).tolist()
        return TrackPoint(knot.time_ns, self.number, x, y, vx, vy, (xx, xy, yy), stage, nis)


def _turned(knot: Known, origin: Array, angle_rad: float, turn: Array) -> Known:
    return replace(
        knot,
        predicted=State(turned_about(knot.predicted.values, origin, angle_rad)),
        predicted_spread=turn @ knot.predicted_spread @ turn.T,
        pose=State(turned_about(knot.pose.values, origin, angle_rad)),
        spread=turn @ knot.spread @ turn.T,
        transition=turn @ knot.transition @ turn.T,
    )
