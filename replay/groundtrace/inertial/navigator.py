"""Inertial navigation of one foot by the moments it stands still."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Quantity

from ..gates import Candidates, Level
from ..heading.rotations import levelled
from .parameters import FootNavigatorParameters
from .walk import Walk

if TYPE_CHECKING:
    from groundtrace_codecs.events import TrackPoint

    from ..detector import Emits
    from .stances import Segment, SegmentRun
    from .strapdown import Pose

#: A sensor that stands and works measures gravity, at least about half of it.
LEAST_FORCE_MPS2 = 5.0


class FootNavigator:
    """ZUPT-INS: integrates a foot's motion, and corrects it by each stance that fits.

    The candidates are the beginnings of stances. ``distance`` and ``speed`` say how far the
    velocity had strayed from zero, in standard deviations and in m/s; ``swing`` is how long the
    foot had been under way. A stance that is rejected changes nothing but how sure the velocity
    is; while it lasts each of its segments is another candidate.
    """

    Parameters = FootNavigatorParameters
    emits: Emits = "track"
    columns = (
        Quantity("stillness", "1"),
        Quantity("distance", "1"),
        Quantity("speed", "m/s"),
        Quantity("swing", "s"),
        Quantity("x", "m"),
        Quantity("y", "m"),
    )
    gates = (
        Level("stillness", "1", "stillness"),
        Level("distance", "1", "max_distance", at_least=False),
        Level("speed", "m/s", "max_speed_mps", at_least=False),
    )

    def __init__(self, parameters: FootNavigatorParameters) -> None:
        self.parameters = parameters
        self.stage = ""
        self.number = 0
        self._walk: Walk | None = None
        self._standing: list[Segment] = []
        self._stands = False

    @property
    def pose(self) -> Pose | None:
        """Where the foot is and how its sensor is biased; None before it first stood."""
        return None if self._walk is None else self._walk.filter.pose

    def start(self, stage: str, number: int) -> None:
        """Begin a track of its own; ``stage`` and ``number`` go into its points."""
        self.stage, self.number = stage, number
        self._walk, self._standing, self._stands = None, [], False

    def go_on(self, segments: SegmentRun, start: int) -> tuple[int, list[TrackPoint]]:
        """Go on from a segment until one that is to be measured; return it, and what is known."""
        walk = self._walk
        if walk is None or self.parameters.magnetometer:
            return start, []
        at, self._stands = walk.go_on(segments, start, stands=self._stands)
        return at, walk.told()

    def measure(self, segment: Segment) -> Candidates:
        """Go on by a segment; return the stance that may begin with it, or none."""
        stillness = 1 / (1 + segment.statistic)
        still = segment.statistic <= self._limit(segment)
        none = Candidates.empty(len(self.columns))
        if self._walk is None:
            self._standing = [*self._standing, segment] if still else []
            return none
        walk = self._walk
        walk.predict(segment)
        walk.rested_s = walk.rested_s + segment.length_s if stillness >= 0.5 else 0.0
        if not still:
            self._stands, walk.stood_s = False, 0.0
        if self._stands:
            return none
        walk.swung_s += segment.length_s
        if not still:
            return none
        seen = walk.stillness(segment)
        speed = float(np.linalg.norm(seen.value))
        row = [stillness, seen.distance, speed, walk.swung_s, *walk.place[:2]]
        return Candidates(
            np.array([segment.time_ns], np.int64),
            np.zeros(1, np.int32),
            np.array([row], np.float32),
        )

    def follow(self, segment: Segment, accepted: bool | None) -> list[TrackPoint]:
        """Take the verdict on what was just measured, None if nothing; return what is known."""
        if self._walk is None:
            return self._align(segment)
        if accepted is not None:
            self._stands = accepted
        return self._walk.follow(segment, self._stands, accepted)

    def finish(self) -> list[TrackPoint]:
        """End the track; return what is still to say of it."""
        walk, self._walk = self._walk, None
        return [] if walk is None else walk.finish()

    def _limit(self, segment: Segment) -> float:
        """Return up to what statistic a foot stands: a fast one rolls on while it does."""
        return max(self.parameters.sure, self.parameters.share * segment.peak)

    def _align(self, segment: Segment) -> list[TrackPoint]:
        """Begin the track where the foot has stood for long enough."""
        if sum(part.length_s for part in self._standing) < self.parameters.align_s:
            return []
        force = np.concatenate([part.force[1:] for part in self._standing]).mean(axis=0)
        if np.linalg.norm(force) < LEAST_FORCE_MPS2:
            return []
        self._walk = Walk(self.parameters, levelled(force), self.stage, self.number)
        self._standing, self._stands = [], True
        return self._walk.follow(segment, self._stands, None)
