"""Deciding again: the same ``decide`` on stored candidates, with other thresholds.

Equal, decision by decision, to a fresh replay with those thresholds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Pick, StageSpec, StepEvent

from ..errors import PipelineError
from ..gates import Candidates, decided_block, gate_specs
from ..parameters import build, describe
from ..plugins import stage_named
from ..score import match_steps
from ..stage import StageRunner, accepted_events, associates, detects

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from ..pipeline import StageConfig
    from ..score import StepMatch
    from .evidence import Evidence

#: A setting: (stage, parameter) to value.
Settings = Mapping[tuple[str, str], Any]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a pipeline decides.

    Attributes
    ----------
    blocks
        Decided candidates of each stage and topic.
    events
        Picks and steps of all stages.
    """

    blocks: tuple[CandidateBlock, ...]
    events: tuple[Pick | StepEvent, ...]

    def step_times(self) -> NDArray[np.int64]:
        """Return the times of the steps of the last stage that emits them [ns]."""
        stage = next((b.spec.stage for b in reversed(self.blocks) if b.spec.emits == "step"), "")
        times = [e.time_ns for e in self.events if isinstance(e, StepEvent) and e.stage == stage]
        return np.array(times, np.int64)


@dataclass(frozen=True, slots=True)
class Counts:
    """True positives, false positives and false negatives of steps."""

    tp: int
    fp: int
    fn: int

    @classmethod
    def of(cls, matching: StepMatch) -> Counts:
        """Count a match."""
        tp = len(matching.pairs)
        return cls(tp, len(matching.found_ns) - tp, len(matching.truth_ns) - tp)


class Redecider:
    """Decides the evidence of one result with other settings.

    Parameters
    ----------
    evidence
        What was stored.

    Raises
    ------
    PipelineError
        Where a setting changes what was measured: that needs a replay.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        found = [(stage, stage_named(stage.use)) for stage in evidence.config.stage]
        #: Configuration and class of each stage that decides about steps.
        self.stages = [each for each in found if detects(each[1]) or associates(each[1])]
        self._unchanged = {
            stage.key: build(kind.Parameters, stage.parameters, stage.key)
            for stage, kind in self.stages
        }

    def outcome(
        self, settings: Settings | None = None, span_ns: tuple[int, int] | None = None
    ) -> Outcome:
        """Decide with some parameters changed; only candidates inside ``span_ns`` where given."""
        blocks: list[CandidateBlock] = []
        events: list[Pick | StepEvent] = []
        picking = ""
        for stage, kind in self.stages:
            parameters = self.parameters(stage, kind, settings or {})
            found: Iterable[Event]
            if detects(kind):
                found = self._detector(stage.key, kind, parameters, span_ns)
            else:
                runner = StageRunner(stage, kind, parameters, {kind.takes[0]: (picking,)})
                found = associated(runner, _sources(picking, blocks, events))
            picking = stage.key if Pick in kind.gives else picking
            for item in found:
                if isinstance(item, CandidateBlock):
                    blocks.append(item)
                elif isinstance(item, Pick | StepEvent):
                    events.append(item)
        return Outcome(tuple(blocks), tuple(events))

    def matching(self, settings: Settings | None = None, tolerance_s: float = 0.12) -> StepMatch:
        """Decide, and match the steps to the truth."""
        e = self.evidence
        times = self.outcome(settings).step_times()
        return match_steps(e.labels, times, e.start_ns, e.end_ns, tolerance_s)

    def whole_numbers(self, stage: str) -> set[str]:
        """Return the parameters of a stage that are integers."""
        kinds = [kind for config, kind in self.stages if config.key == stage]
        infos = [info for kind in kinds for info in describe(kind.Parameters)]
        return {info.name for info in infos if isinstance(info.default, int)}

    def parameters(self, stage: StageConfig, kind: Any, settings: Settings) -> Any:
        """Return a stage's parameters, checked to be decidable from the evidence."""
        changed = {name: value for (key, name), value in settings.items() if key == stage.key}
        if not changed:
            return self._unchanged[stage.key]
        parts = {info.name: info.part for info in describe(kind.Parameters)}
        # what an associator measures are picks, and those are decided again too
        signal = not associates(kind)
        for name in changed:
            if signal and parts.get(name) == "measure":
                raise PipelineError(
                    f"{stage.key}.{name}: expected a gate's parameter, found one of the signal "
                    f"path: it needs a replay"
                )
        parameters = build(kind.Parameters, {**stage.parameters, **changed}, stage.key)
        self._check_floor(stage.key, kind, parameters, changed)
        return parameters

    def _check_floor(
        self, key: str, kind: Any, parameters: Any, changed: Mapping[str, Any]
    ) -> None:
        """Refuse a threshold under the floor: candidates below it were not stored."""
        if "floor" not in {f.name for f in fields(parameters)}:
            return
        first = kind.columns[0].name
        for gate in kind.gates:
            under = gate.name == first and getattr(parameters, gate.parameter) < parameters.floor
            if under and gate.parameter in changed:
                raise PipelineError(
                    f"{key}.{gate.parameter}: expected at least the stored floor "
                    f"{parameters.floor:g}, found {getattr(parameters, gate.parameter):g}: it "
                    f"needs a replay with a lower {key}.floor"
                )

    def _detector(
        self, key: str, kind: Any, parameters: Any, span_ns: tuple[int, int] | None
    ) -> Iterator[Event]:
        for part in self.evidence.of(key):
            candidates = part.candidates
            if span_ns is not None:
                candidates = candidates.rows(part.between(*span_ns))
            spec = replace(part.spec, gates=gate_specs(kind.gates, parameters))
            yield from self._decided(spec, kind, parameters, candidates)

    def _decided(
        self, spec: StageSpec, kind: Any, parameters: Any, candidates: Candidates
    ) -> Iterator[Event]:
        block, _ = decided_block(spec, candidates, kind, parameters)
        yield block
        yield from accepted_events(block)


def _sources(
    stage: str, blocks: Sequence[CandidateBlock], events: Sequence[Pick | StepEvent]
) -> Iterator[tuple[StageSpec, list[Pick]]]:
    """Yield what a stage picked, topic by topic."""
    for block in blocks:
        if block.spec.stage == stage:
            topic = block.spec.topic
            found = [e for e in events if isinstance(e, Pick) and e.stage == stage]
            yield block.spec, [pick for pick in found if pick.topic == topic]


def associated(
    runner: StageRunner, sources: Iterable[tuple[StageSpec, Iterable[Pick]]]
) -> list[Event]:
    """Feed the picks of a stage to a fresh associator, topic by topic.

    Parameters
    ----------
    runner
        The associator.
    sources
        What its source picked, and under which specification.

    Returns
    -------
    What it states, its decided candidates, one block for each topic, then their events.
    """
    given: list[Event] = []
    for spec, picks in sources:
        given += [spec, *picks]
    return runner.rerun(given)
