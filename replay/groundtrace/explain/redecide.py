"""Deciding again: the same ``decide`` on stored candidates, with other thresholds.

The result equals, decision by decision, a fresh replay with those thresholds.
:func:`~.pipeline.gates.decide` decides here as everywhere.

Thousands of settings are tried in turn, from stored candidates to steps or passes. To be fast, a
gate is evaluated again only where its threshold, or what reaches it, has changed, and only for
candidates that passed the gates before it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.errors import did_you_mean
from groundtrace_codecs.events import CandidateBlock, Pick, StageSpec, StepEvent

from ..errors import PipelineError, RecordingError, SettingError
from ..evaluation.matching import STEP_TOLERANCE_S, match_steps
from ..pipeline.gates import Candidates, GateState, decide, decided_block, gate_specs, stated
from ..pipeline.parameters import build, describe, parse_value
from ..pipeline.plugins import stage_named
from ..pipeline.stage import StageRunner, accepted_events, associates, detects, emitted
from .reasons import event_noun, scored_event, times_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event, GateSpec

    from ..evaluation.matching import StepMatch
    from ..pipeline.config import PipelineConfig
    from ..pipeline.parameters import ParameterInfo, StageConfig
    from ..pipeline.results import Evidence

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


class OfflineDecider:
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
        stage_kinds = [(stage, stage_named(stage.use)) for stage in evidence.config.stage]
        #: Configuration and class of each stage that decides about steps.
        self.stages = [each for each in stage_kinds if detects(each[1]) or associates(each[1])]
        self._unchanged = {
            stage.key: build(kind.Parameters, stage.parameters, stage.key)
            for stage, kind in self.stages
        }

    @property
    def untried(self) -> str:
        """The stage that gives the steps, where it takes signal and steps: it takes a replay."""
        steps = [p.spec.stage for p in self.evidence.stages if p.spec.emits == "step"]
        decided = {stage.key for stage, _ in self.stages}
        return steps[-1] if steps and steps[-1] not in decided else ""

    def outcome(
        self, settings: Settings | None = None, span_ns: tuple[int, int] | None = None
    ) -> Outcome:
        """Decide with some parameters changed; only candidates inside ``span_ns`` where given."""
        blocks: list[CandidateBlock] = []
        events: list[Pick | StepEvent] = []
        picking = ""
        for stage, kind in self.stages:
            parameters = self.parameters(stage, kind, settings or {})
            stage_events: Iterable[Event]
            if detects(kind):
                stage_events = self._detector(stage.key, kind, parameters, span_ns)
            else:
                runner = StageRunner(stage, kind, parameters, {kind.takes[0]: (picking,)})
                stage_events = associated(runner, _sources(picking, blocks, events))
            picking = stage.key if Pick in kind.gives else picking
            for item in stage_events:
                if isinstance(item, CandidateBlock):
                    blocks.append(item)
                elif isinstance(item, Pick | StepEvent):
                    events.append(item)
        return Outcome(tuple(blocks), tuple(events))

    def matching(
        self, settings: Settings | None = None, tolerance_s: float = STEP_TOLERANCE_S
    ) -> StepMatch:
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
            candidates, carry = part.candidates, part.carried()
            if span_ns is not None:
                candidates, carry = candidates.rows(part.between(*span_ns)), GateState()
            spec = replace(part.spec, gates=gate_specs(stated(kind.gates, part.spec), parameters))
            block, _ = decided_block(spec, candidates, kind, parameters, carry)
            yield block
            yield from accepted_events(block)


def _sources(
    stage: str, blocks: Sequence[CandidateBlock], events: Sequence[Pick | StepEvent]
) -> Iterator[tuple[StageSpec, list[Pick]]]:
    """Yield what a stage picked, topic by topic."""
    for block in blocks:
        if block.spec.stage == stage:
            topic = block.spec.topic
            picks = [e for e in events if isinstance(e, Pick) and e.stage == stage]
            yield block.spec, [pick for pick in picks if pick.topic == topic]


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


#: What passed a stage on one topic.
Passed = tuple["StageSpec", Candidates]


class GateCascade:
    """The gates of one stage and topic; remembers what passed each of them last.

    Parameters
    ----------
    spec
        What the candidates are.
    gates
        In order.
    candidates
        What they decide on.
    carry
        What decisions before left behind.
    """

    def __init__(
        self,
        spec: StageSpec,
        gates: Sequence[Any],
        candidates: Candidates,
        carry: GateState | None = None,
    ) -> None:
        self.spec = spec
        self.gates = gates
        self.candidates = candidates
        self._carry = carry
        self._last: list[tuple[float, Candidates]] = []

    def within(self, start_ns: int, end_ns: int) -> GateCascade:
        """Return the same of the candidates with start <= time <= end."""
        times = self.candidates.time_ns
        rows = np.flatnonzero((times >= start_ns) & (times <= end_ns))
        return GateCascade(self.spec, self.gates, self.candidates.rows(rows))

    def passed(self, parameters: Any) -> Candidates:
        """Return the candidates that pass every gate."""
        passing = self.candidates
        for depth, gate in enumerate(self.gates):
            threshold = float(getattr(parameters, gate.parameter))
            if depth < len(self._last) and self._last[depth][0] != threshold:
                del self._last[depth:]
            if depth == len(self._last):
                given = passing, self.spec.columns, (gate,), parameters
                decisions, _ = decide(*given, self._carry)
                self._last.append((threshold, passing.rows(decisions.accepted)))
            passing = self._last[depth][1]
        return passing


class ChainStage:
    """One stage on the way; runs again only where something it depends on has changed.

    Parameters
    ----------
    stage, kind
        Its configuration and plugin.
    axes
        What is swept; those of other stages are left alone.
    """

    def __init__(self, stage: StageConfig, kind: Any, axes: Sequence[Axis]) -> None:
        self.stage = stage
        self.kind = kind
        self.base = build(kind.Parameters, stage.parameters, stage.key)
        stage_axes = [(i, axis.parameter) for i, axis in enumerate(axes) if axis.stage == stage.key]
        gates = [gate.parameter for gate in kind.gates]
        rank = {name: 1 + gates.index(name) for _, name in stage_axes if name in gates}
        #: Places in a setting of this stage's values, what changes most first.
        self.setting_axes = sorted(stage_axes, key=lambda item: rank.get(item[1], 0))
        self._measured = [i for i, name in stage_axes if name not in gates]
        self.sieves: list[GateCascade] = []
        self._values: tuple[Any, ...] | None = None
        self._passed: list[Passed] = []
        self._before: tuple[Any, ...] | None = None

    def load(self, sieves: list[GateCascade]) -> None:
        """Take the candidates to decide on."""
        self.sieves = sieves

    def run(self, setting: Sequence[Any]) -> list[Passed]:
        """Return what passes, topic by topic; the same list where nothing changed."""
        values = tuple(setting[i] for i, _ in self.setting_axes)
        if values != self._values:
            self._values = values
            parameters = self.parameters(setting)
            self._passed = [(sieve.spec, sieve.passed(parameters)) for sieve in self.sieves]
        return self._passed

    def parameters(self, setting: Sequence[Any]) -> Any:
        """Return the stage's parameters under a setting."""
        return replace(self.base, **{name: setting[i] for i, name in self.setting_axes})

    def associate(self, before: ChainStage, passed: list[Passed], setting: Sequence[Any]) -> None:
        """Group what passed the stage before anew, where that or how to group it changed."""
        measured = tuple(setting[i] for i in self._measured)
        if self._before is not None and self._before[0] is passed and self._before[1] == measured:
            return
        self._before, self._values = (passed, measured), None
        sources = {self.kind.takes[0]: (before.stage.key,)}
        runner = StageRunner(self.stage, self.kind, self.parameters(setting), sources)
        gates = gate_specs(before.kind.gates, before.parameters(setting))
        made = associated(runner, _picks(passed, gates))
        self.load(
            [
                GateCascade(b.spec, self.kind.gates, Candidates(b.time_ns, b.channel, b.value))
                for b in made
                if isinstance(b, CandidateBlock)
            ]
        )


