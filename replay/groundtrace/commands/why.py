"""``groundtrace why``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..explain import Healer, Redecider, evidence_of
from ..explain.account import Account, False_, Missed, Moment, account, moment
from ..explain.comparison import matched
from ..plugins import load
from ..results import read_results
from .output import print_json, print_table, say
from .pages import account_page, moment_page
from .showing import where_to_show
from .truth import truth_of

if TYPE_CHECKING:
    from ..explain import Evidence, Remedy
    from ..explain.account import Chain


#: From here on a part of the steps lost to a constant latency is worth a line.
LATENCY_PART = 0.1


def why(
    results: Path,
    *,
    step: Annotated[int | None, Parameter(validator=validators.Number(gte=1))] = None,
    at: float | None = None,
    truth: Path | None = None,
    tolerance: Annotated[float, Parameter(validator=validators.Number(gt=0))] = 0.12,
    rrd: Path | None = None,
    spawn: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Explain every missed and false step, and the smallest change that mends it.

    Parameters
    ----------
    results
        Results MCAP that groundtrace replay wrote.
    step
        Show everything about the true step of this number, as the table of all counts them.
    at
        Show everything about this moment [s since the first sample]; needs no truth.
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP.
    tolerance
        Largest distance between a step and its detection [s].
    rrd
        Write a viewer's file of every gate's values and thresholds, around the moment.
    spawn
        Open the viewer with the same, its cursor at the moment.
    force
        Overwrite an existing output.
    json
        Print one JSON document.
    """
    fallback = Path(f"{results.stem}.why.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[results])
    result = read_results(results)
    evidence = evidence_of(result, truth_of(result, results, truth))
    if step is None and at is None:
        time_ns, page = None, _explain_all(evidence, result.name, tolerance, json=json)
    else:
        time_ns = _time_of(evidence, result.name, step, at, tolerance)
        page = _explain_moment(
            evidence, time_ns, step if at is None else None, tolerance, json=json
        )
    if rrd is not None or spawn:
        show = load("views", "why")
        show(evidence, page, path=rrd, spawn=spawn, at_ns=time_ns, tolerance_s=tolerance)
    if rrd is not None:
        say(f"timeline: {rrd} (open it with: rerun {rrd})")


def _time_of(
    evidence: Evidence, name: str, step: int | None, at: float | None, tolerance: float
) -> int:
    if at is not None:
        return evidence.start_ns + round(at * NS_PER_S)
    steps = matched(evidence, tolerance).truth_ns
    if step is None or step > len(steps):
        raise RecordingError(f"{name}: --step: expected 1 to {len(steps)}, found {step}")
    return int(steps[step - 1])


def _explain_all(evidence: Evidence, name: str, tolerance: float, *, json: bool) -> str:
    """Print the account; return it as a page."""
    if not any(label.kind == "step" for label in evidence.labels):
        raise RecordingError(
            f"{name}: expected true steps (in the recording, or --truth FILE), found none; "
            f"--at SECONDS explains a moment without truth"
        )
    for at_s in evidence.clock_steps_s:
        say(f"warning: a clock steps at {at_s:.3f} s: changes around it may not be exact")
    found = account(evidence, tolerance)
    if json:
        print_json(found)
    else:
        _print_account(found)
    return account_page(found)


def _explain_moment(
    evidence: Evidence, time_ns: int, step: int | None, tolerance: float, *, json: bool
) -> str:
    """Print what there is at a moment; return it as a page."""
    found = moment(evidence, time_ns, tolerance)
    remedy, sought = None, step is not None and found.reason is not None
    if sought:
        remedy = Healer(Redecider(evidence), tolerance).recover(time_ns)
    if json:
        print_json(found)
    else:
        _print_moment(found)
        if sought:
            print(f"\nsmallest change: {_remedy(remedy)}")
    return moment_page(found, "" if step is None else f"step {step}", remedy)


def _print_account(found: Account) -> None:
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
    return (str(m.step), f"{m.time_s:.3f}", candidate, cause, text, _remedy(m.remedy))


def _false_row(f: False_) -> tuple[str, ...]:
    gate = f.narrowest
    text = "-" if gate is None else f"{gate.gate} {gate.value:.4g} over {gate.threshold:.4g}"
    return (f"{f.time_s:.3f}", text, _remedy(f.remedy))


def _remedy(remedy: Remedy | None) -> str:
    if remedy is None:
        return "no single change does it"
    before, after = remedy.before, remedy.after
    return (
        f"--set {remedy.setting}: TP {before.tp}->{after.tp}, FP {before.fp}->{after.fp}, "
        f"FN {before.fn}->{after.fn}"
    )


def _print_moment(found: Moment) -> None:
    if found.reason is None:
        print(f"{found.time_s:.3f} s: a step was accepted")
    else:
        print(f"{found.time_s:.3f} s: no step ({found.reason.cause}): {found.reason.text}")
    for link in found.chain:
        _print_link(link)


def _print_link(link: Chain) -> None:
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
