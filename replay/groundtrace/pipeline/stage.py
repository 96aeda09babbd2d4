"""Stages: what a pipeline is made of, and the runner of detectors, associators and arrays.

Signal blocks and events flow from stage to stage. A stage measures; its gates decide; it receives
the verdicts. Everything else that stages have in common is the runner's.

Where the unit of lengths is unknown, those that stages have in metres are scaled to the site's
size. Nothing shows how many metres an unknown unit has. The simplest sound rule: lengths that were
chosen for a room of common size keep their proportion to the room, by the sensors' spread.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from itertools import islice
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, TypeVar

import numpy as np

from groundtrace_codecs.events import (
    EVENTS,
    TRIGGER,
    CandidateBlock,
    Event,
    Fix,
    Gap,
    Label,
    Note,
    Pick,
    Presence,
    Quantity,
    StageSpec,
    TraceBlock,
    kind_emitted,
)
from groundtrace_codecs.geometry import UNKNOWN_UNIT, Geometry
from groundtrace_codecs.signals import NS_PER_S, QUANTITIES, UNKNOWN_UNITS, SignalBlock, Stream

from .buffers import SignalBuffer, StreamSynchronizer
from .gates import Candidates, Gate, GateState, decided_block, gate_specs, never_passed
from .parameters import describe, given_waypoints
from .source import NonFiniteHold

if TYPE_CHECKING:
    from collections import deque
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from .parameters import StageConfig

    #: What a stage is given, and what it yields.
    Item = SignalBlock | Event
    P = TypeVar("P")

#: Events in columns: their StageSpec names stage and topic.
_COLUMNS = frozenset({CandidateBlock, TraceBlock})
#: Why a clock's times before and after a gap have nothing to do with each other.
CLOCK_STEP = "clock step"
#: Signal is kept so long until its stage can start; what is given first in a round, so long, and
#: the very first of it [ns]. Chosen by judgement: they bound memory.
_EARLY_NS, _EARLY_FIRST_NS = 2 * NS_PER_S, 60 * NS_PER_S


class CannotStart(Exception):  # noqa: N818 - it is no error: nothing is wrong
    """A stream or site lacks what a stage needs; the text says what was expected, or nothing."""


@dataclass(frozen=True, slots=True)
class Memory:
    """How much of a recording the results of a time depend on.

    Attributes
    ----------
    warm_up_s
        They do not depend on where a replay began, where that was at least so long before [s];
        None: on all that came before.
    delay_s
        Nor on where it ended, where that was at least so long after [s]; None: on all that came
        after. Left out are smoothed tracks, in which all that was replayed of a track counts, and
        the first steps of a track that later ones made one. What lasts and is on then, as a vehicle
        that is heard or a field that is disturbed, ends where the replay ends.
    """

    warm_up_s: float | None = None
    delay_s: float | None = None

    def behind(self, sources: Sequence[Memory]) -> Memory:
        """Return that of a stage in terms of the signal, given those of the stages it takes from.

        Both times add up along a chain of stages; of several, the longest one counts.
        """
        return Memory(
            _added(self.warm_up_s, _longest([s.warm_up_s for s in sources])),
            _added(self.delay_s, _longest([s.delay_s for s in sources])),
        )

    @classmethod
    def longest(cls, memories: Sequence[Memory]) -> Memory:
        """Return what is enough for all; of none, none."""
        return cls(
            _longest([m.warm_up_s for m in memories]), _longest([m.delay_s for m in memories])
        )


def _longest(times_s: Sequence[float | None]) -> float | None:
    defined_s = [time_s for time_s in times_s if time_s is not None]
    return max(defined_s, default=0.0) if len(defined_s) == len(times_s) else None


def _added(one_s: float | None, other_s: float | None) -> float | None:
    return None if one_s is None or other_s is None else one_s + other_s


@dataclass(frozen=True, slots=True, eq=False)
class StepMeasure:
    """What a stage measured around a step, before anything that it learns bears on it.

    Among what a span made it takes the place of an event; no other stage and no sink is given it.

    Attributes
    ----------
    time_ns
        Of the step.
    topic, stage
        Of the stage.
    value
        As the stage has it.
    """

    time_ns: int
    topic: str
    stage: str
    value: Any


#: A decision that asks for the time since the last one, and a group that begins where the last one
#: ended, depend on the one before. So they do on that, while they follow each other without a rest:
#: as many as this are followed back. Chosen by judgement: chains that begin apart soon meet.
CHAINED = 20


@dataclass(frozen=True, slots=True)
class Input:
    """One thing that a stage takes: signal, the gaps of it, labels, or events of earlier stages.

    Attributes
    ----------
    kind
        ``SignalBlock``, ``CandidateBlock``, ``TraceBlock``, ``Gap``, ``Label`` or a type of event.
    quantities
        Of a SignalBlock: the channels wanted, all where empty; blocks come narrowed to those of all
        inputs.
    of
        Of a CandidateBlock or TraceBlock: the event that its stage gives.
    every
        From all earlier stages that give it, two or more; else from one.
    first
        From the first of the earlier stages that give it; else from the last.
    anywhere
        Of all topics; else of the topic or placement of the instance.
    buffered
        Of a SignalBlock: kept in ``Context.signal`` to look back at, not given to ``process``.
    hold
        Of a SignalBlock: samples that are not finite become the channel's last finite value.
    required
        Without it the pipeline is refused, and an instance waits.
    """

    kind: type[Any]
    quantities: frozenset[str] = frozenset()
    of: type[Any] | None = None
    every: bool = False
    first: bool = False
    anywhere: bool = False
    buffered: bool = False
    hold: bool = True
    required: bool = True


@dataclass(slots=True)
class Numbers:
    """Counts from 1 on."""

    last: int = 0

    def next(self) -> int:
        """Return the next number."""
        self.last += 1
        return self.last


@dataclass(frozen=True, slots=True)
class Context:
    """What an instance of a stage may know when it starts; never the truth.

    Attributes
    ----------
    stage, plugin
        Its name in the pipeline, and the one it is registered under.
    topic
        What its results are filed under.
    stream
        Of the signal that starts it, narrowed; without channels where it takes none.
    sources
        The stages that it takes from, in order; None where nothing is stated of one yet.
    geometry
        Where sensors are; empty where unknown.
    labels
        Waypoints and triggers that it asks for, where ``takes`` has ``Input(Label)``.
    signal
        Of the inputs marked ``buffered``.
    tracks
        Gives numbers to tracks: none comes twice in a stage, whatever instance asks.
    beforehand
        Whether the stage is to yield what it measures, as :class:`StepMeasure`, and nothing else.
    given
        What it measured so, in order, where the signal is not there; else None.
    """

    stage: str
    plugin: str
    topic: str
    stream: Stream
    sources: Mapping[str, StageSpec | None] = field(default_factory=dict)
    geometry: Geometry = field(default_factory=Geometry)
    labels: tuple[Label, ...] = ()
    signal: SignalBuffer | None = None
    tracks: Numbers = field(default_factory=Numbers)
    beforehand: bool = False
    given: deque[StepMeasure] | None = None

    @property
    def source(self) -> StageSpec:
        """What is stated of the first stage that it takes from."""
        spec = next((spec for spec in self.sources.values() if spec is not None), None)
        if spec is None:
            raise CannotStart(f"expected a stage before {self.stage}, found none")
        return spec


#: A gap of up to so long is taken filled, unless a stage says otherwise [s]. Chosen by trial on
#: simulated vehicles, where 0.3 s cost nothing and of 0.5 s the ends are taken for passes, and on
#: ten walks of back-steps (bench: lost_packets.py): less than a step.
BRIDGED_S = 0.3


class Stage(Protocol):
    """A step of a pipeline: it measures, its gates decide, and it is told what was decided.

    It does no I/O and no drawing, reads no clock, and keeps all that crosses items on itself: a
    ``copy.deepcopy`` of an instance goes on exactly as the original does.

    Notes
    -----
    Its class attributes:

    - ``Parameters``: a frozen dataclass of documented fields with units, see
      :mod:`.parameters`;
    - ``takes``: its inputs. The first makes instances: of signal for each stream, of events for
      each topic;
    - ``gives``: types of its events; an accepted candidate becomes the first;
    - ``columns``: name and unit of what is measured of a candidate, first the peak of the decision
      function;
    - ``gates``: in the order of the decision; none where it decides nothing;
    - ``trace``: as ``columns``, of a frame of 50 ms, first the decision function; without it "why
      was there no candidate" cannot be answered;
    - ``scope``: what one instance is for: a topic, the streams of one placement, the recording;
    - ``ends_at``: what ends a run, which is ``flush``, then ``start`` before the next item;
      ``gap`` is any that is not bridged. Gates begin anew at a clock step alone;
    - ``bridges_s``: the longest gap that is to be filled by straight lines instead of ending a run
      [s]. Of all stages of a pipeline that take signal the shortest counts;
    - ``rounds``: quantities of the streams of one window: those named before the last are given
      first, the last one after all others: what stands beside it is then known. Empty: streams come
      as they do;
    - ``feedback``: what is decided changes what is measured later;
    - ``site_lengths``: its columns and gates in m are in the length unit of the site;
    - ``compiles``: files of :mod:`groundtrace.kernels` that it runs: two processes
      compile them in the first replay of an installation.

    One that decides in one of several ways, by what ``start`` is told, has the ``gates`` of all of
    them, and there gives itself the ``columns``, ``gates`` and ``trace`` of the way it takes.

    It may have a method ``curve`` without arguments that returns, as a
    :class:`Curve`, its decision function over the samples that the last
    ``process`` completed; viewers draw it around steps. One that brings signals of unknown units to
    gravity says so by ``mean_is_gravity = True``. It may have a method ``reach``, called after
    ``start``, that returns by the names of gates the most that their values can be, each a
    :class:`.gates.Reach`: a threshold above it is told.

    It may have a class method ``unfiltered`` that takes parameters and returns the class and the
    parameters of what measures the same without its filter, or with its band as wide as can be: by
    measuring again with it, ``why`` tells whether the filter took a step out. Where what it looks
    for is no local maximum of its decision function, ``sought`` says what it is; where the least
    that makes a candidate is no parameter ``floor``, ``floors`` has it by the function's name.
    Columns named in ``of_usual`` say what there is of a usual event in a candidate, 1 of that one.
    Where a gate's value is told by a stretch of the signal, ``told_by_s`` has its least length by
    the name of the gate [s]: between gaps less may be heard.

    It may have a method ``filled`` that is told of each gap of its topic that was filled, before
    the block that fills it. One whose scope is ``placement`` may have a method ``resume``, called
    after ``start`` with the stage of the run that a gap ended: the sensor is the same one.

    One that says its ``memory`` can begin in the middle of a recording. The index of the first
    sample that it is given of a run, ``block.first``, is then not 0, and what it counts from the
    run's begin on, as frames, it counts by that.
    """

    Parameters: type[Any]
    takes: ClassVar[tuple[Input, ...]]
    gives: ClassVar[tuple[type[Any], ...]]
    columns: tuple[Quantity, ...] = ()
    gates: tuple[Gate, ...] = ()
    trace: tuple[Quantity, ...] = ()
    scope: ClassVar[Literal["topic", "placement", "recording"]] = "topic"
    ends_at: ClassVar[Literal["gap", "clock step"]] = "gap"
    bridges_s: ClassVar[float] = BRIDGED_S
    rounds: ClassVar[tuple[str, ...]] = ()
    feedback: ClassVar[bool] = False
    site_lengths: ClassVar[bool] = False
    compiles: ClassVar[tuple[str, ...]] = ()

    def __init__(self, parameters: Any) -> None: ...

    @property
    def memory(self) -> Memory:
        """How much of what it takes its results of a time depend on; all, where it says nothing."""
        return Memory()

    @property
    def measured(self) -> Memory | None:
        """How much what it measures of a step depends on; None where it yields no measures."""
        return None

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; return the channels that candidates are numbered by.

        Raises
        ------
        CannotStart
            Saying what was expected, for people; with an empty text nobody is told.
        """
        ...

    def process(self, item: Any) -> Iterable[Output]:
        """Take one item; yield candidates, frames and events as they become complete.

        Blocks may be of any length. A candidate's time may be before the run's first sample, where
        a filter's delay is taken off: it is set to that sample's before anything is decided.
        """
        ...

    def flush(self) -> Iterable[Output]:
        """End the run; yield what was held back. Counters, as of tracks, go on."""
        return ()

    def decided(self, block: CandidateBlock) -> Iterable[Event]:
        """Take verdicts on the candidates just yielded; yield what the accepted ones stand for.

        It is called before anything more is asked of the generator that yielded them.
        """
        return accepted_events(block)


