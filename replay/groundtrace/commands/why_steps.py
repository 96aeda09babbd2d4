"""What ``groundtrace why`` prints about steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .output import print_table

if TYPE_CHECKING:
    from ..explain import Remedy
    from ..explain.account import Account, False_, Missed, Moment
    from ..explain.candidates import Chain

#: From here on a part of the steps lost to a constant latency is worth a line.
LATENCY_PART = 0.1


def print_account(found: Account) -> None:
    """Print every missed and false step, and how many picks and places are bad."""
    counts = found.counts
    print(f"{found.recording}: {counts.tp} right, {counts.fn} missed, {counts.fp} false")
    if found.causes:
        causes = sorted(found.causes.items(), key=lambda item: -item[1])
        print("causes of misses: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    if found.found_without_latency - counts.tp > LATENCY_PART * (counts.tp + counts.fn):
        print(
            f"detections come {found.latency_ms:+.0f} ms from the truth: without that "
            f"{found.found_without_latency} would be right; see also --tolerance"
        )
    if found.bad_fixes:
        print(f"places: {found.bad_fixes} far off, rejected or missing; see --kind fixes")
    if found.bad_picks:
        print(f"picks: {found.bad_picks} late, early or missed; see --kind picks")
    if found.missed:
        print("\nmissed")
        header = ("step", "time [s]", "candidate", "cause", "why", "smallest change")
        print_table(header, [_missed_row(m) for m in found.missed])
    if found.false:
        print("\nfalse")
        rows = [_false_row(f) for f in found.false]
        print_table(("time [s]", "narrowest gate", "smallest change"), rows)


def _missed_row(m: Missed) -> tuple[str, ...]:
    near = m.reason.candidate_s
    candidate = "none" if near is None else f"{(near - m.time_s) * 1e3:+.0f} ms"
    cause, text = m.reason.cause, m.reason.text
    return (str(m.step), f"{m.time_s:.3f}", candidate, cause, text, remedy_text(m.remedy))


def _false_row(f: False_) -> tuple[str, ...]:
    gate = f.narrowest
    text = "-" if gate is None else f"{gate.gate} {gate.value:.4g} over {gate.threshold:.4g}"
    return (f"{f.time_s:.3f}", text, remedy_text(f.remedy))


def remedy_text(remedy: Remedy | None) -> str:
    """Return a change and what it does to the steps."""
    if remedy is None:
        return "no single change does it"
    before, after = remedy.before, remedy.after
    return (
        f"--set {remedy.setting}: TP {before.tp}->{after.tp}, FP {before.fp}->{after.fp}, "
        f"FN {before.fn}->{after.fn}"
    )


def print_moment(found: Moment) -> None:
    """Print every candidate about a moment."""
    if found.reason is None:
        print(f"{found.time_s:.3f} s: a step was accepted")
    else:
        print(f"{found.time_s:.3f} s: no step ({found.reason.cause}): {found.reason.text}")
    for link in found.chain:
        print_link(link)


def print_link(link: Chain) -> None:
    """Print one candidate and its gates."""
    verdict = "accepted" if link.accepted else "rejected"
    print(f"\n{link.stage} {link.topic} {link.channel} at {link.time_s:.4f} s: {verdict}")
    rows = [
        (
            "  " + r.gate,
            f"{r.value:.5g}",
            f"{r.threshold:.5g}",
            f"{r.margin:+.4g}",
            r.unit,
            "pass" if r.passed else "FAIL",
        )
        for r in link.readings
    ]
    print_table(("  gate", "value", "threshold", "margin", "unit", ""), rows)