def _picks(
    passed: list[Passed], gates: tuple[GateSpec, ...]
) -> Iterator[tuple[StageSpec, Iterator[Pick]]]:
    """Yield the picks that accepted candidates stand for."""
    for spec, candidates in passed:
        none = np.empty((len(candidates), 0), np.float32)
        block = CandidateBlock(
            replace(spec, gates=gates),
            candidates.time_ns,
            candidates.channel,
            candidates.value,
            none,
            none,
            np.ones(len(candidates), np.bool_),
        )
        yield block.spec, (e for e in accepted_events(block) if isinstance(e, Pick))


class StepChain:
    """Decides what is counted of one recording under one setting after the other.

    Only the stage that gives the steps, or the passes, is decided, and those whose picks it takes.

    Parameters
    ----------
    evidence
        What was stored.
    axes
        What is swept, gates' parameters and associators' only; a setting has a value for each.

    Raises
    ------
    PipelineError
        Where a value cannot be decided from what was stored.
    RecordingError
        Where no stage finds what is counted.
    """

    def __init__(self, evidence: Evidence, axes: Sequence[Axis]) -> None:
        self._redecider = OfflineDecider(evidence)
        self._axes = axes
        self._stages = [(s, stage_named(s.use)) for s in evidence.config.stage]
        self._check(axes)
        self.links: list[ChainStage] = []
        needed = self._last_stage(evidence)
        for index in range(len(self._stages) - 1, -1, -1):
            stage, kind = self._stages[index]
            if stage.key != needed:
                continue
            link = ChainStage(stage, kind, axes)
            self.links.insert(0, link)
            if not associates(kind):
                link.load(
                    [
                        GateCascade(p.spec, stated(kind.gates, p.spec), p.candidates, p.carried())
                        for p in evidence.of(stage.key)
                    ]
                )
                break
            needed = self._picking_before(index)

    def within(self, start_ns: int, end_ns: int) -> StepChain:
        """Return a chain that decides only about candidates with start <= time <= end."""
        chain = copy.copy(self)
        chain.links = [ChainStage(link.stage, link.kind, self._axes) for link in self.links]
        chain.links[0].load([sieve.within(start_ns, end_ns) for sieve in self.links[0].sieves])
        return chain

    @property
    def associates(self) -> bool:
        """Whether an associator is on the way."""
        return len(self.links) > 1

    def order(self, rows: Sequence[Sequence[Any]]) -> list[int]:
        """Return the order of settings that changes the early gates least often."""
        keys = [i for link in self.links for i, _ in link.setting_axes]
        ranks = []
        for i in keys:
            column = [row[i] for row in rows]
            rank_of = {value: rank for rank, value in enumerate(sorted(set(column)))}
            ranks.append([rank_of[value] for value in column])
        if not ranks:
            return list(range(len(rows)))
        row_order: list[int] = np.lexsort(ranks[::-1]).tolist()
        return row_order

    def step_times(self, setting: Sequence[Any]) -> NDArray[np.int64]:
        """Return the times of what is counted under a setting [ns]."""
        return times_of(self.passed(setting))

    def passed(self, setting: Sequence[Any]) -> list[Passed]:
        """Return what passes all gates under a setting, topic by topic."""
        passed: list[Passed] = []
        for before, link in zip([None, *self.links], self.links, strict=False):
            if before is not None:
                link.associate(before, passed, setting)
            passed = link.run(setting)
        return passed

    def _check(self, axes: Sequence[Axis]) -> None:
        """Let the redecider refuse what needs a replay."""
        stages = {stage.key: (stage, kind) for stage, kind in self._stages}
        for axis in axes:
            ends = (min(axis.values), max(axis.values)) if axis.numeric else axis.values
            for value in ends:
                settings = {(axis.stage, axis.parameter): value}
                self._redecider.parameters(*stages[axis.stage], settings)

    def _last_stage(self, evidence: Evidence) -> str:
        counted = scored_event(evidence.config)
        for stage, kind in reversed(self._stages):
            if emitted(kind) == counted and evidence.of(stage.key):
                return str(stage.key)
        raise RecordingError(
            f"{evidence.name}: expected a stage that finds {event_noun(counted)}, found none"
        )

    def _picking_before(self, index: int) -> str:
        stages = self._stages[:index]
        picking = (s.key for s, kind in reversed(stages) if emitted(kind) == "pick")
        return str(next(picking, ""))


