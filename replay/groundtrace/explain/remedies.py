"""Remedies: the smallest change of one gate's parameter that makes a wrong decision right."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError
from ..score.step_matching import TrueSteps
from .counted import StepTruth, times_of
from .redecide import Counts
from .tries import Tries

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import GateSpec

    from .bootstrap import Verdicts
    from .evidence import StageEvidence
    from .redecide import Redecider

    #: Whether a change does what is wanted, by the true steps and how it does on them.
    Works = Callable[[TrueSteps, Verdicts], bool]
    #: Stage, parameter, old value, new values by size of the change.
    Proposal = tuple[str, str, float, list[float]]
    #: Stage, parameter, new value.
    Change = tuple[str, str, float]

#: Other candidates of at most this many values are tried for each parameter.
TRIES = 12
#: Candidates this far from the step may have to do with it, through the refractory time [s].
INFLUENCE_S = 1.0
#: Where none of those helps, so many values from the whole recording are tried.
FAR_TRIES = 100
#: A refractory time may fall between a candidate and so many after it.
NEIGHBOURS = 6
#: Time around a step in which a change is tried first [s].
NEARBY_S = 4.0
#: So many changes of the whole recording are remembered.
REMEMBERED = 1000
DIGITS = 4


@dataclass(frozen=True, slots=True)
class Remedy:
    """A change of one parameter and what it does.

    Attributes
    ----------
    stage, parameter
        Which.
    old, new
        Its values; ``--set stage.parameter=new`` gives the same in a replay.
    before, after
        Steps right, false and missed, without and with it.
    """

    stage: str
    parameter: str
    old: float
    new: float
    before: Counts
    after: Counts

    @property
    def setting(self) -> str:
        """The change as ``replay --set`` takes it."""
        return f"{self.stage}.{self.parameter}={self.new:.10g}"

    @property
    def change(self) -> float:
        """Its size relative to the old value."""
        return abs(self.new - self.old) / max(abs(self.old), 1e-9)


class Healer:
    """Looks for remedies of the wrong decisions of one result.

    Parameters
    ----------
    redecider
        Decides again.
    tolerance_s
        Of the match [s].
    """

    def __init__(self, redecider: Redecider, tolerance_s: float) -> None:
        self.redecider = redecider
        self.tolerance_s = tolerance_s
        evidence = redecider.evidence
        truth = TrueSteps.of(evidence.labels, evidence.start_ns, evidence.end_ns, tolerance_s)
        self._truth = StepTruth(truth)
        self._tries = Tries.of(redecider)
        self._tried: dict[Change, Verdicts | None] = {}
        self._far: list[Proposal] | None = None
        self.matching = truth.match(times_of(self._tries.unchanged() if self._tries else []))
        self.before = Counts.of(self.matching)

    def recover(self, truth_ns: int) -> Remedy | None:
        """Return the smallest change that finds the step at ``truth_ns``, or None."""
        return self._smallest(truth_ns, lambda true, found: truth_ns in true.truth_ns[found.hit])

    def remove(self, found_ns: int) -> Remedy | None:
        """Return the smallest change that makes the false step at ``found_ns`` go, or None."""
        return self._smallest(found_ns, lambda _, found: found_ns not in found.false_ns)

    def _smallest(self, time_ns: int, works: Works) -> Remedy | None:
        """Return the smallest change that works by what is near, else through a long chain."""
        if self._tries is None:
            return None
        near = self._best(self._tries, self._proposals(time_ns), works, time_ns)
        if near is None and self._may_be_held_off(time_ns):
            if self._far is None:
                self._far = list(self._far_proposals())
            return self._best(self._tries, self._far, works, None)
        return near

    def _may_be_held_off(self, time_ns: int) -> bool:
        """Whether one change may leave a refractory time alone in the way of a candidate there.

        What began that time may be far away: each accepted candidate holds off the next.
        """
        reach = round(self.tolerance_s * NS_PER_S)
        for part in self.redecider.evidence.stages:
            names = [gate.name for gate in part.spec.gates]
            others = [i for i, name in enumerate(names) if name != "refractory"]
            rows = part.between(time_ns - reach, time_ns + reach)
            failed = (~(part.margin[rows][:, others] >= 0)).sum(axis=1)
            if "refractory" in names and (failed <= 1).any():
                return True
        return False

    def _best(
        self, tries: Tries, proposals: Iterable[Proposal], works: Works, near_ns: int | None
    ) -> Remedy | None:
        """Return the smallest change that works; about ``near_ns`` first, as that is faster."""
        best: Remedy | None = None
        near = None if near_ns is None else self._about(tries, near_ns)
        for stage, parameter, old, values in proposals:
            for new in values:
                size = abs(new - old) / max(abs(old), 1e-9)
                if best is not None and size >= best.change:
                    break
                change = (stage, parameter, new)
                if near is not None and not _helps(works, near[1], _judged(*near, change)):
                    continue
                found = self._whole(tries, change)
                if found is not None and works(self._truth.steps, found):
                    best = Remedy(stage, parameter, old, new, self.before, _counts(found))
                    break
        return best

    def _about(self, tries: Tries, time_ns: int) -> tuple[Tries, StepTruth]:
        """Return the candidates and the true steps around a time."""
        reach = round(NEARBY_S * NS_PER_S)
        steps = self._truth.steps
        first, last = np.searchsorted(steps.truth_ns, (time_ns - reach, time_ns + reach + 1))
        near = replace(
            steps, truth_ns=steps.truth_ns[first:last], truth_s=steps.truth_s[first:last]
        )
        return tries.within(time_ns - reach, time_ns + reach), StepTruth(near)

    def _whole(self, tries: Tries, change: Change) -> Verdicts | None:
        """Return how a change does on the whole recording."""
        if change not in self._tried:
            if len(self._tried) >= REMEMBERED:
                self._tried.clear()
            self._tried[change] = _judged(tries, self._truth, change)
        return self._tried[change]

    def _parts(self) -> Iterator[StageEvidence]:
        """Yield the evidence of the stages that steps depend on."""
        for part in self.redecider.evidence.stages:
            if self._tries is not None and part.spec.stage in self._tries.stages:
                yield part

    def _proposals(self, time_ns: int) -> Iterator[Proposal]:
        """Yield thresholds on either side of candidates around a time."""
        for part in self._parts():
            reach = round((INFLUENCE_S + self.tolerance_s) * NS_PER_S)
            rows = part.between(time_ns - reach, time_ns + reach)
            whole = self.redecider.whole_numbers(part.spec.stage)
            for index, gate in enumerate(part.spec.gates):
                found = np.unique(part.gate_value[rows, index].astype(np.float64))
                values = thresholds(gate, found, whole=gate.parameter in whole)
                if values:
                    yield part.spec.stage, gate.parameter, gate.threshold, values[:TRIES]

    def _far_proposals(self) -> Iterator[Proposal]:
        """Yield the same from all candidates: a chain of refractory times reaches far."""
        for part in self._parts():
            whole = self.redecider.whole_numbers(part.spec.stage)
            for index, gate in enumerate(part.spec.gates):
                found = part.gate_value[:, index].astype(np.float64)
                if gate.name == "refractory":
                    found = np.concatenate([found, _spacings(part.candidates.time_ns)])
                values = thresholds(gate, np.unique(found), whole=gate.parameter in whole)
                if values:
                    kept = values[:: math.ceil(len(values) / FAR_TRIES)]
                    yield part.spec.stage, gate.parameter, gate.threshold, kept


def _judged(tries: Tries, truth: StepTruth, change: Change) -> Verdicts | None:
    """Return how a change does; None where it cannot be decided from what was stored."""
    try:
        return truth.verdicts(tries.passed(*change))
    except PipelineError:
        return None


def _helps(works: Works, truth: StepTruth, found: Verdicts | None) -> bool:
    return found is not None and works(truth.steps, found)


def _counts(found: Verdicts) -> Counts:
    right = int(found.hit.sum())
    return Counts(right, len(found.false_ns), len(found.hit) - right)


def _spacings(time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the times between candidates and those that follow them [s]."""
    times = np.sort(time_ns)
    apart = [times[k:] - times[:-k] for k in range(1, NEIGHBOURS + 1)]
    spacings: NDArray[np.float64] = np.concatenate(apart) / NS_PER_S
    return spacings


