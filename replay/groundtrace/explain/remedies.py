"""Remedies: the smallest change of one parameter, or of two, that makes a wrong decision right.

None does harm: false and missed steps of the whole recording together, FP + FN, are no more with it
than without. Right decisions that it loses (steps found before and missed with it, and new false
ones) are then no more than the wrong ones it corrects (steps missed before and false ones removed),
since the true steps stay the same. Where the smallest change does harm, the smallest one that does
not is sought.

Changes of one parameter are tried in two ways: thresholds beside the candidates around the wrong
decision, about that time first and then on the whole recording; and a table of thresholds beside
all candidates of the recording, each decided once for all wrong decisions. Where none helps, pairs
are tried: those that let in a candidate there which two gates keep out, and a second table, of
every two parameters. Neither table decides more than :data:`WORK` candidates in all, or than a few
settings where a recording alone has as many.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError
from ..evaluation.matching import TrueSteps
from .reasons import StepTruth, times_of
from .redecide import Counts, ParameterTrials

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import GateSpec

    from ..pipeline.results import StageEvidence
    from .reasons import Verdicts
    from .redecide import OfflineDecider

    #: Whether a change does what is wanted, by the true steps and how it does on them.
    Works = Callable[[TrueSteps, Verdicts], bool]

    #: Changes of one parameter, by their size.
    Proposal = list["Change"]
    Changes = tuple["Change", ...]

#: Other candidates of at most this many values are tried for each parameter. Chosen by judgement:
#: it bounds the cost; the smallest changes come first.
TRIES = 12
#: Candidates this far from the step may have to do with it, through the refractory time [s]. Chosen
#: by judgement: four refractory times of 0.25 s.
INFLUENCE_S = 1.0
#: So many of a parameter's values about a moment may do harm before the tables are asked. Chosen by
#: judgement: tables cost as much as some single trials.
HARMFUL = 2
#: So many values of each parameter are in the table of single changes, and in that of pairs. Chosen
#: by judgement: per cents of the range, and a quarter as many in each direction of pairs.
FAR_TRIES = 100
PAIR_TRIES = 16
#: Candidates that a table decides on, all its settings together: with an associator on the way 2 us
#: each, four times as many as without (simulated room of 5 minutes, simulated walk of 20). Chosen
#: by judgement: some seconds.
WORK = 2_000_000
#: A table has at least so many values of each parameter. Chosen by judgement: fewer say little.
LEAST_TRIES = 4
#: Candidates that two gates keep out, of those at a step, which are tried to be let in. Chosen by
#: judgement: the best ones.
KEPT_OUT = 4
#: A refractory time may fall between a candidate and so many after it. Chosen by judgement: a
#: step's ringing has few.
NEIGHBOURS = 6
#: Time around a step in which a change is tried first [s]. Chosen by judgement: several steps, so
#: that most changes that cost some are dropped early.
NEARBY_S = 4.0
#: So many changes of the whole recording are remembered. Chosen by judgement: it bounds memory.
REMEMBERED = 1000
#: Significant digits of a changed value. Chosen by judgement: what people set.
DIGITS = 4


@dataclass(frozen=True, slots=True)
class Change:
    """Another value of one parameter.

    Attributes
    ----------
    stage, parameter
        Which.
    old, new
        Its values; ``--set stage.parameter=new`` gives the same in a replay.
    """

    stage: str
    parameter: str
    old: float
    new: float

    @property
    def setting(self) -> str:
        """The change as ``replay --set`` takes it."""
        return f"{self.stage}.{self.parameter}={self.new:.10g}"

    @property
    def size(self) -> float:
        """Its size relative to the old value."""
        return abs(self.new - self.old) / max(abs(self.old), 1e-9)


@dataclass(frozen=True, slots=True)
class Remedy:
    """A change of one parameter, or of two, and what it does.

    Attributes
    ----------
    changes
        One or two; all of them given to ``replay --set`` do the same.
    before, after
        Steps right, false and missed, without and with it.
    """

    changes: tuple[Change, ...]
    before: Counts
    after: Counts

    @property
    def settings(self) -> tuple[str, ...]:
        """The changes as ``replay --set`` takes them."""
        return tuple(change.setting for change in self.changes)

    @property
    def options(self) -> str:
        """The changes as options of ``replay``."""
        return " ".join(f"--set {setting}" for setting in self.settings)

    @property
    def effect(self) -> str:
        """What it does to the whole recording, in words."""
        before, after = self.before, self.after
        return (
            f"right {before.tp} → {after.tp}, missed {before.fn} → {after.fn}, "
            f"false {before.fp} → {after.fp}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Changes, and how the whole recording does with them."""

    changes: Changes
    verdicts: Verdicts

    @property
    def wrong(self) -> int:
        """Decisions that are wrong with them."""
        return int((~self.verdicts.hit).sum()) + len(self.verdicts.false_ns)

    @property
    def size(self) -> float:
        """Their size, of all together."""
        return sum(change.size for change in self.changes)


