"""Importer for traces of the Indoor Location Competition 2.0 (Microsoft Research, XYZ10).

A trace is tab-separated text, one event a line: unix time [ms], type, values. Accelerometer,
gyroscope and magnetometer of the phone become streams, the surveyor's waypoints truth, and the
first of them the place where the walk starts. Radio scans and Android's own orientation stay out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError, SchemaError
from ..geometry import Geometry
from ..labels import Label
from ..signals import Channel, Stream
from ..units import to_quantity
from . import grid
from .api import Imported
from .mapped import TIME_UNITS_NS, sample_format

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from .api import ImportMap, Source

#: Type of a line, its topic, quantity and unit.
SENSORS = {
    "TYPE_ACCELEROMETER": ("/acc/phone", "acceleration", "m/s2"),
    "TYPE_GYROSCOPE": ("/gyro/phone", "angular_velocity", "rad/s"),
    "TYPE_MAGNETIC_FIELD": ("/mag/phone", "magnetic_field", "uT"),
}
WAYPOINT = "TYPE_WAYPOINT"
_VALUES = {**dict.fromkeys(SENSORS, 3), WAYPOINT: 2}
_START = b"#\tstartTime:"

Row = tuple[int, tuple[float, ...]]


class IndoorLocationImporter:
    """Reads one trace."""

    name = "indoor-location"
    description = "traces of the Indoor Location Competition 2.0: phone sensors and waypoints"

    def sniff(self, path: Path) -> float:
        """Return 1 for a file that begins as a trace does."""
        with path.open("rb") as file:
            return 1.0 if file.read(len(_START)) == _START else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read one trace; it needs no map.

        Raises
        ------
        SchemaError
            For a map, or more than one file.
        FormatError
            Where the file is no trace, or has no accelerometer.
        """
        path = paths[0]
        if map_ is not None or len(paths) != 1:
            raise SchemaError(f"{path.name}: expected one trace and no map, found others")
        rows: dict[str, list[Row]] = {kind: [] for kind in _VALUES}
        for kind, row in _rows(path):
            rows[kind].append(row)
        if len(rows["TYPE_ACCELEROMETER"]) < 2:
            raise FormatError(f"{path.name}: expected TYPE_ACCELEROMETER lines, found none")
        found = {kind: sorted(rows[kind]) for kind in SENSORS if len(rows[kind]) > 1}
        labels = tuple(
            Label(time_ns, "waypoint", x_m=x, y_m=y) for time_ns, (x, y) in sorted(rows[WAYPOINT])
        )
        first = [(label.x_m, label.y_m) for label in labels[:1]]
        start = next(((x, y) for x, y in first if x is not None and y is not None), None)
        return Imported(
            sources=tuple(_source(path.name, kind, each) for kind, each in found.items()),
            start_ns=min(each[0][0] for each in found.values()),
            geometry=None if start is None else Geometry(start=start),
            labels=labels,
        )


def _rows(path: Path) -> Iterator[tuple[str, Row]]:
    """Yield type, time [ns] and values of the lines that count.

    Traces exist in which a line break between two events is missing: what follows the values of
    an event is left alone.
    """
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            cells = line.rstrip("\r\n").split("\t")
            count = _VALUES.get(cells[1] if len(cells) > 1 else "", 0)
            if not count:
                continue
            try:
                values = tuple(float(cell) for cell in cells[2 : 2 + count])
                time_ns = int(cells[0]) * TIME_UNITS_NS["ms"]
            except ValueError as error:
                raise FormatError(
                    f"{path.name}: line {number}: expected numbers, found: {error}"
                ) from error
            if not 0 <= time_ns < 1 << 63:
                raise FormatError(
                    f"{path.name}: line {number}: expected a unix time in ms, found {cells[0]}"
                )
            if len(values) != count:
                raise FormatError(
                    f"{path.name}: line {number}: expected {count} values, found {len(values)}"
                )
            yield cells[1], (time_ns, values)


def _source(name: str, kind: str, rows: Sequence[Row]) -> Source:
    """Return the stream of one sensor."""
    topic, quantity, unit = SENSORS[kind]
    times = np.array([time_ns for time_ns, _ in rows], np.int64)
    if times[-1] <= times[0]:
        raise FormatError(f"{name}: {kind}: expected times that go on, found one")
    timing = grid.fit(times)
    si, factor = to_quantity(quantity, unit)
    channels = tuple(Channel(f"{quantity}_{axis}", quantity, si, axis) for axis in "xyz")
    stream = Stream(topic, channels, timing.rate_hz, "phone", timing.index is None)
    values = np.array([values for _, values in rows]) * factor
    form, samples = sample_format(values)
    return stream, form, timing.blocks(stream, samples)
