"""From a table or archive and its map to streams: shared by the importers that need a map."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import SchemaError
from ..mcap.set_backs import set_backs
from ..schemas.ros import kind_of
from ..signals import NS_PER_S, Channel, Stream
from ..units import to_quantity
from . import grid, packet_counters
from .api import Imported
from .end_to_end import one_recording
from .grid import Timing
from .moments import leap_seconds, moments, parse_start
from .orientation import orientation_labels
from .references import Reference, references

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .api import ColumnMap, CounterMap, ImportMap, Source, StreamMap, TimeMap

#: Name of the metadata record that says by topic what a device's counter tells of its samples.
CLOCKS = "groundtrace.counters"
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
        """Return the sample times [ns], shape (n,), of a column of numbers."""
        ...

    def texts(self, column: str | int) -> list[str]:
        """Return the cells of a column of times in words."""
        ...

    def groups(self, path: str) -> list[Any]:
        """Return what a path leads to, one entry for each bout."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Read:
    """One stream as read.

    Attributes
    ----------
    map
        What it is.
    timing, samples
        When its samples were taken, and the samples as stored, shape (n, n_channels).
    row_times_ns
        Time of every row of the file [ns]: more than there are samples where some came twice.
    warnings, remarks
        What is to be said of its times.
    """

    map: StreamMap
    timing: Timing
    samples: NDArray[Any]
    row_times_ns: NDArray[np.int64]
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def shifted(self, by_ns: int) -> _Read:
        """Return the same stream ``by_ns`` later."""
        rows = self.row_times_ns + by_ns
        return replace(self, timing=self.timing.shifted(by_ns), row_times_ns=rows)


def import_tables(tables: Sequence[Table], map_: ImportMap) -> Imported:
    """Return what files of one map hold; several are one recording, see :mod:`.end_to_end`.

    Raises
    ------
    SchemaError
        Where a table does not have what the map names.
    """
    found = [import_table(table, map_) for table in tables]
    return one_recording(
        found, [table.name for table in tables], continuous=map_.files == "continuous"
    )


def import_table(table: Table, map_: ImportMap) -> Imported:
    """Return the streams and reference events of ``table`` as its map says.

    Raises
    ------
    SchemaError
        Where the table does not have what the map names.
    """
    start_ns = _start_ns(table, map_)
    reads = [_read_stream(table, map_, stream).shifted(start_ns) for stream in map_.stream]
    warnings = list(dict.fromkeys(w for r in reads for w in (*r.warnings, *_timing_warnings(r))))
    earliest = min(int(r.timing.sample_times().min()) for r in reads)
    if ahead_s := leap_seconds(earliest, map_.scale):
        reads = [r.shifted(-ahead_s * NS_PER_S) for r in reads]
        earliest -= ahead_s * NS_PER_S
    if earliest < 0:
        warnings.append(f"times start {-earliest} ns before the clock's zero: shifted to zero")
        reads = [r.shifted(-earliest) for r in reads]
        earliest = 0
    reference = Reference(table.name, earliest, reads[0].row_times_ns, table.numbers, table.groups)
    labels, remarks = references(reference, map_.truth)
    if map_.orientation is not None:
        labels = tuple(sorted((*labels, *orientation_labels(reference, map_.orientation))))
    clocks = {r.map.topic: "; ".join(r.remarks) for r in reads if r.remarks}
    return Imported(
        sources=tuple(_source(r) for r in reads),
        start_ns=earliest,
        labels=labels,
        metadata={CLOCKS: clocks} if clocks else {},
        warnings=(*warnings, *remarks),
        remarks=tuple(f"{topic}: {text}" for topic, text in clocks.items()),
    )


def sample_format(samples: NDArray[np.float64]) -> tuple[str, NDArray[Any]]:
    """Return the smallest format that keeps every value exactly, and the samples in it."""
    if np.isfinite(samples).all() and (np.rint(samples) == samples).all():
        for name, kind in (("i16le", np.int16), ("i32le", np.int32)):
            limits = np.iinfo(kind)
            if samples.size and samples.min() >= limits.min and samples.max() <= limits.max:
                return name, samples.astype(kind)
    with np.errstate(over="ignore"):  # what does not fit is kept as it is
        single = samples.astype(np.float32)
    if np.array_equal(single.astype(np.float64), samples, equal_nan=True):
        return "f32le", single
    return "f64le", samples


def _start_ns(table: Table, map_: ImportMap) -> int:
    start = map_.start
    place = f"{map_.file}: start"
    if start is None:
        return 0
    if not isinstance(start, str | float | int):
        found = np.atleast_1d(table.groups(start.column)[0]).ravel()
        place = f"{table.name}: {start.column}"
        start = found[0] if found.size else ""
        if not isinstance(start, str | float | int | np.number):
            raise SchemaError(f"{place}: expected ISO 8601 or unix seconds, found others")
        start = str(start) if isinstance(start, str) else float(start)
    if isinstance(start, str):
        return parse_start(start, place, map_.zone)
    if not 0 <= start < 9e9:
        raise SchemaError(f"{place}: expected unix seconds, found {start}")
    return round(start * NS_PER_S)


