"""A recording in spans: stages replay each by itself, and the spans are joined to the whole.

A stage that says how far back it remembers (:class:`.stage.Memory`) is replayed span by span, each
after a warm-up of that length. One that learns from all steps before, but says so of what it
measures of a step, measures span by span, and learns in one go. What the others need is made in one
go, over the joined events, and the signal where they take it. So the joined replay has the events
of one in one go, in their order.

That is not presumed: at each join the span before, which is known to be right, and the one after,
which began in the middle, are compared. Runs of samples must stand alike, both must have decided
the end of the warm-up alike, and what their stages still hold back there must be the same. Where it
is not, the span is replayed again from earlier on, at last from the recording's begin.
"""

from __future__ import annotations

import copy
from collections import defaultdict, deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import SMOOTHED, CandidateBlock, Gap, Note, StageSpec, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .gates import Candidates, GateState, Level, Refractory, decided_block
from .source import RunBefore, Source, runs_before
from .stage import CLOCK_STEP, Memory, StageRunner, StepMeasure

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.mcap.chunks import Damage
    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import Stream

    from .chain import Pipeline, Taking

    #: What stages made of something: by their names, events, and what was made of these.
    Made = dict[str, list[tuple[Event, "Made"]]]

#: The end of a warm-up in which both sides of a join are compared [s]. Chosen by judgement: some
#: steps of a walk.
CHECKED_S = 5.0
#: Values on both sides of a join may differ by so much: the rounding of float32, in which they are
#: kept. Source: definition, some times 2^-24.
ROUNDING = 1e-6


def in_spans(pipeline: Pipeline) -> tuple[str, ...]:
    """Return the names of the stages that spans are replayed through, each by itself."""
    return tuple(
        stage.name
        for stage in pipeline.stages
        if isinstance(stage, StageRunner) and pipeline.memories[stage.name].warm_up_s is not None
        if pipeline.memories[stage.name].delay_s is not None
    )


def measured_in_spans(pipeline: Pipeline) -> tuple[str, ...]:
    """Return the names of the stages that learn in one go from what spans measure for them."""
    span_stages = in_spans(pipeline)
    return tuple(
        name
        for name, memory in pipeline.measured.items()
        if name not in span_stages and None not in (memory.warm_up_s, memory.delay_s)
    )


def warm_up_s(pipeline: Pipeline) -> float:
    """Return how much signal is replayed before a span [s]: memory, delay, and what is compared.

    What was decided later than it happened is to come from the span that was on by then.
    """
    memories = [pipeline.memories[name] for name in in_spans(pipeline)]
    memory = Memory.longest(
        [*memories, *(pipeline.measured[name] for name in measured_in_spans(pipeline))]
    )
    return (memory.warm_up_s or 0.0) + (memory.delay_s or 0.0) + CHECKED_S


@dataclass(frozen=True, slots=True)
class Unit:
    """Samples of which only their number and place are kept: what came of them is known.

    Attributes
    ----------
    topic
        Of the stream.
    anchor_ns, first, length
        As a SignalBlock has them.
    """

    topic: str
    anchor_ns: int
    first: int
    length: int

    @classmethod
    def of(cls, block: SignalBlock) -> Unit:
        """Return what is kept of a block."""
        return cls(block.topic, block.anchor_ns, block.first, len(block))

    def block(self, stream: Stream) -> SignalBlock:
        """Return a block in the place of this, whose samples are 0 and take no memory."""
        shape = self.length, len(stream.channels)
        return SignalBlock(
            stream, self.anchor_ns, self.first, np.broadcast_to(np.zeros((), np.int16), shape)
        )


