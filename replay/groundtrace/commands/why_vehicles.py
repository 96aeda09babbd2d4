"""What ``groundtrace why`` prints about vehicles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .output import print_table
from .why_steps import print_link

if TYPE_CHECKING:
    from ..explain.vehicles import VehicleAccount, VehicleMoment

HEADER = ("time [s]", "vehicle", "station", "", "stage", "why", "one setting that mends it")


def print_vehicles(found: VehicleAccount) -> None:
    """Print how many are right, and the reasons of those that are not."""
    print(_headline(found))
    if found.reasons:
        print_table(HEADER, _rows(found))


def print_vehicle_moment(found: VehicleMoment) -> None:
    """Print the candidates about a moment."""
    print(f"{found.time_s:.3f} s: {len(found.chain)} candidates")
    for link in found.chain:
        print_link(link)


def vehicles_page(found: VehicleAccount) -> str:
    """Return the page about all passes or courses."""
    return f"# {_headline(found)}\n"


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
