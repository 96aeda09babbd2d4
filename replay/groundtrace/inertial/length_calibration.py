"""Calibration of the lengths of steps by a walk of known distance.

All models but one are in proportion to a constant, so that the distance tells it exactly; of the
model that fuses two both constants are told, and scaled alike. The first and last steps of a walk
count less, so that a short walk tells what a long one does. What the distance cannot tell is how
the length changes with the pace: walk as in the recordings that it is for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import CandidateBlock
from groundtrace_codecs.signals import NS_PER_S

from .steps import CONSTANTS, ReckoningParameters, StepShape, step_length, step_measures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

#: What the calibration looks at of a step, among the columns of dead reckoning. Source: definition.
WANTED = ("cadence", "swing", "rise", "interval")
#: Parts of a step that the first and the last of a walk come to: who begins or stops is slower.
#: Chosen by trial on 20 simulated people, walks of 35 m: with whole steps other walks come out
#: 2.5 % short.
END_PART = 0.25


@dataclass(frozen=True, slots=True)
class CalibratedModel:
    """A model of step length, before and after.

    Attributes
    ----------
    model
        Its name, as ``step_length`` takes it.
    before_m
        Distance that it tells of the walk by default [m].
    constants
        What the distance makes of its parameters.
    spread
        Standard deviation of the lengths of the walk's steps, as a part of their mean.
    """

    model: str
    before_m: float
    constants: dict[str, float]
    spread: float


@dataclass(frozen=True, slots=True)
class LengthCalibration:
    """What a walk of known distance tells.

    Attributes
    ----------
    steps
        Counted.
    distance_m
        As given.
    cadence_hz, length_m, speed_mps
        Median steps a second, mean length of a step, and that over the mean time of one.
    models
        Each model.
    """

    steps: int
    distance_m: float
    cadence_hz: float
    length_m: float
    speed_mps: float
    models: tuple[CalibratedModel, ...]


def measured_steps(events: Sequence[Event]) -> NDArray[np.float64]:
    """Return time [s], cadence, swing, rise and interval of the steps walked, shape (n, 5)."""
    rows = []
    for block in events:
        if isinstance(block, CandidateBlock):
            names = [column.name for column in block.spec.columns]
            if set(WANTED) <= set(names):
                columns = [names.index(name) for name in WANTED]
                time_s = block.time_ns[block.accepted] / NS_PER_S
                rows.append(np.column_stack([time_s, block.value[block.accepted][:, columns]]))
    return np.concatenate(rows) if rows else np.empty((0, 1 + len(WANTED)))


def _parts(time_s: NDArray[np.float64], pause_s: float) -> NDArray[np.float64]:
    """Return what part of a step each one is, by whether a walk begins or ends with it."""
    apart = np.concatenate([[True], np.diff(time_s) > pause_s, [True]])
    parts: NDArray[np.float64] = np.where(apart[:-1] | apart[1:], END_PART, 1.0)
    return parts


def calibrate_lengths(
    steps: NDArray[np.float64], distance_m: float, parameters: ReckoningParameters
) -> LengthCalibration:
    """Calibrate every model by a distance.

    Parameters
    ----------
    steps
        Of :func:`measured_steps`, at least one.
    distance_m
        What they came to [m].
    parameters
        What holds before; the walker's height stays.
    """
    shapes = [(StepShape(a, b, c), 1 / f) for f, a, b, c in steps[:, 1:].tolist()]
    parts = _parts(steps[:, 0], parameters.pause_s)
    measures = [step_measures(shape, step_s, parameters.height_m) for shape, step_s in shapes]
    constants: dict[str, float] = {}
    models = []
    for model, name in CONSTANTS.items():
        values = np.array([row[model] for row in measures])
        total, before = float(values.sum()), float(getattr(parameters, name))
        if total > 0:
            constants[name] = distance_m / float(values @ parts)
            spread = float(values.std() / values.mean())
            models.append(CalibratedModel(model, before * total, {name: constants[name]}, spread))
    models.append(_fused(shapes, parts, distance_m, parameters, constants))
    return LengthCalibration(
        steps=len(steps),
        distance_m=distance_m,
        cadence_hz=float(np.median(steps[:, 1])),
        length_m=distance_m / float(parts.sum()),
        speed_mps=distance_m / float(parts @ (1 / steps[:, 1])),
        models=tuple(models),
    )


def _fused(
    shapes: list[tuple[StepShape, float]],
    parts: NDArray[np.float64],
    distance_m: float,
    parameters: ReckoningParameters,
    constants: dict[str, float],
) -> CalibratedModel:
    """Calibrate the model that fuses two, each of which is calibrated by itself."""

    def lengths(p: ReckoningParameters) -> NDArray[np.float64]:
        return np.array([step_length(shape, "", step_s, p) for shape, step_s in shapes])

    fusing = replace(parameters, step_length="fused")
    both = replace(
        fusing,
        weinberg=constants.get("weinberg", fusing.weinberg),
        cadence_part=constants.get("cadence_part", fusing.cadence_part),
    )
    lengths_m = lengths(both)
    scale = distance_m / float(lengths_m @ parts)
    fitted = {"weinberg": scale * both.weinberg, "cadence_part": scale * both.cadence_part}
    spread = float(lengths_m.std() / lengths_m.mean())
    return CalibratedModel("fused", float(lengths(fusing).sum()), fitted, spread)
