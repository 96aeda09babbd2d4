"""The way from stored candidates to steps, or passes, for thousands of settings in turn.

:func:`~groundtrace.gates.decide` decides here as everywhere. What makes it fast is that a gate is
asked again only where its threshold, or what reaches it, has changed, and only about candidates
that passed the gates before it: a gate looks at no others.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Pick

from ..errors import RecordingError
from ..gates import Candidates, decide, gate_specs
from ..parameters import build
from ..plugins import stage_named
from ..stage import StageRunner, accepted_events, associates, emitted
from .counted import counted_kind, noun_of, times_of
from .redecide import Redecider, associated

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import GateSpec, StageSpec

    from ..pipeline import StageConfig
    from .evidence import Evidence
    from .grid import Axis

#: What passed a stage on one topic.
Passed = tuple["StageSpec", Candidates]


class Sieve:
    """The gates of one stage and topic; remembers what passed each of them last.

    Parameters
    ----------
    spec
        What the candidates are.
    gates
        In order.
    candidates
        What they decide on.
    """

    def __init__(self, spec: StageSpec, gates: Sequence[Any], candidates: Candidates) -> None:
        self.spec = spec
        self.gates = gates
        self.candidates = candidates
        self._last: list[tuple[float, Candidates]] = []

    def within(self, start_ns: int, end_ns: int) -> Sieve:
        """Return the same of the candidates with start <= time <= end."""
        times = self.candidates.time_ns
        rows = np.flatnonzero((times >= start_ns) & (times <= end_ns))
        return Sieve(self.spec, self.gates, self.candidates.rows(rows))

    def passed(self, parameters: Any) -> Candidates:
        """Return the candidates that pass every gate."""
        found = self.candidates
        for depth, gate in enumerate(self.gates):
            threshold = float(getattr(parameters, gate.parameter))
            if depth < len(self._last) and self._last[depth][0] != threshold:
                del self._last[depth:]
            if depth == len(self._last):
                decisions, _ = decide(found, self.spec.columns, (gate,), parameters)
                self._last.append((threshold, found.rows(decisions.accepted)))
            found = self._last[depth][1]
        return found


class Link:
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
        own = [(i, axis.parameter) for i, axis in enumerate(axes) if axis.stage == stage.key]
        gates = [gate.parameter for gate in kind.gates]
        rank = {name: 1 + gates.index(name) for _, name in own if name in gates}
        #: Places in a setting of this stage's values, what changes most first.
        self.own = sorted(own, key=lambda item: rank.get(item[1], 0))
        self._measured = [i for i, name in own if name not in gates]
        self.sieves: list[Sieve] = []
        self._values: tuple[Any, ...] | None = None
        self._passed: list[Passed] = []
        self._before: tuple[Any, ...] | None = None

    def load(self, sieves: list[Sieve]) -> None:
        """Take the candidates to decide on."""
        self.sieves = sieves

    def run(self, setting: Sequence[Any]) -> list[Passed]:
        """Return what passes, topic by topic; the same list where nothing changed."""
        values = tuple(setting[i] for i, _ in self.own)
        if values != self._values:
            self._values = values
            parameters = self.parameters(setting)
            self._passed = [(sieve.spec, sieve.passed(parameters)) for sieve in self.sieves]
        return self._passed

    def parameters(self, setting: Sequence[Any]) -> Any:
        """Return the stage's parameters under a setting."""
        return replace(self.base, **{name: setting[i] for i, name in self.own})

    def associate(self, before: Link, passed: list[Passed], setting: Sequence[Any]) -> None:
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
                Sieve(b.spec, self.kind.gates, Candidates(b.time_ns, b.channel, b.value))
                for b in made
                if isinstance(b, CandidateBlock)
            ]
        )


def _picks(
    passed: list[Passed], gates: tuple[GateSpec, ...]
) -> Iterator[tuple[StageSpec, Iterator[Pick]]]:
    """Yield the picks that accepted candidates stand for."""
    for spec, found in passed:
        none = np.empty((len(found), 0), np.float32)
        block = CandidateBlock(
            replace(spec, gates=gates),
            found.time_ns,
            found.channel,
            found.value,
            none,
            none,
            np.ones(len(found), np.bool_),
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
        self._redecider = Redecider(evidence)
        self._axes = axes
        self._stages = [(s, stage_named(s.use)) for s in evidence.config.stage]
        self._check(axes)
        self.links: list[Link] = []
        needed = self._last_stage(evidence)
        for index in range(len(self._stages) - 1, -1, -1):
            stage, kind = self._stages[index]
            if stage.key != needed:
                continue
            link = Link(stage, kind, axes)
            self.links.insert(0, link)
            if not associates(kind):
                link.load([Sieve(p.spec, kind.gates, p.candidates) for p in evidence.of(stage.key)])
                break
            needed = self._picking_before(index)

    def within(self, start_ns: int, end_ns: int) -> StepChain:
        """Return a chain that decides only about candidates with start <= time <= end."""
        found = copy.copy(self)
        found.links = [Link(link.stage, link.kind, self._axes) for link in self.links]
        found.links[0].load([sieve.within(start_ns, end_ns) for sieve in self.links[0].sieves])
        return found

    @property
    def associates(self) -> bool:
        """Whether an associator is on the way."""
        return len(self.links) > 1

    def order(self, rows: Sequence[Sequence[Any]]) -> list[int]:
        """Return the order of settings that changes the early gates least often."""
        keys = [i for link in self.links for i, _ in link.own]
        ranks = []
        for i in keys:
            column = [row[i] for row in rows]
            known = {value: rank for rank, value in enumerate(sorted(set(column)))}
            ranks.append([known[value] for value in column])
        if not ranks:
            return list(range(len(rows)))
        found: list[int] = np.lexsort(ranks[::-1]).tolist()
        return found

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
        counted = counted_kind(evidence.config)
        for stage, kind in reversed(self._stages):
            if emitted(kind) == counted and evidence.of(stage.key):
                return str(stage.key)
        raise RecordingError(
            f"{evidence.name}: expected a stage that finds {noun_of(counted)}, found none"
        )

    def _picking_before(self, index: int) -> str:
        stages = self._stages[:index]
        picking = (s.key for s, kind in reversed(stages) if emitted(kind) == "pick")
        return str(next(picking, ""))
