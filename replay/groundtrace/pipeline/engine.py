"""The replay loop: source, clock, pipeline, sinks."""

from __future__ import annotations

import math
import os
import time
from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from multiprocessing import parent_process
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TypeVar

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Gap, Note, StageSpec, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .. import kernels
from ..runtime import one_blas_thread
from .warned import WarningCounter

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from concurrent.futures import Future

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event, Label
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from .chain import Pipeline

    #: What a source gives: blocks and gaps in time order, and notes on them.
    Item = SignalBlock | Gap | Note

    #: First and last time [ns], the last one left out; None is no bound.
    Span = tuple[int | None, int | None]

    #: What gives the events of an item's first stage.
    Begun = Callable[[], list[Event]]

#: Tasks that the other core is ahead: one, and one that waits while another chunk is read, which
#: takes as long as several items from it. Chosen by judgement.
AHEAD = 2
#: Samples of a task, all channels together: handing one over costs what some thousand of them do.
#: Chosen by judgement: a hundred times that.
TOGETHER = 100_000


@dataclass(slots=True)
class ReplayCounts:
    """What a replay produced.

    Attributes
    ----------
    counts
        Number of events by type name; candidates count rows.
    samples
        Samples replayed, all channels together.
    recorded_s, wall_s
        Recorded time covered and wall time taken [s].
    first_ns, last_ns
        Of all blocks [ns]; None before the first.
    warnings
        Notes that warn.
    lost_ns
        By topic, how long nothing was recorded in gaps that were not filled.
    """

    counts: Counter[str] = field(default_factory=Counter)
    samples: int = 0
    recorded_s: float = 0.0
    wall_s: float = 0.0
    first_ns: int | None = None
    last_ns: int | None = None
    warnings: WarningCounter = field(default_factory=WarningCounter)
    lost_ns: Counter[str] = field(default_factory=Counter)

    def update(self, block: SignalBlock) -> None:
        """Count a block."""
        start_ns, end_ns = block.start_ns, block.end_ns
        self.first_ns = start_ns if self.first_ns is None else min(self.first_ns, start_ns)
        self.last_ns = end_ns if self.last_ns is None else max(self.last_ns, end_ns)
        self.recorded_s = (self.last_ns - self.first_ns) / NS_PER_S
        self.samples += block.samples.size

    def add(self, events: Collection[Event]) -> None:
        """Count events."""
        kinds = Counter(map(type, events))
        for kind, count in kinds.items():
            self.counts[kind.__name__] += count
        if CandidateBlock in kinds or TraceBlock in kinds:
            for event in events:
                if isinstance(event, (CandidateBlock, TraceBlock)):
                    self.counts[type(event).__name__] += len(event) - 1
        if Note in kinds or Gap in kinds:
            for event in events:
                if isinstance(event, Note):
                    self.warnings.add(event)
                elif isinstance(event, Gap) and not event.bridged:
                    self.lost_ns[event.topic] += event.end_ns - event.start_ns


