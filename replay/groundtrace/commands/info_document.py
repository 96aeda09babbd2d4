"""What ``groundtrace info`` says, as one document."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..health.imu import AxisCheck
    from ..placement import Measures
    from .info_faults import FaultInfo


@dataclass(frozen=True, slots=True)
class GuessInfo:
    """Where a sensor may be worn, and what that was decided by (:mod:`groundtrace.placement`)."""

    placement: str
    confidence: float
    contradicts: bool
    measures: Measures
    text: str


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One sampled stream of a recording; times are seconds from its first sample."""

    topic: str
    rate_hz: float
    irregular: bool
    placement: str
    channels: list[dict[str, str]]
    samples: int | None
    start_s: float | None
    end_s: float | None
    placement_guess: GuessInfo | None


@dataclass(frozen=True, slots=True)
class GapInfo:
    """One interruption; ``steps`` is how many true steps it cuts or swallows."""

    topic: str
    start_s: float
    end_s: float
    reason: str
    lost: int
    bridged: bool
    steps: int


@dataclass(frozen=True, slots=True)
class DamageInfo:
    """One damaged place of the file."""

    offset: int
    length: int
    messages: int | None
    start_s: float | None
    end_s: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Everything ``info`` says."""

    recording: str
    bytes: int
    start_ns: int
    start: str | None
    duration_s: float
    streams: list[StreamInfo]
    others: list[dict[str, str | int]]
    gaps: list[GapInfo]
    damage: list[DamageInfo]
    truth: dict[str, int]
    geometry: dict[str, int] | None
    length_unit: str | None
    metadata: list[str]
    annotations: dict[str, int] = field(default_factory=dict)
    unit_warnings: list[str] = field(default_factory=list)
    faults: list[FaultInfo] = field(default_factory=list)
    axes: list[AxisCheck] = field(default_factory=list)
    clocks: list[str] = field(default_factory=list)
    signals_read: bool = True
