"""The stage that runs an array method: the waveforms around each step are looked at together."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Gap, Note, Pick, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.signals import NS_PER_S

from .array_method import Window
from .gates import Carry, decided_block, gate_specs
from .recall import Recall
from .stage import PluginStage, accepted_events

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from .array_method import ArrayMethod


@dataclass(slots=True)
class _Run:
    """An array method at work on one topic, once there are steps to look at.

    ``lacking`` says what it cannot work without; it is said once, with the first step.
    """

    columns: list[int]
    recall: Recall
    worker: ArrayMethod
    spec: StageSpec | None = None
    lacking: str = ""
    carry: Carry = field(default_factory=Carry)


class ArrayStage(PluginStage["ArrayMethod"]):
    """Runs one array method on the steps found in every stream whose channels it wants.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    picking, stepping
        The stages whose picks and steps it takes.
    window_s
        How long after a step's first pick others still belong to it [s].
    geometry
        Where the sensors are; None where unknown.

    Notes
    -----
    :meth:`remember` hears each block before any stage processes it: a step that the block brings
    about is then found with its waveforms. What is found of a step comes before the step itself
    reaches the stages behind, so that a localizer there has it. Where a stream or its site lacks
    what the method needs, a note says so and nothing comes of it.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[ArrayMethod],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        picking: str,
        stepping: str,
        window_s: float,
        geometry: Geometry | None = None,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.picking = picking
        self.stepping = stepping
        self.window_s = window_s
        self.geometry = geometry or Geometry()
        self._runs: dict[str, _Run | None] = {}

    def remember(self, block: SignalBlock) -> None:
        """Hear a block before the stages before this one say what is in it."""
        if block.topic not in self._runs:
            self._runs[block.topic] = self._prepared(block)
        run = self._runs[block.topic]
        if run is not None:
            run.recall.hear(block.select(run.columns))

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Begin at the stage that finds steps, gather picks, and examine steps."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.stepping:
                yield from self._begin(topic)
            case Pick(stage=stage, topic=topic) if stage == self.picking:
                if (run := self._running(topic)) is not None:
                    run.recall.pick(item)
            case StepEvent(stage=stage, topic=topic) if stage == self.stepping:
                if (run := self._running(topic)) is not None:
                    yield from self._examined(run, item.time_ns)
                elif (run := self._runs.get(topic)) is not None and run.lacking:
                    yield Note(item.time_ns, f"{topic}: {run.lacking}", "WARN", self.name)
                    run.lacking = ""
            case Gap(reason="clock step", bridged=False, topic=topic):
                if (run := self._running(topic)) is not None:
                    run.recall.forget()
                    run.carry = Carry()

    def flush(self) -> Iterator[Event]:
        """Yield nothing: no step is held back."""
        yield from ()

    def _prepared(self, block: SignalBlock) -> _Run | None:
        columns = block.stream.columns_of(self.kind.quantities)
        allowed = self.allowed(block.topic)
        if not (columns and allowed):
            return None
        p = self.parameters
        before, after, window = (
            round(s * NS_PER_S) for s in (p.before_s, p.after_s, self.window_s)
        )
        stream = block.stream.select(columns)
        ahead_s = self.geometry.clock_offsets(c.name for c in stream.channels)
        recall = Recall(stream, before, after, window, ahead_s)
        return _Run(columns, recall, self.kind(self.parameters))

    def _running(self, topic: str) -> _Run | None:
        run = self._runs.get(topic)
        return run if run is not None and run.spec is not None else None

    def _begin(self, topic: str) -> Iterator[Event]:
        run = self._runs.get(topic)
        if run is None:
            return
        names = run.worker.start(run.recall.stream, self.geometry)
        if names:
            gates = gate_specs(run.worker.gates, self.parameters)
            columns, emits = run.worker.columns, run.worker.emits
            run.spec = StageSpec(self.name, self.plugin, topic, names, columns, gates, (), emits)
            yield run.spec
        else:
            run.lacking = f"no {run.worker.emits}s: expected {run.worker.needs}, found none"

    def _examined(self, run: _Run, step_ns: int) -> Iterator[Event]:
        assert run.spec is not None  # asked for by _running
        start_ns, values = run.recall.window(step_ns)
        arrivals = run.recall.arrivals(step_ns, start_ns)
        rate_hz = run.recall.stream.rate_hz
        found = run.worker.examine(Window(step_ns, start_ns, rate_hz, values, arrivals))
        if len(found):
            found = found.not_before(run.recall.first_ns or 0)
            block, run.carry = decided_block(
                run.spec, found, run.worker, self.parameters, run.carry
            )
            yield block
            yield from accepted_events(block)