@dataclass(frozen=True, slots=True)
class JoinState:
    """Where a replay stands between two windows, to compare.

    Attributes
    ----------
    runs
        State of each topic's run of samples.
    decided
        The events of the last seconds before.
    pending
        The events that would come if the recording ended here.
    stated
        Stage and topic of all that was stated so far.
    """

    runs: Mapping[str, Any]
    decided: tuple[Event, ...]
    pending: tuple[Event, ...]
    stated: frozenset[tuple[str, str]]

    def after(self, before: JoinState) -> JoinState:
        """Return the same of a replay that was on before the span with this end began."""
        return replace(self, stated=self.stated | before.stated)

    def differs(self, true: JoinState) -> str:
        """Return in what this is not as another, which is known to be right; empty: in nothing."""
        if self.runs != true.runs:
            return "runs of samples"
        if self.stated != true.stated:
            return "stages that began"
        if not same_events(self.decided, true.decided):
            return "what was decided"
        if not same_events(self.pending, true.pending) or _notes(self.pending) != _notes(
            true.pending
        ):
            return "what stages hold back"
        return ""


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a recording, in windows of log time; see :meth:`.source.Source.windows`.

    Attributes
    ----------
    first, stop
        Of the windows; None is the recording's begin or end.
    warm
        Where the warm-up begins; None: with the recording.
    checked
        Windows before the first one that are compared.
    runs
        By topic, time and recorded index of sample 0 of the runs there are at ``first``, where
        known.
    """

    first: int | None
    stop: int | None
    warm: int | None
    checked: int
    runs: Mapping[str, tuple[int, int]] | None = None


@dataclass(frozen=True, slots=True)
class SpanReplay:
    """What a span gives.

    Attributes
    ----------
    items
        What came of the recording, and what was made of it, in order.
    pending
        By stage, what comes at the recording's end; of the last span alone.
    begin, end
        Where it began and ended, to compare; None at the recording's begin and end.
    damage
        What was left out of the recording.
    """

    items: list[tuple[Unit | Gap, Made]]
    pending: Made | None
    begin: JoinState | None
    end: JoinState | None
    damage: tuple[Damage, ...] = ()

    def differs(self, true: JoinState) -> str:
        """Return in what it began not as is known to be right; empty: in nothing."""
        return "" if self.begin is None else self.begin.differs(true)


class RecordedStages:
    """Stages at work, and what each makes of every item, so that it can be given again."""

    def __init__(self, stages: Sequence[StageRunner]) -> None:
        self._stages = tuple(stages)

    def process(self, item: SignalBlock | Gap) -> Made:
        """Return what the stages make of an item."""
        if isinstance(item, SignalBlock):
            for stage in self._stages:
                if stage.buffers:
                    stage.buffer(item)
        made: Made = {}
        self._through([(item, made)], self._stages)
        return made

    def flush(self) -> Made:
        """End the recording; return what each stage held back."""
        made: Made = {}
        for index, stage in enumerate(self._stages):
            made[stage.name] = [(event, {}) for event in stage.flush()]
            self._through(made[stage.name], self._stages[index + 1 :])
        return made

    def pending(self) -> Made:
        """Return what `flush` would, and go on as if it had not been asked."""
        return copy.deepcopy(self).flush()

    @staticmethod
    def _through(line: Sequence[tuple[Any, Made]], stages: Sequence[StageRunner]) -> None:
        for stage in stages:
            longer: list[tuple[Any, Made]] = []
            events_of = stage.process_all([item for item, _ in line])
            for (item, made), events in zip(line, events_of, strict=True):
                if events:
                    born: list[tuple[Event, Made]] = [(event, {}) for event in events]
                    made[stage.name] = born
                    longer += born
                longer.append((item, made))
            line = longer


def events_in(made: Made) -> Iterator[Event]:
    """Yield the events that were made of something, each before what was made of it."""
    for born in made.values():
        for event, derived in born:
            yield event
            yield from events_in(derived)


def replay_span(recording: Recording, pipeline: Pipeline, span: Span) -> SpanReplay:
    """Replay a span, with its warm-up, through the stages that it can be replayed through.

    Parameters
    ----------
    recording, pipeline
        Both as a replay of the whole has them; the pipeline has seen nothing yet.
    span
        What is to be replayed.
    """
    span_stages, measured = set(in_spans(pipeline)), set(measured_in_spans(pipeline))
    stages = RecordedStages(
        [
            stage.beforehand() if stage.name in measured else stage
            for stage in pipeline.stages
            if isinstance(stage, StageRunner) and stage.name in span_stages | measured
        ]
    )
    source = _source_of(recording, span, pipeline.bridge_s)
    items: list[tuple[Unit | Gap, Made]] = []
    recent: list[tuple[int, list[Event]]] = []
    stated: set[tuple[str, str]] = set()
    runs: Mapping[str, Any] = {}
    begin: JoinState | None = None

    def standing(window: int) -> JoinState:
        last = tuple(e for at, events in recent if at >= window - span.checked for e in events)
        return JoinState(runs, last, tuple(events_in(stages.pending())), frozenset(stated))

    for window, given in source.windows():
        if span.first is not None and begin is None and window >= span.first:
            begin = standing(span.first)
        if span.stop is not None and window >= span.stop:
            break
        in_span = span.first is None or window >= span.first
        events: list[Event] = []
        for item in given:
            made = stages.process(item)
            if in_span:
                items.append((Unit.of(item) if isinstance(item, SignalBlock) else item, made))
            events += events_in(made)
        stated |= {(e.stage, e.topic) for e in events if isinstance(e, StageSpec)}
        recent = [
            *(entry for entry in recent if entry[0] >= window - span.checked),
            (window, events),
        ]
        runs = source.states
    if span.first is not None and begin is None:  # nothing was recorded from there on
        begin = standing(span.first)
    if span.stop is None:
        return SpanReplay(items, stages.flush(), begin, None, recording.damage)
    return SpanReplay(items, None, begin, standing(span.stop), recording.damage)


def _source_of(recording: Recording, span: Span, bridge_s: float) -> Source:
    """Return the source of a span: from its warm-up on."""
    source = Source(recording, bridge_s=bridge_s)
    if span.warm is None:
        return source
    late_ns = max(lag.high_ns for _, lag in recording.readers.values())
    start_ns = span.warm * source.width_ns - late_ns
    topics = [stream.topic for stream in source.streams]
    if span.runs is not None:
        runs = {t: RunBefore(start_ns, *begin) for t, begin in span.runs.items()}
    else:
        indexed_runs = runs_before(recording, topics, start_ns, bridge_s)
        runs = _without_gap(recording, topics, start_ns) if indexed_runs is None else indexed_runs
    return Source(recording, start_ns=start_ns, bridge_s=bridge_s, runs=runs)


def _without_gap(
    recording: Recording, topics: Iterable[str], start_ns: int
) -> dict[str, RunBefore]:
    """Return the runs that go on at a time if there was no gap before: the join tells if so."""
    runs = {}
    for topic in topics:
        first = next((block for _, block in recording.blocks([topic])), None)
        if first is not None and first.start_ns < start_ns:
            base = 0 if first.times_ns is not None else first.first
            runs[topic] = RunBefore(start_ns, first.start_ns, base)
    return runs


def same_events(one: Iterable[Event], other: Iterable[Event]) -> bool:
    """Return whether events are the same, but for what rounding and a begin in the middle change.

    Times and verdicts are compared, and values up to :data:`ROUNDING`. The time since the last
    decision is no more than told by where a replay began; notes and smoothed tracks are no
    decisions.
    """
    first, second = _columns(one), _columns(other)
    return first.keys() == second.keys() and all(
        _equal(values, second[key]) for key, values in first.items()
    )


def _notes(events: Iterable[Event]) -> list[Note]:
    return [event for event in events if isinstance(event, Note)]


def _columns(events: Iterable[Event]) -> dict[tuple[str, ...], Any]:
    columns: dict[tuple[str, ...], list[Any]] = defaultdict(list)
    for event in events:
        if isinstance(event, Note | StageSpec | Gap):
            continue
        kind = type(event).__name__
        if isinstance(event, CandidateBlock | TraceBlock):
            names = ["time_ns", "value"]
            names += ["channel", "accepted"] if isinstance(event, CandidateBlock) else []
            for name in names:
                columns[event.spec.stage, event.spec.topic, kind, name].append(getattr(event, name))
        elif not event.stage.endswith(SMOOTHED):
            columns[event.stage, getattr(event, "topic", ""), kind].append([event.time_ns])
    return {key: np.concatenate(parts) for key, parts in columns.items()}


def _equal(one: Any, other: Any) -> bool:
    if one.shape != other.shape:
        return False
    if one.dtype.kind == "f":
        return bool(np.allclose(one, other, ROUNDING, 0, equal_nan=True))
    return bool(np.array_equal(one, other))


@dataclass(slots=True)
class _Replayed:
    """What is known to be made of the items under way, by what they are."""

    made: dict[int, Made] = field(default_factory=dict)
    pending: Made = field(default_factory=dict)


class Played:
    """Stands for a stage that spans were replayed through: it gives again what that made.

    Gates are decided anew, so that the time since the last decision is that of the whole.

    Parameters
    ----------
    stage
        The stage.
    replayed
        What was made of the item under way; filled by `joined`.
    """

    in_step = True

    def __init__(self, stage: StageRunner, replayed: _Replayed) -> None:
        self.name = stage.name
        self._stage = stage
        self._replayed = replayed
        self._carry: dict[str, GateState] = {}
        gates = stage.kind.gates
        plain = bool(gates) and all(isinstance(gate, Level) for gate in gates[:-1])
        #: The gate that alone remembers, and is the last: it remembers what was accepted last.
        self._waits = (
            gates[-1].name if plain and gates[-1].parameter == Refractory().parameter else ""
        )

    def process(self, item: Any) -> list[Event]:
        """Return what was made of an item."""
        return self._given(self._replayed.made.get(id(item), {}).get(self.name, ()), item)

    def process_all(self, items: Sequence[Any]) -> list[list[Event]]:
        """Return what was made of each of some items."""
        return [self.process(item) for item in items]

    def flush(self) -> list[Event]:
        """Return what was held back at the recording's end."""
        return self._given(self._replayed.pending.get(self.name, ()), None)

    def _given(self, born: Iterable[tuple[Event, Made]], item: Any) -> list[Event]:
        if isinstance(item, Gap) and item.reason == CLOCK_STEP and not item.bridged:
            self._carry.clear()
        events = []
        for event, made in born:
            given = self._decided(event) if isinstance(event, CandidateBlock) else event
            if made:
                self._replayed.made[id(given)] = made
            events.append(given)
        return events

    def _decided(self, block: CandidateBlock) -> CandidateBlock:
        carry = self._carry.setdefault(block.spec.topic, GateState())
        # a time that is told by what both sides of a join have decided alike is right
        if self._waits and (block.gate_value[:, -1] < CHECKED_S).all():
            passed = block.accepted
            channels, times = block.channel[passed].tolist(), block.time_ns[passed].tolist()
            last = carry.last_ns.setdefault(self._waits, {})
            last.update(zip(channels, times, strict=True))
            return block
        candidates = Candidates(block.time_ns, block.channel, block.value)
        kind, parameters, topic = self._stage.kind, self._stage.parameters, block.spec.topic
        decided, self._carry[topic] = decided_block(block.spec, candidates, kind, parameters, carry)
        if not np.array_equal(decided.accepted, block.accepted):
            raise JoinError(self.name)
        return decided


