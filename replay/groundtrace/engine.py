"""The replay loop: source, clock, pipeline, sinks."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.events import CandidateBlock, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Sequence

    from groundtrace_codecs.events import Event, Gap, Note

    from .clock import Clock
    from .pipeline import Pipeline
    from .sinks import Sink


@dataclass(slots=True)
class Tally:
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
    """

    counts: Counter[str] = field(default_factory=Counter)
    samples: int = 0
    recorded_s: float = 0.0
    wall_s: float = 0.0
    first_ns: int | None = None
    last_ns: int | None = None

    def hear(self, block: SignalBlock) -> int:
        """Count a block; return the time reached [ns]."""
        start_ns, end_ns = block.start_ns, block.end_ns
        self.first_ns = start_ns if self.first_ns is None else min(self.first_ns, start_ns)
        self.last_ns = end_ns if self.last_ns is None else max(self.last_ns, end_ns)
        self.recorded_s = (self.last_ns - self.first_ns) / NS_PER_S
        self.samples += block.samples.size
        return self.last_ns

    def add(self, events: Collection[Event]) -> None:
        """Count events."""
        kinds = Counter(map(type, events))
        for kind, count in kinds.items():
            self.counts[kind.__name__] += count
        if CandidateBlock in kinds or TraceBlock in kinds:
            for event in events:
                if isinstance(event, (CandidateBlock, TraceBlock)):
                    self.counts[type(event).__name__] += len(event) - 1


def replay(
    source: Iterable[SignalBlock | Gap | Note],
    pipeline: Pipeline,
    sinks: Sequence[Sink],
    *,
    clock: Clock | None = None,
    progress: Callable[[int], None] | None = None,
    tally: Tally | None = None,
) -> Tally:
    """Stream a source through a pipeline into open sinks.

    Parameters
    ----------
    source
        Blocks and gaps in time order, and notes on them.
    pipeline
        Stages that make events of them.
    sinks
        Where blocks and events go; already open, closed by the caller.
    clock
        Paces the replay; None means as fast as possible.
    progress
        Told the time reached [ns] after each block.
    tally
        Of what was replayed before, to be added to; None begins a new one.
    """
    tally = Tally() if tally is None else tally
    began = time.perf_counter() - tally.wall_s
    last_ns = tally.last_ns
    for item in source:
        if isinstance(item, SignalBlock):
            _wait(clock, item.end_ns)
            last_ns = tally.hear(item)
        else:
            tally.add([item])
        for sink in sinks:
            sink.write(item)
        _deliver(pipeline.process(item), sinks, tally)
        if progress is not None and last_ns is not None:
            progress(last_ns)
    _deliver(pipeline.flush(), sinks, tally)
    tally.wall_s = time.perf_counter() - began
    return tally


def _deliver(events: Collection[Event], sinks: Sequence[Sink], tally: Tally) -> None:
    tally.add(events)
    for event in events if sinks else ():
        for sink in sinks:
            sink.write(event)


def _wait(clock: Clock | None, time_ns: int) -> None:
    """Sleep until the clock says that ``time_ns`` is due: the one place that waits."""
    while clock is not None and (wait := clock.wait_s(time_ns, time.monotonic())) > 0:
        time.sleep(min(wait, 0.1))
