"""The stage that tells types of steps: forward, backward, left or right."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Gap, Note, StageSpec, StepEvent
from groundtrace_codecs.signals import SignalBlock

from .gates import Candidates, Carry, decided_block, gate_specs
from .stage import PluginStage

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event

    from .steptypes.classifier import StepTypes
    from .steptypes.follower import Follower


@dataclass(slots=True)
class _Run:
    """The steps of one topic; ``follower`` is None where its stream does not do."""

    spec: StageSpec
    follower: Follower | None
    carry: Carry = field(default_factory=Carry)


class StepTypeStage(PluginStage["StepTypes"]):
    """Tells the types of the steps that one stage finds in accelerations of three axes.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    stepping
        The stage whose steps it takes.

    Notes
    -----
    Each step has one candidate for each type. That of the accepted one is given as a step again,
    with its type and of this stage; a step without an accepted type is not given again. Steps come
    out in the order of time. A gap that is not bridged ends all walks.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[StepTypes],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        stepping: str,
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.stepping = stepping
        self._sources: set[str] = set()
        self._early: dict[str, list[StepEvent]] = {}  # steps of a topic not heard of yet
        self._runs: dict[str, _Run] = {}

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Take signal and steps; give the steps whose types are known."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.stepping:
                if self.allowed(topic):
                    self._sources.add(topic)
            case StepEvent(stage=stage, topic=topic) if stage == self.stepping:
                if topic in self._sources:
                    self._step(item)
            case SignalBlock() if len(item) and item.topic in self._sources:
                yield from self._hear(item)
            case Gap(bridged=False, topic=topic) if topic in self._runs:
                yield from self._end(self._runs[topic])

    def flush(self) -> Iterator[Event]:
        """Give the steps that waited for others."""
        for run in self._runs.values():
            yield from self._end(run)

    def _step(self, step: StepEvent) -> None:
        """Remember a step until the block comes that it was found in."""
        run = self._runs.get(step.topic)
        if run is None:
            self._early.setdefault(step.topic, []).append(step)
        elif run.follower is not None:
            run.follower.step(step)

    def _hear(self, block: SignalBlock) -> Iterator[Event]:
        run = self._runs.get(block.topic)
        if run is None:
            self._runs[block.topic] = run = self._begin(block)
            if run.follower is None:
                text = f"{block.topic}: no types of steps: expected accelerations along x, y and z"
                yield Note(block.start_ns, text, "WARN", self.name)
            else:
                yield run.spec
        if run.follower is not None:
            run.follower.hear(block)
            yield from self._told(run)

    def _begin(self, block: SignalBlock) -> _Run:
        from .steptypes.axes import BodyAxes
        from .steptypes.follower import Follower

        worker = self.kind(self.parameters)
        spec = StageSpec(
            self.name,
            self.plugin,
            block.topic,
            worker.channels,
            worker.columns,
            gate_specs(worker.gates, self.parameters),
            (),
            worker.emits,
        )
        follower = Follower(worker) if BodyAxes.fits(block.stream) else None
        for step in self._early.pop(block.topic, []):
            if follower is not None:
                follower.step(step)
        return _Run(spec, follower)

    def _end(self, run: _Run) -> Iterator[Event]:
        if run.follower is not None:
            yield from self._told(run, final=True)
            run.follower.end()
            run.carry = Carry()

    def _told(self, run: _Run, *, final: bool = False) -> Iterator[Event]:
        told = [] if run.follower is None else list(run.follower.told(final=final))
        if not told:
            return
        types = len(run.spec.channels)
        found = Candidates(
            np.repeat([step.time_ns for step, _ in told], types),
            np.tile(np.arange(types, dtype=np.int32), len(told)),
            np.array([row for _, rows in told for row in rows], np.float32),
        )
        block, run.carry = decided_block(run.spec, found, self.kind, self.parameters, run.carry)
        yield block
        last = -1
        for row in np.flatnonzero(block.accepted).tolist():
            place = row // types
            if place > last:
                name = run.spec.channels[int(block.channel[row])]
                value = float(block.value[row, 0])
                yield self._typed(told[place][0], name, value)
            last = place

    def _typed(self, step: StepEvent, kind: str, value: float) -> StepEvent:
        """Return a step again, with its type."""
        return StepEvent(
            time_ns=step.time_ns,
            kind=step.kind,
            foot=step.foot,
            topic=step.topic,
            stage=self.name,
            value=value,
            channels=step.channels,
            type=kind,
        )
