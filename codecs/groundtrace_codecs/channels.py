"""Channels that carry signals: which those are, and their messages as blocks."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from .description import PREVIEW_KEY, STREAM_KEY, stream_from_json
from .errors import CodecError, SchemaError
from .geometry import placed
from .mcap import MessageTable
from .readable import pass_over, readable
from .schemas.cdr import CdrDecoder
from .schemas.protobuf import get_time, parse
from .schemas.ros import (
    KINDS,
    RosSource,
    column_order,
    find_sources,
    in_range,
    kind_of,
    read_samples,
)
from .schemas.ros2msg import parse_ros2msg
from .schemas.waveform import decode_waveform
from .schemas.waveform_run import WaveformRun
from .signals import NS_PER_S, Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .geometry import Geometry
    from .mcap import ChannelRecord, McapFile, Message, Schema
    from .schemas.ros2msg import Definition
    from .schemas.waveform import Waveform

_PROBE_MESSAGES = 500
_PROBE_NS = 30 * NS_PER_S
_LOCATION_KINDS = {"foxglove.LocationFix", "foxglove.LocationFixes"}


class Stamped(NamedTuple):
    """A block and the log time of the (last) message it came from [ns]."""

    log_ns: int
    block: SignalBlock


class ChannelReader(Protocol):
    """Turns the messages of one channel into blocks of the streams it holds."""

    streams: tuple[Stream, ...]

    def blocks(self, messages: MessageTable, *, joined: bool = False) -> Iterator[Stamped]:
        """Yield the blocks of consecutive messages of the channel, joined where they continue."""


def probe(file: McapFile, channel_id: int) -> MessageTable:
    """Return the first messages of a channel, at most 500 and 30 s, enough to know its rate."""
    found = MessageTable.none()
    for table in file.tables({channel_id}):
        end_ns = (found or table)[0].log_time + _PROBE_NS
        count = min(table.before(end_ns), _PROBE_MESSAGES - len(found))
        found = MessageTable.joined([found, table[:count]])
        if count < len(table):
            break
    return found


def reader_for(
    file: McapFile, channel: ChannelRecord, geometry: Geometry | None
) -> ChannelReader | None:
    """Return the reader of a channel, or None where it carries no known signal.

    Raises
    ------
    CodecError
        Where the channel says that it carries a stream but its description or first messages do
        not.
    """
    schema = file.schemas.get(channel.schema_id)
    if schema is None or PREVIEW_KEY in channel.metadata:
        return None
    kind = (channel.message_encoding, schema.encoding)
    reader: ChannelReader | None = None
    if kind == ("protobuf", "protobuf") and schema.name == "groundtrace.WaveformBlock":
        reader = _waveform_reader(file, channel)
    elif kind == ("protobuf", "protobuf") and schema.name in _LOCATION_KINDS:
        reader = _location_reader(file, channel, schema.name)
    elif kind == ("cdr", "ros2msg"):
        reader = _ros_reader(file, channel, schema)
    if reader is not None:
        reader.streams = tuple(placed(s, geometry) for s in reader.streams)
    return reader


def _place(file: McapFile, channel: ChannelRecord) -> str:
    return f"{file.name}: {channel.topic}"


def median_rate(times_ns: NDArray[np.int64]) -> float:
    """Return the inverse of the median interval [Hz]; 1 where there are no two distinct times."""
    steps = np.diff(np.unique(times_ns))
    return NS_PER_S / float(np.median(steps)) if len(steps) else 1.0


class WaveformReader:
    """Reads ``groundtrace.WaveformBlock`` messages, one block each unless they are joined."""

    def __init__(self, stream: Stream, place: str) -> None:
        self.streams: tuple[Stream, ...] = (stream,)
        self._place = place
        self._count = 0  # samples of the last message: most have as many

    def blocks(self, messages: MessageTable, *, joined: bool = False) -> Iterator[Stamped]:
        """Yield one block per message, or per run of messages that continue each other."""
        run: WaveformRun | None = None
        log_ns = 0
        for message in messages:
            if run is None or not (joined and run.take(message.data)):
                if run is not None:
                    yield Stamped(log_ns, run.block())
                run = WaveformRun(self.streams[0], message.data, self._place, self._count)
                self._count = run.count
            log_ns = message.log_time
        if run is not None:
            yield Stamped(log_ns, run.block())


def _waveform_reader(file: McapFile, channel: ChannelRecord) -> WaveformReader | None:
    place = _place(file, channel)
    if STREAM_KEY in channel.metadata:
        text = channel.metadata[STREAM_KEY]
        return WaveformReader(stream_from_json(text, channel.topic, place), place)
    wave = _first_wave(probe(file, channel.id), place)
    if wave is None:
        return None
    columns = range(1, 1 + wave.samples.shape[1])
    channels = tuple(Channel(f"ch{i}", "seismic", "count") for i in columns)
    rate = wave.rate_hz if wave.times_ns is None else median_rate(wave.times_ns)
    stream = Stream(channel.topic, channels, rate, irregular=wave.times_ns is not None)
    return WaveformReader(stream, place)


def _first_wave(messages: Sequence[Message], place: str) -> Waveform | None:
    """Return the first message that can be decoded."""
    for message in messages:
        with suppress(CodecError):
            return decode_waveform(message.data, place)
    return None


class RosReader:
    """Reads ROS 2 messages, many at once; a message may hold several streams.

    Attributes
    ----------
    streams
        What the messages hold.
    assumed
        One line for each stream that the type of its message does not tell to be one.
    """

    def __init__(
        self,
        definition: Definition,
        sources: Sequence[RosSource],
        streams: Sequence[Stream],
        place: str,
    ) -> None:
        self.streams: tuple[Stream, ...] = tuple(streams)
        self._place = place
        self._sources = sources
        self._decoder = CdrDecoder(definition, place)
        self._orders = [
            list(range(len(s.fields))) if s.position else column_order(s.kind, t)
            for s, t in zip(sources, streams, strict=True)
        ]
        self.assumed = tuple(
            f"{t.topic}: the {' and '.join(path for path, _ in s.fields[:2])} of {s.kind}, a "
            f"message of unknown type, are taken for a position in degrees"
            for s, t in zip(sources, streams, strict=True)
            if s.position
        )

    def blocks(self, messages: MessageTable, *, joined: bool = True) -> Iterator[Stamped]:  # noqa: ARG002
        """Yield the blocks of consecutive messages: one per stream and contiguous run."""
        log_ns = log_times(messages, self._place)
        tables = list(self._decoder.tables(messages.by_size()))
        for source, stream, order in zip(self._sources, self.streams, self._orders, strict=True):
            found = read_samples(source, tables, log_ns)
            if not len(found.times_ns):
                continue
            values = found.values if order == sorted(order) else found.values[:, order]
            if stream.irregular:
                first = messages[0].sequence
                block = SignalBlock(stream, int(found.times_ns[0]), first, values, found.times_ns)
                yield Stamped(messages[-1].log_time, block)
            else:
                indices = messages.rows["sequence"]
                yield from _runs(stream, indices, found.times_ns, values, log_ns)


def log_times(messages: MessageTable, place: str) -> NDArray[np.int64]:
    """Return the log time of every message [ns].

    Raises
    ------
    SchemaError
        Where one does not fit an int64; names ``place``.
    """
    times = messages.rows["log_time"].astype(np.int64)
    if (times < 0).any():
        latest = messages.rows["log_time"].max()
        raise SchemaError(f"{place}: log_time: expected less than 2^63 ns, found {latest}")
    return times


def _runs(
    stream: Stream,
    indices: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    log_ns: NDArray[np.int64],
) -> Iterator[Stamped]:
    """Cut uniform samples where index or anchor jump; the index is the message's sequence."""
    anchors = times_ns - np.rint(indices * stream.period_ns).astype(np.int64)
    breaks = np.flatnonzero((np.diff(indices) != 1) | (np.diff(anchors) != 0)) + 1
    for start, stop in zip([0, *breaks], [*breaks, len(indices)], strict=True):
        block = SignalBlock(stream, int(anchors[start]), int(indices[start]), values[start:stop])
        yield Stamped(int(log_ns[stop - 1]), block)


