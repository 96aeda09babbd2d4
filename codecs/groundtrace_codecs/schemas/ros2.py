"""ROS 2 messages: their definitions, CDR payloads as columns, and the streams they hold.

Definitions are parsed from the text of the MCAP specification's ``ros2msg`` schema encoding:
definitions separated by a line of ``=``, each but the first opened by ``MSG: package/Type``. The
schemas that groundtrace writes have the fields and constants of the ROS 2 packages std_msgs,
geometry_msgs and sensor_msgs of Jazzy, without their comments: the types have the same hash (REP
2016).

The layout of a message's bytes is fixed once the lengths of its strings and sequences are. It is
walked once; every following message of the same lengths is read, and written, by numpy views at the
same offsets. Alignment counts from the body, four bytes after the start (OMG DDSI-RTPS 2.3, chapter
10; encapsulations CDR_BE and CDR_LE).

Streams are recognised by the embedded schema alone: the five ``sensor_msgs`` below, and any message
that contains one of them, also in one array. A message of another type with a latitude and a
longitude is taken for a position. A sample's time is the stamp of its own header where that is
non-zero, else of the nearest enclosing one, else the message's log time.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import CodecError, FormatError, SchemaError
from ..signals import ACCURACY_SIGMAS, NS_PER_S, Channel, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

_HEADER = 4
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_ENCAPSULATIONS = {order: np.void(head) for head, order in _ORDERS.items()}


class FieldSpan(NamedTuple):
    """Where a field's values lie in a payload: offset, how many, and their numpy type.

    A string's type is ``str``, and its number that of its bytes.
    """

    offset: int
    number: int
    dtype: str


class Layout:
    """Where everything lies in payloads of given lengths.

    Parameters
    ----------
    order
        ``<`` or ``>``.
    size
        Of a payload [bytes].
    lengths
        Offset and value of every length field: what makes two payloads of one layout.
    places
        Path to places, one per element of the array of messages it lies in. Paths join names with
        dots; ``[]`` follows the name of an array of messages: ``samples[].header.stamp.sec``.
    """

    def __init__(
        self,
        order: str,
        size: int,
        lengths: Sequence[tuple[int, int]],
        places: dict[str, list[FieldSpan]],
    ) -> None:
        self.places = places
        self._encapsulation = _ENCAPSULATIONS[order]
        self._lengths = [(f"#{i}", value) for i, (_, value) in enumerate(lengths)]
        self._columns: dict[str, list[str]] = {}
        fields: dict[str, tuple[int, Any]] = {"#": (0, "V2")}
        fields |= {f"#{i}": (offset, f"{order}u4") for i, (offset, _) in enumerate(lengths)}
        for path, spans in places.items():
            solid = [p for p in spans if p.number and p.dtype != "str"]
            names = [path if len(solid) == 1 else f"{path}#{i}" for i in range(len(solid))]
            self._columns[path] = names
            fields |= {n: (p.offset, _subarray(p)) for n, p in zip(names, solid, strict=True)}
        self.dtype = np.dtype(
            {
                "names": list(fields),
                "offsets": [offset for offset, _ in fields.values()],
                "formats": [dtype for _, dtype in fields.values()],
                "itemsize": size,
            }
        )

    def fits(self, payloads: NDArray[np.void]) -> NDArray[np.bool_]:
        """Tell which payloads, all of the layout's size, have it; shape (n,)."""
        records = payloads.view(self.dtype)
        same: NDArray[np.bool_] = records["#"] == self._encapsulation
        for name, value in self._lengths:
            same &= records[name] == value
        return same

    def names(self, path: str) -> list[str]:
        """Return the names of the fields of ``dtype`` at a path, in order; often one."""
        return self._columns.get(path, [])