def takes_signal_alone(kind: type[Stage]) -> bool:
    """Return whether a stage needs nothing of what other stages do; labels are known beforehand."""
    return all(
        need.kind is Label or (need.kind is SignalBlock and not need.buffered)
        for need in kind.takes
    )


def detects(kind: type[Stage]) -> bool:
    """Return whether a stage finds candidates in the signal of each stream by itself."""
    return takes_signal_alone(kind) and not (kind.rounds or kind.feedback)


def associates(kind: type[Stage]) -> bool:
    """Return whether a stage takes picks alone."""
    return all(need.kind is Pick for need in kind.takes)


def wanted_quantities(kind: type[Stage]) -> frozenset[str]:
    """Return the quantities of the channels that a stage wants."""
    return frozenset().union(*(need.quantities for need in kind.takes if need.kind is SignalBlock))


def emitted(kind: type[Stage]) -> str:
    """Return what results call the events that a stage's accepted candidates become."""
    return EVENTS[kind.gives[0]].name


def allows(patterns: Sequence[str], topic: str) -> bool:
    """Return whether a topic fits one of some patterns; every topic does where there are none."""
    return not patterns or any(fnmatch(topic, pattern) for pattern in patterns)


def accepted_events(block: CandidateBlock) -> list[Event]:
    """Return the events that the accepted candidates of a block stand for, as the table has it."""
    kind = kind_emitted(block.spec.emits)
    return [] if kind is None else list(kind.from_candidates(block))


