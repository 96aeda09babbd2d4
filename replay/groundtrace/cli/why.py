"""``groundtrace why``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from ..api.analysis import evidence_with
from ..explain.questions import Kind, Question, explained
from ..explain.unfiltered import beside
from ..explain.why import StepExplanation
from ..pipeline.plugins import load
from ..pipeline.results import read_results
from .console import print_json, print_stderr, print_warnings, truth_of, where_to_show
from .explanations import answer_page, print_answer
from .options import AT_LEAST_ONE, FLAG, ForceOutput, Json, Results, Truth

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    force: ForceOutput = False,
    json: Json = False,
) -> None:
    """Explain every missed and false step, bad pick or bad place, and the change that mends it.

    Parameters
    ----------
    kind
        What to explain: steps (the default), picks, fixes, the places of steps, or vehicles, the
        passes or courses of a pipeline for them (the default there).
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
        Write a viewer's file of every gate's values and thresholds, around the moment.
    spawn
        Open the viewer with the same, its cursor at the moment.
    """
    asked = Question(kind, step, fix, pick, at, tolerance, tolerance_m, tolerance_ms / 1e3, stage)
    asked.checked_kind()
    fallback = Path(f"{results.stem}.why.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[results])
    evidence = _evidence(results, truth, recording or [])
    if not json:
        print_warnings(evidence.warnings)
    found = explained(evidence, results.name, asked)
    if isinstance(found.details, StepExplanation):
        for at_s in evidence.clock_steps_s:
            print_stderr(
                f"warning: a clock steps at {at_s:.3f} s: changes around it may not be exact"
            )
    if json:
        print_json(found.details, evidence.warnings)
    else:
        print_answer(found)
    if rrd is not None or spawn:
        show = load("views", "why")
        page = answer_page(found)
        show(evidence, page, path=rrd, spawn=spawn, at_ns=found.time_ns, tolerance_s=tolerance)
    if rrd is not None:
        print_stderr(f"timeline: {rrd} (open it with: rerun {rrd})")


def _evidence(results: Path, truth: Path | None, recordings: Sequence[Path]) -> Evidence:
    """Read what decisions are explained by; it lives on without what it was read from."""
    result = read_results(results, evidence=True)
    places = (beside(results, result.provenance.recording), *recordings)
    return evidence_with(result, truth_of(result, results, truth), places)
