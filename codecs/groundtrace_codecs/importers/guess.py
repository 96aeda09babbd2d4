"""Guesses the map of a text table for a person to check: the meaning of each column, and why.

Words of the header count most, then the size of the numbers: gravity is 9.8 m/s2 or 1 g, the
earth's field 20 to 70 uT, air pressure near 1000 hPa.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ..errors import FormatError, SchemaError
from ..signals import NS_PER_S
from ..toml import toml_value
from ..truth import plain_cell
from .map import TIME_UNITS_NS
from .time import timestamps

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import TimeUnit

    Numbers = Mapping[int, NDArray[np.float64]]


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
    used = {c.column for group in groups.values() for c in group}
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
    values = np.full(len(table.rows), np.nan)
    for i, row in enumerate(table.rows):
        cell = row[index].strip()
        try:
            values[i] = float(cell.replace(",", ".") if table.decimal == "," else cell)
        except ValueError:
            continue
    return values if np.isfinite(values).mean() > 0.9 else None


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
    labels = ", ".join(table.label(c.column) for c in columns)
    worst = max((c.sureness for c in columns), key=["sure", "likely", "unsure"].index)
    why = "; ".join(dict.fromkeys(c.why for c in columns))
    return Remark(topic, f"{' and '.join(kinds)}: {labels}", worst, why)


Axis = Literal["x", "y", "z", ""]


class Column(NamedTuple):
    """One column: where, what, in which unit, along which axis, how sure, and why."""

    column: int
    quantity: str
    unit: str
    axis: Axis
    sureness: str
    why: str


class Named(NamedTuple):
    """What the header alone says: where, what, which axis, the words left, and the unit's text."""

    column: int
    quantity: str
    axis: Axis
    rest: str
    cell: str


#: Words of each quantity, and the short names of its axes.
_WORDS: tuple[tuple[str, str], ...] = (
    ("acceleration_magnitude", r"(?:acc[a-z]*[ _])?(?:magnitude|norm)|vector[ _]magnitude"),
    ("acceleration", r"lin\w*[ _]?acc\w*|acc[a-z]*|a(?=_?[xyz]$)|beschl\w*"),
    ("angular_velocity", r"gyr[a-z]*|ang\w*[ _]?vel\w*|rot\w*|omega|[gw](?=_?[xyz]$)"),
    ("magnetic_field", r"mag[a-z]*(?:[ _]?field)?|[mb](?=_?[xyz]$)"),
    ("pressure", r"press\w*|baro\w*|druck"),
    ("temperature", r"temp\w*"),
    ("latitude", r"lat\w*"),
    ("longitude", r"lon\w*|lng"),
    ("altitude", r"alt\w*|height"),
)
VECTORS = frozenset({"acceleration", "angular_velocity", "magnetic_field"})
_FIX = ("latitude", "longitude", "altitude")
_TOPICS = {
    "acceleration": "/acc",
    "acceleration_magnitude": "/acc_magnitude",
    "angular_velocity": "/gyro",
    "magnetic_field": "/mag",
    "pressure": "/baro",
    "temperature": "/temperature",
    "latitude": "/fix",
}
_BARE_UNIT = re.compile(r"[(\[]([^()\[\]]*)[)\]]|_(g|mg|dps|ut|hpa|pa|kpa|mps2|ms2|rads)$", re.I)
#: Spellings of units in headers, in lower case and without blanks.
_UNITS: dict[str, dict[str, str]] = {
    "acceleration": {
        **dict.fromkeys(("m/s2", "m/s^2", "m/s²", "mps2", "ms2", "ms-2", "m.s-2"), "m/s2"),
        "g": "g",
        "mg": "mg",
    },
    "angular_velocity": {
        **dict.fromkeys(("rad/s", "rads", "rad/sec"), "rad/s"),
        **dict.fromkeys(("deg/s", "dps", "°/s", "deg/sec"), "deg/s"),
    },
    "magnetic_field": {
        **dict.fromkeys(("ut", "µt", "μt"), "uT"),
        "nt": "nT",
        "mt": "mT",
        "t": "T",
        "gauss": "gauss",
        "mgauss": "mgauss",
        **dict.fromkeys(("a.u.", "a.u", "au"), "a.u."),
    },
    "pressure": {"hpa": "hPa", "pa": "Pa", "kpa": "kPa", "mbar": "mbar"},
}
_UNITS["acceleration_magnitude"] = _UNITS["acceleration"]
_FIXED = {"temperature": "degC", "latitude": "deg", "longitude": "deg", "altitude": "m"}
#: Unit to the range the median of the length of a vector, or of a value, has in it.
_RANGES: dict[str, tuple[tuple[str, float, float], ...]] = {
    "acceleration": (("m/s2", 7.0, 13.0), ("g", 0.7, 1.4), ("mg", 700.0, 1400.0)),
    "magnetic_field": (
        ("uT", 15.0, 90.0),
        ("mgauss", 150.0, 900.0),
        ("gauss", 0.15, 0.9),
        ("T", 15e-6, 90e-6),
        ("nT", 15e3, 90e3),
    ),
    "pressure": (("hPa", 300.0, 1100.0), ("Pa", 3e4, 1.1e5), ("kPa", 30.0, 110.0)),
}
_RANGES["acceleration_magnitude"] = _RANGES["acceleration"]
#: A column of no more different values is a flag.
_FLAGS = 8
#: Above this no body turns, so that the unit is degrees [rad/s]; half of it leaves a doubt.
_FAST_RADPS = 40.0


