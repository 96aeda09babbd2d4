"""The stage that compares localizers: where they place one step apart, something is wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Fix, Gap, Note, StageSpec

from .gates import Carry, decided_block, gate_specs
from .lengths import in_length_unit, length_note, scaled_lengths
from .stage import PluginStage, accepted_events

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import SignalBlock

    from .comparisons.api import Comparison


@dataclass(slots=True)
class _Run:
    """A comparison at work, and the fixes of the step that may still get company."""

    worker: Comparison
    spec: StageSpec
    told: bool = False
    carry: Carry = field(default_factory=Carry)
    waiting: dict[str, Fix] = field(default_factory=dict)


class ComparisonStage(PluginStage["Comparison"]):
    """Runs one comparison on the fixes that several localizers give for each step.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    sources
        The stages whose fixes it compares.
    geometry
        Where the sensors are; None where unknown.

    Notes
    -----
    Fixes of one step share its time. They are compared when the first fix of the next step has
    come, or at the end. A step with a single fix has nothing to compare, and no candidate.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Comparison],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        sources: Sequence[str],
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, scaled_lengths(parameters, geometry), topics)
        self.sources = tuple(sources)
        self.geometry = geometry
        self._run: _Run | None = None

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the first stage that locates, then take the fixes of all."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage in self.sources:
                if self._run is None and self.allowed(topic):
                    self._run = self._begin(topic)
                    yield self._run.spec
            case Fix(stage=stage) if stage in self.sources and self._run is not None:
                yield from self._take(self._run, item)
            case Gap(reason="clock step", bridged=False, topic=topic) if self._run is not None:
                if topic == self._run.spec.topic:
                    yield from self._decide(self._run)
                    self._run.carry = Carry()

    def flush(self) -> Iterator[Event]:
        """Compare the fixes of the last step."""
        if self._run is not None:
            yield from self._decide(self._run)

    def _begin(self, topic: str) -> _Run:
        worker = self.kind(self.parameters)
        gates = gate_specs(worker.gates, self.parameters)
        pairs = tuple(f"{one}, {other}" for one, other in combinations(self.sources, 2))
        spec = StageSpec(
            self.name, self.plugin, topic, pairs, worker.columns, gates, (), worker.emits
        )
        return _Run(worker, in_length_unit(spec, self.geometry))

    def _take(self, run: _Run, fix: Fix) -> Iterator[Event]:
        if run.waiting and next(iter(run.waiting.values())).time_ns != fix.time_ns:
            yield from self._decide(run)
        run.waiting[fix.stage] = fix
        note = "" if run.told else length_note(self.geometry)
        run.told = True
        if note:
            yield Note(fix.time_ns, note, "INFO", self.name)

    def _decide(self, run: _Run) -> Iterator[Event]:
        fixes, run.waiting = run.waiting, {}
        found = run.worker.compare([fixes.get(stage) for stage in self.sources])
        if not len(found):
            return
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        yield block
        yield from accepted_events(block)