class ReplayLoop:
    """Items on their way through a pipeline into open sinks, closed by the caller.

    On two cores the first stage takes the next items in another thread while the other stages, the
    sinks and whoever reads are at work in this one. Everything comes in the same order as on one.

    Parameters
    ----------
    pipeline
        Stages that make events of items.
    sinks
        Where blocks and events go.
    clock
        Paces the replay, which then takes nothing ahead; None means as fast as possible.
    progress
        Told the time reached [ns] after each block.
    span
        Of what is counted, paced and given to sinks, ``start <= time < stop`` [ns]; None is no
        bound. The pipeline sees all.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        sinks: Sequence[Sink],
        *,
        clock: Clock | None = None,
        progress: Callable[[int], None] | None = None,
        span: Span = (None, None),
    ) -> None:
        self.tally = ReplayCounts()
        self._span = span
        self._pipeline = pipeline
        self._sinks = sinks
        self._clock = clock
        self._progress = progress
        self._ahead = AHEAD if clock is None and cores() > 1 and pipeline.runs_ahead else 0
        self._gathered: list[Item] = []
        self._gathered_samples = 0
        self._begun: deque[tuple[list[Item], Future[list[Begun]]]] = deque()

    def through(self, source: Iterable[Item]) -> ReplayCounts:
        """Take everything that a source gives, until its end."""
        began = time.perf_counter()
        if cores() > 1:
            kernels.compile_new(self._pipeline.compiles)
        items = iter(source)
        with one_blas_thread():
            while (item := self._next(items)) is not None:
                self._take(item)
            self.flush()
            self._deliver(self._pipeline.flush())
        self.tally.wall_s = time.perf_counter() - began
        return self.tally

    def flush(self) -> None:
        """Bring all items that were taken to their end: nothing is on its way afterwards.

        Nor is it after an error: what comes after that is left out.
        """
        tasks, self._begun = self._begun, deque()
        gathered = self._gather()
        for items, task in tasks:
            self._finish_task(items, task)
        for item in gathered:
            self._finish(item, partial(self._pipeline.begin, item))

    def _next(self, items: Iterator[Item]) -> Item | None:
        """Return the next item; an error of the source comes after what was there before it."""
        try:
            return next(items, None)
        except Exception:
            self.flush()
            raise

    def _take(self, item: Item) -> None:
        self._gathered.append(item)
        self._gathered_samples += item.samples.size if isinstance(item, SignalBlock) else 0
        if not self._ahead:
            self.flush()
        elif self._gathered_samples >= TOGETHER:
            items = self._gather()
            self._begun.append((items, started(partial(_begin, self._pipeline, items))))
            if len(self._begun) > self._ahead:
                self._finish_task(*self._begun.popleft())

    def _gather(self) -> list[Item]:
        """Return the items that were gathered, and begin to gather others."""
        gathered, self._gathered, self._gathered_samples = self._gathered, [], 0
        return gathered

    def _finish_task(self, items: Sequence[Item], task: Future[list[Begun]]) -> None:
        for item, begun in zip(items, task.result(), strict=True):
            self._finish(item, begun)

    def _finish(self, item: Item, begun: Begun) -> None:
        part = part_of(item, *self._span)
        if isinstance(part, SignalBlock):
            self._wait(part.end_ns)
            self.tally.update(part)
        elif part is not None:
            self.tally.add([part])
        for sink in self._sinks if part is not None else ():
            sink.write(part)
        self._deliver(self._pipeline.go_on(item, begun()))
        if self._progress is not None and self.tally.last_ns is not None:
            self._progress(self.tally.last_ns)

    def _deliver(self, events: Collection[Event]) -> None:
        if self._span != (None, None):
            parts = (part_of(event, *self._span) for event in events)
            events = [part for part in parts if part is not None]
        self.tally.add(events)
        for event in events if self._sinks else ():
            for sink in self._sinks:
                sink.write(event)

    def _wait(self, time_ns: int) -> None:
        """Sleep until the clock says that ``time_ns`` is due: the one place that waits."""
        clock = self._clock
        while clock is not None and (wait := clock.wait_s(time_ns, time.monotonic())) > 0:
            time.sleep(min(wait, 0.1))


def _begin(pipeline: Pipeline, items: Sequence[Item]) -> list[Begun]:
    """Begin items; what fails is to fail when it is asked for."""
    return [_begun(pipeline, item) for item in items]


def _begun(pipeline: Pipeline, item: Item) -> Begun:
    try:
        events = pipeline.begin(item)
    except Exception as error:  # whatever it is, it is raised where it is due
        return partial(_fail, error)
    return lambda: events


def _fail(error: Exception) -> NoReturn:
    raise error


def replay(
    source: Iterable[Item],
    pipeline: Pipeline,
    sinks: Sequence[Sink],
    *,
    clock: Clock | None = None,
    progress: Callable[[int], None] | None = None,
) -> ReplayCounts:
    """Stream a source through a pipeline into open sinks, in one go: see :class:`ReplayLoop`."""
    return ReplayLoop(pipeline, sinks, clock=clock, progress=progress).through(source)


def part_of(item: Any, start_ns: int | None, stop_ns: int | None) -> Any:
    """Return what of a block or event is of ``start_ns <= time < stop_ns``, or None.

    What a stage states is of all times.
    """
    if (start_ns is None and stop_ns is None) or isinstance(item, StageSpec):
        return item
    if isinstance(item, SignalBlock):
        part = item.between(start_ns, stop_ns)
        return part if len(part) else None
    times = np.asarray(item.time_ns)
    inside = np.ones(times.shape, np.bool_)
    if start_ns is not None:
        inside &= times >= start_ns
    if stop_ns is not None:
        inside &= times < stop_ns
    if not isinstance(item, CandidateBlock | TraceBlock):
        return item if inside else None
    if inside.all():
        return item
    names = [name for name in type(item).__dataclass_fields__ if name != "spec"]
    rows = {name: getattr(item, name)[inside] for name in names}
    return replace(item, **rows) if inside.any() else None


class Clock:
    """Paces a replay.

    Parameters
    ----------
    rate
        Recorded seconds per wall second; 0 means as fast as possible.

    Notes
    -----
    All wall times are given by the caller [s, any monotonic clock], so a test needs no waiting.
    """

    def __init__(self, rate: float = 0.0) -> None:
        if not (math.isfinite(rate) and rate >= 0):
            raise ValueError(f"rate: expected a number >= 0, found {rate}")
        self.rate = rate
        self._origin: tuple[int, float] | None = None

    def wait_s(self, time_ns: int, now_s: float) -> float:
        """Return how long to wait [s] before ``time_ns`` is due.

        The first call sets the origin: that recorded time is due now.
        """
        if self.rate == 0:
            return 0.0
        if self._origin is None:
            self._origin = (time_ns, now_s)
        origin_ns, origin_s = self._origin
        due_s = origin_s + (time_ns - origin_ns) / NS_PER_S / self.rate
        return max(0.0, due_s - now_s)


@dataclass(frozen=True, slots=True)
class ReplaySession:
    """What a replay is about, told to every sink before the first item.

    Attributes
    ----------
    name
        File name of the recording.
    application
        Kind of recording, which chooses a viewer's layout: ``room``, ``walker``, ``shots``, ...
    start_ns, end_ns
        First and last sample of the recording [ns].
    streams
        What will be replayed.
    geometry
        Where the sensors stand, or None.
    labels
        The recording's own truth.
    pipeline
        The pipeline's recipe, for people.
    shown_ns
        The part of the recording that is shown, first and last time [ns]; None for all of it.
    annotations
        What people marked, beside the recording or inside it.
    live
        Whether the recording still grows: then ``end_ns`` is where it is known so far.
    """

    name: str
    application: str
    start_ns: int
    end_ns: int
    streams: tuple[Stream, ...]
    geometry: Geometry | None
    labels: tuple[Label, ...]
    pipeline: str
    shown_ns: tuple[int, int] | None = None
    annotations: tuple[Annotation, ...] = ()
    live: bool = False


class Sink(Protocol):
    """Takes what a replay produces, in time order."""

    def open(self, session: ReplaySession) -> None:
        """Begin a replay."""

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""

    def close(self) -> None:
        """End the replay; everything taken is safe afterwards."""


T = TypeVar("T")


@dataclass(slots=True)
class EventList:
    """A sink that keeps the events and leaves out the signals."""

    events: list[Event] = field(default_factory=list)

    def open(self, session: ReplaySession) -> None:
        """Begin; nothing is needed."""

    def write(self, item: SignalBlock | Event) -> None:
        """Take an event."""
        if not isinstance(item, SignalBlock):
            self.events.append(item)

    def close(self) -> None:
        """End; nothing is held."""


def cores() -> int:
    """Return how many cores this process may use: one, where another started it to share work."""
    if parent_process() is not None:
        return 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def started(task: Callable[[], T]) -> Future[T]:
    """Have a task done by the other thread, after those that it was given before."""
    return _other().submit(task)


@cache
def _other() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, thread_name_prefix="groundtrace-other")


if hasattr(os, "register_at_fork"):  # threads do not live on in a forked process
    os.register_at_fork(after_in_child=_other.cache_clear)