def _subarray(span: FieldSpan) -> Any:
    return span.dtype if span.number == 1 else (span.dtype, (span.number,))


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Payloads of one layout as a structured array, shape (n_messages,), by column."""

    layout: Layout
    records: NDArray[np.void]

    def column(self, path: str) -> NDArray[Any]:
        """Return a field of every message, shape (n_messages, values per message)."""
        count = len(self.records)
        columns = [self.records[n].reshape(count, -1) for n in self.layout.names(path)]
        if len(columns) == 1:
            return columns[0]
        return np.concatenate(columns, axis=1) if columns else np.empty((count, 0))

    def put(self, path: str, values: NDArray[Any]) -> None:
        """Write a field of every message; ``values`` has the shape ``column`` returns."""
        done = 0
        for name in self.layout.names(path):
            field = self.records[name].reshape(len(self.records), -1)
            field[...] = values[:, done : done + field.shape[1]]
            done += field.shape[1]

    def payloads(self) -> list[bytes]:
        """Return the messages."""
        size = self.records.itemsize
        data = self.records.view(f"V{size}").tobytes()
        return [data[i : i + size] for i in range(0, len(data), size)]


class _Walk:
    """One pass over one payload, noting where everything lies."""

    def __init__(self, data: bytes | memoryview, where: str) -> None:
        self._data = memoryview(data)
        self._where = where
        order = _ORDERS.get(bytes(self._data[:2]))
        if order is None or len(data) < _HEADER:
            header = bytes(self._data[:_HEADER]).hex() or "nothing"
            raise FormatError(f"{where}: expected a CDR encapsulation 0000 or 0001, found {header}")
        self._order = order
        self._byteorder: Any = "little" if order == "<" else "big"
        self._at = _HEADER
        self._lengths: list[tuple[int, int]] = []
        self._places: dict[str, list[FieldSpan]] = {}

    def layout(self, definition: Definition) -> Layout:
        self._need(definition.min_size, definition.name)
        self._message(definition, "")
        return Layout(self._order, len(self._data), self._lengths, self._places)

    def _need(self, size: int, path: str) -> None:
        if size > len(self._data) - self._at:
            raise FormatError(
                f"{self._where}: {path}: expected {size} bytes at {self._at}, "
                f"found {len(self._data) - self._at}"
            )

    def _align(self, size: int) -> None:
        self._at += -(self._at - _HEADER) % size

    def _message(self, definition: Definition, prefix: str) -> None:
        for member in definition.fields:
            self._field(member, prefix + member.name)

    def _field(self, field: Field, path: str) -> None:
        count = self._count(field, path)
        self._need(count * field.min_size, path)
        if field.message is not None:
            many = field.sequence or field.count is not None
            for _ in range(count):
                self._message(field.message, f"{path}[]." if many else f"{path}.")
        elif field.primitive == "str":
            for _ in range(count):
                length = self._length(path)
                self._note(path, length, "str")
        elif count:
            self._align(int(field.primitive[1]))
            self._note(path, count, self._order + field.primitive)
        else:
            self._places.setdefault(path, [])

    def _count(self, field: Field, path: str) -> int:
        if not field.sequence:
            return 1 if field.count is None else field.count
        count = self._length(path)
        if field.longest is not None and count > field.longest:
            raise FormatError(
                f"{self._where}: {path}: expected at most {field.longest} elements, found {count}"
            )
        return count

    def _length(self, path: str) -> int:
        self._align(4)
        self._need(4, path)
        length = int.from_bytes(self._data[self._at : self._at + 4], self._byteorder)
        self._lengths.append((self._at, length))
        self._at += 4
        return length

    def _note(self, path: str, count: int, dtype: str) -> None:
        size = count if dtype == "str" else count * int(dtype[2])
        self._need(size, path)
        self._places.setdefault(path, []).append(FieldSpan(self._at, count, dtype))
        self._at += size


class CdrDecoder:
    """Decodes payloads of one message type.

    Parameters
    ----------
    definition
        Of the message.
    where
        Named in errors.
    """

    def __init__(self, definition: Definition, where: str = "CDR") -> None:
        self.definition = definition
        self._where = where
        self._layouts: dict[int, Layout] = {}

    def layout(self, payload: bytes | memoryview) -> Layout:
        """Return where everything lies in one payload.

        Raises
        ------
        FormatError
            Where the payload ends early, is no plain CDR, or a length exceeds what is left.
        """
        return _Walk(payload, self._where).layout(self.definition)

    def decode(self, payload: bytes | memoryview) -> dict[str, list[Any]]:
        """Decode one message: path to its values; strings come as ``str``.

        Raises
        ------
        FormatError
            As :meth:`layout`.
        """
        layout = self.layout(payload)
        table = Table(layout, np.frombuffer(payload, layout.dtype))
        return {
            path: [_text(payload, p) for p in places if p.dtype == "str"]
            or table.column(path)[0].tolist()
            for path, places in layout.places.items()
        }

    def tables(
        self, by_size: Iterable[tuple[NDArray[np.intp], NDArray[np.void]]]
    ) -> Iterator[tuple[NDArray[np.intp], Table]]:
        """Yield messages in groups of one layout, with the index of each message.

        Parameters
        ----------
        by_size
            Payloads of one size, shape (n,), and the index of each, size by size.

        Raises
        ------
        FormatError
            As :meth:`layout`.
        """
        for rows, payloads in by_size:
            yield from self._split(rows, payloads)

    def _split(
        self, rows: NDArray[np.intp], payloads: NDArray[np.void]
    ) -> Iterator[tuple[NDArray[np.intp], Table]]:
        size = payloads.itemsize
        while len(rows):
            layout = self._layouts.get(size)
            if layout is None or not layout.fits(payloads[:1])[0]:
                layout = self._layouts[size] = self.layout(payloads[:1].tobytes())
            same = layout.fits(payloads)
            if same.all():
                yield rows, Table(layout, payloads.view(layout.dtype))
                return
            yield rows[same], Table(layout, payloads[same].view(layout.dtype))
            payloads, rows = payloads[~same], rows[~same]


def _text(payload: bytes | memoryview, span: FieldSpan) -> str:
    raw = bytes(payload[span.offset : span.offset + span.number])
    return raw.removesuffix(b"\0").decode("utf-8", "replace")


class CdrTemplate:
    """Writes little-endian messages of one type whose strings and lengths are fixed.

    Parameters
    ----------
    definition
        Of the message.
    texts
        Path to the strings there, in order; others are empty.
    lengths
        Path to the number of elements of a sequence; others are empty.
    """

    def __init__(
        self,
        definition: Definition,
        texts: Mapping[str, Sequence[str]] | None = None,
        lengths: Mapping[str, int] | None = None,
    ) -> None:
        self._texts = {path: list(t) for path, t in (texts or {}).items()}
        self._lengths = lengths or {}
        self._body = bytearray()
        self._message(definition, "")
        self._blank = b"\x00\x01\x00\x00" + bytes(self._body)
        self._layout = CdrDecoder(definition).layout(self._blank)

    def table(self, count: int) -> Table:
        """Return ``count`` messages, all zero but for the strings and lengths, to be filled."""
        # A view of bytes, never a copy: copies of records leave out what lies between the fields.
        return Table(
            self._layout, np.frombuffer(bytearray(self._blank * count), self._layout.dtype)
        )

    def _align(self, size: int) -> None:
        self._body.extend(bytes(-len(self._body) % size))

    def _number(self, value: int) -> None:
        self._align(4)
        self._body.extend(value.to_bytes(4, "little"))

    def _message(self, definition: Definition, prefix: str) -> None:
        for member in definition.fields:
            self._field(member, prefix + member.name)

    def _field(self, field: Field, path: str) -> None:
        count = 1 if field.count is None else field.count
        if field.sequence:
            count = self._lengths.get(path, 0)
            self._number(count)
        if field.message is not None:
            many = field.sequence or field.count is not None
            for _ in range(count):
                self._message(field.message, f"{path}[]." if many else f"{path}.")
        elif field.primitive == "str":
            for _ in range(count):
                texts = self._texts.get(path)
                text = (texts.pop(0) if texts else "").encode() + b"\0"
                self._number(len(text))
                self._body.extend(text)
        elif count:
            size = int(field.primitive[1])
            self._align(size)
            self._body.extend(bytes(size * count))


_LAST_STAMP_S = (1 << 31) - 1
_IMU = "sensor_msgs/Imu"
_IMU_PARTS = ("orientation", "angular_velocity", "linear_acceleration")


def _axes(path: str, name: str, quantity: str, unit: str) -> tuple[tuple[str, Channel], ...]:
    return tuple((f"{path}.{a}", Channel(f"{name}_{a}", quantity, unit, a)) for a in "xyz")


#: Message to the paths of its samples and what they are.
KINDS: dict[str, tuple[tuple[str, Channel], ...]] = {
    _IMU: (
        *_axes("linear_acceleration", "acc", "acceleration", "m/s2"),
        *_axes("angular_velocity", "gyro", "angular_velocity", "rad/s"),
    ),
    "sensor_msgs/MagneticField": _axes("magnetic_field", "mag", "magnetic_field", "T"),
    "sensor_msgs/FluidPressure": (("fluid_pressure", Channel("pressure", "pressure", "Pa")),),
    "sensor_msgs/Temperature": (("temperature", Channel("temperature", "temperature", "degC")),),
    "sensor_msgs/NavSatFix": (
        ("latitude", Channel("latitude", "latitude", "deg")),
        ("longitude", Channel("longitude", "longitude", "deg")),
        ("altitude", Channel("altitude", "altitude", "m")),
    ),
}
_COVARIANCE = "position_covariance"
#: What a message may tell besides, by a field that is no number.
BESIDES: dict[str, tuple[tuple[str, Channel], ...]] = {
    "sensor_msgs/NavSatFix": (
        (_COVARIANCE, Channel("horizontal_accuracy", "horizontal_accuracy", "m")),
    ),
}
#: sensor_msgs/NavSatFix: nobody knows the covariance, or it is roughly known.
_UNKNOWN, _APPROXIMATED = 0, 1
#: The height of a satellite fix is so much less exact than an axis of its place. Chosen by
#: judgement: satellites stand above the receiver alone; vertical dilution is 1.5 to 2 times the
#: horizontal.
_VERTICAL = 2.0


#: Names of fields that are a position's, in degrees and metres, in messages of unknown types.
_POSITION_NAMES = {
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng", "long"),
    "altitude": ("altitude", "alt", "height"),
}


@dataclass(frozen=True, slots=True)
class RosSource:
    """One stream within the messages of a topic.

    Attributes
    ----------
    kind
        Key of :data:`KINDS`, or the name of a message of unknown type that holds a position.
    prefix
        Path before the kind's fields: empty for the message itself, else ending in a dot.
    stamps
        Paths of the header stamps that may time it, innermost first.
    position
        Fields of a position in a message of unknown type; empty for a known one.
    besides
        Those of :data:`BESIDES` that the message has.
    """

    kind: str
    prefix: str
    stamps: tuple[str, ...]
    position: tuple[tuple[str, Channel], ...] = ()
    besides: tuple[tuple[str, Channel], ...] = ()

    @property
    def fields(self) -> tuple[tuple[str, Channel], ...]:
        """The paths of the samples and what they are."""
        return self.position or KINDS[self.kind] + self.besides

    @property
    def suffix(self) -> str:
        """What the stream's topic has after the channel's."""
        path = self.prefix.replace("[]", "").rstrip(".")
        return f".{path}" if path else ""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of the stream."""
        return tuple(channel for _, channel in self.fields)


