"""Maps: TOML that says what the columns of a table or archive mean, and the import it describes.

A map is typed and checked when it is loaded. Paths lead into nested archives, such as
``data.Trial1.SU.LowerBack.Acc[:,0]`` or ``bouts[*].Start``: names joined by dots, each followed by
any number of brackets. ``[*]`` takes each element of a struct array, ``[3]`` one element, ``[:,0]``
one column of a matrix.

Events of a reference system are described by ``[[truth]]`` tables. Such systems miss contacts and
report one twice. Nothing is dropped silently: around a contact known to be missing there is an
``ignore`` span, and events nearer to each other than ``min_interval_s`` become one with a warning.

A reference orientation gives true headings and disturbances of the magnetic field. The measured
field, turned to the earth frame by the reference orientation, is constant but for disturbances. A
magnetometer answers a little later than the optical system; unless that delay is taken out, fast
turning alone looks like a disturbance.

Several files, each with one event or one part of a recording, become one recording. Files with
distinct times keep them: a hammer shot its acquisition time, a table its clock. Where times
overlap, as in files that each begin at 0, they mean nothing: the files are laid end to end in
order, with a second without samples between two, so that a replay starts each with fresh state.
"""

from __future__ import annotations

import datetime
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
import numpy as np

from ..errors import FormatError, SchemaError, did_you_mean
from ..events import TRUTH_KINDS, Label
from ..mcap.reader import set_backs
from ..schemas.ros2 import kind_of
from ..schemas.waveform import FORMATS
from ..signals import NS_PER_S, Channel, SignalBlock, Stream, to_quantity
from . import base
from . import time as time_columns
from .base import (
    CLOCKS,
    ColumnMap,
    CounterMap,
    Imported,
    ImportMap,
    OrientationMap,
    StartMap,
    StreamMap,
    TimeMap,
    Timing,
    TruthMap,
)
from .stored import Column, Computed, StoredArray, picked, pieces, stacked, steps
from .time import check_time, leap_seconds, parse_start, timestamps, zone_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from ..geometry import Geometry
    from .base import Source

    Array = NDArray[np.float64]


def load_map(path: Path) -> ImportMap:
    """Read and check a map TOML.

    Parameters
    ----------
    path
        The map.

    Raises
    ------
    SchemaError
        One line "FILE: KEY: expected X, found Y": unknown key, wrong type, unknown unit,
        quantity or kind, or a stream without time.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SchemaError(f"{path.name}: expected TOML, found: {error}") from error
    start = table.get("start")
    if isinstance(start, datetime.datetime | datetime.date):
        table["start"] = start.isoformat()
    try:
        map_ = msgspec.convert({**table, "file": path.name}, ImportMap)
    except msgspec.ValidationError as error:
        raise SchemaError(f"{path.name}: {_sentence(str(error))}") from error
    _check(map_)
    return map_


def _sentence(message: str) -> str:
    """Return msgspec's message as "KEY: expected X, found Y"."""
    what, _, where = message.partition(" - at `$")
    key = where.rstrip("`").removeprefix(".")
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", what):
        table = _TABLES.get(re.sub(r"\[\d*\]|\[\.\.\.\]", "", key))
        names = [] if table is None else [n for n in table.__struct_fields__ if n != "file"]
        return (
            f"{_join(key, unknown[1])}: expected a known key, found an unknown one"
            f"{did_you_mean(unknown[1], names)}"
        )
    if missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        return f"{_join(key, missing[1])}: expected a value, found none"
    if wrong := re.fullmatch(r"Expected `(.*)`, got `(.*)`", what):
        return f"{key}: expected {wrong[1]}, found {wrong[2]}"
    if value := re.fullmatch(r"Invalid enum value '?(.*?)'?", what):
        expected, choices = _CHOICES.get(key.rpartition(".")[2], ("another value", ()))
        return f"{key}: expected {expected}, found {value[1]!r}{did_you_mean(value[1], choices)}"
    return f"{key or 'map'}: expected a map, found: {what}"


#: What a map's tables are, by their place without indices.
_TABLES: dict[str, type[msgspec.Struct]] = {
    "": ImportMap,
    "stream": StreamMap,
    "stream.columns": ColumnMap,
    "truth": TruthMap,
    "orientation": OrientationMap,
    "start": StartMap,
    **dict.fromkeys(("time", "stream.time"), TimeMap),
    **dict.fromkeys(("counter", "stream.counter"), CounterMap),
}
#: What a key may be, in words and as a list.
_CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "axis": (
        "x, y, z or w of the sensor, or e, n or u (east, north, up)",
        ("x", "y", "z", "w", "east", "north", "up"),
    ),
    "decimal": ("'.' or ','", ()),
    "files": ("events or continuous", ("events", "continuous")),
    "missing": ("ignore or error", ("ignore", "error")),
    "scale": ("utc, gps or tai", ("utc", "gps", "tai")),
    "unit": (
        "s, ms, us, ns, iso (times of samples) or sample (times of events)",
        ("s", "ms", "us", "ns", "iso", "sample"),
    ),
}


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _check(map_: ImportMap) -> None:
    """Refuse what types cannot: units, quantities, kinds, rates, and streams without time."""
    if not map_.stream:
        raise SchemaError(f"{map_.file}: stream: expected at least one, found none")
    if map_.delimiter is not None and len(map_.delimiter) != 1:
        raise SchemaError(
            f"{map_.file}: delimiter: expected one character, found {map_.delimiter!r}"
        )
    if map_.skip_rows < 0:
        raise SchemaError(f"{map_.file}: skip_rows: expected 0 or more, found {map_.skip_rows}")
    if map_.zone:
        zone_of(map_.zone, f"{map_.file}: zone")
    topics = [s.topic for s in map_.stream]
    for i, stream in enumerate(map_.stream):
        where = f"{map_.file}: stream[{i}]"
        if not stream.topic.startswith("/") or topics.count(stream.topic) > 1:
            raise SchemaError(
                f"{where}.topic: expected a name of its own that starts with /, "
                f"found {stream.topic!r}"
            )
        _check_stream(map_, stream, where)
    for i, truth in enumerate(map_.truth):
        _check_truth(truth, f"{map_.file}: truth[{i}]")


