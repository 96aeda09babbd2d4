"""The stage that crosses bearings: those of each step become a place."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Bearing, Gap, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry

from .gates import Carry, decided_block, gate_specs
from .localizer_stage import place_candidate
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from .direction.crossing import Crossing


@dataclass(slots=True)
class _Run:
    """Bearings of one topic to be crossed: the latest of each station."""

    worker: Crossing
    spec: StageSpec
    stations: dict[str, tuple[float, float]]
    carry: Carry = field(default_factory=Carry)
    latest: dict[str, Bearing] = field(default_factory=dict)


class BearingStage(PluginStage["Crossing"]):
    """Crosses the bearings that an array method gives for each step.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    pointing, stepping
        The stages whose bearings and steps it takes.
    geometry
        Where the stations are.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[Crossing],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        pointing: str,
        stepping: str,
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.pointing = pointing
        self.stepping = stepping
        self.geometry = geometry or Geometry()
        self._run: _Run | None = None

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that gives bearings, gather them, and cross those of each step."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.pointing:
                if self._run is None and self.allowed(topic):
                    self._run = self._begin(item)
                    yield self._run.spec
            case Bearing(stage=stage) if stage == self.pointing and self._run is not None:
                self._run.latest[item.station] = item
            case StepEvent(stage=stage, topic=topic) if stage == self.stepping:
                if self._run is not None and self._run.spec.topic == topic:
                    yield from self._cross(self._run, item.time_ns)
            case Gap(reason="clock step", bridged=False, topic=topic):
                if self._run is not None and self._run.spec.topic == topic:
                    self._run.latest.clear()
                    self._run.carry = Carry()

    def flush(self) -> Iterator[Event]:
        """Yield nothing: no step is held back."""
        yield from ()

    def _begin(self, source: StageSpec) -> _Run:
        from .direction.bearings import placed

        worker = self.kind(self.parameters)
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name, self.plugin, source.topic, ("all",), worker.columns, gates, (), worker.emits
        )
        return _Run(worker, spec, placed(source.channels, self.geometry))

    def _cross(self, run: _Run, time_ns: int) -> Iterator[Event]:
        """Cross the bearings of the step: those that came with it, at its very time."""
        own = [b for b in run.latest.values() if b.time_ns == time_ns and b.station in run.stations]
        location = run.worker.locate(
            np.array([run.stations[b.station] for b in own], np.float64).reshape(-1, 2),
            np.array([b.azimuth_rad for b in own], np.float64),
            np.array([b.sigma_rad for b in own], np.float64),
        )
        found = place_candidate(time_ns, location)
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        yield block
        if block.accepted[0]:
            yield location.fix(time_ns, self.plugin, self.name)
