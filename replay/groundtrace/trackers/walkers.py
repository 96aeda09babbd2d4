"""Several walkers, each with a step-clocked Kalman filter, told apart by where they go.

Source: the thesis on footstep localisation, chapter 6, for each walker; it has one only. Fixes
and predicted steps are assigned one to one inside a gate, see :mod:`.association`. Two walkers may
set their feet down at any times, but of one walker two impacts within the least pace and at one
place are heel and toe: the second joins no track and begins none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Fix, Quantity, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Candidates, Level
from ..parameters import measured
from ..stage import Context, Input, Stage
from .api import TrackerParameters
from .association import Foot, Limits, Observed, fit, foot_of, nearest, paired
from .kalman import Motion, StepFilter, WalkModel, first_spread
from .track import Track, filtered_points, smoothed_points

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock

    from ..stage import Output

#: A track counts from its second fix on, which must be among three that could be its own.
START_FIXES, START_CHANCES = 2, 3


@dataclass(frozen=True, slots=True)
class WalkersParameters(TrackerParameters):
    """Parameters of :class:`Walkers`.

    The two gates say whose step a fix is, and with it where the track goes on: to change one is
    to track again, it cannot be tried on stored candidates.
    """

    sigma_q: Annotated[
        float, measured("m", "How far a step strays from going straight on.", gt=0)
    ] = 0.1
    sigma_r: Annotated[float, measured("m", "Error of a fix, per axis.", gt=0)] = 0.5
    own_covariance: Annotated[
        bool, measured("", "Take the covariance of a fix that has one, not sigma_r.")
    ] = False
    max_distance: Annotated[
        float, measured("1", "Largest Mahalanobis distance from the predicted step.", gt=0)
    ] = 3.7
    least_pace_s: Annotated[
        float, measured("s", "Least time between two steps of a walker.", ge=0)
    ] = 0.25
    confirm: Annotated[
        int, measured("1", "A track is given once it has so many steps, all of them then.", ge=2)
    ] = 3
    end_s: Annotated[float, measured("s", "A track without a fix for so long ends.", gt=0)] = 2.0
    smooth: Annotated[bool, measured("", "Also give each track smoothed, when it ends.")] = True


class Walkers(Stage):
    """Kalman filters with a clock of steps, one a walker; each track is smoothed when it ends.

    Fixes that come together are of different walkers, so they are decided at once: when the first
    fix after them has come. Where the clock steps, all tracks end.
    """

    Parameters = WalkersParameters
    takes = (Input(Fix, first=True),)
    gives = (TrackPoint,)
    scope = "recording"
    ends_at = "clock step"
    feedback = True
    columns = (
        Quantity("distance", "1"),
        Quantity("since", "s"),
        Quantity("x", "m"),
        Quantity("y", "m"),
    )
    gates = (
        Level("distance", "1", "max_distance", at_least=False),
        Level("since", "s", "least_pace_s"),
    )

    def __init__(self, parameters: WalkersParameters) -> None:
        self.parameters = parameters
        self.model = WalkModel(parameters.sigma_q, parameters.sigma_r)
        self.stage = ""
        self._tracks: list[Track] = []
        self._steps: dict[int, tuple[Track, Motion]] = {}
        self._again: set[int] = set()
        self._count = 0
        self._waiting: list[Fix] = []  # fixes that may still get company
        self._together: list[Fix] = []  # those being decided

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin without tracks."""
        self.stage = context.stage
        return ("all",)

    def process(self, fix: Fix) -> Iterator[Output]:
        """Take a fix; where it is too late to be together with those that wait, decide these."""
        together_ns = self.parameters.together_s * NS_PER_S
        if self._waiting and fix.time_ns - self._waiting[0].time_ns > together_ns:
            yield from self._candidates()
        self._waiting.append(fix)

    def flush(self) -> Iterator[Output]:
        """End all tracks."""
        yield from self._candidates()
        yield from self.finish()

    def decided(self, block: CandidateBlock) -> Sequence[TrackPoint]:
        """Go on with the fixes just decided."""
        return self.follow(self._together, block.accepted)

    def _candidates(self) -> Iterator[Output]:
        """Yield the fixes that came together as candidates, and before them what has ended."""
        self._together = fixes = sorted(self._waiting, key=lambda fix: fix.time_ns)
        self._waiting = []
        if not fixes:
            return
        yield from self.expire(fixes[0].time_ns)
        times = np.array([fix.time_ns for fix in fixes], np.int64)
        yield Candidates(times, np.zeros(len(fixes), np.int32), self.measure(fixes))

    def expire(self, time_ns: int) -> list[TrackPoint]:
        """End the tracks that had no fix for too long."""
        limit = time_ns - self.parameters.end_s * NS_PER_S
        over = [track for track in self._tracks if track.last_ns < limit]
        self._tracks = [track for track in self._tracks if track.last_ns >= limit]
        return self._ended(over)

    def measure(self, fixes: Sequence[Fix]) -> NDArray[np.float32]:
        """Find whose steps the fixes are.

        Returns
        -------
        Shape (n, 4). Distance and time of a fix are those from the track whose next step it is,
        else from the nearest track; that may have another step within the least pace, from the
        place of which the distance is then. Where there are no tracks they are 0 and infinite.
        """
        limits = Limits(self.parameters.max_distance, self.parameters.least_pace_s)
        seen = [self._observed(fix) for fix in fixes]
        fits = [[fit(track, one, self.model, limits) for track in self._tracks] for one in seen]
        owner = paired(fits, self._tracks, limits)
        self._steps, self._again = {}, set()
        feet = {column: foot_of(track) for column, track in enumerate(self._tracks)}
        rows = np.zeros((len(fixes), 2), np.float32)
        for row, column in owner.items():
            found, one = fits[row][column], seen[row]
            if found is not None:
                self._steps[row] = (self._tracks[column], found.motion)
                rows[row] = found.distance, feet[column].since_s(one)
                feet[column] = Foot(one.time_ns, one.place, one.noise)
        for row, one in enumerate(seen):
            if row not in owner:
                rows[row] = nearest(one, feet, fits[row], limits)
                if rows[row, 0] <= limits.max_distance and rows[row, 1] < limits.least_pace_s:
                    self._again.add(row)
                else:
                    feet[len(feet)] = Foot(one.time_ns, one.place, one.noise)
        places = np.array([(fix.x_m, fix.y_m) for fix in fixes])
        return np.column_stack([rows, places]).astype(np.float32)

    def follow(self, fixes: Sequence[Fix], accepted: NDArray[np.bool_]) -> list[TrackPoint]:
        """Take a step with each fix that belongs to a track; begin tracks with strangers."""
        points: list[TrackPoint] = []
        begun: list[Track] = []
        for row, fix in enumerate(fixes):
            if row in self._steps and accepted[row]:
                points += self._step(*self._steps[row], fix)
            elif row not in self._again:
                self._missed(fix)
                begun.append(self._begin(fix))
        counted = [t for t in self._tracks if t.counts or t.chances < START_CHANCES]
        self._tracks = counted + begun
        return points

    def finish(self) -> list[TrackPoint]:
        """End all tracks."""
        over, self._tracks = self._tracks, []
        return self._ended(over)

    def _observed(self, fix: Fix) -> Observed:
        """Return a fix with the covariance that it is taken to have."""
        place, noise = np.array([fix.x_m, fix.y_m]), self.model.r
        xx, xy, yy = fix.covariance
        known = np.isfinite(xx + xy + yy) and xx > 0 and xx * yy > xy**2
        if self.parameters.own_covariance and known:
            noise = np.array([[xx, xy], [xy, yy]])
        return Observed(fix.time_ns, place, noise)

    def _step(self, track: Track, motion: Motion, fix: Fix) -> list[TrackPoint]:
        seen = self._observed(fix)
        track.take(fix.time_ns, motion, track.filter.step(seen.place, seen.noise, motion))
        track.chances += 1
        first = len(track.steps) - 1
        track.counts = track.counts or len(track.steps) >= START_FIXES
        if not track.number and len(track.steps) >= self.parameters.confirm:
            self._count += 1
            track.number, first = self._count, 0
        return filtered_points(track, self.stage, first) if track.number else []

    def _missed(self, fix: Fix) -> None:
        """Count a fix against the nearest track that does not count yet."""
        place = np.array([fix.x_m, fix.y_m])
        stepped = [track for track, _ in self._steps.values()]
        free = [t for t in self._tracks if not t.counts and t not in stepped]
        if free:
            nearby = min(free, key=lambda t: float(np.hypot(*(t.steps[-1].state[2:] - place))))
            nearby.chances += 1

    def _begin(self, fix: Fix) -> Track:
        seen = self._observed(fix)
        track = Track(StepFilter(self.model, seen.place, first_spread(seen.noise)), [])
        track.take(fix.time_ns, Motion.ahead(self.model), float("nan"))
        return track

    def _ended(self, over: Sequence[Track]) -> list[TrackPoint]:
        kept = [t for t in over if t.number] if self.parameters.smooth else []
        return [p for t in kept for p in smoothed_points(t, self.stage)]
