"""Which column of a table counts packets or samples, and where it wraps around."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from .guess_table import RawTable

_WORD = re.compile(r"(?i)(packet|pkt|count|seq|sample|frame|(^|[^a-z])(nr|no|n|id|index|idx)$)")
#: What counters of 8, 12, 16 and 32 bits wrap around at.
_MODULI = (256, 4096, 65536, 1 << 32)
#: Of the steps of a counter, this part is one at least.
_STEADY = 0.8


class GuessedCounter(NamedTuple):
    """A counter: its column, what it wraps around at, how sure, and why."""

    column: int
    modulus: int | None
    sureness: str
    why: str


def guess_counter(
    table: RawTable, numbers: Mapping[int, NDArray[np.float64]]
) -> GuessedCounter | None:
    """Return the column that is most likely the device's count of samples.

    A count of rows from 0 or 1 without a hole tells nothing and is none.

    Parameters
    ----------
    table
        The table.
    numbers
        The columns of numbers besides the time, by index.
    """
    found = [_counter(table, i, column) for i, column in numbers.items()]
    candidates = [g for g in found if g is not None]
    order = ["sure", "likely"]
    return min(candidates, key=lambda g: (order.index(g.sureness), g.column), default=None)


def _counter(table: RawTable, index: int, column: NDArray[np.float64]) -> GuessedCounter | None:
    if not np.isfinite(column).all() or (np.rint(column) != column).any() or column.min() < 0:
        return None
    steps = np.diff(column)
    if not len(steps) or (steps == 1).mean() < _STEADY:
        return None
    name = table.header[index] if table.header else ""
    named = _WORD.search(name) is not None
    modulus = _modulus(column, steps)
    if modulus is not None:
        sureness = "sure" if named else "likely"
        return GuessedCounter(index, modulus, sureness, f"it wraps around at {modulus}")
    holes = int((steps > 1).sum())
    if named and (holes or column[0] > 1):
        what = f"{holes} holes" if holes else f"it begins at {column[0]:.0f}"
        return GuessedCounter(index, None, "likely", f"{what}, and no wrap-around is in this file")
    return None


def _modulus(column: NDArray[np.float64], steps: NDArray[np.float64]) -> int | None:
    """Return what a counter wraps around at, None where it does not."""
    back = steps[steps < -32]
    for modulus in _MODULI:
        if len(back) and column.max() < modulus and (back <= -0.75 * modulus).all():
            return modulus
    return None
