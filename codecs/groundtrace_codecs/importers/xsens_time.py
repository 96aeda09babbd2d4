"""When the packets of Xsens devices were sampled: counters that wrap, and columns of UTC."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError
from ..signals import NS_PER_S
from .counters import unwrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .delimited import TextTable

#: Where the packet counter begins again, and ``SampleTimeFine`` (Xsens Low Level Communication
#: Protocol, PacketCounter and SampleTimeFine).
PACKETS, TICKS = 1 << 16, 1 << 32
#: Rates of ``SampleTimeFine`` [Hz]: of MTi and MTw, and of the DOT.
TICKS_HZ = (10_000, 1_000_000)
_COUNTERS = ("PacketCounter", "Counter")
_FINE = "SampleTimeFine"


@dataclass(frozen=True, slots=True, eq=False)
class PacketTimes:
    """When the rows of one file were sampled.

    Attributes
    ----------
    times_ns
        Shape (n,), int64.
    columns
        Names of the columns that say so.
    warnings
        One line each.
    """

    times_ns: NDArray[np.int64]
    columns: tuple[str, ...]
    warnings: tuple[str, ...]


def packet_times(
    files: Sequence[tuple[TextTable, float | None]],
) -> tuple[list[PacketTimes], tuple[str, ...]]:
    """Return the times of the rows of the files of one recording, and what was assumed.

    A row is at ``SampleTimeFine`` where every row has it, else at its counter over the rate the
    file tells. Where rows tell UTC the times are brought to it. Files without UTC are of one
    station, which counts for all its sensors: they are put together by their counters.

    Raises
    ------
    FormatError
        Where a file has neither ``SampleTimeFine`` nor a rate.
    """
    origin: int | None = None
    found, loose = [], 0
    for table, rate_hz in files:
        counter = _counter(table)
        if counter is not None and origin is None:
            origin = int(counter[0])
        times = _elapsed(table, counter, rate_hz, origin or 0)
        utc = _utc(table)
        if utc is not None:
            row, utc_ns = utc
            times = times - times[row] + utc_ns
        loose += utc is None
        found.append(PacketTimes(times, _time_columns(table), _losses(counter)))
    assumed = []
    if loose:
        assumed.append("the files do not tell the date: the clock is not that of the calendar")
    if loose > 1:
        assumed.append(f"{loose} files are put together by their packet counters")
    return found, tuple(assumed)


def _counter(table: TextTable) -> NDArray[np.int64] | None:
    """Return the packet counter, unwrapped, or None."""
    name = next((n for n in _COUNTERS if n in table.header), None)
    if name is None:
        return None
    values = table.numbers(name)
    if not _counts(values):
        return None
    return unwrapped(values.astype(np.int64), PACKETS)


def _counts(values: NDArray[np.float64]) -> bool:
    """Return whether all values are there and such as a counter of 32 bits can have."""
    return bool(((values >= 0) & (values < 2.0**32)).all())


def _elapsed(
    table: TextTable, counter: NDArray[np.int64] | None, rate_hz: float | None, origin: int
) -> NDArray[np.int64]:
    """Return the times of the rows on the device's own clock [ns]."""
    fine = table.numbers(_FINE) if _FINE in table.header else np.array([np.nan])
    if _counts(fine):
        ticks = unwrapped(fine.astype(np.int64), TICKS)
        return ticks * (NS_PER_S // _ticks_hz(ticks, rate_hz))
    if not rate_hz:
        raise FormatError(
            f"{table.name}: expected // Update Rate or {_FINE} in every row, found neither"
        )
    if counter is None:
        counter = np.arange(len(table.rows), dtype=np.int64)
        origin = 0
    first = (int(counter[0]) - origin + PACKETS // 2) % PACKETS - PACKETS // 2
    passed: NDArray[np.float64] = (counter - counter[0] + first) * (NS_PER_S / rate_hz)
    return np.rint(passed).astype(np.int64)


def _ticks_hz(ticks: NDArray[np.int64], rate_hz: float | None) -> int:
    """Return how fast the ticks are [Hz], by the rate of the samples where it is known."""
    steps = np.diff(ticks)
    if rate_hz is None or not (steps > 0).any():
        return TICKS_HZ[0]
    told = float(np.median(steps[steps > 0])) * rate_hz
    return min(TICKS_HZ, key=lambda hz: abs(np.log(told / hz)))


def _time_columns(table: TextTable) -> tuple[str, ...]:
    """Return the names of the columns that are about time."""
    parts = ("Year", "Month", "Day", "Hour", "Minute", "Second", "Nano", "Valid")
    known = {*_COUNTERS, _FINE, *parts, *(f"UTC_{part}" for part in parts)}
    return tuple(name for name in table.header if name in known)


def _utc(table: TextTable) -> tuple[int, int] | None:
    """Return the first row that tells UTC, and what it tells [ns]; None without one."""
    prefix = "UTC_" if "UTC_Year" in table.header else ""
    names = [f"{prefix}{part}" for part in ("Year", "Month", "Day", "Second")]
    if not set(names) <= set(table.header):
        return None
    more = [f"{prefix}{part}" for part in ("Hour", "Minute", "Nano")]
    columns = [table.numbers(n) for n in names]
    columns += [table.numbers(n) if n in table.header else np.zeros(len(table.rows)) for n in more]
    valid = f"{prefix}Valid"
    told = np.isfinite(columns).all(axis=0) & (columns[0] > 1970)
    if valid in table.header:
        told &= np.nan_to_num(table.numbers(valid)) > 0
    if not told.any():
        return None
    row = int(np.argmax(told))
    year, month, day, second, hour, minute, nano = (float(column[row]) for column in columns)
    try:
        date = datetime.datetime(int(year), int(month), int(day), tzinfo=datetime.UTC)
    except ValueError as error:
        raise FormatError(
            f"{table.name}: line {table.lines[row]}: {names[0]}: expected a date, found: {error}"
        ) from error
    whole = round(date.timestamp()) + int(hour) * 3600 + int(minute) * 60
    return row, whole * NS_PER_S + round(second * NS_PER_S) + int(nano)


def _losses(counter: NDArray[np.int64] | None) -> tuple[str, ...]:
    """Say how many packets are missing, come twice or late."""
    if counter is None:
        return ()
    steps = np.diff(np.unique(counter))
    lines = []
    if lost := int((steps - 1).sum()):
        lines.append(f"{lost} packets are missing, in {int((steps > 1).sum())} gaps")
    if twice := len(counter) - len(np.unique(counter)):
        lines.append(f"{twice} packets come twice")
    return tuple(lines)