def find_sources(definition: Definition) -> tuple[RosSource, ...]:
    """Return the streams a message holds, in the order of its fields."""
    return tuple(_search(definition, "", ())) or tuple(_positions(definition, "", ()))


def in_range(values: NDArray[np.float64]) -> bool:
    """Tell whether latitudes and longitudes, the first columns, are such in degrees."""
    with np.errstate(invalid="ignore"):
        return not (np.abs(values[:, :2]) > (90.0, 180.0)).any()


def _positions(definition: Definition, prefix: str, outer: tuple[str, ...]) -> Iterator[RosSource]:
    """Yield what a message of unknown type has of positions, none of them in arrays."""
    outer = _stamped(definition, prefix, outer)
    coordinates: dict[str, str] = {}
    for quantity, names in _POSITION_NAMES.items():
        name = next((n for n in names if _is_number(definition, n, "f")), None)
        if name is not None:
            coordinates[quantity] = name
    if {"latitude", "longitude"} <= coordinates.keys():
        fix = {channel.quantity: channel for _, channel in KINDS["sensor_msgs/NavSatFix"]}
        fields = tuple((name, fix[quantity]) for quantity, name in coordinates.items())
        yield RosSource(definition.name, prefix, outer, fields)
        return
    for member in definition.fields:
        path = _below(member, prefix)
        if member.message is not None and "[]" not in path:
            yield from _positions(member.message, path, outer)


