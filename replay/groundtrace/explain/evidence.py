"""Evidence: what a results file holds of every decision, read back without the signal."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Gap, StageSpec, TraceBlock, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

from ..detector import Frames
from ..gates import Candidates
from ..pipeline import parse_pipeline

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    from ..pipeline import PipelineConfig
    from ..results import Results
    from ..warned import Warned


#: Messages that evidence is made of, and what the replay warned of.
KINDS = frozenset({"CandidateBlock", "TraceBlock", "Gap", "Note", "TrackPoint"})
#: So many blocks of a stage are joined.
JOINED = 256


@dataclass(frozen=True, slots=True, eq=False)
class StageEvidence:
    """All candidates and frames of one stage on one topic.

    Attributes
    ----------
    spec
        What the columns mean, and the gates as they stood.
    candidates
        In the order they were decided.
    gate_value, margin
        Shape (n, n_gates), float32, as decided.
    accepted
        Shape (n,), bool, as decided.
    frames
        The trace; empty for associators.
    """

    spec: StageSpec
    candidates: Candidates
    gate_value: NDArray[np.float32]
    margin: NDArray[np.float32]
    accepted: NDArray[np.bool_]
    frames: Frames

    def between(self, start_ns: int, end_ns: int) -> NDArray[np.intp]:
        """Return the rows of candidates with start <= time <= end."""
        times = self.candidates.time_ns
        return np.flatnonzero((times >= start_ns) & (times <= end_ns))


@dataclass(frozen=True, slots=True)
class Unmuted:
    """A candidate that is there without the filter.

    Attributes
    ----------
    time_ns
        Its time.
    value
        What its decision function reaches, in the unit of the candidates' first column.
    """

    time_ns: int
    value: float


class WithoutFilters(Protocol):
    """The signal of a result, measured again without the filters of its stages."""

    @property
    def at_hand(self) -> bool:
        """Whether the recording is."""

    def around(self, part: StageEvidence, time_ns: int) -> StageEvidence | None:
        """Return what a stage measures without its filter in the stretch that a time lies in."""

    def nearest(
        self, part: StageEvidence, channel: int, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return what passes all thresholds in a span without the filter, nearest its middle."""

    def group(
        self, part: StageEvidence, source: StageEvidence, start_ns: int, end_ns: int
    ) -> Unmuted | None:
        """Return the accepted group of picks in a span where they are picked without the filter."""

    def clipped(self, part: StageEvidence, start_ns: int, end_ns: int) -> tuple[str, float] | None:
        """Return the channel that stood still at its extreme for longest, and for how long [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Everything needed to decide again.

    Attributes
    ----------
    name
        File name of the recording.
    config
        The pipeline, every parameter as it stood.
    stages
        In the order of the pipeline, then of the topics.
    gaps
        Interruptions of the streams.
    labels
        The truth.
    start_ns, end_ns
        First and last sample of the recording [ns].
    geometry
        Where the sensors are; None where unknown.
    track
        Where targets were tracked, by the last stage that tracks.
    warnings
        What the replay warned of.
    unfiltered
        Measures the recording again without a stage's filter; None where it is not known.
    """

    name: str
    config: PipelineConfig
    stages: tuple[StageEvidence, ...]
    gaps: tuple[Gap, ...]
    labels: tuple[Label, ...]
    start_ns: int
    end_ns: int
    geometry: Geometry | None = None
    track: tuple[TrackPoint, ...] = ()
    warnings: tuple[Warned, ...] = ()
    unfiltered: WithoutFilters | None = None

    @property
    def clock_steps_s(self) -> tuple[float, ...]:
        """Where a clock stepped and ended a run [s since the first sample].

        A replay forgets there what it accepted before; stored candidates do not tell on which
        side of the step they lie, so that decisions after it may not be decided again exactly.
        """
        steps = [g.start_ns for g in self.gaps if g.reason == "clock step" and not g.bridged]
        return tuple((time_ns - self.start_ns) / NS_PER_S for time_ns in steps)

    def of(self, stage: str) -> tuple[StageEvidence, ...]:
        """Return the evidence of a stage, topic by topic."""
        return tuple(e for e in self.stages if e.spec.stage == stage)