def _ros_reader(file: McapFile, channel: ChannelRecord, schema: Schema) -> RosReader | None:
    place = _place(file, channel)
    try:
        definition = parse_ros2msg(schema.name, schema.data.decode("utf-8", "replace"))
    except SchemaError:
        # A foreign schema that cannot be read is a channel left alone, not a broken recording.
        return None
    sources = find_sources(definition)
    if not sources:
        return None
    if STREAM_KEY in channel.metadata:
        stream = stream_from_json(channel.metadata[STREAM_KEY], channel.topic, place)
        if definition.name not in KINDS or kind_of(stream) != definition.name:
            raise SchemaError(f"{place}: expected the channels of {definition.name}, found others")
        return RosReader(definition, sources, (stream,), place)
    return _estimated(file, channel, definition)


def nominal_reader(definition: Definition, topic: str, place: str) -> RosReader | None:
    """Return the reader of a topic of another tool at a nominal 1 Hz, None without signals."""
    sources = find_sources(definition)
    if not sources:
        return None
    streams = [Stream(topic + s.suffix, s.channels, 1.0, irregular=True) for s in sources]
    return RosReader(definition, sources, streams, place)


def _estimated(file: McapFile, channel: ChannelRecord, definition: Definition) -> RosReader | None:
    """Return the reader of a foreign channel; its rates are those of its first messages."""
    messages = probe(file, channel.id)
    reader = nominal_reader(definition, channel.topic, _place(file, channel))
    if not messages or reader is None:
        return None
    blocks = [b for _, b in readable(reader, messages, pass_over)]
    if reader.assumed and not all(in_range(b.samples) for b in blocks):
        return None
    times = {b.topic: b.sample_times() for b in blocks}
    reader.streams = tuple(
        replace(s, rate_hz=median_rate(times.get(s.topic, np.empty(0, np.int64))))
        for s in reader.streams
    )
    return reader