def _check_stream(map_: ImportMap, stream: StreamMap, where: str) -> None:
    if not stream.columns:
        raise SchemaError(f"{where}.columns: expected at least one, found none")
    for j, column in enumerate(stream.columns):
        try:
            to_quantity(column.quantity, column.unit)
        except SchemaError as error:
            raise SchemaError(f"{where}.columns[{j}].{error}") from error
    check_time(map_, stream, where)


def _check_truth(truth: TruthMap, where: str) -> None:
    if truth.kind not in TRUTH_KINDS:
        raise SchemaError(
            f"{where}.kind: expected one of {', '.join(sorted(TRUTH_KINDS))}, found {truth.kind!r}"
            f"{did_you_mean(truth.kind, TRUTH_KINDS)}"
        )
    origins = (truth.time, truth.increments_of, truth.total_of)
    if sum(o is not None for o in origins) != 1:
        raise SchemaError(
            f"{where}: expected one of time, increments_of and total_of, "
            f"found {sum(o is not None for o in origins)}"
        )
    if truth.total_of is not None and truth.kind != "count":
        raise SchemaError(f"{where}.kind: expected count with total_of, found {truth.kind!r}")
    if truth.kind in ("walking", "ignore") and truth.end is None:
        raise SchemaError(f"{where}.end: expected a path, as {truth.kind} is a span, found none")


#: Nanoseconds per unit of a time column.
TIME_UNITS_NS = {"s": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}


