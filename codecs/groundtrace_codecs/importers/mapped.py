"""From a table or archive and its map to streams: shared by the importers that need a map."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import SchemaError
from ..schemas.ros import kind_of
from ..signals import NS_PER_S, Channel, Stream
from ..units import to_quantity
from . import grid
from .api import Imported
from .orientation import orientation_labels
from .references import Reference, references

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .api import Source
    from .grid import Timing
    from .maps import ColumnMap, ImportMap, StreamMap, TimeMap

#: Nanoseconds per unit of a time column.
TIME_UNITS_NS = {"s": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}


class Table(Protocol):
    """Columns of numbers that a map names."""

    @property
    def name(self) -> str:
        """Name of the file, for messages."""
        ...

    def numbers(self, column: str | int) -> NDArray[np.float64]:
        """Return one column, shape (n,); empty cells are NaN."""
        ...

    def times_ns(self, time: TimeMap) -> NDArray[np.int64]:
        """Return the sample times [ns], shape (n,)."""
        ...

    def groups(self, path: str) -> list[Any]:
        """Return what a path leads to, one entry for each bout."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Read:
    """One stream as read: its map, timing and stored samples, shape (n, n_channels)."""

    map: StreamMap
    timing: Timing
    samples: NDArray[Any]


def import_table(table: Table, map_: ImportMap) -> Imported:
    """Return the streams and reference events of ``table`` as its map says.

    Raises
    ------
    SchemaError
        Where the table does not have what the map names.
    """
    start_ns = _start_ns(table, map_)
    reads = [_read_stream(table, map_, stream, start_ns) for stream in map_.stream]
    warnings = [w for r in reads for w in _timing_warnings(r)]
    earliest = min(int(r.timing.sample_times().min()) for r in reads)
    if earliest < 0:
        warnings.append(f"times start {-earliest} ns before the clock's zero: shifted to zero")
        reads = [_Read(r.map, r.timing.shifted(-earliest), r.samples) for r in reads]
        earliest = 0
    reference = Reference(
        table.name, earliest, reads[0].timing.sample_times(), table.numbers, table.groups
    )
    labels, remarks = references(reference, map_.truth)
    if map_.orientation is not None:
        labels = tuple(sorted((*labels, *orientation_labels(reference, map_.orientation))))
    return Imported(
        sources=tuple(_source(r) for r in reads),
        start_ns=earliest,
        labels=labels,
        warnings=(*warnings, *remarks),
    )


def sample_format(samples: NDArray[np.float64]) -> tuple[str, NDArray[Any]]:
    """Return the smallest format that keeps every value exactly, and the samples in it."""
    if np.isfinite(samples).all() and (np.rint(samples) == samples).all():
        for name, kind in (("i16le", np.int16), ("i32le", np.int32)):
            limits = np.iinfo(kind)
            if samples.size and samples.min() >= limits.min and samples.max() <= limits.max:
                return name, samples.astype(kind)
    single = samples.astype(np.float32)
    if np.array_equal(single.astype(np.float64), samples, equal_nan=True):
        return "f32le", single
    return "f64le", samples


def parse_start(text: str, place: str) -> int:
    """Return an ISO 8601 time (UTC where it has no zone) as unix time [ns].

    Raises
    ------
    SchemaError
        Where the text is no ISO 8601 time.
    """
    try:
        moment = datetime.datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise SchemaError(f"{place}: expected an ISO 8601 time, found {text[:40]!r}") from error
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    epoch = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    return (moment - epoch) // datetime.timedelta(microseconds=1) * 1000


def _start_ns(table: Table, map_: ImportMap) -> int:
    start = map_.start
    place = f"{map_.file}: start"
    if start is None:
        return 0
    if not isinstance(start, str | float | int):
        found = np.atleast_1d(table.groups(start.column)[0]).ravel()
        place = f"{table.name}: {start.column}"
        start = found[0] if found.size else ""
        start = str(start) if isinstance(start, str) else float(start)
    if isinstance(start, str):
        return parse_start(start, place)
    if not 0 <= start < 9e9:
        raise SchemaError(f"{place}: expected unix seconds, found {start}")
    return round(start * NS_PER_S)


def _read_stream(table: Table, map_: ImportMap, stream: StreamMap, start_ns: int) -> _Read:
    columns = [table.numbers(c.column) for c in stream.columns]
    lengths = sorted({len(c) for c in columns})
    if len(lengths) != 1 or lengths[0] == 0:
        raise SchemaError(
            f"{table.name}: {stream.topic}: expected columns of one length, found {lengths}"
        )
    own = stream.time is not None or stream.rate_hz is not None
    time, rate_hz = (stream.time, stream.rate_hz) if own else (map_.time, map_.rate_hz)
    if time is None:
        assert rate_hz is not None  # the map's check saw to it
        timing = grid.uniform(lengths[0], rate_hz)
    else:
        timing = _timing(table, stream.topic, time, lengths[0])
    return _Read(stream, timing.shifted(start_ns), np.stack(columns, axis=1))


def _timing(table: Table, topic: str, time: TimeMap, count: int) -> Timing:
    times_ns = table.times_ns(time)
    place = f"{table.name}: {topic}: {time.column}"
    if len(times_ns) != count:
        raise SchemaError(f"{place}: expected {count} times, found {len(times_ns)}")
    if count < 2 or not (np.diff(times_ns) > 0).any() or times_ns[-1] <= times_ns[0]:
        raise SchemaError(f"{place}: expected times that go on, found {count} that do not")
    return grid.even(times_ns) if time.even else grid.fit(times_ns)


def _timing_warnings(read: _Read) -> list[str]:
    """Return what a reader should know about the stream's times."""
    steps = np.diff(read.timing.sample_times())
    back = int((steps <= 0).sum())
    warnings = [f"{read.map.topic}: {back} samples are not later than the one before"]
    return warnings if back else []


def _source(read: _Read) -> Source:
    """Return a stream; one that fits a ROS message carries its values, others what was read."""
    stream = Stream(
        topic=read.map.topic,
        channels=_channels(read.map.columns),
        rate_hz=read.timing.rate_hz,
        placement=read.map.placement,
        irregular=read.timing.index is None,
    )
    values = read.samples
    unscaled = replace(stream, channels=tuple(replace(c, scale=1.0) for c in stream.channels))
    if kind_of(unscaled) is not None:
        values, stream = values * stream.scales, unscaled
    name, samples = sample_format(values)
    return stream, name, read.timing.blocks(stream, samples)


def _channels(columns: Sequence[ColumnMap]) -> tuple[Channel, ...]:
    """Return the channels; names that would repeat get their place in the stream appended."""
    names = [_name(c) for c in columns]
    channels = []
    for i, (column, name) in enumerate(zip(columns, names, strict=True)):
        unit, factor = to_quantity(column.quantity, column.unit)
        unique = name if names.count(name) == 1 else f"{name}_{i + 1}"
        channels.append(Channel(unique, column.quantity, unit, column.axis, column.scale * factor))
    return tuple(channels)


def _name(column: ColumnMap) -> str:
    if column.name:
        return column.name
    if isinstance(column.column, str) and re.fullmatch(r"[\w-]+", column.column):
        return column.column
    return f"{column.quantity}_{column.axis}" if column.axis else column.quantity
