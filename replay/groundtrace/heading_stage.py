"""The stage that finds headings: the streams of one body-worn sensor are fused."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Gap, Heading, Note, StageSpec
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .gates import Candidates, decided_block, gate_specs
from .heading.aligned import PATIENCE_NS, QUANTITIES, Aligner, columns_of_axes
from .heading.disturbed_spans import DisturbedSpans
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .heading.api import HeadingFrame, HeadingMethod


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

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Feed a block to its sensor's filter, or end a run at a gap."""
        if isinstance(item, Gap):
            yield from self._interrupted(item)
        elif isinstance(item, SignalBlock) and len(item) and self._wanted(item.stream):
            sensor = item.stream.placement
            if sensor not in self._runs and not columns_of_axes(item.stream, "angular_velocity"):
                kept = self._early.setdefault(sensor, [])
                kept.append(item)
                while kept[0].last_ns < item.start_ns - PATIENCE_NS:
                    kept.pop(0)
                return
            if sensor not in self._runs:
                self._runs[sensor] = self._begin(item.stream)
                yield self._runs[sensor].spec
                for early in self._early.pop(sensor, []):
                    self._runs[sensor].aligner.hear(early)
            run = self._runs[sensor]
            run.aligner.hear(item)
            yield from self._frames(run, run.method.add(run.aligner.take()))

    def flush(self) -> Iterator[Event]:
        """End all runs."""
        for run in self._runs.values():
            yield from self._finish(run)

    def save(self) -> Any:
        """Return a copy of everything that crosses blocks."""
        return copy.deepcopy((self._runs, self._early))

    def restore(self, saved: Any) -> None:
        """Go on from what :meth:`save` returned."""
        self._runs, self._early = copy.deepcopy(saved)

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

    def _interrupted(self, gap: Gap) -> Iterator[Event]:
        for sensor, run in list(self._runs.items()):
            if run.topic == gap.topic and not gap.bridged:
                yield from self._finish(run)
                del self._runs[sensor]

    def _finish(self, run: _Run) -> Iterator[Event]:
        frames = [*run.method.add(run.aligner.finish()), *run.method.finish()]
        yield from self._frames(run, frames)
        yield from run.spans.finish()

    def _frames(self, run: _Run, frames: Sequence[HeadingFrame]) -> Iterator[Event]:
        """Yield what frames say: the tests of the field, disturbances, headings, notes."""
        tested = [frame for frame in frames if frame.compass]
        if tested:
            found = Candidates(
                np.array([frame.time_ns[0] for frame in tested], np.int64),
                np.zeros(len(tested), np.int32),
                np.array([frame.values for frame in tested], np.float32),
            )
            yield decided_block(run.spec, found, run.method, self.parameters)[0]
        for frame in frames:
            start_ns, end_ns = int(frame.time_ns[0]), int(frame.time_ns[-1] + run.period_ns)
            off = float(frame.values[0]) if frame.compass else math.nan
            disturbed = frame.compass and not frame.undisturbed
            yield from run.spans.add(start_ns, end_ns, off, disturbed=disturbed)
            yield from self._headings(run, frame)
        yield from self._notes(run, frames)

    def _headings(self, run: _Run, frame: HeadingFrame) -> Iterator[Heading]:
        """Yield the headings of a frame that are due."""
        every_ns = max(NS_PER_S / self.parameters.output_hz, run.period_ns)
        for time_ns, heading in zip(
            frame.time_ns.tolist(), frame.heading_rad.tolist(), strict=True
        ):
            if run.due_ns is None or time_ns >= run.due_ns - run.period_ns / 2:
                yield Heading(time_ns, heading, frame.sigma_rad, self.name)
                passed = 0 if run.due_ns is None else run.due_ns
                run.due_ns = round(max(passed, time_ns - every_ns / 2) + every_ns)

    def _notes(self, run: _Run, frames: Sequence[HeadingFrame]) -> Iterator[Note]:
        """Yield what a person should know, each once."""
        for frame in frames:
            for text in frame.notes:
                if text not in run.told:
                    run.told |= {text}
                    yield Note(int(frame.time_ns[-1]), f"{run.topic}: {text}", "INFO", self.name)
