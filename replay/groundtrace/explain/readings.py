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


def below(reading: GateReading) -> str:
    """Return value, threshold and margin of a failed gate as a phrase."""
    unit = "" if reading.unit == "1" else f" {reading.unit}"
    sign = "<" if reading.value < reading.threshold else ">"
    return (
        f"{reading.gate} {reading.value:.4g}{unit} {sign} {reading.threshold:.4g}{unit} "
        f"(margin {reading.margin:.3g})"
    )


def timed(off_s: float) -> str:
    """Return how late (> 0) or early something is as a phrase."""
    return f"{abs(off_s) * 1e3:.1f} ms {'late' if off_s > 0 else 'early'}"
