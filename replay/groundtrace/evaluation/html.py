"""The page of a score: one HTML file that needs no other file and no network."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape
from pathlib import PureWindowsPath
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .headings import heading_errors
from .matching import (
    STEP_TOLERANCE_S,
    best_shift,
    found_text,
    match_steps,
    metronome_f1,
    random_f1,
    timing_pairs,
)
from .picks import ANSWER_S, pick_residuals
from .positions import matched_fixes, true_places
from .report import answers_of, last_word
from .tracks import moments
from .truth import ScoredTruth
from .vehicles import match_passes, scored_passes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, Label, Pass, TrackPoint
    from groundtrace_codecs.geometry import Geometry

    from ..pipeline.results import Provenance, Results
    from ..pipeline.warned import Warned
    from .headings import DisturbanceScore, HeadingScore
    from .matching import StepMatch
    from .picks import PickErrors, PickResiduals, PickScore
    from .positions import Places, PositionErrors, PositionScore
    from .report import ResultEvents, Score
    from .steps import Confusion, StepScore
    from .tracks import Consistency, ConsistencyScore, Moment, TrackScore
    from .vehicles import PassScore, VehiclePass

POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def score_page(
    result: Results,
    labels: Sequence[Label] | ScoredTruth,
    score: Score,
    tolerance_s: float = STEP_TOLERANCE_S,
    stages: Collection[str] = (),
) -> str:
    """Return a score as an HTML page with figures.

    The page asks nothing of any server, runs no script and names no folder.

    Parameters
    ----------
    result
        What was scored.
    labels
        The truth, perhaps with remarks on it.
    score
        The result's score against it.
    tolerance_s
        The score's tolerance [s].
    stages
        Those chosen for the score.
    """
    origin = result.provenance
    remarks = labels.remarks if isinstance(labels, ScoredTruth) else ()
    truth = labels.labels if isinstance(labels, ScoredTruth) else labels
    said = answers_of(result.events, stages)
    scored = Scored(
        truth, said, result.geometry, origin.start_ns, origin.end_ns, tolerance_s, score
    )
    name = PureWindowsPath(origin.recording).name
    seconds = (origin.end_ns - origin.start_ns) / NS_PER_S
    subtitle = f"{seconds:.1f} s recorded, steps matched within {1e3 * tolerance_s:.0f} ms"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Score of {escape(name)}</title><style>{STYLE}</style></head>\n<body><main>"
        f'<header><p class="brand">groundtrace score</p><h1>{escape(name)}</h1>'
        f'<p class="sub">{escape(subtitle)}</p>{warned(result.warnings)}'
        + "".join(f"<p>Truth: {escape(remark)}.</p>" for remark in remarks)
        + "</header>\n"
        f"{all_sections(scored)}\n{_origin(origin)}</main></body></html>\n"
    )


def _origin(origin: Provenance) -> str:
    """Return where the result comes from: hash, versions, the whole recipe."""
    versions = ", ".join(f"{name} {number}" for name, number in origin.versions.items())
    rows = [
        ("recording", PureWindowsPath(origin.recording).name),
        ("SHA-256", origin.sha256),
        ("versions", versions),
    ]
    recipe = folded("Pipeline, with every parameter", f"<pre>{escape(origin.pipeline)}</pre>")
    return section("Origin", table("", ("", ""), rows) + recipe)


#: Colours after Okabe and Ito (2008), told apart by colour-blind people, on light and dark.
STYLE = """
:root{--paper:#fff;--card:#f6f7f9;--ink:#1b2028;--soft:#5c6673;--rule:#dfe3e8;--result:#0072b2;
--hit:#00916a;--missed:#d1480f;--false:#b8377f;--chance:#8a94a0;--random:#b9802f;--scored:#e9f1f7}
@media(prefers-color-scheme:dark){:root{--paper:#14171c;--card:#1c2027;--ink:#e7eaee;
--soft:#9aa5b1;--rule:#313843;--result:#56b4e9;--hit:#2fc296;--missed:#ff7a45;--false:#e57fb8;
--chance:#8a94a0;--random:#e0aa5c;--scored:#1f2a36}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
main{max-width:1240px;margin:0 auto;padding:36px 32px 64px}
header{border-bottom:2px solid var(--ink);padding-bottom:14px}
h1{font-size:30px;line-height:1.2;margin:2px 0;overflow-wrap:anywhere}
.brand{margin:0;color:var(--result);font-weight:600;letter-spacing:.04em}
.sub{margin:0;color:var(--soft)}
section{margin-top:34px}
h2{font-size:21px;margin:0 0 14px}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:12px;margin:0}
.tiles div{background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:12px 14px}
.tiles dt{color:var(--soft);font-size:13px}
.tiles dd{margin:0;font-size:25px;font-weight:600;font-variant-numeric:tabular-nums}
.tiles dd small{display:block;font-size:12.5px;font-weight:400;color:var(--soft)}
.pair{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(480px,100%),1fr));gap:0 28px}
.row{display:flex;flex-wrap:wrap;gap:0 56px}
figure{margin:20px 0 0}
figcaption{color:var(--soft);font-size:13.5px;margin-top:4px}
.figure-title,caption{font-weight:600;margin:0 0 6px;text-align:left}
caption{white-space:nowrap}
.key{display:inline-block;width:14px;height:10px;border-radius:2px;margin:0 6px 0 0}
.keys{display:block}.keys span{margin-right:16px;white-space:nowrap}
svg{display:block;width:100%;height:auto;font-family:inherit}
svg text{fill:var(--soft);font-size:12px}
svg text.note{fill:var(--ink);paint-order:stroke;stroke:var(--paper);stroke-width:4px}
svg text.label{fill:var(--ink);font-size:13px}
svg text.mid{text-anchor:middle}
svg text.end{text-anchor:end}
.grid{stroke:var(--rule)}.zero{stroke:var(--soft)}.mark{stroke:var(--ink);stroke-dasharray:5 4}
.scored{fill:var(--scored)}.bar{fill:var(--result)}
.line{fill:none;stroke-width:2.2;stroke-linejoin:round}
.line.result{stroke:var(--result)}.line.metronome{stroke:var(--chance);stroke-dasharray:7 4}
.line.random{stroke:var(--random);stroke-dasharray:2 4;stroke-linecap:round}
.line.truth{stroke:var(--hit);stroke-width:1.2}.line.outline{stroke:var(--soft);stroke-width:1.2}
.line.median{stroke:var(--ink)}
.dot.result{fill:var(--result)}.dot.fix{fill:var(--random)}.dot.metronome{fill:var(--chance)}
.dot.random{fill:var(--random)}.dot.truth{fill:var(--hit)}.dot.missed{fill:var(--missed)}
.dot.false{fill:var(--false)}.dot.bias{fill:none;stroke:var(--missed);stroke-width:2.5}
.ring{fill:none;stroke:var(--soft);stroke-dasharray:4 3}.sensor{fill:var(--soft)}
.stroke{stroke-width:1.6}.stroke.hit{stroke:var(--hit)}
.stroke.missed{stroke:var(--missed);stroke-width:4}.stroke.false{stroke:var(--false);stroke-width:4}
.key.result{background:var(--result)}.key.metronome{background:var(--chance)}
.key.random,.key.fix{background:var(--random)}.key.hit,.key.truth{background:var(--hit)}
.key.missed,.key.bias{background:var(--missed)}.key.false{background:var(--false)}
.key.median{background:var(--ink);height:3px;vertical-align:middle}.key.sensor{background:var(--soft)}
.scroll{overflow-x:auto;margin-top:20px}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:5px 18px 5px 0;text-align:left;border-bottom:1px solid var(--rule);vertical-align:top}
th{color:var(--soft);font-weight:500;font-size:13.5px}
td{overflow-wrap:anywhere}
details{margin-top:16px}summary{cursor:pointer;color:var(--result)}
pre{background:var(--card);border:1px solid var(--rule);border-radius:8px;padding:14px;
overflow-x:auto;font-size:13px}
.warned{margin:10px 0 0;padding:0;list-style:none;color:var(--missed)}
@media print{main{padding:0}section{break-inside:avoid}}
"""


def warned(warnings: Sequence[Warned]) -> str:
    """Return what a replay warned of as a list for the head of a page; empty where of nothing."""
    items = "".join(f"<li>Warning: {escape(each.line)}</li>" for each in warnings)
    return f'<ul class="warned">{items}</ul>' if items else ""


def section(title: str, content: str) -> str:
    """Return a section; ``content`` is HTML."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>\n"


