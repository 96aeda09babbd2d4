"""``groundtrace sweep``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

from ..api.files import mark_of, writable
from ..pipeline.results import write_text
from .console import print_json, print_line, print_stderr, print_table, progress
from .options import AT_LEAST_ONE, FLAG, PIPELINE, POSITIVE, SETTING, ForceOutputs, Json, Truth

if TYPE_CHECKING:
    from ..api.comparing import SweepPlan
    from ..explain.sweep import Counted, LeaveOneOut, Ranked, Ranking


def sweep(
    *inputs: Path,
    grid: Annotated[list[str] | None, FLAG, SETTING] = None,
    random: Annotated[int | None, AT_LEAST_ONE] = None,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    truth: Truth = None,
    tolerance: Annotated[float | None, POSITIVE] = None,
    pipeline: Annotated[str | None, PIPELINE] = None,
    recording: Annotated[list[Path] | None, FLAG] = None,
    top: Annotated[int, AT_LEAST_ONE] = 10,
    write: Path | None = None,
    figure: Path | None = None,
    jobs: Annotated[int | None, AT_LEAST_ONE] = None,
    force: ForceOutputs = False,
    json: Json = False,
) -> None:
    """Try many settings and report the best, with confidence intervals.

    Parameters
    ----------
    inputs
        Results that groundtrace replay wrote, or recordings with --pipeline. Of several, each is
        also left out in turn.
    grid
        What to sweep, as stage.param=FROM:TO:COUNT or stage.param=VALUE,VALUE; may be given
        several times, and all combinations are tried.
    random
        Number of random settings to try, instead of all combinations.
    seed
        Of the random settings.
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
    """
    from ..api.comparing import SweepPlan, best_recipe, config_of, origin_of, subjects_of
    from ..explain.redecide import make_grid, parse_axis

    config = config_of(inputs, pipeline)
    asked = make_grid([parse_axis(text, config) for text in grid or []], random, seed)
    sources = [*inputs, *(recording or [])]
    first = origin_of(inputs[0])
    if write is not None:
        writable(write, force=force, sources=sources)
    if figure is not None:
        writable(figure, force=force, sources=sources, of=lambda: first)
    processes = jobs or os.cpu_count() or 1
    subjects = subjects_of(
        inputs, config, truth, recording or [], processes, print_stderr, progress
    )
    plan = SweepPlan.of(subjects, config, asked, tolerance)
    counted, ranking = _swept(plan, top, processes)
    if write is not None:
        write_text(write, best_recipe(config, plan.settings, ranking))
    if figure is not None:
        from ..explain.sweep_plots import sweep_figure

        drawn = sweep_figure(counted, ranking)
        write_text(figure, f"{drawn}\n<!-- {mark_of(first.sha256)} -->\n")
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
    print_line(f"{', '.join(r.recordings)}: {r.truth} true {r.counted}, {r.rate.settings} settings")
    _print_top(r)
    best = r.best
    if best.same > 1:
        print_line(f"\nbest: the middle of the {best.same} settings that reach F1 {best.f1:.3f}")
    if r.now.f1 >= best.f1:
        print_line("no setting is better than the pipeline as it is")
    sets = " ".join(f"--set {name}={_exact(value)}" for name, value in best.settings.items())
    print_line(f"{'' if best.same > 1 else chr(10)}replay with {sets}")
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
    print_line(f"\nmissed against false {r.counted}: what no setting beats")
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


def _print_left_out(left_out: LeaveOneOut) -> None:
    print_line("\nleft out: each recording under what is best on the others")
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
        for x in left_out.recordings
    ]
    names = list(left_out.recordings[0].settings)
    mean = ("mean", *("" for _ in names), "", "", "", f"{left_out.mean_f1:.3f}")
    rows.append((*mean, f"{left_out.mean_in_sample_f1:.3f}"))
    print_table(("recording", *names, "TP", "FP", "FN", "F1", "F1 of its own best"), rows)


def _print_rate(r: Ranking) -> None:
    through = "gates of a detector" if r.rate.through == "gates" else "gates and an associator"
    print_line(
        f"\n{r.rate.settings} settings in {r.rate.decided_s:.2f} s through {through}: "
        f"{r.rate.recorded_s_per_s:.0f} recorded seconds per second"
    )
    if r.rate.measurements:
        print_line(
            f"{r.rate.measurements} measurements of the signal took {r.rate.measured_s:.1f} s"
        )


def _exact(value: Any) -> str:
    """Return a value so that ``--set`` reads the same."""
    return f"{value:.12g}" if isinstance(value, float) else str(value)
