"""``groundtrace compare``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from ..explain import evidence_of
from ..explain.comparison import Comparison, Decision
from ..explain.comparison import compare as compared
from ..explain.unfiltered import beside
from ..plugins import load
from ..results import read_results
from .output import print_json, print_table, say
from .pages import comparison_page
from .showing import where_to_show
from .truth import truth_of

if TYPE_CHECKING:
    from ..explain.comparison import Side
    from ..explain.differences import PlaceComparison


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
    fallback = Path(f"{a.stem}-{b.stem}.compare.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[a, b])
    one, other = read_results(a), read_results(b)
    labels = truth_of(one, a, truth) or truth_of(other, b, truth)
    places = [beside(path, one.provenance.recording) for path in (a, b)]
    found = compared(one, other, labels, tolerance, places)
    if json:
        print_json(found)
    else:
        _print(found)
    if rrd is not None or spawn:
        sides = evidence_of(one, labels), evidence_of(other, labels)
        load("views", "compare")(*sides, found, comparison_page(found), path=rrd, spawn=spawn)
    if rrd is not None:
        say(f"timeline: {rrd} (open it with: rerun {rrd})")


def _print(found: Comparison) -> None:
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
    rows = [_row(d) for d in found.decisions if d.obstacle is not None]
    if rows:
        print()
        print_table(("time [s]", "step", "verdict", "without it", "why"), rows)


def _side(side: Side) -> str:
    if side.counts is None:
        return f"{side.name}, {side.steps} steps"
    c = side.counts
    return f"{side.name}, {c.tp} right, {c.fn} missed, {c.fp} false"


def _row(decision: Decision) -> tuple[str, ...]:
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