class Table(Protocol):
    """Columns of numbers that a map names."""

    @property
    def name(self) -> str:
        """Name of the file, for messages."""
        ...

    def numbers(self, column: str | int) -> Column:
        """Return one column of n numbers; empty cells are NaN."""
        ...

    def times_ns(self, time: TimeMap) -> Column:
        """Return the n sample times [ns] of a column of numbers."""
        ...

    def texts(self, column: str | int) -> Iterable[str]:
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
        When its samples were taken, and the samples as stored, n rows of n_channels.
    row_times_ns
        Time of every row of the file [ns]: more than there are samples where some came twice.
    warnings, remarks
        What is to be said of its times.
    """

    map: StreamMap
    timing: Timing
    samples: Column
    row_times_ns: Column
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def shifted(self, by_ns: int) -> _Read:
        """Return the same stream ``by_ns`` later."""
        times_ns = self.row_times_ns
        later = Computed(len(times_ns), lambda rows: times_ns[rows] + by_ns)
        return replace(self, timing=self.timing.shifted(by_ns), row_times_ns=later)


def import_tables(tables: Sequence[Table], map_: ImportMap) -> Imported:
    """Return what files of one map hold; several are one recording, end to end.

    Raises
    ------
    SchemaError
        Where a table does not have what the map names.
    """
    imports = [import_table(table, map_) for table in tables]
    return one_recording(
        imports, [table.name for table in tables], continuous=map_.files == "continuous"
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
    earliest = min(r.timing.first_ns() for r in reads)
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


def sample_format(samples: Column) -> tuple[str, Column]:
    """Return the smallest format that keeps every value exactly, and the samples in it."""
    name = _whole_format(samples) or _real_format(samples)
    kind = np.dtype(FORMATS[name])
    if isinstance(samples, np.ndarray):
        return name, samples.astype(kind)
    return name, Computed(len(samples), lambda rows: samples[rows].astype(kind))


def _whole_format(samples: Column) -> str:
    """Return the smallest format of whole numbers that all samples fit, if they are such."""
    lowest, highest, seen = 0.0, 0.0, False
    for rows in pieces(len(samples), samples[:1].size or 1):
        part = samples[rows]
        if part.dtype.kind == "f" and not (np.isfinite(part) & (np.rint(part) == part)).all():
            return ""
        if part.size:
            lowest, highest = min(lowest, float(part.min())), max(highest, float(part.max()))
            seen = True
    for name in _WHOLE:
        limits = np.iinfo(FORMATS[name])
        if seen and lowest >= limits.min and highest <= limits.max:
            return name
    return ""


def _real_format(samples: Column) -> str:
    for rows in pieces(len(samples), samples[:1].size or 1):
        part = samples[rows].astype(np.float64)
        with np.errstate(over="ignore"):  # what does not fit is kept as it is
            single = part.astype(np.float32)
        if not np.array_equal(single.astype(np.float64), part, equal_nan=True):
            return "f64le"
    return "f32le"


#: Formats of whole numbers, the smallest first.
_WHOLE = ("i16le", "i32le")


def _common_format(names: Iterable[str]) -> str:
    """Return the smallest format that keeps what is exact in each of some."""
    formats = set(names)
    if len(formats) == 1:
        return formats.pop()
    if formats == set(_WHOLE):
        return _WHOLE[-1]
    return "f32le" if formats == {_WHOLE[0], "f32le"} else "f64le"


def _start_ns(table: Table, map_: ImportMap) -> int:
    start = map_.start
    where = f"{map_.file}: start"
    if start is None:
        return 0
    if not isinstance(start, str | float | int):
        cells = np.atleast_1d(table.groups(start.column)[0]).ravel()
        where = f"{table.name}: {start.column}"
        start = cells[0] if cells.size else ""
        if not isinstance(start, str | float | int | np.number):
            raise SchemaError(f"{where}: expected ISO 8601 or unix seconds, found others")
        start = str(start) if isinstance(start, str) else float(start)
    if isinstance(start, str):
        return parse_start(start, where, map_.zone)
    if not 0 <= start < 9e9:
        raise SchemaError(f"{where}: expected unix seconds, found {start}")
    return round(start * NS_PER_S)


def _read_stream(table: Table, map_: ImportMap, stream: StreamMap) -> _Read:
    columns = [table.numbers(c.column) for c in stream.columns]
    lengths = sorted({len(c) for c in columns})
    if len(lengths) != 1 or lengths[0] == 0:
        raise SchemaError(
            f"{table.name}: {stream.topic}: expected columns of one length, found {lengths}"
        )
    count = lengths[0]
    samples = stacked(columns)
    stream_has_time = stream.time is not None or stream.rate_hz is not None
    time, rate_hz = (stream.time, stream.rate_hz) if stream_has_time else (map_.time, map_.rate_hz)
    times_ns: Column | None = None
    warnings: list[str] = []
    if time is not None:
        times_ns, warnings = _times(table, map_, stream.topic, time, count)
    counter = stream.counter or map_.counter
    if counter is not None:
        return _by_counter(table, stream, samples, counter, (times_ns, rate_hz), warnings)
    if time is None or times_ns is None:
        assert rate_hz is not None  # the map's check saw to it
        timing = base.uniform(count, rate_hz)
    else:
        timing = base.even(times_ns) if time.even else base.fit(times_ns)
    return _Read(stream, timing, samples, timing, tuple(warnings))


def _by_counter(
    table: Table,
    stream: StreamMap,
    samples: Column,
    counter: CounterMap,
    clock: tuple[Column | None, float | None],
    warnings: list[str],
) -> _Read:
    """Return a stream whose device counts its samples; counts and times are held in memory."""
    where = f"{table.name}: {stream.topic}: {counter.column}"
    values = table.numbers(counter.column)[:]
    if len(values) != len(samples):
        raise SchemaError(f"{where}: expected {len(samples)} counts, found {len(values)}")
    host_ns = None if clock[0] is None else clock[0][:]
    counted = time_columns.count(values, counter.modulus, host_ns, where)
    timing, text = time_columns.timed(counted, host_ns, clock[1], where)
    rows = Timing(timing.rate_hz, timing.anchor_ns, counted.of_row, None)
    if counted.resets:
        warnings.append(
            f"{stream.topic}: the counter began again {counted.resets} times: what was lost there "
            + ("is told by the times only" if host_ns is not None else "is not known")
        )
    remarks = (f"counter {counter.column}: {counted.line()}", text)
    return _Read(stream, timing, picked(samples, counted.rows), rows, tuple(warnings), remarks)


def _times(
    table: Table, map_: ImportMap, topic: str, time: TimeMap, count: int
) -> tuple[Column, list[str]]:
    """Return the times of so many rows [ns], and what is to be said of them."""
    where = f"{table.name}: {topic}: {time.column}"
    remarks: list[str] = []
    times_ns: Column
    if time.unit == "iso":
        column_where = f"{table.name}: {time.column}"
        times_ns, remarks = timestamps(table.texts(time.column), column_where, map_.zone)
    else:
        times_ns = table.times_ns(time)
    if time.wraps is not None and time.unit != "iso":
        period_ns = time.wraps * TIME_UNITS_NS[time.unit]
        times_ns, turns = time_columns.times_going_on(times_ns[:], period_ns)
        if turns:
            remarks.append(f"{where}: the clock began again {turns} times: taken to go on")
    if len(times_ns) != count:
        raise SchemaError(f"{where}: expected {count} times, found {len(times_ns)}")
    back = [] if time.even else base.steps_back(times_ns)
    on_ns = base.without_set_backs(times_ns, back)
    forward = any((step > 0).any() for step in steps(times_ns))
    if count < 2 or not forward or on_ns[count - 1 :][0] <= on_ns[:1][0]:
        raise SchemaError(f"{where}: expected times that go on, found {count} that do not")
    return times_ns, remarks


def _timing_warnings(read: _Read) -> list[str]:
    """Return what a reader should know about the stream's times."""
    set_back = read.timing.set_back
    back = sum(int((step <= 0).sum()) for step in steps(read.timing)) - len(set_back)
    warnings = [f"{read.map.topic}: {line}" for line in base.set_back_lines(set_back)]
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
        scales, stream = stream.scales, unscaled
        values = Computed(len(read.samples), lambda rows: read.samples[rows] * scales)
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


