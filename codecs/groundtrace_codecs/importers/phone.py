"""Importer for tables of phone apps, in a zip archive, a folder or alone: Sensor Logger, phyphox.

Sensor Logger writes one table per sensor. Columns are ``time`` (unix time, ns), ``seconds_elapsed``
and those of the sensor, with the axes in the order z, y, x. Units and signs are those of the app's
UNITS and COORDINATES pages: Android's, except that an iPhone without "Standardise Units & Frames"
gives every acceleration with the opposite sign, and that of the uncalibrated accelerometer in g.

phyphox writes one table per sensor, or one for all. The first column is ``Time (s)``, since the
experiment began; the others state their unit. Separator and decimal sign are the user's choice and
words are in the phone's language, so a column is recognised by its unit. ``meta/time.csv`` gives
the calendar time at which the experiment ran and paused: the time of the experiment stands still in
a pause.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ..errors import FormatError, SchemaError
from ..events import Label
from ..signals import NS_PER_S, QUANTITIES, Channel, to_quantity
from .base import ColumnMap, Imported, ImportMap, StreamMap, TimeMap
from .map import MAX_NS, Sampled, together
from .stored import Computed, pieces, stacked
from .tables import TextTable, check_member

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import TimeUnit
    from .tables import TextFile

#: Files that say more about those beside them, by the folder they are in.
_BESIDE = ("Metadata.csv", "Annotation.csv", "meta/time.csv")
#: How much of a table is looked at to know it [bytes].
_HEAD = 4096
#: Tables are packed no more than so many times: a row of ten characters takes 100 bytes in memory.
#: Chosen by judgement: tables of numbers are packed 3 to 6 times.
_RATIO = 25
#: A table that holds no samples is no longer than this [bytes].
_RECORDS = 1 << 22


class PhoneImporter:
    """Reads what one phone recorded at one time."""

    name = "phone"
    description = "phone apps: Sensor Logger and phyphox, zip or CSV files"

    def sniff(self, path: Path) -> float:
        """Return 1 where a file is of an app, by the header of its table or of one inside."""
        if path.suffix.lower() not in (".zip", ".csv"):
            return 0.0
        try:
            with _files([path]) as files:
                return 1.0 if _app(files) is not None or _says_more(files) else 0.0
        except FormatError:
            return 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recording; they need no map.

        Raises
        ------
        FormatError
            Where the files are of no app known here, or damaged.
        SchemaError
            For a map, or tables that do not hold what their app writes.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for a phone app, found one")
        with _files(paths) as files:
            for path in paths:
                if path.suffix.lower() == ".zip":
                    _check_sizes(path)
            read = _app(files)
            if read is None:
                raise FormatError(
                    f"{paths[0].name}: expected CSV tables of Sensor Logger or phyphox, "
                    f"found {len(files)} tables of neither"
                )
            content = read(files)
        if not content.sampled:
            raise FormatError(
                f"{paths[0].name}: expected acceleration, rotation, magnetic field, pressure or "
                f"places, found none"
            )
        return together(content.sampled, labels=content.labels, warnings=content.warnings)


def _app(files: Sequence[AppFile]) -> Callable[[Sequence[AppFile]], AppContent] | None:
    """Return what reads the files, or None."""
    if any(is_sensor_logger_table(f) for f in files):
        return read_sensor_logger
    if any(is_phyphox_table(f) for f in files):
        return read_phyphox
    return None


def _says_more(files: Sequence[AppFile]) -> bool:
    return any(is_metadata(f) or is_clock(f) for f in files)


@contextmanager
def _files(paths: Sequence[Path]) -> Iterator[list[AppFile]]:
    """Yield the tables meant: those given, inside archives, and what lies beside and says more."""
    opened: list[zipfile.ZipFile] = []
    try:
        tables: dict[str, TextFile] = {}
        for path in paths:
            if path.suffix.lower() == ".zip":
                opened.append(zipfile.ZipFile(path))
                tables |= _inside(opened[-1])
                continue
            tables[path.name] = path
            beside = (path.parent / name for name in _BESIDE)
            tables |= {p.name: p for p in beside if p.is_file()}
        yield [_look(file) for file in tables.values()]
    except _DAMAGE as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(f"{paths[0].name}: expected a whole archive, found: {text}") from error
    finally:
        for archive in opened:
            archive.close()


#: What :mod:`zipfile` raises for archives that are cut short, damaged, encrypted or unknown.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    UnicodeDecodeError,
)


def _inside(archive: zipfile.ZipFile) -> dict[str, TextFile]:
    """Return the tables of an archive by their names without folder."""
    names = [m.filename for m in _tables(archive)]
    return {n.rpartition("/")[2]: zipfile.Path(archive, n) for n in names}


def _tables(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    members = [m for m in archive.infolist() if m.filename.lower().endswith(".csv")]
    return [m for m in members if "__MACOSX" not in m.filename]


def _check_sizes(path: Path) -> None:
    """Refuse an archive with a table that is larger than a table of its packed size can be."""
    with zipfile.ZipFile(path) as archive:
        for member in _tables(archive):
            check_member(member, f"{path.name}: {member.filename}", _RATIO)


def _look(file: TextFile) -> AppFile:
    """Return a file with the cells of its first line and what separates them."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    line = head.decode("utf-8-sig", "replace").partition("\n")[0].rstrip("\r")
    delimiter = max(",;\t", key=line.count)
    try:
        header = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        header = []
    return AppFile(file, tuple(c.strip() for c in header), delimiter, head)