class LocationReader:
    """Reads ``foxglove.LocationFix`` and ``foxglove.LocationFixes``."""

    def __init__(self, stream: Stream, schema_name: str, place: str) -> None:
        self.streams: tuple[Stream, ...] = (stream,)
        self._many = schema_name.endswith("Fixes")
        self._place = place

    def _fixes(self, message: Message) -> Sequence[Any]:
        if self._many:
            from foxglove_schemas_protobuf.LocationFixes_pb2 import LocationFixes

            fixes: Sequence[Any] = parse(LocationFixes, message.data, self._place).fixes
            return fixes
        from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

        return (parse(LocationFix, message.data, self._place),)

    def blocks(self, messages: MessageTable, *, joined: bool = True) -> Iterator[Stamped]:  # noqa: ARG002
        """Yield one block of all the fixes."""
        logs = log_times(messages, self._place)
        pairs = [(m, fix) for m in messages for fix in self._fixes(m)]
        if not pairs:
            return
        times = [get_time(fix.timestamp, self._place) or m.log_time for m, fix in pairs]
        values = np.array([(f.latitude, f.longitude, f.altitude) for _, f in pairs], np.float64)
        block = SignalBlock(self.streams[0], times[0], 0, values, np.array(times, np.int64))
        yield Stamped(int(logs[-1]), block)


def _location_reader(
    file: McapFile, channel: ChannelRecord, schema_name: str
) -> LocationReader | None:
    try:
        import foxglove_schemas_protobuf  # noqa: F401
    except ImportError as error:
        raise CodecError(f"{file.name}: expected foxglove-schemas-protobuf, found none") from error
    messages = probe(file, channel.id)
    channels = tuple(c for _, c in KINDS["sensor_msgs/NavSatFix"])
    stream = Stream(channel.topic, channels, 1.0, irregular=True)
    reader = LocationReader(stream, schema_name, _place(file, channel))
    times = [b.sample_times() for _, b in readable(reader, messages, pass_over)]
    if not times:
        return None
    reader.streams = (replace(stream, rate_hz=median_rate(times[0])),)
    return reader