def tiles(items: Sequence[tuple[str, str, str]]) -> str:
    """Return tiles of (name, figure, remark)."""
    cells = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(remark)}</small></dd></div>"
        for name, value, remark in items
    )
    return f'<dl class="tiles">{cells}</dl>'


def figure(title: str, svg: str, caption: str = "", **keys: str) -> str:
    """Return a figure; ``keys`` name what each colour stands for."""
    named = "".join(
        f'<span><i class="key {style}"></i>{escape(name)}</span>' for style, name in keys.items()
    )
    legend = f'<span class="keys">{named}</span>' if named else ""
    heading = f'<p class="figure-title">{escape(title)}</p>' if title else ""
    return f"<figure>{heading}{svg}<figcaption>{legend}{escape(caption)}</figcaption></figure>"


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    caption = f"<caption>{escape(title)}</caption>" if title else ""
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    named = f"<thead><tr>{head}</tr></thead>" if any(header) else ""
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f'<div class="scroll"><table>{caption}{named}<tbody>{body}</tbody></table></div>'


def folded(title: str, content: str) -> str:
    """Return HTML that shows when its title is clicked."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def confusion_table(title: str, c: Confusion) -> str:
    """Return a confusion matrix: rows are truth, columns detections."""
    rows = [(word, *map(str, counts)) for word, counts in zip(c.words, c.counts, strict=True)]
    header = ("truth \\ found", *c.words)
    said = f"{title}: {c.agreed} of {c.compared} agree ({c.accuracy:.1%})"
    return table(said, header, rows)


def shown(value: float | None, unit: str, digits: int = 2, *, sign: bool = False) -> str:
    """Return a number with its unit, or a dash."""
    if value is None:
        return "\N{EN DASH}"
    return f"{value:{'+' if sign else ''}.{digits}f} {unit}"


#: So many unmatched steps and impacts are listed; the figures show all.
LISTED = 60


@dataclass(frozen=True, slots=True)
class Scored:
    """What a page is about: truth, what the result says, and the score."""

    labels: Sequence[Label]
    said: ResultEvents
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


LEFT, RIGHT, TOP, BOTTOM = 58, 16, 14, 44


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis: what it shows, with its unit, and from where to where."""

    label: str
    low: float
    high: float

    def ticks(self, about: int = 6) -> list[float]:
        """Return round values within the axis: 1, 2 or 5 times a power of ten apart."""
        rough = (self.high - self.low) / about
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * 0.999)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