def name_columns(header: Sequence[str], numbers: Numbers) -> dict[str, tuple[Column, ...]]:
    """Return the streams of a table by topic.

    Parameters
    ----------
    header
        Names of all columns; empty without a header.
    numbers
        The columns of numbers besides the time, by index.
    """
    named = [n for i in numbers if header and (n := _named(i, header[i])) is not None]
    groups: dict[tuple[str, str], list[Named]] = {}
    for each in named:
        quantity = "latitude" if each.quantity in _FIX else each.quantity
        groups.setdefault((quantity, each.rest), []).append(each)
    complete = {k: g for k, g in groups.items() if _is_complete(k[0], g)}
    columns = {k: _with_unit(k[0], g, numbers) for k, g in complete.items()}
    if not columns:
        return _without_words(numbers)
    several = len({rest for _, rest in columns}) > 1
    return _topics(columns, several)


def _named(index: int, cell: str) -> Named | None:
    """Return what a cell of the header says, None where it says nothing known."""
    words = _BARE_UNIT.sub("", cell).strip()
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", words).lower()
    for quantity, pattern in _WORDS:
        match = re.search(rf"(?:^|[^a-z])({pattern})", words)
        if match is None:
            continue
        rest = words[: match.start(1)] + words[match.end(1) :]
        axis = _axis(quantity, rest, match[1])
        if quantity in VECTORS and axis is None:
            continue
        without_axis = re.sub(r"(^|[^a-z])[xyz]($|[^a-z])", " ", f" {rest} ")
        slug = "_".join(re.findall(r"[a-z0-9]+", without_axis))
        return Named(index, quantity, axis or "", slug, cell)
    return None


def _axis(quantity: str, rest: str, word: str) -> Axis | None:
    """Return the axis of a column, by a letter that stands alone or ends the word."""
    if quantity not in VECTORS:
        return ""
    match = re.search(r"(?:^|[^a-z])([xyz])(?:$|[^a-z])", rest) or re.search(r"([xyz])$", word)
    axes: dict[str, Axis] = {"x": "x", "y": "y", "z": "z"}
    return axes[match[1]] if match else None


def _is_complete(quantity: str, group: Sequence[Named]) -> bool:
    have = sorted(n.axis if quantity in VECTORS else n.quantity for n in group)
    if quantity in VECTORS:
        return have == ["x", "y", "z"]
    return have == sorted(_FIX) if quantity == "latitude" else len(have) == 1


def _with_unit(quantity: str, group: Sequence[Named], numbers: Numbers) -> tuple[Column, ...]:
    if quantity in _FIXED:
        return tuple(
            Column(n.column, n.quantity, _FIXED[n.quantity], "", "likely", "the header's words")
            for n in group
        )
    units = {_header_unit(quantity, n.cell) for n in group}
    if len(units) == 1 and (unit := units.pop()) is not None:
        sureness, why = "sure", "the header says quantity and unit"
    else:
        unit, sureness, why = _by_size(quantity, np.stack([numbers[n.column] for n in group]))
    return tuple(Column(n.column, quantity, unit, n.axis, sureness, why) for n in group)


def _header_unit(quantity: str, cell: str) -> str | None:
    """Return the unit a header names."""
    match = _BARE_UNIT.search(cell)
    text = "" if match is None else (match[1] or match[2] or "")
    return _UNITS[quantity].get(text.lower().replace(" ", ""))


def _by_size(quantity: str, values: NDArray[np.float64]) -> tuple[str, str, str]:
    """Return unit, sureness and reason from the numbers, shape (n_axes, n)."""
    with np.errstate(over="ignore"):
        lengths = np.sqrt(np.nansum(values**2, axis=0))
    if quantity == "angular_velocity":
        fast = float(np.percentile(lengths, 99))
        if fast > _FAST_RADPS:
            return "deg/s", "likely", f"{fast:.3g} rad/s would be faster than a body turns"
        doubt = "likely" if fast < _FAST_RADPS / 2 else "unsure"
        return "rad/s", doubt, f"99 % are below {fast:.3g}"
    median = float(np.median(lengths))
    for unit, low, high in _RANGES[quantity]:
        if low <= median <= high:
            return unit, "likely", f"the median of {median:.4g} is that of {quantity} in {unit}"
    return "count", "unsure", f"a median of {median:.4g} fits no unit"


