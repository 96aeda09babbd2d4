"""``groundtrace score``, ``groundtrace sweep`` and ``groundtrace compare``."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..api.files import existing, writable
from ..api.scores import score_document, scored
from ..errors import RecordingError
from ..evaluation.picks import RIGHT_S
from ..evaluation.truth import own_truth
from ..pipeline.config import build_pipeline, checked_pipeline, parse_pipeline
from ..pipeline.plugins import load
from ..pipeline.results import RUN, evidence_of, provenance_in, read_results, write_text
from .console import (
    print_json,
    print_stderr,
    print_table,
    print_warnings,
    progress,
    scored_truth_of,
    truth_of,
    truth_of_recording,
    where_to_show,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..api.comparing import SweepPlan
    from ..evaluation.headings import DisturbanceScore, HeadingScore
    from ..evaluation.picks import PickErrors, PickScore
    from ..evaluation.positions import ClosureScore, PositionErrors, PositionScore, WaypointScore
    from ..evaluation.report import Score
    from ..evaluation.steps import StepScore
    from ..evaluation.tracks import ConsistencyScore, TrackScore
    from ..evaluation.vehicles import PassScore, VehicleTrackScore
    from ..explain.compare import ComparedResult, Comparison, Decision, PlaceComparison
    from ..explain.sweep import Counted, LeaveOneOut, Ranked, Ranking, Subject
    from ..pipeline.config import PipelineConfig
    from ..pipeline.results import Provenance


def score(
    results: Path,
    *,
    truth: Path | None = None,
    author: str | None = None,
    tolerance: Annotated[float, Parameter(validator=validators.Number(gt=0, lt=math.inf))] = 0.12,
    stage: Annotated[list[str] | None, Parameter(negative="")] = None,
    html: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Score a result against the truth in its recording, with the level of chance beside it.

    Parameters
    ----------
    results
        Results MCAP that groundtrace replay wrote.
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP, annotations too.
        Without truth of its own, the annotations beside the recording are used.
    author
        Where annotations are the truth: whose; without it everybody's.
    tolerance
        Largest distance between a step and its detection [s].
    stage
        Score what this stage gives, in the place of others' of its kind; may be given several
        times. Without it the last stage of a kind counts, and of a track the smoothed one
        (TRACK.smoothed) where there is one.
    html
        Write the score with figures as a page that opens in any browser, offline.
    force
        Overwrite an existing page.
    json
        Print one JSON document.
    """
    if html is not None:
        writable(html, force=force, sources=[results, *([truth] if truth is not None else [])])
    result = read_results(results, blocks=html is not None)
    known = scored_truth_of(result, results, truth, author)
    stages = tuple(stage or ())
    figures = scored(result, known, tolerance, stages)
    if html is not None:
        from ..evaluation.score_page import score_page

        page = score_page(result, known, figures, tolerance, stages)
        write_text(html, page)
    if json:
        print_json(score_document(figures, known, result.warnings))
    else:
        print_warnings(result.warnings)
        _print_score(figures, "m" if result.geometry is None else result.geometry.length_unit)
    if html is not None:
        print_stderr(f"page: {html}")


def _print_score(figures: Score, unit: str) -> None:
    if figures.steps is not None:
        _print_steps(figures.steps)
    if figures.positions is not None:
        _print_positions(figures.positions, unit)
    if figures.picks is not None:
        _print_picks(figures.picks)
    if figures.track is not None:
        _print_track(figures.track, unit)
    if figures.heading is not None:
        _print_heading(figures.heading)
    if figures.disturbance is not None:
        _print_disturbance(figures.disturbance)
    if figures.consistency is not None:
        _print_consistency(figures.consistency)
    if figures.passes is not None:
        _print_passes(figures.passes)


