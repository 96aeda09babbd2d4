"""Velocities of common floors and grounds: the tables of docs/waves.md."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers.wave_physics import (
    Plate,
    Response,
    Solid,
    a0_mps,
    cutoffs,
    front_mps,
    onset_s,
    sensor_mps,
    thin_a0_mps,
    thin_limit_hz,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

#: Round values to start from: stiffness varies by tens of per cent, and timber with direction.
FLOORS = {
    "concrete 0.10 m": Plate(0.10),
    "concrete 0.15 m": Plate(0.15),
    "concrete 0.20 m": Plate(0.20),
    "concrete 0.30 m": Plate(0.30),
    "timber panel 0.14 m": Plate(0.14, young_pa=9e9, density_kgm3=480.0, poisson=0.3),
    "timber boards 0.022 m": Plate(0.022, young_pa=10e9, density_kgm3=550.0, poisson=0.3),
}
#: The same of grounds, by what is measured on site: P and S velocity [m/s] and density [kg/m3].
GROUNDS = {
    "loose dry sand": Solid.of_velocities(350, 180, 1600),
    "stiff clay": Solid.of_velocities(700, 300, 1900),
    "wet soil": Solid.of_velocities(1550, 200, 1900),
    "dense gravel": Solid.of_velocities(900, 450, 2100),
}
_HEARD_HZ = (50.0, 200.0, 1000.0)
_DISTANCES_M = (5.0, 10.0, 15.0, 20.0)


def velocity_table() -> str:
    """Return velocities of floors and grounds [m/s] as a Markdown table."""
    a0_columns = [f"A0 {f:.0f} Hz" for f in _HEARD_HZ]
    head = ["", "P", "S", "Rayleigh", "S0", *a0_columns, "thin to Hz", "A1 from Hz", "seen at 5 m"]
    floors = [
        [name, *_solid_cells(Solid.of_plate(p)), *_plate_cells(p)] for name, p in FLOORS.items()
    ]
    grounds = [[name, *_solid_cells(solid)[:3], *["-"] * 7] for name, solid in GROUNDS.items()]
    return _markdown([head, *floors, *grounds])


def thinness_table(plate: Plate) -> str:
    """Return by how much the thin plate's A0 is too fast, as a Markdown table."""
    frequency_hz = np.array([100.0, 200, 500, 1000, 2000, 5000])
    thin, exact = thin_a0_mps(plate, frequency_hz), a0_mps(plate, frequency_hz)
    head = ["Hz", "A0", "sqrt(a w)", "too fast"]
    rows = zip(frequency_hz, exact, thin, 100 * (thin / exact - 1), strict=True)
    return _markdown([head, *([*_whole(row[:3]), f"{row[3]:.1f} %"] for row in rows)])


def perceived_table(plate: Plate) -> str:
    """Return the velocities a floor seems to have [m/s] as a Markdown table."""
    distance_m = np.array(_DISTANCES_M)
    head = ["distance m", "(4.25) front", "sensor", "onset over 200"]
    onset = distance_m / onset_s(Response(plate), distance_m)
    rows = zip(
        distance_m, front_mps(plate, distance_m), sensor_mps(plate, distance_m), onset, strict=True
    )
    return _markdown([head, *map(_whole, rows)])


def _solid_cells(solid: Solid) -> list[str]:
    return _whole((solid.p_mps, solid.s_mps, solid.rayleigh_mps, solid.plate_mps))


def _plate_cells(plate: Plate) -> list[str]:
    first = cutoffs(plate, Solid.of_plate(plate).s_mps / plate.thickness_m)[0]
    seen = sensor_mps(plate, np.array([5.0]))[0]
    bending = a0_mps(plate, np.array(_HEARD_HZ))
    return _whole((*bending, thin_limit_hz(plate), first.frequency_hz, seen))


def _whole(values: Iterable[float]) -> list[str]:
    return [f"{value:.0f}" for value in values]


def _markdown(rows: list[list[str]]) -> str:
    head, *body = rows
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *body))


def main() -> None:
    """Print the velocities of common floors, and what becomes of them on the default one."""
    print("Velocities [m/s]\n")
    print(velocity_table())
    for title, table in (
        ("A0 [m/s]", thinness_table),
        ("Perceived velocity [m/s]", perceived_table),
    ):
        print(f"\n{title}, concrete 0.20 m\n")
        print(table(Plate()))


if __name__ == "__main__":
    main()
