"""``groundtrace compare``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..api.files import writable
from ..api.known_truth import truth_beside
from ..errors import RecordingError
from ..pipeline.plugins import load
from ..pipeline.results import evidence_of, previous_results, provenance_of, read_results
from .console import print_json, print_line, print_stderr, print_table, where_to_show
from .options import FLAG, ForceOthers, Json, Tolerance, Truth

if TYPE_CHECKING:
    from ..explain.compare import ComparedResult, Comparison, Decision, PlaceComparison


def compare(
    a: Path,
    b: Path | None = None,
    *,
    truth: Truth = None,
    tolerance: Tolerance = 0.12,
    rrd: Path | None = None,
    spawn: Annotated[bool, FLAG] = False,
    force: ForceOthers = False,
    json: Json = False,
) -> None:
    """Compare two results of one recording, decision by decision.

    Parameters
    ----------
    a
        Results MCAP that groundtrace replay wrote.
    b
        Another one, of the same recording. Without it, ``a`` is compared with the results that it
        replaced, which a replay keeps as NAME.previous.results.mcap.
    rrd
        Write a viewer's file with the decisions of both.
    spawn
        Open the viewer with the same, its cursor at the first difference.
    """
    from ..explain.compare import compare as compared

    if b is None:
        a, b = _replaced_by(a), a
    fallback = Path(f"{a.stem}-{b.stem}.compare.rrd")
    checked = partial(writable, force=force, sources=[a, b], of=lambda: provenance_of(a))
    spawn, rrd = where_to_show(rrd, fallback, checked, spawn=spawn)
    one, other = read_results(a), read_results(b)
    labels = truth_beside(one, a, truth, print_stderr)
    labels = labels or truth_beside(other, b, truth, print_stderr)
    places = [one.provenance.beside(path) for path in (a, b)]
    comparison = compared(one, other, labels, tolerance, places)
    if json:
        print_json(comparison)
    else:
        _print_comparison(comparison)
    if rrd is not None or spawn:
        sides = evidence_of(one, labels), evidence_of(other, labels)
        load("views", "compare")(*sides, comparison, _page(comparison), path=rrd, spawn=spawn)
    if rrd is not None:
        print_stderr(f"timeline: {rrd} (open it with: rerun {rrd})")


def _replaced_by(results: Path) -> Path:
    """Return the results that a replay replaced."""
    previous = previous_results(results)
    if results.is_file() and not previous.is_file():
        raise RecordingError(
            f"{previous}: expected the results that {results.name} replaced, found no such file; "
            "replay again with another --set, or name two results"
        )
    return previous


def _print_comparison(comparison: Comparison) -> None:
    print_line(f"{comparison.recording}: A {_side(comparison.a)}; B {_side(comparison.b)}")
    for change in comparison.parameters:
        values = ("absent" if v is None else v for v in (change.a, change.b))
        print_line(f"  {change.stage}.{change.parameter}: A {{}}, B {{}}".format(*values))
    print_line(
        ", ".join(f"{n} {verdict}" for verdict, n in comparison.verdicts.items()) or "no decisions"
    )
    if comparison.p_value is not None:
        print_line(
            f"McNemar's exact test: p = {comparison.p_value:.2g} "
            f"({'more' if comparison.p_value < 0.05 else 'no more'} than chance explains)"
        )
    if comparison.places is not None:
        _print_places(comparison.places)
    rows = [_comparison_row(d) for d in comparison.decisions if d.obstacle is not None]
    if rows:
        print_line()
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
        print_line(f"places: {places.a} by A, {places.b} by B, none at the same moment")
        return
    text = (
        f"places: {len(places.pairs)} moments fixed by both, median "
        f"{places.median_apart_m:.2f} m apart, largest {places.largest_apart_m:.2f} m"
    )
    if places.rmse_a_m is not None and places.rmse_b_m is not None:
        text += f"; RMSE A {places.rmse_a_m:.2f} m, B {places.rmse_b_m:.2f} m"
    print_line(text)


READING_COMPARE = """
## How to read it

* Lanes `A` and `B`: steps hit (green), missed (red) and false (magenta); `differs` marks where \
only one of them is right.
* Panels: the decision function of each stage, its threshold as a red line, accepted candidates \
as green triangles, rejected ones as grey crosses.
"""


def _page(comparison: Comparison) -> str:
    """Return the page about two results."""
    from .why import counts_table

    lines = [
        f"# {comparison.recording}",
        "",
        f"A = {comparison.a.name}, B = {comparison.b.name}",
        "",
    ]
    if comparison.a.counts is not None and comparison.b.counts is not None:
        lines += counts_table((("A", comparison.a.counts), ("B", comparison.b.counts)))
    lines += ["", "| parameter | A | B |", "|---|---|---|"]
    lines += [f"| {c.stage}.{c.parameter} | {c.a} | {c.b} |" for c in comparison.parameters]
    lines += ["", *(f"* {n} {verdict}" for verdict, n in comparison.verdicts.items())]
    if comparison.p_value is not None:
        lines.append(f"* McNemar's exact test: p = {comparison.p_value:.3g}")
    differing = [d for d in comparison.decisions if d.obstacle is not None]
    lines += ["", "| time [s] | | why |", "|---|---|---|"]
    lines += [
        f"| {d.time_s:.3f} | {d.verdict} | {d.obstacle.side}: {d.obstacle.text} |"
        for d in differing
        if d.obstacle is not None
    ]
    return "\n".join(lines) + "\n" + READING_COMPARE
