"""``groundtrace analyze``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter, validators

from groundtrace_codecs.geometry import Geometry

from ..analyze.layout import layout_of
from ..analyze.report import report
from ..analyze.room import Settings, analyze_room
from ..analyze.words import NAMES, assumed, findings
from ..plugins import load
from .output import existing, print_json, print_table, progress, say, writable
from .showing import where_to_show

if TYPE_CHECKING:
    from ..analyze.report import RoomReport
    from ..analyze.room import RoomAnalysis

FLAG = Parameter(negative="")
POSITIVE = Parameter(validator=validators.Number(gt=0, lt=math.inf))


def room(
    geometry: Path,
    *,
    sigma_ms: Annotated[float, POSITIVE] = 0.5,
    theta_s: Annotated[float | None, POSITIVE] = None,
    localizer: Literal["so-tdoa", "hyperbolic", "power-law"] = "power-law",
    lattice: Annotated[int, Parameter(validator=validators.Number(gte=3, lte=201))] = 21,
    draws: Annotated[int, Parameter(validator=validators.Number(gte=2, lte=10_000))] = 50,
    seed: Annotated[int, Parameter(validator=validators.Number(gte=0))] = 0,
    png: Path | None = None,
    rrd: Path | None = None,
    spawn: Annotated[bool, FLAG] = False,
    force: Annotated[bool, FLAG] = False,
    json: Annotated[bool, FLAG] = False,
) -> None:
    """Tell how well a layout of sensors will locate, before anyone records.

    Parameters
    ----------
    geometry
        TOML with sensors, outline and medium.
    sigma_ms
        Standard deviation of each sensor's arrivals [ms].
    theta_s
        Time scale of the velocity law instead of the medium's [s].
    localizer
        Which one the advice is for.
    lattice
        Places along the longer side of the room.
    draws
        Random errors at each place.
    seed
        Of everything random.
    png
        Write the figure here, as PNG.
    rrd
        Write a viewer's file with the maps.
    spawn
        Open the viewer with the same.
    force
        Overwrite existing outputs.
    json
        Print one JSON document.
    """
    if png is not None:
        writable(png, force=force, sources=[geometry])
    fallback = Path(f"{geometry.stem}.analysis.rrd")
    spawn, rrd = where_to_show(rrd, fallback, spawn=spawn, force=force, sources=[geometry])
    site = Geometry.from_toml(existing(geometry, "a geometry"))
    layout, remarks = layout_of(site, geometry.name, sigma_ms * 1e-3, theta_s)
    how = Settings(lattice, draws, seed, localizer)
    with progress(100.0, "analysing", "%") as show:
        found = analyze_room(layout, remarks, how, lambda part: show(100.0 * part))
    if json:
        print_json(report(found))
    else:
        _print(found)
    for remark in remarks:
        say(f"remark: {remark}")
    _write(found, png, rrd, spawn=spawn)


def _print(found: RoomAnalysis) -> None:
    print(f"{found.layout.name}: {assumed(found.layout)}")
    for line in findings(found):
        print(f"  {line}")
    if found.contributions:
        print("\nmean error without each sensor, rise [m]")
        _print_sensors(report(found))


def _print_sensors(document: RoomReport) -> None:
    rows = [
        (s.name, f"{s.x_m:.2f}", f"{s.y_m:.2f}", *(f"{v:+.3f}" for v in s.contribution_m.values()))
        for s in document.sensors
        if s.contribution_m is not None
    ]
    print_table(("sensor", "x [m]", "y [m]", *NAMES.values()), rows)


def _write(found: RoomAnalysis, png: Path | None, rrd: Path | None, *, spawn: bool) -> None:
    if png is not None:
        from ..analyze.figures import save

        save(found, png)
        say(f"figure: {png}")
    if rrd is not None or spawn:
        load("views", "room-analysis")(found, path=rrd, spawn=spawn)
    if rrd is not None:
        say(f"maps: {rrd} (open it with: rerun {rrd})")
