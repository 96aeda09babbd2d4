"""The stage that runs an associator: picks of one topic are grouped."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Gap, Pick, StageSpec
from groundtrace_codecs.signals import SignalBlock

from .detector import Associator
from .gates import Candidates, Carry, decided_block, gate_specs
from .stage import PluginStage, TopicRun, accepted_events

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Event


class AssociatorStage(PluginStage[Associator]):
    """Runs one associator on the picks of every topic.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    source
        The stage whose picks it takes; empty means any.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Associator],
        parameters: Any,
        topics: Sequence[str] = (),
        source: str = "",
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.source = source
        self._runs: dict[str, TopicRun[Associator]] = {}
        self._fresh: set[str] = set()

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that picks, then feed its picks; begin anew where the clock steps."""
        yield from self.process_all([item])[0]

    def process_all(self, items: Sequence[SignalBlock | Event]) -> list[list[Event]]:
        """Take items in their order; groups that picks in succession complete are decided at once.

        Returns
        -------
        What each item brings about.
        """
        given: list[list[Event]] = [[] for _ in items]
        waiting: dict[str, list[tuple[int, Candidates]]] = {}
        for place, item in enumerate(items):
            if isinstance(item, Pick):
                run = self._runs.get(item.topic)
                if run is not None and (not self.source or item.stage == self.source):
                    found = run.worker.associate(item)
                    if len(found):
                        waiting.setdefault(item.topic, []).append((place, found))
            elif isinstance(item, Gap | StageSpec):
                self._decide(waiting, given)
                given[place] += self._told(item)
            elif isinstance(item, SignalBlock) and item.topic in self._fresh:
                self._fresh.remove(item.topic)
                given[place] += self._runs[item.topic].never_passed(item.start_ns)
        self._decide(waiting, given)
        return given

    def at_once(self, source: StageSpec, picks: Iterable[Pick]) -> CandidateBlock | None:
        """Return what all picks of a topic come to, decided at once; None where it may not run."""
        if not self.allowed(source.topic):
            return None
        run = self._begin(source)
        parts = [found for pick in picks if len(found := run.worker.associate(pick))]
        none = Candidates.empty(len(run.spec.columns))
        found = Candidates.concatenate([none, *parts, run.worker.finish()])
        return decided_block(run.spec, found, run.worker, self.parameters)[0]

    def flush(self) -> Iterator[Event]:
        """Yield the groups held back."""
        for run in self._runs.values():
            yield from run.decide(run.worker.finish(), self.parameters)

    def _told(self, item: Gap | StageSpec) -> Iterator[Event]:
        """Begin at the stage that picks; begin anew where the clock steps."""
        if isinstance(item, StageSpec):
            if item.stage == (self.source or item.stage) and self.allowed(item.topic):
                self._runs[item.topic] = begun = self._begin(item)
                self._fresh.add(item.topic)  # its time is that of the block that brought it
                yield begun.spec
            return
        run = self._runs.get(item.topic)
        if run is not None and item.reason == "clock step" and not item.bridged:
            yield from run.decide(run.worker.finish(), self.parameters)
            run.carry = Carry()

    def _decide(
        self, waiting: dict[str, list[tuple[int, Candidates]]], given: list[list[Event]]
    ) -> None:
        """Decide the groups that wait, topic by topic; give what they bring about to its place."""
        for topic, groups in waiting.items():
            run = self._runs[topic]
            found = Candidates.concatenate([own for _, own in groups])
            state = (run.worker, self.parameters, run.carry)
            block, run.carry = decided_block(run.spec, found, *state)
            told, start = iter(accepted_events(block, run.worker.emits)), 0
            for place, own in groups:
                part = _rows_of(block, slice(start, start + len(own)))
                given[place] += [part, *islice(told, int(np.count_nonzero(part.accepted)))]
                start += len(own)
        waiting.clear()

    def _begin(self, source: StageSpec) -> TopicRun[Associator]:
        worker = self.kind(self.parameters)
        names = worker.start(source)
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name, self.plugin, source.topic, names, worker.columns, gates, (), worker.emits
        )
        return TopicRun(worker, spec)


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
