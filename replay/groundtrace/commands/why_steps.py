"""What ``groundtrace why`` prints about steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .output import print_table

if TYPE_CHECKING:
    from ..explain import Remedy
    from ..explain.account import Account, False_, Missed, Moment
    from ..explain.candidates import Chain


def print_account(found: Account) -> None:
    """Print every missed and false step, and how many picks and places are bad."""
    counts = found.counts
    print(f"{found.recording}: {counts.tp} right, {counts.fn} missed, {counts.fp} false")
    if found.shift is not None:
        s = found.shift
        print(
            f"one shift mends {s.mends} of {s.pairs} steps that were found at the wrong time: all "
            f"detections {s.late_ms:+.0f} ms from the truth; without that {s.right} would be "
            f"right; see also --tolerance"
        )
    if found.causes:
        causes = sorted(found.causes.items(), key=lambda item: -item[1])
        print("causes of misses: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    for noun, mended, wrong in (
        ("misses", found.mended_missed, found.missed),
        ("false steps", found.mended_false, found.false),
    ):
        if wrong:
            print(
                f"remedies of {noun}: {mended.one} one change, {mended.two} a pair of changes, "
                f"{mended.none} none"
            )
    if found.bad_fixes:
        print(f"places: {found.bad_fixes} far off, rejected or missing; see --kind fixes")
    if found.bad_picks:
        print(f"picks: {found.bad_picks} late, early or missed; see --kind picks")
    if found.missed:
        print("\nmissed")
        header = ("step", "time [s]", "candidate", "cause", "why", "smallest change")
        print_table(header, [_missed_row(m, found) for m in found.missed])
    if found.false:
        print("\nfalse")
        rows = [_false_row(f, found) for f in found.false]
        print_table(("time [s]", "what it is", "narrowest gate", "smallest change"), rows)


def _missed_row(m: Missed, found: Account) -> tuple[str, ...]:
    near = m.reason.candidate_s
    candidate = "none" if near is None else f"{(near - m.time_s) * 1e3:+.0f} ms"
    cause, text = m.reason.cause, m.reason.text
    if m.pair is not None:
        scored = {f.time_s for f in found.false}
        outside = "" if m.pair.found_s in scored else ", outside what is scored"
        text = f"{text} (the step found at {m.pair.found_s:.3f} s{outside})"
    return (str(m.step), f"{m.time_s:.3f}", candidate, cause, text, _change_text(m, found))


def _false_row(f: False_, found: Account) -> tuple[str, ...]:
    gate = f.narrowest
    text = "-" if gate is None else f"{gate.gate} {gate.value:.4g} over {gate.threshold:.4g}"
    answers = "-" if f.pair is None else f.pair.text
    return (f"{f.time_s:.3f}", answers, text, _change_text(f, found))


def _change_text(wrong: Missed | False_, found: Account) -> str:
    """Return what mends a wrong decision; the one shift of all where that is what does it."""
    if wrong.remedy is None and wrong.pair is not None and found.shift is not None:
        left_ms = wrong.pair.late_ms - found.shift.late_ms
        if abs(left_ms) <= found.tolerance_s * 1e3:
            return f"the shift of all detections ({found.shift.late_ms:+.0f} ms)"
    return remedy_text(wrong.remedy)


def remedy_text(remedy: Remedy | None) -> str:
    """Return a change and what it does to the steps."""
    if remedy is None:
        return "no change of one or two parameters does it without harm"
    before, after = remedy.before, remedy.after
    return (
        f"{settings_text(remedy)}: TP {before.tp}->{after.tp}, FP {before.fp}->{after.fp}, "
        f"FN {before.fn}->{after.fn}"
    )


def settings_text(remedy: Remedy) -> str:
    """Return the changes as arguments of ``replay``."""
    return " ".join(f"--set {setting}" for setting in remedy.settings)


def print_moment(found: Moment) -> None:
    """Print every candidate about a moment."""
    if found.reason is None:
        answers = "" if found.pair is None else f" at {found.pair.found_s:.3f} s: {found.pair.text}"
        print(f"{found.time_s:.3f} s: a step was accepted{answers}")
    else:
        at = "" if found.pair is None else f" (the step found at {found.pair.found_s:.3f} s)"
        print(f"{found.time_s:.3f} s: no step ({found.reason.cause}): {found.reason.text}{at}")
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