def thresholds(gate: GateSpec, found: NDArray[np.float64], *, whole: bool) -> list[float]:
    """Return thresholds that just let in, or just shut out, candidates; the nearest first.

    Parameters
    ----------
    gate
        As it stood.
    found
        Shape (n,): what it looked at, of the candidates.
    whole
        Whether its parameter is an integer.
    """
    values: set[float] = set()
    for value in found[np.isfinite(found)].tolist():
        margin = value - gate.threshold if gate.at_least else gate.threshold - value
        passing = margin >= 0
        up = passing == gate.at_least  # to shut out, above the value; to let in, at or below it
        values |= _beside(value, up=up, strict=passing, whole=whole)
    kept = [v for v in values if v >= 0 and v != gate.threshold]
    return sorted(kept, key=lambda v: abs(v - gate.threshold))


def _beside(value: float, *, up: bool, strict: bool, whole: bool) -> set[float]:
    """Return short numbers at or beside ``value``, above it or below it.

    Two of them, since the stored value is rounded and the nearest may just fail.
    """
    sign = 1 if up else -1
    if whole:
        return {int(value) + sign * strict}
    digits = DIGITS - 1 - math.floor(math.log10(abs(value))) if value else DIGITS
    units = value * 10.0**digits
    nearest = math.ceil(units) if up else math.floor(units)
    first = nearest + sign * (strict and nearest == units)
    return {round((first + sign * k) / 10.0**digits, max(digits, 0)) for k in (0, 1)}
