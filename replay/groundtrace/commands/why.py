"""``groundtrace why``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..explain import Healer, Redecider, evidence_of
from ..explain.account import account, moment, remedy_of
from ..explain.counted import matched
from ..explain.reasons import StepReasons
from ..explain.unfiltered import beside, with_recording
from ..plugins import load
from ..results import read_results
from .output import print_json, print_warnings, say
from .pages import account_page, moment_page
from .showing import where_to_show
from .truth import truth_of
from .why_picks import explain_picks
from .why_places import explain_places
from .why_steps import print_account, print_moment, remedy_text
from .why_vehicles import explain_vehicles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..explain import Evidence

Kind = Literal["steps", "picks", "fixes", "vehicles"]
Count = Annotated[int | None, Parameter(validator=validators.Number(gte=1))]
Positive = Annotated[float, Parameter(validator=validators.Number(gt=0))]


def why(
    results: Path,
    *,
    kind: Kind | None = None,
    step: Count = None,
    fix: Count = None,
    pick: Count = None,
    at: float | None = None,
    truth: Path | None = None,
    recording: Annotated[list[Path] | None, Parameter(negative="")] = None,
    tolerance: Positive = 0.12,
    tolerance_m: Positive = 1.0,
    tolerance_ms: Positive = 2.0,
    stage: str = "",
    rrd: Path | None = None,
    spawn: Annotated[bool, Parameter(negative="")] = False,
    force: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Explain every missed and false step, bad pick or bad place, and the change that mends it.

    Parameters
    ----------
    results
        Results MCAP that groundtrace replay wrote.
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
    truth
        Truth instead of the recording's own: CSV, .sgt hand picks, or MCAP.
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
    force
        Overwrite an existing output.
    json
        Print one JSON document.
    """
    numbers: dict[Kind, int | None] = {"steps": step, "fixes": fix, "picks": pick}
    chosen = _kind(kind, numbers)
    fallback = Path(f"{results.stem}.why.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[results])
    evidence = _evidence(results, truth, recording or [])
    if not json:
        print_warnings(evidence.warnings)
    at_ns = None if at is None else evidence.start_ns + round(at * NS_PER_S)
    if chosen == "steps" and kind is None and step is None:
        chosen = "vehicles" if evidence.config.application == "vehicle" else chosen
    tolerances = {"steps": tolerance, "fixes": tolerance_m, "picks": tolerance_ms / 1e3}
    asked = Asked(
        results.name, numbers.get(chosen), at_ns, stage, tolerances.get(chosen, 0.0), json
    )
    time_ns, page = EXPLAINERS[chosen](evidence, asked)
    if rrd is not None or spawn:
        show = load("views", "why")
        show(evidence, page, path=rrd, spawn=spawn, at_ns=time_ns, tolerance_s=tolerance)
    if rrd is not None:
        say(f"timeline: {rrd} (open it with: rerun {rrd})")


def _evidence(results: Path, truth: Path | None, recordings: Sequence[Path]) -> Evidence:
    """Read what decisions are explained by; it lives on without what it was read from."""
    result = read_results(results, evidence=True)
    evidence = evidence_of(result, truth_of(result, results, truth))
    origin = result.provenance
    places = (beside(results, origin.recording), *recordings)
    return with_recording(evidence, origin.sha256, places)


def _kind(kind: Kind | None, numbers: dict[Kind, int | None]) -> Kind:
    """Return what to explain: what is asked for, or what a number is given of."""
    given = [name for name, number in numbers.items() if number is not None]
    wanted = kind or (given[0] if given else "steps")
    if any(name != wanted for name in given):
        options = {"steps": "--step", "fixes": "--fix", "picks": "--pick"}
        found = " and ".join(options[name] for name in given)
        raise RecordingError(f"--kind {wanted}: expected {options[wanted]}, found {found}")
    return wanted


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be explained of a kind.

    Attributes
    ----------
    name
        Of the results, for errors.
    number, at_ns
        One of its moments, by its number or its time [ns]; None of both: all that are wrong.
    stage
        Whose; empty for the last.
    tolerance
        Within which one is right, in the unit of its kind: s or m.
    json
        Whether one JSON document is printed.
    """

    name: str
    number: int | None
    at_ns: int | None
    stage: str
    tolerance: float
    json: bool


def _explain_steps(evidence: Evidence, asked: Asked) -> tuple[int | None, str]:
    """Print the account of steps, or of one; return its time [ns] and the page."""
    name, step, at_ns, tolerance = asked.name, asked.number, asked.at_ns, asked.tolerance
    if step is None and at_ns is None:
        return None, _explain_all(evidence, name, tolerance, json=asked.json)
    time_ns = _time_of(evidence, name, step, tolerance) if at_ns is None else at_ns
    number = step if at_ns is None else None
    return time_ns, _explain_moment(evidence, time_ns, number, tolerance, json=asked.json)


#: What explains a kind; it prints, and returns the time looked at [ns] and the page.
EXPLAINERS: Mapping[Kind, Callable[[Evidence, Asked], tuple[int | None, str]]] = {
    "steps": _explain_steps,
    "picks": lambda evidence, a: explain_picks(
        evidence, a.stage, a.tolerance, a.number, a.at_ns, json=a.json
    ),
    "fixes": lambda evidence, a: explain_places(
        evidence, a.stage, a.tolerance, a.number, a.at_ns, json=a.json
    ),
    "vehicles": lambda evidence, a: explain_vehicles(evidence, a.at_ns, json=a.json),
}


def _time_of(evidence: Evidence, name: str, step: int | None, tolerance: float) -> int:
    steps = matched(evidence, tolerance).truth_ns
    if step is None or step > len(steps):
        raise RecordingError(f"{name}: --step: expected 1 to {len(steps)}, found {step}")
    return int(steps[step - 1])


def _explain_all(evidence: Evidence, name: str, tolerance: float, *, json: bool) -> str:
    """Print the account; return it as a page."""
    if not any(label.kind == "step" for label in evidence.labels):
        raise RecordingError(
            f"{name}: expected true steps (in the recording, or --truth FILE), found none; "
            f"--at SECONDS explains a moment without truth"
        )
    for at_s in evidence.clock_steps_s:
        say(f"warning: a clock steps at {at_s:.3f} s: changes around it may not be exact")
    found = account(evidence, tolerance)
    if json:
        print_json(found, evidence.warnings)
    else:
        print_account(found)
    return account_page(found)


def _explain_moment(
    evidence: Evidence, time_ns: int, step: int | None, tolerance: float, *, json: bool
) -> str:
    """Print what there is at a moment; return it as a page."""
    found = moment(evidence, time_ns, tolerance)
    remedy, sought = None, step is not None and found.reason is not None
    if sought:
        reasons = StepReasons(evidence, tolerance)
        remedy = remedy_of(Healer(Redecider(evidence), tolerance), reasons, time_ns)
    if json:
        print_json(found, evidence.warnings)
    else:
        print_moment(found)
        if sought:
            print(f"\nsmallest change: {remedy_text(remedy)}")
    return moment_page(found, "" if step is None else f"step {step}", remedy)