def evidence_of(results: Results, labels: tuple[Label, ...] | None = None) -> Evidence:
    """Return the evidence of a result; ``labels`` replace its own truth where given."""
    origin = results.provenance
    config = parse_pipeline(origin.pipeline.encode(), f"{results.name}: pipeline")
    return Evidence(
        origin.recording,
        config,
        stage_evidence(results.events, [stage.key for stage in config.stage]),
        tuple(e for e in results.events if isinstance(e, Gap)),
        results.labels if labels is None else labels,
        origin.start_ns,
        origin.end_ns,
        results.geometry,
        _last_track(results.events),
        results.warnings,
    )


def step_times(evidence: Evidence) -> NDArray[np.int64]:
    """Return the times of the steps of the last stage that emits them, sorted [ns]."""
    stages = [part for part in evidence.stages if part.spec.emits == "step"]
    last = stages[-1].spec.stage if stages else ""
    times = [p.candidates.time_ns[p.accepted] for p in stages if p.spec.stage == last]
    return np.sort(np.concatenate([np.empty(0, np.int64), *times]))


def joined(events: Iterable[Event]) -> Iterator[Event]:
    """Yield events, the candidates and frames of each stage and topic many to a block.

    An hour has a hundred thousand blocks of a few candidates, and each block its own arrays.
    """
    waiting: dict[tuple[type[Event], int], list[Any]] = {}
    for event in events:
        if not isinstance(event, CandidateBlock | TraceBlock):
            yield event
            continue
        parts = waiting.setdefault((type(event), id(event.spec)), [])
        parts.append(event)
        if len(parts) == JOINED:
            yield _one_block(parts)
            parts.clear()
    for parts in waiting.values():
        if parts:
            yield _one_block(parts)


def _one_block(parts: Sequence[Any]) -> Event:
    """Return blocks of one kind, stage and topic as one."""
    columns = (field.name for field in fields(parts[0]) if field.name != "spec")
    joint = (np.concatenate([getattr(part, name) for part in parts]) for name in columns)
    return cast("Event", type(parts[0])(parts[0].spec, *joint))


def _last_track(events: Iterable[Event]) -> tuple[TrackPoint, ...]:
    """Return the points of the last stage that tracks: a smoother comes after what it smooths."""
    points = [e for e in events if isinstance(e, TrackPoint)]
    stages = list(dict.fromkeys(p.stage for p in points))
    return tuple(p for p in points if p.stage == stages[-1])


def stage_evidence(events: Iterable[Event], order: list[str]) -> tuple[StageEvidence, ...]:
    """Gather the blocks of each stage and topic; stages come in ``order``."""
    specs: dict[tuple[str, str], StageSpec] = {}
    blocks: dict[tuple[str, str], list[CandidateBlock]] = {}
    traces: dict[tuple[str, str], list[TraceBlock]] = {}
    for event in events:
        if isinstance(event, StageSpec):
            specs.setdefault((event.stage, event.topic), event)
        elif isinstance(event, CandidateBlock):
            blocks.setdefault((event.spec.stage, event.spec.topic), []).append(event)
        elif isinstance(event, TraceBlock):
            traces.setdefault((event.spec.stage, event.spec.topic), []).append(event)
    keys = sorted(specs, key=lambda key: order.index(key[0]))
    return tuple(_gathered(specs[k], blocks.get(k, []), traces.get(k, [])) for k in keys)


def _gathered(
    spec: StageSpec, blocks: list[CandidateBlock], traces: list[TraceBlock]
) -> StageEvidence:
    gates, n_channels = len(spec.gates), len(spec.channels)
    none = Candidates.empty(len(spec.columns))
    parts = [Candidates(b.time_ns, b.channel, b.value) for b in blocks]
    margins = np.empty((0, gates), np.float32)
    frames = np.empty((0, n_channels, len(spec.trace)), np.float32)
    return StageEvidence(
        spec,
        Candidates.concatenate([none, *parts]),
        np.concatenate([margins, *(b.gate_value for b in blocks)]),
        np.concatenate([margins, *(b.margin for b in blocks)]),
        np.concatenate([np.empty(0, np.bool_), *(b.accepted for b in blocks)]),
        Frames(
            np.concatenate([np.empty(0, np.int64), *(t.time_ns for t in traces)]),
            np.concatenate([frames, *(t.value for t in traces)]),
        ),
    )