class Learning:
    """Stands for a stage that spans measured for: it learns from that, without the signal.

    Parameters
    ----------
    stage
        The stage.
    replayed
        What was made of the item under way; filled by `joined`.
    """

    in_step = True
    buffers = True

    def __init__(self, stage: StageRunner, replayed: _Replayed) -> None:
        self.name = stage.name
        self._replayed = replayed
        self._measures: deque[StepMeasure] = deque()
        self._stage = stage.with_measures(self._measures)

    def buffer(self, block: SignalBlock) -> None:
        """Take a block before any stage does: only when the signal began is kept."""
        self._stage.buffer(block)

    def process(self, item: Any) -> list[Event]:
        """Return what the stage makes of an item."""
        made: Iterable[Any] = self._replayed.made.get(id(item), {}).get(self.name, ())
        self._measures.extend(event for event, _ in made if isinstance(event, StepMeasure))
        return self._stage.process(item)

    def flush(self) -> list[Event]:
        """Return what the stage held back at the recording's end."""
        return self._stage.flush()


class JoinError(Exception):
    """A stage decided otherwise in a span than in one go; the text is its name."""


def joined(
    pipeline: Pipeline,
    streams: Sequence[Stream],
    spans: Iterator[SpanReplay],
    signal: Iterable[SignalBlock | Gap | Note] | None,
) -> tuple[Pipeline, Iterator[SignalBlock | Gap | Note]]:
    """Return a pipeline and its items that give what a replay in one go does.

    Parameters
    ----------
    pipeline
        That of the whole, which has seen nothing yet.
    streams
        Of the recording.
    spans
        In order; all of them are right.
    signal
        What a source of the whole gives, where samples are wanted; else None.
    """
    replayed = _Replayed()
    made, measured = in_spans(pipeline), measured_in_spans(pipeline)
    stages: list[Taking] = []
    for stage in pipeline.stages:
        if isinstance(stage, StageRunner) and stage.name in made:
            stages.append(Played(stage, replayed))
        elif isinstance(stage, StageRunner) and stage.name in measured:
            stages.append(Learning(stage, replayed))
        else:
            stages.append(stage)
    joined_pipeline = pipeline.with_stages(stages)
    return joined_pipeline, _items(replayed, {s.topic: s for s in streams}, spans, signal)