@dataclass(slots=True)
class _Instance:
    """A stage at work; ``start_ns`` is the first sample of its run, ``open`` whether one is on."""

    stage: Stage
    spec: StageSpec
    context: Context
    carry: GateState = field(default_factory=GateState)
    holder: NonFiniteHold = field(default_factory=NonFiniteHold)
    open: bool = True
    start_ns: int | None = None


@dataclass(slots=True)
class _Refused:
    """Why there is no instance; the text is said once, then it is empty."""

    text: str


@dataclass(slots=True)
class _State:
    """All that crosses items, by the topic or placement of instances, or ``""``.

    Attributes
    ----------
    instances
        At work, or refused.
    columns
        The wanted columns of each topic that was heard of; none where it is left alone.
    stated
        What stages that are taken from state, by their name and topic.
    early
        Items that wait for their instance to start.
    buffers
        By topic, for what is looked back at.
    fresh
        Topics on which a stage began without knowing when: thresholds are looked at with the block.
    ended
        Stages that a gap ended, by what they are for; the next one may know what they know.
    """

    instances: dict[str, _Instance | _Refused] = field(default_factory=dict)
    columns: dict[str, list[int]] = field(default_factory=dict)
    stated: dict[tuple[str, str], StageSpec] = field(default_factory=dict)
    early: dict[str, list[Any]] = field(default_factory=dict)
    buffers: dict[str, tuple[list[int], SignalBuffer] | None] = field(default_factory=dict)
    fresh: set[str] = field(default_factory=set)
    ended: dict[str, Stage] = field(default_factory=dict)
    rounds: StreamSynchronizer | None = None
    tracks: Numbers = field(default_factory=Numbers)


