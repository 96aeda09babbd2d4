"""Several walkers, each with a step-clocked Kalman filter, told apart by where they go.

Source: the thesis on footstep localisation, chapter 6, for each walker; it has one only. Fixes
and predicted steps are assigned one to one inside a gate, as many as can be, the nearest first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Level
from ..parameters import gate, measured
from ..score.assignment import assign
from .api import TrackerParameters
from .kalman import StepFilter, WalkModel, first_spread
from .track import Track, filtered_points, smoothed_points

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, TrackPoint

    from ..detector import Emits

    Array = NDArray[np.float64]

#: A track counts from its second fix on, which must be among three that could be its own.
START_FIXES, START_CHANCES = 2, 3


@dataclass(frozen=True, slots=True)
class WalkersParameters(TrackerParameters):
    """Parameters of :class:`Walkers`."""

    sigma_q: Annotated[
        float, measured("m", "How far a step strays from going straight on.", gt=0)
    ] = 0.1
    sigma_r: Annotated[float, measured("m", "Error of a fix, per axis.", gt=0)] = 0.5
    own_covariance: Annotated[
        bool, measured("", "Take the covariance of a fix that has one, not sigma_r.")
    ] = False
    max_distance: Annotated[
        float, gate("1", "Largest Mahalanobis distance from the predicted step.", gt=0)
    ] = 3.7
    least_pace_s: Annotated[
        float, measured("s", "Least time between two steps of a walker.", ge=0)
    ] = 0.25
    end_s: Annotated[float, measured("s", "A track without a fix for so long ends.", gt=0)] = 2.0
    smooth: Annotated[bool, measured("", "Also give each track smoothed, when it ends.")] = True


class Walkers:
    """Kalman filters with a clock of steps, one a walker; each track is smoothed when it ends."""

    Parameters = WalkersParameters
    emits: Emits = "track"
    columns = (Quantity("distance", "1"), Quantity("x", "m"), Quantity("y", "m"))
    gates = (Level("distance", "1", "max_distance", at_least=False),)

    def __init__(self, parameters: WalkersParameters) -> None:
        self.parameters = parameters
        self.model = WalkModel(parameters.sigma_q, parameters.sigma_r)
        self.stage = ""
        self._tracks: list[Track] = []
        self._owner: dict[int, Track] = {}
        self._count = 0

    def start(self, stage: str) -> None:
        """Begin without tracks."""
        self.stage = stage

    def expire(self, time_ns: int) -> list[TrackPoint]:
        """End the tracks that had no fix for too long."""
        limit = time_ns - self.parameters.end_s * NS_PER_S
        over = [track for track in self._tracks if track.last_ns < limit]
        self._tracks = [track for track in self._tracks if track.last_ns >= limit]
        return self._ended(over)

    def measure(self, fixes: Sequence[Fix]) -> NDArray[np.float32]:
        """Assign fixes to predicted steps.

        Returns
        -------
        Shape (n, 3). The distance is that from the step a fix is assigned to, else from the
        nearest step that is left over: 0 where there are no tracks yet, infinite where all are
        taken.
        """
        cost = self._distances(fixes)
        pairs = assign(cost.astype(np.float64), self.parameters.max_distance)
        self._owner = {int(row): self._tracks[column] for row, column in pairs}
        left = np.ones(len(self._tracks), np.bool_)
        left[pairs[:, 1]] = False
        nearest = np.min(cost[:, left], axis=1, initial=np.inf)
        nearest[pairs[:, 0]] = cost[pairs[:, 0], pairs[:, 1]]
        if not self._tracks:
            nearest[:] = 0.0
        return np.array([(d, f.x_m, f.y_m) for d, f in zip(nearest, fixes, strict=True)], "f4")

    def follow(self, fixes: Sequence[Fix], accepted: NDArray[np.bool_]) -> list[TrackPoint]:
        """Take a step with each fix that belongs to a track; begin tracks with the others."""
        points: list[TrackPoint] = []
        begun: list[Track] = []
        for row, fix in enumerate(fixes):
            owner = self._owner.get(row)
            if owner is not None and accepted[row]:
                points += self._step(owner, fix)
            else:
                self._missed(fix)
                begun.append(self._begin(fix))
        counted = [t for t in self._tracks if t.number or t.chances < START_CHANCES]
        self._tracks = counted + begun
        return points

    def finish(self) -> list[TrackPoint]:
        """End all tracks."""
        over, self._tracks = self._tracks, []
        return self._ended(over)

    def _distances(self, fixes: Sequence[Fix]) -> NDArray[np.float32]:
        """Return Mahalanobis distances, shape (n, n_tracks), of the precision that is stored."""
        cost = np.full((len(fixes), len(self._tracks)), np.inf, np.float32)
        pace_ns = self.parameters.least_pace_s * NS_PER_S
        for row, fix in enumerate(fixes):
            place, noise = self._observed(fix)
            for column, track in enumerate(self._tracks):
                if fix.time_ns - track.last_ns >= max(pace_ns, 1):
                    cost[row, column] = track.filter.distance(place, noise)
        return cost

    def _observed(self, fix: Fix) -> tuple[Array, Array]:
        """Return the place of a fix, shape (2,), and its covariance, shape (2, 2)."""
        place = np.array([fix.x_m, fix.y_m])
        xx, xy, yy = fix.covariance
        known = np.isfinite(xx + xy + yy) and xx > 0 and xx * yy > xy**2
        if self.parameters.own_covariance and known:
            return place, np.array([[xx, xy], [xy, yy]])
        return place, self.model.r

    def _step(self, track: Track, fix: Fix) -> list[TrackPoint]:
        track.take(fix.time_ns, track.filter.step(*self._observed(fix)))
        track.chances += 1
        first = len(track.steps) - 1
        if not track.number and len(track.steps) >= START_FIXES:
            self._count += 1
            track.number, first = self._count, 0
        return filtered_points(track, self.stage, first) if track.number else []

    def _missed(self, fix: Fix) -> None:
        """Count a fix against the nearest track that does not count yet."""
        place = np.array([fix.x_m, fix.y_m])
        free = [t for t in self._tracks if not t.number and t not in self._owner.values()]
        if free:
            nearest = min(free, key=lambda t: float(np.hypot(*(t.steps[-1].state[2:] - place))))
            nearest.chances += 1

    def _begin(self, fix: Fix) -> Track:
        place, noise = self._observed(fix)
        track = Track(StepFilter(self.model, place, first_spread(noise)), [])
        track.take(fix.time_ns, float("nan"))
        return track

    def _ended(self, over: Sequence[Track]) -> list[TrackPoint]:
        kept = [t for t in over if t.number] if self.parameters.smooth else []
        return [p for t in kept for p in smoothed_points(t, self.stage, self.model)]
