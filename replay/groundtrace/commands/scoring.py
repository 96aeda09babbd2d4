"""``groundtrace score``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from ..errors import RecordingError
from ..results import read_results
from ..score import PickScore, Score, StepScore, score_events
from .output import print_json, print_table
from .truth import truth_of

if TYPE_CHECKING:
    from ..score.picks import PickErrors


def score(
    results: Path,
    *,
    truth: Path | None = None,
    tolerance: Annotated[float, Parameter(validator=validators.Number(gt=0, lt=math.inf))] = 0.12,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Score a result against the truth in its recording, with the level of chance beside it.

    Parameters
    ----------
    results
        Results MCAP that groundtrace replay wrote.
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP.
    tolerance
        Largest distance between a step and its detection [s].
    json
        Print one JSON document.
    """
    result = read_results(results)
    origin = result.provenance
    figures = score_events(
        truth_of(result, results, truth), result.events, origin.start_ns, origin.end_ns, tolerance
    )
    if figures.steps is None and figures.picks is None:
        raise RecordingError(
            f"{result.name}: expected truth to score against (in the recording, or --truth FILE), "
            f"found none"
        )
    if json:
        print_json({k: v for k, v in _parts(figures).items() if v is not None})
        return
    if figures.steps is not None:
        _print_steps(figures.steps)
    if figures.picks is not None:
        _print_picks(figures.picks)


def _parts(figures: Score) -> dict[str, StepScore | PickScore | None]:
    return {"steps": figures.steps, "picks": figures.picks}


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


def _print_picks(p: PickScore) -> None:
    print(f"picks: {p.all.answered} of {p.all.truth} answered ({p.all.answered_fraction:.1%})")
    header = ("impact", "answered", "median |error|", "median", "earliest", "latest [ms]")
    rows = (
        [_pick_row(e) for e in [*p.impacts, p.all]] if len(p.impacts) <= 40 else [_pick_row(p.all)]
    )
    print_table(header, rows)


def _pick_row(e: PickErrors) -> tuple[str, ...]:
    def ms(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    return (
        e.label or "all",
        f"{e.answered}/{e.truth}",
        ms(e.median_abs_ms),
        ms(e.median_ms),
        ms(e.earliest_ms),
        ms(e.latest_ms),
    )