#: Times further from the epoch than this are no times [ns].
MAX_NS = 2**62


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Samples of one stream in the order of the file.

    Attributes
    ----------
    topic, placement, channels
        Of the stream.
    times_ns
        Shape (n,), int64: any order, repeats allowed.
    values
        Shape (n, n_channels), as the channels' scales take them.
    """

    topic: str
    placement: str
    channels: tuple[Channel, ...]
    times_ns: NDArray[np.int64]
    values: Column

    def only(self, rows: NDArray[np.intp]) -> Sampled:
        """Return some of the samples, by their numbers, in that order."""
        return replace(self, times_ns=self.times_ns[rows], values=picked(self.values, rows))


def in_order(sampled: Sampled) -> tuple[Sampled, tuple[str, ...]]:
    """Return the samples by time without repeats, and a line for each thing that took.

    Samples that came late are put where their time says, but those after a clock was set back, of
    which the order of the file tells. Of samples with one time and the same values one is kept;
    with other values all are, for which is right is not known here.
    """
    times = sampled.times_ns
    set_back = set_backs(times)
    remarks = [f"{sampled.topic}: {line}" for line in base.set_back_lines(set_back)]
    on = times + base.earlier_by(set_back, slice(0, len(times)))
    late = int((np.diff(on) < 0).sum())
    if late:
        worst_s = float((np.maximum.accumulate(on) - on).max()) / NS_PER_S
        remarks.append(
            f"{sampled.topic}: {late} times go back, by up to {worst_s:g} s: sorted by time"
        )
        sampled = sampled.only(np.argsort(on, kind="stable"))
    same = np.diff(sampled.times_ns, prepend=sampled.times_ns[0] - 1) == 0
    if same.any():
        copies = _copies(sampled.values, same)
        sampled = sampled.only(np.flatnonzero(~copies)) if copies.any() else sampled
        if copies.any():
            remarks.append(f"{sampled.topic}: {int(copies.sum())} samples come twice: one kept")
        if others := int(same.sum() - copies.sum()):
            remarks.append(f"{sampled.topic}: {others} samples are not later than the one before")
    return sampled, tuple(remarks)


def _copies(values: Column, same: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the samples with the time of the one before have its values as well."""
    copies = np.zeros(len(same), np.bool_)
    for rows in pieces(len(same)):
        if same[rows].any():
            block = values[max(0, rows.start - 1) : rows.stop]
            equal = (block[1:] == block[:-1]) | (np.isnan(block[1:]) & np.isnan(block[:-1]))
            copies[rows.stop - len(equal) : rows.stop] = equal.all(axis=1)
    return copies & same


def together(
    streams: Sequence[Sampled],
    *,
    geometry: Geometry | None = None,
    labels: tuple[Label, ...] = (),
    warnings: tuple[str, ...] = (),
) -> Imported:
    """Return streams as one import, on one clock that starts no earlier than zero.

    Parameters
    ----------
    streams
        At least one stream, each with at least one sample.
    geometry, labels, warnings
        As in :class:`~.base.Imported`.

    Raises
    ------
    FormatError
        Where a time is out of the range of times.
    """
    for each in streams:
        if np.abs(each.times_ns).max() > MAX_NS:
            raise FormatError(f"{each.topic}: expected times within 146 years, found others")
    ordered = [in_order(each) for each in streams]
    remarks = [line for _, lines in ordered for line in lines]
    earliest = min(int(each.times_ns.min()) for each, _ in ordered)
    shift_ns = max(0, -earliest)
    if shift_ns:
        remarks.append(f"times start {shift_ns} ns before the clock's zero: shifted to zero")
    return Imported(
        sources=tuple(_sampled_source(each, shift_ns) for each, _ in ordered),
        start_ns=earliest + shift_ns,
        geometry=geometry,
        labels=labels,
        warnings=(*warnings, *remarks),
    )


def _sampled_source(sampled: Sampled, shift_ns: int) -> Source:
    times = sampled.times_ns + shift_ns
    timing = base.fit(times) if np.ptp(times) > 0 else _sampled_moment(times)
    stream = Stream(
        sampled.topic, sampled.channels, timing.rate_hz, sampled.placement, timing.index is None
    )
    form, samples = sample_format(sampled.values)
    return stream, form, timing.blocks(stream, samples)


def _sampled_moment(times_ns: NDArray[np.int64]) -> base.Timing:
    """Return the timing of samples all of one time, such as a single fix."""
    return base.Timing(1.0, int(times_ns[0]), None, times_ns)


#: The magnetometer's delay is looked for up to here [s].
LONGEST_DELAY_S = 0.05
MICROTESLA = 1e-6


def orientation_labels(reference: Reference, map_: OrientationMap) -> list[Label]:
    """Return ``heading``, ``disturbed`` and ``ignore`` labels.

    Parameters
    ----------
    reference
        Where the columns are looked up; its sample times are those of the orientation.
    map_
        What they are.

    Returns
    -------
    Headings are counter-clockwise from east [rad]. ``ignore`` stands where the reference was blind.

    Raises
    ------
    SchemaError
        Where a path leads to something of another shape.
    """
    times = reference.sample_times_ns[:]
    q = _matrix(reference, map_.quaternion, len(times), 4)
    valid = np.asarray(np.isfinite(q).all(axis=1))
    labels = list(_headings(times, q, valid, map_))
    labels += [Label(a, "ignore", b, note="no reference") for a, b in _spans(times, ~valid)]
    if map_.field is not None:
        _, factor = to_quantity("magnetic_field", map_.field_unit)
        field = _matrix(reference, map_.field, len(times), 3) * factor / MICROTESLA
        labels += _disturbances(times, q, field, map_)
    return labels


