"""``groundtrace why``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter, validators

from groundtrace_codecs.events import readable, unit_after

from ..api.analysis import evidence_with
from ..api.files import writable
from ..api.known_truth import truth_beside
from ..explain.questions import Kind, Question, explained
from ..explain.why import Moment, StepExplanation
from ..explain.why_picks import PickAccount, PickMoment
from ..explain.why_places import FixMoment, PlaceAccount
from ..explain.why_vehicles import VehicleAccount, VehicleMoment
from ..pipeline.plugins import load
from ..pipeline.results import provenance_of, read_results
from .console import (
    print_json,
    print_line,
    print_stderr,
    print_table,
    print_warnings,
    where_to_show,
)
from .options import AT_LEAST_ONE, FLAG, ForceOthers, Json, Results, Truth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..explain.questions import Answer
    from ..explain.reasons import Chain
    from ..explain.redecide import Counts
    from ..explain.remedies import Remedy
    from ..explain.why import FalseDetection, Missed
    from ..explain.why_picks import BadPick, ChannelPicks
    from ..explain.why_places import Figures, FixAccount, PlaceCause, PlaceRemedy, SensorFault
    from ..pipeline.results import Evidence


Count = Annotated[int | None, AT_LEAST_ONE]
Positive = Annotated[float, Parameter(validator=validators.Number(gt=0))]


def why(
    results: Results,
    *,
    kind: Kind | None = None,
    step: Count = None,
    fix: Count = None,
    pick: Count = None,
    at: float | None = None,
    truth: Truth = None,
    recording: Annotated[list[Path] | None, FLAG] = None,
    tolerance: Positive = 0.12,
    tolerance_m: Positive = 1.0,
    tolerance_ms: Positive = 2.0,
    stage: str = "",
    rrd: Path | None = None,
    spawn: Annotated[bool, FLAG] = False,
    force: ForceOthers = False,
    json: Json = False,
) -> None:
    """Explain every missed and false step, bad pick or bad place, and the change that mends it.

    Parameters
    ----------
    kind
        What to explain: steps, picks, fixes, the places of steps, or vehicles, the passes or
        courses of a pipeline for them. Without it, the first of these that the results hold.
    step
        Show everything about the true step of this number, as the table of all counts them.
    fix
        Show everything about the place of this number, channel by channel.
    pick
        Show everything about the bad pick of this number.
    at
        Show everything about this moment [s since the first sample]; needs no truth.
    recording
        The recording, where it is not beside its results: by measuring again without a filter it
        tells whether the filter took a step out.
    tolerance
        Largest distance between a step and its detection [s].
    tolerance_m
        Largest error of a right place [m].
    tolerance_ms
        Largest error of a right pick [ms].
    stage
        The stage whose places or picks are explained; by default the last one that locates, or
        the last one that picks onsets.
    rrd
        Write a Rerun file (.rrd) with every gate's values and thresholds, around the moment.
    spawn
        Open the viewer with the same, its cursor at the moment.
    """
    asked = Question(kind, step, fix, pick, at, tolerance, tolerance_m, tolerance_ms / 1e3, stage)
    asked.checked_kind()
    fallback = Path(f"{results.stem}.why.rrd")
    checked = partial(writable, force=force, sources=[results], of=lambda: provenance_of(results))
    spawn, rrd = where_to_show(rrd, fallback, checked, spawn=spawn)
    evidence = _evidence(results, truth, recording or [])
    if not json:
        print_warnings(evidence.warnings)
    answer = explained(evidence, results.name, asked)
    if isinstance(answer.details, StepExplanation):
        for at_s in evidence.clock_steps_s:
            print_stderr(
                f"warning: a clock steps at {at_s:.3f} s: changes around it may not be exact"
            )
    if json:
        print_json(answer.details, evidence.warnings)
    else:
        print_answer(answer)
    if rrd is not None or spawn:
        show = load("views", "why")
        page = answer_page(answer)
        show(evidence, page, path=rrd, spawn=spawn, at_ns=answer.time_ns, tolerance_s=tolerance)
    if rrd is not None:
        print_stderr(f"timeline: {rrd} (open it with: rerun {rrd})")


def _evidence(results: Path, truth: Path | None, recordings: Sequence[Path]) -> Evidence:
    """Read what decisions are explained by; it lives on without what it was read from."""
    result = read_results(results, evidence=True)
    places = (result.provenance.beside(results), *recordings)
    return evidence_with(result, truth_beside(result, results, truth, print_stderr), places)


def print_answer(answer: Answer) -> None:
    """Print what was found, for people."""
    match answer.details:
        case StepExplanation():
            print_account(answer.details)
        case Moment():
            print_moment(answer.details)
            if answer.sought:
                print_line(f"\nsmallest change: {remedy_text(answer.remedy)}")
        case PickAccount():
            print_picks(answer.details)
        case PickMoment():
            print_pick(answer.details)
        case PlaceAccount():
            print_places(answer.details)
        case FixMoment():
            print_place(answer.details, answer.reference)
        case VehicleAccount():
            print_vehicles(answer.details)
        case VehicleMoment():
            print_vehicle_moment(answer.details)


def answer_page(answer: Answer) -> str:
    """Return the page that a viewer's file has of it."""
    match answer.details:
        case StepExplanation():
            return account_page(answer.details)
        case Moment():
            title = "" if answer.step is None else f"step {answer.step}"
            return moment_page(answer.details, title, answer.remedy)
        case PickAccount():
            return picks_page(answer.details)
        case PickMoment():
            return f"# picks at {answer.details.time_s:.3f} s\n"
        case PlaceAccount():
            return places_page(answer.details)
        case FixMoment():
            return place_page(answer.details)
        case VehicleAccount():
            return vehicles_page(answer.details)
        case VehicleMoment():
            return f"# vehicles at {answer.details.time_s:.3f} s\n"


