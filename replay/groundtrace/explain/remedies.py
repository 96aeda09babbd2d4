"""Remedies: the smallest change of one gate's parameter that makes a wrong decision right."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError
from .redecide import Counts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import GateSpec

    from ..score import StepMatch
    from .redecide import Redecider, Settings

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
        self._tried: dict[tuple[str, str, float], StepMatch | None] = {}
        self.matching = redecider.matching(tolerance_s=tolerance_s)
        self.before = Counts.of(self.matching)

    def recover(self, truth_ns: int) -> Remedy | None:
        """Return the smallest change that finds the step at ``truth_ns``, or None."""

        def found(matching: StepMatch) -> bool:
            hits = matching.truth_ns[matching.pairs[:, 0]]
            return bool((hits == truth_ns).any())

        return self._smallest(truth_ns, found)

    def remove(self, found_ns: int) -> Remedy | None:
        """Return the smallest change that makes the false step at ``found_ns`` go, or None."""

        def gone(matching: StepMatch) -> bool:
            return not (matching.found_ns[matching.false] == found_ns).any()

        return self._smallest(found_ns, gone)

    def _smallest(self, time_ns: int, works: Callable[[StepMatch], bool]) -> Remedy | None:
        """Return the smallest change that works by what is near, else through a long chain."""
        near = self._best(self._proposals(time_ns), works, time_ns)
        if near is None and self._may_be_held_off(time_ns):
            return self._best(self._far_proposals(), works, None)
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
        self,
        proposals: Iterator[tuple[str, str, float, list[float]]],
        works: Callable[[StepMatch], bool],
        near_ns: int | None,
    ) -> Remedy | None:
        best: Remedy | None = None
        for stage, parameter, old, values in proposals:
            for new in values:
                size = abs(new - old) / max(abs(old), 1e-9)
                if best is not None and size >= best.change:
                    break
                change = (stage, parameter, new)
                if near_ns is not None and not self._works_nearby(*change, near_ns, works):
                    continue
                matching = self._matching(*change)
                if matching is not None and works(matching):
                    after = Counts.of(matching)
                    best = Remedy(stage, parameter, old, new, self.before, after)
                    break
        return best

    def _works_nearby(
        self,
        stage: str,
        parameter: str,
        value: float,
        time_ns: int,
        works: Callable[[StepMatch], bool],
    ) -> bool:
        """Try a change on the time around a step first: the whole takes much longer."""
        reach = round(NEARBY_S * NS_PER_S)
        span = (time_ns - reach, time_ns + reach)
        settings: Settings = {(stage, parameter): value}
        try:
            return works(self.redecider.matching(settings, self.tolerance_s, span))
        except PipelineError:
            return False

    def _matching(self, stage: str, parameter: str, value: float) -> StepMatch | None:
        """Decide with one parameter changed; None where that needs a replay."""
        key = (stage, parameter, value)
        if key not in self._tried:
            settings: Settings = {(stage, parameter): value}
            try:
                self._tried[key] = self.redecider.matching(settings, self.tolerance_s)
            except PipelineError:
                self._tried[key] = None
        return self._tried[key]

    def _proposals(self, time_ns: int) -> Iterator[tuple[str, str, float, list[float]]]:
        """Yield (stage, parameter, old value, new values by size of the change)."""
        for part in self.redecider.evidence.stages:
            reach = round((INFLUENCE_S + self.tolerance_s) * NS_PER_S)
            rows = part.between(time_ns - reach, time_ns + reach)
            whole = self.redecider.whole_numbers(part.spec.stage)
            for index, gate in enumerate(part.spec.gates):
                found = np.unique(part.gate_value[rows, index].astype(np.float64))
                values = thresholds(gate, found, whole=gate.parameter in whole)
                if values:
                    yield part.spec.stage, gate.parameter, gate.threshold, values[:TRIES]

    def _far_proposals(self) -> Iterator[tuple[str, str, float, list[float]]]:
        """Yield the same from all candidates: a chain of refractory times reaches far."""
        for part in self.redecider.evidence.stages:
            whole = self.redecider.whole_numbers(part.spec.stage)
            for index, gate in enumerate(part.spec.gates):
                found = part.gate_value[:, index].astype(np.float64)
                if gate.name == "refractory":
                    found = np.concatenate([found, _spacings(part.candidates.time_ns)])
                values = thresholds(gate, np.unique(found), whole=gate.parameter in whole)
                if values:
                    kept = values[:: math.ceil(len(values) / FAR_TRIES)]
                    yield part.spec.stage, gate.parameter, gate.threshold, kept


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
