"""The stage that finds headings: the streams of one body-worn sensor are fused."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Gap, Heading, Note, StageSpec
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .gates import Candidates, decided_block, gate_specs
from .heading.aligned import PATIENCE_NS, QUANTITIES, Aligner, columns_of_axes
from .heading.api import HeadingFrames
from .heading.disturbed_spans import DisturbedSpans
from .later import Later
from .rounds import Rounds
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .heading import frame_kernels
    from .heading.api import HeadingFrame, HeadingMethod
else:
    frame_kernels = Later("groundtrace.heading.frame_kernels")


@dataclass(slots=True)
class _Run:
    """A heading filter at work on one sensor."""

    topic: str
    method: HeadingMethod
    spec: StageSpec
    spans: DisturbedSpans
    period_ns: float
    aligner: Aligner = field(default_factory=Aligner)
    due_ns: int | None = None
    told: frozenset[str] = frozenset()


class HeadingStage(PluginStage["HeadingMethod"]):
    """Runs one heading filter on every sensor with a gyroscope and an accelerometer.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.

    Notes
    -----
    Streams of one placement are one sensor: its magnetometer may have a topic of its own. Each
    frame is a candidate, accepted where the field is undisturbed. A gap of the gyroscope that is
    not bridged, and a step of its clock, begin anew; other gaps leave the field or the force out.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[HeadingMethod],
        parameters: Any,
        topics: Sequence[str] = (),
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self._runs: dict[str, _Run] = {}
        self._early: dict[str, list[SignalBlock]] = {}
        self._rounds = Rounds("angular_velocity")

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Feed blocks to their sensors' filters, or end a run at a gap."""
        wanted = isinstance(item, SignalBlock) and len(item) and self._wanted(item.stream)
        if isinstance(item, Gap) or (isinstance(item, SignalBlock) and wanted):
            yield from self._take(self._rounds.add(item))

    def flush(self) -> Iterator[Event]:
        """End all runs."""
        yield from self._take(self._rounds.finish())
        for run in self._runs.values():
            yield from self._finish(run)

    def _take(self, items: Sequence[SignalBlock | Gap]) -> list[Event]:
        """Take a round of all streams."""
        found: list[Event] = []
        for item in items:
            found += self._interrupted(item) if isinstance(item, Gap) else self._hear(item)
        for sensor, kept in self._early.items():
            oldest_ns = kept[-1].start_ns - PATIENCE_NS
            self._early[sensor] = [block for block in kept if block.last_ns >= oldest_ns]
        return found

    def _hear(self, block: SignalBlock) -> list[Event]:
        found: list[Event] = []
        sensor = block.stream.placement
        if sensor not in self._runs and not columns_of_axes(block.stream, "angular_velocity"):
            self._early.setdefault(sensor, []).append(block)
            return found
        if sensor not in self._runs:
            self._runs[sensor] = self._begin(block.stream)
            found.append(self._runs[sensor].spec)
            for early in self._early.pop(sensor, []):
                self._runs[sensor].aligner.hear(early)
        run = self._runs[sensor]
        run.aligner.hear(block)
        if run.aligner.remark and run.aligner.remark not in run.told:
            run.told |= {run.aligner.remark}
            found.append(Note(block.start_ns, run.aligner.remark, "WARN", self.name))
        return found + self._frames(run, run.method.add(run.aligner.take()))

    def _wanted(self, stream: Stream) -> bool:
        allowed = self.allowed(stream.topic)
        return allowed and any(columns_of_axes(stream, quantity) for quantity in QUANTITIES)

    def _begin(self, stream: Stream) -> _Run:
        method = self.kind(self.parameters, stream.rate_hz)
        spec = StageSpec(
            stage=self.name,
            plugin=self.plugin,
            topic=stream.topic,
            channels=("field",),
            columns=method.columns,
            gates=gate_specs(method.gates, self.parameters),
            trace=(),
            emits="heading",
        )
        spans = DisturbedSpans(self.name, round(self.parameters.join_s * NS_PER_S))
        return _Run(stream.topic, method, spec, spans, stream.period_ns)

    def _interrupted(self, gap: Gap) -> list[Event]:
        found: list[Event] = []
        for sensor, run in list(self._runs.items()):
            if run.topic == gap.topic and not gap.bridged:
                found += self._finish(run)
                del self._runs[sensor]
        return found

    def _finish(self, run: _Run) -> list[Event]:
        frames = [*run.method.add(run.aligner.finish()), *run.method.finish()]
        return [*self._frames(run, frames), *run.spans.finish()]

    def _frames(self, run: _Run, given: Sequence[HeadingFrame]) -> list[Event]:
        """Return what frames say: the tests of the field, disturbances, headings, notes."""
        if not given:
            return []
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        said: list[Event] = []
        tested = np.flatnonzero(frames.compass)
        if len(tested):
            found = Candidates(
                frames.time_ns[frames.first[tested]],
                np.zeros(len(tested), np.int32),
                frames.values[tested].astype(np.float32),
            )
            said.append(decided_block(run.spec, found, run.method, self.parameters)[0])
        said += self._disturbances(run, frames)
        said += self._headings(run, frames)
        said += self._notes(run, frames)
        return said

    def _disturbances(self, run: _Run, frames: HeadingFrames) -> Iterator[Event]:
        """Yield the disturbances that are over."""
        disturbed = frames.compass & ~frames.undisturbed
        if not (disturbed.any() or run.spans.under_way):
            return
        starts_ns = frames.time_ns[frames.first[:-1]].tolist()
        ends_ns = (frames.time_ns[frames.first[1:] - 1] + run.period_ns).astype(np.int64).tolist()
        offs = np.where(frames.compass, frames.values[:, 0], np.nan).tolist()
        for start_ns, end_ns, off, bad in zip(
            starts_ns, ends_ns, offs, disturbed.tolist(), strict=True
        ):
            yield from run.spans.add(start_ns, end_ns, off, disturbed=bad)

    def _headings(self, run: _Run, frames: HeadingFrames) -> Iterator[Heading]:
        """Return the headings that are due."""
        every_ns = max(NS_PER_S / self.parameters.output_hz, run.period_ns)
        due_ns = -1 if run.due_ns is None else run.due_ns
        due, run.due_ns = frame_kernels.due_places(frames.time_ns, due_ns, every_ns, run.period_ns)
        sigma = np.repeat(frames.sigma_rad, frames.lengths)[due]
        columns = (frames.time_ns[due], frames.heading_rad[due], sigma)
        return map(Heading, *(x.tolist() for x in columns), repeat(self.name))

    def _notes(self, run: _Run, frames: HeadingFrames) -> Iterator[Note]:
        """Yield what a person should know, each once."""
        for place, texts in frames.notes.items():
            for text in texts:
                if text not in run.told:
                    run.told |= {text}
                    time_ns = int(frames.time_ns[frames.first[place + 1] - 1])
                    yield Note(time_ns, f"{run.topic}: {text}", "INFO", self.name)