PICK_HEADER = ("pick", "time [s]", "channel", "", "off [ms]", "cause", "why")


def print_pick(moment: PickMoment) -> None:
    """Print a bad pick, or a moment, with the candidates about it."""
    if moment.bad is not None:
        print_table(PICK_HEADER, _picks_rows([moment.bad]))
    else:
        print_line(f"{moment.time_s:.3f} s: {len(moment.chain)} candidates for picks")
    for link in moment.chain:
        print_link(link)


def print_picks(account: PickAccount) -> None:
    """Print the figures, the channels with bad picks, and the bad picks."""
    print_line(_picks_headline(account))
    if account.causes:
        causes = sorted(account.causes.items(), key=lambda item: -item[1])
        print_line("causes: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    wrong = [c for c in account.channels if sum(_counts(c)[1:])]
    if wrong:
        print_line("\nchannels")
        header = ("channel", "right", "late", "early", "missed", "false", "median off [ms]", "")
        print_table(header, [_channel_row(c) for c in wrong])
    if account.bad:
        print_line("\npicks")
        print_table(PICK_HEADER, _picks_rows(account.bad))


def _picks_headline(account: PickAccount) -> str:
    c = account.counts
    return (
        f"{account.recording}: {account.stage}: {c.right} right to {account.tolerance_ms:g} ms, "
        f"{c.late} late, {c.early} early, {c.missed} missed, {c.false} false"
    )


def _counts(picks: ChannelPicks) -> tuple[int, ...]:
    c = picks.counts
    return (c.right, c.late, c.early, c.missed, c.false)


def _channel_row(picks: ChannelPicks) -> tuple[str, ...]:
    whose = "its clock" if picks.clock else "the picker's latency"
    note = f"by nearly the same time: {whose}" if picks.clock or picks.latency else ""
    return (picks.channel, *map(str, _counts(picks)), _picks_number(picks.median_ms), note)


def _picks_rows(bad: Sequence[BadPick]) -> list[tuple[str, ...]]:
    """Return a row for each bad pick; those of a channel with the same reason share one."""
    groups: dict[tuple[str, str, str, str], list[BadPick]] = {}
    for b in bad:
        key = (b.channel, b.state, b.reason.cause, b.reason.text)
        groups.setdefault(key, []).append(b)
    return [
        (
            spans([b.pick for b in same]),
            first_to_last([b.time_s for b in same]),
            channel,
            state,
            _picks_number(float(np.median([b.off_ms for b in same]))),
            cause,
            text,
        )
        for (channel, state, cause, text), same in groups.items()
    ]


def _picks_number(value: float) -> str:
    return f"{value:+.2f}" if np.isfinite(value) else "-"


def picks_page(account: PickAccount) -> str:
    """Return the page about all picks."""
    lines = [f"# {account.recording}", "", _picks_headline(account), ""]
    if account.bad:
        lines += page_table(PICK_HEADER, _picks_rows(account.bad))
    return "\n".join(lines) + "\n"


FIX_HEADER = ("fix", "time [s]", "off [m]", "cause", "misfit", "why", "smallest change")
AGAINST = {"truth": "the truth", "track": "the track (no true places)", "none": "nothing known"}


def print_places(account: PlaceAccount) -> None:
    """Print the figures, the wrong sensors and the bad places."""
    print_line(_places_headline(account))
    if account.undetected:
        print_line(f"{account.undetected} true steps were not detected; see --kind steps")
    if account.causes:
        causes = sorted(account.causes.items(), key=lambda item: -item[1])
        print_line("causes of bad places: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    if account.sensors:
        print_line("\nsensors")
        rows = [_sensor_row(s, account.reference) for s in account.sensors]
        print_table(("sensor", "cause", "why", "change", "what it does"), rows)
    if account.bad:
        print_line("\nplaces")
        print_line(
            "misfit: what a cause leaves unexplained of the arrivals; the next best beside it"
        )
        print_table(FIX_HEADER, _fix_rows(account.bad, account.reference))


def _places_headline(account: PlaceAccount) -> str:
    f = account.figures
    counts = (
        f"{f.right} right, {f.far} more than {account.tolerance_m:g} m off, {f.rejected} rejected, "
        f"{f.missing} without a place"
    )
    rmse = f"RMSE {f.rmse_m:.2f} m" if np.isfinite(f.rmse_m) else "errors unknown"
    against = f"{rmse} against {AGAINST[account.reference]}"
    return f"{account.recording}: places of {account.stage}: {counts}; {against}"


def _sensor_row(s: SensorFault, reference: str) -> tuple[str, ...]:
    if s.before is None or s.after is None:
        return (s.channel, s.cause, s.text, "-", "-")
    off = f"its arrivals {s.before_ms:.2f} -> {s.after_ms:.2f} ms off the curve"
    gain = f"explains them better by {s.gain:.0f}, {s.rival} by {s.rival_gain:.0f} (BIC)"
    does = f"{off}, {_effect(s.before, s.after, reference)}"
    return (s.channel, s.cause, f"{s.text}; {gain}", s.change or "none without harm", does)


def _effect(before: Figures, after: Figures, reference: str) -> str:
    """Return what a change does to all places; a track that bad places made is no measure."""
    parts = []
    if reference == "truth":
        parts.append(f"RMSE {before.rmse_m:.2f} -> {after.rmse_m:.2f} m")
    elif np.isfinite(before.residual) and np.isfinite(after.residual):
        parts.append(
            f"median residual {readable(before.residual, 3)} -> {readable(after.residual, 3)}"
        )
    wrong = [f.far + f.rejected + f.missing for f in (before, after)]
    return ", ".join([*parts, f"bad {wrong[0]} -> {wrong[1]}"])


def _fix_rows(bad: Sequence[FixAccount], reference: str) -> list[tuple[str, ...]]:
    """Return a row for each bad place; those with the same cause and remedy share one."""
    groups: dict[tuple[str, str, str], list[FixAccount]] = {}
    for fix in bad:
        groups.setdefault(_same(fix), []).append(fix)
    rows: list[tuple[str, ...]] = []
    for (cause, text, change), same in groups.items():
        remedy = same[0].cause.remedy if same[0].cause is not None else None
        mends = _remedy(remedy, change, reference, alone=len(same) == 1)
        rows.append(
            (
                spans([f.fix for f in same]),
                first_to_last([f.time_s for f in same]),
                _off(same),
                cause,
                _closest([f.cause for f in same if f.cause is not None]),
                text,
                mends,
            )
        )
    return rows


def _same(fix: FixAccount) -> tuple[str, str, str]:
    cause = fix.cause
    if cause is None:
        return "", "", ""
    change = cause.remedy.change if cause.remedy is not None else ""
    return cause.cause, cause.text, change


def _closest(causes: Sequence[PlaceCause]) -> str:
    """Return the misfit of a cause and of its rival, where they are closest."""
    with_misfit = [c for c in causes if np.isfinite(c.misfit)]
    if not with_misfit:
        return "-"
    c = min(with_misfit, key=lambda c: np.nan_to_num(c.rival_misfit - c.misfit, nan=np.inf))
    beside = f", {c.rival} {c.rival_misfit:.1f}" if c.rival else ""
    return f"{c.misfit:.1f}{beside}"


def _off(fixes: Sequence[FixAccount]) -> str:
    errors = [f.error_m for f in fixes if np.isfinite(f.error_m)]
    states = {f.state for f in fixes} - {"far"}
    note = "/".join(sorted(states))
    if not errors:
        return note or "-"
    span = f"{min(errors):.2f}" + (f"-{max(errors):.2f}" if len(errors) > 1 else "")
    return f"{span} {note}".rstrip()


def _remedy(remedy: PlaceRemedy | None, change: str, reference: str, *, alone: bool) -> str:
    if remedy is None:
        return "no change of one parameter or sensor does it without harm"
    to = f" ({remedy.error_m:.2f} m off)" if alone and np.isfinite(remedy.error_m) else ""
    return f"{change}{to}: {_effect(remedy.before, remedy.after, reference)}"


def print_place(moment: FixMoment, reference: str) -> None:
    """Print everything about one place."""
    print_line(_place_line(moment.fix))
    cause = moment.fix.cause
    if cause is not None:
        print_line(f"{cause.cause}: {cause.text}")
        if np.isfinite(cause.misfit):
            print_line(f"misfit: {_closest([cause])}")
        change = cause.remedy.change if cause.remedy is not None else ""
        print_line(f"smallest change: {_remedy(cause.remedy, change, reference, alone=True)}")
    for r in moment.fix.readings:
        verdict = "pass" if r.passed else "FAIL"
        unit = unit_after(r.unit)
        print_line(
            f"gate {r.gate}: {readable(r.value)}{unit}, "
            f"threshold {readable(r.threshold)}{unit}: {verdict}"
        )
    print_line()
    header = ("channel", "arrival [ms]", "off [ms]", "without it: off [m]", "residual", "")
    print_table(header, _channel_rows(moment))


def _channel_rows(moment: FixMoment) -> list[tuple[str, ...]]:
    return [
        (
            c.channel,
            _places_number(c.arrival_ms, ".2f"),
            _places_number(c.off_ms, "+.2f"),
            _places_number(c.error_without_m, ".2f"),
            _places_number(c.residual_without, ".3g"),
            c.text,
        )
        for c in moment.channels
    ]


def _places_number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _place_line(fix: FixAccount) -> str:
    position = f"({fix.x_m:.2f}, {fix.y_m:.2f}) m" if np.isfinite(fix.x_m) else "nowhere"
    off = f", {fix.error_m:.2f} m off" if np.isfinite(fix.error_m) else ""
    return f"fix {fix.fix} at {fix.time_s:.3f} s: {fix.state}: placed {position}{off}"


def places_page(account: PlaceAccount) -> str:
    """Return the page about all places."""
    lines = [f"# {account.recording}", "", _places_headline(account), ""]
    lines += [f"* {s.channel}, {s.cause}: {s.text}" for s in account.sensors]
    if account.bad:
        rows = [row[: len(FIX_HEADER) - 1] for row in _fix_rows(account.bad, account.reference)]
        lines += ["", *page_table(FIX_HEADER[:-1], rows)]
    return "\n".join(lines) + "\n"


def place_page(moment: FixMoment) -> str:
    """Return the page about one place."""
    lines = [f"# fix {moment.fix.fix}", "", _place_line(moment.fix), ""]
    if moment.fix.cause is not None:
        lines += [f"**{moment.fix.cause.cause}**: {moment.fix.cause.text}", ""]
    header = ("channel", "arrival [ms]", "off [ms]", "off without it [m]", "residual", "")
    lines += page_table(header, _channel_rows(moment))
    return "\n".join(lines) + "\n"


#: So many spans of numbers are written out.
WRITTEN = 4


def spans(numbers: Sequence[int]) -> str:
    """Return rising numbers as spans, e.g. ``1-7, 13``; of many spans only the first."""
    ranges: list[tuple[int, int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], number)
        else:
            ranges.append((number, number))
    texts = [str(a) if a == b else f"{a}-{b}" for a, b in ranges[:WRITTEN]]
    left = sum(b - a + 1 for a, b in ranges[WRITTEN:])
    return ", ".join(texts) + (f" and {left} more" if left else "")


def first_to_last(times_s: Sequence[float]) -> str:
    """Return the span of times, or the only one."""
    text = f"{times_s[0]:.3f}"
    return text if len(times_s) == 1 else f"{text}-{times_s[-1]:.3f}"


def print_account(explanation: StepExplanation) -> None:
    """Print every missed and false step, and how many picks and places are bad."""
    counts = explanation.counts
    print_line(f"{explanation.recording}: {counts.tp} right, {counts.fn} missed, {counts.fp} false")
    if explanation.shift is not None:
        s = explanation.shift
        print_line(
            f"one shift mends {s.mends} of {s.pairs} steps that were found at the wrong time: all "
            f"detections {s.late_ms:+.0f} ms from the truth; without that {s.right} would be "
            f"right; see also --tolerance"
        )
    if explanation.causes:
        causes = sorted(explanation.causes.items(), key=lambda item: -item[1])
        print_line("causes of misses: " + ", ".join(f"{n} {cause}" for cause, n in causes))
    for noun, mended, wrong in (
        ("misses", explanation.mended_missed, explanation.missed),
        ("false steps", explanation.mended_false, explanation.false),
    ):
        if wrong and not explanation.untried:
            print_line(
                f"remedies of {noun}: {mended.one} one change, {mended.two} a pair of changes, "
                f"{mended.none} none"
            )
    if explanation.untried and (explanation.missed or explanation.false):
        print_line(f"remedies: none sought; {_untried_text(explanation.untried)}")
    if explanation.bad_fixes:
        print_line(
            f"places: {explanation.bad_fixes} far off, rejected or missing; see --kind fixes"
        )
    if explanation.bad_picks:
        print_line(f"picks: {explanation.bad_picks} late, early or missed; see --kind picks")
    if explanation.missed:
        print_line("\nmissed")
        header = ("step", "time [s]", "candidate", "cause", "why", "smallest change")
        print_table(header, [_missed_row(m, explanation) for m in explanation.missed])
    if explanation.false:
        print_line("\nfalse")
        rows = [_false_row(f, explanation) for f in explanation.false]
        print_table(("time [s]", "what it is", "narrowest gate", "smallest change"), rows)


def _missed_row(m: Missed, explanation: StepExplanation) -> tuple[str, ...]:
    near = m.reason.candidate_s
    candidate = "none" if near is None else f"{(near - m.time_s) * 1e3:+.0f} ms"
    cause, text = m.reason.cause, m.reason.text
    if m.pair is not None:
        scored = {f.time_s for f in explanation.false}
        outside = "" if m.pair.found_s in scored else ", outside what is scored"
        text = f"{text} (the step found at {m.pair.found_s:.3f} s{outside})"
    return (str(m.step), f"{m.time_s:.3f}", candidate, cause, text, _change_text(m, explanation))


def _false_row(f: FalseDetection, explanation: StepExplanation) -> tuple[str, ...]:
    gate = f.narrowest
    text = (
        "-"
        if gate is None
        else f"{gate.gate} {readable(gate.value)} over {readable(gate.threshold)}"
    )
    answers = "-" if f.pair is None else f.pair.text
    return (f"{f.time_s:.3f}", answers, text, _change_text(f, explanation))


def _change_text(wrong: Missed | FalseDetection, explanation: StepExplanation) -> str:
    """Return what mends a wrong decision; the one shift of all where that is what does it."""
    if wrong.remedy is None and wrong.pair is not None and explanation.shift is not None:
        left_ms = wrong.pair.late_ms - explanation.shift.late_ms
        if abs(left_ms) <= explanation.tolerance_s * 1e3:
            return f"the shift of all detections ({explanation.shift.late_ms:+.0f} ms)"
    return "-" if explanation.untried else remedy_text(wrong.remedy)


def _untried_text(stage: str) -> str:
    return f"{stage} takes signal, so what it makes of other settings takes a replay"


def remedy_text(remedy: Remedy | None) -> str:
    """Return a change and what it does to the steps."""
    if remedy is None:
        return "no change of one or two parameters does it without harm"
    before, after = remedy.before, remedy.after
    return (
        f"{remedy.options}: TP {before.tp}->{after.tp}, FP {before.fp}->{after.fp}, "
        f"FN {before.fn}->{after.fn}"
    )


def print_moment(moment: Moment) -> None:
    """Print every candidate about a moment."""
    if moment.reason is None:
        answers = (
            "" if moment.pair is None else f" at {moment.pair.found_s:.3f} s: {moment.pair.text}"
        )
        print_line(f"{moment.time_s:.3f} s: a step was accepted{answers}")
    else:
        at = "" if moment.pair is None else f" (the step found at {moment.pair.found_s:.3f} s)"
        print_line(
            f"{moment.time_s:.3f} s: no step ({moment.reason.cause}): {moment.reason.text}{at}"
        )
    for link in moment.chain:
        print_link(link)


def print_link(link: Chain) -> None:
    """Print one candidate and its gates."""
    verdict = "accepted" if link.accepted else "rejected"
    print_line(f"\n{link.stage} {link.topic} {link.channel} at {link.time_s:.4f} s: {verdict}")
    rows = [
        (
            "  " + r.gate,
            readable(r.value, 5),
            readable(r.threshold, 5),
            readable(r.margin, sign="+"),
            r.unit,
            "pass" if r.passed else "FAIL",
        )
        for r in link.readings
    ]
    print_table(("  gate", "value", "threshold", "margin", "unit", ""), rows)


VEHICLE_HEADER = ("time [s]", "vehicle", "station", "", "stage", "why", "one setting that mends it")


def print_vehicles(account: VehicleAccount) -> None:
    """Print how many are right, and the reasons of those that are not."""
    print_line(_vehicles_headline(account))
    if account.reasons:
        print_table(VEHICLE_HEADER, _vehicles_rows(account))


def print_vehicle_moment(moment: VehicleMoment) -> None:
    """Print the candidates about a moment."""
    print_line(f"{moment.time_s:.3f} s: {len(moment.chain)} candidates")
    for link in moment.chain:
        print_link(link)


def vehicles_page(account: VehicleAccount) -> str:
    """Return the page about all passes or courses."""
    return f"# {_vehicles_headline(account)}\n"


def _vehicles_headline(account: VehicleAccount) -> str:
    return (
        f"{account.recording}: {account.stage}: {account.right} right, {account.missed} missed, "
        f"{account.false} false"
    )


def _vehicles_rows(account: VehicleAccount) -> list[tuple[str, ...]]:
    return [
        (
            f"{r.time_s:.2f}",
            r.target or "-",
            r.station,
            r.state,
            r.stage,
            r.text,
            f"--set {r.change}" if r.change else "-",
        )
        for r in account.reasons
    ]


READING_WHY = """
## How to read it

* Panels: each candidate's value at one gate, the threshold as a red line. **Green** passed, \
**red** fails at this gate first, **amber** fails here behind another gate.
* White ring: the candidate that explains the moment. White line: the moment.
* Lanes: the same verdicts gate by gate; `score` has steps hit, missed and false; `truth` is what \
the recording says.
"""


def moment_page(moment: Moment, title: str, remedy: Remedy | None) -> str:
    """Return the page about one moment.

    Parameters
    ----------
    moment
        What there is at the moment.
    title
        Which true step it is, e.g. ``step 8``; empty for any other moment.
    remedy
        The smallest change that finds that step; None where there is none, or none is needed.
    """
    lines = [f"# {title or 'moment'} at {moment.time_s:.3f} s", ""]
    if moment.reason is None:
        lines.append("A step was accepted.")
    else:
        lines.append(f"**{moment.reason.cause}**: {moment.reason.text}")
    if moment.pair is not None:
        lines += ["", f"The step found at {moment.pair.found_s:.3f} s {moment.pair.text}."]
    if remedy is not None:
        lines += ["", f"Smallest change: `{remedy.options}`", ""]
        lines += counts_table((("now", remedy.before), ("then", remedy.after)))
    elif title and moment.reason is not None:
        lines += [
            "",
            "No change of one or two parameters finds it without losing more than it mends.",
        ]
    stages = list(dict.fromkeys(link.stage for link in moment.chain))
    for link in sorted(moment.chain, key=lambda link: -stages.index(link.stage)):
        lines += ["", *_chain(link)]
    return "\n".join(lines) + "\n" + READING_WHY


def page_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table as lines of a page."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (header, *rows)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:]]


def counts_table(rows: tuple[tuple[str, Counts], ...]) -> list[str]:
    """Return a table of right, false and missed, as lines of a page."""
    head = ["| | right | false | missed |", "|---|---|---|---|"]
    return head + [f"| {name} | {c.tp} | {c.fp} | {c.fn} |" for name, c in rows]


def _chain(link: Chain) -> list[str]:
    verdict = "accepted" if link.accepted else "rejected"
    head = f"**{link.stage} {link.channel} at {link.time_s:.3f} s: {verdict}**"
    rows = [
        f"| {r.gate} | {readable(r.value)} | {readable(r.threshold)} "
        f"| {readable(r.margin, 3, '+')} "
        f"| {'pass' if r.passed else '**fail**'} |"
        for r in link.readings
    ]
    return [head, "", "| gate | value | threshold | margin | |", "|---|---|---|---|---|", *rows]


def account_page(explanation: StepExplanation) -> str:
    """Return the page about a whole result."""
    lines = [f"# {explanation.recording}", "", *counts_table((("", explanation.counts),)), ""]
    if explanation.shift is not None:
        s = explanation.shift
        lines += [
            f"One shift mends {s.mends} of {s.pairs} steps found at the wrong time: all "
            f"detections {s.late_ms:+.0f} ms from the truth; without that {s.right} are right.",
            "",
        ]
    lines += [f"* {n} missed by {cause}" for cause, n in explanation.causes.items()]
    if explanation.missed:
        rows = [(f"{m.step}", f"{m.time_s:.3f}", m.reason.text) for m in explanation.missed]
        lines += ["", *page_table(("missed", "time [s]", "why"), rows)]
    return "\n".join(lines) + "\n" + READING_WHY
