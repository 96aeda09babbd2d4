"""Stages: what a pipeline is made of, and the one that runs a detector."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    Note,
    StageSpec,
    TraceBlock,
    kind_emitted,
)
from groundtrace_codecs.signals import SignalBlock
from groundtrace_codecs.units import QUANTITIES, UNKNOWN_UNITS

from .detector import Associator, Detector, Emits
from .gates import Candidates, Carry, decided_block, gate_specs, never_passed
from .nonfinite import Holder
from .parameters import describe
from .presence_spans import Spans

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .detector import Curve, Measured

W = TypeVar("W", bound=Detector | Associator)
K = TypeVar("K")


class Stage(Protocol):
    """A step of a pipeline: items in, events out.

    One that does better with many items at once has a method ``process_all`` as well: it takes
    items that come one after the other, and returns a list of what each brings about.
    """

    name: str

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Take one item; yield the events it brings about."""

    def flush(self) -> Iterator[Event]:
        """End of the recording: yield what was held back."""


@dataclass(slots=True)
class TopicRun(Generic[W]):
    """A detector or associator at work on one topic; ``start_ns`` is a run's first sample."""

    worker: W
    spec: StageSpec
    columns: list[int] = field(default_factory=list)
    carry: Carry = field(default_factory=Carry)
    holder: Holder = field(default_factory=Holder)
    spans: Spans = field(default_factory=Spans)
    open: bool = True
    start_ns: int | None = None

    def decide(self, found: Candidates, parameters: Any) -> list[Event]:
        """Return the decided candidates and the events that the accepted ones stand for."""
        if not len(found):
            return []
        block, self.carry = decided_block(self.spec, found, self.worker, parameters, self.carry)
        if self.worker.emits == "presence":
            return [block, *self.spans.take(block)]
        return [block, *accepted_events(block, self.worker.emits)]

    def unknown_units(self, block: SignalBlock, parameters: Any) -> Iterator[Note]:
        """Say at the run's begin where thresholds have a unit and the signal an unknown one."""
        spec = self.spec
        units = {q.unit for q in spec.columns} | {g.unit for g in spec.gates}
        units |= {info.unit for info in describe(type(parameters))}
        channels = [block.stream.channels[c] for c in self.columns]
        for quantity, unit in sorted({(c.quantity, c.unit) for c in channels}):
            wanted = QUANTITIES.get(quantity)
            if unit not in UNKNOWN_UNITS or unit == wanted or wanted not in units:
                continue
            text = f"{spec.topic}: {quantity} is in {unit}, not {wanted}:"
            if getattr(self.worker, "mean_is_gravity", False):
                said = f"{text} its mean length is taken for gravity"
                yield Note(block.start_ns, said, "INFO", spec.stage)
            else:
                said = f"{text} what {spec.stage} asks for in {wanted} does not hold"
                yield Note(block.start_ns, said, "WARN", spec.stage)

    def never_passed(self, time_ns: int) -> Iterator[Note]:
        """Say at the run's begin which thresholds no candidate can reach."""
        reach = getattr(self.worker, "reach", None)
        for text in [] if reach is None else never_passed(self.spec, reach()):
            yield Note(time_ns, text, "WARN", self.spec.stage)


def allows(patterns: Sequence[str], topic: str) -> bool:
    """Return whether a topic fits one of some patterns; every topic does where there are none."""
    return not patterns or any(fnmatch(topic, pattern) for pattern in patterns)


class PluginStage(Generic[K]):
    """What every stage is given: its name, its plugin, and where it may run.

    Parameters
    ----------
    name
        Name of the stage in its pipeline.
    plugin
        Name the plugin is registered under.
    kind
        The plugin's class.
    parameters
        Its parameters.
    topics
        Patterns of the topics it may run on; empty means all that fit.
    """

    def __init__(
        self, name: str, plugin: str, kind: type[K], parameters: Any, topics: Sequence[str] = ()
    ) -> None:
        self.name = name
        self.plugin = plugin
        self.kind = kind
        self.parameters = parameters
        self.topics = tuple(topics)

    def allowed(self, topic: str) -> bool:
        """Return whether the stage may run on a topic."""
        return allows(self.topics, topic)