def _read_stream(table: Table, map_: ImportMap, stream: StreamMap) -> _Read:
    columns = [table.numbers(c.column) for c in stream.columns]
    lengths = sorted({len(c) for c in columns})
    if len(lengths) != 1 or lengths[0] == 0:
        raise SchemaError(
            f"{table.name}: {stream.topic}: expected columns of one length, found {lengths}"
        )
    samples, count = np.stack(columns, axis=1), lengths[0]
    own = stream.time is not None or stream.rate_hz is not None
    time, rate_hz = (stream.time, stream.rate_hz) if own else (map_.time, map_.rate_hz)
    times_ns: NDArray[np.int64] | None = None
    warnings: list[str] = []
    if time is not None:
        times_ns, warnings = _times(table, map_, stream.topic, time, count)
    counter = stream.counter or map_.counter
    if counter is not None:
        return _by_counter(table, stream, samples, counter, (times_ns, rate_hz), warnings)
    if time is None or times_ns is None:
        assert rate_hz is not None  # the map's check saw to it
        timing = grid.uniform(count, rate_hz)
    else:
        timing = grid.even(times_ns) if time.even else grid.fit(times_ns)
    return _Read(stream, timing, samples, timing.sample_times(), tuple(warnings))


def _by_counter(
    table: Table,
    stream: StreamMap,
    samples: NDArray[np.float64],
    counter: CounterMap,
    clock: tuple[NDArray[np.int64] | None, float | None],
    warnings: list[str],
) -> _Read:
    """Return a stream whose device counts its samples."""
    place = f"{table.name}: {stream.topic}: {counter.column}"
    values = table.numbers(counter.column)
    if len(values) != len(samples):
        raise SchemaError(f"{place}: expected {len(samples)} counts, found {len(values)}")
    found = packet_counters.count(values, counter.modulus, clock[0], place)
    timing, text = packet_counters.timed(found, *clock, place)
    rows = Timing(timing.rate_hz, timing.anchor_ns, found.of_row, None).sample_times()
    if found.resets:
        warnings.append(
            f"{stream.topic}: the counter began again {found.resets} times: what was lost there is "
            + ("told by the times only" if clock[0] is not None else "not known")
        )
    said = (f"counter {counter.column}: {found.line()}", text)
    return _Read(stream, timing, samples[found.rows], rows, tuple(warnings), said)


def _times(
    table: Table, map_: ImportMap, topic: str, time: TimeMap, count: int
) -> tuple[NDArray[np.int64], list[str]]:
    """Return the times of the rows, shape (count,) [ns], and what is to be said of them."""
    place = f"{table.name}: {topic}: {time.column}"
    remarks: list[str] = []
    if time.unit == "iso":
        where = f"{table.name}: {time.column}"
        times_ns, remarks = moments(table.texts(time.column), where, map_.zone)
    else:
        times_ns = table.times_ns(time)
    if time.wraps is not None and time.unit != "iso":
        period_ns = time.wraps * TIME_UNITS_NS[time.unit]
        times_ns, turns = packet_counters.times_going_on(times_ns, period_ns)
        if turns:
            remarks.append(f"{place}: the clock began again {turns} times: taken to go on")
    if len(times_ns) != count:
        raise SchemaError(f"{place}: expected {count} times, found {len(times_ns)}")
    back = [] if time.even else set_backs(times_ns)
    on_ns = times_ns + grid.earlier_by(back, len(times_ns))
    if count < 2 or not (np.diff(times_ns) > 0).any() or on_ns[-1] <= on_ns[0]:
        raise SchemaError(f"{place}: expected times that go on, found {count} that do not")
    return times_ns, remarks


def _timing_warnings(read: _Read) -> list[str]:
    """Return what a reader should know about the stream's times."""
    times_ns, set_back = read.timing.sample_times(), read.timing.set_back
    back = int((np.diff(times_ns) <= 0).sum()) - len(set_back)
    warnings = [f"{read.map.topic}: {line}" for line in grid.set_back_lines(set_back)]
    if back:
        warnings.append(f"{read.map.topic}: {back} samples are not later than the one before")
    return warnings


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
        channels.append(
            Channel(unique, column.quantity, unit, column.channel_axis, column.scale * factor)
        )
    return tuple(channels)


def _name(column: ColumnMap) -> str:
    if column.name:
        return column.name
    if isinstance(column.column, str) and re.fullmatch(r"[\w-]+", column.column):
        return column.column
    return f"{column.quantity}_{column.axis}" if column.axis else column.quantity
