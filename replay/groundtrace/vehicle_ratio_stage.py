"""The stage of ratios: places from instantaneous powers of the stations of one recorder."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Gap, Note, StageSpec, TraceBlock
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .gates import Carry, decided_block, gate_specs
from .lengths import in_length_unit
from .localizers.api import place_candidate
from .stage import PluginStage
from .vehicles.api import row_doubt
from .vehicles.ratios import Noise

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from .vehicles.ratio_worker import CycleRatios, RatioPlaces

#: A place needs so many stations.
_LEAST = 3
#: Cycles with a vehicle are remembered for so long [ns].
_KEEP_NS = 60 * NS_PER_S


@dataclass(slots=True)
class _Heard:
    """The cycles of one topic in which a vehicle is heard.

    Attributes
    ----------
    names
        Of the channels.
    cycles
        Time [ns] of each, and power, floor and its standard deviation, shape (n_channels, 3).
    """

    names: tuple[str, ...]
    cycles: deque[tuple[int, NDArray[np.float64]]] = field(default_factory=deque)

    def remember(self, block: CandidateBlock) -> None:
        """Keep the cycles in which any channel hears a vehicle."""
        named = [c.name for c in block.spec.columns]
        columns = [named.index(name) for name in ("power", "floor", "floor_sigma")]
        for time_ns in np.unique(block.time_ns[block.accepted]).tolist():
            rows = np.flatnonzero(block.time_ns == time_ns)
            known = np.full((len(self.names), len(columns)), np.nan)
            known[block.channel[rows]] = block.value[rows][:, columns]
            self.cycles.append((time_ns, known))
        while self.cycles and self.cycles[0][0] < self.cycles[-1][0] - _KEEP_NS:
            self.cycles.popleft()

    def noise(self, time_ns: int, names: Sequence[str]) -> Noise | None:
        """Return the noise at channels in a cycle, None if no vehicle is heard; forget older."""
        while self.cycles and self.cycles[0][0] < time_ns:
            self.cycles.popleft()
        if not self.cycles or self.cycles[0][0] != time_ns:
            return None
        known = self.cycles[0][1][[self.names.index(name) for name in names]]
        return Noise.of(*known.T)


@dataclass(slots=True)
class _Run:
    """Ratios of the stations of one topic."""

    worker: RatioPlaces
    spec: StageSpec
    names: tuple[str, ...]
    columns: list[int]
    sensors: NDArray[np.float64]
    rate_hz: float
    doubt: str
    carry: Carry = field(default_factory=Carry)

    def begin(self) -> None:
        """Begin a run of samples."""
        self.worker.start(self.rate_hz, self.sensors)


class RatioStage(PluginStage["RatioPlaces"]):
    """Runs ratios on every stream with three or more stations at known places.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    hearing
        The stage that hears vehicles: only in its cycles are there places, and ratios.
    geometry
        Where the stations are; None where unknown.

    Notes
    -----
    Stations of several recorders are not compared: their samples are not of the same moments. Any
    gap starts the analytic signal anew.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[RatioPlaces],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        hearing: str,
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.hearing = hearing
        self.geometry = geometry or Geometry()
        self._heard: dict[str, _Heard] = {}
        self._runs: dict[str, _Run | None] = {}

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Take samples, and the cycles in which there is a vehicle."""
        match item:
            case SignalBlock(topic=topic) if len(item) and topic in self._heard:
                yield from self._hear(item)
            case StageSpec(stage=stage, topic=topic) if stage == self.hearing:
                if self.allowed(topic):
                    self._heard[topic] = _Heard(item.channels)
            case CandidateBlock(spec=spec) if spec.stage == self.hearing:
                if spec.topic in self._heard:
                    self._heard[spec.topic].remember(item)
            case Gap(bridged=False, topic=topic):
                if (run := self._runs.get(topic)) is not None:
                    run.begin()
                    run.carry = Carry()
                    self._heard[topic].cycles.clear()

    def flush(self) -> Iterator[Event]:
        """Yield nothing: a cycle that is not complete has no ratios."""
        yield from ()

    def _hear(self, block: SignalBlock) -> Iterator[Event]:
        from .detectors.filters import planar

        if block.topic not in self._runs:
            self._runs[block.topic] = run = self._begin(block)
            if run is not None:
                yield run.spec
        run = self._runs[block.topic]
        if run is None:
            return
        heard = self._heard[block.topic]
        for ratios in run.worker.add(block.sample_times(), planar(block.select(run.columns))):
            noise = heard.noise(ratios.time_ns, run.names)
            if noise is not None:
                yield from self._located(run, ratios, noise)

    def _begin(self, block: SignalBlock) -> _Run | None:
        stream = block.stream
        columns = stream.columns_of(self.kind.quantities)
        places, sensors = self.geometry.placed([stream.channels[c].name for c in columns])
        if len(np.unique(sensors, axis=0)) < _LEAST:
            return None
        worker = self.kind(self.parameters)
        names = tuple(places)
        pairs = tuple(f"{name}/{names[0]}" for name in names[1:])
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name,
            self.plugin,
            block.topic,
            pairs,
            worker.columns,
            gates,
            worker.trace,
            worker.emits,
        )
        index = {c.name: i for i, c in enumerate(stream.channels)}
        chosen = [index[name] for name in names]
        spec = in_length_unit(spec, self.geometry)
        doubt = row_doubt(names, sensors)
        run = _Run(worker, spec, names, chosen, sensors, stream.rate_hz, doubt)
        run.begin()
        return run

    def _located(self, run: _Run, ratios: CycleRatios, noise: Noise) -> Iterator[Event]:
        columns = [
            column
            for found in ratios.without(noise).estimates.values()
            for column in (found.log_theta, found.log_sigma)
        ]
        value = np.stack(columns, axis=-1).astype(np.float32)[None]
        yield TraceBlock(run.spec, np.array([ratios.time_ns], np.int64), value)
        location = run.worker.locate(ratios, noise)
        found = place_candidate(ratios.time_ns, location)
        block, run.carry = decided_block(run.spec, found, run.worker, self.parameters, run.carry)
        yield block
        if block.accepted[0]:
            if run.doubt:
                yield Note(ratios.time_ns, run.doubt, "WARN", self.name)
                run.doubt = ""
            yield location.fix(ratios.time_ns, f"{self.plugin} {self.parameters.method}", self.name)
