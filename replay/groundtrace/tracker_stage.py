"""The stage that runs a tracker: the fixes of one localizer become tracks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Fix, Gap, StageSpec
from groundtrace_codecs.signals import NS_PER_S

from .gates import Candidates, Carry, decided_block, gate_specs
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from .trackers.api import Tracker


@dataclass(slots=True)
class _Run:
    """A tracker at work, and the fixes that may still get company."""

    worker: Tracker
    spec: StageSpec
    carry: Carry = field(default_factory=Carry)
    waiting: list[Fix] = field(default_factory=list)


class TrackerStage(PluginStage["Tracker"]):
    """Runs one tracker on the fixes of one stage.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    source
        The stage whose fixes it takes.

    Notes
    -----
    Fixes that come together are of different walkers, so they are decided at once: when the first
    fix after them has come. Where the clock steps, all tracks end.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Tracker],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        source: str,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.source = source
        self._run: _Run | None = None

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that locates, then take its fixes."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.source:
                if self._run is None and self.allowed(topic):
                    self._run = self._begin(topic)
                    yield self._run.spec
            case Fix(stage=stage) if stage == self.source and self._run is not None:
                yield from self._take(self._run, item)
            case Gap(reason="clock step", bridged=False, topic=topic) if self._run is not None:
                if topic == self._run.spec.topic:
                    yield from self._end(self._run)

    def flush(self) -> Iterator[Event]:
        """End all tracks."""
        if self._run is not None:
            yield from self._end(self._run)

    def _begin(self, topic: str) -> _Run:
        worker = self.kind(self.parameters)
        worker.start(self.name)
        gates = gate_specs(worker.gates, self.parameters)
        names = ("all",)
        return _Run(
            worker,
            StageSpec(
                self.name, self.plugin, topic, names, worker.columns, gates, (), worker.emits
            ),
        )

    def _take(self, run: _Run, fix: Fix) -> Iterator[Event]:
        together_ns = self.parameters.together_s * NS_PER_S
        if run.waiting and fix.time_ns - run.waiting[0].time_ns > together_ns:
            yield from self._decide(run)
        run.waiting.append(fix)

    def _end(self, run: _Run) -> Iterator[Event]:
        yield from self._decide(run)
        yield from run.worker.finish()
        run.carry = Carry()

    def _decide(self, run: _Run) -> Iterator[Event]:
        fixes, run.waiting = sorted(run.waiting, key=lambda fix: fix.time_ns), []
        if not fixes:
            return
        yield from run.worker.expire(fixes[0].time_ns)
        times = np.array([fix.time_ns for fix in fixes], np.int64)
        found = Candidates(times, np.zeros(len(fixes), np.int32), run.worker.measure(fixes))
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        yield block
        yield from run.worker.follow(fixes, block.accepted)
