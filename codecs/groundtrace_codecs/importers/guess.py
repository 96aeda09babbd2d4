"""A guess at the map of a text table, for a person to check: what each column may be, and why.

Words of the header count most, then how large the numbers are: gravity is 9.8 m/s2 or 1 g, the
earth's field 20 to 70 uT, the air's pressure near 1000 hPa.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import FormatError
from .guess_columns import Column, name_columns
from .guess_counter import GuessedCounter, guess_counter
from .guess_table import RawTable, read_raw
from .guess_time import PLACEHOLDER_HZ, GuessedTime, guess_time
from .guess_toml import as_toml

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


class Remark(NamedTuple):
    """One thing guessed: what it is about, what was taken, how sure, and why."""

    about: str
    taken: str
    sureness: str
    why: str


class Guess(NamedTuple):
    """A guessed map: its TOML and what was guessed."""

    toml: str
    remarks: tuple[Remark, ...]


def guess_map(path: Path) -> Guess:
    """Return the likely map of a CSV or TSV file.

    Parameters
    ----------
    path
        The table.

    Raises
    ------
    FormatError
        Where it holds no rows of numbers.
    """
    table = read_raw(path)
    numbers = {i: column for i in range(table.width) if (column := _numbers(table, i)) is not None}
    time = guess_time(table, numbers)
    rest = {i: c for i, c in numbers.items() if time is None or i != time.column}
    counter = guess_counter(table, rest)
    if counter is not None:
        del rest[counter.column]
    groups = name_columns(table.header, rest)
    if not groups:
        raise FormatError(f"{path.name}: expected columns of numbers besides the time, found none")
    used = {c.place for group in groups.values() for c in group}
    left = [table.label(i) for i in range(table.width) if i not in used]
    if time is not None:
        left.remove(table.label(time.column))
    if counter is not None:
        left.remove(table.label(counter.column))
    remarks = [_layout(table), _timing(table, time)]
    if counter is not None:
        remarks.append(_counted(table, counter))
    remarks += [_group(table, topic, columns) for topic, columns in groups.items()]
    if left:
        remarks.append(Remark("left out", ", ".join(left), "", "no stream is known for them"))
    return Guess(as_toml(table, time, counter, groups, remarks), tuple(remarks))


def _numbers(table: RawTable, index: int) -> NDArray[np.float64] | None:
    """Return a column as numbers, None where more than one cell in ten is none."""
    found = np.full(len(table.rows), np.nan)
    for i, row in enumerate(table.rows):
        cell = row[index].strip()
        try:
            found[i] = float(cell.replace(",", ".") if table.decimal == "," else cell)
        except ValueError:
            continue
    return found if np.isfinite(found).mean() > 0.9 else None


def _layout(table: RawTable) -> Remark:
    names = {",": "comma", ";": "semicolon", "\t": "tab", " ": "space", "|": "bar"}
    header = "a header" if table.header else "no header"
    taken = f"{names[table.delimiter]} between cells, decimal {table.decimal!r}, {header}"
    return Remark("table", taken, "sure" if table.header else "likely", f"{table.width} columns")


def _timing(table: RawTable, time: GuessedTime | None) -> Remark:
    if time is None:
        taken = f"none; rate_hz = {PLACEHOLDER_HZ:g} stands in"
        return Remark("time", taken, "unsure", "no column goes on and on: write the true rate")
    taken = f"{table.label(time.column)} in {time.unit}, {time.rate_hz:.4g} Hz"
    if time.unit == "iso" and not time.zoned:
        taken += '; no zone is written: UTC, or add zone = "Europe/Paris"'
    return Remark("time", taken, time.sureness, time.why)


def _counted(table: RawTable, counter: GuessedCounter) -> Remark:
    wraps = "" if counter.modulus is None else f", modulus {counter.modulus}"
    taken = f"{table.label(counter.column)}{wraps}"
    return Remark("counter of samples", taken, counter.sureness, counter.why)


def _group(table: RawTable, topic: str, columns: tuple[Column, ...]) -> Remark:
    kinds = dict.fromkeys(f"{c.quantity} in {c.unit}" for c in columns)
    labels = ", ".join(table.label(c.place) for c in columns)
    worst = max((c.sureness for c in columns), key=["sure", "likely", "unsure"].index)
    why = "; ".join(dict.fromkeys(c.why for c in columns))
    return Remark(topic, f"{' and '.join(kinds)}: {labels}", worst, why)