class RemedySearch:
    """Looks for remedies of the wrong decisions of one result.

    Parameters
    ----------
    redecider
        Decides again.
    tolerance_s
        Of the match [s].
    """

    def __init__(self, redecider: OfflineDecider, tolerance_s: float) -> None:
        self.redecider = redecider
        self.tolerance_s = tolerance_s
        evidence = redecider.evidence
        truth = TrueSteps.of(evidence.labels, evidence.start_ns, evidence.end_ns, tolerance_s)
        self._truth = StepTruth(truth)
        self._tries = ParameterTrials.of(redecider)
        #: The stage whose decisions of other settings are not known without a replay; else nothing.
        self.untried = redecider.untried
        self._tried: dict[Changes, _Trial | None] = {}
        self._singles: list[_Trial] | None = None
        self._pairs: list[_Trial] | None = None
        self.matching = truth.match(times_of(self._tries.unchanged() if self._tries else []))
        self.before = Counts.of(self.matching)

    def recover(self, truth_ns: int, found_ns: int | None = None) -> Remedy | None:
        """Return the smallest change that finds the step at ``truth_ns``, or None.

        Parameters
        ----------
        truth_ns
            The missed step.
        found_ns
            Its detection, where that comes at a wrong time: it must be false no longer, since
            another detection beside it would mend nothing.
        """

        def works(true: TrueSteps, verdicts: Verdicts) -> bool:
            at = int(true.truth_ns.searchsorted(truth_ns))
            return bool(verdicts.hit[at]) and (
                found_ns is None or found_ns not in verdicts.false_ns
            )

        return self._mended(truth_ns, works)

    def remove(self, found_ns: int) -> Remedy | None:
        """Return the smallest change that makes the false step at ``found_ns`` go, or None.

        No other false step may come in its place, that is within the tolerance of it.
        """
        reach = round(self.tolerance_s * NS_PER_S)

        def false_near(false_ns: NDArray[np.int64]) -> set[int]:
            first, last = false_ns.searchsorted((found_ns - reach, found_ns + reach + 1))
            return set(false_ns[first:last].tolist())

        others = false_near(self.matching.found_ns[self.matching.false]) - {found_ns}

        def works(_: TrueSteps, verdicts: Verdicts) -> bool:
            return false_near(verdicts.false_ns) <= others

        return self._mended(found_ns, works)

    def _mended(self, time_ns: int, works: Works) -> Remedy | None:
        """Return the smallest change of one parameter that works; else the best pair."""
        if self._tries is None or self.untried:
            return None
        near = self._about(self._tries, time_ns)
        best = self._nearby(self._tries, near, time_ns, works)
        far = self._first(self._single_table(self._tries), works)
        best = min((t for t in (best, far) if t is not None), key=_size, default=None)
        if best is None:
            pairs = [*self._exact_pairs(self._tries, near, time_ns, works)]
            table = self._first(self._pair_table(self._tries), works)
            trials = pairs if table is None else [*pairs, table]
            best = min(trials, key=_wrong_then_size, default=None)
        return None if best is None else Remedy(best.changes, self.before, _counts(best.verdicts))

    def _nearby(
        self,
        tries: ParameterTrials,
        near: tuple[ParameterTrials, StepTruth],
        time_ns: int,
        works: Works,
    ) -> _Trial | None:
        """Return the smallest harmless change by what is around."""
        best: _Trial | None = None
        for proposal in self._proposals(time_ns):
            harmful = 0
            for change in proposal:
                if best is not None and change.size >= best.size:
                    break
                if not _helps(works, near[1], _judged(*near, (change,))):
                    continue
                trial = self._on_recording(tries, (change,))
                if trial is None or not works(self._truth.steps, trial.verdicts):
                    continue
                if self._harmless(trial):
                    best = trial
                    break
                harmful += 1
                if harmful == HARMFUL:
                    break
        return best

    def _exact_pairs(
        self,
        tries: ParameterTrials,
        near: tuple[ParameterTrials, StepTruth],
        time_ns: int,
        works: Works,
    ) -> Iterator[_Trial]:
        """Yield the pairs that let in a candidate at a time which two gates keep out."""
        for changes in self._let_in(time_ns):
            if _helps(works, near[1], _judged(*near, changes)):
                trial = self._on_recording(tries, changes)
                if trial is None or not works(self._truth.steps, trial.verdicts):
                    continue
                if self._harmless(trial):
                    yield trial

    def _harmless(self, trial: _Trial) -> bool:
        """Whether no more decisions are wrong than before."""
        return trial.wrong <= self.before.fp + self.before.fn

    def _first(self, table: Sequence[_Trial], works: Works) -> _Trial | None:
        return next((t for t in table if works(self._truth.steps, t.verdicts)), None)

    def _single_table(self, tries: ParameterTrials) -> list[_Trial]:
        """Return the harmless changes of one parameter, the smallest first."""
        if self._singles is None:
            proposals = list(self._far_proposals())
            most = self._most(len(proposals))
            tried = [
                (c,) for proposal in proposals for c in _spread(proposal, min(most, FAR_TRIES))
            ]
            self._singles = sorted(self._harmless_of(tries, tried), key=_size)
        return self._singles

    def _pair_table(self, tries: ParameterTrials) -> list[_Trial]:
        """Return the harmless pairs of changes, those with the fewest wrong decisions first."""
        if self._pairs is None:
            sides = self._sides()
            most = math.isqrt(self._most(math.comb(len(sides), 2)))
            most = max(min(most, PAIR_TRIES), LEAST_TRIES)
            side_changes = [_of_both(opened, shut, most) for opened, shut in sides]
            tried = [both for a, b in combinations(side_changes, 2) for both in product(a, b)]
            self._pairs = sorted(self._harmless_of(tries, tried), key=_wrong_then_size)
        return self._pairs

    def _most(self, parts: int) -> int:
        """Return how many settings of each part of a table the work allows."""
        candidates = sum(len(part.candidates) for part in self._parts())
        return max(WORK // max(candidates * parts, 1), LEAST_TRIES)

    def _harmless_of(self, tries: ParameterTrials, tried: Sequence[Changes]) -> Iterator[_Trial]:
        """Try changes on the whole recording, in the order that is fastest."""
        for index in tries.order([_settings(changes) for changes in tried]):
            verdicts = _judged(tries, self._truth, tried[index])
            trial = None if verdicts is None else _Trial(tried[index], verdicts)
            if trial is not None and self._harmless(trial):
                yield trial

    def _about(self, tries: ParameterTrials, time_ns: int) -> tuple[ParameterTrials, StepTruth]:
        """Return the candidates and the true steps around a time."""
        reach = round(NEARBY_S * NS_PER_S)
        steps = self._truth.steps
        first, last = np.searchsorted(steps.truth_ns, (time_ns - reach, time_ns + reach + 1))
        near = replace(
            steps, truth_ns=steps.truth_ns[first:last], truth_s=steps.truth_s[first:last]
        )
        return tries.within(time_ns - reach, time_ns + reach), StepTruth(near)

    def _on_recording(self, tries: ParameterTrials, changes: Changes) -> _Trial | None:
        """Return how changes do on the whole recording."""
        if changes not in self._tried:
            if len(self._tried) >= REMEMBERED:
                self._tried.clear()
            verdicts = _judged(tries, self._truth, changes)
            self._tried[changes] = None if verdicts is None else _Trial(changes, verdicts)
        return self._tried[changes]

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
            for index in range(len(part.spec.gates)):
                changes = self._changes(part, index, part.gate_value[rows, index])
                if changes:
                    yield changes[:TRIES]

    def _far_proposals(self) -> Iterator[Proposal]:
        """Yield the same from all candidates: a chain of refractory times reaches far."""
        for part in self._parts():
            for index, gate in enumerate(part.spec.gates):
                measured = part.gate_value[:, index].astype(np.float64)
                if gate.name == "refractory":
                    measured = np.concatenate([measured, _spacings(part.candidates.time_ns)])
                changes = self._changes(part, index, measured)
                if changes:
                    yield changes

    def _let_in(self, time_ns: int) -> Iterator[Changes]:
        """Yield changes of two gates that let in a candidate which these two keep out."""
        reach = round(self.tolerance_s * NS_PER_S)
        for part in self._parts():
            rows = part.between(time_ns - reach, time_ns + reach)
            failed = ~(part.margin[rows] >= 0)
            by_two = np.flatnonzero(failed.sum(axis=1) == 2)
            apart = np.abs(part.candidates.time_ns[rows[by_two]] - time_ns)
            for at in by_two[np.argsort(apart, kind="stable")[:KEPT_OUT]]:
                first, second = np.flatnonzero(failed[at]).tolist()
                value = part.gate_value[rows[at]]
                yield from zip(
                    self._changes(part, first, value[[first]]),
                    self._changes(part, second, value[[second]]),
                    strict=False,
                )

    def _sides(self) -> Sequence[tuple[Proposal, Proposal]]:
        """Return for each parameter the changes that let in candidates at missed steps, and others.

        The others shut out what is accepted: the false steps one by one, and otherwise 1, 2, 4, 8
        and so on of the accepted ones.
        """
        sides: dict[tuple[str, str], tuple[set[Change], set[Change]]] = {}
        reach = round(self.tolerance_s * NS_PER_S)
        missed = self.matching.truth_ns[self.matching.missed]
        false = self.matching.found_ns[self.matching.false]
        for part in self._parts():
            times = part.candidates.time_ns
            at_missed, at_false = (
                _beside_any(times, missed, reach),
                _beside_any(times, false, reach),
            )
            for index, gate in enumerate(part.spec.gates):
                value = part.gate_value[:, index]
                opened = self._changes(part, index, value[at_missed])
                shut = self._changes(part, index, value[part.accepted & at_false])
                more = self._changes(part, index, value[part.accepted])
                powers = [more[i] for i in _powers_of_two(len(more))]
                both = sides.setdefault((part.spec.stage, gate.parameter), (set(), set()))
                both[0].update(c for c in opened if (c.new < c.old) == gate.at_least)
                both[1].update((*shut, *powers))
        return [(_by_size(opened), _by_size(shut)) for opened, shut in sides.values()]

    def _changes(self, part: StageEvidence, index: int, measured: NDArray[np.floating]) -> Proposal:
        """Return changes of one gate's parameter beside values that it looked at."""
        stage, gate = part.spec.stage, part.spec.gates[index]
        is_integer = gate.parameter in self.redecider.whole_numbers(stage)
        values = thresholds(gate, np.unique(measured.astype(np.float64)), is_integer=is_integer)
        return [Change(stage, gate.parameter, gate.threshold, value) for value in values]


def _by_size(changes: Iterable[Change]) -> Proposal:
    return sorted(changes, key=lambda change: (change.size, change.new))


def _size(trial: _Trial) -> float:
    return trial.size


def _wrong_then_size(trial: _Trial) -> tuple[int, float]:
    return trial.wrong, trial.size


def _settings(changes: Changes) -> dict[tuple[str, str], float]:
    return {(change.stage, change.parameter): change.new for change in changes}


def _beside_any(
    times_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], reach: int
) -> NDArray[np.bool_]:
    """Return which times lie within a reach of one of some sorted others."""
    first = np.searchsorted(wanted_ns, times_ns - reach)
    last = np.searchsorted(wanted_ns, times_ns + reach, side="right")
    return np.asarray(last > first)


