"""Figures of a whole fleet, and whether one fleet is better than another at them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..explain.bootstrap import Interval, Sums, bootstrap_recordings

if TYPE_CHECKING:
    from collections.abc import Hashable

    from numpy.typing import NDArray

    from .reading import FleetTable

Verdict = Literal["better", "worse", "undecided", "the same"]
#: With fewer recordings of both nothing is said: drawing so few again tells nothing.
FEWEST = 6


@dataclass(frozen=True, slots=True)
class Measure:
    """A figure over recordings: a ratio of sums.

    Attributes
    ----------
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

    name: str
    unit: str
    top: str
    bottom: str = ""
    scale: float = 1.0
    higher: bool = False
    absolute: bool = False

    def sums(self, table: FleetTable) -> Sums:
        """Return what each row adds, NaN where it has no such figure."""
        top = self.scale * _added(table, self.top)
        top = np.abs(top) if self.absolute else top
        bottom = _added(table, self.bottom) if self.bottom else np.ones(len(table))
        return Sums(top, bottom)


MEASURES = (
    Measure("F1, all steps together", "", "steps_matched", "steps_truth+steps_detected", 2, True),
    Measure("F1, mean of recordings", "", "steps_f1", higher=True),
    Measure("Recall", "", "steps_matched", "steps_truth", higher=True),
    Measure("Precision", "", "steps_matched", "steps_detected", higher=True),
    Measure("Count error", "%", "steps_count_error", "steps_count_truth", 100),
    Measure("Latency, median, without sign", "ms", "steps_latency_ms_median", absolute=True),
    Measure("Place, RMSE of fixes", "m", "positions_rmse_m"),
    Measure("Arrivals, median error", "ms", "picks_median_abs_ms"),
    Measure("Arrivals answered", "%", "picks_answered", "picks_truth", 100, True),
    Measure("Track, median at waypoints", "m", "track_waypoints_median_m"),
    Measure("Track, OSPA", "m", "track_ospa_m"),
    Measure("Heading, RMSE", "deg", "heading_rmse_deg"),
    Measure("Disturbance, F1", "", "disturbance_f1", higher=True),
    Measure("Passes found", "%", "passes_matched", "passes_truth", 100, True),
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
        Of the change, nine of ten draws; None where there are too few recordings to tell.
    verdict
        Better or worse where the whole interval is.
    """

    measure: Measure
    pipeline: str
    recordings: int
    before: float
    after: float
    interval: Interval | None
    verdict: Verdict


def pairs_of(old: FleetTable, new: FleetTable) -> list[tuple[int, int]]:
    """Return the numbers of the rows, old and new, of one recording and pipeline.

    Recordings are the same by name and bytes; where either table has one pipeline only, it is
    compared with the other's one, whatever their names.
    """
    one = len(set(old.pipelines())) == 1 == len(set(new.pipelines()))
    known = {key: row for row, key in enumerate(_keys(old, named=not one))}
    keys = enumerate(_keys(new, named=not one))
    return [(known[key], row) for row, key in keys if key in known]


def changes(old: FleetTable, new: FleetTable) -> list[Change]:
    """Return every figure that both tables have, pipeline by pipeline."""
    pairs = np.array(pairs_of(old, new), np.intp).reshape(-1, 2)
    found = []
    for pipeline in new.pipelines():
        mine = pairs[new.rows_of(pipeline)[pairs[:, 1]]]
        for measure in MEASURES:
            change = _change(measure, pipeline, measure.sums(old), measure.sums(new), mine)
            if change is not None:
                found.append(change)
    return found


def _change(
    measure: Measure, pipeline: str, old: Sums, new: Sums, pairs: NDArray[np.intp]
) -> Change | None:
    parts = [old.top, old.bottom], [new.top, new.bottom]
    finite = np.ones(len(pairs), np.bool_)
    for side, arrays in enumerate(parts):
        for values in arrays:
            finite &= np.isfinite(values[pairs[:, side]])
    kept = pairs[finite]
    before, after = (
        Sums(top[kept[:, side]], bottom[kept[:, side]]) for side, (top, bottom) in enumerate(parts)
    )
    if not len(kept) or not np.isfinite(before.value() + after.value()):
        return None
    same = bool((before.top * after.bottom == after.top * before.bottom).all())
    interval = bootstrap_recordings(before, after) if len(kept) >= FEWEST and not same else None
    verdict = "the same" if same else verdict_of(interval, higher=measure.higher)
    return Change(measure, pipeline, len(kept), before.value(), after.value(), interval, verdict)


def verdict_of(interval: Interval | None, *, higher: bool) -> Verdict:
    """Return what an interval of changes says."""
    if interval is None or interval.low <= 0 <= interval.high:
        return "undecided"
    return "better" if (interval.low > 0) == higher else "worse"


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
