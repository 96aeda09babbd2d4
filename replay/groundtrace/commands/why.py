"""``groundtrace why``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from ..api.analysis import Answer, Kind, Question, evidence_with, explained
from ..explain.account import Account, Moment
from ..explain.arrivals import PickAccount, PickMoment
from ..explain.places import FixMoment, PlaceAccount
from ..explain.unfiltered import beside
from ..explain.vehicles import VehicleAccount, VehicleMoment
from ..plugins import load
from ..results import read_results
from .output import print_json, print_warnings, say
from .pages import account_page, moment_page
from .showing import where_to_show
from .truth import truth_of
from .why_picks import picks_page, print_pick, print_picks
from .why_places import place_page, places_page, print_place, print_places
from .why_steps import print_account, print_moment, remedy_text
from .why_vehicles import print_vehicle_moment, print_vehicles, vehicles_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..explain import Evidence

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
    asked = Question(kind, step, fix, pick, at, tolerance, tolerance_m, tolerance_ms / 1e3, stage)
    asked.checked_kind()
    fallback = Path(f"{results.stem}.why.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[results])
    evidence = _evidence(results, truth, recording or [])
    if not json:
        print_warnings(evidence.warnings)
    found = explained(evidence, results.name, asked)
    if isinstance(found.details, Account):
        for at_s in evidence.clock_steps_s:
            say(f"warning: a clock steps at {at_s:.3f} s: changes around it may not be exact")
    if json:
        print_json(found.details, evidence.warnings)
    else:
        _print(found)
    if rrd is not None or spawn:
        show = load("views", "why")
        page = _page(found)
        show(evidence, page, path=rrd, spawn=spawn, at_ns=found.time_ns, tolerance_s=tolerance)
    if rrd is not None:
        say(f"timeline: {rrd} (open it with: rerun {rrd})")


def _evidence(results: Path, truth: Path | None, recordings: Sequence[Path]) -> Evidence:
    """Read what decisions are explained by; it lives on without what it was read from."""
    result = read_results(results, evidence=True)
    places = (beside(results, result.provenance.recording), *recordings)
    return evidence_with(result, truth_of(result, results, truth), places)


def _print(found: Answer) -> None:
    """Print what was found, for people."""
    match found.details:
        case Account():
            print_account(found.details)
        case Moment():
            print_moment(found.details)
            if found.sought:
                print(f"\nsmallest change: {remedy_text(found.remedy)}")
        case PickAccount():
            print_picks(found.details)
        case PickMoment():
            print_pick(found.details)
        case PlaceAccount():
            print_places(found.details)
        case FixMoment():
            print_place(found.details, found.reference)
        case VehicleAccount():
            print_vehicles(found.details)
        case VehicleMoment():
            print_vehicle_moment(found.details)


def _page(found: Answer) -> str:
    """Return the page that a viewer's file has of it."""
    match found.details:
        case Account():
            return account_page(found.details)
        case Moment():
            title = "" if found.step is None else f"step {found.step}"
            return moment_page(found.details, title, found.remedy)
        case PickAccount():
            return picks_page(found.details)
        case PickMoment():
            return f"# picks at {found.details.time_s:.3f} s\n"
        case PlaceAccount():
            return places_page(found.details)
        case FixMoment():
            return place_page(found.details)
        case VehicleAccount():
            return vehicles_page(found.details)
        case VehicleMoment():
            return f"# vehicles at {found.details.time_s:.3f} s\n"