def number(value: float) -> str:
    """Return a coordinate or tick as short text."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def element(tag: str, style: str, title: str = "", **attributes: float | str) -> str:
    """Return an SVG element of a class; the title shows where the mouse rests."""
    pairs = "".join(
        f' {name}="{number(value) if isinstance(value, int | float) else escape(value)}"'
        for name, value in attributes.items()
    )
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<{tag} class="{style}"{pairs}>{inner}</{tag}>'


def text(x: float, y: float, words: str, style: str = "note") -> str:
    """Return text at a place in pixels."""
    return f'<text class="{style}" x="{number(x)}" y="{number(y)}">{escape(words)}</text>'


def span_of(values: NDArray[np.float64], label: str, least: float = 1e-3) -> Axis:
    """Return an axis that holds all finite values with a margin, at least ``least`` long."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = max(0.06 * (high - low), (least - (high - low)) / 2)
    return Axis(label, low - margin, high + margin)


@dataclass(slots=True)
class Plot:
    """A plot that grows by its methods and comes out as SVG.

    Attributes
    ----------
    x, y
        The axes.
    width, height
        Of the whole picture [px].
    rows
        Names of values of y in place of its ticks; empty for ticks.
    """

    x: Axis
    y: Axis
    width: int = 560
    height: int = 320
    parts: list[str] = field(default_factory=list)
    rows: dict[float, str] = field(default_factory=dict)

    def named_rows(self, names: dict[float, str]) -> Plot:
        """Name values of the y axis in place of its ticks."""
        self.rows = names
        return self

    def px(self, value: float) -> float:
        """Return the horizontal place of a value [px]."""
        part = (value - self.x.low) / (self.x.high - self.x.low)
        return LEFT + part * (self.width - LEFT - RIGHT)

    def py(self, value: float) -> float:
        """Return the vertical place of a value [px]."""
        part = (value - self.y.low) / (self.y.high - self.y.low)
        return self.height - BOTTOM - part * (self.height - TOP - BOTTOM)

    def add(self, tag: str, style: str, title: str = "", **attributes: float | str) -> None:
        """Add an element, as :func:`element` makes it."""
        self.parts.append(element(tag, style, title, **attributes))

    def line(self, points: Iterable[tuple[float, float]], style: str) -> None:
        """Add a line through points; it breaks where one is not finite."""
        pieces: list[list[str]] = [[]]
        for x, y in points:
            if math.isfinite(x) and math.isfinite(y):
                pieces[-1].append(f"{number(self.px(x))},{number(self.py(y))}")
            elif pieces[-1]:
                pieces.append([])
        for piece in pieces:
            if len(piece) > 1:
                self.add("polyline", f"line {style}", points=" ".join(piece))

    def dot(self, x: float, y: float, style: str, title: str = "", radius: float = 3.2) -> None:
        """Add a dot."""
        self.add("circle", style, title, cx=self.px(x), cy=self.py(y), r=radius)

    def box(
        self, x: tuple[float, float], y: tuple[float, float], style: str, title: str = ""
    ) -> None:
        """Add a filled rectangle."""
        left, right = self.px(x[0]), self.px(x[1])
        low, high = self.py(y[0]), self.py(y[1])
        self.add("rect", style, title, x=left, y=high, width=right - left, height=low - high)

    def vertical(self, x: float, style: str, title: str = "") -> None:
        """Add a line over the whole height."""
        at = self.px(x)
        self.add("line", style, title, x1=at, x2=at, y1=self.py(self.y.low), y2=TOP)

    def horizontal(self, y: float, style: str) -> None:
        """Add a line over the whole width."""
        at = self.py(y)
        self.add("line", style, x1=LEFT, x2=self.width - RIGHT, y1=at, y2=at)

    def text(self, x: float, y: float, words: str, style: str = "note") -> None:
        """Add text at a place in pixels."""
        self.parts.append(text(x, y, words, style))

    def svg(self, title: str) -> str:
        """Return the picture; ``title`` is read to those who cannot see it."""
        return picture(self.width, self.height, title, [*self._axes(), *self.parts])

    def _axes(self) -> list[str]:
        frame = Plot(self.x, self.y, self.width, self.height)
        floor, middle = self.height - BOTTOM, (self.height - TOP - BOTTOM) / 2 + TOP
        for value in self.x.ticks(max(2, self.width // 90)):
            frame.vertical(value, "grid")
            frame.text(self.px(value), floor + 17, number(value), "tick mid")
        named = self.rows or {v: number(v) for v in self.y.ticks(max(2, self.height // 60))}
        for value, name in named.items():
            frame.horizontal(value, "grid")
            frame.text(LEFT - 7, self.py(value) + 4, name, "tick end")
        frame.text((LEFT + self.width - RIGHT) / 2, self.height - 6, self.x.label, "label mid")
        frame.parts.append(
            f'<text class="label mid" transform="translate(14 {number(middle)}) rotate(-90)">'
            f"{escape(self.y.label)}</text>"
        )
        return frame.parts


def picture(width: int, height: int, title: str, parts: Sequence[str]) -> str:
    """Return an SVG element that fits the width of its place."""
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">'
        f"{''.join(parts)}</svg>"
    )


#: Lengths that a row of the timeline may have [s]; the first ones only as its sole row.
ROW_S = (5, 10, 15, 20, 30, 60, 120, 300, 600, 1800, 3600, 7200)
SOLE_S = 30
MOST_ROWS = 24
WIDTH = 1160
ROW_PX = 58
MARGIN_PX = 46


def tolerance_figure(score: StepScore, matching: StepMatch, start_ns: int) -> str:
    """Return F1 over tolerance, with what random and metronome detections would reach."""
    truth = (matching.truth_ns - start_ns) / NS_PER_S
    tolerances = [t for t, _ in score.curve]
    plot = Plot(Axis("Tolerance [ms]", 0, 1e3 * tolerances[-1]), Axis("F1 (0 to 1)", 0, 1))
    for name, f1 in (("metronome", metronome_f1), ("random", random_f1)):
        values = [f1(truth, matching.spans, score.detected, t) for t in tolerances]
        _series(plot, tolerances, values, name, name)
    plot.vertical(1e3 * score.tolerance_s, "mark", "tolerance of the score")
    _series(plot, tolerances, [f1 for _, f1 in score.curve], "result", "this result")
    return plot.svg("F1 over tolerance, with two levels of chance")


def _series(
    plot: Plot, tolerances: list[float], values: list[float], style: str, name: str
) -> None:
    plot.line(zip([1e3 * t for t in tolerances], values, strict=True), style)
    for t, value in zip(tolerances, values, strict=True):
        plot.dot(1e3 * t, value, f"dot {style}", f"{name}: F1 {value:.3f} at {1e3 * t:.0f} ms", 2.6)


def latency_figure(score: StepScore, matching: StepMatch) -> str:
    """Return the histogram of detection minus truth of the matched steps."""
    pairs = matching.pairs
    late = (matching.found_ns[pairs[:, 1]] - matching.truth_ns[pairs[:, 0]]) / 1e6
    widest = 1.2 * float(np.abs(late).max(initial=0.0))
    reach = min(1e3 * score.tolerance_s, max(10.0, widest))
    edges = np.linspace(-reach, reach, 25)
    counts, _ = np.histogram(late, edges)
    top = max(4.0, 1.15 * float(counts.max()))
    plot = Plot(Axis("Detection minus truth [ms]", -reach, reach), Axis("Steps [count]", 0, top))
    for low, high, count in zip(edges, edges[1:], counts, strict=False):
        if count:
            plot.box((low, high), (0, float(count)), "bar", f"{low:.0f} to {high:.0f} ms: {count}")
    plot.vertical(0, "zero")
    if score.latency_ms is not None:
        plot.vertical(score.latency_ms.median, "mark", "median")
    return plot.svg("Histogram of latency")


def timeline_figure(matching: StepMatch, start_ns: int, end_ns: int) -> str:
    """Return every scored step in rows of time: truth above, detections below the line.

    Rows in which nothing happens are left out.
    """
    length = max((end_ns - start_ns) / NS_PER_S, 1.0)
    rows = 1 if length <= SOLE_S else MOST_ROWS
    fitting = (r for r in ROW_S if r * rows >= length and r >= min(length, SOLE_S))
    row_s = next(fitting, length / MOST_ROWS)
    marks = [
        *_marks(matching.truth_ns, matching.missed, "missed", start_ns),
        *_marks(matching.found_ns, matching.false, "false", start_ns),
    ]
    last = int(length / row_s)
    by_row: dict[int, list[Mark]] = {}
    for mark in marks:
        by_row.setdefault(min(max(int(mark.time_s / row_s), 0), last), []).append(mark)
    parts: list[str] = []
    for place, k in enumerate(sorted(by_row)):
        row = Row(k * row_s, row_s, place * ROW_PX)
        parts += [*row.frame(), *row.spans(matching.spans), *map(row.stroke, by_row[k])]
    foot = ROW_PX * len(by_row) + 16
    parts.append(text(WIDTH / 2, foot, "Time since the first sample [s]", "label mid"))
    return picture(WIDTH, foot + 6, "Steps over time", parts)


class Mark(NamedTuple):
    """A step on the timeline: when, what became of it, and whether it is a true one."""

    time_s: float
    style: str
    true: bool


def _marks(
    times_ns: NDArray[np.int64], alone: NDArray[np.intp], style: str, start_ns: int
) -> list[Mark]:
    unmatched = set(alone.tolist())
    return [
        Mark((int(t) - start_ns) / NS_PER_S, style if i in unmatched else "hit", style == "missed")
        for i, t in enumerate(times_ns)
    ]


@dataclass(frozen=True, slots=True)
class Row:
    """One row of the timeline: its first second, its length, its place from the top [px]."""

    begin_s: float
    length_s: float
    top: float

    def px(self, time_s: float) -> float:
        """Return the horizontal place of a time, within the row [px]."""
        part = min(max((time_s - self.begin_s) / self.length_s, 0.0), 1.0)
        return MARGIN_PX + part * (WIDTH - MARGIN_PX - 14)

    def frame(self) -> list[str]:
        """Return the middle line, ticks and names of the halves."""
        end_s, middle = self.begin_s + self.length_s, self.top + 22
        x1, x2 = self.px(self.begin_s), self.px(end_s)
        out = [element("line", "zero", x1=x1, x2=x2, y1=middle, y2=middle)]
        for tick in Axis("", self.begin_s, end_s).ticks(12):
            x = self.px(tick)
            out.append(element("line", "grid", x1=x, x2=x, y1=self.top + 41, y2=self.top + 45))
            out.append(text(x, self.top + 55, number(tick), "tick mid"))
        for y, name in ((16, "truth"), (36, "found")):
            out.append(text(MARGIN_PX - 6, self.top + y, name, "tick end"))
        return out

    def spans(self, spans: NDArray[np.float64]) -> list[str]:
        """Return the shades of what is scored."""
        end_s = self.begin_s + self.length_s
        return [
            element(
                "rect",
                "scored",
                f"scored: {a:.2f} to {b:.2f} s",
                x=self.px(a),
                y=self.top + 2,
                width=self.px(b) - self.px(a),
                height=40,
            )
            for a, b in spans
            if a < end_s and b > self.begin_s
        ]

    def stroke(self, mark: Mark) -> str:
        """Return the stroke of a step: above the line for a true one."""
        x = self.px(mark.time_s)
        y1, y2 = (self.top + 5, self.top + 21) if mark.true else (self.top + 23, self.top + 39)
        name = {"hit": "matched"}.get(mark.style, mark.style)
        title = f"{'step' if mark.true else 'detection'} at {mark.time_s:.3f} s: {name}"
        return element("line", f"stroke {mark.style}", title, x1=x, x2=x, y1=y1, y2=y2)


WIDE = 1160


def pick_figure(residuals: PickResiduals) -> str:
    """Return the errors of the first picks, impact by impact; far ones at the edge."""
    errors, states = residuals.error_s * 1e3, residuals.states()
    known = np.abs(errors[~np.isnan(errors)])
    reach = float(np.clip(1.3 * np.percentile(known, 98) if len(known) else 1, 0.5, ANSWER_S * 1e3))
    count = len(residuals.impacts)
    axis = Axis("Impact [number]", 0.4, count + 0.6)
    plot = Plot(axis, Axis("Pick minus arrival [ms]", -1.1 * reach, 1.1 * reach), WIDE, 300)
    plot.horizontal(0, "zero")
    for i, name in enumerate(residuals.impacts):
        of = np.flatnonzero(residuals.impact == i)
        good = errors[[k for k in of if states[k] != "missed"]]
        if len(good):
            middle = float(np.clip(np.median(good), -reach, reach))
            plot.line([(i + 0.75, middle), (i + 1.25, middle)], "median")
        for place, k in enumerate(of):
            x = i + 1 + 0.44 * (place / max(len(of) - 1, 1) - 0.5)
            title = f"{name}, {residuals.channels[k]}: "
            if np.isnan(errors[k]):
                plot.dot(x, -reach, "dot missed", title + "no pick")
                continue
            style = "dot false" if states[k] == "missed" else "dot result"
            y = float(np.clip(errors[k], -reach, reach))
            plot.dot(x, y, style, f"{title}{errors[k]:+.2f} ms", 2.6)
    return plot.svg("Errors of picks by impact")


def error_figure(errors: NDArray[np.float64], score: PositionScore) -> str:
    """Return the errors of fixes in the plane, with the circles that hold 50 and 95 %."""
    reach = 1.15 * float(max(np.abs(errors).max(initial=0.0), score.cep95_m or 0.0, 0.01))
    plot = _to_scale(Axis("Error in x [m]", -reach, reach), Axis("Error in y [m]", -reach, reach))
    plot.vertical(0, "zero")
    plot.horizontal(0, "zero")
    names: list[tuple[float, float, str]] = []
    for name, radius in (("CEP50", score.cep50_m), ("CEP95", score.cep95_m)):
        if radius is not None:
            size = plot.px(radius) - plot.px(0)
            title = f"{name}: {radius:.2f} m"
            plot.add("circle", "ring", title, cx=plot.px(0), cy=plot.py(0), r=size)
            names.append((plot.px(0) + 0.72 * size, plot.py(0) - 0.72 * size, name))
    for x, y in errors:
        plot.dot(float(x), float(y), "dot fix", f"{x:+.2f} m, {y:+.2f} m")
    if score.bias_x_m is not None and score.bias_y_m is not None:
        plot.dot(score.bias_x_m, score.bias_y_m, "dot bias", "mean error", 5)
    for across, down, name in names:
        plot.text(across, down, name)
    return plot.svg("Errors of position fixes")


def map_figure(
    truth: Places,
    fixes: Sequence[Fix],
    points: Sequence[TrackPoint],
    geometry: Geometry | None,
) -> str:
    """Return truth, fixes, tracks and sensors in the plane, to scale."""
    outline = [*geometry.outline, *geometry.outline[:1]] if geometry is not None else []
    sensors = geometry.sensors if geometry is not None else ()
    everything = [
        *truth.xy.tolist(),
        *((e.x_m, e.y_m) for e in fixes),
        *((e.x_m, e.y_m) for e in points),
        *outline,
        *((s.x, s.y) for s in sensors),
    ]
    xy = np.array(everything, np.float64)
    plot = _to_scale(span_of(xy[:, 0], "x [m]", 1.0), span_of(xy[:, 1], "y [m]", 1.0))
    plot.line(outline, "outline")
    for s in sensors:
        plot.add(
            "rect", "sensor", s.name, x=plot.px(s.x) - 4, y=plot.py(s.y) - 4, width=8, height=8
        )
    plot.line(truth.xy, "truth")
    for x, y in truth.xy:
        plot.dot(float(x), float(y), "dot truth", f"truth {x:.2f} m, {y:.2f} m")
    for number in sorted({p.track for p in points}):
        plot.line([(p.x_m, p.y_m) for p in points if p.track == number], "result")
    for fix in fixes:
        plot.dot(fix.x_m, fix.y_m, "dot fix", f"fix {fix.x_m:.2f} m, {fix.y_m:.2f} m", 2.6)
    return plot.svg("Map of truth, fixes and tracks")


def _to_scale(x: Axis, y: Axis) -> Plot:
    """Return a plot that holds both axes and in which a metre is as long in x as in y."""
    plot = Plot(x, y, 560, 404)
    across = plot.px(x.high) - plot.px(x.low)
    upward = plot.py(y.low) - plot.py(y.high)
    metre = min(across / (x.high - x.low), upward / (y.high - y.low))
    plot.x, plot.y = _stretched(x, across / metre), _stretched(y, upward / metre)
    return plot


def _stretched(axis: Axis, length: float) -> Axis:
    extra = (length - (axis.high - axis.low)) / 2
    return Axis(axis.label, axis.low - extra, axis.high + extra)


def distance_figure(found: Sequence[Moment], start_ns: int) -> str:
    """Return OSPA and GOSPA over time."""
    seconds = np.array([(m.time_ns - start_ns) / NS_PER_S for m in found])
    top = 1.1 * max(0.1, *(max(m.ospa_m, m.gospa_m) for m in found))
    x = span_of(seconds, "Time since the first sample [s]", 1.0)
    plot = Plot(x, Axis("Distance [m]", 0, top))
    plot.line(zip(seconds, (m.gospa_m for m in found), strict=True), "metronome")
    plot.line(zip(seconds, (m.ospa_m for m in found), strict=True), "result")
    return plot.svg("OSPA and GOSPA over time")


def heading_figure(
    times_ns: NDArray[np.int64], errors_rad: NDArray[np.float64], start_ns: int
) -> str:
    """Return the error of the heading over time."""
    seconds = (times_ns - start_ns) / NS_PER_S
    errors = np.degrees(errors_rad)
    x = span_of(seconds, "Time since the first sample [s]", 1.0)
    plot = Plot(x, span_of(np.append(errors, 0.0), "Heading minus truth [deg]", 2.0))
    plot.horizontal(0, "zero")
    plot.line(zip(seconds, errors, strict=True), "result")
    for t, error in zip(seconds, errors, strict=True):
        if np.isfinite(error):
            plot.dot(float(t), float(error), "dot result", f"{t:.2f} s: {error:+.1f} deg", 2.2)
    return plot.svg("Error of the heading over time")


_WIDTH, _ROW_PX, _FRAME_PX = 1160, 44, 90
_RIGHT = {None: "not told", True: "right", False: "wrong"}


def pass_section(
    labels: Sequence[Label], passes: Sequence[Pass], p: PassScore, span_ns: tuple[int, int]
) -> str:
    """Return the section of a score of passes.

    Parameters
    ----------
    labels, passes
        What was scored.
    p
        The score.
    span_ns
        First and last sample of the recording [ns].
    """
    drawn = figure(
        "Every pass",
        pass_figure(labels, passes, span_ns),
        "One row for each station. Rest the mouse on a dot for its vehicle, direction and speed.",
        result="found",
        truth="true, found",
        missed="true, missed",
        false="false",
    )
    header = ("vehicle", "stations", "told as one", "direction", "speed", "error of speed")
    vehicles = table("By vehicle", header, [_row(v) for v in p.vehicles])
    return section("Passes", _tiles(p) + drawn + vehicles)


def _tiles(p: PassScore) -> str:
    right = f"{p.vehicles_right} of {len(p.vehicles)}"
    return tiles(
        [
            ("Found", f"{p.matched} of {p.truth}", f"within {p.tolerance_s:g} s at their station"),
            ("False", str(p.found - p.matched), f"of {p.found} found, stage {p.stage}"),
            ("Vehicles right", right, "told as one, and the direction right"),
            ("Order", "right" if p.order_right else "wrong", "of passes that are clearly apart"),
            ("Median |error|", shown(p.median_abs_s, "s"), f"bias {shown(p.bias_s, 's')}"),
            ("Error of speed", shown(p.speed_median_percent, "%", 1), "median over vehicles"),
        ]
    )


def _row(v: VehiclePass) -> tuple[str, ...]:
    return (
        v.target or "\N{EN DASH}",
        f"{v.found} of {v.truth}",
        str(v.together),
        _RIGHT[v.direction_right],
        shown(v.speed_mps, "m/s", 1),
        shown(v.speed_error_mps, "m/s", sign=True),
    )


def pass_figure(labels: Sequence[Label], passes: Sequence[Pass], span_ns: tuple[int, int]) -> str:
    """Return true and found passes on a time axis, a row for each station."""
    truth, found = scored_passes(labels, passes)
    pairs = match_passes(truth, found)
    stations = list(dict.fromkeys([x.channel for x in truth] + [p.station for p in found]))
    rows = {name: len(stations) - i for i, name in enumerate(sorted(stations))}
    last_s = (span_ns[1] - span_ns[0]) / NS_PER_S
    plot = Plot(
        Axis("Time since the first sample [s]", 0, last_s),
        Axis("", 0.4, len(stations) + 0.6),
        _WIDTH,
        _FRAME_PX + _ROW_PX * len(stations),
    )
    known = {id(item) for pair in pairs for item in pair}
    for x in truth:
        style = "truth" if id(x) in known else "missed"
        words = f"{x.target}, {x.label}, {shown(x.value, 'm/s', 1)}"
        at_s = (x.time_ns - span_ns[0]) / NS_PER_S
        plot.dot(at_s, rows[x.channel] - 0.14, f"dot {style}", f"{at_s:.2f} s: true, {words}", 5)
    for p in found:
        style = "result" if id(p) in known else "false"
        words = f"vehicle {p.vehicle or 'untold'}, {p.direction or 'no direction'}"
        at_s = (p.time_ns - span_ns[0]) / NS_PER_S
        words = f"{at_s:.2f} s: found, {words}, {p.speed_mps:.1f} m/s"
        plot.dot(at_s, rows[p.station] + 0.14, f"dot {style}", words, 5)
    return plot.named_rows({row: name for name, row in rows.items()}).svg("Every pass")