def _matrix(reference: Reference, path: str, rows: int, columns: int) -> Array:
    matrix = np.asarray(reference.groups(path)[0], np.float64)
    if matrix.shape != (rows, columns):
        raise SchemaError(
            f"{reference.name}: {path}: expected {rows} rows of {columns}, found {matrix.shape}"
        )
    return matrix


def _headings(
    times: NDArray[np.int64], q: Array, valid: NDArray[np.bool_], map_: OrientationMap
) -> Iterator[Label]:
    """Yield headings at even distances, none where the axis is too steep."""
    unit = np.eye(3)["xyz".index(map_.axis[-1])] * (-1 if map_.axis[0] == "-" else 1)
    every_ns = map_.every_s * NS_PER_S
    rows = np.unique(np.searchsorted(times, np.arange(times[0], times[-1] + 1, every_ns)))
    rows = rows[(rows < len(times))]
    pointing = rotated(q[rows], np.broadcast_to(unit, (len(rows), 3)))
    usable = valid[rows] & (np.abs(pointing[:, 2]) <= np.sin(np.radians(map_.steepest_deg)))
    heading = np.arctan2(pointing[:, 1], pointing[:, 0])
    for row, angle in zip(rows[usable].tolist(), heading[usable].tolist(), strict=True):
        yield Label(int(times[row]), "heading", value=angle)


def _disturbances(
    times: NDArray[np.int64], q: Array, field: Array, map_: OrientationMap
) -> list[Label]:
    """Return where the averaged field is off its median in the earth frame."""
    period_s = float(np.median(np.diff(times))) / NS_PER_S
    longest = round(LONGEST_DELAY_S / period_s)
    best = min(range(longest + 1), key=lambda late: _unrest(_earth(q, field, late)))
    earth = _earth(q, field, best)
    off = earth - np.nanmedian(earth, axis=0)
    width = max(1, round(map_.average_s / period_s))
    size = np.linalg.norm(_averaged(off, width), axis=1)
    with np.errstate(invalid="ignore"):
        disturbed = size > map_.disturbed_ut
    return [
        Label(a, "disturbed", b, value=float(np.nanmax(size[i:j])) * MICROTESLA)
        for (i, j), (a, b) in zip(_rows(disturbed), _spans(times, disturbed), strict=True)
    ]


def _earth(q: Array, field: Array, late: int) -> Array:
    """Return the field in the earth frame, of a magnetometer that is ``late`` samples behind."""
    out = np.full_like(field, np.nan)
    out[: len(q) - late] = rotated(q[: len(q) - late], field[late:])
    return out


def _unrest(earth: Array) -> float:
    """Return how much the field moves about its median, whatever a magnet does to a part of it."""
    off = np.abs(earth - np.nanmedian(earth, axis=0))
    return float(np.nanmedian(off, axis=0).sum())


def _averaged(values: Array, width: int) -> Array:
    """Return centred means over ``width`` rows, of those that are known."""
    valid = np.isfinite(values)
    ones = np.ones(width)
    sums = [np.convolve(c, ones, "same") for c in np.where(valid, values, 0.0).T]
    counts = np.convolve(valid[:, 0], ones, "same")
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.stack(sums, axis=1) / counts[:, None]
    return np.where(valid, means, np.nan)