def _print_steps(s: StepScore) -> None:
    print(f"steps: {s.matched} of {s.truth} found, {s.detected - s.matched} false")
    chance = f"chance: random {s.chance_f1:.2f}, metronome {s.chance_f1_metronome:.2f}"
    print(f"  F1 {s.f1:.3f} at {s.tolerance_s * 1e3:.0f} ms ({chance})")
    print(f"  precision {s.precision:.3f}, recall {s.recall:.3f}")
    if s.latency_ms is not None:
        print(
            f"  latency median {s.latency_ms.median:+.0f} ms, IQR {s.latency_ms.iqr:.0f} ms; "
            f"F1 without it {s.f1_debiased:.3f}"
        )
    print(
        f"  count {s.count_truth + s.count_error_signed} of {s.count_truth} "
        f"({s.count_error_signed:+d}; absolute, span by span: {s.count_error})"
    )
    curve = "  ".join(f"{t * 1e3:.0f} ms {f1:.2f}" for t, f1 in s.curve)
    print(f"  F1 by tolerance: {curve}")
    for name, c in (("left and right", s.feet), ("kind of step", s.kinds)):
        if c is not None:
            print(f"  {name}: {c.agreed} of {c.compared} agree ({c.accuracy:.1%})")
    if s.kinds is not None:
        rows = [
            (word, *map(str, row)) for word, row in zip(s.kinds.words, s.kinds.counts, strict=True)
        ]
        print_table(("truth \\ found", *s.kinds.words), rows)