def _items(
    replayed: _Replayed,
    streams: Mapping[str, Stream],
    spans: Iterator[SpanReplay],
    signal: Iterable[SignalBlock | Gap | Note] | None,
) -> Iterator[SignalBlock | Gap | Note]:
    signal_items = iter(()) if signal is None else iter(signal)
    for span in spans:
        for unit, made in span.items:
            item: Any = unit
            if signal is not None:
                while isinstance(item := next(signal_items), Note):
                    yield item
                read_unit = Unit.of(item) if isinstance(item, SignalBlock) else item
                assert read_unit == unit  # both are read by the same rules
            elif isinstance(unit, Unit):
                item = unit.block(streams[unit.topic])
            replayed.made = {id(item): made}
            yield item
        if span.pending is not None:
            replayed.pending = span.pending
    yield from signal_items


def spans_of(recording: Recording, warm_s: float, count: int) -> list[Span]:
    """Cut a recording into so many spans, or fewer where it is short.

    Parameters
    ----------
    recording
        The recording.
    warm_s
        What is replayed before each span [s].
    count
        Of spans.
    """
    width_ns = Source(recording).width_ns
    first, stop = recording.file.start_ns // width_ns, recording.file.end_ns // width_ns + 1
    warm = -(-round(warm_s * NS_PER_S) // width_ns) + 1
    checked = -(-round(CHECKED_S * NS_PER_S) // width_ns)
    edges = sorted({first + round(i * (stop - first) / count) for i in range(1, count)})
    edges = [edge for edge in edges if first < edge < stop]
    begins, ends = [None, *edges], [*edges, None]
    return [
        Span(begin, end, None if begin is None or begin - warm <= first else begin - warm, checked)
        for begin, end in zip(begins, ends, strict=True)
    ]


def begun_earlier(span: Span, true: JoinState, first: int) -> Span:
    """Return a span with a warm-up four times as long, and the runs that there are.

    Parameters
    ----------
    span
        The span, whose begin was found to be wrong.
    true
        How it is there.
    first
        The first window of the recording.
    """
    assert span.first is not None  # the first span begins with the recording
    assert span.warm is not None  # else it is right
    warm = span.first - 4 * (span.first - span.warm)
    runs = {topic: state[:2] for topic, state in true.runs.items() if state is not None}
    return replace(span, warm=None if warm <= first else warm, runs=runs)
