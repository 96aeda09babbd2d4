"""Which column of a table holds the times, and in what unit."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import SchemaError
from ..signals import NS_PER_S
from .mapped import TIME_UNITS_NS
from .moments import moments

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from .api import TimeUnit
    from .guess_table import RawTable

_WORD = re.compile(
    r"(?i)(^|[^a-z])(t|ts|time|times|zeit|epoch|timestamp|\w*time\w*|sec\w*|elapsed)"
)
_COUNTER = re.compile(r"(?i)(^|[^a-z])(index|idx|sample|samples|packet\w*|count\w*|seq|no|nr|row)")
#: Words of a header to the unit of a time.
_UNIT_WORDS: tuple[tuple[TimeUnit, str], ...] = (
    ("ns", r"(?i)(^|[^a-z])(ns|nsec|nano\w*)($|[^a-z])"),
    ("us", r"(?i)(^|[^a-z])([uµμ]s|usec|micro\w*)($|[^a-z])"),
    ("ms", r"(?i)(^|[^a-z])(ms|msec|milli\w*)($|[^a-z])"),
    ("s", r"(?i)(^|[^a-z])(s|sec|secs|seconds?|seconds_elapsed)($|[^a-z])"),
)
#: Rate written where a table has no times, for the user to correct [Hz].
PLACEHOLDER_HZ = 100.0
#: No time is a larger number, whatever its unit.
_MAX = 1e19
#: Unix times of 2001 to 2100 by their unit.
_EPOCH_S = (1e9, 4.1e9)
#: Below this a number that looks like a unix time counts something finer since a start [Hz].
_SLOWEST_HZ = 0.01
#: Rates of sensors worn, carried or stuck into the ground [Hz].
_RATES_HZ = (1.01, 2000.0)


class GuessedTime(NamedTuple):
    """A time column: its index, unit, the rate it gives, how sure, why, and if it names a zone."""

    column: int
    unit: TimeUnit
    rate_hz: float
    sureness: str
    why: str
    zoned: bool = True


def guess_time(table: RawTable, numbers: Mapping[int, NDArray[np.float64]]) -> GuessedTime | None:
    """Return the column that is most likely the time, None where none goes on and on."""
    found = [_iso(table, i) for i in range(table.width) if i not in numbers]
    found += [_numeric(table, i, column) for i, column in numbers.items()]
    candidates = [g for g in found if g is not None]
    order = ["sure", "likely", "unsure"]
    return min(candidates, key=lambda g: (order.index(g.sureness), g.column), default=None)


def _iso(table: RawTable, index: int) -> GuessedTime | None:
    cells = [row[index].strip() for row in table.rows]
    if not all(c[:4].isdigit() and len(c) > 9 for c in cells):
        return None
    try:
        times_ns, _ = moments(cells, table.label(index))
    except SchemaError:
        return None
    step = float(np.median(np.diff(times_ns))) / NS_PER_S
    if step <= 0:
        return None
    zoned = re.search(r"(Z|[+-]\d\d:?\d\d|[A-Za-z]+\]?)$", cells[0]) is not None
    return GuessedTime(index, "iso", 1 / step, "sure", "every cell is an ISO 8601 time", zoned)


def _numeric(table: RawTable, index: int, column: NDArray[np.float64]) -> GuessedTime | None:
    if not np.isfinite(column).all() or np.abs(column).max() > _MAX:
        return None
    steps = np.diff(column)
    name = table.header[index] if table.header else ""
    step = float(np.median(steps))
    forward = float((steps >= 0).mean())
    named = _WORD.search(name) is not None
    if step <= 0 or forward < (0.95 if named else 0.99) or column[-1] <= column[0]:
        return None
    if _COUNTER.search(name) and not named:
        return None
    unit, certain, why = _unit(name, float(column[0]), step)
    if not named and not certain and (np.abs(steps / step - 1) < 0.5).mean() < 0.8:
        return None  # something that grows, but not as time does
    rate_hz = 1e9 / (step * TIME_UNITS_NS[unit])
    sureness = "sure" if named and certain else "likely" if named or certain else "unsure"
    return GuessedTime(index, unit, rate_hz, sureness, why)


def _unit(name: str, first: float, step: float) -> tuple[TimeUnit, bool, str]:
    """Return the unit of times, whether that is certain, and why."""
    for unit, factor in TIME_UNITS_NS.items():
        dated = _EPOCH_S[0] <= first * factor / 1e9 <= _EPOCH_S[1]
        if dated and 1e9 / (step * factor) > _SLOWEST_HZ:
            return _TYPED[unit], True, f"the numbers are unix times in {unit}"
    for unit, words in _UNIT_WORDS:
        if re.search(words, name):
            return unit, True, f"the header says {unit}"
    for unit, factor in TIME_UNITS_NS.items():
        if _RATES_HZ[0] <= 1e9 / (step * factor) <= _RATES_HZ[1]:
            return _TYPED[unit], False, f"a step of {step:g} {unit} gives the rate of a sensor"
    return "s", False, "no unit gives the rate of a sensor"


_TYPED: dict[str, TimeUnit] = {"s": "s", "ms": "ms", "us": "us", "ns": "ns"}
