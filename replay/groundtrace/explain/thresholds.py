"""Thresholds tried in place: what each value of each gate would make of a recording's steps.

Each curve changes one threshold and leaves the others as they stood. What was measured is stored,
so that nothing is measured anew: values below what was kept of candidates are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import PipelineError
from ..evaluation.matching import STEP_TOLERANCE_S, TrueSteps
from .reasons import times_of
from .redecide import Counts, OfflineDecider, ParameterTrials

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..pipeline.results import Evidence, StageEvidence

#: So many values of a threshold are tried. Chosen by judgement: a slider of 200 pixels.
VALUES = 41
#: Candidates decided on, all values of all gates together. Chosen by judgement: a second or two.
WORK = 1_000_000
#: Fewer values than this say little; then there is no curve. Chosen by judgement.
LEAST_VALUES = 5


@dataclass(frozen=True, slots=True)
class ThresholdCurve:
    """What becomes of the steps with other values of one threshold.

    Attributes
    ----------
    stage, parameter, unit
        Which; ``--set stage.parameter=value`` gives the same in a replay.
    now
        Its value as it stood.
    values
        Those tried, ascending, ``now`` among them.
    right, missed, false
        Steps with each of them.
    """

    stage: str
    parameter: str
    unit: str
    now: float
    values: tuple[float, ...]
    right: tuple[int, ...]
    missed: tuple[int, ...]
    false: tuple[int, ...]


def threshold_curves(
    evidence: Evidence, tolerance_s: float = STEP_TOLERANCE_S
) -> tuple[ThresholdCurve, ...]:
    """Return a curve for each gate that steps depend on.

    Parameters
    ----------
    evidence
        Of the result.
    tolerance_s
        Of the match [s].

    Returns
    -------
    The curves in the order of the pipeline; none where no stage finds steps, where there are no
    true ones, or where their stage needs a replay.
    """
    decider = OfflineDecider(evidence)
    tries = ParameterTrials.of(decider)
    if tries is None or decider.untried or not any(x.kind == "step" for x in evidence.labels):
        return ()
    truth = TrueSteps.of(evidence.labels, evidence.start_ns, evidence.end_ns, tolerance_s)
    parts = {
        (part.spec.stage, gate.parameter): list(evidence.of(part.spec.stage))
        for part in evidence.stages
        if part.spec.stage in tries.stages
        for gate in part.spec.gates
    }
    candidates = sum(len(p.candidates) for gate_parts in parts.values() for p in gate_parts)
    most = min(VALUES, WORK // max(candidates, 1))
    if most < LEAST_VALUES:
        return ()
    curves = (
        _curve(tries, truth, key, gate_parts, decider, most) for key, gate_parts in parts.items()
    )
    return tuple(curve for curve in curves if len(curve.values) >= LEAST_VALUES)


def _curve(
    tries: ParameterTrials,
    truth: TrueSteps,
    key: tuple[str, str],
    parts: Sequence[StageEvidence],
    decider: OfflineDecider,
    most: int,
) -> ThresholdCurve:
    stage, parameter = key
    gates = parts[0].spec.gates
    column = next(i for i, gate in enumerate(gates) if gate.parameter == parameter)
    now = float(gates[column].threshold)
    measured = np.concatenate([part.gate_value[:, column] for part in parts]).astype(np.float64)
    is_integer = parameter in decider.whole_numbers(stage)
    points: list[tuple[float, Counts]] = []
    for value in tried(measured, now, most, is_integer=is_integer):
        setting = {key: int(value) if is_integer else value}
        try:
            times = times_of(tries.passed(setting))
        except PipelineError:  # below what was stored, or not allowed
            continue
        points.append((value, Counts.of(truth.match(times))))
    return ThresholdCurve(
        stage,
        parameter,
        gates[column].unit,
        now,
        tuple(value for value, _ in points),
        tuple(count.tp for _, count in points),
        tuple(count.fn for _, count in points),
        tuple(count.fp for _, count in points),
    )


def tried(measured: np.ndarray, now: float, most: int, *, is_integer: bool) -> list[float]:
    """Return values of a threshold to try: where candidates are, close to it and far from it.

    Parameters
    ----------
    measured
        Values of the gate, shape (n,); those that are no numbers say nothing.
    now
        The threshold as it stands, which is among them.
    most
        How many at most.
    is_integer
        Whether only whole numbers are thresholds.
    """
    finite = measured[np.isfinite(measured)]
    parts = np.quantile(finite, np.linspace(0.0, 1.0, most - 1)) if len(finite) else np.empty(0)
    values = np.append(parts, now)
    values = (
        np.rint(values)
        if is_integer
        else np.array([float(f"{v:.4g}") for v in values[:-1]] + [now])
    )
    return [float(v) for v in np.unique(values)]
