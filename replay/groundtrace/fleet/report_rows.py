"""Tables of a fleet's page: pipelines, the worst recordings, what opens a miss, errors."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from .measures import MEASURES, Measure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from .reading import FleetTable, MissedStep

#: The worst recordings that are listed, and misses of each.
LISTED, MISSES = 25, 8
#: What ``replay --at-miss`` matches steps by [s]; misses of another tolerance have other numbers.
AT_MISS_TOLERANCE_S = 0.12
AROUND_S = 5.0
NO_FIGURE = "\N{EN DASH}"
#: What recordings are put in order by, as far as they have it.
_RANKED = (
    ("steps_f1", "F1", True),
    ("steps_count_error", "count error, where only counts are known", False),
    ("passes_matched", "passes found", True),
    ("positions_rmse_m", "RMSE of places [m]", False),
    ("picks_median_abs_ms", "arrivals [ms]", False),
    ("track_waypoints_median_m", "median at waypoints [m]", False),
    ("heading_rmse_deg", "heading RMSE [deg]", False),
)


@dataclass(frozen=True, slots=True)
class Ranked:
    """Rows of a table from the worst on, by one figure.

    Attributes
    ----------
    column, name
        The figure.
    rows
        Numbers of the rows.
    """

    column: str
    name: str
    rows: tuple[int, ...]


def ranked(table: FleetTable) -> list[Ranked]:
    """Return the rows from the worst on: each by the first of the figures that it has."""
    left = np.ones(len(table), np.bool_)
    found = []
    for column, name, higher in _RANKED:
        values = table.numbers(column)
        if column == "passes_matched":
            values = values / np.maximum(table.numbers("passes_truth"), 1)
        rows = np.flatnonzero(left & np.isfinite(values))
        left[rows] = False
        if len(rows):
            order = np.argsort(values[rows] if higher else -values[rows], kind="stable")
            found.append(Ranked(column, name, tuple(rows[order].tolist())))
    return found


def pipeline_rows(table: FleetTable) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of what each pipeline reached over all recordings."""
    named = [(m, m.sums(table)) for m in MEASURES]
    shown = [(m, s) for m, s in named if np.isfinite(s.top + s.bottom).any()]
    header = ["figure", *table.pipelines()]
    rows = []
    for measure, sums in shown:
        cells = [measure.name + (f" [{measure.unit}]" if measure.unit else "")]
        for pipeline in table.pipelines():
            kept = table.rows_of(pipeline) & np.isfinite(sums.top + sums.bottom)
            bottom = float(sums.bottom[kept].sum())
            cells.append(
                figure(float(sums.top[kept].sum()) / bottom, measure) if bottom else NO_FIGURE
            )
        rows.append(cells)
    return header, rows


def figure(value: float, measure: Measure, *, sign: bool = False) -> str:
    """Return a figure as text, with as many digits as it deserves."""
    digits = 3 if not measure.unit else 2 if abs(value) < 10 else 1
    return f"{value:{'+' if sign else ''}.{digits}f}"


def worst_rows(table: FleetTable, ranking: Ranked) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the worst recordings."""
    values = table.numbers(ranking.column)
    steps = ranking.column == "steps_f1"
    header = ["recording", "pipeline", ranking.name, "duration [s]"]
    header += ["true steps", "missed", "false", "counted", "most misses by"] if steps else []
    rows = []
    for row in ranking.rows[:LISTED]:
        cells = [table.of("location")[row], table.of("pipeline")[row], f"{values[row]:.3g}"]
        cells.append(f"{table.numbers('duration_s')[row]:.0f}")
        rows.append(cells + (_step_cells(table, row) if steps else []))
    return header, rows


def _step_cells(table: FleetTable, row: int) -> list[str]:
    truth, detected, matched, error = (
        int(table.of(f"steps_{name}")[row])
        for name in ("truth", "detected", "matched", "count_error_signed")
    )
    causes = causes_of(table, np.array([row]))
    main = causes[0][0] if causes else NO_FIGURE
    return [
        str(truth),
        str(truth - matched),
        str(detected - matched),
        f"{error:+d}" if error else "0",
        main,
    ]


def causes_of(table: FleetTable, rows: NDArray[np.intp]) -> list[tuple[str, int]]:
    """Return how many misses of some rows have each cause, the most frequent first."""
    prefix = "missed_"
    names = [name for name in table.columns if name.startswith(prefix)]
    counted = [(name[len(prefix) :], np.nansum(table.numbers(name)[rows])) for name in names]
    return sorted(((c, int(n)) for c, n in counted if n > 0), key=lambda item: (-item[1], item[0]))


def miss_rows(
    table: FleetTable, row: int, misses: Sequence[MissedStep], files: Mapping[str, str]
) -> list[list[str]]:
    """Return the first misses of a recording: time, cause, why, and what opens it.

    Parameters
    ----------
    table, row
        The recording and pipeline.
    misses
        Its missed steps.
    files
        What each pipeline is called on the command line, by its name.
    """
    return [
        [
            str(miss.miss),
            f"{miss.time_s:.2f}",
            miss.cause,
            miss.text,
            command(table, row, miss, files),
        ]
        for miss in misses[:MISSES]
    ]


def command(table: FleetTable, row: int, miss: MissedStep, files: Mapping[str, str]) -> str:
    """Return what shows the signal and every decision around a miss."""
    location = table.of("location")[row]
    stem = PurePosixPath(table.of("recording")[row]).stem
    words = ["groundtrace", "replay", location]
    pipeline = table.of("pipeline")[row]
    words += ["--pipeline", files.get(pipeline, pipeline)]
    own = table.of("truth")[row] in ("recording", "annotations")
    if own and table.of("tolerance_s")[row] == AT_MISS_TOLERANCE_S:
        words += ["--at-miss", str(miss.miss)]
    else:
        start_s = max(0.0, miss.time_s - AROUND_S)
        words += ["--from", f"{start_s:.1f}", "--to", f"{miss.time_s + AROUND_S:.1f}"]
    return shlex.join([*words, "--rrd", f"{stem}-miss{miss.miss}.rrd"])


def length(seconds: float) -> str:
    """Return a duration as text."""
    if seconds < 600:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 7200 else f"{seconds / 3600:.4g} h"


def counted(number: int, what: str) -> str:
    """Return a number of things as text."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def error_rows(table: FleetTable) -> list[list[str]]:
    """Return the recordings that could not be replayed, and why."""
    columns = (table.of("location"), table.of("pipeline"), table.of("error"))
    return [[str(cell) for cell in row] for row in zip(*columns, strict=True) if row[2]]


def warning_rows(table: FleetTable) -> list[list[str]]:
    """Return what was warned of, and of how many recordings; the most frequent first."""
    counts: dict[tuple[str, str], list[str]] = {}
    columns = (table.of("location"), table.of("pipeline"), table.of("warnings"))
    for location, pipeline, told in zip(*columns, strict=True):
        for text in (told or "").split(" | ") if told else ():
            counts.setdefault((pipeline, text), []).append(location)
    found = sorted(counts.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        [text, pipeline, str(len(names)), names[0]] for (pipeline, text), names in found[:LISTED]
    ]


def damage_rows(table: FleetTable) -> list[list[str]]:
    """Return the recordings of which part could not be read."""
    names = ("location", "pipeline", "damaged_places", "lost_messages", "gaps", "lost_samples")
    rows = zip(*(table.of(name) for name in names), strict=True)
    return [[str(cell) for cell in row] for row in rows if row[2]]
