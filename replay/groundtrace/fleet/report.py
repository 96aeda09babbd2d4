"""A fleet's table as a page: one HTML file that needs nothing from anywhere else."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ..score.html import POLICY
from ..score.html_parts import STYLE, figure, folded, section, table, tiles
from .report_changes import changes_section
from .report_figures import cause_bars, distribution, span_for
from .report_rows import (
    LISTED,
    MISSES,
    causes_of,
    counted,
    damage_rows,
    error_rows,
    length,
    miss_rows,
    pipeline_rows,
    ranked,
    warning_rows,
    worst_rows,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .reading import FleetTable, MissedStep

    Misses = Mapping[tuple[str, str], Sequence[MissedStep]]

#: Column, divisor column, title, axis, whether it has a sign.
_DRAWN = (
    ("steps_f1", "", "F1 of steps", "F1 (0 to 1)", False),
    ("steps_count_error_signed", "steps_count_truth", "Count error", "Counted too many [%]", True),
    ("steps_latency_ms_median", "", "Latency of steps", "Median latency [ms]", True),
    ("positions_rmse_m", "", "Error of places", "RMSE of fixes [m]", False),
    ("picks_median_abs_ms", "", "Error of arrivals", "Median error [ms]", False),
    ("track_waypoints_median_m", "", "Error of the track", "Median at waypoints [m]", False),
    ("heading_rmse_deg", "", "Error of headings", "RMSE [deg]", False),
)
_MORE_STYLE = """
td:not(:first-child){overflow-wrap:normal}
.misses th,.misses td:nth-child(-n+3){white-space:nowrap;overflow-wrap:normal}
.misses td:last-child{min-width:26em;font:12.5px/1.5 ui-monospace,Menlo,Consolas,monospace;
font-variant-ligatures:none}
.better{color:var(--hit);font-weight:600}.worse{color:var(--missed);font-weight:600}
"""


def fleet_page(
    fleet: FleetTable, misses: Misses, files: Mapping[str, str], old: FleetTable | None = None
) -> str:
    """Return a fleet's table as an HTML page with figures.

    The page asks nothing of any server and runs no script. It names recordings as the table does.

    Parameters
    ----------
    fleet
        The table.
    misses
        Missed steps by location and pipeline.
    files
        What each pipeline is called on the command line, by its name.
    old
        An earlier table to compare with.
    """
    recorded = length(float(np.nansum(_of_each(fleet, "duration_s"))))
    subtitle = (
        f"{counted(len(set(fleet.of('location'))), 'recording')}, {recorded}, through "
        f"{', '.join(fleet.pipelines()) or 'no pipeline'}"
    )
    parts = [
        _overview(fleet),
        "" if old is None else changes_section(old, fleet),
        _distributions(fleet),
        _worst(fleet, misses, files),
        _causes(fleet),
        _errors(fleet),
        _warnings(fleet),
        _origin(fleet),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Fleet {escape(fleet.name)}</title><style>{STYLE}{_MORE_STYLE}</style></head>\n"
        '<body><main><header><p class="brand">groundtrace fleet</p>'
        f'<h1>{escape(fleet.name)}</h1><p class="sub">{escape(subtitle)}</p></header>\n'
        f"{''.join(parts)}</main></body></html>\n"
    )


def _of_each(fleet: FleetTable, column: str) -> list[float]:
    """Return a number of each recording, once whatever went through it."""
    by_place = dict(zip(fleet.of("location"), fleet.numbers(column).tolist(), strict=True))
    return list(by_place.values())


def _overview(fleet: FleetTable) -> str:
    failed, hurt = error_rows(fleet), damage_rows(fleet)
    wall_s, recorded_s = (float(np.nansum(fleet.numbers(n))) for n in ("wall_s", "duration_s"))
    speed = f"{recorded_s / wall_s:.3g} times real time in one process" if wall_s else ""
    f1 = fleet.numbers("steps_f1")
    f1 = f1[np.isfinite(f1)]
    items = [
        ("Rows", str(len(fleet)), "a recording through a pipeline"),
        ("Recorded", length(recorded_s), speed),
        ("Failed", str(len(failed)), "rows with an error"),
        ("Damaged", str(len(hurt)), "rows of which part was read"),
        ("Warned", str(sum(map(bool, fleet.of("warnings")))), "rows with a warning"),
    ]
    if len(f1):
        low, middle = np.percentile(f1, [10, 50])
        items.insert(2, ("F1 of steps", f"{middle:.3f}", f"median; one in ten below {low:.3f}"))
    header, rows = pipeline_rows(fleet)
    return section("Overview", tiles(items) + (table("", header, rows) if rows else ""))


def _distributions(fleet: FleetTable) -> str:
    drawn = []
    for column, divisor, title, axis, signed in _DRAWN:
        values = fleet.numbers(column)
        if divisor:
            of = fleet.numbers(divisor)
            values = 100 * values / np.where(of > 0, of, np.nan)
        span = span_for(values[np.isfinite(values)], signed=signed)
        span = (0.0, 1.0) if column == "steps_f1" else span
        for pipeline in fleet.pipelines():
            rows = np.flatnonzero(fleet.rows_of(pipeline) & np.isfinite(values))
            if len(rows):
                names = [fleet.of("recording")[row] for row in rows]
                outside = int((np.abs(values[rows]) > max(span)).sum())
                said = f"{counted(len(rows), 'recording')}; the broken line is the median."
                said += f" {outside} outside are drawn at the edge." if outside else ""
                plot = distribution(values[rows], names, axis, span)
                drawn.append(figure(f"{title}, {pipeline}", plot, said))
    return section("Distributions", f'<div class="pair">{"".join(drawn)}</div>') if drawn else ""


def _worst(fleet: FleetTable, misses: Misses, files: Mapping[str, str]) -> str:
    parts = []
    for ranking in ranked(fleet):
        header, rows = worst_rows(fleet, ranking)
        more = f"; the worst {LISTED} of {len(ranking.rows)}" if len(ranking.rows) > LISTED else ""
        parts.append(table(f"By {ranking.name}{more}", header, rows))
        for row in ranking.rows[:LISTED]:
            place = (fleet.of("location")[row], fleet.of("pipeline")[row])
            found = misses.get(place, ())
            if found:
                shown = f", the first {MISSES}" if len(found) > MISSES else ""
                title = f"{place[0]}, {place[1]}: {len(found)} missed{shown}"
                cells = miss_rows(fleet, row, found, files)
                inner = table("", ("miss", "time [s]", "cause", "why", "shows it"), cells)
                parts.append(folded(title, f'<div class="misses">{inner}</div>'))
    return section("Worst recordings first", "".join(parts)) if parts else ""


def _causes(fleet: FleetTable) -> str:
    parts = []
    for pipeline in fleet.pipelines():
        counts = causes_of(fleet, np.flatnonzero(fleet.rows_of(pipeline)))
        if counts:
            total = sum(n for _, n in counts)
            parts.append(figure(f"{pipeline}: {total} misses", cause_bars(counts)))
    said = "<p>A cause is that of the first gate that failed; groundtrace why explains each.</p>"
    return section("Misses by cause", said + "".join(parts)) if parts else ""


def _errors(fleet: FleetTable) -> str:
    failed, hurt = error_rows(fleet), damage_rows(fleet)
    parts = ""
    if failed:
        parts += table("Could not be replayed", ("recording", "pipeline", "error"), failed)
    if hurt:
        header = ("recording", "pipeline", "places", "messages lost", "gaps", "samples lost")
        parts += table("Damaged: the rest was replayed", header, hurt)
    return section("Errors and damage", parts or "<p>None.</p>")


def _warnings(fleet: FleetTable) -> str:
    rows = warning_rows(fleet)
    if not rows:
        return ""
    header = ("warning", "pipeline", "recordings", "the first of them")
    return section("Warnings", table("", header, rows))


def _origin(fleet: FleetTable) -> str:
    names = ("pipeline", "parameters", "versions", "error")
    rows = zip(*(fleet.of(name) for name in names), strict=True)
    known = dict.fromkeys((p, t, v) for p, t, v, error in rows if not error)
    parts = [
        folded(f"{pipeline}, with every parameter", f"<pre>{escape(recipe)}</pre>")
        for pipeline, recipe in dict.fromkeys((p, t) for p, t, _ in known)
    ]
    versions = [[v] for v in dict.fromkeys(v for _, _, v in known)]
    return section("Origin", table("", ("versions",), versions) + "".join(parts))
