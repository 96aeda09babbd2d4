"""Candidates with everything the gates said of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .readings import GateReading, readings

if TYPE_CHECKING:
    from .evidence import Evidence, StageEvidence


@dataclass(frozen=True, slots=True)
class Chain:
    """One candidate and everything the gates said of it."""

    stage: str
    topic: str
    channel: str
    time_s: float
    accepted: bool
    readings: tuple[GateReading, ...]


def links(evidence: Evidence, part: StageEvidence, start_ns: int, end_ns: int) -> tuple[Chain, ...]:
    """Return the candidates of a stage with start <= time <= end and what the gates said."""
    return tuple(
        Chain(
            part.spec.stage,
            part.spec.topic,
            part.spec.channels[int(part.candidates.channel[row])],
            (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S,
            bool(part.accepted[row]),
            readings(part, int(row)),
        )
        for row in part.between(start_ns, end_ns)
    )
