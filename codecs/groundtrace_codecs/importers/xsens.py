"""Importer for the text that Xsens MT Manager exports: one file per sensor.

A file has comments of ``//``, a row of names and rows of numbers; what was made of such a file may
have a line of another kind before the names. Units are those of the manual:
m/s2, rad/s, degrees, and for the magnetometer the field where it was calibrated (MTw Awinda User
Manual, "Exporting data": a.u.). Older versions write ``Counter`` and ``Sample rate``, newer ones
``PacketCounter`` and, not always, ``Update Rate``.
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError, SchemaError
from ..signals import NS_PER_S, Channel, to_quantity
from .base import ColumnMap, ImportMap, StreamMap
from .map import Sampled, together
from .stored import pieces, stacked
from .tables import TextTable, names_of_columns
from .time import unwrapped

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import Imported
    from .stored import Column

_HEAD_BYTES = 4096
_NAMES = re.compile(rb"^[^/\r\n]*\b(?:Packet)?Counter\b[^\r\n]*\b(?:Acc|Gyr|Mag)_X\b", re.M)
_RATE = re.compile(r"\b(?:rate|frequency):\s*(\d+(?:\.\d+)?)\s*Hz", re.I)
_DEVICE = re.compile(r"Device ?Id:\s*([0-9A-F]{8})\b", re.I)
_DEVICE_IN_NAME = re.compile(r"_([0-9A-F]{8})$", re.I)
_DELIMITERS = ("\t", ";", ",")
_MAG = "magnetic_field_normalised"
_NOT_TESLA = (
    f"the magnetic field is in units of that where the sensor was calibrated: kept as {_MAG}, "
    f"of which no heading is made"
)


def _axes(word: str, name: str, quantity: str, unit: str) -> tuple[tuple[str, Channel], ...]:
    return tuple((f"{word}_{a.upper()}", Channel(f"{name}_{a}", quantity, unit, a)) for a in "xyz")


def _quaternion(names: str) -> tuple[tuple[str, Channel], ...]:
    channels = (Channel(f"q_{a}", "orientation", "1", a) for a in "wxyz")
    return tuple(zip((f"Quat_{n}" for n in names.split()), channels, strict=True))


#: Topic to the columns of a stream and what they are; a stream is there where all its columns are.
STREAMS: tuple[tuple[str, tuple[tuple[str, Channel], ...]], ...] = (
    (
        "/imu",
        (
            *_axes("Acc", "acc", "acceleration", "m/s2"),
            *_axes("Gyr", "gyro", "angular_velocity", "rad/s"),
        ),
    ),
    ("/acc", _axes("Acc", "acc", "acceleration", "m/s2")),
    ("/gyro", _axes("Gyr", "gyro", "angular_velocity", "rad/s")),
    ("/mag", _axes("Mag", "mag", _MAG, "1")),
    ("/orientation", _quaternion("q0 q1 q2 q3")),
    ("/orientation", _quaternion("w x y z")),
    ("/baro", (("Pressure", Channel("pressure", "pressure", "Pa")),)),
    ("/temperature", (("Temperature", Channel("temperature", "temperature", "degC")),)),
    (
        "/fix",
        tuple(
            (name, Channel(name.lower(), name.lower(), unit))
            for name, unit in (("Latitude", "deg"), ("Longitude", "deg"), ("Altitude", "m"))
        ),
    ),
)


class XsensImporter:
    """Reads the files of the sensors of one recording."""

    name = "xsens"
    description = "text exported by Xsens MT Manager, a file per sensor"

    def sniff(self, path: Path) -> float:
        """Return 0.95 for comments of // and the names of columns below, 0.8 for names alone."""
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if not _NAMES.search(head):
            return 0.0
        return 0.95 if head.lstrip(b"\xef\xbb\xbf").startswith(b"//") else 0.8

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recording; they need no map.

        Raises
        ------
        SchemaError
            For a map, or two files of one sensor.
        FormatError
            Where a file is no such text, or nothing in it says how fast it was sampled.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for an Xsens export, found one")
        files = [_open(path) for path in paths]
        devices = [file.device for file in files]
        if len(set(devices)) < len(devices):
            raise SchemaError(
                f"{paths[0].name}: expected a sensor of its own in each file, "
                f"found {', '.join(devices)}"
            )
        times, remarks = packet_times([(f.table, f.rate_hz) for f in files])
        streams: list[Sampled] = []
        warnings: list[str] = []
        for file, when in zip(files, times, strict=True):
            suffix = f"/{file.device}" if len(files) > 1 else ""
            streams += _streams(file.table, when, suffix, warnings)
        if not streams:
            raise FormatError(f"{paths[0].name}: expected columns with samples, found none")
        if any(each.channels[0].quantity == _MAG for each in streams):
            remarks = (*remarks, _NOT_TESLA)
        return replace(together(streams, warnings=tuple(warnings)), remarks=remarks)


