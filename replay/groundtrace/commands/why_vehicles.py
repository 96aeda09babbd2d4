"""What ``groundtrace why`` prints about vehicles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..explain.vehicles import vehicle_account, vehicle_moment
from .output import print_json, print_table
from .why_steps import print_link

if TYPE_CHECKING:
    from ..explain import Evidence
    from ..explain.vehicles import VehicleAccount

HEADER = ("time [s]", "vehicle", "station", "", "stage", "why", "one setting that mends it")


def explain_vehicles(
    evidence: Evidence, at_ns: int | None, *, json: bool
) -> tuple[int | None, str]:
    """Print the account of passes or courses, or a moment; return its time [ns] and the page.

    Raises
    ------
    RecordingError
        Where there is nothing to explain.
    """
    if at_ns is not None:
        one = vehicle_moment(evidence, at_ns)
        if json:
            print_json(one, evidence.warnings)
        else:
            print(f"{one.time_s:.3f} s: {len(one.chain)} candidates")
            for link in one.chain:
                print_link(link)
        return at_ns, f"# vehicles at {one.time_s:.3f} s\n"
    found = vehicle_account(evidence)
    if json:
        print_json(found, evidence.warnings)
    else:
        print(_headline(found))
        if found.reasons:
            print_table(HEADER, _rows(found))
    return None, f"# {_headline(found)}\n"


def _headline(found: VehicleAccount) -> str:
    return (
        f"{found.recording}: {found.stage}: {found.right} right, {found.missed} missed, "
        f"{found.false} false"
    )


def _rows(found: VehicleAccount) -> list[tuple[str, ...]]:
    return [
        (
            f"{r.time_s:.2f}",
            r.target or "-",
            r.station,
            r.state,
            r.stage,
            r.text,
            f"--set {r.change}" if r.change else "-",
        )
        for r in found.reasons
    ]
