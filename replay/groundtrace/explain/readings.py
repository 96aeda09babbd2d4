"""Readings: what the gates said of one candidate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from groundtrace_codecs.events import CandidateBlock

    from .evidence import StageEvidence


@dataclass(frozen=True, slots=True)
class GateReading:
    """What one gate said of one candidate."""

    gate: str
    unit: str
    parameter: str
    value: float
    threshold: float
    margin: float
    passed: bool


def readings(part: StageEvidence | CandidateBlock, row: int) -> tuple[GateReading, ...]:
    """Return what every gate said of a candidate."""
    return tuple(
        GateReading(
            gate.name,
            gate.unit,
            gate.parameter,
            float(part.gate_value[row, i]),
            gate.threshold,
            float(part.margin[row, i]),
            bool(part.margin[row, i] >= 0),
        )
        for i, gate in enumerate(part.spec.gates)
    )


def closeness(part: StageEvidence, row: int, time_ns: int) -> tuple[int, float, int]:
    """Return what orders candidates: gates failed, then shortfall, then distance in time."""
    margin = part.margin[row]
    scale = [max(abs(g.threshold), 1e-9) for g in part.spec.gates]
    short = np.where(margin < 0, -margin / scale, 0.0)
    failed = int((~(margin >= 0)).sum())
    return failed, float(np.nansum(short)), abs(int(part.candidates.time_ns[row]) - time_ns)


def told_apart(value: float, other: float, digits: int = 4) -> tuple[str, str]:
    """Return two numbers with as many digits as show which is the larger, at least ``digits``."""
    for precision in range(digits, 18):
        texts = f"{value:.{precision}g}", f"{other:.{precision}g}"
        shown = float(texts[0]), float(texts[1])
        if (shown[0] < shown[1], shown[0] > shown[1]) == (value < other, value > other):
            return texts
    return f"{value!r}", f"{other!r}"


def below(reading: GateReading) -> str:
    """Return value, threshold and margin of a failed gate as a phrase that its numbers bear out."""
    unit = "" if reading.unit == "1" else f" {reading.unit}"
    if np.isnan(reading.value):
        return f"{reading.gate} is no number, the threshold is {reading.threshold:.4g}{unit}"
    # a time is stored rounded: one that just fails may read as the threshold itself
    at_threshold = reading.value == reading.threshold
    found = reading.threshold - abs(reading.margin) if at_threshold else reading.value
    value, threshold = told_apart(found, reading.threshold)
    sign = "<" if found < reading.threshold else ">"
    return f"{reading.gate} {value}{unit} {sign} {threshold}{unit} (margin {reading.margin:.3g})"


def timed(off_s: float) -> str:
    """Return how late (> 0) or early something is as a phrase."""
    return f"{abs(off_s) * 1e3:.1f} ms {'late' if off_s > 0 else 'early'}"