PLACEMENT = "phone"
#: First part of the topic of each quantity.
TOPICS = {
    "acceleration": "/acc",
    "angular_velocity": "/gyro",
    "magnetic_field": "/mag",
    "pressure": "/baro",
    "temperature": "/temperature",
    "latitude": "/fix",
}


@dataclass(frozen=True, slots=True)
class AppFile:
    """One table of an app.

    Attributes
    ----------
    file
        On the disk or in an archive.
    header
        Cells of the first line.
    delimiter
        What separates them.
    head
        The first bytes.
    """

    file: TextFile
    header: tuple[str, ...]
    delimiter: str
    head: bytes

    @property
    def name(self) -> str:
        """Name without folder."""
        return self.file.name

    @property
    def stem(self) -> str:
        """Name without suffix."""
        return self.name.rpartition(".")[0]

    def records(self) -> list[dict[str, str]]:
        """Return the rows as texts by column, for tables that hold no samples."""
        with self.file.open("rb") as file:
            content = file.read(_RECORDS + 1)
        if len(content) > _RECORDS:
            raise FormatError(f"{self.name}: expected at most {_RECORDS} bytes, found more")
        text = content.decode("utf-8-sig", "replace").replace("\0", "")
        try:
            rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=self.delimiter))
        except csv.Error:
            return []
        return [dict(zip(self.header, row, strict=False)) for row in rows[1:]]


