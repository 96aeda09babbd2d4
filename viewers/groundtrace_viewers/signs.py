"""Signs of a step: which of two sensors a wave reached first, against the region chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers.so_tdoa import distances, measured_signs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace.localizers.regions import Regions

#: Wrong pairs named one by one; the rest are in the matrix.
NAMED = 6
#: With more sensors than this the matrix would not fit beside the log.
MATRIX_SENSORS, FEW_SENSORS = 16, 10
MARKS = {1: "+", -1: "−", 0: "·"}
KEY = (
    "Sign of the time at i (column) less that at j (row): + the wave reached j first, − i first, "
    "✗ the region lit on the map says otherwise, · not known."
)


@dataclass(frozen=True, slots=True, eq=False)
class Signs:
    """The signs of one step.

    Attributes
    ----------
    hit
        Shape (k,): the regions that fit best.
    measured, expected
        Shape (n_pairs,): sign(t_i - t_j), 0 where there is none, and that of the first such region.
    compared
        Shape (n_pairs,): which pairs were measured and tell regions apart.
    distance
        Of the regions that fit best, (5.6).
    """

    hit: NDArray[np.intp]
    measured: NDArray[np.int8]
    expected: NDArray[np.int8]
    compared: NDArray[np.bool_]
    distance: float

    @property
    def wrong(self) -> NDArray[np.intp]:
        """Pairs whose measured sign is not the region's."""
        found: NDArray[np.intp] = np.flatnonzero(self.compared & (self.measured != self.expected))
        return found

    @property
    def residual(self) -> float:
        """Part of the compared signs that the region contradicts."""
        return self.distance / max(int(self.compared.sum()), 1)


def signs_of(regions: Regions, times_s: NDArray[np.float64]) -> Signs:
    """Return the signs of arrivals, shape (n,) [s], NaN where a sensor has none."""
    signs, compared = measured_signs(regions, times_s)
    apart = distances(regions, signs, compared)
    hit = np.flatnonzero(apart == apart.min())
    expected = regions.signs[hit[0]]
    return Signs(hit, signs.astype(np.int8), expected, compared, float(apart.min()))


def signs_page(signs: Signs, regions: Regions, names: Sequence[str], when: str) -> str:
    """Return the signs of a step as a page, markdown.

    Parameters
    ----------
    signs, regions
        Of the step, and of the room.
    names
        Of the sensors.
    when
        The step's time, for people.
    """
    wrong, count = signs.wrong, int(signs.compared.sum())
    tied = f", {len(signs.hit)} regions fit equally" if len(signs.hit) > 1 else ""
    lines = [
        f"**Step at {when}: {len(wrong)} of {count} signs wrong**, "
        f"residual {signs.residual:.2g}{tied}",
        "",
    ]
    if len(names) <= MATRIX_SENSORS:
        lines += ["```", *_matrix(signs, regions, names), "```", ""]
    if len(wrong):
        lines += ["| pair i–j | measured | region |", "|---|---|---|"]
        lines += [_row(signs, regions, names, pair) for pair in wrong[:NAMED]]
        more = len(wrong) - NAMED
        lines += ["", f"and {more} more" if more > 0 else "", ""]
    lines += [KEY]
    return "\n".join(lines)


def _row(signs: Signs, regions: Regions, names: Sequence[str], pair: int) -> str:
    i, j = names[regions.first[pair]], names[regions.second[pair]]
    measured, expected = (MARKS[int(s[pair])] for s in (signs.measured, signs.expected))
    return f"| {i}–{j} | {measured} ✗ | {expected} |"


def _matrix(signs: Signs, regions: Regions, names: Sequence[str]) -> list[str]:
    """Return the signs of all pairs i < j: i a column, j a row, the names on the diagonal."""
    width = 3 if len(names) <= FEW_SENSORS else 2
    marks = np.array([MARKS[int(s)] for s in signs.measured], dtype=object)
    marks[~signs.compared] = MARKS[0]
    marks[signs.wrong] = "✗"
    cell = np.full((len(names), len(names)), "", dtype=object)
    cell[regions.second, regions.first] = marks
    return [
        "".join(str(mark).ljust(width) for mark in cell[row, :row]) + name
        for row, name in enumerate(names)
    ]