@dataclass(frozen=True, slots=True)
class _File:
    """The rows of one sensor, its id, and the rate that is told before them, if it is [Hz]."""

    table: TextTable
    device: str
    rate_hz: float | None


def _open(path: Path) -> _File:
    """Read a file; the sensor's id is in the comments or ends the file's name."""
    with path.open("rb") as file:
        # of bytes: a text ends its lines at a form feed, too, which a table does not
        lines = file.read(_HEAD_BYTES).splitlines()
    at = next((i for i, line in enumerate(lines) if _NAMES.search(line)), 0)
    head = [line.decode("latin-1").removeprefix("ï»¿") for line in lines[:at]]
    skipped = sum(not line.lstrip('"').startswith("//") for line in head if line)
    delimiter = max(_DELIMITERS, key=lines[at].decode("latin-1").count)
    layout = partial(
        ImportMap,
        "xsens",
        delimiter=delimiter,
        comment="//",
        skip_rows=skipped,
        encoding="utf-8-sig",
    )
    header = names_of_columns(path, layout(stream=()))
    columns = tuple(ColumnMap(name, "", "") for name in header if name)
    table = TextTable.load(path, layout(stream=(StreamMap("/", columns),)))
    rate = _RATE.search("\n".join(head))
    device = _DEVICE.search("\n".join(head)) or _DEVICE_IN_NAME.search(path.stem)
    return _File(
        table, device[1].upper() if device else path.stem, float(rate[1]) if rate else None
    )


def _streams(
    table: TextTable, when: PacketTimes, suffix: str, warnings: list[str]
) -> list[Sampled]:
    """Return the streams of a table; adds a line for each thing to know."""
    streams: dict[str, Sampled] = {}
    used = set(when.columns)
    for topic, columns in STREAMS:
        names = [name for name, _ in columns]
        if not set(names) <= set(table.header) or set(names) <= used:
            continue
        used |= set(names)
        values = stacked([table.numbers(name) for name in names])
        valid = np.concatenate([_there(values[rows], topic) for rows in pieces(len(values))])
        if not valid.any():
            continue
        channels = tuple(channel for _, channel in columns)
        each = Sampled(topic + suffix, "", channels, when.times_ns, values)
        each = each if valid.all() else each.only(np.flatnonzero(valid))
        streams[topic] = replace(each, channels=tuple(_channel(c, each.values) for c in channels))
    warnings += [f"{table.name}: {line}" for line in when.warnings]
    others = [name for name in table.header if name and name not in used]
    if others:
        warnings.append(f"{table.name}: left out: {', '.join(others)}")
    return list(streams.values())


def _there(values: NDArray[np.float64], topic: str) -> NDArray[np.bool_]:
    """Tell which rows hold something; the device writes zeros where it has no fix."""
    there: NDArray[np.bool_] = np.asarray(np.isfinite(values).any(axis=1))
    if topic == "/fix":
        there &= values[:, :2].any(axis=1)
    return there


