"""The stage that runs an associator: picks of one topic are grouped."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Gap, Pick, StageSpec

from .detector import Associator
from .gates import Carry, gate_specs
from .stage import PluginStage, TopicRun

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock


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

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that picks, then feed its picks; begin anew where the clock steps."""
        if isinstance(item, Gap):
            run = self._runs.get(item.topic)
            if run is not None and item.reason == "clock step" and not item.bridged:
                yield from run.decide(run.worker.finish(), self.parameters)
                run.carry = Carry()
        if not isinstance(item, StageSpec | Pick) or item.stage != (self.source or item.stage):
            return
        if isinstance(item, StageSpec):
            if self.allowed(item.topic):
                self._runs[item.topic] = run = self._begin(item)
                yield run.spec
        elif item.topic in self._runs:
            run = self._runs[item.topic]
            yield from run.decide(run.worker.associate(item), self.parameters)

    def flush(self) -> Iterator[Event]:
        """Yield the groups held back."""
        for run in self._runs.values():
            yield from run.decide(run.worker.finish(), self.parameters)

    def save(self) -> Any:
        """Return a copy of everything that crosses picks."""
        return copy.deepcopy(self._runs)

    def restore(self, saved: Any) -> None:
        """Go on from what :meth:`save` returned."""
        self._runs = copy.deepcopy(saved)

    def _begin(self, source: StageSpec) -> TopicRun[Associator]:
        worker = self.kind(self.parameters)
        names = worker.start(source)
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name, self.plugin, source.topic, names, worker.columns, gates, (), worker.emits
        )
        return TopicRun(worker, spec)
