"""Faults of signals as ``groundtrace info`` says them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.signals import Stream

    from ..health import Finding

#: So many channels with one kind of fault are told one by one.
MOST_LINES = 4
#: A stream that begins or ends so much off the others is worth a line [s, sampling intervals].
LATE_S, LATE_SAMPLES = 1.0, 20
#: A stream whose samples fill less than this part of its span is one of single shots.
SHOTS = 0.8


@dataclass(frozen=True, slots=True)
class FaultInfo:
    """One kind of fault of one channel; times are seconds from the recording's first sample."""

    topic: str
    channel: str
    kind: str
    start_s: float
    end_s: float
    events: int
    share: float
    what: str
    effect: str
    remedy: str


def fault_of(found: Finding, start_ns: int) -> FaultInfo:
    """Return a finding as the command says it."""
    return FaultInfo(
        found.topic,
        found.channel,
        found.kind,
        (found.start_ns - start_ns) / NS_PER_S,
        (found.end_ns - start_ns) / NS_PER_S,
        found.events,
        found.share,
        found.what,
        found.effect,
        found.remedy,
    )


def absences(
    stream: Stream, span_s: tuple[float, float], heard_s: float, length_s: float
) -> Iterator[FaultInfo]:
    """Yield that a stream begins late or ends early; one of single shots does neither.

    Parameters
    ----------
    stream
        Which.
    span_s
        Times of its first and last sample [s].
    heard_s
        How long its samples last [s].
    length_s
        Time of the last sample of all [s].
    """
    least_s = max(LATE_S, LATE_SAMPLES / stream.rate_hz)
    first_s, last_s = span_s
    if heard_s < SHOTS * (last_s - first_s):
        return
    for kind, start_s, end_s, what, effect in (
        ("late", 0.0, first_s, "begins late", "until then"),
        ("ends early", last_s, length_s, "ends early", "from there on"),
    ):
        missing_s = end_s - start_s
        if missing_s > least_s:
            yield FaultInfo(
                stream.topic,
                "",
                kind,
                start_s,
                end_s,
                1,
                missing_s / length_s,
                f"{what}: nothing for {missing_s:.3f} s",
                f"{effect} the stages go on with the other streams",
                "look at when it was switched on and off",
            )


def print_faults(faults: Sequence[FaultInfo]) -> None:
    """Print one line for each fault, of many channels alike the first few."""
    kinds = dict.fromkeys((fault.topic, fault.kind) for fault in faults)
    for kind in kinds:
        alike = [fault for fault in faults if (fault.topic, fault.kind) == kind]
        shown = alike if len(alike) <= MOST_LINES else alike[: MOST_LINES - 1]
        for fault in shown:
            where = " ".join(filter(None, (fault.topic, fault.channel)))
            print(
                f"fault: {where}: {fault.what}, first at {fault.start_s:.3f} s: "
                f"{fault.effect}; {fault.remedy}"
            )
        rest = alike[len(shown) :]
        if rest:
            names = ", ".join(fault.channel for fault in rest)
            print(f"fault: {kind[0]}: {kind[1]} on {len(rest)} more channels: {names}")
