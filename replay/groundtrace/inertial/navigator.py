"""Inertial navigation of one foot by the moments it stands still."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Note, Quantity, TrackPoint
from groundtrace_codecs.signals import SignalBlock

from ..gates import Candidates, Level
from ..heading.aligned import columns_of_axes
from ..heading.rotations import levelled
from ..nonfinite import Holder
from ..stage import CannotStart, Context, Input, Stage
from .parameters import FootNavigatorParameters
from .walk import Walk

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import CandidateBlock
    from groundtrace_codecs.signals import Stream

    from ..stage import Output
    from .stances import Segment, SegmentRun, Segments
    from .strapdown import Pose

#: A sensor that stands and works measures gravity, at least about half of it.
LEAST_FORCE_MPS2 = 5.0
#: Sampled slower, the samples do not tell how fast a foot went between them.
LEAST_RATE_HZ = 25.0
QUANTITIES = ("angular_velocity", "acceleration")
#: With the magnetometer's, where the stream has one.
COLUMNS = 9


class FootNavigator(Stage):
    """ZUPT-INS: integrates a foot's motion, and corrects it by each stance that fits.

    The candidates are the beginnings of stances. ``distance`` and ``speed`` say how far the
    velocity had strayed from zero, in standard deviations and in m/s; ``swing`` is how long the
    foot had been under way. A stance that is rejected changes nothing but how sure the velocity
    is; while it lasts each of its segments is another candidate.

    Streams whose placement is given and is no foot are left alone. A bridged gap changes nothing;
    any other ends the track, and the next begins at the origin again: nothing says how far the
    foot came meanwhile.
    """

    Parameters = FootNavigatorParameters
    takes = (
        Input(SignalBlock, frozenset({"angular_velocity"}), hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), hold=False),
        Input(SignalBlock, hold=False, required=False),  # a field, or what else it has
    )
    gives = (TrackPoint,)
    feedback = True
    #: What it takes, in words.
    needs = "three axes of a foot"
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
        self._rate_told = False

    @property
    def pose(self) -> Pose | None:
        """Where the foot is and how its sensor is biased; None before it first stood."""
        return None if self._walk is None else self._walk.filter.pose

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a track where a stream is of a foot and has three axes of each sensor."""
        stream = context.stream
        if "foot" not in (stream.placement or "foot"):
            raise CannotStart
        columns = inertial_columns(stream)
        if columns is None:
            text = f"no track: expected three axes of {' and '.join(QUANTITIES)}, found others"
            raise CannotStart(text if stream.placement else "")
        self._columns, self._topic, self._holder = columns, context.topic, Holder()
        self._segments = segments_of(self.parameters, stream.rate_hz)
        self.begin(context.stage, context.tracks.next())
        return ("foot",)

    def process(self, block: SignalBlock) -> Iterator[Output]:
        """Go on by the samples of a block."""
        rate_hz = block.stream.rate_hz
        if rate_hz < LEAST_RATE_HZ and not self._rate_told:
            text = f"{block.topic}: a swing of a foot needs {LEAST_RATE_HZ:g} Hz to be followed"
            yield Note(block.start_ns, f"{text}, found {rate_hz:g}", "WARN", self.stage)
        self._rate_told = True
        held = self._holder.held(block.select(self._columns))
        values = held.values
        if values.shape[1] < COLUMNS:
            values = np.pad(values, ((0, 0), (0, 3)), constant_values=np.nan)
        yield from self._navigate(self._segments.add(block.sample_times(), values))

    def flush(self) -> Iterator[Output]:
        """End the track."""
        for segments in self._segments.finish():
            yield from self._navigate(segments)
        yield from self.finish()
        if self._holder.count:
            text = f"{self._topic}: {self._holder.count} samples not finite, last value held"
            yield Note(self._holder.last_ns, text, "WARN", self.stage)

    def decided(self, block: CandidateBlock) -> Sequence[TrackPoint]:
        """Go on by the segment just decided."""
        return self.follow(self._segment, bool(block.accepted[0]))

    def _navigate(self, segments: SegmentRun) -> Iterator[Output]:
        """Go on by segments, each with which a stance may begin decided before the next."""
        at = 0
        while at < len(segments):
            at, points = self.go_on(segments, at)
            yield from points
            if at < len(segments):
                self._segment = segments[at]
                found = self.measure(self._segment)
                if len(found):
                    yield found
                else:
                    yield from self.follow(self._segment, None)
                at += 1

    def begin(self, stage: str, number: int) -> None:
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


def inertial_columns(stream: Stream) -> list[int] | None:
    """Return the columns of rate and force, x, y, z each, and of the magnetic field if it is there.

    None where rate or force do not have three axes.
    """
    columns = []
    for quantity in (*QUANTITIES, "magnetic_field"):
        found = columns_of_axes(stream, quantity)
        if not found and quantity in QUANTITIES:
            return None
        columns += found
    return columns


def segments_of(p: FootNavigatorParameters, rate_hz: float) -> Segments:
    """Return what cuts samples into segments in which a foot stands or swings."""
    # what filters is not imported where pipelines are only listed
    from ..detectors.zupt import ZeroVelocityParameters
    from .stances import Segments

    statistic = ZeroVelocityParameters(
        p.window_s, p.acceleration_sigma, p.rotation_sigma, stride_s=p.stride_s
    )
    return Segments(rate_hz, statistic)