class StageRunner:
    """Runs one stage of a pipeline: all that is the same for every stage, once.

    It makes instances by ``scope`` and starts each when its required inputs are known (a stream by
    a block, a source by its StageSpec); keeps what comes before; fills in samples that are not
    finite; brings streams into rounds; states the StageSpec; decides what is yielded, by
    :func:`~.gates.decide`, before it asks for more; ends runs; says once why one cannot
    start.

    Parameters
    ----------
    config
        The stage in its pipeline.
    kind
        Its class.
    parameters
        Its parameters.
    sources
        Whom each input is taken from, see :func:`.config.wire`; from any stage where
        nothing is said.
    geometry
        Where the sensors are; None where unknown. Where its unit of length is not known, parameters
        in metres of a stage that takes fixes are brought to it.
    labels
        Of the recording; only waypoints and triggers go on to a stage that takes labels, and only
        those that its parameters ``updates`` and ``trigger`` ask for.
    placements
        By topic, where a sensor is worn that its stream does not say.
    window_s
        How long after a step's first pick others still belong to it [s], for buffered signal.

    Notes
    -----
    A bridged gap ends nothing. Where a run ends, what was held back comes out, and the next one
    begins with the stage started again. The refractory time goes on, unless the clock was set back:
    times before and after then have nothing to do with each other. No candidate is earlier than the
    first sample of its run.
    """

    def __init__(
        self,
        config: StageConfig,
        kind: type[Stage],
        parameters: Any,
        sources: Mapping[Input, tuple[str, ...]] | None = None,
        geometry: Geometry | None = None,
        labels: Sequence[Label] = (),
        *,
        placements: Mapping[str, str] | None = None,
        window_s: float = 0.0,
    ) -> None:
        self.name, self.plugin, self.topics = config.key, config.use, config.topics
        self.config, self.kind = config, kind
        fixes = any(need.kind is Fix for need in kind.takes)
        self.parameters = scaled_lengths(parameters, geometry) if fixes else parameters
        self.geometry = geometry or Geometry()
        self.window_s = window_s
        self._sources = dict(sources or {})
        self._placements = placements or {} if detects(kind) else {}
        takes = kind.takes
        asked = any(need.kind is Label for need in takes)
        self._labels = _given(labels, parameters) if asked else ()
        self._signal = tuple(n for n in takes if n.kind is SignalBlock and not n.buffered)
        self._anywhere = tuple(n for n in self._signal if n.anywhere)
        self._buffered = tuple(n for n in takes if n.buffered)
        self._quantities = wanted_quantities(kind)
        self._all = any(not need.quantities for need in (*self._signal, *self._buffered))
        self._gaps = any(need.kind is Gap for need in takes)
        self._events = tuple(n for n in takes if n.kind not in (SignalBlock, Gap, Label))
        #: By type of event, the stages that it is taken from; None is any.
        self._from: dict[type[Any], tuple[str, ...] | None] = {}
        for need in self._events:
            names, others = self._sources.get(need), self._from.get(need.kind, ())
            any_stage = names is None or others is None
            self._from[need.kind] = None if any_stage else (*(others or ()), *(names or ()))
        self._holds = all(need.hold for need in self._signal)
        self._at_once = kind.decided is Stage.decided and not (self._signal or self._buffered)
        self._beforehand = False
        self._given: deque[StepMeasure] | None = None
        self._state = self._fresh_state()

    @property
    def runs_ahead(self) -> bool:
        """Whether it takes signal alone, unbuffered: only then may another core run it ahead."""
        return takes_signal_alone(self.kind)

    @property
    def memory(self) -> Memory:
        """What the stage says of how much of its inputs its results depend on."""
        return self.kind(self.parameters).memory

    @property
    def measured(self) -> Memory | None:
        """What the stage says of how much of its inputs its measures depend on."""
        return self.kind(self.parameters).measured

    def beforehand(self) -> StageRunner:
        """Return the same, of which nothing was seen yet, that yields what it measures alone."""
        measuring = copy.copy(self)
        measuring._beforehand, measuring._state = True, self._fresh_state()
        return measuring

    def with_measures(self, given: deque[StepMeasure]) -> StageRunner:
        """Return the same, of which nothing was seen yet, that takes measures instead of signal."""
        learning = copy.copy(self)
        learning._given, learning._state = given, self._fresh_state()
        return learning

    @property
    def buffers(self) -> bool:
        """Whether it looks back at signal: :meth:`buffer` is then called with every block."""
        return bool(self._buffered)

    def allowed(self, topic: str) -> bool:
        """Return whether the stage may run on a topic."""
        return allows(self.topics, topic)

    def buffer(self, block: SignalBlock) -> None:
        """Keep a block to look back at; called before any stage of the pipeline sees it."""
        topic, buffers = block.topic, self._state.buffers
        if topic not in buffers:
            columns = self._columns(block.stream)
            buffers[topic] = (columns, self._recall(block.stream, columns)) if columns else None
        entry = buffers[topic]
        if entry is not None:
            columns, recall = entry
            if self._given is None:
                recall.update(block.select(columns))
            else:
                recall.pass_over(block)

    def process(self, item: Item) -> list[Event]:
        """Take an item; return what it brings about."""
        return self.process_all([item])[0]

    def process_all(self, items: Sequence[Item]) -> list[list[Event]]:
        """Take items in order; return what each brings about.

        Where ``decided`` is the default and no signal is taken, candidates of many items are
        decided at once.
        """
        made: list[list[Event]] = [[] for _ in items]
        waiting: dict[str, list[tuple[list[Event], Candidates]]] = {}
        wanted = self._from
        for item, out in zip(items, made, strict=True):
            kind = type(item)
            if kind in wanted:  # most of what comes are events, and most of these of other stages
                names = wanted[kind]
                if names is None or _stage_of(item) in names:
                    self._take_event(item, out, waiting)
            elif isinstance(item, SignalBlock):
                self._take_signal(item, out)
            elif isinstance(item, Gap):
                self._decide_waiting(waiting)
                self._take_gap(item, out)
            elif isinstance(item, StageSpec):
                self._decide_waiting(waiting)
                self._take_spec(item, out)
        self._decide_waiting(waiting)
        return made

    def flush(self) -> list[Event]:
        """End all runs; return what was held back."""
        out: list[Event] = []
        if self._state.rounds is not None:
            self._take_round(self._state.rounds.flush(), out)
        for instance in self._state.instances.values():
            if isinstance(instance, _Instance):
                self._end(instance, out)
        return out

    def curve(self, topic: str) -> Curve | None:
        """Return the decision function of what the last block of a topic completed.

        None where the stage does not run on the topic, or gives frames alone.
        """
        instance = self._state.instances.get(topic)
        tell = getattr(instance.stage, "curve", None) if isinstance(instance, _Instance) else None
        curve: Curve | None = tell() if tell is not None else None
        return curve

    def rerun(self, given: Iterable[Item]) -> list[Event]:
        """Return what fresh instances make of stored items, signal excepted: for why and sweep.

        Where ``decided`` is the default, all candidates of a topic are decided at once: one block
        each, then their events; notes are left out.
        """
        again = copy.copy(self)
        again._state = self._fresh_state()
        if not self._at_once:
            made = again.process_all(list(given))
            return [event for events in made for event in events] + again.flush()
        out: list[Event] = []
        candidates: dict[str, list[Candidates]] = {}
        for item in given:
            if isinstance(item, StageSpec):
                again._take_spec(item, out)
            elif type(item) in self._from and self._comes_from(item):
                key = self._key_of(topic_of(item), "")
                instance = again._state.instances.get(key)
                if isinstance(instance, _Instance):
                    parts = candidates.setdefault(key, [])
                    parts += [x for x in instance.stage.process(item) if isinstance(x, Candidates)]
        blocks = []
        for key, instance in again._state.instances.items():
            if isinstance(instance, _Instance):
                flushed = [x for x in instance.stage.flush() if isinstance(x, Candidates)]
                parts = [
                    Candidates.empty(len(instance.spec.columns)),
                    *candidates.get(key, []),
                    *flushed,
                ]
                all_candidates = Candidates.concatenate(parts)
                blocks.append(
                    decided_block(instance.spec, all_candidates, self.kind, self.parameters)[0]
                )
        return [*out, *blocks, *(event for block in blocks for event in accepted_events(block))]

    def _fresh_state(self) -> _State:
        rounds = self.kind.rounds
        return _State(rounds=StreamSynchronizer(rounds) if rounds else None)

    def _columns(self, stream: Stream) -> list[int]:
        """Return the columns of a stream that are wanted; none where the stage may not run."""
        if not (self.allowed(stream.topic) or self._anywhere):
            return []
        wanted = self._quantities
        return list(range(len(stream.channels))) if self._all else stream.columns_of(wanted)

    def _recall(self, stream: Stream, columns: Sequence[int]) -> SignalBuffer:
        """Return what keeps the signal of a stream that a buffered input is of."""
        p = self.parameters
        before, after, together = (
            round(s * NS_PER_S) for s in (p.before_s, p.after_s, self.window_s)
        )
        stream = stream.select(columns)
        ahead_s = self.geometry.clock_offsets(c.name for c in stream.channels)
        return SignalBuffer(stream, before, after, together, ahead_s)

    # What comes: signal, gaps, what stages state, and their events.

    def _take_signal(self, block: SignalBlock, out: list[Event]) -> None:
        if block.topic in self._state.fresh:
            self._state.fresh.remove(block.topic)
            instance = self._state.instances[self._key_of(block.topic, "")]
            assert isinstance(instance, _Instance)  # it began
            out += _never_passed(instance, block.start_ns)
        if not (self._signal and len(block)):
            return
        columns = self._state.columns.get(block.topic)
        if columns is None:
            columns = self._columns(block.stream)
            self._state.columns[block.topic] = columns
            if not columns:
                self._state.early.pop(block.topic, None)
        if not columns:
            return
        block = block.select(columns)
        if self._state.rounds is not None:
            self._take_round(self._state.rounds.add(block), out)
        else:
            self._receive(block, out)

    def _take_round(self, items: Sequence[SignalBlock | Gap], out: list[Event]) -> None:
        """Take what streams that are brought together have of one window."""
        for item in items:
            if isinstance(item, Gap):
                self._end_at(item, out)
            else:
                self._receive(item, out)
        for key, waiting in self._state.early.items():
            self._state.early[key] = _recent(waiting, self.kind.rounds[:-1])

    def _receive(self, block: SignalBlock, out: list[Event]) -> None:
        """Give a narrowed block to its instance, or to all where it is taken from anywhere."""
        if self._anywhere:
            self._receive_anywhere(block, out)
            return
        key = self._key_of(block.topic, block.stream.placement)
        instance = self._state.instances.get(key)
        if instance is None:
            instance = self._begin_with(key, block, out)
        if isinstance(instance, _Instance):
            self._feed(instance, block, out)

    def _receive_anywhere(self, block: SignalBlock, out: list[Event]) -> None:
        """Give a block to all instances; one of its own topic may begin with it."""
        topic, instances = block.topic, self._state.instances
        if topic not in instances and self.allowed(topic) and self._sources_known(topic):
            self._begin(topic, topic, block.stream, block.start_ns, out)
        for instance in instances.values():
            if isinstance(instance, _Instance):
                self._feed(instance, block, out)
        self._state.early.setdefault("", []).append(block)

    def _take_gap(self, gap: Gap, out: list[Event]) -> None:
        if self._state.rounds is not None:
            self._take_round(self._state.rounds.add(gap), out)
        else:
            self._end_at(gap, out)

    def _end_at(self, gap: Gap, out: list[Event]) -> None:
        """End the runs that a gap ends, or give it to those who take gaps."""
        if self._gaps:
            for instance in self._state.instances.values():
                if isinstance(instance, _Instance):
                    self._feed(instance, gap, out)
            return
        stepped = gap.reason == CLOCK_STEP
        if gap.filled:
            self._tell_filled(gap)
        if gap.bridged or (self.kind.ends_at == CLOCK_STEP and not stepped):
            return
        anywhere = any(need.anywhere for need in self.kind.takes)
        for key, instance in list(self._state.instances.items()):
            if isinstance(instance, _Refused) or not (anywhere or instance.spec.topic == gap.topic):
                continue
            self._end(instance, out)
            if stepped:
                instance.carry = GateState()
            if self.kind.scope == "placement":  # its streams are to be found again
                del self._state.instances[key]
                if not stepped:
                    self._state.ended[key] = instance.stage

    def _tell_filled(self, gap: Gap) -> None:
        """Tell those that want to know which samples of their topic were filled."""
        for instance in self._state.instances.values():
            if isinstance(instance, _Instance) and instance.spec.topic == gap.topic:
                tell = getattr(instance.stage, "filled", None)
                if tell is not None:
                    tell(gap)

    def _take_spec(self, spec: StageSpec, out: list[Event]) -> None:
        """Take what a stage states before it gives anything: instances may start."""
        if not any(self._is_from(need, spec.stage) for need in self._events):
            return
        self._state.stated[spec.stage, spec.topic] = spec
        if self._signal or not self.allowed(spec.topic):
            return
        key = self._key_of(spec.topic, "")
        if key not in self._state.instances:
            self._begin(key, spec.topic, Stream("", (), 0.0), None, out)

    def _take_event(
        self, item: Any, out: list[Event], waiting: dict[str, list[tuple[list[Event], Candidates]]]
    ) -> None:
        topic = topic_of(item)
        key = self._key_of(topic, "")
        instance = self._state.instances.get(key)
        if instance is None:
            if self._signal and self._is_stated(item, topic):
                self._state.early.setdefault(key, []).append(item)
        elif isinstance(instance, _Refused):
            if type(item) is self.kind.takes[-1].kind and self.allowed(topic):
                self._say_refused(instance, topic, _time_of(item), out)
        elif self.kind.scope == "topic" or self._reaches(instance, item, topic):
            if self._at_once:
                self._gather(key, instance, item, out, waiting)
            else:
                self._feed(instance, item, out)

    def _reaches(self, instance: _Instance, item: Any, topic: str) -> bool:
        """Return whether an event of a topic is for the instance of a whole recording."""
        anywhere = any(need.anywhere for need in self._events if need.kind is type(item))
        return anywhere or not topic or topic == instance.spec.topic

    def _comes_from(self, item: Any) -> bool:
        """Return whether an event is of a stage that is taken from."""
        names = self._from[type(item)]
        return names is None or _stage_of(item) in names

    def _is_stated(self, item: Any, topic: str) -> bool:
        """Return whether the stage of an event has stated that it runs on a topic."""
        return (_stage_of(item), topic) in self._state.stated and self.allowed(topic)

    def _is_from(self, need: Input, stage: str) -> bool:
        """Return whether an input is taken from a stage."""
        names = self._sources.get(need)
        return names is None or stage in names

    def _key_of(self, topic: str, placement: str) -> str:
        """Return the key of the instance that what comes on a topic is for."""
        scope = self.kind.scope
        return topic if scope == "topic" else placement if scope == "placement" else ""

    # Instances: begun, fed, decided, ended.

    def _begin_with(
        self, key: str, block: SignalBlock, out: list[Event]
    ) -> _Instance | _Refused | None:
        """Begin with a block where all is known that is required; else keep it."""
        first = self._signal[0]
        makes = bool(block.stream.columns_of(first.quantities)) if self.kind.rounds else True
        if makes and self._sources_known(block.topic):
            return self._begin(key, block.topic, block.stream, block.start_ns, out)
        if self.kind.rounds:
            self._state.early.setdefault(key, []).append(block)
        return None

    def _begin(
        self, key: str, topic: str, stream: Stream, time_ns: int | None, out: list[Event]
    ) -> _Instance | _Refused | None:
        """Begin an instance where all is known that is required, by a stream or a stage's word."""
        entry = self._state.buffers.get(topic)
        if not self._sources_known(topic) or (self._buffered and entry is None):
            return None
        recall = None if entry is None else entry[1]
        stream = self._worn(stream) if recall is None else recall.stream
        context = Context(
            self.name,
            self.plugin,
            topic,
            stream,
            self._stated_by(topic),
            self.geometry,
            self._labels,
            recall,
            self._state.tracks,
            self._beforehand,
            self._given,
        )
        stage = self.kind(self.parameters)
        early = [*self._state.early.pop(key, []), *self._state.early.get("", [])]
        try:
            names = stage.start(context)
        except CannotStart as refusal:
            if self.kind.scope == "placement":  # another of its streams may do
                self._state.early[key] = early
                return None
            refused = _Refused(str(refusal))
            if time_ns is not None:
                self._say_refused(refused, topic, time_ns, out)
            self._state.instances[key] = refused
            return refused
        before, resume = self._state.ended.pop(key, None), getattr(stage, "resume", None)
        if before is not None and resume is not None:
            resume(before)
        instance = _Instance(stage, self._spec(stage, topic, names), context)
        self._state.instances[key] = instance
        out.append(instance.spec)
        if time_ns is None:
            if hasattr(stage, "reach"):
                self._state.fresh.add(topic)
        elif detects(self.kind):
            out += self._unknown_units(instance, time_ns)
            out += _never_passed(instance, time_ns)
            out += self._not_asked(instance, time_ns)
        for item in early:
            self._feed(instance, item, out)
        return instance

    def _spec(self, stage: Stage, topic: str, names: tuple[str, ...]) -> StageSpec:
        spec = StageSpec(
            stage=self.name,
            plugin=self.plugin,
            topic=topic,
            channels=names,
            columns=stage.columns,
            gates=gate_specs(stage.gates, self.parameters),
            trace=stage.trace,
            emits=emitted(self.kind),
        )
        return in_length_unit(spec, self.geometry) if stage.site_lengths else spec

    def _sources_known(self, topic: str) -> bool:
        """Return whether every stage that is required has stated something, of ``every`` one."""
        for need in self._events:
            if need.required and not any(
                self._is_from(need, stage) and (self.kind.scope == "recording" or on == topic)
                for stage, on in self._state.stated
            ):
                return False
        return True

    def _stated_by(self, topic: str) -> dict[str, StageSpec | None]:
        """Return what is stated of the stages that are taken from, by name, in order."""
        stated = self._state.stated
        specs: dict[str, StageSpec | None] = {}
        for need in self._events:
            given = self._sources.get(need)
            for name in [stage for stage, _ in stated] if given is None else given:
                stage_specs = [spec for (stage, _), spec in stated.items() if stage == name]
                specs[name] = stated.get((name, topic), stage_specs[0] if stage_specs else None)
        return specs

    def _worn(self, stream: Stream) -> Stream:
        """Return a stream with the placement that it states, or else the one that is known."""
        placement = stream.placement or self._placements.get(stream.topic, "")
        return stream if placement == stream.placement else replace(stream, placement=placement)

    def _feed(self, instance: _Instance, item: Item, out: list[Event]) -> None:
        """Give an item to an instance, in a new run where the last one has ended."""
        if not instance.open:
            if isinstance(item, SignalBlock):
                stream = self._worn(item.stream)
                instance.context = replace(instance.context, stream=stream)
            instance.stage.start(instance.context)
            instance.open, instance.start_ns = True, None
        if isinstance(item, SignalBlock):
            if instance.start_ns is None and not self.kind.rounds:
                instance.start_ns = item.start_ns
            item = instance.holder.fill(item) if self._holds else item
        self._make(instance, instance.stage.process(item), out)

    def _make(self, instance: _Instance, outputs: Iterable[Output], out: list[Event]) -> None:
        """Send out what an instance yields, candidates decided before more is asked for."""
        for output in outputs:
            if isinstance(output, Candidates):
                if len(output):
                    self._decide(instance, output, out)
            elif isinstance(output, Frames):
                if len(output.time_ns):
                    out.append(TraceBlock(instance.spec, output.time_ns, output.value))
            else:
                out.append(output)

    def _decide(self, instance: _Instance, candidates: Candidates, out: list[Event]) -> None:
        stage, recall = instance.stage, instance.context.signal
        start_ns = instance.start_ns if recall is None else recall.first_ns or 0
        if start_ns is not None:
            candidates = candidates.not_before(start_ns)
        block, instance.carry = decided_block(
            instance.spec, candidates, stage, self.parameters, instance.carry
        )
        out.append(block)
        out += stage.decided(block)

    def _gather(
        self,
        key: str,
        instance: _Instance,
        item: Item,
        out: list[Event],
        waiting: dict[str, list[tuple[list[Event], Candidates]]],
    ) -> None:
        """Give an item to an instance; its candidates wait to be decided with others."""
        if not instance.open:
            instance.stage.start(instance.context)
            instance.open = True
        for output in instance.stage.process(item):
            if not isinstance(output, Candidates):
                self._decide_waiting(waiting)
                self._make(instance, (output,), out)
            elif len(output):
                waiting.setdefault(key, []).append((out, output))

    def _decide_waiting(self, waiting: dict[str, list[tuple[list[Event], Candidates]]]) -> None:
        """Decide the candidates that wait, instance by instance, for the items that made them."""
        for key, groups in waiting.items():
            instance = self._state.instances[key]
            assert isinstance(instance, _Instance)  # it made them
            candidates = Candidates.concatenate([group for _, group in groups])
            block, instance.carry = decided_block(
                instance.spec, candidates, instance.stage, self.parameters, instance.carry
            )
            events, start = iter(accepted_events(block)), 0
            for out, group in groups:
                part = _rows_of(block, slice(start, start + len(group)))
                out += [part, *islice(events, int(np.count_nonzero(part.accepted)))]
                start += len(group)
        waiting.clear()

    def _end(self, instance: _Instance, out: list[Event]) -> None:
        """End a run: what was held back comes out."""
        if not instance.open:
            return
        instance.open = False
        self._make(instance, instance.stage.flush(), out)
        if (replaced := instance.holder.count) > 0:
            text = f"{instance.spec.topic}: {replaced} samples not finite, last value held"
            out.append(Note(instance.holder.last_ns, text, "WARN", self.name))
        instance.holder = NonFiniteHold()
        if instance.context.signal is not None:
            instance.context.signal.discard()

    # What a person should know.

    def _say_refused(self, refused: _Refused, topic: str, time_ns: int, out: list[Event]) -> None:
        if refused.text:
            out.append(Note(time_ns, f"{topic}: {refused.text}", "WARN", self.name))
            refused.text = ""

    def _not_asked(self, instance: _Instance, time_ns: int) -> Iterator[Note]:
        """Say at the run's begin which thresholds were changed that decide nothing here."""
        active = [gate.parameter for gate in instance.stage.gates]
        defaults = self.kind.Parameters()
        for name in dict.fromkeys(gate.parameter for gate in self.kind.gates):
            value = self.config.parameters.get(name, getattr(defaults, name))
            if value != getattr(defaults, name) and name not in active:
                text = f"{instance.spec.topic}: {self.name}.{name} decides nothing here, but "
                yield Note(time_ns, text + " and ".join(active), "WARN", self.name)

    def _unknown_units(self, instance: _Instance, time_ns: int) -> Iterator[Note]:
        """Say at the run's begin where thresholds have a unit and the signal an unknown one."""
        spec = instance.spec
        units = {q.unit for q in spec.columns} | {g.unit for g in spec.gates}
        units |= {info.unit for info in describe(type(self.parameters))}
        channels = instance.context.stream.channels
        for quantity, unit in sorted({(c.quantity, c.unit) for c in channels}):
            wanted = QUANTITIES.get(quantity)
            if unit not in UNKNOWN_UNITS or unit == wanted or wanted not in units:
                continue
            text = f"{spec.topic}: {quantity} is in {unit}, not {wanted}:"
            if getattr(instance.stage, "mean_is_gravity", False):
                message = f"{text} its mean length is taken for gravity"
                yield Note(time_ns, message, "INFO", spec.stage)
            else:
                message = f"{text} what {spec.stage} asks for in {wanted} does not hold"
                yield Note(time_ns, message, "WARN", spec.stage)


