"""``groundtrace score``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..api.files import writable
from ..api.known_truth import scored_truth_of
from ..api.scores import numbers_of, score_document, scored
from ..evaluation.picks import RIGHT_S
from ..pipeline.results import provenance_of, read_results, write_text
from .console import (
    print_json,
    print_line,
    print_stderr,
    print_table,
    print_warnings,
)
from .options import FLAG, Json, Results, Texts, Tolerance

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ..evaluation.headings import DisturbanceScore, HeadingScore
    from ..evaluation.picks import PickErrors, PickScore
    from ..evaluation.positions import ClosureScore, PositionErrors, PositionScore, WaypointScore
    from ..evaluation.report import Score
    from ..evaluation.steps import StepScore
    from ..evaluation.tracks import ConsistencyScore, TrackScore
    from ..evaluation.vehicles import PassScore, VehicleTrackScore


def score(
    results: Results,
    *,
    truth: Path | None = None,
    author: str | None = None,
    tolerance: Tolerance = 0.12,
    stage: Texts = None,
    html: Path | None = None,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """Score results against truth, with chance levels.

    Parameters
    ----------
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP, annotations too.
        Without truth of its own, the annotations beside the recording are used.
    author
        Where annotations are the truth: whose; without it everybody's.
    stage
        Score what this stage gives, in the place of others' of its kind; may be given several
        times. Without it the last stage of a kind counts, and of a track the smoothed one
        (TRACK.smoothed) where there is one.
    html
        Write the score with figures as a page that opens in any browser, offline.
    force
        Overwrite an existing file that is no page of this recording.
    """
    if html is not None:
        sources = [results, *([truth] if truth is not None else [])]
        writable(html, force=force, sources=sources, of=lambda: provenance_of(results))
    result = read_results(results, blocks=html is not None)
    scored_truth = scored_truth_of(
        result, result.provenance.beside(results), truth, author, print_stderr
    )
    stages = tuple(stage or ())
    figures = scored(result, scored_truth, tolerance, stages)
    if html is not None:
        from ..evaluation.score_page import score_page

        page = score_page(result, scored_truth, figures, tolerance, stages)
        write_text(html, page)
    if json:
        print_json(score_document(figures, scored_truth, result.warnings))
    else:
        print_warnings(result.warnings)
        _print_score(figures, "m" if result.geometry is None else result.geometry.length_unit)
    if html is not None:
        print_stderr(f"page: {html}")


def _print_score(figures: Score, unit: str) -> None:
    for name, part in figures.parts.items():
        if name in PRINTERS:
            PRINTERS[name](part, unit)
        else:
            print_line(f"{name}:")
            for _, figure, value in numbers_of({name: part}):
                print_line(f"  {figure} {value:g}")


def print_found(s: StepScore) -> None:
    """Print how many steps were found, and their F1 beside that of chance."""
    print_line(f"steps: {s.matched} of {s.truth} found, {s.detected - s.matched} false")
    chance = f"chance: random {s.chance_f1:.2f}, metronome {s.chance_f1_metronome:.2f}"
    print_line(f"  F1 {s.f1:.3f} at {s.tolerance_s * 1e3:.0f} ms ({chance})")


def _print_steps(s: StepScore, _unit: str) -> None:
    print_found(s)
    print_line(f"  precision {s.precision:.3f}, recall {s.recall:.3f}")
    if s.latency_ms is not None:
        print_line(
            f"  latency median {s.latency_ms.median:+.0f} ms, IQR {s.latency_ms.iqr:.0f} ms; "
            f"F1 without it {s.f1_debiased:.3f}"
        )
    print_line(
        f"  count {s.count_truth + s.count_error_signed} of {s.count_truth} "
        f"({s.count_error_signed:+d}; absolute, span by span: {s.count_error})"
    )
    curve = "  ".join(f"{t * 1e3:.0f} ms {f1:.2f}" for t, f1 in s.curve)
    print_line(f"  F1 by tolerance: {curve}")
    for name, c in (("left and right", s.feet), ("kind of step", s.kinds)):
        if c is not None:
            print_line(f"  {name}: {c.agreed} of {c.compared} agree ({c.accuracy:.1%})")
    if s.kinds is not None:
        rows = [
            (word, *map(str, row)) for word, row in zip(s.kinds.words, s.kinds.counts, strict=True)
        ]
        print_table(("truth \\ found", *s.kinds.words), rows)


def _print_picks(p: PickScore, _unit: str) -> None:
    a = p.all
    stage = f" of {p.stage}" if p.stage else ""
    print_line(
        f"picks{stage}: {a.answered} of {a.truth} answered ({a.answered_fraction:.1%}): "
        f"{a.right} right to {RIGHT_S * 1e3:g} ms, {a.late} late, {a.early} early; "
        f"{a.missed} missed"
    )
    header = ("impact", "answered", "median |error|", "median", "earliest", "latest [ms]")
    rows = (
        [_pick_row(e) for e in [*p.impacts, p.all]] if len(p.impacts) <= 40 else [_pick_row(p.all)]
    )
    print_table(header, rows)


def _pick_row(e: PickErrors) -> tuple[str, ...]:
    values = (e.median_abs_ms, e.median_ms, e.earliest_ms, e.latest_ms)
    return (e.label or "all", f"{e.answered}/{e.truth}", *map(_number, values))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _print_positions(p: PositionScore, unit: str) -> None:
    print_line(f"positions: {p.n} fixes of {p.stage} at {p.truth} true places")
    rows = [_position_row("all", p), *(_position_row(f"{e.group} picks", e) for e in p.by_picks)]
    if len(p.by_stage) > 1:
        rows += [_position_row(e.group, e) for e in p.by_stage]
    print_table(("fixes", "n", "RMSE", "CEP50", "CEP95", "bias x", f"bias y [{unit}]"), rows)


def _position_row(name: str, e: PositionScore | PositionErrors) -> tuple[str, ...]:
    values = (e.rmse_m, e.cep50_m, e.cep95_m, e.bias_x_m, e.bias_y_m)
    return (name, str(e.n), *map(_number, values))


def _print_track(t: TrackScore, unit: str) -> None:
    print_line(f"track: {t.tracks} of {t.stage} at {t.times} times")
    cutoff = f"(cut-off {t.cutoff_m:g} {unit})"
    print_line(f"  OSPA {t.ospa_m:.2f} {unit}, GOSPA {t.gospa_m:.2f} {unit} {cutoff}")
    print_line(f"  {t.missed} missed, {t.false} false, accuracy {_number(t.accuracy_m)} {unit}")
    print_line(
        f"  completeness {t.completeness:.3f}, ambiguity {t.ambiguity:.2f}, "
        f"spuriousness {t.spuriousness:.3f}"
    )
    if t.identity is not None and len(t.identity.targets) > 1:
        targets = len(t.identity.targets)
        print_line(
            f"  {targets} targets: {t.identity.switches} switches, IDF1 {t.identity.idf1:.3f}"
        )
    if t.ways is not None:
        _print_ways(t.ways, unit)
        return  # a vehicle is heard on part of its way: closure would say nothing
    if t.closure is not None:
        _print_closure(t.closure, unit)
    if t.waypoints is not None:
        _print_waypoints(t.waypoints, unit)


def _print_closure(c: ClosureScore, unit: str) -> None:
    print_line(
        f"  walked {c.walked_m:.1f} {unit}, end {c.apart_m:.2f} {unit} from the start, "
        f"truth {c.true_apart_m:.2f} {unit}: {c.percent:.2f} % of the way"
    )
    if c.aligned_rmse_m is not None:
        print_line(
            f"  turned and shifted onto the truth: RMSE {c.aligned_rmse_m:.2f} {unit}, "
            f"end {_number(c.aligned_end_m)} {unit} off"
        )


def _print_ways(w: VehicleTrackScore, unit: str) -> None:
    print_line(
        f"  across the way: median {w.across_median_m:.2f} {unit} off, 90 % within "
        f"{w.across_p90_m:.2f} {unit}, {w.n} points"
    )
    print_line(
        f"  along it: median {w.along_median_m:+.2f} {unit}; speed: median "
        f"{w.speed_median_mps:.2f} {unit}/s off"
    )


def _print_passes(p: PassScore, _unit: str) -> None:
    print_line(
        f"passes: {p.matched} of {p.truth} found within {p.tolerance_s:g} s, "
        f"{p.found - p.matched} false"
    )
    if p.median_abs_s is not None:
        order = "right" if p.order_right else "wrong"
        print_line(
            f"  median {p.median_abs_s:.2f} s off, bias {_number(p.bias_s)} s, order {order}; "
            f"speed {_number(p.speed_median_percent)} % off in the median"
        )
    right = {None: "-", True: "right", False: "wrong"}
    rows = [
        (
            v.target or "-",
            f"{v.found}/{v.truth}",
            f"{v.together}",
            right[v.direction_right],
            _number(v.speed_mps),
            _number(v.speed_error_mps),
        )
        for v in p.vehicles
    ]
    header = ("vehicle", "stations", "told as one", "direction", "speed", "error [m/s]")
    print_table(header, rows)


def _print_waypoints(w: WaypointScore, unit: str) -> None:
    compared = "longer" if w.way_error_percent >= 0 else "shorter"
    print_line(
        f"  waypoints: median {w.median_m:.2f} {unit} off, mean {w.mean_m:.2f} {unit}, "
        f"95 % within {w.p95_m:.2f} {unit}, {w.n} of them"
    )
    print_line(
        f"  last one {w.end_m:.2f} {unit} off, {w.end_percent:.1f} % of the {w.way_m:.1f} {unit} "
        f"between them; track {abs(w.way_error_percent):.1f} % {compared} than that"
    )


def _print_heading(h: HeadingScore, _unit: str) -> None:
    print_line(
        f"heading: RMSE {_number(h.rmse_deg)} deg, bias {_number(h.bias_deg)} deg, "
        f"at {h.n} of {h.truth} times"
    )


def _print_disturbance(d: DisturbanceScore, _unit: str) -> None:
    if d.f1 is None:
        alarm = f"{d.false_alarm_s:.2f} s of {d.scored_s:.2f} s false alarm"
        print_line(f"disturbance: truth has none; {alarm}")
        return
    print_line(
        f"disturbance: F1 {d.f1:.3f}, precision {_share(d.precision)}, recall {_share(d.recall)} "
        f"({d.found_s:.2f} s found, {d.truth_s:.2f} s true, {d.false_alarm_s:.2f} s false alarm)"
    )


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _print_consistency(c: ConsistencyScore, _unit: str) -> None:
    print_line("consistency:")
    named = (("NEES of fixes", c.nees_fixes), ("NEES of tracks", c.nees_tracks), ("NIS", c.nis))
    for name, x in named:
        if x is not None:
            verdict = "inside" if x.consistent else "outside"
            print_line(f"  {name} {x.mean:.2f}, {verdict} [{x.lower:.2f}, {x.upper:.2f}], n {x.n}")


#: What prints each part of a score, given the unit of lengths; of others every number is printed.
PRINTERS: Mapping[str, Callable[[Any, str], None]] = {
    "steps": _print_steps,
    "positions": _print_positions,
    "picks": _print_picks,
    "track": _print_track,
    "heading": _print_heading,
    "disturbance": _print_disturbance,
    "consistency": _print_consistency,
    "passes": _print_passes,
}
