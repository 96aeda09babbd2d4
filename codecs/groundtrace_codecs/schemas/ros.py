"""Streams in ROS 2 messages: which messages hold samples, where, and at what time.

Recognised by the embedded schema alone: the five ``sensor_msgs`` below, and any message that
contains one of them, also in one array. A message of another type with a latitude and a longitude
is taken for a position. A sample's time is the stamp of its own header where that
is non-zero, else of the nearest enclosing one, else the message's log time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import CodecError
from ..signals import NS_PER_S, Channel, Stream
from .cdr_template import CdrTemplate
from .msgs import ros2msg
from .ros2msg import Definition, Field, parse_ros2msg

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .cdr import Table

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
    """

    kind: str
    prefix: str
    stamps: tuple[str, ...]
    position: tuple[tuple[str, Channel], ...] = ()

    @property
    def fields(self) -> tuple[tuple[str, Channel], ...]:
        """The paths of the samples and what they are."""
        return self.position or KINDS[self.kind]

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
    found: dict[str, str] = {}
    for quantity, names in _POSITION_NAMES.items():
        name = next((n for n in names if _is_number(definition, n, "f")), None)
        if name is not None:
            found[quantity] = name
    if {"latitude", "longitude"} <= found.keys():
        fix = {channel.quantity: channel for _, channel in KINDS["sensor_msgs/NavSatFix"]}
        fields = tuple((name, fix[quantity]) for quantity, name in found.items())
        yield RosSource(definition.name, prefix, outer, fields)
        return
    for field in definition.fields:
        path = _below(field, prefix)
        if field.message is not None and "[]" not in path:
            yield from _positions(field.message, path, outer)


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
            yield RosSource(definition.name, prefix, outer)
        return
    for field in definition.fields:
        path = _below(field, prefix)
        if field.message is not None and path.count("[]") <= 1:
            yield from _search(field.message, path, outer)


def _is_number(definition: Definition, path: str, kinds: str = "iuf") -> bool:
    """Tell whether a path leads to one number of every message; ``kinds`` are numpy's."""
    name, _, rest = path.partition(".")
    field = definition.find(name)
    if field is None or field.sequence or field.count is not None:
        return False
    if field.message is None:
        return not rest and field.primitive[0] in kinds
    return bool(rest) and _is_number(field.message, rest, kinds)


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
    columns = [table.column(source.prefix + path) for path, _ in source.fields]
    count = columns[0].shape[1]
    values = np.empty((len(rows), count, len(columns)))
    for i, column in enumerate(columns):
        values[:, :, i] = column
    times = log_ns[:, None]
    for stamp in reversed(source.stamps):
        own = table.column(f"{stamp}.sec").astype(np.int64) * NS_PER_S
        own += table.column(f"{stamp}.nanosec").astype(np.int64)
        times = own if own.all() else np.where(own != 0, own, times)
    if count != 1:
        times, rows = np.broadcast_to(times, (len(rows), count)), np.repeat(rows, count)
    return Samples(times.reshape(-1), values.reshape(-1, len(columns)), rows)


def kind_of(stream: Stream) -> str | None:
    """Return the message that holds exactly the channels of a stream, unscaled, or None."""
    have = sorted((c.quantity, c.axis, c.unit) for c in stream.channels)
    if any(c.scale != 1.0 for c in stream.channels):
        return None
    for kind, fields in KINDS.items():
        if have == sorted((c.quantity, c.axis, c.unit) for _, c in fields):
            return kind
    return None


def column_order(kind: str, stream: Stream) -> list[int]:
    """Return, for each channel of a stream of that kind, the column of the kind it is."""
    columns = [(c.quantity, c.axis) for _, c in KINDS[kind]]
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
        self._columns = [(KINDS[kind][k][0], i) for i, k in enumerate(order)]
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
            table.put(path, values[:, i : i + 1])
        # sensor_msgs/Imu: -1 in the first element says that there is no such estimate.
        covariance = np.zeros((len(times_ns), 9))
        covariance[:, 0] = -1.0
        for path in self._unknown:
            table.put(path, covariance)
        return table.payloads()
