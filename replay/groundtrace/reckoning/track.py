"""A walk under way: the filter of one track, its points, and what smoothing needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.estimates import SMOOTHED
from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..later import Later
from .filter import LOST_RAD
from .knots import Knots
from .strides import Strides

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from . import track_kernels
    from .filter import ReckoningFilter
    from .knots import Moment
    from .strides import Stride

    Array = NDArray[np.float64]
else:
    track_kernels = Later("groundtrace.reckoning.track_kernels")

#: Of a point without an update by a known place.
NO_NIS = float("nan")


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
        self._settled = False
        # what may have to be gone again: strides, and after how many of them fixes came
        self._strides = Strides()
        self._fixes: list[tuple[int, Fix]] = []
        self._knots = Knots()
        self._knots.begin(time_ns, filter_.state, filter_.covariance)

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
        if self._settled:
            self._strides.count = 0
        self._strides.add(stride)
        if not self._settled and turn_rad != self._turn_rad:
            before = self._again(turn_rad)
        else:
            self._turn_rad = turn_rad
            before = self._go(self._strides.count - 1, self._strides.count)
        if settled:
            self._settled, self._fixes = True, []
        return [self._point(self._knots.moment(-1), before, self.stage), *self._due()]

    def fix(self, time_ns: int, place: Array, sigma_m: float) -> list[TrackPoint]:
        """Take in where the walker was at a time, shape (2,) [m]; return the point."""
        fix = Fix(time_ns, place, sigma_m)
        self._aim(fix)
        before = self._knots.moment(-1)
        nis = self._meet(fix)
        if not self._settled:
            self._fixes.append((self._strides.count, fix))
        return [self._point(self._knots.moment(-1), before, self.stage, nis), *self._due()]

    def finish(self) -> list[TrackPoint]:
        """Return the track smoothed, as far as not said yet."""
        points = self._smoothed() if self.smooth_s else []
        self._knots.keep_last()
        return points

    def _again(self, turn_rad: float) -> Moment:
        """Go the track again from its beginning, as the sensor is known to be turned by now.

        Return where the walker was before the last step.
        """
        self._turn_rad, (filter_, time_ns) = turn_rad, self._begun
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

    def _aim(self, fix: Fix) -> None:
        """Turn a track that is lost, and all that is remembered of it, towards a known place."""
        one, knots = self.filter, self._knots
        if one.lost:
            angle_rad = one.angle_to(fix.place, fix.sigma_m) or 0.0
            state = (one.state, one.covariance, one.origin)
            track_kernels.turn(*state, angle_rad, knots.columns, knots.count)

    def _go(self, start: int, stop: int) -> Moment:
        """Go some of the strides, at least one; return where the walker was before the last.

        A track that is lost is turned as the compass says first.
        """
        one, knots, noise, rows = self.filter, self._knots, self.filter.noise, slice(start, stop)
        more = 2 * (stop - start)
        knots.make_room(more)
        track_kernels.strides(
            *(one.state, one.covariance, one.origin),
            *(self._strides.time_ns[rows], self._strides.rows[rows]),
            *(self._turn_rad, LOST_RAD),
            (noise.drift, noise.wander, noise.length, noise.way),
            knots.columns,
            knots.count,
            NS_PER_S,
        )
        knots.count += more
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
        if not self._settled:
            return []
        if self.time_ns - int(self._knots.time_ns[0]) <= self.smooth_s * NS_PER_S:
            return []
        points = self._smoothed()[:-1]
        self._knots.keep_last()
        return points

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
