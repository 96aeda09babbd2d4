"""The sections of the score's page, one for each kind of truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .headings import heading_errors
from .html_parts import confusion_table, figure, folded, section, shown, table, tiles
from .pass_section import pass_section
from .picks import pick_residuals
from .place_figures import (
    distance_figure,
    error_figure,
    heading_figure,
    map_figure,
    pick_figure,
)
from .places import true_places
from .positions import matched_fixes
from .report import last_word
from .step_figures import latency_figure, timeline_figure, tolerance_figure
from .step_matching import match_steps
from .step_timing import best_shift, found_text, timing_pairs
from .tracks import moments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.labels import Label

    from .consistency import Consistency, ConsistencyScore
    from .disturbances import DisturbanceScore
    from .headings import HeadingScore
    from .picks import PickErrors, PickScore
    from .positions import PositionErrors, PositionScore
    from .report import Answers, Score
    from .step_matching import StepMatch
    from .steps import StepScore
    from .tracks import TrackScore

#: So many unmatched steps and impacts are listed; the figures show all.
LISTED = 60


@dataclass(frozen=True, slots=True)
class Scored:
    """What a page is about: truth, what the result says, and the score."""

    labels: Sequence[Label]
    said: Answers
    geometry: Geometry | None
    start_ns: int
    end_ns: int
    tolerance_s: float
    score: Score


def all_sections(scored: Scored) -> str:
    """Return the sections of all parts that were scored."""
    score, span_ns = scored.score, (scored.start_ns, scored.end_ns)
    parts = [
        _steps(scored, score.steps) if score.steps is not None else "",
        _positions(scored, score.positions) if score.positions is not None else "",
        _tracks(scored, score.track) if score.track is not None else "",
        pass_section(scored.labels, scored.said.passes, score.passes, span_ns)
        if score.passes is not None
        else "",
        _picks(scored, score.picks) if score.picks is not None else "",
        _heading(scored, score.heading) if score.heading is not None else "",
        _disturbance(score.disturbance) if score.disturbance is not None else "",
        _consistency(score.consistency) if score.consistency is not None else "",
    ]
    return "".join(parts)


def _steps(scored: Scored, s: StepScore) -> str:
    detected_ns = np.array([step.time_ns for step in scored.said.steps], np.int64)
    matching = match_steps(
        scored.labels, detected_ns, scored.start_ns, scored.end_ns, scored.tolerance_s
    )
    words = (("Left and right", s.feet), ("Kind of step", s.kinds))
    return section(
        "Steps",
        _step_tiles(s)
        + (_step_figures(scored, s, matching) if s.truth or s.detected else "")
        + _wrong_times(matching, scored.start_ns)
        + _unmatched(matching, scored.start_ns)
        + '<div class="row">'
        + "".join(confusion_table(name, c) for name, c in words if c is not None)
        + "</div>",
    )


def _step_tiles(s: StepScore) -> str:
    chance = f"chance: random {s.chance_f1:.2f}, metronome {s.chance_f1_metronome:.2f}"
    late = s.latency_ms
    items = [
        ("F1", f"{s.f1:.3f}", chance),
        ("Precision", f"{s.precision:.3f}", f"{s.detected - s.matched} of {s.detected} false"),
        ("Recall", f"{s.recall:.3f}", f"{s.truth - s.matched} of {s.truth} missed"),
        (
            "Count",
            f"{s.count_truth + s.count_error_signed} of {s.count_truth}",
            f"error {s.count_error_signed:+d}; absolute, span by span: {s.count_error}",
        ),
    ]
    if late is not None:
        without = f"IQR {late.iqr:.0f} ms; F1 without it {s.f1_debiased:.3f}"
        items.append(("Median latency", f"{late.median:+.0f} ms", without))
    return tiles(items if s.truth else items[3:4])


def _step_figures(scored: Scored, s: StepScore, matching: StepMatch) -> str:
    curve = figure(
        "F1 by tolerance",
        tolerance_figure(s, matching, scored.start_ns),
        "What counts is the distance to chance: a wide tolerance flatters anything.",
        result="this result",
        metronome="blind metronome",
        random="random times",
    )
    latency = figure(
        "Latency of matched steps",
        latency_figure(s, matching),
        "Right of zero: detected after the true contact.",
    )
    timeline = figure(
        "Every step",
        timeline_figure(matching, scored.start_ns, scored.end_ns),
        "Shaded time is scored. Rest the mouse on a stroke for its time.",
        hit="matched",
        missed="missed",
        false="false",
    )
    return f'<div class="pair">{curve}{latency}</div>{timeline}'


def _wrong_times(matching: StepMatch, start_ns: int) -> str:
    """Return missed and false steps that are one error each, and the shift that mends most."""
    pairs = timing_pairs(matching)
    if not pairs:
        return ""
    title = f"Missed and false steps that are one, found at the wrong time: {len(pairs)}"
    shift = best_shift(matching, pairs)
    if shift is not None:
        title += (
            f"; all detections {shift.late_ms:+.0f} ms from the truth: without that {shift.mends} "
            f"of them would be right, {shift.right} steps in all"
        )
    rows = [
        (
            str(pair.step),
            f"{(pair.truth_ns - start_ns) / NS_PER_S:.3f}",
            f"{(pair.found_ns - start_ns) / NS_PER_S:.3f}",
            found_text(pair, matching.tolerance_s),
        )
        for pair in pairs[:LISTED]
    ]
    more = f" (the first {LISTED})" if len(pairs) > LISTED else ""
    return table(title + more, ("step", "true time [s]", "false step [s]", "error"), rows)


def _unmatched(matching: StepMatch, start_ns: int) -> str:
    rows = []
    for name, times, alone in (
        ("missed", matching.truth_ns, matching.missed),
        ("false", matching.found_ns, matching.false),
    ):
        if len(alone):
            seconds = (times[alone[:LISTED]] - start_ns) / NS_PER_S
            more = f" and {len(alone) - LISTED} more" if len(alone) > LISTED else ""
            rows.append((name, str(len(alone)), ", ".join(f"{t:.2f}" for t in seconds) + more))
    return table("Steps without a match", ("", "count", "times [s]"), rows) if rows else ""


def _positions(scored: Scored, p: PositionScore) -> str:
    fixes = [fix for fix in scored.said.fixes if fix.stage == p.stage]
    _, errors = matched_fixes(true_places(scored.labels), fixes, scored.tolerance_s)
    numbers = tiles(
        [
            ("RMSE", shown(p.rmse_m, "m"), f"{p.n} fixes at {p.truth} true places"),
            ("CEP50", shown(p.cep50_m, "m"), "half of the fixes are nearer"),
            ("CEP95", shown(p.cep95_m, "m"), "95 % of the fixes are nearer"),
            ("Bias in x", shown(p.bias_x_m, "m", sign=True), f"stage {p.stage}"),
            ("Bias in y", shown(p.bias_y_m, "m", sign=True), f"stage {p.stage}"),
        ]
    )
    plane = figure(
        "Errors in the plane",
        error_figure(errors, p),
        "Circles hold 50 and 95 % of the fixes.",
        fix="fix",
        bias="mean error",
    )
    header = ("", "fixes", "RMSE", "CEP50", "CEP95", "bias x", "bias y")
    tables = table("By number of picks", header, [_position_row(e) for e in p.by_picks])
    if len(p.by_stage) > 1:
        tables += table("By stage", header, [_position_row(e) for e in p.by_stage])
    pair = f'<div class="pair">{plane}{_map(scored)}</div>'
    return section("Positions", f'{numbers}{pair}<div class="row">{tables}</div>')


def _position_row(e: PositionErrors) -> tuple[str, ...]:
    radii = (shown(v, "m") for v in (e.rmse_m, e.cep50_m, e.cep95_m))
    bias = (shown(v, "m", sign=True) for v in (e.bias_x_m, e.bias_y_m))
    return (e.group, str(e.n), *radii, *bias)


def _tracks(scored: Scored, t: TrackScore) -> str:
    found = moments(true_places(scored.labels), scored.said.points, scored.tolerance_s)
    numbers = tiles(
        [
            ("OSPA", shown(t.ospa_m, "m"), f"cut-off {t.cutoff_m:g} m, order {t.order:g}, mean"),
            ("GOSPA", shown(t.gospa_m, "m"), f"{t.missed} missed, {t.false} false over {t.times}"),
            ("Completeness", f"{t.completeness:.1%}", "of the targets have a track"),
            ("Ambiguity", f"{t.ambiguity:.2f}", "tracks per tracked target"),
            ("Spuriousness", f"{t.spuriousness:.1%}", "of the tracks have no target"),
            ("Accuracy", shown(t.accuracy_m, "m"), "mean distance of track and target"),
        ]
    )
    over_time = figure(
        "Distance over time",
        distance_figure(found, scored.start_ns),
        result="OSPA",
        metronome="GOSPA",
    )
    beside = "" if scored.said.fixes else _map(scored)
    return section("Tracks", f'{numbers}<div class="pair">{over_time}{beside}</div>')


def _map(scored: Scored) -> str:
    fixes = last_word(scored.said.fixes)
    drawn = map_figure(true_places(scored.labels), fixes, scored.said.points, scored.geometry)
    keys = {"truth": "truth"}
    keys |= {"fix": "fixes"} if fixes else {}
    keys |= {"result": "tracks"} if scored.said.points else {}
    keys |= {"sensor": "sensors"} if scored.geometry is not None else {}
    return figure("Map", drawn, **keys)


def _picks(scored: Scored, p: PickScore) -> str:
    e = p.all
    numbers = tiles(
        [
            ("Answered", f"{e.answered_fraction:.1%}", f"{e.answered} of {e.truth} within 50 ms"),
            ("Median |error|", shown(e.median_abs_ms, "ms"), "of the answered arrivals"),
            ("Median error", shown(e.median_ms, "ms", sign=True), f"IQR {shown(e.iqr_ms, 'ms')}"),
            ("Earliest", shown(e.earliest_ms, "ms", sign=True), "of all first picks"),
            ("Latest", shown(e.latest_ms, "ms", sign=True), "of all first picks"),
        ]
    )
    errors = figure(
        "Errors by impact",
        pick_figure(pick_residuals(scored.labels, scored.said.picks)),
        "Channels side by side; errors beyond the axis stand at its edge.",
        result="answered",
        false="more than 50 ms off",
        missed="no pick",
        median="median",
    )
    header = ("impact", "answered", "median |error|", "median", "earliest", "latest")
    rows = [_pick_row(i, e) for i, e in enumerate(p.impacts[:LISTED])]
    more = f", the first {LISTED} of {len(p.impacts)}" if len(p.impacts) > LISTED else ""
    return section("Picks", numbers + errors + folded(f"By impact{more}", table("", header, rows)))


def _pick_row(index: int, e: PickErrors) -> tuple[str, ...]:
    return (
        f"{index + 1}  {e.label}",
        f"{e.answered} of {e.truth}",
        shown(e.median_abs_ms, "ms"),
        *(shown(v, "ms", sign=True) for v in (e.median_ms, e.earliest_ms, e.latest_ms)),
    )


def _heading(scored: Scored, h: HeadingScore) -> str:
    times, errors = heading_errors(scored.labels, scored.said.headings, scored.tolerance_s)
    numbers = tiles(
        [
            ("RMSE", shown(h.rmse_deg, "deg", 1), f"{h.n} of {h.truth} true headings"),
            ("Bias", shown(h.bias_deg, "deg", 1, sign=True), "mean error"),
            ("95 % within", shown(h.p95_deg, "deg", 1), f"stage {h.stage}"),
        ]
    )
    drawn = figure("Error over time", heading_figure(times, errors, scored.start_ns))
    return section("Heading", f'{numbers}<div class="pair">{drawn}</div>')


def _disturbance(d: DisturbanceScore) -> str:
    alarm = ("False alarm", f"{d.false_alarm_s:.2f} s", f"of {d.scored_s:.2f} s scored")
    if d.f1 is None:
        return section("Disturbances", tiles([alarm]) + "<p>Truth has no disturbed span.</p>")
    numbers = tiles(
        [
            ("F1", f"{d.f1:.3f}", "frames of 10 ms"),
            ("Precision", shown(d.precision, "", 3), f"{d.both_s:.2f} of {d.found_s:.2f} s found"),
            ("Recall", shown(d.recall, "", 3), f"{d.both_s:.2f} of {d.truth_s:.2f} s true"),
            alarm,
        ]
    )
    return section("Disturbances", numbers)


def _consistency(c: ConsistencyScore) -> str:
    named = (("NEES of fixes", c.nees_fixes), ("NEES of tracks", c.nees_tracks), ("NIS", c.nis))
    header = ("", "values", "mean", "expected", "95 % bounds", "verdict", "below own 95 % bound")
    rows = [_consistency_row(name, x) for name, x in named if x is not None]
    return section("Consistency", table("", header, rows))


def _consistency_row(name: str, x: Consistency) -> tuple[str, ...]:
    verdict = (
        "consistent" if x.consistent else "too sure" if x.mean > x.upper else "not sure enough"
    )
    bounds = f"{x.lower:.2f} to {x.upper:.2f}"
    return (
        name,
        str(x.n),
        f"{x.mean:.2f}",
        str(x.dof),
        bounds,
        verdict,
        f"{x.inside_fraction:.1%}",
    )
