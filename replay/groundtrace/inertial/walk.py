"""A walk under way: the filter of one track, and what its points and its smoothing need."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..trackers.api import SMOOTHED
from .compass import Compass, sigma_of
from .error_state import ErrorStateFilter, SensorNoise
from .smoothing import Knot, smoothed
from .strapdown import PLACE, STATES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .error_state import Innovation
    from .parameters import FootNavigatorParameters
    from .stances import Segment
    from .strapdown import Pose

    Array = NDArray[np.float64]

#: Errors of a standing foot's velocity and rate go on for about so long [s].
CORRELATION_S = 0.1
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
        self._knots: list[Knot[Pose]] = []
        self._compass = Compass()

    @property
    def place(self) -> Array:
        """Where the foot is, shape (3,) [m]."""
        return self.filter.pose.place

    def predict(self, segment: Segment) -> None:
        """Go on by a segment."""
        self._transition = self.filter.predict(segment) @ self._transition

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
            self._remember(segment.time_ns, shown, predicted, spread)
        return self._shown(nis) if shown else []

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
        if self._knots and not self._knots[-1].shown:
            self._knots[-1] = last = replace(self._knots[-1], shown=True)
            points.append(self._point(last.time_ns, last.pose, last.spread, self.stage, NO_NIS))
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

    def _remember(self, time_ns: int, shown: bool, predicted: Pose, spread: Array) -> None:
        now, sure = self.filter.pose, self.filter.covariance
        if self.parameters.smooth or shown:
            knot = Knot(time_ns, shown, predicted, spread, now, sure, self._transition)
            self._knots.append(knot)
        self._transition = np.eye(STATES)

    def _shown(self, nis: float) -> list[TrackPoint]:
        """Return the point of the last knot, and those that are smoothed if it is time to."""
        last = self._knots[-1]
        self._pointed_ns = last.time_ns
        points = [self._point(last.time_ns, last.pose, last.spread, self.stage, nis)]
        if not self.parameters.smooth:
            self._knots.clear()
        elif last.time_ns - self._knots[0].time_ns > self.parameters.smooth_s * NS_PER_S:
            points += self._smoothed()[:-1]
            self._knots = [last]
        return points

    def _smoothed(self) -> list[TrackPoint]:
        found = zip(self._knots, smoothed(self._knots), strict=True)
        return [
            self._point(knot.time_ns, pose, spread, self.stage + SMOOTHED, NO_NIS)
            for knot, (pose, spread) in found
            if knot.shown
        ]

    def _point(self, time_ns: int, pose: Pose, spread: Array, stage: str, nis: float) -> TrackPoint:
        x, y, _ = pose.place.tolist()
        vx, vy, _ = pose.velocity.tolist()
        (xx, xy, _), (_, yy, _), _ = spread[PLACE, PLACE].tolist()
        return TrackPoint(time_ns, self.number, x, y, vx, vy, (xx, xy, yy), stage, nis)


def _lasting(sigma: float, segment: Segment) -> float:
    """Return the deviation that has the same weight over time if segments were independent."""
    return float(sigma) * math.sqrt(max(1.0, CORRELATION_S / segment.length_s))


def _horizontal(seen: Innovation) -> float:
    """Return the normalised square of an innovation's horizontal part."""
    value, spread = seen.value[:2], seen.spread[:2, :2]
    return float(value @ np.linalg.solve(spread, value))
