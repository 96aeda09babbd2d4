"""What a fleet's table says, alone or against an earlier one, and the page that says it."""

from __future__ import annotations

import csv
import shlex
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from groundtrace_codecs.truth import plain_cell

from ..errors import RecordingError
from ..evaluation.drawing import COLOURS, WIDE, Drawing
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.page import rendered
from ..explain.reasons import RatioOfSums, interval_of_change

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    from markupsafe import Markup
    from numpy.typing import NDArray

    from ..explain.reasons import Interval, TestedInterval
    from .table import FleetTable, MissedStep

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
#: From so many recordings on they are counted in bars; fewer are drawn one by one.
ENOUGH_FOR_BARS = 20
BINS = 25
#: Recordings listed that fell, and that rose.
CHANGES_LISTED = 12


def fleet_page(
    fleet: FleetTable,
    misses: Misses,
    files: Mapping[str, str],
    old: FleetTable | None = None,
    figure_changes: Sequence[Change] = (),
    by: str = "",
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
    figure_changes
        The changes since.
    by
        What was left out as a whole; empty for recordings.
    """
    recorded = length(float(np.nansum(_of_each(fleet, "duration_s"))))
    wall_s, recorded_s = (float(np.nansum(fleet.numbers(n))) for n in ("wall_s", "duration_s"))
    f1 = fleet.numbers("steps_f1")
    f1 = f1[np.isfinite(f1)]
    return rendered(
        "fleet.html.jinja",
        Path(__file__).parent,
        kind="fleet",
        name=fleet.name,
        subtitle=f"{counted(len(set(fleet.of('location'))), 'recording')}, {recorded}, through "
        f"{', '.join(fleet.pipelines()) or 'no pipeline'}",
        rows=len(fleet),
        recorded=length(recorded_s),
        speed=f"{recorded_s / wall_s:.3g} times real time in one process" if wall_s else "",
        f1=np.percentile(f1, [50, 10]).tolist() if len(f1) else None,
        failed=error_rows(fleet),
        hurt=damage_rows(fleet),
        warned=sum(map(bool, fleet.of("warnings"))),
        by_pipeline=pipeline_rows(fleet),
        against=None if old is None else _against(old, fleet, figure_changes),
        by=by,
        false_discoveries=FALSE_DISCOVERIES,
        fewest=FEWEST,
        distributions=list(_distributions(fleet)),
        worst=_worst(fleet, misses, files),
        causes=list(_causes(fleet)),
        warnings=warning_rows(fleet),
        **_origin(fleet),
    )


def _of_each(fleet: FleetTable, column: str) -> list[float]:
    """Return a number of each recording, once whatever went through it."""
    by_place = dict(zip(fleet.of("location"), fleet.numbers(column).tolist(), strict=True))
    return list(by_place.values())


class FleetFigure(NamedTuple):
    """A figure, what stands above it, and what is said below it."""

    title: str
    svg: Markup
    caption: str = ""


class FleetRows(NamedTuple):
    """A table: its title, header and rows; ``misses`` are tables of what some rows missed."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    misses: Sequence[FleetRows] = ()


def _distributions(fleet: FleetTable) -> Iterator[FleetFigure]:
    """Yield how each figure is distributed over the recordings of each pipeline."""
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
                caption = f"{counted(len(rows), 'recording')}; the broken line is the median."
                caption += f" {outside} outside are drawn at the edge." if outside else ""
                drawn = distribution(values[rows], names, axis, span)
                yield FleetFigure(f"{title}, {pipeline}", drawn, caption)


def _worst(fleet: FleetTable, misses: Misses, files: Mapping[str, str]) -> list[FleetRows]:
    """Return the worst recordings, by each figure that puts them in order, and what they missed."""
    tables = []
    for ranking in ranked(fleet):
        header, rows = worst_rows(fleet, ranking)
        more = len(ranking.rows) > WORST_LISTED
        title = f"By {ranking.name}"
        title += f"; the worst {WORST_LISTED} of {len(ranking.rows)}" if more else ""
        missed = []
        for row in ranking.rows[:WORST_LISTED]:
            key = (fleet.of("location")[row], fleet.of("pipeline")[row])
            if of := misses.get(key, ()):
                shown = f", the first {MISSES}" if len(of) > MISSES else ""
                heading = f"{key[0]}, {key[1]}: {len(of)} missed{shown}"
                columns = ("miss", "time [s]", "cause", "why", "shows it")
                missed.append(FleetRows(heading, columns, miss_rows(fleet, row, of, files)))
        tables.append(FleetRows(title, header, rows, missed))
    return tables


def _causes(fleet: FleetTable) -> Iterator[FleetFigure]:
    """Yield the misses of each pipeline by cause."""
    for pipeline in fleet.pipelines():
        counts = causes_of(fleet, np.flatnonzero(fleet.rows_of(pipeline)))
        if counts:
            total = sum(n for _, n in counts)
            yield FleetFigure(f"{pipeline}: {total} misses", cause_bars(counts))


def _origin(fleet: FleetTable) -> dict[str, list[tuple[str, ...]]]:
    """Return the recipes of the pipelines, and the versions."""
    names = ("pipeline", "parameters", "versions", "error")
    rows = zip(*(fleet.of(name) for name in names), strict=True)
    origins = dict.fromkeys((p, t, v) for p, t, v, error in rows if not error)
    return {
        "recipes": list(dict.fromkeys((p, t) for p, t, _ in origins)),
        "versions": [(v,) for v in dict.fromkeys(v for _, _, v in origins)],
    }


class Against(NamedTuple):
    """What changed since an earlier table: name, rows in both, intervals, figures, recordings."""

    name: str
    pairs: int
    tested: int
    figures: list[tuple[list[str], Verdict]]
    tables: list[FleetRows]


def _against(old: FleetTable, new: FleetTable, figure_changes: Sequence[Change]) -> Against:
    pairs = pairs_of(old, new)
    tables = [each for each in _moved(old, new, pairs) if each.rows] if figure_changes else []
    figures = [(change_cells(change), change.verdict) for change in figure_changes]
    tested = sum(change.interval is not None for change in figure_changes)
    return Against(old.name, len(pairs), tested, figures, tables)


def _moved(old: FleetTable, new: FleetTable, pairs: list[tuple[int, int]]) -> Iterator[FleetRows]:
    """Yield the recordings whose F1 fell and rose most, and those that fail now or no more."""
    before, after = old.numbers("steps_f1"), new.numbers("steps_f1")
    moved = np.array([after[b] - before[a] for a, b in pairs], np.float64)
    order = [int(i) for i in np.argsort(moved, kind="stable") if np.isfinite(moved[i])]
    fell = [i for i in order if moved[i] < 0][:CHANGES_LISTED]
    rose = [i for i in reversed(order) if moved[i] > 0][:CHANGES_LISTED]
    places = list(zip(new.of("location"), new.of("pipeline"), strict=True))
    for title, indices in (("F1 fell most", fell), ("F1 rose most", rose)):
        figures = ((pairs[i], moved[i]) for i in indices)
        rows = [
            (*places[b], f"{before[a]:.3f}", f"{after[b]:.3f}", f"{change:+.3f}")
            for (a, b), change in figures
        ]
        yield FleetRows(title, ("recording", "pipeline", "before", "now", "change"), rows)
    was, now = old.of("error"), new.of("error")
    failed = [
        (*places[b], was[a] or "none", now[b] or "none")
        for a, b in pairs
        if bool(was[a]) != bool(now[b])
    ]
    header = ("recording", "pipeline", "error before", "error now")
    yield FleetRows("Fail now, or no more", header, failed)


def change_cells(change: Change) -> list[str]:
    """Return a change as text: figure, pipeline, recordings, groups, before..interval, p."""
    measure, interval = change.measure, change.interval
    interval_text = (
        "" if change.verdict == "the same" else f"needs {FEWEST} groups, found {change.groups}"
    )
    if interval is not None:
        low, high = (figure(end, measure, sign=True) for end in (interval.low, interval.high))
        interval_text = f"{low} to {high}"
    return [
        measure.name + (f" [{measure.unit}]" if measure.unit else ""),
        change.pipeline,
        str(change.recordings),
        str(change.groups),
        figure(change.before, measure),
        figure(change.after, measure),
        figure(change.after - change.before, measure, sign=True),
        interval_text,
        "" if change.adjusted_p is None else f"{change.adjusted_p:.3f}",
    ]


def distribution(
    values: NDArray[np.float64], names: Sequence[str], label: str, span: tuple[float, float]
) -> Markup:
    """Return how a figure is distributed over recordings.

    Parameters
    ----------
    values
        Of each recording, finite, shape (n,).
    names
        Of the recordings.
    label
        What the figure is, with its unit.
    span
        Ends of the axis; what lies outside is drawn at them.
    """
    clipped = np.clip(values, *span)
    if len(values) < ENOUGH_FOR_BARS:
        order = np.argsort(clipped, kind="stable")
        plot = Drawing(f"{label}, recording by recording", label, "Recordings, in order")
        tips = [f"{names[row]}: {values[row]:.4g}" for row in order]
        plot.dots(clipped[order], np.arange(1, len(clipped) + 1), "result", tips, 8)
        plot.axes.locator_params(axis="y", integer=True)
        plot.axes.set_ylim(0.4, len(clipped) + 0.6)
    else:
        edges = np.linspace(*span, BINS + 1)
        counts, _ = np.histogram(clipped, edges)
        plot = Drawing(f"Distribution of {label}", label, "Recordings [count]")
        ends = zip(edges, edges[1:], counts, strict=False)
        plot.bars(edges, counts, [f"{low:.4g} to {high:.4g}: {n}" for low, high, n in ends])
        plot.axes.set_ylim(0, max(4.0, 1.12 * float(counts.max())))
    plot.mark(x=float(np.median(clipped)))
    margin = 0.02 * (span[1] - span[0])
    plot.axes.set_xlim(span[0] - margin, span[1] + margin)
    return plot.svg()


def span_for(values: NDArray[np.float64], *, signed: bool) -> tuple[float, float]:
    """Return the ends of an axis that shows all but the farthest values.

    Parameters
    ----------
    values
        Of all pipelines, finite.
    signed
        Whether the axis is to be even about zero.
    """
    reach = float(np.percentile(np.abs(values), 98)) if len(values) else 1.0
    reach = max(1.15 * reach, 1e-3)
    return (-reach, reach) if signed else (0.0, reach)


def cause_bars(counts: Sequence[tuple[str, int]]) -> Markup:
    """Return misses by cause as bars, the most frequent first."""
    total = sum(n for _, n in counts)
    causes, numbers = [cause for cause, _ in counts], [n for _, n in counts]
    plot = Drawing("Misses by cause", "Misses [count]", "", WIDE, 60 + 30 * len(counts))
    places = -np.arange(len(counts))
    bars = plot.axes.barh(places, numbers, 0.7, color=COLOURS["result"])
    plot.tell_bars(bars, [f"{cause}: {n} of {total} misses" for cause, n in counts])
    for position, n in zip(places, numbers, strict=True):
        plot.note(n, float(position), f"{n} ({n / total:.0%})", va="center", xytext=(6, 0))
    plot.axes.set_yticks(places, causes)
    plot.axes.set_xlim(0, 1.12 * max(numbers))
    plot.axes.grid(visible=False, axis="y")
    plot.axes.locator_params(axis="x", integer=True)
    return plot.svg()


#: The worst recordings that are listed, and misses of each.
WORST_LISTED, MISSES = 25, 8
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
    rankings = []
    for column, name, higher in _RANKED:
        values = table.numbers(column)
        if column == "passes_matched":
            values = values / np.maximum(table.numbers("passes_truth"), 1)
        rows = np.flatnonzero(left & np.isfinite(values))
        left[rows] = False
        if len(rows):
            order = np.argsort(values[rows] if higher else -values[rows], kind="stable")
            rankings.append(Ranked(column, name, tuple(rows[order].tolist())))
    return rankings


def pipeline_rows(table: FleetTable) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of what each pipeline reached over all recordings."""
    named = [(m, m.sums(table)) for m in MEASURES]
    shown = [(m, s) for m, s in named if np.isfinite(s.top + s.bottom).any()]
    header = ["figure", *table.pipelines()]
    rows = []
    for measure, sums in shown:
        cells = [measure.name + (f" [{measure.unit}]" if measure.unit else "")]
        for pipeline in table.pipelines():
            valid = table.rows_of(pipeline) & np.isfinite(sums.top + sums.bottom)
            bottom = float(sums.bottom[valid].sum())
            cells.append(
                figure(float(sums.top[valid].sum()) / bottom, measure) if bottom else NO_FIGURE
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
    for row in ranking.rows[:WORST_LISTED]:
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
    has_own_truth = table.of("truth")[row] in ("recording", "annotations")
    # replay --at-miss matches by this tolerance; misses of another one have other numbers
    if has_own_truth and table.of("tolerance_s")[row] == STEP_TOLERANCE_S:
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
    for location, pipeline, warnings in zip(*columns, strict=True):
        for part in (warnings or "").split(" | ") if warnings else ():
            counts.setdefault((pipeline, part), []).append(location)
    by_count = sorted(counts.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        [text, pipeline, str(len(names)), names[0]]
        for (pipeline, text), names in by_count[:WORST_LISTED]
    ]


def damage_rows(table: FleetTable) -> list[list[str]]:
    """Return the recordings of which part could not be read."""
    names = ("location", "pipeline", "damaged_places", "lost_messages", "gaps", "lost_samples")
    rows = zip(*(table.of(name) for name in names), strict=True)
    return [[str(cell) for cell in row] for row in rows if row[2]]


Verdict = Literal["better", "worse", "too small to matter", "undecided", "the same"]
#: Part of the figures called better or worse that may be so by chance. Source: the definition of
#: the interval, which misses as many.
FALSE_DISCOVERIES = 0.1
#: With fewer recordings of both nothing is said: drawing so few again tells nothing.
FEWEST = 6


@dataclass(frozen=True, slots=True)
class Measure:
    """A figure over recordings: a ratio of sums.

    Attributes
    ----------
    key
        Its name on the command line.
    matters
        The least difference that matters, in its unit.
    name, unit
        For people.
    top, bottom
        Columns whose sums are divided, ``+`` between several; no bottom means the mean.
    scale
        What the ratio is multiplied by.
    higher
        Whether more is better.
    absolute
        Whether the sign is left out first.
    """

    key: str
    matters: float
    name: str
    unit: str
    top: str
    bottom: str = ""
    scale: float = 1.0
    higher: bool = False
    absolute: bool = False

    def sums(self, table: FleetTable) -> RatioOfSums:
        """Return what each row adds, NaN where it has no such figure."""
        top = self.scale * _added(table, self.top)
        top = np.abs(top) if self.absolute else top
        bottom = _added(table, self.bottom) if self.bottom else np.ones(len(table))
        return RatioOfSums(top, bottom)


#: Key, least difference that matters, name, unit, columns, scale. Chosen by judgement: of steps and
#: answers one in a hundred; of latency half a sample at 100 Hz; of places 5 cm and of tracks 10 cm,
#: less than feet are apart; of arrivals two samples at 20 kHz; of headings half a degree.
MEASURES = (
    Measure(
        "f1",
        0.01,
        "F1, all steps together",
        "",
        "steps_matched",
        "steps_truth+steps_detected",
        2,
        True,
    ),
    Measure("f1_mean", 0.01, "F1, mean of recordings", "", "steps_f1", higher=True),
    Measure("recall", 0.01, "Recall", "", "steps_matched", "steps_truth", higher=True),
    Measure("precision", 0.01, "Precision", "", "steps_matched", "steps_detected", higher=True),
    Measure("count_error", 1, "Count error", "%", "steps_count_error", "steps_count_truth", 100),
    Measure(
        "latency_ms",
        5,
        "Latency, median, without sign",
        "ms",
        "steps_latency_ms_median",
        absolute=True,
    ),
    Measure("place_m", 0.05, "Place, RMSE of fixes", "m", "positions_rmse_m"),
    Measure("arrivals_ms", 0.1, "Arrivals, median error", "ms", "picks_median_abs_ms"),
    Measure("answered", 1, "Arrivals answered", "%", "picks_answered", "picks_truth", 100, True),
    Measure("track_m", 0.1, "Track, median at waypoints", "m", "track_waypoints_median_m"),
    Measure("ospa_m", 0.1, "Track, OSPA", "m", "track_ospa_m"),
    Measure("heading_deg", 0.5, "Heading, RMSE", "deg", "heading_rmse_deg"),
    Measure("disturbance_f1", 0.01, "Disturbance, F1", "", "disturbance_f1", higher=True),
    Measure("passes", 1, "Passes found", "%", "passes_matched", "passes_truth", 100, True),
)


@dataclass(frozen=True, slots=True)
class Change:
    """A figure before and after.

    Attributes
    ----------
    measure
        Which one.
    pipeline
        Of the new table.
    recordings
        Those that have it in both tables.
    before, after
        Over these.
    interval
        Of the change; None where there are too few groups to tell.
    verdict
        Better or worse where that is told apart from chance among all figures, and matters.
    groups
        What was left out in turn: recordings, or groups of them.
    adjusted_p
        Of the figure among all compared (Benjamini and Hochberg 1995); None without an interval.
    """

    measure: Measure
    pipeline: str
    recordings: int
    before: float
    after: float
    interval: TestedInterval | None
    verdict: Verdict
    groups: int
    adjusted_p: float | None = None


def pairs_of(old: FleetTable, new: FleetTable) -> list[tuple[int, int]]:
    """Return the numbers of the rows, old and new, of one recording and pipeline.

    Recordings are the same by name and bytes; where either table has one pipeline only, it is
    compared with the other's one, whatever their names.
    """
    one = len(set(old.pipelines())) == 1 == len(set(new.pipelines()))
    old_rows = {key: row for row, key in enumerate(_keys(old, named=not one))}
    keys = enumerate(_keys(new, named=not one))
    return [(old_rows[key], row) for row, key in keys if key in old_rows]


def changes(
    old: FleetTable,
    new: FleetTable,
    groups: Sequence[str] | None = None,
    matters: Mapping[str, float] | None = None,
) -> list[Change]:
    """Return every figure that both tables have, pipeline by pipeline.

    Parameters
    ----------
    old, new
        The tables.
    groups
        Of each row of the new table: what is left out as a whole; None leaves out recordings.
    matters
        The least difference that matters by the key of a figure, where not its own.
    """
    numbers = np.arange(len(new)) if groups is None else np.unique(groups, return_inverse=True)[1]
    pairs = np.array(pairs_of(old, new), np.intp).reshape(-1, 2)
    figure_changes = []
    for pipeline in new.pipelines():
        mine = pairs[new.rows_of(pipeline)[pairs[:, 1]]]
        for measure in MEASURES:
            change = _change(measure, pipeline, measure.sums(old), measure.sums(new), mine, numbers)
            if change is not None:
                figure_changes.append(change)
    return _judged(figure_changes, matters or {})


def _judged(figure_changes: Sequence[Change], matters: Mapping[str, float]) -> list[Change]:
    """Return changes with verdicts: all intervals together are corrected for their number."""
    from scipy.stats import false_discovery_control

    tested = [change.interval.p for change in figure_changes if change.interval is not None]
    adjusted = iter(false_discovery_control(tested).tolist() if tested else ())
    judged = []
    for change in figure_changes:
        if change.interval is None:
            judged.append(change)
            continue
        p, measure = next(adjusted), change.measure
        least = matters.get(measure.key, measure.matters)
        moved = change.after - change.before
        verdict = verdict_of(change.interval, moved, p, least, higher=measure.higher)
        judged.append(replace(change, verdict=verdict, adjusted_p=p))
    return judged


def _change(
    measure: Measure,
    pipeline: str,
    old: RatioOfSums,
    new: RatioOfSums,
    pairs: NDArray[np.intp],
    groups: NDArray[np.intp],
) -> Change | None:
    parts = [old.top, old.bottom], [new.top, new.bottom]
    finite = np.ones(len(pairs), np.bool_)
    for side, arrays in enumerate(parts):
        for values in arrays:
            finite &= np.isfinite(values[pairs[:, side]])
    valid_pairs = pairs[finite]
    before, after = (
        RatioOfSums(top[valid_pairs[:, side]], bottom[valid_pairs[:, side]])
        for side, (top, bottom) in enumerate(parts)
    )
    if not len(valid_pairs) or not np.isfinite(before.value() + after.value()):
        return None
    same = bool((before.top * after.bottom == after.top * before.bottom).all())
    drawn, of = np.unique(groups[valid_pairs[:, 1]], return_inverse=True)
    is_testable = len(drawn) >= FEWEST and not same
    interval = interval_of_change(before.by_group(of), after.by_group(of)) if is_testable else None
    verdict: Verdict = "the same" if same else "undecided"
    was, now = before.value(), after.value()
    return Change(measure, pipeline, len(valid_pairs), was, now, interval, verdict, len(drawn))


def verdict_of(
    interval: Interval, moved: float, p: float, matters: float, *, higher: bool
) -> Verdict:
    """Return what is said of a change.

    Parameters
    ----------
    interval, moved
        Of the change, and the change.
    p
        Corrected for the number of figures.
    matters
        The least difference that matters.
    higher
        Whether more is better.
    """
    if -matters < interval.low and interval.high < matters:
        return "too small to matter"
    if p > FALSE_DISCOVERIES or abs(moved) < matters:
        return "undecided"
    return "better" if (moved > 0) == higher else "worse"


def groups_of(table: FleetTable, by: str, tags: Path | None = None) -> list[str]:
    """Return the group of each row: a column of the tags, of the table, or its ``folder``.

    Parameters
    ----------
    table
        The recordings.
    by
        Name of the column.
    tags
        CSV with a column ``recording`` (file name) or ``location``, and one for each tag.

    Returns
    -------
    Of each row; empty where it has none, which may be so of a recording that failed.

    Raises
    ------
    RecordingError
        Where there is no such column, a recording has no cell in it, or one has two.
    """
    if tags is not None:
        cells = _tagged(table, by, tags)
    elif by == "folder":
        cells = [str(PurePosixPath(location).parent) for location in table.of("location")]
    elif by in table.columns:
        cells = [None if cell is None else str(cell) for cell in table.of(by)]
    else:
        raise RecordingError(
            f"{table.name}: expected a column {by} (or folder, or --tags), found none"
        )
    for cell, name, error in zip(cells, table.of("location"), table.of("error"), strict=True):
        if not cell and not error:
            raise RecordingError(f"{tags or table.name}: {name}: expected its {by}, found none")
    return [cell or "" for cell in cells]


def _tagged(table: FleetTable, by: str, tags: Path) -> list[str | None]:
    """Return the cell of each recording in a column of tags; None where it is not listed."""
    try:
        text = tags.read_text("utf-8-sig")
        lines = [[plain_cell(cell) for cell in line] for line in csv.reader(text.splitlines())]
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{tags}: expected CSV in UTF-8, found: {error}") from None
    names = lines[0] if lines else []
    key = next((name for name in ("location", "recording") if name in names), None)
    if key is None or by not in names:
        columns = ", ".join(names) or "none"
        raise RecordingError(f"{tags}: expected columns recording and {by}, found {columns}")
    key_column, tag = names.index(key), names.index(by)
    tag_of: dict[str, str] = {}
    for number, line in enumerate(lines[1:], 2):
        if len(line) <= max(key_column, tag):
            continue
        if tag_of.setdefault(line[key_column], line[tag]) != line[tag]:
            both = f"{tag_of[line[key_column]]} and {line[tag]}"
            conflict = f"expected one {by} of {line[key_column]}, found {both}"
            raise RecordingError(f"{tags}: line {number}: {conflict}")
    return [tag_of.get(name) for name in table.of(key)]


def _added(table: FleetTable, names: str) -> NDArray[np.float64]:
    columns = [table.numbers(name) for name in names.split("+")]
    return np.asarray(np.sum(columns, axis=0), np.float64)


def _keys(table: FleetTable, *, named: bool) -> list[Hashable]:
    """Return what tells the rows apart; copies of one recording are numbered."""
    seen: dict[Hashable, int] = {}
    keys: list[Hashable] = []
    columns = (table.of("recording"), table.of("sha256"), table.of("pipeline"))
    for recording, sha256, pipeline in zip(*columns, strict=True):
        key = (recording, sha256, pipeline if named else "")
        seen[key] = seen.get(key, 0) + 1
        keys.append((*key, seen[key]))
    return keys