def _given(labels: Sequence[Label], parameters: object) -> tuple[Label, ...]:
    """Return the labels that a stage asks for by its parameters ``updates`` and ``trigger``."""
    waypoints = given_waypoints(labels, getattr(parameters, "updates", "none"))
    asked = getattr(parameters, "trigger", False)
    triggers = sorted(x for x in labels if asked and x.kind == TRIGGER)
    return (*waypoints, *triggers)


def _never_passed(instance: _Instance, time_ns: int) -> Iterator[Note]:
    """Say at the run's begin which thresholds no candidate can reach."""
    reach = getattr(instance.stage, "reach", None)
    spec = instance.spec
    for text in [] if reach is None else never_passed(spec.topic, spec.stage, spec.gates, reach()):
        yield Note(time_ns, text, "WARN", spec.stage)


def _recent(waiting: Sequence[Any], first: Sequence[str]) -> list[Any]:
    """Return the items that wait for their stage without the blocks that are too old for it."""
    blocks = [item for item in waiting if isinstance(item, SignalBlock)]
    leading = [block for block in blocks if block.stream.columns_of(set(first))]
    others = [block for block in blocks if not block.stream.columns_of(set(first))]
    old = {id(b) for b in others if b.last_ns < others[-1].start_ns - _EARLY_NS}
    old |= {id(b) for b in leading[1:] if b.last_ns < leading[-1].start_ns - _EARLY_FIRST_NS}
    return [item for item in waiting if id(item) not in old]


