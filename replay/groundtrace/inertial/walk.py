"""A walk under way: the filter of one track, and what its points and its smoothing need."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.estimates import SMOOTHED
from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..later import Later
from .compass import Compass, sigma_of
from .error_state import LOST_MPS, ErrorStateFilter, SensorNoise
from .knots import Knots
from .strapdown import GRAVITY_MPS2, PLACE, STATES, Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import smoothing_kernels
    from . import walk_kernels as compiled
    from .error_state import Innovation
    from .parameters import FootNavigatorParameters
    from .stances import Segment, SegmentRun

    Array = NDArray[np.float64]
else:
    compiled = Later("groundtrace.inertial.walk_kernels")
    smoothing_kernels = Later("groundtrace.inertial.smoothing_kernels")

#: Errors of a standing foot's velocity and rate go on for about so long [s].
CORRELATION_S = 0.1
#: Where place and velocity of a pose in the plane are, and the place's covariance.
COLUMNS = [7, 8, 4, 5]
PLANE = ([PLACE.start, PLACE.start, PLACE.start + 1], [PLACE.start, *[PLACE.start + 1] * 2])
#: Of a point without an update that stands for itself.
NO_NIS = float("nan")


class Walk:
    """A track from where the foot first stood.

    Parameters
    ----------
    parameters
        Of the navigator.
    orientation
        At the start, shape (4,).
    stage, number
        Go into the points.
    """

    def __init__(
        self, parameters: FootNavigatorParameters, orientation: Array, stage: str, number: int
    ) -> None:
        self.parameters = parameters
        self.filter = ErrorStateFilter(SensorNoise(), orientation)
        self.stage = stage
        self.number = number
        #: How long the foot has stood, and how long before that it was under way [s].
        self.stood_s = 0.0
        self.swung_s = 0.0
        self.rested_s = 0.0
        self._pointed_ns = 0
        self._transition = np.eye(STATES)
        self._knots: list[Knots] = []
        self._compass = Compass()
        self._told: list[TrackPoint] = []

    @property
    def place(self) -> Array:
        """Where the foot is, shape (3,) [m]."""
        return self.filter.pose.place

    def predict(self, segment: Segment) -> None:
        """Go on by a segment."""
        self._transition = self.filter.predict(segment) @ self._transition

    def go_on(self, segments: SegmentRun, start: int, *, stands: bool) -> tuple[int, bool]:
        """Go on from a segment until one of which it is to be decided whether a stance begins.

        Parameters
        ----------
        segments
            Not predicted yet.
        start
            The first of them that counts.
        stands
            Whether the foot stood in the segment before.

        Returns
        -------
        The segment where that is, or the number of segments; and whether the foot stood before it.
        Points wait for :meth:`told`.
        """
        pose, covariance = self.filter.pose.row, self.filter.covariance.copy()
        since, at, full = self._transition.copy(), start, True
        clocks = np.array([self.stood_s, self.swung_s, self.rested_s, float(stands)])
        s, settings = segments, self._settings()
        while full:
            at, self._pointed_ns, *knots = compiled.walk(
                *(at, s.time_ns, s.interval_s, s.rate, s.force, s.statistic, s.peak, s.length_s),
                *(pose, covariance, since, clocks, self._pointed_ns, settings),
            )
            full = len(knots[0]) == compiled.ROOM
            self._add(Knots(*(np.array(column) for column in knots)), NO_NIS)
        if at > start:
            self.filter.pose, self.filter.covariance = Pose.of(pose), covariance
            self._transition = since
            self.stood_s, self.swung_s, self.rested_s, still = clocks.tolist()
            stands = still > 0
        return at, stands

    def told(self) -> list[TrackPoint]:
        """Return the points that are known by now."""
        told, self._told = self._told, []
        return told

    def _settings(self) -> Array:
        """Return the settings as compiled functions lay them out."""
        n, p = self.filter.noise, self.parameters
        noise = (n.gyro_walk, n.force_walk, n.gyro_scale, n.force_scale)
        walks = (n.gyro_bias_walk, n.force_bias_walk)
        still = (p.sure, p.share, p.sole_m, p.still_mps, p.still_radps, p.rest_s, p.lost_s)
        last = (p.point_s * NS_PER_S, CORRELATION_S, LOST_MPS, GRAVITY_MPS2, float(p.smooth))
        return np.array([*noise, *walks, *still, *last])

    def stillness(self, segment: Segment) -> Innovation:
        """Return what it says of the velocity if the foot stands in a segment just predicted."""
        p = self.parameters
        rate = segment.rate[1:] - self.filter.pose.gyro_bias
        rolling = p.sole_m * float(np.sqrt(np.einsum("ij,ij->i", rate, rate).mean()))
        return self.filter.still(_lasting(np.hypot(p.still_mps, rolling), segment))

    def follow(self, segment: Segment, stands: bool, accepted: bool | None) -> list[TrackPoint]:
        """Take it that the foot stands in the segment just predicted, or does not.

        Parameters
        ----------
        segment
            As predicted.
        stands
            Whether it does.
        accepted
            The verdict on a stance that begins here; None where none does.

        Returns
        -------
        The points that are known now.
        """
        self._lose(accepted)
        predicted, spread, nis = self.filter.pose, self.filter.covariance, NO_NIS
        if stands:
            seen = self.stillness(segment)
            nis = _horizontal(seen) if accepted else nis
            self._stand(segment, seen)
        due = segment.time_ns - self._pointed_ns >= self.parameters.point_s * NS_PER_S
        shown = accepted is True or due
        if shown or stands:
            self._remember(segment.time_ns, shown, predicted, spread, nis)
        return self.told()

    def _lose(self, accepted: bool | None) -> None:
        """Give the velocity up where it must be wrong: no swing is so long, and rest is rest."""
        p = self.parameters
        resting = accepted is False and self.rested_s >= p.rest_s
        if resting or (not accepted and self.swung_s >= p.lost_s):
            self.filter.lose_velocity()
            self.swung_s = 0.0

    def finish(self) -> list[TrackPoint]:
        """Return where the track ends, and the track smoothed, as far as not said yet."""
        points: list[TrackPoint] = []
        if self._knots and not self._knots[-1].shown[-1]:
            last = self._knots[-1]
            self._knots[-1:] = [last.rows(0, len(last) - 1), _shown(last.rows(len(last) - 1, None))]
            points += self._points(self._knots[-1], self.stage, NO_NIS)
        points += self._smoothed()
        self._knots = []
        return points

    def _stand(self, segment: Segment, seen: Innovation) -> None:
        p = self.parameters
        self.filter.update(seen)
        self.stood_s += segment.length_s
        self.swung_s = 0.0
        if self.stood_s >= p.rest_s:
            rate = segment.rate[1:].mean(axis=0)
            turning = float(np.linalg.norm(rate - self.filter.pose.gyro_bias))
            sigma = _lasting(np.hypot(p.still_radps, turning), segment)
            self.filter.update(self.filter.not_turning(rate, sigma))
        if p.magnetometer:
            angle = self._compass.turned_by(self.filter.pose.orientation, segment.field)
            if angle is not None:
                self.filter.update(self.filter.turned(angle, sigma_of(segment.length_s)))

    def _remember(
        self, time_ns: int, shown: bool, predicted: Pose, spread: Array, nis: float
    ) -> None:
        now, sure = self.filter.pose, self.filter.covariance
        if self.parameters.smooth or shown:
            columns = (predicted.row, spread, now.row, sure, self._transition)
            knot = Knots(
                np.array([time_ns], np.int64),
                np.array([shown]),
                *(np.array(column)[None] for column in columns),
            )
            self._pointed_ns = time_ns if shown else self._pointed_ns
            self._add(knot, nis)
        self._transition = np.eye(STATES)

    def _add(self, knots: Knots, nis: float) -> None:
        """Keep knots; say the points of those that are shown, and what is smoothed by then."""
        self._told += self._points(knots, self.stage, nis)
        if not (self.parameters.smooth and len(knots)):
            return
        begin, times, longest_ns = 0, knots.time_ns.tolist(), self.parameters.smooth_s * NS_PER_S
        for place in np.flatnonzero(knots.shown).tolist():
            first = int(self._knots[0].time_ns[0]) if self._knots else times[begin]
            if times[place] - first > longest_ns:
                self._knots.append(knots.rows(begin, place + 1))
                self._told += self._smoothed()[:-1]
                self._knots, begin = [knots.rows(place, place + 1)], place + 1
        if begin < len(knots):
            self._knots.append(knots.rows(begin, len(knots)))

    def _smoothed(self) -> list[TrackPoint]:
        """Return the points of all knots that are kept as all of them tell."""
        told: list[list[TrackPoint]] = []
        if not self._knots:
            return []
        last = self._knots[-1].rows(len(self._knots[-1]) - 1, None)
        pose, spread = last.pose[0].copy(), last.spread[0].copy()
        told.append(self._points(last, self.stage + SMOOTHED, NO_NIS))
        before = [*self._knots[:-1], self._knots[-1].rows(0, len(self._knots[-1]) - 1)]
        later = last
        for part in before[::-1]:
            if not len(part):
                continue
            found, planar = smoothing_kernels.smooth(
                *(part.pose, part.spread, part.predicted, part.predicted_spread, part.transition),
                *(later.predicted[0], later.predicted_spread[0], later.transition[0]),
                *(pose, spread),
            )
            told.append(self._points(part, self.stage + SMOOTHED, NO_NIS, found, planar))
            later = part
        return [point for points in told[::-1] for point in points]

    def _points(
        self,
        knots: Knots,
        stage: str,
        nis: float,
        pose: Array | None = None,
        planar: Array | None = None,
    ) -> list[TrackPoint]:
        """Return points where knots are shown, by their own poses or by others."""
        rows, number = np.flatnonzero(knots.shown), self.number
        if not len(rows):
            return []
        pose = knots.pose if pose is None else pose
        own = knots.spread[rows[:, None], PLANE[0], PLANE[1]] if planar is None else planar[rows]
        columns = (knots.time_ns[rows], pose[rows[:, None], COLUMNS], own)
        return [
            TrackPoint(time_ns, number, x, y, vx, vy, (xx, xy, yy), stage, nis)
            for time_ns, (x, y, vx, vy), (xx, xy, yy) in zip(
                *(column.tolist() for column in columns), strict=True
            )
        ]


def _shown(knots: Knots) -> Knots:
    return replace(knots, shown=np.ones(len(knots), np.bool_))


def _lasting(sigma: float, segment: Segment) -> float:
    """Return the deviation that has the same weight over time if segments were independent."""
    return float(sigma) * math.sqrt(max(1.0, CORRELATION_S / segment.length_s))


def _horizontal(seen: Innovation) -> float:
    """Return the normalised square of an innovation's horizontal part."""
    value, spread = seen.value[:2], seen.spread[:2, :2]
    return float(value @ np.linalg.solve(spread, value))