def _channel(channel: Channel, values: Column) -> Channel:
    """Return a channel; pressure is in Pa or, of an older device, in mbar: its size tells."""
    if channel.quantity != "pressure" or np.nanmedian(values[:]) > 3000:
        return channel
    unit, factor = to_quantity("pressure", "mbar")
    return Channel(channel.name, channel.quantity, unit, scale=factor)


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
    timings, loose = [], 0
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
        timings.append(PacketTimes(times, _time_columns(table), _losses(counter)))
    assumed = []
    if loose:
        assumed.append("the files do not tell the date: the clock is not that of the calendar")
    if loose > 1:
        assumed.append(f"{loose} files are put together by their packet counters")
    return timings, tuple(assumed)


def _counter(table: TextTable) -> NDArray[np.int64] | None:
    """Return the packet counter, unwrapped, or None."""
    name = next((n for n in _COUNTERS if n in table.header), None)
    if name is None:
        return None
    values = table.numbers(name)[:]
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
    fine = table.numbers(_FINE)[:] if _FINE in table.header else np.array([np.nan])
    if _counts(fine):
        ticks = unwrapped(fine.astype(np.int64), TICKS)
        return ticks * (NS_PER_S // _ticks_hz(ticks, rate_hz))
    if not rate_hz:
        raise FormatError(
            f"{table.name}: expected // Update Rate or {_FINE} in every row, found neither; a map "
            f"can state the rate: groundtrace import {table.name} --guess writes one"
        )
    if counter is None:
        counter = np.arange(len(table.lines), dtype=np.int64)
        origin = 0
    first = (int(counter[0]) - origin + PACKETS // 2) % PACKETS - PACKETS // 2
    passed: NDArray[np.float64] = (counter - counter[0] + first) * (NS_PER_S / rate_hz)
    return np.rint(passed).astype(np.int64)


def _ticks_hz(ticks: NDArray[np.int64], rate_hz: float | None) -> int:
    """Return how fast the ticks are [Hz], by the rate of the samples where it is known."""
    steps = np.diff(ticks)
    if rate_hz is None or not (steps > 0).any():
        return TICKS_HZ[0]
    estimate_hz = float(np.median(steps[steps > 0])) * rate_hz
    return min(TICKS_HZ, key=lambda hz: abs(np.log(estimate_hz / hz)))


def _time_columns(table: TextTable) -> tuple[str, ...]:
    """Return the names of the columns that are about time."""
    parts = ("Year", "Month", "Day", "Hour", "Minute", "Second", "Nano", "Valid")
    names = {*_COUNTERS, _FINE, *parts, *(f"UTC_{part}" for part in parts)}
    return tuple(name for name in table.header if name in names)


def _utc(table: TextTable) -> tuple[int, int] | None:
    """Return the first row that tells UTC, and what it tells [ns]; None without one."""
    prefix = "UTC_" if "UTC_Year" in table.header else ""
    names = [f"{prefix}{part}" for part in ("Year", "Month", "Day", "Second")]
    if not set(names) <= set(table.header):
        return None
    more = [f"{prefix}{part}" for part in ("Hour", "Minute", "Nano")]
    columns = [table.numbers(n)[:] for n in names]
    none = np.zeros(len(table.lines))
    columns += [table.numbers(n)[:] if n in table.header else none for n in more]
    valid_column = f"{prefix}Valid"
    valid = np.isfinite(columns).all(axis=0) & (columns[0] > 1970)
    if valid_column in table.header:
        valid &= np.nan_to_num(table.numbers(valid_column)[:]) > 0
    if not valid.any():
        return None
    row = int(np.argmax(valid))
    year, month, day, second, hour, minute, nano = (float(column[row]) for column in columns)
    try:
        date = datetime.datetime(int(year), int(month), int(day), tzinfo=datetime.UTC)
    except ValueError as error:
        line = table.lines[row : row + 1][0]
        raise FormatError(
            f"{table.name}: line {line}: {names[0]}: expected a date, found: {error}"
        ) from error
    minute_start_s = round(date.timestamp()) + int(hour) * 3600 + int(minute) * 60
    return row, minute_start_s * NS_PER_S + round(second * NS_PER_S) + int(nano)


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