@dataclass(frozen=True, slots=True)
class AppContent:
    """What an app's files hold."""

    sampled: tuple[Sampled, ...]
    labels: tuple[Label, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Wanted:
    """One column of a table: its name, and what it measures."""

    column: str
    quantity: str
    unit: str
    axis: Literal["x", "y", "z", ""] = ""


def sampled(
    file: AppFile, topic: str, columns: tuple[Wanted, ...], time: str, unit: TimeUnit
) -> Sampled | None:
    """Return columns of a table as samples in SI, None where it has no rows.

    Rows in which no column has a number are left out: apps write them where a sensor had nothing
    to say.

    Raises
    ------
    SchemaError
        Where a column or a number is missing; names file, line and column.
    """
    if not file.head.partition(b"\n")[2].strip():
        return None
    table = TextTable.load(file.file, _map(file, columns, time, unit))
    times = table.times_ns(TimeMap(time, unit))[:]
    numbers = [table.numbers(c.column) for c in columns]
    if np.abs(times).max() > MAX_NS:
        raise SchemaError(f"{file.name}: {time}: expected times, found {times.max()} ns")
    factors = [to_quantity(c.quantity, c.unit) for c in columns]
    scales = np.array([factor for _, factor in factors])
    beside = stacked(numbers)
    values = Computed(len(times), lambda rows: beside[rows] * scales)
    channels = tuple(
        Channel(channel_name(c), c.quantity, si, c.axis)
        for c, (si, _) in zip(columns, factors, strict=True)
    )
    stream = Sampled(topic, PLACEMENT, channels, times, values)
    there = np.concatenate([~np.isnan(values[rows]).all(axis=1) for rows in pieces(len(times))])
    if there.all():
        return stream
    return stream.only(np.flatnonzero(there)) if there.any() else None


def channel_name(column: Wanted) -> str:
    """Return the name of the channel of a column."""
    return f"{column.quantity}_{column.axis}" if column.axis else column.quantity


def _map(file: AppFile, columns: tuple[Wanted, ...], time: str, unit: TimeUnit) -> ImportMap:
    """Return the map of a table: its columns by name, and its decimal sign by its numbers."""
    second = file.head.split(b"\n", 2)[1]
    comma = file.delimiter != "," and b"," in second
    maps = tuple(ColumnMap(c.column, c.quantity, c.unit, c.axis) for c in columns)
    return ImportMap(
        "phone",
        (StreamMap("/", maps),),
        time=TimeMap(time, unit),
        delimiter=file.delimiter,
        decimal="," if comma else ".",
        comment="",
        skip_rows=1,
    )


_TIME = re.compile(r"(?i)(time|t|zeit|temps|tempo|tiempo)\s*\(s\)")
_COLUMN = re.compile(r"(?P<words>.*?)\s*\b(?P<axis>[xyzXYZ])?\s*\((?P<unit>[^()]+)\)")
#: Unit to what is measured in it and what we call it.
_UNITS = {
    "m/s^2": ("acceleration", "m/s2"),
    "m/s²": ("acceleration", "m/s2"),
    "rad/s": ("angular_velocity", "rad/s"),
    "µT": ("magnetic_field", "uT"),
    "μT": ("magnetic_field", "uT"),
    "hPa": ("pressure", "hPa"),
    "°C": ("temperature", "degC"),
}
_AXIS: dict[str, Literal["x", "y", "z", ""]] = {"x": "x", "y": "y", "z": "z", "": ""}
_VECTORS = frozenset({"acceleration", "angular_velocity", "magnetic_field"})
_LINEAR = re.compile(r"(?i)linear|without g|ohne g")
#: Words of a column of phyphox's location, and its quantity.
_COORDINATES = {
    "latitude": "latitude",
    "longitude": "longitude",
    "height": "altitude",
    "altitude": "altitude",
    "horizontal accuracy": "horizontal_accuracy",
}


class Piece(NamedTuple):
    """The experiment ran from one of its times [ns] on; what to add for unix time [ns]."""

    start_ns: int
    offset_ns: int


def is_phyphox_table(file: AppFile) -> bool:
    """Return whether a file is a table of samples."""
    return bool(file.header) and bool(_TIME.fullmatch(file.header[0])) and bool(_groups(file))


def is_clock(file: AppFile) -> bool:
    """Return whether a file says when the experiment ran."""
    return {"event", "experiment time", "system time"} <= set(file.header)


def read_phyphox(files: Sequence[AppFile]) -> AppContent:
    """Return the streams of the tables of one experiment.

    Raises
    ------
    SchemaError
        Where a table does not hold what it should, or two hold the same.
    """
    pieces = [p for file in files if is_clock(file) for p in _pieces(file)]
    streams: dict[str, Sampled] = {}
    for file in (f for f in files if is_phyphox_table(f)):
        for topic, columns in _groups(file).items():
            read_ = sampled(file, topic, columns, file.header[0], "s")
            if read_ is None:
                continue
            if topic in streams:
                raise SchemaError(f"{file.name}: {topic}: expected one table of it, found two")
            streams[topic] = _on_calendar(read_, pieces)
    warnings = [] if pieces else ["no meta/time.csv: times count from the start of the experiment"]
    if f"/acc_linear/{PLACEMENT}" in streams and f"/acc/{PLACEMENT}" not in streams:
        warnings.append("the acceleration is without gravity, and nothing else has it")
    return AppContent(tuple(streams.values()), (), tuple(warnings))


def _groups(file: AppFile) -> dict[str, tuple[Wanted, ...]]:
    """Return the columns of each stream of a table, by topic."""
    groups: dict[str, list[Wanted]] = {}
    for cell in file.header[1:]:
        match = _COLUMN.fullmatch(cell)
        if match is None:
            continue
        coordinate = _coordinate(cell, match["words"])
        if coordinate is not None:
            groups.setdefault(f"/fix/{PLACEMENT}", []).append(coordinate)
            continue
        quantity, unit = _UNITS.get(match["unit"], ("", ""))
        axis = _AXIS[(match["axis"] or "").lower()] if quantity in _VECTORS else ""
        if not quantity or (quantity in _VECTORS and not axis):
            continue
        part = "_linear" if quantity == "acceleration" and _LINEAR.search(cell + file.name) else ""
        topic = f"{TOPICS[quantity]}{part}/{PLACEMENT}"
        groups.setdefault(topic, []).append(Wanted(cell, quantity, unit, axis))
    return {t: tuple(c) for t, c in groups.items() if _is_complete(c)}


def _coordinate(cell: str, words: str) -> Wanted | None:
    """Return a column of a place on the globe."""
    word = words.strip().lower()
    quantity = _COORDINATES.get(word)
    return None if quantity is None else Wanted(cell, quantity, QUANTITIES[quantity])


def _is_complete(columns: list[Wanted]) -> bool:
    """Return whether each axis is there once; places need latitude, longitude and altitude."""
    have = [c.axis or c.quantity for c in columns]
    places = set(have) & set(_COORDINATES.values())
    if places and not {"latitude", "longitude", "altitude"} <= places:
        return False
    return len(set(have)) == len(have)


def _pieces(file: AppFile) -> list[Piece]:
    """Return the pieces of a clock; a row without numbers is no piece."""
    pieces = []
    for row in file.records():
        if row.get("event", "").strip().upper() != "START":
            continue
        try:
            experiment, system = (
                float(row[key].replace(",", ".")) for key in ("experiment time", "system time")
            )
        except (KeyError, ValueError) as error:
            raise SchemaError(f"{file.name}: START: expected two times, found {row}") from error
        if not (0 <= system < 9e9 and abs(experiment) < 9e9):
            raise SchemaError(f"{file.name}: START: expected unix seconds, found {system}")
        start_ns = round(experiment * NS_PER_S)
        # seconds since 1970 with three decimals: the float keeps them, its last digits do not
        pieces.append(Piece(start_ns, round(system * 1000) * 1_000_000 - start_ns))
    return sorted(pieces)


def _on_calendar(stream: Sampled, pieces: Sequence[Piece]) -> Sampled:
    """Return the samples at their times on the calendar, a pause being a gap."""
    if not pieces:
        return stream
    starts: NDArray[np.int64] = np.array([p.start_ns for p in pieces], np.int64)
    offsets: NDArray[np.int64] = np.array([p.offset_ns for p in pieces], np.int64)
    which = np.maximum(np.searchsorted(starts, stream.times_ns, side="right") - 1, 0)
    return replace(stream, times_ns=stream.times_ns + offsets[which])


#: Tables of each stream that is one sensor, best first, with what their columns are.
_AXES = {
    "angular_velocity": (("Gyroscope", "GyroscopeUncalibrated"), "rad/s"),
    "magnetic_field": (("Magnetometer", "MagnetometerUncalibrated"), "uT"),
}
_SENSOR_LOGGER_FIX = (
    Wanted("latitude", "latitude", "deg"),
    Wanted("longitude", "longitude", "deg"),
    Wanted("altitude", "altitude", "m"),
)
_ACCURACY = Wanted("horizontalAccuracy", "horizontal_accuracy", "m")
_ACC = TOPICS["acceleration"]
_SUM = ("Accelerometer", "Gravity")
#: Tables with samples that are read, whole or as the second best.
_SENSORS = frozenset(
    {
        *(name for names, _ in _AXES.values() for name in names),
        *_SUM,
        "TotalAcceleration",
        "AccelerometerUncalibrated",
        "Barometer",
        "Location",
    }
)


def is_sensor_logger_table(file: AppFile) -> bool:
    """Return whether a file is the table of a sensor."""
    return {"time", "seconds_elapsed"} <= set(file.header)


def is_metadata(file: AppFile) -> bool:
    """Return whether a file says which phone and settings the others are of."""
    return {"platform", "appVersion"} <= set(file.header)


def read_sensor_logger(files: Sequence[AppFile]) -> AppContent:
    """Return the streams and annotations of the tables of one recording.

    Raises
    ------
    SchemaError
        Where a table does not hold what it should.
    """
    tables = {f.stem: f for f in files if is_sensor_logger_table(f)}
    sign, warnings = _sign([f for f in files if is_metadata(f)])
    streams = [_single(tables, q, *_AXES[q]) for q in _AXES]
    streams.append(_columns(tables, "Barometer", (Wanted("pressure", "pressure", "mbar"),)))
    exact = _columns(tables, "Location", (*_SENSOR_LOGGER_FIX, _ACCURACY))
    streams.append(exact or _columns(tables, "Location", _SENSOR_LOGGER_FIX))
    acceleration, remarks = _acceleration(tables, sign)
    others = sorted(tables.keys() - _SENSORS - {"Annotation"})
    if others:
        remarks += (f"left alone: {', '.join(others)}",)
    return AppContent(
        tuple(s for s in (acceleration, *streams) if s is not None),
        _notes(tables.get("Annotation")),
        (*warnings, *remarks),
    )


def _sign(metadata: Sequence[AppFile]) -> tuple[float, tuple[str, ...]]:
    """Return what takes an acceleration to Android's sign, -1 also for g, and a remark."""
    rows = [row for file in metadata for row in file.records()]
    if not rows:
        return 1.0, ("no Metadata.csv: units and signs are taken as an Android phone gives them",)
    ios = rows[0].get("platform", "").strip().lower() == "ios"
    standard = rows[0].get("standardisation", "").strip().lower() == "true"
    if not ios or standard:
        return 1.0, ()
    return -1.0, ("iOS without Standardise Units & Frames: accelerations are turned round",)


def _axes(quantity: str, unit: str) -> tuple[Wanted, ...]:
    return tuple(Wanted(axis, quantity, unit, axis) for axis in ("x", "y", "z"))


def _columns(tables: dict[str, AppFile], name: str, columns: tuple[Wanted, ...]) -> Sampled | None:
    """Return the samples of one table, None where there is none with those columns."""
    file = tables.get(name)
    if file is None or not all(c.column in file.header for c in columns):
        return None
    topic = f"{TOPICS[columns[0].quantity]}/{PLACEMENT}"
    return sampled(file, topic, columns, "time", "ns")


def _single(
    tables: dict[str, AppFile], quantity: str, names: tuple[str, ...], unit: str
) -> Sampled | None:
    read_ = (_columns(tables, name, _axes(quantity, unit)) for name in names)
    return next((s for s in read_ if s is not None), None)


def _acceleration(
    tables: dict[str, AppFile], sign: float
) -> tuple[Sampled | None, tuple[str, ...]]:
    """Return the acceleration with gravity, as an accelerometer measures it, and remarks."""
    axes = _axes("acceleration", "m/s2")
    total = _columns(tables, "TotalAcceleration", axes)
    if total is not None:
        return _signed(total, sign), ()
    linear, gravity = (_columns(tables, name, axes) for name in _SUM)
    if (
        linear is not None
        and gravity is not None
        and np.array_equal(linear.times_ns, gravity.times_ns)
    ):
        both = (linear.values, gravity.values)
        values = Computed(len(linear.times_ns), lambda rows: both[0][rows] + both[1][rows])
        summed = replace(linear, values=values)
        return _signed(summed, sign), ("acceleration is Accelerometer.csv plus Gravity.csv",)
    raw = _columns(
        tables, "AccelerometerUncalibrated", _axes("acceleration", "g" if sign < 0 else "m/s2")
    )
    if raw is not None:
        return _signed(raw, sign), ("acceleration is AccelerometerUncalibrated.csv",)
    if linear is None:
        return None, ()
    bare = replace(linear, topic=f"{_ACC}_linear/{PLACEMENT}")
    return _signed(bare, sign), ("Accelerometer.csv is without gravity, and nothing else has it",)


def _signed(stream: Sampled, sign: float) -> Sampled:
    values = stream.values
    return replace(stream, values=Computed(len(values), lambda rows: values[rows] * sign))


def _notes(file: AppFile | None) -> tuple[Label, ...]:
    """Return what the user wrote while recording; a row without a time is left out."""
    rows = [] if file is None else file.records()
    return tuple(
        Label(int(row["time"]), "note", note=row.get("text", "").strip(), author="Sensor Logger")
        for row in rows
        if re.fullmatch(r"\d{1,18}|[1-8]\d{18}", row.get("time", ""), re.ASCII)
    )