class ParameterTrials:
    """Decides with some parameters changed.

    Parameters
    ----------
    redecider
        Says what can be decided from what was stored.

    Raises
    ------
    RecordingError
        Where no stage finds steps.
    """

    def __init__(self, redecider: OfflineDecider) -> None:
        evidence = redecider.evidence
        self._redecider = redecider
        self._stages = {stage.key: (stage, kind) for stage, kind in redecider.stages}
        stood = {name: redecider.parameters(*stage, {}) for name, stage in self._stages.items()}
        #: Every gate's parameter as it stood.
        self._base = {
            (part.spec.stage, gate.parameter): getattr(stood[part.spec.stage], gate.parameter)
            for part in evidence.stages
            if part.spec.stage in stood
            for gate in part.spec.gates
        }
        axes = [Axis(*key, "", (value,), False, False) for key, value in self._base.items()]
        self._chain = StepChain(evidence, axes)

    @classmethod
    def of(cls, redecider: OfflineDecider) -> ParameterTrials | None:
        """Return the tries of a result; None where it has no steps to decide."""
        evidence = redecider.evidence
        steps = any(part.spec.emits == "step" for part in evidence.stages)
        return cls(redecider) if steps and scored_event(evidence.config) == "step" else None

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages that steps depend on."""
        return tuple(link.stage.key for link in self._chain.links)

    def within(self, start_ns: int, end_ns: int) -> ParameterTrials:
        """Return the tries of candidates with start <= time <= end."""
        trials = copy.copy(self)
        trials._chain = self._chain.within(start_ns, end_ns)
        return trials

    def passed(self, settings: Settings) -> list[Passed]:
        """Return the steps with some parameters changed, topic by topic.

        Raises
        ------
        PipelineError
            Where a value is not allowed, or needs a replay.
        """
        for name in {stage for stage, _ in settings}:
            if name not in self._stages:
                raise PipelineError(
                    f"{name}: expected a stage that candidates decide, found another"
                )
            self._redecider.parameters(*self._stages[name], settings)
        return self._chain.passed(self._row(settings))

    def order(self, tried: Sequence[Settings]) -> list[int]:
        """Return the order of settings in which the early gates change least often."""
        return self._chain.order([self._row(settings) for settings in tried])

    def _row(self, settings: Settings) -> list[Any]:
        return [settings.get(key, value) for key, value in self._base.items()]

    def unchanged(self) -> list[Passed]:
        """Return the steps as they stood, topic by topic."""
        return self._chain.passed([*self._base.values()])


#: A sweep of more settings than this is refused. Chosen by judgement: it bounds memory and time.
MOST = 1_000_000
#: Significant digits of values between the ends of a range: what is printed is what was tried.
#: Chosen by judgement: more than float32 holds.
DIGITS = 8
#: The same of values drawn at random. Chosen by judgement: finer than a draw means.
RANDOM_DIGITS = 6


@dataclass(frozen=True, slots=True)
class Axis:
    """A parameter that is swept.

    Attributes
    ----------
    stage, parameter, unit
        Which.
    values
        In the order given; the type is the parameter's.
    span
        Whether they stand for the whole range between the first and the last.
    remeasure
        Whether it changes the signal path, so that each value needs the signal again.
    """

    stage: str
    parameter: str
    unit: str
    values: tuple[Any, ...]
    span: bool
    remeasure: bool

    @property
    def name(self) -> str:
        """The parameter as settings name it."""
        return f"{self.stage}.{self.parameter}"

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers."""
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)

    def draw(self, rng: np.random.Generator, count: int) -> list[Any]:
        """Return random values: from the whole range, or out of the list."""
        if not self.span:
            return [self.values[i] for i in rng.integers(len(self.values), size=count)]
        low, high = min(self.values), max(self.values)
        if isinstance(low, int):
            return [int(v) for v in rng.integers(low, high, endpoint=True, size=count)]
        drawn = rng.uniform(low, high, count).tolist()
        return [min(max(_rounded(v, RANDOM_DIGITS), low), high) for v in drawn]

    def places(self, values: Sequence[Any]) -> NDArray[np.float64]:
        """Return where values lie between the axis' ends, 0 to 1; a list's are evenly apart."""
        if self.span:
            low, high = min(self.values), max(self.values)
            return np.array([(v - low) / ((high - low) or 1) for v in values], np.float64)
        steps = {value: index for index, value in enumerate(self.values)}
        return np.array([steps[v] for v in values], np.float64) / max(len(steps) - 1, 1)