def _powers_of_two(count: int) -> list[int]:
    """Return 0, 1, 3, 7 and so on, below a count."""
    return [2**k - 1 for k in range(count.bit_length())]


def _spread(changes: Sequence[Change], most: int) -> list[Change]:
    """Return at most so many of the changes, the first and the last among them."""
    if len(changes) <= most:
        return list(changes)
    return [
        changes[i] for i in np.unique(np.linspace(0, len(changes) - 1, most).round().astype(int))
    ]


def _of_both(opened: Sequence[Change], shut: Sequence[Change], most: int) -> list[Change]:
    """Return at most so many changes, half of either kind where both have as many."""
    half = most // 2
    first = _spread(opened, max(half, most - len(shut)))
    return [*first, *_spread(shut, most - len(first))]


def _judged(tries: ParameterTrials, truth: StepTruth, changes: Changes) -> Verdicts | None:
    """Return how changes do; None where it cannot be decided from what was stored."""
    try:
        return truth.verdicts(tries.passed(_settings(changes)))
    except PipelineError:
        return None


def _helps(works: Works, truth: StepTruth, verdicts: Verdicts | None) -> bool:
    return verdicts is not None and works(truth.steps, verdicts)


def _counts(verdicts: Verdicts) -> Counts:
    right = int(verdicts.hit.sum())
    return Counts(right, len(verdicts.false_ns), len(verdicts.hit) - right)