def _stamped(definition: Definition, prefix: str, outer: tuple[str, ...]) -> tuple[str, ...]:
    """Return the stamps that may time what is in a message, its own first."""
    if all(_is_number(definition, f"header.stamp.{p}", "iu") for p in ("sec", "nanosec")):
        return (f"{prefix}header.stamp", *outer)
    return outer


def _search(definition: Definition, prefix: str, outer: tuple[str, ...]) -> Iterator[RosSource]:
    outer = _stamped(definition, prefix, outer)
    if definition.name in KINDS:
        # A schema may call anything an Imu: it is one if it has an Imu's fields.
        if all(_is_number(definition, path) for path, _ in KINDS[definition.name]):
            besides = BESIDES.get(definition.name, ()) if _has_covariance(definition) else ()
            yield RosSource(definition.name, prefix, outer, (), besides)
        return
    for member in definition.fields:
        path = _below(member, prefix)
        if member.message is not None and path.count("[]") <= 1:
            yield from _search(member.message, path, outer)


def _is_number(definition: Definition, path: str, kinds: str = "iuf") -> bool:
    """Tell whether a path leads to one number of every message; ``kinds`` are numpy's."""
    name, _, rest = path.partition(".")
    field = definition.find(name)
    if field is None or field.sequence or field.count is not None:
        return False
    if field.message is None:
        return not rest and field.primitive[0] in kinds
    return bool(rest) and _is_number(field.message, rest, kinds)


