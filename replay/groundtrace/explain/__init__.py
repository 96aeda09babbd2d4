"""Explanation: why a step was missed or false, and what the smallest change would do."""

from __future__ import annotations

from .evidence import Evidence, StageEvidence, evidence_of
from .readings import GateReading
from .reasons import CAUSES, Reason, StepReasons, WrongTime, reason_at
from .redecide import Counts, Outcome, Redecider
from .remedies import Healer, Remedy

__all__ = [
    "CAUSES",
    "Counts",
    "Evidence",
    "GateReading",
    "Healer",
    "Outcome",
    "Reason",
    "Redecider",
    "Remedy",
    "StageEvidence",
    "StepReasons",
    "WrongTime",
    "evidence_of",
    "reason_at",
]
