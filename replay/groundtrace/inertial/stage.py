"""The stage that navigates: the signal of a sensor on a foot becomes a track."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Gap, Note, StageSpec
from groundtrace_codecs.signals import SignalBlock

from ..gates import Carry, decided_block, gate_specs
from ..heading.aligned import columns_of_axes
from ..nonfinite import Holder
from ..stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .navigator import FootNavigator
    from .stances import Segment, SegmentRun, Segments

#: Sampled slower, the samples do not tell how fast a foot went between them.
LEAST_RATE_HZ = 25.0
QUANTITIES = ("angular_velocity", "acceleration")
#: With the magnetometer's, where the stream has one.
COLUMNS = 9


@dataclass(slots=True)
class _Run:
    """A navigator at work on one topic; ``segments`` is None between two runs of samples."""

    worker: FootNavigator
    spec: StageSpec
    columns: list[int]
    segments: Segments | None = None
    carry: Carry = field(default_factory=Carry)
    holder: Holder = field(default_factory=Holder)


class NavigatorStage(PluginStage["FootNavigator"]):
    """Runs one navigator on every stream of a foot that has three axes of each sensor.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.

    Notes
    -----
    Streams whose placement is given and is no foot are left alone. A bridged gap changes nothing;
    any other ends the track, and the next begins at the origin again: nothing says how far the
    foot came meanwhile.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[FootNavigator],
        parameters: Any,
        topics: Sequence[str] = (),
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self._runs: dict[str, _Run | None] = {}
        self._tracks = 0

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Feed a block to the navigator, or end its track at a gap."""
        if isinstance(item, Gap):
            run = self._runs.get(item.topic)
            if run is not None and not item.bridged:
                yield from self._finish(run)
        elif isinstance(item, SignalBlock) and len(item):
            if item.topic not in self._runs:
                yield from self._begin(item)
            run = self._runs[item.topic]
            if run is not None:
                yield from self._feed(run, item.select(run.columns))

    def flush(self) -> Iterator[Event]:
        """End all tracks."""
        for run in self._runs.values():
            if run is not None:
                yield from self._finish(run)

    def _begin(self, block: SignalBlock) -> Iterator[Event]:
        stream = block.stream
        self._runs[block.topic] = None
        allowed = self.allowed(stream.topic)
        if not allowed or "foot" not in (stream.placement or "foot"):
            return
        columns = inertial_columns(stream)
        if columns is None:
            if stream.placement:
                text = (
                    f"{stream.topic}: no track: expected three axes of {' and '.join(QUANTITIES)}"
                )
                yield Note(block.start_ns, f"{text}, found others", "WARN", self.name)
            return
        worker = self.kind(self.parameters)
        gates = gate_specs(worker.gates, self.parameters)
        names = ("foot",)
        spec = StageSpec(
            self.name, self.plugin, stream.topic, names, worker.columns, gates, (), worker.emits
        )
        self._runs[block.topic] = _Run(worker, spec, columns)
        yield spec
        if stream.rate_hz < LEAST_RATE_HZ:
            text = f"{stream.topic}: a swing of a foot needs {LEAST_RATE_HZ:g} Hz to be followed"
            yield Note(block.start_ns, f"{text}, found {stream.rate_hz:g}", "WARN", self.name)

    def _feed(self, run: _Run, block: SignalBlock) -> Iterator[Event]:
        if run.segments is None:
            self._tracks += 1
            run.worker.start(self.name, self._tracks)
            run.segments = self._segments(block.stream.rate_hz)
        held = run.holder.held(block)
        values = held.values
        if values.shape[1] < COLUMNS:
            values = np.pad(values, ((0, 0), (0, 3)), constant_values=np.nan)
        yield from self._navigate(run, run.segments.add(held.sample_times(), values))

    def _finish(self, run: _Run) -> Iterator[Event]:
        if run.segments is None:
            return
        for segments in run.segments.finish():
            yield from self._navigate(run, segments)
        yield from run.worker.finish()
        if run.holder.count:
            text = f"{run.spec.topic}: {run.holder.count} samples not finite, last value held"
            yield Note(run.holder.last_ns, text, "WARN", self.name)
        run.segments, run.carry, run.holder = None, Carry(), Holder()

    def _navigate(self, run: _Run, segments: SegmentRun) -> Iterator[Event]:
        at = 0
        while at < len(segments):
            at, points = run.worker.go_on(segments, at)
            yield from points
            if at < len(segments):
                yield from self._decide(run, segments[at])
                at += 1

    def _decide(self, run: _Run, segment: Segment) -> Iterator[Event]:
        """Go on by a segment with which a stance may begin."""
        found = run.worker.measure(segment)
        accepted = None
        if len(found):
            block, run.carry = decided_block(
                run.spec, found, run.worker, self.parameters, run.carry
            )
            yield block
            accepted = bool(block.accepted[0])
        yield from run.worker.follow(segment, accepted)

    def _segments(self, rate_hz: float) -> Segments:
        # what filters is not imported where pipelines are only listed
        from ..detectors.zupt import ZeroVelocityParameters
        from .stances import Segments

        p = self.parameters
        statistic = ZeroVelocityParameters(
            p.window_s, p.acceleration_sigma, p.rotation_sigma, stride_s=p.stride_s
        )
        return Segments(rate_hz, statistic)


def inertial_columns(stream: Stream) -> list[int] | None:
    """Return the columns of rate and force, x, y, z each, and of the magnetic field if it is there.

    None where rate or force do not have three axes.
    """
    columns = []
    for quantity in (*QUANTITIES, "magnetic_field"):
        found = columns_of_axes(stream, quantity)
        if not found and quantity in QUANTITIES:
            return None
        columns += found
    return columns