class DetectorStage(PluginStage[Detector]):
    """Runs one detector on every stream whose channels it wants.

    Parameters
    ----------
    name
        Name of the stage in its pipeline.
    plugin
        Name the detector is registered under.
    kind
        The detector's class.
    parameters
        Its parameters.
    topics
        Patterns of the topics it may run on; empty means all that fit.
    placements
        By topic, where a sensor is worn that its stream does not say.

    Notes
    -----
    Rule for gaps: a bridged gap changes nothing; any other ends the run of its stream (what was
    held back comes out) and starts a new one with fresh filters. The refractory time goes on,
    unless the clock was set back: times before and after then have nothing to do with each other.
    Samples that are not finite are held at the channel's last finite value and counted.

    No candidate is earlier than the first sample of its run: one that a filter's delay or a lead
    put before it, where somebody begins to walk from rest, is set to it before it is decided.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Detector],
        parameters: Any,
        topics: Sequence[str] = (),
        placements: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.placements = placements or {}
        self._runs: dict[str, TopicRun[Detector] | None] = {}

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Feed a block to the detector, or end a run at a gap."""
        if isinstance(item, Gap):
            run = self._runs.get(item.topic)
            if run is not None and not item.bridged:
                yield from self._finish(run)
                if item.reason == "clock step":
                    run.carry = Carry()
        elif isinstance(item, SignalBlock) and len(item):
            if item.topic not in self._runs:
                self._runs[item.topic] = run = self._begin(item.stream)
                if run is not None:
                    yield run.spec
                    yield from run.unknown_units(item, self.parameters)
                    yield from run.never_passed(item.start_ns)
            run = self._runs[item.topic]
            if run is not None:
                yield from self._feed(run, item.select(run.columns))

    def curve(self, topic: str) -> Curve | None:
        """Return the decision function of what the last block of a topic completed.

        None where the stage does not run on the topic, or its detector tells frames alone.
        """
        run = self._runs.get(topic)
        tell = getattr(run.worker, "curve", None) if run is not None else None
        curve: Curve | None = tell() if tell is not None else None
        return curve

    def flush(self) -> Iterator[Event]:
        """End all runs."""
        for run in self._runs.values():
            if run is not None:
                yield from self._finish(run)

    def _begin(self, stream: Stream) -> TopicRun[Detector] | None:
        columns = stream.columns_of(self.kind.quantities)
        allowed = self.allowed(stream.topic)
        if not (columns and allowed):
            return None
        detector = self.kind(self.parameters)
        names = detector.start(self._worn(stream.select(columns)))
        spec = StageSpec(
            stage=self.name,
            plugin=self.plugin,
            topic=stream.topic,
            channels=names,
            columns=detector.columns,
            gates=gate_specs(detector.gates, self.parameters),
            trace=detector.trace,
            emits=detector.emits,
        )
        return TopicRun(detector, spec, columns)

    def _worn(self, stream: Stream) -> Stream:
        """Return a stream with the placement that it states, or else the one that is known."""
        placement = stream.placement or self.placements.get(stream.topic, "")
        return replace(stream, placement=placement)

    def _feed(self, run: TopicRun[Detector], block: SignalBlock) -> list[Event]:
        if not run.open:
            run.worker = self.kind(self.parameters)
            run.worker.start(self._worn(block.stream))
            run.open, run.start_ns = True, None
        if run.start_ns is None:
            run.start_ns = block.start_ns
        return self._measured(run, run.worker.measure(run.holder.held(block)))

    def _finish(self, run: TopicRun[Detector]) -> Iterator[Event]:
        if not run.open:
            return
        run.open = False
        yield from self._measured(run, run.worker.finish())
        yield from run.spans.finish(run.spec)
        if run.holder.count:
            text = f"{run.spec.topic}: {run.holder.count} samples not finite, last value held"
            yield Note(run.holder.last_ns, text, "WARN", self.name)
        run.holder = Holder()

    def _measured(self, run: TopicRun[Detector], measured: Measured) -> list[Event]:
        found = measured.candidates
        if run.start_ns is not None:
            found = found.not_before(run.start_ns)
        decided = run.decide(found, self.parameters)
        if not len(measured.frames.time_ns):
            return decided
        return [TraceBlock(run.spec, measured.frames.time_ns, measured.frames.value), *decided]


def accepted_events(block: CandidateBlock, emits: Emits) -> list[Event]:
    """Return the events that the accepted candidates of a block stand for, as the table has it."""
    kind = kind_emitted(emits)
    return [] if kind is None else list(kind.from_candidates(block))
