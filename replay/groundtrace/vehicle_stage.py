"""The stage that works on powers of stations: places, courses and passes of vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import CandidateBlock, Gap, Note, StageSpec
from groundtrace_codecs.geometry import Geometry

from .gates import Carry, decided_block, gate_specs
from .lengths import in_length_unit
from .stage import PluginStage
from .vehicles.joining import CycleJoin

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from .gates import Candidates
    from .vehicles.api import Cycle, VehicleWorker


@dataclass(slots=True)
class _Run:
    """A worker at work, and the cycles that wait for other stations."""

    worker: VehicleWorker
    spec: StageSpec
    join: CycleJoin
    carry: Carry = field(default_factory=Carry)


class VehicleStage(PluginStage["VehicleWorker"]):
    """Runs one worker on the cycles of the stage that hears vehicles, of all topics together.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    hearing
        The stage whose cycles it takes.
    geometry
        Where the stations are; None where unknown.

    Notes
    -----
    What is found is told of the first topic heard. Where a site lacks what the worker needs, a
    note says so and nothing comes of it. Where the clock steps, the run of cycles ends.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[VehicleWorker],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        hearing: str,
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.hearing = hearing
        self.geometry = geometry or Geometry()
        self._run: _Run | None = None
        self._told = False

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that hears vehicles, then take its cycles."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.hearing:
                if self._run is None and self.allowed(topic):
                    self._run = self._begin(topic)
                    if self._run is not None:
                        yield self._run.spec
            case CandidateBlock(spec=spec) if spec.stage == self.hearing:
                yield from self._take(item)
            case Gap(reason="clock step", bridged=False) if self._run is not None:
                yield from self._end(self._run)

    def flush(self) -> Iterator[Event]:
        """End the run of cycles."""
        if self._run is not None:
            yield from self._end(self._run)

    def _begin(self, topic: str) -> _Run | None:
        site = self.geometry.stations()
        if len(site.names) < self.kind.least_stations:
            return None
        worker = self.kind(self.parameters)
        names = worker.start(site, self.name)
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name, self.plugin, topic, names, worker.columns, gates, (), worker.emits
        )
        return _Run(worker, in_length_unit(spec, self.geometry), CycleJoin(site))

    def _take(self, block: CandidateBlock) -> Iterator[Event]:
        if self._run is not None:
            yield from self._worked(self._run, self._run.join.add(block))
        elif not self._told and self.allowed(block.spec.topic):
            self._told = True
            text = f"expected a geometry with places of {self.kind.least_stations} or more stations"
            found = len(self.geometry.stations().names) or "none"
            text = f"{block.spec.topic}: no {self.kind.emits}: {text}, found {found}"
            yield Note(int(block.time_ns[0]), text, "WARN", self.name)

    def _worked(self, run: _Run, cycles: Iterable[Cycle]) -> Iterator[Event]:
        for cycle in cycles:
            yield from self._decided(run, run.worker.take(cycle))

    def _end(self, run: _Run) -> Iterator[Event]:
        yield from self._worked(run, run.join.flush())
        yield from self._decided(run, run.worker.finish())
        run.carry = Carry()

    def _decided(self, run: _Run, found: Candidates) -> Iterator[Event]:
        if not len(found):
            return
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        yield block
        yield from run.worker.follow(block.accepted)