def _has_covariance(definition: Definition) -> bool:
    field = definition.find(_COVARIANCE)
    matrix = field is not None and field.count == 9 and field.primitive[:1] == "f"
    return matrix and _is_number(definition, f"{_COVARIANCE}_type", "iu")


def _below(field: Field, prefix: str) -> str:
    many = field.sequence or field.count is not None
    return f"{prefix}{field.name}{'[]' if many else ''}."


class Samples(NamedTuple):
    """Decoded samples: times (n,), values (n, n_channels), and each one's message (n,)."""

    times_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    rows: NDArray[np.intp]


def read_samples(
    source: RosSource,
    tables: Sequence[tuple[NDArray[np.intp], Table]],
    log_ns: NDArray[np.int64],
) -> Samples:
    """Return the samples of one stream in the order of their messages.

    Parameters
    ----------
    source
        Which stream.
    tables
        The messages, as :meth:`CdrDecoder.tables` groups them.
    log_ns
        Log time of every message, shape (n_messages,).
    """
    parts = [_from_table(source, rows, table, log_ns[rows]) for rows, table in tables]
    if len(parts) == 1:
        return parts[0]
    times, values, rows = (np.concatenate(p) for p in zip(*parts, strict=True))
    order = np.argsort(rows, kind="stable")
    return Samples(times[order], values[order], rows[order])


def _from_table(
    source: RosSource, rows: NDArray[np.intp], table: Table, log_ns: NDArray[np.int64]
) -> Samples:
    columns = [_column(table, source.prefix + path) for path, _ in source.fields]
    count = columns[0].shape[1]
    values = np.empty((len(rows), count, len(columns)))
    for i, column in enumerate(columns):
        values[:, :, i] = column
    times = log_ns[:, None]
    for stamp in reversed(source.stamps):
        stamp_ns = table.column(f"{stamp}.sec").astype(np.int64) * NS_PER_S
        stamp_ns += table.column(f"{stamp}.nanosec").astype(np.int64)
        times = stamp_ns if stamp_ns.all() else np.where(stamp_ns != 0, stamp_ns, times)
    if count != 1:
        times, rows = np.broadcast_to(times, (len(rows), count)), np.repeat(rows, count)
    return Samples(times.reshape(-1), values.reshape(-1, len(columns)), rows)


def _column(table: Table, path: str) -> NDArray[Any]:
    """Return a number of every message; of a covariance the accuracy, NaN where it is not told."""
    if not path.endswith(_COVARIANCE):
        return table.column(path)
    estimated = table.column(f"{path}_type") != _UNKNOWN
    covariance = table.column(path).reshape(*estimated.shape, 9)
    return np.where(estimated, accuracy_m(covariance[:, :, 0] + covariance[:, :, 4]), np.nan)


