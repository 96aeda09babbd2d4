"""Importers for logs of phones, a reading a line: Indoor Location Competition 2.0, GetSensorData.

A trace of the Indoor Location Competition 2.0 (Microsoft Research, XYZ10) is tab-separated: unix
time [ms], type, values. Accelerometer, gyroscope and magnetometer of the phone become streams, the
surveyor's waypoints truth, and the first of them the start of the walk.

A log of GetSensorData (LOPSI at CAR-CSIC), in which the IPIN competitions give their data, begins
with comments that name the columns of each kind of line. Lines are separated by semicolons: kind,
seconds since the log began, the sensor's own seconds, values. A reading lies at the sensor's time,
which keeps the intervals, moved by the median of what the app's time is ahead of it. Reference
positions (POSI) become waypoints in metres east and north of the first one, the site's origin.

Radio scans, sound, light and Android's own orientation are left out. A line that is cut short or
holds no numbers is left out, too, and counted.
"""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError, SchemaError
from ..events import Label
from ..geometry import Geometry, tangent_plane
from ..signals import NS_PER_S, Channel, to_quantity
from .map import MAX_NS, TIME_UNITS_NS, Sampled, together
from .phone import PLACEMENT, TOPICS, Wanted, channel_name
from .stored import PIECE, Computed, Spool, pieces

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import Imported, ImportMap
    from .stored import Column


def _axes(quantity: str, unit: str, before: str = "") -> tuple[Wanted, ...]:
    return (
        Wanted(f"{before}X", quantity, unit, "x"),
        Wanted(f"{before}Y", quantity, unit, "y"),
        Wanted(f"{before}Z", quantity, unit, "z"),
    )


#: Type of a line of a trace, and its values.
TRACE = {
    "TYPE_ACCELEROMETER": _axes("acceleration", "m/s2"),
    "TYPE_GYROSCOPE": _axes("angular_velocity", "rad/s"),
    "TYPE_MAGNETIC_FIELD": _axes("magnetic_field", "uT"),
}
WAYPOINT = "TYPE_WAYPOINT"
_TRACE_START = b"#\tstartTime:"