def _rows(true: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the half-open runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _spans(times: NDArray[np.int64], true: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the half-open spans [ns] of runs of True."""
    after = int(times[-1] + np.median(np.diff(times)))
    return [(int(times[a]), int(times[b]) if b < len(times) else after) for a, b in _rows(true)]


def rotated(q: Array, vectors: Array) -> Array:
    """Return vectors, shape (n, 3), rotated by unit quaternions (w, x, y, z), shape (n, 4)."""
    w, u = q[:, :1], q[:, 1:]
    twice = 2 * np.cross(u, vectors)
    return np.asarray(vectors + w * twice + np.cross(u, twice))


_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Times are further from the first sample than this in no file [s].
_LONGEST_S = 2**62 / NS_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where reference events are looked up.

    Attributes
    ----------
    name
        Of the file, for messages.
    start_ns
        Time of the recording's first sample [ns].
    sample_times_ns
        Of the first stream, n of them [ns].
    numbers, groups
        Look up a column, or a path with one entry for each bout.
    """

    name: str
    start_ns: int
    sample_times_ns: Column
    numbers: Callable[[str | int], Column]
    groups: Callable[[str], list[Any]]


def references(
    reference: Reference, truths: Sequence[TruthMap]
) -> tuple[tuple[Label, ...], tuple[str, ...]]:
    """Return the labels of all ``[[truth]]`` tables in time order, and warnings.

    Raises
    ------
    SchemaError
        Where a path leads nowhere, or a time is missing that may not be.
    """
    labels: list[Label] = []
    warnings: list[str] = []
    for truth in truths:
        if truth.increments_of is not None:
            labels += _increments(reference, truth)
        elif truth.total_of is not None:
            labels += _total(reference, truth)
        else:
            for bout in _bouts(reference, truth):
                events, remarks = _rules(bout, truth, reference)
                labels += events
                warnings += remarks
    return tuple(sorted(labels, key=lambda label: (label.time_ns, label.kind))), tuple(warnings)


def _increments(reference: Reference, truth: TruthMap) -> list[Label]:
    """Return one event for each unit a running count grows by, at the row where it does."""
    assert truth.increments_of is not None
    counts = reference.numbers(truth.increments_of)[:]
    filled = np.flatnonzero(np.isfinite(counts))
    if len(counts) != len(reference.sample_times_ns) or not filled.size:
        raise SchemaError(
            f"{reference.name}: {truth.increments_of}: expected a count in the rows of the first "
            f"stream, found {len(counts)} cells"
        )
    grown = np.diff(counts[filled])
    rows = np.repeat(filled[1:], np.maximum(grown, 0).astype(np.int64))
    return [Label(int(t), truth.kind) for t in reference.sample_times_ns[:][rows]]


def _total(reference: Reference, truth: TruthMap) -> list[Label]:
    """Return the count over the whole recording, its end one period after the last sample."""
    assert truth.total_of is not None
    cells = reference.numbers(truth.total_of)[:]
    filled = cells[np.isfinite(cells)]
    if filled.size != 1:
        raise SchemaError(
            f"{reference.name}: {truth.total_of}: expected one filled cell, found {filled.size}"
        )
    times = reference.sample_times_ns[:]
    end_ns = int(times.max()) + int(np.median(np.diff(times)))
    return [Label(int(times.min()), truth.kind, end_ns, value=float(filled[0]))]


def _bouts(reference: Reference, truth: TruthMap) -> list[list[Label | None]]:
    """Return the events of each bout, None where the reference has no time."""
    assert truth.time is not None
    times = reference.groups(truth.time)
    columns = {
        name: reference.groups(path)
        for name in ("end", "label", "value", "x", "y")
        if (path := getattr(truth, name)) is not None
    }
    bouts = []
    for b, bout in enumerate(times):
        cells = {
            name: np.atleast_1d(groups[b])
            if name == "label"
            else _numbers(groups[b], reference, getattr(truth, name))
            for name, groups in columns.items()
        }
        moments = _numbers(bout, reference, truth.time)
        wrong = [n for n, c in cells.items() if len(c) != len(moments)]
        if wrong:
            raise SchemaError(
                f"{reference.name}: {getattr(truth, wrong[0])}: expected {len(moments)} cells, "
                f"found {len(cells[wrong[0]])}"
            )
        bouts.append(
            [
                _label(truth, reference, float(t), {n: c[i] for n, c in cells.items()})
                for i, t in enumerate(moments)
            ]
        )
    return bouts


def _numbers(cells: Any, reference: Reference, path: str) -> NDArray[np.float64]:
    try:
        return np.atleast_1d(np.asarray(cells, np.float64)).ravel()
    except (ValueError, TypeError) as error:
        raise SchemaError(f"{reference.name}: {path}: expected numbers, found: {error}") from error


def _label(
    truth: TruthMap, reference: Reference, time: float, cells: dict[str, Any]
) -> Label | None:
    """Return one event, or None where its time is NaN."""
    ends = [float(cells["end"])] if "end" in cells else []
    if not np.isfinite([time, *ends]).all():
        return None
    number = {n: float(cells[n]) for n in ("value", "x", "y") if n in cells}
    return Label(
        time_ns=_reference_moment(truth, reference, time),
        kind=truth.kind,
        end_ns=_reference_moment(truth, reference, ends[0]) if ends else None,
        x_m=number["x"] * truth.x_scale if "x" in number else None,
        y_m=number["y"] * truth.y_scale if "y" in number else None,
        value=number.get("value"),
        label=str(cells.get("label", "")).strip().lower(),
    )


def _reference_moment(truth: TruthMap, reference: Reference, time: float) -> int:
    """Return a time of the file on the recording's clock [ns]."""
    if truth.unit != "sample":
        later_s = time * _UNITS_S[truth.unit]
        if abs(later_s) > _LONGEST_S:
            raise SchemaError(
                f"{reference.name}: {truth.time}: expected a time within 146 years, found {time:g}"
            )
        return reference.start_ns + round(later_s * NS_PER_S)
    index = round(time)
    if not 0 <= index < len(reference.sample_times_ns):
        raise SchemaError(
            f"{reference.name}: {truth.time}: expected a sample below "
            f"{len(reference.sample_times_ns)}, found {index}"
        )
    return int(reference.sample_times_ns[index : index + 1][0])


def _rules(
    bout: list[Label | None], truth: TruthMap, reference: Reference
) -> tuple[list[Label], list[str]]:
    """Return a bout's events after merging, with ``ignore`` where one is known to be missing."""
    if truth.missing == "error" and None in bout:
        raise SchemaError(f"{reference.name}: {truth.time}: expected times, found NaN")
    merged: list[Label] = []
    ignored: list[Label] = []
    warnings: list[str] = []
    missing = False
    for event in bout:
        if event is None:
            missing = True
            continue
        last = merged[-1] if merged else None
        if last is not None and _near(last, event, truth):
            merged[-1], warning = _merge(last, event, reference)
            warnings.append(warning)
            continue
        if last is not None and (missing or _same_foot(last, event, truth)):
            why = "no time for a contact" if missing else f"two contacts {event.label} in a row"
            ignored += _ignore(last, event, truth, why)
        missing = False
        merged.append(event)
    return merged + ignored, warnings + [_ignore_warning(label, reference) for label in ignored]


def _near(last: Label, event: Label, truth: TruthMap) -> bool:
    return event.time_ns - last.time_ns < truth.min_interval_s * NS_PER_S


def _same_foot(last: Label, event: Label, truth: TruthMap) -> bool:
    return truth.alternating and last.label == event.label != ""


def _merge(last: Label, event: Label, reference: Reference) -> tuple[Label, str]:
    """Return two events too near to be two as one; its foot is known only where they agree."""
    apart_ms = (event.time_ns - last.time_ns) / 1e6
    at_s = (last.time_ns - reference.start_ns) / NS_PER_S
    note = f"two in the reference, {apart_ms:g} ms apart"
    foot = last.label if last.label == event.label else ""
    return (
        replace(last, label=foot, note=note),
        f"{last.kind} at {at_s:.3f} s: {note}: taken as one",
    )


def _ignore(last: Label, event: Label, truth: TruthMap, why: str) -> list[Label]:
    margin_ns = round(truth.margin_s * NS_PER_S)
    span = (last.time_ns + margin_ns, event.time_ns - margin_ns)
    return [Label(span[0], "ignore", span[1], note=why)] if span[0] < span[1] else []


def _ignore_warning(label: Label, reference: Reference) -> str:
    assert label.end_ns is not None
    span = [(t - reference.start_ns) / NS_PER_S for t in (label.time_ns, label.end_ns)]
    return f"ignore {span[0]:.3f} to {span[1]:.3f} s: {label.note} in the reference"


_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[([^\[\]]*)\]")


def evaluate(root: Any, path: str, where: str) -> list[Any]:
    """Return what ``path`` leads to, one entry for each element of its ``[*]``.

    Parameters
    ----------
    root
        Nested mappings and arrays.
    path
        As the module describes.
    where
        Start of error messages.

    Raises
    ------
    SchemaError
        Where the path is no path or leads nowhere; names the step that failed.
    """
    entries: list[Any] = [root]
    position = 0
    while position < len(path):
        step = _STEP.match(path, position)
        if step is None:
            raise SchemaError(
                f"{where}: {path}: expected a name or [index] at {path[position:]!r}, found neither"
            )
        taken = f"{where}: {path[: step.end()]}"
        if step[1] is not None:
            entries = [_member(value, step[1], taken) for value in entries]
        elif step[2] == "*":
            entries = [element for value in entries for element in np.atleast_1d(value)]
        else:
            entries = [_indexed(value, step[2], taken) for value in entries]
        position = step.end()
    return entries


def column(root: Any, path: str, where: str) -> Column:
    """Return the numbers ``path`` leads to as one column of n rows, float64.

    Raises
    ------
    SchemaError
        Where the path leads to something else than one vector of numbers.
    """
    entries = evaluate(root, path, where)
    if len(entries) == 1 and isinstance(entries[0], StoredArray):
        stored = entries[0].column()
        if stored is None or stored.of.dtype.kind not in "biuf":
            raise SchemaError(
                f"{where}: {path}: expected one column of numbers, found {entries[0].dtype} of "
                f"shape {entries[0].shape}"
            )
        return Computed(len(stored), lambda rows: stored[rows].astype(np.float64))
    try:
        values = np.squeeze(np.asarray(entries[0] if len(entries) == 1 else entries))
        if values.ndim > 1 or np.iscomplexobj(values):
            raise SchemaError(
                f"{where}: {path}: expected one column of numbers, found shape {values.shape}"
            )
        return np.atleast_1d(values).astype(np.float64)
    except (ValueError, TypeError) as error:
        raise SchemaError(f"{where}: {path}: expected numbers, found: {error}") from error


def _member(value: Any, name: str, where: str) -> Any:
    """Return a field of a mapping or struct."""
    fields = value if isinstance(value, Mapping) else {}
    if name not in fields:
        names = sorted(n for n in fields if not n.startswith("_"))
        raise SchemaError(f"{where}: expected one of {', '.join(names) or 'no names'}, found none")
    return fields[name]


def _indexed(value: Any, text: str, where: str) -> Any:
    """Return an element or column of an array; the text holds integers and ``:``."""
    parts = [p.strip() for p in text.split(",")]
    if not all(p == ":" or re.fullmatch(r"-?\d+", p) for p in parts):
        raise SchemaError(f"{where}: expected [*], [i] or [:,j], found [{text}]")
    index = tuple(slice(None) if p == ":" else int(p) for p in parts)
    try:
        return value.at(index) if isinstance(value, StoredArray) else np.atleast_1d(value)[index]
    except IndexError as error:
        raise SchemaError(f"{where}: expected an index inside the array, found: {error}") from error


#: Time without samples between two files that are laid end to end [s].
GAP_S = 1.0


@dataclass(frozen=True, slots=True)
class Part:
    """What one file takes of the time.

    Attributes
    ----------
    name
        Of the file.
    start_ns, end_ns
        First sample and one period after the last, by the file's own time [ns].
    """

    name: str
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class Laid:
    """Where files lie in one recording.

    Attributes
    ----------
    order
        Of the files, by their places in what was given.
    starts_ns
        First sample of each file, in that order [ns].
    note
        One line: whose times these are.
    own_times
        True where these are the files' own times.
    """

    order: tuple[int, ...]
    starts_ns: tuple[int, ...]
    note: str
    own_times: bool


def lay_out(parts: Sequence[Part], what: str, gap_s: float = GAP_S) -> Laid:
    """Return where files lie: at their own times, or end to end where these overlap.

    Parameters
    ----------
    parts
        The files, at least one, in the order to lay them in.
    what
        What a file is, for the note, such as ``shots``.
    gap_s
        Time between two that are laid end to end [s].
    """
    order = sorted(range(len(parts)), key=lambda i: parts[i].start_ns)
    for before, after in pairwise(order):
        if parts[after].start_ns < parts[before].end_ns:
            names = f"{parts[before].name} and {parts[after].name}"
            break
    else:
        starts = tuple(parts[i].start_ns for i in order)
        note = f"{len(parts)} {what}: each keeps its own time"
        return Laid(tuple(order), starts, note, own_times=True)
    starts_ns = [parts[0].start_ns]
    for part in parts[:-1]:
        starts_ns.append(starts_ns[-1] + part.end_ns - part.start_ns + round(gap_s * NS_PER_S))
    apart = f"{gap_s:g} s apart" if gap_s else "without a gap"
    return Laid(
        tuple(range(len(parts))),
        tuple(starts_ns),
        f"{len(parts)} {what}: laid end to end, {apart}: the times of {names} overlap",
        own_times=False,
    )


def one_recording(
    imports: Sequence[Imported], names: Sequence[str], *, continuous: bool = False
) -> Imported:
    """Return what several files of one map hold as one recording, each with its labels.

    Parameters
    ----------
    imports
        What each file holds: the same topics and channels.
    names
        Of the files.
    continuous
        True: the files are parts of one recording, each goes on where the one before ends.

    Raises
    ------
    SchemaError
        Where the files differ in rate so much that one of them is no recording of the same device.
    """
    if len(imports) == 1:
        return imports[0]
    parts = [
        Part(name, each.start_ns, max(b.end_ns for _, _, blocks in each.sources for b in blocks))
        for name, each in zip(names, imports, strict=True)
    ]
    laid = lay_out(parts, "files", 0.0 if continuous else GAP_S)
    shifts = [
        start - parts[i].start_ns for i, start in zip(laid.order, laid.starts_ns, strict=True)
    ]
    sources: list[Source] = []
    for at in range(len(imports[0].sources)):
        read = [imports[i].sources[at] for i in laid.order]
        stream = _common([s for s, _, _ in read], [names[i] for i in laid.order])
        form = _common_format(name for _, name, _ in read)
        moved = _Moved([b for _, _, b in read], shifts, stream, form, laid.starts_ns[0])
        sources.append((stream, form, moved))
    return Imported(
        sources=tuple(sources),
        start_ns=laid.starts_ns[0],
        labels=tuple(
            label.later(by_ns)
            for i, by_ns in zip(laid.order, shifts, strict=True)
            for label in imports[i].labels
        ),
        metadata=_records(imports, names),
        warnings=tuple(dict.fromkeys(w for each in imports for w in each.warnings)),
        remarks=(laid.note, *dict.fromkeys(r for each in imports for r in each.remarks)),
        files=tuple((names[i], start) for i, start in zip(laid.order, laid.starts_ns, strict=True)),
    )


@dataclass(frozen=True, slots=True)
class _Moved:
    """The blocks of several files, each by so much later, as one stream of one format."""

    blocks: Sequence[Iterable[SignalBlock]]
    by_ns: Sequence[int]
    stream: Stream
    form: str
    origin_ns: int

    def __iter__(self) -> Iterator[SignalBlock]:
        kind = np.dtype(FORMATS[self.form])
        for blocks, by_ns in zip(self.blocks, self.by_ns, strict=True):
            for block in blocks:
                moved = shifted(block, self.stream, by_ns, self.origin_ns)
                yield replace(moved, samples=moved.samples.astype(kind))


def shifted(block: SignalBlock, stream: Stream, by_ns: int, origin_ns: int) -> SignalBlock:
    """Return a block of ``stream`` ``by_ns`` later, counted from the stream's origin.

    A block of an irregular stream carries the times of its samples.
    """
    if stream.irregular:
        return SignalBlock(stream, origin_ns, 0, block.samples, block.sample_times() + by_ns)
    begin_ns = block.anchor_ns + by_ns  # of the run: all its blocks go on as they did
    before = round((begin_ns - origin_ns) * stream.rate_hz / NS_PER_S)
    anchor_ns = begin_ns - round(before * NS_PER_S / stream.rate_hz)
    return SignalBlock(stream, anchor_ns, before + block.first, block.samples)


def _common(streams: Sequence[Stream], names: Sequence[str]) -> Stream:
    """Return the stream that all are: of one rate, or irregular where their rates differ."""
    first = streams[0]
    for stream, name in zip(streams, names, strict=True):
        if not 0.5 < stream.rate_hz / first.rate_hz < 2:
            raise SchemaError(
                f"{name}: {stream.topic}: expected about {first.rate_hz:g} Hz as in {names[0]}, "
                f"found {stream.rate_hz:g} Hz"
            )
    if all(s.rate_hz == first.rate_hz and not s.irregular for s in streams):
        return first
    rate_hz = float(np.median([s.rate_hz for s in streams]))
    return replace(first, rate_hz=rate_hz, irregular=True)


def _records(imports: Sequence[Imported], names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the metadata of all files; of several with one key, each says its file."""
    records: dict[str, dict[str, str]] = {}
    for each, name in zip(imports, names, strict=True):
        for record, pairs in each.metadata.items():
            merged = records.setdefault(record, {})
            for key, text in pairs.items():
                line = f"{name}: {text}"
                merged[key] = f"{merged[key]}; {line}" if key in merged else line
    return records