def topic_of(item: Any) -> str:
    """Return the topic of an event, empty where its type has none."""
    topic: str = getattr(item.spec if type(item) in _COLUMNS else item, "topic", "")
    return topic


def _stage_of(item: Any) -> str:
    """Return the stage that an event is of."""
    stage: str = item.spec.stage if type(item) in _COLUMNS else item.stage
    return stage


def _time_of(item: Any) -> int:
    """Return the time of an event, of candidates that of the first [ns]."""
    return int(item.time_ns if isinstance(item.time_ns, int) else item.time_ns[0])


def _rows_of(block: CandidateBlock, rows: slice) -> CandidateBlock:
    return CandidateBlock(
        block.spec,
        block.time_ns[rows],
        block.channel[rows],
        block.value[rows],
        block.gate_value[rows],
        block.margin[rows],
        block.accepted[rows],
    )


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The trace of a measurement: what was reached in each 50 ms frame.

    Attributes
    ----------
    time_ns
        Shape (n,), int64: start of each frame.
    value
        Shape (n, n_channels, n_quantities), float32, in the order of the detector's ``trace``.
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A decision function sample by sample.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    value
        Shape (n, n_channels), in the unit of the detector's first ``trace`` quantity.
    """

    time_ns: NDArray[np.int64]
    value: NDArray[np.float64]


NO_FRAMES = Frames(np.empty(0, np.int64), np.empty((0, 0, 0), np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a block completes: frames and candidates, which ``process`` yields.

    A detector whose ``trace`` is empty gives no frames; then "why was there no candidate" cannot
    be answered for it.
    """

    candidates: Candidates
    frames: Frames = NO_FRAMES

    def __iter__(self) -> Iterator[Frames | Candidates]:
        """Yield the frames, then the candidates, as results hold them."""
        yield self.frames
        yield self.candidates