def accuracy_m(variances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the accuracy [m] of a fix whose two axes have variances of this sum [m2].

    NaN where that is none.
    """
    with np.errstate(invalid="ignore"):
        return np.where(variances > 0, ACCURACY_SIGMAS * np.sqrt(variances / 2), np.nan)


def fields_of(kind: str) -> tuple[tuple[str, Channel], ...]:
    """Return all that a message may tell of a stream."""
    return KINDS[kind] + BESIDES.get(kind, ())


def kind_of(stream: Stream) -> str | None:
    """Return the message that holds exactly the channels of a stream, unscaled, or None."""
    have = sorted((c.quantity, c.axis, c.unit) for c in stream.channels)
    if any(c.scale != 1.0 for c in stream.channels):
        return None
    for kind, fields in KINDS.items():
        for complete in (fields, fields_of(kind)):
            if have == sorted((c.quantity, c.axis, c.unit) for _, c in complete):
                return kind
    return None


def column_order(kind: str, stream: Stream) -> list[int]:
    """Return, for each channel of a stream of that kind, the column of the kind it is."""
    columns = [(c.quantity, c.axis) for _, c in fields_of(kind)]
    return [columns.index((c.quantity, c.axis)) for c in stream.channels]


class RosWriter:
    """Encodes samples of one stream as ROS 2 messages, one per sample.

    Parameters
    ----------
    kind
        Key of :data:`KINDS`.
    stream
        Whose channels are those of the kind, in any order; of an Imu perhaps one sensor's only.
    """

    def __init__(self, kind: str, stream: Stream) -> None:
        definition = parse_ros2msg(kind, ros2msg(kind))
        frame = stream.placement or stream.topic.strip("/")
        self._template = CdrTemplate(definition, {"header.frame_id": [frame]})
        order = column_order(kind, stream)
        self._columns = [(fields_of(kind)[k][0], i) for i, k in enumerate(order)]
        self._topic = stream.topic
        have = {path.partition(".")[0] for path, _ in self._columns}
        self._unknown = [
            f"{name}_covariance" for name in _IMU_PARTS if kind == _IMU and name not in have
        ]

    def encode(self, times_ns: NDArray[np.int64], values: NDArray[Any]) -> list[bytes]:
        """Return one message per sample; ``values`` has shape (n, n_channels).

        Raises
        ------
        CodecError
            Where a time is past 2038, the end of a ROS stamp.
        """
        table = self._template.table(len(times_ns))
        seconds, nanos = np.divmod(times_ns, NS_PER_S)
        if len(seconds) and seconds.max() > _LAST_STAMP_S:
            raise CodecError(
                f"{self._topic}: expected times up to {_LAST_STAMP_S} s, found {seconds.max()} s"
            )
        table.put("header.stamp.sec", seconds[:, None])
        table.put("header.stamp.nanosec", nanos[:, None])
        for path, i in self._columns:
            if path == _COVARIANCE:
                _put_accuracy(table, values[:, i])
            else:
                table.put(path, values[:, i : i + 1])
        # sensor_msgs/Imu: -1 in the first element says that there is no such estimate.
        covariance = np.zeros((len(times_ns), 9))
        covariance[:, 0] = -1.0
        for path in self._unknown:
            table.put(path, covariance)
        return table.payloads()


def _put_accuracy(table: Table, accuracy_m: NDArray[Any]) -> None:
    """Write an accuracy as a covariance, which is unknown where it is none; shape (n,)."""
    with np.errstate(invalid="ignore"):
        estimated = accuracy_m > 0
    variance = np.where(estimated, (accuracy_m / ACCURACY_SIGMAS) ** 2, 0.0)
    covariance = np.zeros((len(accuracy_m), 9))
    covariance[:, 0] = covariance[:, 4] = variance
    covariance[:, 8] = _VERTICAL**2 * variance
    table.put(_COVARIANCE, covariance)
    table.put(f"{_COVARIANCE}_type", np.where(estimated, _APPROXIMATED, _UNKNOWN)[:, None])


#: Wire types of the primitive fields (little-endian numpy codes without byte order).
PRIMITIVES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "uint8": "u1",
    "int8": "i1",
    "uint16": "u2",
    "int16": "i2",
    "uint32": "u4",
    "int32": "i4",
    "uint64": "u8",
    "int64": "i8",
    "float32": "f4",
    "float64": "f8",
}
#: Definitions some writers leave out because every ROS 2 tool knows them.
_IMPLIED = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
#: An empty message occupies one byte on the wire.
_EMPTY = "uint8 structure_needs_at_least_one_member"
_MAX_FIELDS = 10_000
_MAX_DEPTH = 32

_SEPARATOR = re.compile(r"^={8,}\s*$", re.MULTILINE)
_COMMENT = re.compile(r"""^((?:[^#"']|"[^"]*"|'[^']*')*)#.*$""")
_LINE = re.compile(
    r"""^(?P<type>[A-Za-z][\w/]*)(?:<=(?P<longest>\d{1,10}))?
        (?P<array>\[(?P<bounded><=)?(?P<count>\d{0,10})\])?
        \s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)$""",
    re.VERBOSE,
)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message.

    Attributes
    ----------
    name
        As in the definition.
    primitive
        numpy code, ``str`` for a string, empty for a nested message.
    message
        The nested message's definition, or None.
    count
        Length of a fixed array; None for a single value or a sequence.
    sequence
        True for an unbounded or bounded sequence.
    longest
        Bound of a bounded sequence, or None.
    default
        Default value's text, empty where there is none.
    """

    name: str
    primitive: str
    message: Definition | None
    count: int | None = None
    sequence: bool = False
    longest: int | None = None
    default: str = ""

    @property
    def min_size(self) -> int:
        """Fewest bytes one element takes on the wire, without padding."""
        if self.message is not None:
            return self.message.min_size
        return 4 if self.primitive == "str" else int(self.primitive[1])


@dataclass(frozen=True, slots=True)
class Definition:
    """A message: its name (``package/Type``), fields in wire order, and constants."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, str], ...] = ()
    min_size: int = field(default=0, compare=False)
    paths: int = field(default=0, compare=False)

    def find(self, name: str) -> Field | None:
        """Return the field of that name, or None."""
        return next((f for f in self.fields if f.name == name), None)


@lru_cache(maxsize=256)
def parse_ros2msg(name: str, text: str) -> Definition:
    """Parse a ``ros2msg`` schema.

    Parameters
    ----------
    name
        Of the schema, ``package/msg/Type`` or ``package/Type``.
    text
        Its content.

    Raises
    ------
    SchemaError
        Where a line is no field, a type is unknown or contains itself; names the message.
    """
    root = _plain(name)
    head, *others = _SEPARATOR.split(text)
    sources = {**_IMPLIED, root: head}
    for other in others:
        title, _, body = other.strip().partition("\n")
        if not title.startswith("MSG:"):
            raise SchemaError(f"{root}: expected 'MSG: package/Type', found {title[:60]!r}")
        sources[_plain(title.removeprefix("MSG:").strip())] = body
    return _Resolver(sources).resolve(root, ())


def _plain(name: str) -> str:
    return name.replace("/msg/", "/")


class _Resolver:
    """Turns the texts of a schema into definitions, each once."""

    def __init__(self, sources: dict[str, str]) -> None:
        self._sources = sources
        self._definitions: dict[str, Definition] = {}

    def resolve(self, name: str, parents: tuple[str, ...]) -> Definition:
        if name in self._definitions:
            return self._definitions[name]
        if name in parents or len(parents) >= _MAX_DEPTH:
            raise SchemaError(f"{name}: expected a finite message, found it nested in itself")
        if name not in self._sources:
            user = parents[-1] if parents else "schema"
            raise SchemaError(f"{user}: expected a definition of {name}, found none")
        constants: list[tuple[str, str]] = []
        fields: list[Field] = []
        for line in self._sources[name].splitlines():
            self._line(name, line, (*parents, name), fields, constants)
        if not fields:
            self._line(name, _EMPTY, parents, fields, constants)
        self._definitions[name] = _definition(name, fields, constants)
        return self._definitions[name]

    def _line(
        self,
        owner: str,
        line: str,
        parents: tuple[str, ...],
        fields: list[Field],
        constants: list[tuple[str, str]],
    ) -> None:
        comment = _COMMENT.match(line)
        line = (comment[1] if comment else line).strip()
        if not line:
            return
        match = _LINE.match(line)
        if match is None:
            raise SchemaError(f"{owner}: expected 'type name', found {line[:60]!r}")
        if match["rest"].startswith("="):
            constants.append((match["name"], match["rest"][1:].strip()))
            return
        fields.append(self._field(owner, match, parents))

    def _field(self, owner: str, match: re.Match[str], parents: tuple[str, ...]) -> Field:
        kind = match["type"]
        message = None
        if kind == "string":
            primitive = "str"
        elif kind in PRIMITIVES:
            primitive = PRIMITIVES[kind]
        elif kind == "wstring":
            raise SchemaError(f"{owner}: {match['name']}: expected a string, found a wstring")
        else:
            primitive, message = "", self.resolve(self._qualified(kind, owner), parents)
        number = int(match["count"]) if match["count"] else None
        sequence = match["array"] is not None and (number is None or bool(match["bounded"]))
        return Field(
            match["name"],
            primitive,
            message,
            None if sequence else number,
            sequence,
            number if sequence else None,
            match["rest"],
        )

    @staticmethod
    def _qualified(kind: str, owner: str) -> str:
        if kind == "Header":
            return "std_msgs/Header"
        if "/" in kind:
            return _plain(kind)
        return f"{owner.rpartition('/')[0]}/{kind}"


def _definition(name: str, fields: list[Field], constants: list[tuple[str, str]]) -> Definition:
    size = sum(
        0 if f.sequence else f.min_size * (1 if f.count is None else f.count) for f in fields
    )
    size += sum(4 for f in fields if f.sequence)
    paths = sum(1 if f.message is None else f.message.paths for f in fields)
    if paths > _MAX_FIELDS:
        raise SchemaError(f"{name}: expected at most {_MAX_FIELDS} fields, found {paths}")
    return Definition(name, tuple(fields), tuple(constants), size, paths)


_DEFINITIONS = {
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "sensor_msgs/Imu": (
        "std_msgs/Header header",
        "geometry_msgs/Quaternion orientation",
        "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity",
        "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration",
        "float64[9] linear_acceleration_covariance",
    ),
    "sensor_msgs/MagneticField": (
        "std_msgs/Header header",
        "geometry_msgs/Vector3 magnetic_field",
        "float64[9] magnetic_field_covariance",
    ),
    "sensor_msgs/FluidPressure": (
        "std_msgs/Header header",
        "float64 fluid_pressure",
        "float64 variance",
    ),
    "sensor_msgs/Temperature": (
        "std_msgs/Header header",
        "float64 temperature",
        "float64 variance",
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_UNKNOWN=-2",
        "int8 STATUS_NO_FIX=-1",
        "int8 STATUS_FIX=0",
        "int8 STATUS_SBAS_FIX=1",
        "int8 STATUS_GBAS_FIX=2",
        "int8 status",
        "uint16 SERVICE_UNKNOWN=0",
        "uint16 SERVICE_GPS=1",
        "uint16 SERVICE_GLONASS=2",
        "uint16 SERVICE_COMPASS=4",
        "uint16 SERVICE_GALILEO=8",
        "uint16 service",
    ),
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header",
        "sensor_msgs/NavSatStatus status",
        "float64 latitude",
        "float64 longitude",
        "float64 altitude",
        "float64[9] position_covariance",
        "uint8 COVARIANCE_TYPE_UNKNOWN=0",
        "uint8 COVARIANCE_TYPE_APPROXIMATED=1",
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2",
        "uint8 COVARIANCE_TYPE_KNOWN=3",
        "uint8 position_covariance_type",
    ),
    "std_msgs/MultiArrayDimension": ("string label", "uint32 size", "uint32 stride"),
    "std_msgs/MultiArrayLayout": (
        "std_msgs/MultiArrayDimension[] dim",
        "uint32 data_offset",
    ),
    "std_msgs/Float64MultiArray": ("std_msgs/MultiArrayLayout layout", "float64[] data"),
}


def ros2msg(name: str) -> str:
    """Return the ``ros2msg`` schema of one of the messages, e.g. ``sensor_msgs/Imu``."""
    needed = [name]
    for message in needed:
        kinds = (line.split()[0].removesuffix("[]") for line in _DEFINITIONS[message])
        needed += [k for k in dict.fromkeys(kinds) if k in _DEFINITIONS and k not in needed]
    head, *others = ("\n".join(_DEFINITIONS[n]) for n in needed)
    rule = "\n" + "=" * 80 + "\n"
    return head + "".join(
        f"{rule}MSG: {other}\n{text}" for other, text in zip(needed[1:], others, strict=True)
    )