def parse_axis(text: str, config: PipelineConfig) -> Axis:
    """Read ``stage.param=FROM:TO:COUNT`` or ``stage.param=VALUE,VALUE``.

    Raises
    ------
    PipelineError
        Another form, an unknown stage or parameter, or a value that it may not have.
    """
    left, equals, right = text.partition("=")
    key, dot, parameter = left.strip().rpartition(".")
    if not (equals and dot and parameter and right.strip()):
        raise SettingError(
            f"--grid: expected stage.param=FROM:TO:COUNT or stage.param=VALUE,VALUE, found {text!r}"
        )
    stages = {stage.key: stage for stage in config.stage}
    if key not in stages:
        raise SettingError(
            f"--grid: expected a stage of {', '.join(stages)}, found {key!r} in {text!r}"
            f"{did_you_mean(key, stages)}"
        )
    kind = stage_named(stages[key].use)
    counted = scored_event(config)
    if not (detects(kind) or associates(kind)) and emitted(kind) != counted:
        raise SettingError(
            f"--grid: expected a stage that decides about {event_noun(counted)}, found {key!r}"
        )
    info = next((i for i in describe(kind.Parameters) if i.name == parameter), None)
    span = ":" in right
    if span:
        given = _range(right, text, info)
        for end in (given[0], given[-1]):
            _checked(stages[key], kind, parameter, end)
    else:
        parsed = [parse_value(value.strip()) for value in right.split(",")]
        given = [_checked(stages[key], kind, parameter, value) for value in parsed]
    values = tuple(dict.fromkeys(given))
    # passes are found in the cycles of which a gate says that they hear a vehicle
    through = emitted(kind) == "presence" and counted == "pass"
    signal = not associates(kind) and info is not None and info.part == "measure"
    remeasure = signal or through
    return Axis(key, parameter, info.unit if info else "", values, span, remeasure)