def joined(first: Measured, second: Measured) -> Measured:
    """Return two measurements, one after the other, as one."""
    return Measured(
        Candidates.concatenate([first.candidates, second.candidates]),
        Frames(
            np.concatenate([first.frames.time_ns, second.frames.time_ns]),
            np.concatenate([first.frames.value, second.frames.value]),
        ),
    )


if TYPE_CHECKING:
    Output = Candidates | Frames | Event


#: Accepted cycles no further apart are of one span [ns].
BRIDGE_NS = NS_PER_S


@dataclass(slots=True)
class _Open:
    """A span that may go on: its first and last accepted cycle, and the greatest value."""

    first_ns: int
    last_ns: int
    value: float


@dataclass(slots=True)
class PresenceIntervals:
    """The spans of one stage on one topic, while they grow.

    Attributes
    ----------
    open
        By channel.
    last_ns, cycle_ns
        Of each channel the last candidate, and how far candidates are apart [ns].
    spec
        What the candidates so far are; None before any.
    """

    open: dict[int, _Open] = field(default_factory=dict)
    last_ns: dict[int, int] = field(default_factory=dict)
    cycle_ns: int = 0
    spec: StageSpec | None = None

    def take(self, block: CandidateBlock) -> Iterator[Presence]:
        """Take decided candidates; yield the spans that have ended."""
        self.spec = block.spec
        rows = zip(
            block.time_ns.tolist(),
            block.channel.tolist(),
            block.value[:, 0].tolist(),
            block.accepted.tolist(),
            strict=True,
        )
        for time_ns, channel, value, accepted in rows:
            self._space(channel, time_ns)
            interval = self.open.get(channel)
            if interval is not None and time_ns - interval.last_ns > BRIDGE_NS:
                yield self._ended(block.spec, channel)
                interval = None
            if accepted and interval is None:
                self.open[channel] = _Open(time_ns, time_ns, value)
            elif accepted and interval is not None:
                interval.last_ns, interval.value = time_ns, max(interval.value, value)

    def flush(self) -> Iterator[Presence]:
        """End all spans."""
        if self.spec is not None:
            for channel in sorted(self.open):
                yield self._ended(self.spec, channel)
        self.last_ns.clear()

    def _space(self, channel: int, time_ns: int) -> None:
        if channel in self.last_ns:
            apart = time_ns - self.last_ns[channel]
            self.cycle_ns = apart if self.cycle_ns == 0 else min(apart, self.cycle_ns)
        self.last_ns[channel] = time_ns

    def _ended(self, spec: StageSpec, channel: int) -> Presence:
        one = self.open.pop(channel)
        half = self.cycle_ns // 2
        name = spec.channels[channel]
        start_ns, end_ns = one.first_ns - half, one.last_ns + half
        return Presence(start_ns, end_ns, name, spec.topic, spec.stage, one.value)