def _spacings(time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the times between candidates and those that follow them [s]."""
    times = np.sort(time_ns)
    apart = [times[k:] - times[:-k] for k in range(1, NEIGHBOURS + 1)]
    spacings: NDArray[np.float64] = np.concatenate(apart) / NS_PER_S
    return spacings


def thresholds(gate: GateSpec, measured: NDArray[np.float64], *, is_integer: bool) -> list[float]:
    """Return thresholds that just let in, or just shut out, candidates; the nearest first.

    Parameters
    ----------
    gate
        As it stood.
    measured
        Shape (n,): what it looked at, of the candidates.
    is_integer
        Whether its parameter is an integer.
    """
    values: set[float] = set()
    for value in measured[np.isfinite(measured)].tolist():
        margin = value - gate.threshold if gate.at_least else gate.threshold - value
        passing = margin >= 0
        up = passing == gate.at_least  # to shut out, above the value; to let in, at or below it
        values |= _beside(value, up=up, strict=passing, is_integer=is_integer)
    levels = [v for v in values if v >= 0 and v != gate.threshold]
    return sorted(levels, key=lambda v: abs(v - gate.threshold))


def _beside(value: float, *, up: bool, strict: bool, is_integer: bool) -> set[float]:
    """Return short numbers at or beside ``value``, above it or below it.

    Two of them, since the stored value is rounded and the nearest may just fail.
    """
    sign = 1 if up else -1
    if is_integer:
        return {int(value) + sign * strict}
    digits = DIGITS - 1 - math.floor(math.log10(abs(value))) if value else DIGITS
    units = value * 10.0**digits
    nearest = math.ceil(units) if up else math.floor(units)
    first = nearest + sign * (strict and nearest == units)
    return {round((first + sign * k) / 10.0**digits, max(digits, 0)) for k in (0, 1)}