class IndoorLocationImporter:
    """Reads one trace."""

    name = "indoor-location"
    description = "traces of the Indoor Location Competition 2.0: phone sensors and waypoints"

    def sniff(self, path: Path) -> float:
        """Return 1 for a file that begins as a trace does."""
        with path.open("rb") as file:
            return 1.0 if file.read(len(_TRACE_START)) == _TRACE_START else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one trace; it needs no map.

        Raises
        ------
        SchemaError
            For a map, or more than one file.
        FormatError
            Where the file is no trace, or has no accelerometer.
        """
        path = _only(paths, map_, "trace")
        counts = {**dict.fromkeys(TRACE, 3), WAYPOINT: 2}
        log = _Log(path.name, counts)
        for number, line in _lines(path):
            cells = line.split("\t")
            if len(cells) > 1 and cells[1] in counts:
                log.add(number, cells[1], cells[0], cells[2:], _milliseconds)
        log.need("TYPE_ACCELEROMETER")
        points = log.readings[WAYPOINT].moments()
        return together(
            [
                _sensor(columns, log.readings[kind].times_ns, log.readings[kind].values)
                for kind, columns in TRACE.items()
                if log.has(kind)
            ],
            geometry=Geometry(start=(points[0][1][0], points[0][1][1])) if points else None,
            labels=tuple(Label(time_ns, "waypoint", x_m=x, y_m=y) for time_ns, (x, y) in points),
            warnings=log.warnings(),
        )


#: Kind of a line of GetSensorData, and the columns wanted of it, by their names before the unit.
LOG = {
    "ACCE": _axes("acceleration", "m/s2", "Acc_"),
    "GYRO": _axes("angular_velocity", "rad/s", "Gyr_"),
    "MAGN": _axes("magnetic_field", "uT", "Mag_"),
    "PRES": (Wanted("Pres", "pressure", "mbar"),),
    "TEMP": (Wanted("temp", "temperature", "degC"),),
    "GNSS": (
        Wanted("Latit", "latitude", "deg"),
        Wanted("Long", "longitude", "deg"),
        Wanted("Altitude", "altitude", "m"),
        Wanted("Accuracy", "horizontal_accuracy", "m"),
    ),
}
#: Fixes come from several sources of which each has its own clock, and twice where two listen.
FIXES, REFERENCE = "GNSS", "POSI"
_REFERENCE_COLUMNS = ("Latitude", "Longitude", "floor ID", "Building ID")
_SENSOR_TIME = "SensorTimestamp"
_LOG_START = re.compile(rb"%[^\n]*GetSensorData")
_DESCRIBED = re.compile(r"'(?P<kind>[A-Z][A-Z0-9]{3});(?P<cells>[^']*)")
_CREATED = re.compile(
    r"Date of creation:\s*\w{3} (?P<date>[A-Z][a-z]{2} \d{1,2} \d\d:\d\d:\d\d) "
    r"(?P<zone>\S+) (?P<year>\d{4})"
)
_ZONE = re.compile(r"(?:GMT|UTC|Z)?(?:(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d))?")
_HEAD_BYTES = 4096
#: Clocks of sensors whose times are ahead of the app's by the same within this are one clock [s].
#: Chosen by judgement: readings come late by some hundredths of a second; two clocks of a phone
#: that began at different times, by more.
ONE_CLOCK_S = 1.0


class GetSensorDataImporter:
    """Reads one log."""

    name = "getsensordata"
    description = (
        "logs of GetSensorData, as in the IPIN competitions: phone sensors, fixes, waypoints"
    )

    def sniff(self, path: Path) -> float:
        """Return 1 for a file whose first lines say what wrote it."""
        with path.open("rb") as file:
            return 1.0 if _LOG_START.search(file.read(_HEAD_BYTES)) else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one log; it needs no map.

        Raises
        ------
        SchemaError
            For a map, or more than one file.
        FormatError
            Where the file is no such log, or has no accelerometer.
        """
        path = _only(paths, map_, "log")
        described = _described(path)
        log, others = _gathered(path, described.columns)
        log.need("ACCE")
        clock = _SensorClocks(log)
        labels, geometry = _references(log, described.start_ns)
        streams = {
            kind: _sensor(columns, described.start_ns + clock.times_ns(kind), log.measured(kind))
            for kind, columns in LOG.items()
            if log.has(kind)
        }
        if FIXES in streams:
            streams[FIXES] = streams[FIXES].only(log.changes(FIXES))
        read = together(
            list(streams.values()),
            geometry=geometry,
            labels=labels,
            warnings=(*described.warnings, *log.warnings()),
        )
        return replace(read, remarks=(*read.remarks, *_left_out(others), *_origin(geometry)))


def _only(paths: Sequence[Path], map_: ImportMap | None, what: str) -> Path:
    if map_ is not None:
        raise SchemaError(f"{map_.file}: expected no map for a {what} of a phone, found one")
    if len(paths) != 1:
        raise SchemaError(
            f"{paths[0].name}: expected one {what}, found {len(paths)} files: import each by itself"
        )
    return paths[0]


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text, from 1, without their ends."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            yield number, line.rstrip("\r\n")


def _milliseconds(text: str) -> int:
    return int(text) * TIME_UNITS_NS["ms"]


def _seconds(text: str) -> int:
    return round(float(text) * NS_PER_S)


class _Readings:
    """Times [ns] and values of the lines of one kind, the values in a temporary file."""

    def __init__(self, values: int) -> None:
        self.count = values
        self._times, self._values, self._spool = array("q"), array("d"), Spool(float, (values,))

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time_ns: int, values: Sequence[float]) -> None:
        """Add a line."""
        self._times.append(time_ns)
        self._values.extend(values)
        if len(self._values) >= PIECE:
            self._flush()

    def _flush(self) -> None:
        self._spool.write(memoryview(self._values).cast("B"))
        self._values = array("d")

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """The times in the order of the file, shape (n,)."""
        return np.array(self._times, np.int64)

    @property
    def values(self) -> Column:
        """The values, shape (n, n_values)."""
        if self._values:
            self._flush()
        return self._spool

    def moments(self) -> list[tuple[int, list[float]]]:
        """Return times [ns] and values of few lines, by time."""
        return sorted(zip(self._times, self.values[:].tolist(), strict=True))