#: Root mean square distance of nine sensors in a room of 5.4 m x 5.4 m from their middle [m].
#: Source: definition, 2.7 sqrt(4 / 3).
COMMON_RADIUS_M = 3.118
#: Power of length in the units of parameters that have one. Source: definition.
POWERS = {"m": 1, "m^2": 2, "m/s": 1, "m/s^2": 1}


def units_per_metre(geometry: Geometry | None) -> float:
    """Return how many of a site's units count as a metre: 1 where its unit is known."""
    if geometry is None or geometry.unit != UNKNOWN_UNIT or not geometry.sensors:
        return 1.0
    places = np.array([(s.x, s.y) for s in geometry.sensors], np.float64)
    radius = float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))
    return radius / COMMON_RADIUS_M if radius > 0 else 1.0


def scaled_lengths(parameters: P, geometry: Geometry | None) -> P:
    """Return a stage's parameters with the lengths among them in the site's units."""
    factor = units_per_metre(geometry)
    if factor == 1.0:
        return parameters
    given: Any = parameters
    lengths = {
        info.name: getattr(given, info.name) * factor ** POWERS[info.unit]
        for info in describe(type(given))
        if info.unit in POWERS
    }
    changed: P = replace(given, **lengths)
    return changed


def length_note(geometry: Geometry | None) -> str:
    """Return what a person must know of the lengths; an empty text where the unit is known."""
    factor = units_per_metre(geometry)
    if geometry is None or geometry.unit != UNKNOWN_UNIT:
        return ""
    return (
        f"the unit of length is unknown: places are in units; lengths of stages in m are taken "
        f"times {factor:.3g}, by the sensors' spread"
    )


def in_length_unit(spec: StageSpec, geometry: Geometry | None) -> StageSpec:
    """Return what a stage's columns and gates mean, metres being the site's units."""
    if geometry is None or geometry.unit != UNKNOWN_UNIT:
        return spec
    unit = geometry.length_unit
    return replace(
        spec,
        columns=tuple(replace(c, unit=unit) if c.unit == "m" else c for c in spec.columns),
        gates=tuple(replace(g, unit=unit) if g.unit == "m" else g for g in spec.gates),
    )


#: A place in the plane has two coordinates, and the moment of the impact is unknown too. Source:
#: definition.
LEAST_PICKS = 3


@dataclass(frozen=True, slots=True, eq=False)
class LocationEstimate:
    """A place found.

    Attributes
    ----------
    x, y
        Where [m]; NaN where there are too few arrivals.
    covariance
        Shape (2, 2) [m^2]; NaN likewise.
    residual
        What the method leaves unexplained, in its own unit; NaN likewise.
    picks
        From how many arrivals.
    ties
        How many regions or nodes explain the arrivals equally well.
    """

    x: float
    y: float
    covariance: NDArray[np.float64]
    residual: float
    picks: int
    ties: int = 1

    @property
    def located(self) -> bool:
        """Whether there is a place."""
        return bool(np.isfinite(self.x))

    @property
    def larger_sigma_m(self) -> float:
        """Standard deviation along the longer axis of its ellipse [m]; inf where that is open."""
        if not np.isfinite(self.covariance).all():
            return float("inf")
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance)[-1], 0.0)))

    def fix(self, time_ns: int, method: str, stage: str, *, doubted: bool = False) -> Fix:
        """Return the place as the fix of a moment, found by a method in a stage."""
        (xx, xy), (_, yy) = self.covariance.tolist()
        spread = (xx, xy, yy)
        of = method, self.picks, stage, doubted
        return Fix(time_ns, self.x, self.y, spread, self.residual, *of)


def no_location(picks: int) -> LocationEstimate:
    """Return the answer to fewer arrivals than :data:`LEAST_PICKS`."""
    nan = float("nan")
    return LocationEstimate(nan, nan, np.full((2, 2), nan), nan, picks, 0)