def _topics(
    groups: Mapping[tuple[str, str], tuple[Column, ...]], several: bool
) -> dict[str, tuple[Column, ...]]:
    """Return the groups by topic; acceleration and rotation of one sensor are one IMU."""
    topics: dict[str, tuple[Column, ...]] = {}
    rests = Counter(r for q, r in groups if q in ("acceleration", "angular_velocity"))
    for (quantity, rest), columns in groups.items():
        imu = rests[rest] == 2 and quantity in ("acceleration", "angular_velocity")
        topic = "/imu" if imu else _TOPICS[quantity]
        topic += f"/{rest}" if several and rest else ""
        topics[topic] = (*topics.get(topic, ()), *columns)
    return topics


def _without_words(numbers: Numbers) -> dict[str, tuple[Column, ...]]:
    """Return what the numbers alone show: three columns as long as gravity, else counts."""
    # a flag beside the axes, such as a phone's accuracy of 3, adds little to their length
    order = [i for i, column in numbers.items() if len(np.unique(column)) > _FLAGS]
    for start in range(len(order) - 2):
        three = order[start : start + 3]
        if three[2] - three[0] != 2:
            continue
        unit, _, why = _by_size("acceleration", np.stack([numbers[i] for i in three]))
        if unit != "count":
            axes: tuple[Axis, ...] = ("x", "y", "z")
            return {
                "/acc": tuple(
                    Column(i, "acceleration", unit, a, "unsure", f"{why}, and no words say so")
                    for i, a in zip(three, axes, strict=True)
                )
            }
    why = "no words are known and no numbers are as long as gravity"
    columns = tuple(Column(i, "seismic", "count", "", "unsure", why) for i in numbers)
    return {"/seismic": columns} if columns else {}


_COUNTER_WORD = re.compile(
    r"(?i)(packet|pkt|count|seq|sample|frame|(^|[^a-z])(nr|no|n|id|index|idx)$)"
)
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
    guesses = [_counter(table, i, column) for i, column in numbers.items()]
    candidates = [g for g in guesses if g is not None]
    order = ["sure", "likely"]
    return min(candidates, key=lambda g: (order.index(g.sureness), g.column), default=None)


def _counter(table: RawTable, index: int, column: NDArray[np.float64]) -> GuessedCounter | None:
    if not np.isfinite(column).all() or (np.rint(column) != column).any() or column.min() < 0:
        return None
    steps = np.diff(column)
    if not len(steps) or (steps == 1).mean() < _STEADY:
        return None
    name = table.header[index] if table.header else ""
    named = _COUNTER_WORD.search(name) is not None
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


#: How much of a table is looked at [bytes].
_HEAD = 1 << 20
_DELIMITERS = (",", ";", "\t", "|", " ")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_MIN_ROWS = 3


@dataclass(frozen=True, slots=True)
class RawTable:
    """The start of a table.

    Attributes
    ----------
    delimiter, decimal, encoding
        As a map names them.
    header
        Names of the columns, stripped; empty where there is none.
    skip_rows
        Rows before the first of numbers.
    rows
        Cells of the rows of numbers, all of one width.
    """

    delimiter: str
    decimal: Literal[".", ","]
    encoding: str
    header: tuple[str, ...]
    skip_rows: int
    rows: tuple[list[str], ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.rows[0])

    def label(self, index: int) -> str:
        """Return what to call a column."""
        name = " ".join(self.header[index].splitlines()) if self.header else ""
        return name or f"column {index}"

    def key(self, index: int) -> str | int:
        """Return what a map calls a column: its name where that is one of a kind."""
        name = self.header[index] if self.header else ""
        return name if name and self.header.count(name) == 1 else index


def read_raw(path: Path) -> RawTable:
    """Read the start of a table.

    Raises
    ------
    FormatError
        Where no separator gives rows of numbers.
    """
    with path.open("rb") as file:
        data = file.read(_HEAD + 1)
    text, encoding = _text(data)
    if len(data) > _HEAD:  # the last line is not whole
        text = text.rpartition("\n")[0]
    tables = [t for d in _DELIMITERS if (t := _split(text, d, encoding)) is not None]
    if not tables:
        raise FormatError(f"{path.name}: expected rows of numbers, found none")
    return max(tables, key=lambda t: (len(t.rows) * t.width, -_DELIMITERS.index(t.delimiter)))