def _range(text: str, full_text: str, info: ParameterInfo | None) -> list[Any]:
    """Return evenly spaced numbers, both ends among them; whole ones for a whole parameter."""
    try:
        low, high, count = (float(part) for part in text.split(":"))
    except ValueError:
        low, high, count = math.nan, math.nan, 0
    if not (math.isfinite(low + high) and count >= 2 and count == int(count) and low < high):
        raise SettingError(
            f"--grid: expected FROM:TO:COUNT with FROM < TO and a COUNT of 2 or more, "
            f"found {full_text!r}"
        )
    if count > MOST:
        raise SettingError(f"--grid: expected at most {MOST} values, found {full_text!r}")
    values = np.linspace(low, high, int(count)).tolist()
    if info is not None and type(info.default) is int:
        return [round(v) for v in values]
    return [low, *(_rounded(v, DIGITS) for v in values[1:-1]), high]


def _checked(stage: StageConfig, kind: Any, parameter: str, value: Any) -> Any:
    """Return a value as the parameter has it."""
    try:
        built = build(kind.Parameters, {**stage.parameters, parameter: value}, stage.key)
    except PipelineError as error:
        raise SettingError(str(error)) from None
    return getattr(built, parameter)


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """The settings of a sweep.

    Attributes
    ----------
    axes
        What is swept.
    rows
        One value for each axis, setting by setting.
    shape
        Number of values of each axis where every combination is there, in the order of the axes,
        the last one fastest; None for random settings.
    """

    axes: tuple[Axis, ...]
    rows: tuple[tuple[Any, ...], ...]
    shape: tuple[int, ...] | None

    def __len__(self) -> int:
        return len(self.rows)

    def places(self) -> NDArray[np.float64]:
        """Return where the settings lie, each axis from 0 to 1; shape (n, n_axes)."""
        columns = zip(*self.rows, strict=True)
        return np.column_stack([a.places(c) for a, c in zip(self.axes, columns, strict=True)])

    def setting(self, row: int) -> dict[str, Any]:
        """Return a setting by the names of its parameters."""
        return dict(zip((a.name for a in self.axes), self.rows[row], strict=True))


def make_grid(axes: Sequence[Axis], random: int | None = None, seed: int = 0) -> Grid:
    """Return all combinations of the axes' values, or ``random`` random settings.

    Raises
    ------
    PipelineError
        Where nothing is swept, a parameter is named twice, or there are more than :data:`MOST`.
    """
    names = [axis.name for axis in axes]
    twice = next((name for name in names if names.count(name) > 1), None)
    if not names or twice:
        expected = "each parameter once" if twice else "at least one parameter to sweep"
        raise PipelineError(f"--grid: expected {expected}, found {twice or 'none'}")
    shape = tuple(len(axis.values) for axis in axes)
    count = math.prod(shape) if random is None else random
    if count > MOST:
        raise PipelineError(
            f"--grid: expected at most {MOST} settings, found {count}: --random {MOST // 10} tries "
            f"some of them"
        )
    if random is None:
        return Grid(tuple(axes), tuple(product(*(a.values for a in axes))), shape)
    rng = np.random.default_rng(seed)
    drawn = [axis.draw(rng, random) for axis in axes]
    return Grid(tuple(axes), tuple(zip(*drawn, strict=True)), None)