def _print_picks(p: PickScore) -> None:
    a = p.all
    stage = f" of {p.stage}" if p.stage else ""
    print(
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
    print(f"positions: {p.n} fixes of {p.stage} at {p.truth} true places")
    rows = [_position_row("all", p), *(_position_row(f"{e.group} picks", e) for e in p.by_picks)]
    if len(p.by_stage) > 1:
        rows += [_position_row(e.group, e) for e in p.by_stage]
    print_table(("fixes", "n", "RMSE", "CEP50", "CEP95", "bias x", f"bias y [{unit}]"), rows)


def _position_row(name: str, e: PositionScore | PositionErrors) -> tuple[str, ...]:
    values = (e.rmse_m, e.cep50_m, e.cep95_m, e.bias_x_m, e.bias_y_m)
    return (name, str(e.n), *map(_number, values))


def _print_track(t: TrackScore, unit: str) -> None:
    print(f"track: {t.tracks} of {t.stage} at {t.times} times")
    cutoff = f"(cut-off {t.cutoff_m:g} {unit})"
    print(f"  OSPA {t.ospa_m:.2f} {unit}, GOSPA {t.gospa_m:.2f} {unit} {cutoff}")
    print(f"  {t.missed} missed, {t.false} false, accuracy {_number(t.accuracy_m)} {unit}")
    print(
        f"  completeness {t.completeness:.3f}, ambiguity {t.ambiguity:.2f}, "
        f"spuriousness {t.spuriousness:.3f}"
    )
    if t.identity is not None and len(t.identity.targets) > 1:
        targets = len(t.identity.targets)
        print(f"  {targets} targets: {t.identity.switches} switches, IDF1 {t.identity.idf1:.3f}")
    if t.ways is not None:
        _print_ways(t.ways, unit)
        return  # a vehicle is heard on part of its way: closure would say nothing
    if t.closure is not None:
        _print_closure(t.closure, unit)
    if t.waypoints is not None:
        _print_waypoints(t.waypoints, unit)


def _print_closure(c: ClosureScore, unit: str) -> None:
    print(
        f"  walked {c.walked_m:.1f} {unit}, end {c.apart_m:.2f} {unit} from the start, "
        f"truth {c.true_apart_m:.2f} {unit}: {c.percent:.2f} % of the way"
    )
    if c.aligned_rmse_m is not None:
        print(
            f"  turned and shifted onto the truth: RMSE {c.aligned_rmse_m:.2f} {unit}, "
            f"end {_number(c.aligned_end_m)} {unit} off"
        )


def _print_ways(w: VehicleTrackScore, unit: str) -> None:
    print(
        f"  across the way: median {w.across_median_m:.2f} {unit} off, 90 % within "
        f"{w.across_p90_m:.2f} {unit}, {w.n} points"
    )
    print(
        f"  along it: median {w.along_median_m:+.2f} {unit}; speed: median "
        f"{w.speed_median_mps:.2f} {unit}/s off"
    )


def _print_passes(p: PassScore) -> None:
    print(
        f"passes: {p.matched} of {p.truth} found within {p.tolerance_s:g} s, "
        f"{p.found - p.matched} false"
    )
    if p.median_abs_s is not None:
        order = "right" if p.order_right else "wrong"
        print(
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
    print(
        f"  waypoints: median {w.median_m:.2f} {unit} off, mean {w.mean_m:.2f} {unit}, "
        f"95 % within {w.p95_m:.2f} {unit}, {w.n} of them"
    )
    print(
        f"  last one {w.end_m:.2f} {unit} off, {w.end_percent:.1f} % of the {w.way_m:.1f} {unit} "
        f"between them; track {w.way_error_percent:+.1f} % longer than that"
    )


def _print_heading(h: HeadingScore) -> None:
    print(
        f"heading: RMSE {_number(h.rmse_deg)} deg, bias {_number(h.bias_deg)} deg, "
        f"at {h.n} of {h.truth} times"
    )


def _print_disturbance(d: DisturbanceScore) -> None:
    if d.f1 is None:
        alarm = f"{d.false_alarm_s:.2f} s of {d.scored_s:.2f} s false alarm"
        print(f"disturbance: truth has none; {alarm}")
        return
    print(
        f"disturbance: F1 {d.f1:.3f}, precision {_share(d.precision)}, recall {_share(d.recall)} "
        f"({d.found_s:.2f} s found, {d.truth_s:.2f} s true, {d.false_alarm_s:.2f} s false alarm)"
    )


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _print_consistency(c: ConsistencyScore) -> None:
    print("consistency:")
    named = (("NEES of fixes", c.nees_fixes), ("NEES of tracks", c.nees_tracks), ("NIS", c.nis))
    for name, x in named:
        if x is not None:
            verdict = "inside" if x.consistent else "outside"
            print(f"  {name} {x.mean:.2f}, {verdict} [{x.lower:.2f}, {x.upper:.2f}], n {x.n}")


POSITIVE = Parameter(validator=validators.Number(gt=0, lt=math.inf))
AT_LEAST_ONE = Parameter(validator=validators.Number(gte=1))


def sweep(
    *inputs: Path,
    grid: Annotated[list[str] | None, Parameter(negative="")] = None,
    random: Annotated[int | None, AT_LEAST_ONE] = None,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    truth: Path | None = None,
    tolerance: Annotated[float | None, POSITIVE] = None,
    pipeline: str | None = None,
    recording: Annotated[list[Path] | None, Parameter(negative="")] = None,
    top: Annotated[int, AT_LEAST_ONE] = 10,
    write: Path | None = None,
    figure: Path | None = None,
    jobs: Annotated[int | None, AT_LEAST_ONE] = None,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Try many settings and say which are best, and how sure that is.

    Parameters
    ----------
    inputs
        Results that groundtrace replay wrote, or recordings with --pipeline. Of several, each is
        also left out in turn.
    grid
        What to sweep, as stage.param=FROM:TO:COUNT or stage.param=VALUE,VALUE; may be given
        several times, and all combinations are tried.
    random
        Try so many random settings of those ranges instead of all combinations.
    seed
        Of the random settings.
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP.
    tolerance
        Largest distance between a step, or a pass, and its detection [s]; 0.12 for steps without
        it, 1 for passes.
    pipeline
        Name or TOML file to measure recordings with.
    recording
        The recording of a result that is not beside it; needed where the signal path is swept.
    top
        How many of the highest F1 to list.
    write
        Write the pipeline with the best settings here, as TOML.
    figure
        Write the figure here, as SVG.
    jobs
        Processes for measuring; as many as there are processors without it.
    force
        Overwrite existing outputs.
    json
        Print one JSON document.
    """
    from ..api.comparing import SweepPlan
    from ..explain.redecide import make_grid, parse_axis
    from ..explain.sweep import with_values

    config = config_of(inputs, pipeline)
    asked = make_grid([parse_axis(text, config) for text in grid or []], random, seed)
    for path in (write, figure):
        if path is not None:
            writable(path, force=force, sources=[*inputs, *(recording or [])])
    subjects = subjects_of(inputs, config, truth, recording or [], all_jobs(jobs))
    plan = SweepPlan.of(subjects, config, asked, tolerance)
    counted, ranking = _swept(plan, top, all_jobs(jobs))
    if write is not None:
        best = with_values(config, plan.settings.axes, list(ranking.best.settings.values()))
        best = replace(best, placements={})  # those are of one recording
        write_text(write, build_pipeline(best).recipe())
    if figure is not None:
        from ..explain.sweep_plots import sweep_figure

        write_text(figure, sweep_figure(counted, ranking))
    if json:
        print_json(ranking)
    else:
        _print_sweep(ranking)
    for name, path in (("pipeline", write), ("figure", figure)):
        if path is not None:
            print_stderr(f"{name}: {path}")


def _swept(plan: SweepPlan, top: int, jobs: int) -> tuple[Counted, Ranking]:
    """Sweep, showing how far the measurements are."""
    again = plan.measured()
    total_s = sum(subject.recorded_s for subject in again)
    if again:
        print_stderr(
            f"the signal path is swept: {len(again)} measurements ({total_s:.0f} s recorded)"
        )
    with progress(total_s, "measuring") as show:
        counter = iter(range(1, len(again) + 1))
        return plan.run(top, jobs, lambda: show(next(counter) * total_s / len(again)))


def _print_sweep(r: Ranking) -> None:
    print(f"{', '.join(r.recordings)}: {r.truth} true {r.counted}, {r.rate.settings} settings")
    _print_top(r)
    best = r.best
    if best.same > 1:
        print(f"\nbest: the middle of the {best.same} settings that reach F1 {best.f1:.3f}")
    if r.now.f1 >= best.f1:
        print("no setting is better than the pipeline as it is")
    sets = " ".join(f"--set {name}={_exact(value)}" for name, value in best.settings.items())
    print(f"{'' if best.same > 1 else chr(10)}replay with {sets}")
    _print_front(r)
    if r.left_out is not None:
        _print_left_out(r.left_out)
    _print_rate(r)
    for note in r.notes:
        print_stderr(f"warning: {note}")


def _print_top(r: Ranking) -> None:
    names = [p.name for p in r.parameters]
    header = ("", *names, "TP", "FP", "FN", "F1", "90 %", "settings", "against the best")
    rows = [_sweep_row(f"{i}", x) for i, x in enumerate(r.top, 1)]
    print_table(header, [*rows, _sweep_row("now", r.now)])


def _sweep_row(name: str, x: Ranked) -> tuple[str, ...]:
    behind = f"behind by {x.behind.low:.3f} to {x.behind.high:.3f}"
    verdict = "best" if name == "1" else behind if x.worse else "not distinguishable"
    return (
        name,
        *(_exact(value) for value in x.settings.values()),
        str(x.tp),
        str(x.fp),
        str(x.fn),
        f"{x.f1:.3f}",
        f"{x.interval.low:.3f} to {x.interval.high:.3f}",
        str(x.same),
        verdict,
    )


def _print_front(r: Ranking) -> None:
    print(f"\nmissed against false {r.counted}: what no setting beats")
    names = [p.name for p in r.parameters]
    rows = [
        (
            str(p.missed),
            str(p.false),
            f"{p.f1:.3f}",
            str(p.same),
            *(_exact(value) for value in p.settings.values()),
        )
        for p in r.front
    ]
    print_table(("missed", "false", "F1", "settings", *names), rows)


def _print_left_out(found: LeaveOneOut) -> None:
    print("\nleft out: each recording under what is best on the others")
    rows = [
        (
            x.recording,
            *(_exact(value) for value in x.settings.values()),
            str(x.tp),
            str(x.fp),
            str(x.fn),
            f"{x.f1:.3f}",
            f"{x.in_sample_f1:.3f}",
        )
        for x in found.recordings
    ]
    names = list(found.recordings[0].settings)
    mean = ("mean", *("" for _ in names), "", "", "", f"{found.mean_f1:.3f}")
    rows.append((*mean, f"{found.mean_in_sample_f1:.3f}"))
    print_table(("recording", *names, "TP", "FP", "FN", "F1", "F1 of its own best"), rows)


def _print_rate(r: Ranking) -> None:
    through = "gates of a detector" if r.rate.through == "gates" else "gates and an associator"
    print(
        f"\n{r.rate.settings} settings in {r.rate.decided_s:.2f} s through {through}: "
        f"{r.rate.recorded_s_per_s:.0f} recorded seconds per second"
    )
    if r.rate.measurements:
        print(f"{r.rate.measurements} measurements of the signal took {r.rate.measured_s:.1f} s")


def _exact(value: Any) -> str:
    """Return a value so that ``--set`` reads the same."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def all_jobs(jobs: int | None) -> int:
    """Return how many processes to use: those asked for, else one for each processor."""
    return jobs if jobs is not None else os.cpu_count() or 1


def config_of(inputs: Sequence[Path], pipeline: str | None) -> PipelineConfig:
    """Return the pipeline that is swept: the one named, or that of the first results.

    Raises
    ------
    RecordingError
        Where there is no input, or a recording and no pipeline to measure it with.
    PipelineError, PluginError
        Where the one named is none.
    """
    from ..explain.sweep import resolved

    if not inputs:
        raise RecordingError("sweep: expected results or recordings, found none")
    if pipeline:
        return resolved(checked_pipeline(pipeline))
    origins = {path: _origin(existing(path)) for path in inputs}
    for path, origin in origins.items():
        if origin is None:
            raise RecordingError(
                f"{path.name}: expected --pipeline NAME to measure the recording with, found none"
            )
    first, text = next((p, o.pipeline) for p, o in origins.items() if o is not None)
    return parse_pipeline(text.encode(), f"{first.name}: pipeline")


def subjects_of(
    inputs: Sequence[Path],
    config: PipelineConfig,
    truth: Path | None,
    recordings: Sequence[Path],
    jobs: int,
) -> list[Subject]:
    """Read results, and measure recordings that were not replayed.

    Parameters
    ----------
    inputs
        Results or recordings.
    config
        The pipeline that recordings are measured with, and results were.
    truth
        Truth instead of that of the one input.
    recordings
        Where else to look for the recordings of results than beside them.
    jobs
        Processes for measuring.

    Raises
    ------
    RecordingError
        Where there is no truth, or not the same pipeline for all.
    """
    from ..api.comparing import check_subjects

    if truth is not None and len(inputs) > 1:
        raise RecordingError(f"--truth: expected one recording, found {len(inputs)}")
    replayed = {path: _origin(existing(path)) is not None for path in inputs}
    fresh = [path for path in inputs if not replayed[path]]
    measured = _measured(fresh, config, truth, jobs) if fresh else {}
    read = {p: _read(p, truth, recordings) for p in inputs if replayed[p]}
    subjects = [measured[path] if path in measured else read[path] for path in inputs]
    check_subjects(subjects, config)
    return subjects


def _origin(path: Path) -> Provenance | None:
    """Return where results come from; None for a recording."""
    with Recording.open(path) as opened:
        return provenance_in(opened, path.name) if RUN in opened.metadata else None


def _measured(
    paths: Sequence[Path], config: PipelineConfig, truth: Path | None, jobs: int
) -> dict[Path, Subject]:
    from ..explain.sweep import Subject, in_processes, measure_evidence

    total_s = 0.0
    labels, placements = {}, {}
    for path in paths:
        with Recording.open(path) as recording:
            labels[path] = truth_of_recording(recording, path, truth)
            placements[path] = {s.topic: s.placement for s in recording.streams}
            total_s += (recording.end_ns - recording.start_ns) / NS_PER_S
    if paths:
        print_stderr(f"measuring {len(paths)} recordings ({total_s:.0f} s)")
    with progress(total_s, "measuring") as show:
        count = iter(range(1, len(paths) + 1))
        found = in_processes(
            partial(measure_evidence, config=config),
            list(paths),
            jobs,
            lambda: show(next(count) * total_s / len(paths)),
        )
    subjects = {}
    for path, evidence in zip(paths, found, strict=True):
        specs = [stage.spec for stage in evidence.stages]
        own = own_truth(labels[path], specs, placements[path])
        for remark in own.remarks:
            print_stderr(f"truth: {remark}")
        subjects[path] = Subject(replace(evidence, labels=own.labels), (path,))
    return subjects


def _read(path: Path, truth: Path | None, recordings: Sequence[Path]) -> Subject:
    from ..explain.sweep import Subject

    result = read_results(path, evidence=True)
    origin = result.provenance
    evidence = evidence_of(result, truth_of(result, path, truth))
    part = any(argument.startswith(("--from", "--to")) for argument in origin.arguments)
    # what was replayed in part is not to be measured as a whole
    places = () if part else (path.parent / Path(origin.recording).name, *recordings)
    return Subject(evidence, places, origin.sha256)


def compare(
    a: Path,
    b: Path,
    *,
    truth: Path | None = None,
    tolerance: Annotated[float, Parameter(validator=validators.Number(gt=0, lt=math.inf))] = 0.12,
    rrd: Path | None = None,
    spawn: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compare two results of one recording, decision by decision.

    Parameters
    ----------
    a
        Results MCAP that groundtrace replay wrote.
    b
        Another one, of the same recording.
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP.
    tolerance
        Largest distance between a step and its detection [s].
    rrd
        Write a viewer's file with the decisions of both.
    spawn
        Open the viewer with the same, its cursor at the first difference.
    force
        Overwrite an existing output.
    json
        Print one JSON document.
    """
    from ..explain.compare import compare as compared
    from ..explain.unfiltered import beside
    from .why import comparison_page

    fallback = Path(f"{a.stem}-{b.stem}.compare.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[a, b])
    one, other = read_results(a), read_results(b)
    labels = truth_of(one, a, truth) or truth_of(other, b, truth)
    places = [beside(path, one.provenance.recording) for path in (a, b)]
    found = compared(one, other, labels, tolerance, places)
    if json:
        print_json(found)
    else:
        _print_comparison(found)
    if rrd is not None or spawn:
        sides = evidence_of(one, labels), evidence_of(other, labels)
        load("views", "compare")(*sides, found, comparison_page(found), path=rrd, spawn=spawn)
    if rrd is not None:
        print_stderr(f"timeline: {rrd} (open it with: rerun {rrd})")


def _print_comparison(found: Comparison) -> None:
    print(f"{found.recording}: A {_side(found.a)}; B {_side(found.b)}")
    for change in found.parameters:
        values = ("absent" if v is None else v for v in (change.a, change.b))
        print(f"  {change.stage}.{change.parameter}: A {{}}, B {{}}".format(*values))
    print(", ".join(f"{n} {verdict}" for verdict, n in found.verdicts.items()) or "no decisions")
    if found.p_value is not None:
        print(
            f"McNemar's exact test: p = {found.p_value:.2g} "
            f"({'more' if found.p_value < 0.05 else 'no more'} than chance explains)"
        )
    if found.places is not None:
        _print_places(found.places)
    rows = [_comparison_row(d) for d in found.decisions if d.obstacle is not None]
    if rows:
        print()
        print_table(("time [s]", "step", "verdict", "without it", "why"), rows)


def _side(side: ComparedResult) -> str:
    if side.counts is None:
        return f"{side.name}, {side.steps} steps"
    c = side.counts
    return f"{side.name}, {c.tp} right, {c.fn} missed, {c.fp} false"


def _comparison_row(decision: Decision) -> tuple[str, ...]:
    lacks = decision.obstacle
    step = "-" if decision.step is None else str(decision.step)
    side, why = ("", "") if lacks is None else (lacks.side, lacks.text)
    for side_pair in decision.pairs:
        pair = side_pair.pair
        if pair.found_s == decision.time_s:
            why = f"{why}; {side_pair.side}'s step {pair.text}"
        elif side_pair.side == side:
            why = f"{why} (the step found at {pair.found_s:.3f} s)"
    return (f"{decision.time_s:.3f}", step, decision.verdict, side, why)


def _print_places(places: PlaceComparison) -> None:
    if places.median_apart_m is None or places.largest_apart_m is None:
        print(f"places: {places.a} by A, {places.b} by B, none at the same moment")
        return
    text = (
        f"places: {len(places.pairs)} moments fixed by both, median "
        f"{places.median_apart_m:.2f} m apart, largest {places.largest_apart_m:.2f} m"
    )
    if places.rmse_a_m is not None and places.rmse_b_m is not None:
        text += f"; RMSE A {places.rmse_a_m:.2f} m, B {places.rmse_b_m:.2f} m"
    print(text)