class _Log:
    """Readings of a log by kind.

    Parameters
    ----------
    name
        Of the file, named in errors.
    counts
        How many values the lines of each kind have.
    """

    def __init__(self, name: str, counts: Mapping[str, int]) -> None:
        self.readings = {kind: _Readings(count) for kind, count in counts.items()}
        self._name = name
        self._broken, self._first_broken = 0, ""

    def add(
        self,
        number: int,
        kind: str,
        time: str,
        texts: Sequence[str],
        time_ns_of: Callable[[str], int],
    ) -> None:
        """Add a line, or count it among those that are none.

        Values beyond those of the kind are left alone: traces exist in which a line break between
        two events is missing.
        """
        readings = self.readings[kind]
        try:
            time_ns = time_ns_of(time)
            values = [float(text) for text in texts[: readings.count]]
        except (ValueError, OverflowError) as error:
            self._leave_out(number, f"expected numbers, found: {error}")
            return
        if not 0 <= time_ns <= MAX_NS:
            self._leave_out(number, f"expected a time since 1970, found {time}")
        elif len(values) != readings.count:
            self._leave_out(number, f"expected {readings.count} values, found {len(values)}")
        else:
            readings.add(time_ns, values)

    def _leave_out(self, number: int, fault: str) -> None:
        self._broken += 1
        self._first_broken = self._first_broken or f"line {number}: {fault}"

    def has(self, kind: str) -> bool:
        """Return whether there are samples of a kind."""
        return len(self.readings.get(kind, ())) > 1

    def need(self, kind: str) -> None:
        """Raise where there are no samples of a kind, or all have one time."""
        if not self.has(kind):
            first = f" ({self._first_broken})" if self._broken else ""
            raise FormatError(f"{self._name}: expected {kind} lines, found none{first}")
        if np.ptp(self.readings[kind].times_ns) == 0:
            raise FormatError(f"{self._name}: {kind}: expected times that go on, found one")

    def measured(self, kind: str) -> Column:
        """Return the values of a kind without the sensor's time before them."""
        values = self.readings[kind].values
        return Computed(len(values), lambda rows: values[rows][:, 1:])

    def changes(self, kind: str) -> NDArray[np.intp]:
        """Return the lines of a kind that say something else than the one before, by number."""
        values = self.readings[kind].values[:]
        return np.flatnonzero(np.append(True, (np.diff(values, axis=0) != 0).any(axis=1)))

    def warnings(self) -> tuple[str, ...]:
        """Return what to say of the lines that were left out."""
        if not self._broken:
            return ()
        if self._broken == 1:
            return (f"1 broken line was left out: {self._first_broken}",)
        return (f"{self._broken} broken lines were left out, the first: {self._first_broken}",)


def _sensor(columns: Sequence[Wanted], times_ns: NDArray[np.int64], values: Column) -> Sampled:
    """Return the samples of one sensor."""
    units = [to_quantity(c.quantity, c.unit) for c in columns]
    scales = np.array([factor for _, factor in units])
    channels = tuple(
        Channel(channel_name(c), c.quantity, si, c.axis)
        for c, (si, _) in zip(columns, units, strict=True)
    )
    scaled = Computed(len(times_ns), lambda piece: values[piece] * scales)
    return Sampled(
        f"{TOPICS[columns[0].quantity]}/{PLACEMENT}", PLACEMENT, channels, times_ns, scaled
    )


@dataclass(frozen=True, slots=True)
class _Described:
    """What the comments of a log say.

    Attributes
    ----------
    columns
        Names of the cells after the kind, by kind.
    start_ns
        When the log began [ns since 1970]; 0 where it does not say so.
    warnings
        One line each.
    """

    columns: dict[str, tuple[str, ...]]
    start_ns: int
    warnings: tuple[str, ...]


def _described(path: Path) -> _Described:
    columns: dict[str, tuple[str, ...]] = {}
    created = None
    for _, line in _lines(path):
        if line and not line.startswith("%"):
            break
        created = created or _CREATED.search(line)
        match = _DESCRIBED.search(line)
        if match is not None:
            cells = (cell.partition("(")[0].strip() for cell in match["cells"].split(";"))
            columns.setdefault(match["kind"], tuple(cell for cell in cells if cell))
    start = None if created is None else _utc(created["date"], created["zone"], created["year"])
    if start is None:
        zone = "no date of creation" if created is None else f"time zone {created['zone']}"
        return _Described(columns, 0, (f"{zone}: times count from the start of the log",))
    return _Described(columns, round(start.timestamp()) * NS_PER_S, ())


def _utc(date: str, zone: str, year: str) -> datetime | None:
    """Return a moment as Java writes it; None in a zone that is not told by numbers."""
    match = _ZONE.fullmatch(zone)
    if match is None:
        return None
    try:
        local = datetime.strptime(f"{date} {year}", "%b %d %H:%M:%S %Y").replace(tzinfo=UTC)
    except ValueError:
        return None
    ahead = timedelta(hours=int(match["hours"] or 0), minutes=int(match["minutes"] or 0))
    return local + ahead if match["sign"] == "-" else local - ahead