def _text(data: bytes) -> tuple[str, str]:
    try:
        # the read may end inside a character
        return data.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError as error:
        if error.start >= len(data) - 3 and len(data) > _HEAD:
            return data[: error.start].decode("utf-8-sig"), "utf-8-sig"
    return data.decode("latin-1"), "latin-1"


def _split(text: str, delimiter: str, encoding: str) -> RawTable | None:
    """Return the table one separator gives, None where it gives none of two columns or more."""
    try:
        cells = [r for r in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if r]
    except csv.Error:
        return None
    numeric = [_is_row(row) for row in cells]
    widths = [len(row) for row, good in zip(cells, numeric, strict=True) if good]
    if len(widths) < _MIN_ROWS:
        return None
    width = max(set(widths), key=widths.count)
    start = next(i for i, row in enumerate(cells) if numeric[i] and len(row) == width)
    rows = [row for row in cells[start:] if len(row) == width]
    if len(rows) < _MIN_ROWS:
        return None
    header = tuple(plain_cell(c.strip()) for c in cells[start - 1]) if start else ()
    if len(header) == width - 1 and not any(row[-1].strip() for row in rows):
        header = (*header, "")  # only the rows end in a separator
    decimal: Literal[".", ","] = "." if delimiter == "," or not _commas(rows) else ","
    named = len(header) == width and any(header)
    return RawTable(delimiter, decimal, encoding, header if named else (), start, tuple(rows))


def _is_row(cells: list[str]) -> bool:
    """Return whether at least half of the filled cells are numbers."""
    filled = [c.strip() for c in cells if c.strip()]
    numbers = sum(_NUMBER.fullmatch(c) is not None for c in filled)
    return numbers >= 1 and 2 * numbers >= len(filled)


def _commas(rows: list[list[str]]) -> bool:
    cells = [c for row in rows[:100] for c in row if _NUMBER.fullmatch(c.strip())]
    return any("," in c for c in cells) and not any("." in c for c in cells)


_TIME_WORD = re.compile(
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
    guesses = [_iso(table, i) for i in range(table.width) if i not in numbers]
    guesses += [_numeric(table, i, column) for i, column in numbers.items()]
    candidates = [g for g in guesses if g is not None]
    order = ["sure", "likely", "unsure"]
    return min(candidates, key=lambda g: (order.index(g.sureness), g.column), default=None)


def _iso(table: RawTable, index: int) -> GuessedTime | None:
    cells = [row[index].strip() for row in table.rows]
    if not all(c[:4].isdigit() and len(c) > 9 for c in cells):
        return None
    try:
        times_ns, _ = timestamps(cells, table.label(index))
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
    named = _TIME_WORD.search(name) is not None
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


def as_toml(
    table: RawTable,
    time: GuessedTime | None,
    counter: GuessedCounter | None,
    groups: Mapping[str, Sequence[Column]],
    remarks: Sequence[Remark],
) -> str:
    """Return the text of a map."""
    lines = ["# Guessed by groundtrace import --guess: check it, then import with --map."]
    lines += [f"# {_plain(remark_line(r))}" for r in remarks]
    lines += [
        'format = "csv"',
        f"delimiter = {toml_value(table.delimiter)}",
        f"decimal = {toml_value(table.decimal)}",
        'comment = ""',
        f"skip_rows = {table.skip_rows}",
        f"encoding = {toml_value(table.encoding)}",
    ]
    if time is None:
        lines.append(f"rate_hz = {PLACEHOLDER_HZ}")
    else:
        key = toml_value(table.key(time.column))
        lines.append(f"time = {{column = {key}, unit = {toml_value(time.unit)}}}")
    if counter is not None:
        wraps = "" if counter.modulus is None else f", modulus = {counter.modulus}"
        lines.append(f"counter = {{column = {toml_value(table.key(counter.column))}{wraps}}}")
    for topic, columns in groups.items():
        lines += ["", "[[stream]]", f"topic = {toml_value(topic)}", "columns = ["]
        lines += [f"  {_column(table, c)}," for c in columns]
        lines.append("]")
    return "\n".join(lines) + "\n"


def remark_line(remark: Remark) -> str:
    """Return one guess as a line."""
    sure = f" ({remark.sureness}: {remark.why})" if remark.sureness else f" ({remark.why})"
    return f"{remark.about}: {remark.taken}{sure}"


def _column(table: RawTable, column: Column) -> str:
    key, quantity, unit = table.key(column.column), column.quantity, column.unit
    axis = f", axis = {toml_value(column.axis)}" if column.axis else ""
    return (
        f"{{column = {toml_value(key)}, quantity = {toml_value(quantity)}, "
        f"unit = {toml_value(unit)}{axis}}}"
    )


def _plain(text: str) -> str:
    """Return a comment without what TOML forbids there."""
    return "".join(c if c.isprintable() else " " for c in text)