def _gathered(path: Path, columns: Mapping[str, tuple[str, ...]]) -> tuple[_Log, Counter[str]]:
    """Return what the lines of a log say, and how many there are of the kinds left out."""
    kinds = {kind: (_SENSOR_TIME, *(w.column for w in wanted)) for kind, wanted in LOG.items()}
    kinds[REFERENCE] = _REFERENCE_COLUMNS
    described = {kind: _places(columns.get(kind, ()), names) for kind, names in kinds.items()}
    places = {kind: at for kind, at in described.items() if at is not None}
    log, others = _Log(path.name, {kind: len(at) for kind, at in places.items()}), Counter[str]()
    for number, line in _lines(path):
        kind, _, rest = line.partition(";")
        if kind in places:
            cells = rest.split(";")
            texts = [cells[at] for at in places[kind] if at < len(cells)]
            log.add(number, kind, cells[0], texts, _seconds)
        elif kind and not kind.startswith("%"):
            others[kind[:4]] += 1
    return log, others


def _places(cells: Sequence[str], names: Sequence[str]) -> tuple[int, ...] | None:
    """Return where columns stand, whatever the case of their names; None where one is missing."""
    lower = [cell.lower() for cell in cells]
    wanted = [name.lower() for name in names]
    return tuple(lower.index(w) for w in wanted) if set(wanted) <= set(lower) else None


class _SensorClocks:
    """Puts the sensors' times on the app's clock.

    All sensors whose clocks are apart from it by what the accelerometer's is have one clock.
    """

    def __init__(self, log: _Log) -> None:
        self._log = log
        kinds = [kind for kind in LOG if log.has(kind)]
        self._sensor_ns = {kind: self._by_sensor_ns(kind) for kind in kinds}
        self._ahead = {
            kind: int(np.median(log.readings[kind].times_ns - times))
            for kind, times in self._sensor_ns.items()
        }
        common = self._ahead["ACCE"]
        for kind, ahead in self._ahead.items():
            if abs(ahead - common) < ONE_CLOCK_S * NS_PER_S:
                self._ahead[kind] = common

    def _by_sensor_ns(self, kind: str) -> NDArray[np.int64]:
        """Return the sensor's times; the app's of fixes, and where the sensor's stand still."""
        app = self._log.readings[kind].times_ns
        if kind == FIXES:
            return app
        values = self._log.readings[kind].values
        seconds = np.concatenate([values[rows][:, 0] for rows in pieces(len(app))])
        in_range = (np.abs(seconds) < MAX_NS / NS_PER_S).all()
        if not in_range or 2 * np.ptp(seconds) * NS_PER_S < np.ptp(app):
            return app
        return np.rint(seconds * 1e6).astype(np.int64) * 1000

    def times_ns(self, kind: str) -> NDArray[np.int64]:
        """Return the times of the readings of a kind since the log began, shape (n,) [ns]."""
        return self._sensor_ns[kind] + self._ahead[kind]


def _references(log: _Log, start_ns: int) -> tuple[tuple[Label, ...], Geometry | None]:
    """Return the reference positions in metres east and north of the first one, and the site."""
    points = log.readings.get(REFERENCE)
    if not points:
        return (), None
    passed = [(t, x) for t, x in points.moments() if abs(x[0]) <= 90 and abs(x[1]) <= 180]
    if not passed:
        return (), None
    site = Geometry(origin=(passed[0][1][0], passed[0][1][1], 0.0))
    plane = tangent_plane(site)
    labels = []
    for time_ns, (latitude, longitude, floor, building) in passed:
        x_m, y_m = plane.map_position(math.radians(latitude), math.radians(longitude))
        note = f"floor {floor:g}, building {building:g}"
        labels.append(Label(start_ns + time_ns, "waypoint", x_m=x_m, y_m=y_m, note=note))
    return tuple(labels), site


def _origin(site: Geometry | None) -> tuple[str, ...]:
    if site is None or site.origin is None:
        return ()
    latitude, longitude, _ = site.origin
    where = f"{latitude:.6f}, {longitude:.6f}"
    return (f"waypoints are metres east and north of the first one, at {where}",)


def _left_out(others: Mapping[str, int]) -> tuple[str, ...]:
    counted = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
    return (f"lines of other kinds, left out: {counted}",) if counted else ()
