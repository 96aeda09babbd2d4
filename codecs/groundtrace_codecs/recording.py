"""Recordings as typed blocks: the streams of an MCAP file, written by groundtrace or by others."""

from __future__ import annotations

from bisect import bisect_right
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self

import numpy as np

from .annotations import annotations_of
from .errors import CodecError, SchemaError
from .geometry import SITE_NAME, Geometry, placed
from .mcap.chunks import Damage, MessageTable
from .mcap.reader import McapFile
from .schemas.event_messages import TRUTH_TOPIC, Described, labels_of
from .schemas.protobuf import field_names, get_time, parse
from .schemas.ros2 import (
    KINDS,
    CdrDecoder,
    RosSource,
    accuracy_m,
    column_order,
    fields_of,
    find_sources,
    in_range,
    kind_of,
    parse_ros2msg,
    read_samples,
)
from .schemas.waveform import WaveformRun, decode_waveform
from .signals import (
    ACCURACY,
    NS_PER_S,
    PREVIEW_KEY,
    STREAM_KEY,
    Channel,
    SignalBlock,
    Stream,
    stream_from_json,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
    from types import TracebackType

    from numpy.typing import NDArray

    from .annotations import Annotation
    from .events import Label
    from .mcap.byte_source import ByteSource
    from .mcap.chunks import ChannelRecord, ChunkEntry, Message, Schema
    from .schemas.ros2 import Definition
    from .schemas.waveform import Waveform

#: Log time over which messages are decoded together; blocks come out in order of log time.
BATCH_NS = NS_PER_S // 4
#: How much later or earlier than seen at its start a channel may be logged after its samples.
SLACK_NS = 2 * NS_PER_S


class Recording:
    """An open recording.

    Made by :meth:`open`; a context manager.

    Attributes
    ----------
    name
        File name.
    file
        The MCAP file underneath.
    streams
        In the order of their channels' ids; channels with the positions the geometry gives.
    others
        Topics left alone.
    geometry
        Of the site, or None.
    metadata
        Values of every Metadata record by its name.
    """

    def __init__(self, file: McapFile, *, strict: bool = False) -> None:
        self.file = file
        self._strict = strict
        self._left_out: dict[tuple[int, int, int], Damage] = {}
        self.name = Path(file.name).name
        self.geometry = _geometry(file)
        self.metadata: dict[str, dict[str, str]] = {}
        for record in file.metadata:
            self.metadata.setdefault(record.name, {}).update(record.values)
        self._readers: dict[int, ChannelReader] = {}
        others: list[OtherTopic] = []
        for channel in sorted(file.channels.values(), key=lambda c: c.id):
            reader = reader_for(file, channel, self.geometry)
            if reader is not None:
                self._readers[channel.id] = reader
            elif not is_ours(file, channel):
                others.append(other_topic(file, channel))
        self.others = tuple(others)
        self.streams = _unify(self._readers)
        self._lags = lags_of(file, self._readers)
        self._clock = file.reading_clock(self._readers.keys())

    @classmethod
    def open(cls, source: str | Path | ByteSource, *, strict: bool = False) -> Self:
        """Open a recording.

        Parameters
        ----------
        source
            Path, or bytes from elsewhere.
        strict
            Raise at the first damage instead of listing it.

        Raises
        ------
        CodecError
            Where there is no such file, it is no MCAP file, or a channel is not what it says.
        """
        try:
            file = McapFile.open(source, strict=strict)
        except OSError as error:
            raise CodecError(f"{source}: expected a recording, found: {error.strerror}") from error
        try:
            return cls(file, strict=strict)
        except BaseException:
            file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far; grows while blocks are read."""
        return (*self.file.damage, *self._left_out.values())

    @property
    def assumed(self) -> tuple[str, ...]:
        """One line for each stream that is only taken for what it seems to be."""
        return tuple(line for r in self._readers.values() for line in getattr(r, "assumed", ()))

    @property
    def readers(self) -> dict[int, tuple[ChannelReader, Lag]]:
        """What decodes each channel that has samples, by its id, and its lag."""
        return {i: (self._readers[i], lag) for i, lag in self._lags.items()}

    @property
    def topic_counts(self) -> dict[str, int]:
        """Messages by topic, in the order of the channels' ids."""
        counts: dict[str, int] = {}
        for channel in sorted(self.file.channels.values(), key=lambda c: c.id):
            count = self.file.message_counts.get(channel.id, 0)
            counts[channel.topic] = counts.get(channel.topic, 0) + count
        return counts

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """The recording's own truth, by time."""
        return labels_of(self.file, TRUTH_TOPIC)

    @cached_property
    def annotations(self) -> tuple[Annotation, ...]:
        """What people marked, kept inside the file, by time."""
        return annotations_of(self.file)

    @cached_property
    def start_ns(self) -> int:
        """Time of the first sample over all streams [ns]; 0 without samples."""
        firsts = [lag.first_ns for lag in self._lags.values()]
        for edge_ns in self._edges_ns:
            blocks = self._decoded(self._readers, edge_ns, edge_ns + SLACK_NS)
            firsts += [int(b.sample_times().min()) for _, b in blocks]
        return min(firsts, default=0)

    @property
    def set_back(self) -> bool:
        """Whether the clock was set back while it was recorded: some times come twice."""
        return self._clock is not None

    @property
    def _edges_ns(self) -> tuple[int, ...]:
        """Where a clock that was set back goes on, in times of reading [ns]."""
        return () if self._clock is None else self._clock.edges_ns

    @cached_property
    def end_ns(self) -> int:
        """Time of the last sample over all streams [ns]; 0 without samples."""
        if not self._lags:
            return 0
        end_ns = self.file.end_ns
        if self._clock is not None:
            end_ns = max(chunk.end_ns for chunk in self._clock.chunks)
        lasts = [self._last_ns(edge_ns, edge_ns) for edge_ns in self._edges_ns]
        return max(*lasts, self._last_ns(end_ns, None), self.start_ns)

    def _last_ns(self, end_ns: int, stop_ns: int | None) -> int:
        """Return the last sample that was read by a time [ns]; 0 where there is none."""
        span = NS_PER_S
        while True:
            low = end_ns - span
            blocks = self._decoded(self._readers, low, stop_ns)
            last = max((int(b.sample_times().max()) for _, b in blocks), default=None)
            if last is not None or low <= self.file.start_ns:
                return last or 0
            span *= 4

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,
    ) -> Iterator[LoggedBlock]:
        """Yield blocks of all streams in order of log time, then of channel id.

        One block per WaveformBlock; messages of one sample are put together over 0.25 s of log
        time. After a clock was set back, log times go on as if it had not been, see
        :mod:`.mcap.reader`: a channel's blocks come as they were recorded.

        Parameters
        ----------
        topics
            Streams to read; None = all.
        start_ns, stop_ns
            Sample times ``[start_ns, stop_ns)``; None = no bound. Messages are looked for where
            their channel's first messages were logged after their samples, and 2 s around.
        joined_ns
            Log time over which messages of all kinds are put together, those that continue each
            other into one block; 0 = as said above.

        Raises
        ------
        CodecError
            Where a topic is none of the streams; strict, also where a message is not what its
            schema says (otherwise it is left out and listed as damage).
        """
        wanted = self._wanted(topics)
        readers = {
            i: r for i, r in self._readers.items() if any(s.topic in wanted for s in r.streams)
        }
        lags = [self._lags[i] for i in readers if i in self._lags]
        if not lags:
            return
        low = None if start_ns is None else start_ns + min(g.low_ns for g in lags) - SLACK_NS
        high = None if stop_ns is None else stop_ns + max(g.high_ns for g in lags) + SLACK_NS
        if high is not None and self._clock is not None:
            high += self._clock.latest_ns
        if start_ns is None and stop_ns is None and len(wanted) == len(self.streams):
            yield from self._decoded(readers, low, high, joined_ns)
            return
        for logged_ns, block in self._decoded(readers, low, high, joined_ns):
            if block.topic in wanted and len(part := block.between(start_ns, stop_ns)):
                yield LoggedBlock(logged_ns, part)

    def counted(self, topic: str) -> CountedMessages | None:
        """Return how many messages a stream has before each chunk, by the index of the file alone.

        None where the index does not say it, samples carry their own times, more than one channel
        holds the stream, or a clock was set back.
        """
        ids = [i for i, r in self._readers.items() if topic in (s.topic for s in r.streams)]
        if len(ids) != 1 or self._clock is not None or ids[0] not in self._lags:
            return None
        reader, lag = self._readers[ids[0]], self._lags[ids[0]]
        counts = self.file.counted(ids[0])
        stream = next(s for s in reader.streams if s.topic == topic)
        if stream.irregular or not counts:
            return None
        before = np.cumsum([0, *(count for _, count in counts)], dtype=np.int64)[:-1]
        chunks = tuple(chunk for chunk, _ in counts)
        return CountedMessages(self.file, ids[0], reader, stream, lag.first_ns, chunks, before)

    def _wanted(self, topics: Collection[str] | None) -> set[str]:
        available = {s.topic for s in self.streams}
        missing = sorted(set(topics or ()) - available)
        if missing:
            raise CodecError(f"{self.name}: expected a stream {missing[0]}, found none")
        return available if topics is None else set(topics)

    def _decoded(
        self,
        readers: dict[int, ChannelReader],
        low_ns: int | None,
        high_ns: int | None,
        joined_ns: int = 0,
    ) -> Iterator[LoggedBlock]:
        """Yield decoded blocks by log time, one batch after the other."""
        tables = self.file.tables(readers.keys(), low_ns, high_ns, self._clock)
        for batch in batches(tables, joined_ns or BATCH_NS):
            yield from self._blocks_of(batch, readers, joined=joined_ns > 0)

    def decoded(self, messages: MessageTable) -> list[LoggedBlock]:
        """Return the blocks of messages of any channels, in the order of log time."""
        decodable = messages.of_channels([i for i in messages.counts() if i in self._readers])
        return self._blocks_of(_by_channel([decodable]), self._readers) if decodable else []

    def _blocks_of(
        self,
        batch: Iterable[tuple[int, MessageTable]],
        readers: dict[int, ChannelReader],
        *,
        joined: bool = False,
    ) -> list[LoggedBlock]:
        blocks = [
            stamped
            for i, messages in batch
            for stamped in readable(readers[i], messages, self._leave_out, joined=joined)
        ]
        # The sort is stable: blocks of one log time stay in the order of their channels' ids.
        return sorted(blocks, key=attrgetter("log_ns"))

    def _leave_out(self, message: Message, error: CodecError) -> None:
        if self._strict:
            raise error
        at = message.log_time
        key = (message.channel_id, message.sequence, at)
        self._left_out[key] = Damage(0, len(message.data), at, at, 1, str(error))


def _geometry(file: McapFile) -> Geometry | None:
    sites = [ref for ref in file.attachments if ref.name == SITE_NAME]
    if not sites:
        return None
    return Geometry.from_json(file.attachment(sites[-1]), f"{file.name}: {SITE_NAME}")


def _unify(readers: dict[int, ChannelReader]) -> tuple[Stream, ...]:
    """Let channels of one topic share its stream; a topic's other kind of stream gets the id."""
    streams: dict[str, Stream] = {}
    for channel_id, reader in readers.items():
        unified = []
        for stream in reader.streams:
            shared = streams.setdefault(stream.topic, stream)
            same = replace(stream, rate_hz=shared.rate_hz) == shared
            if not same or (stream.rate_hz != shared.rate_hz and not stream.irregular):
                stream = replace(stream, topic=f"{stream.topic}#{channel_id}")
                shared = streams.setdefault(stream.topic, stream)
            unified.append(shared)
        reader.streams = tuple(unified)
    return tuple(streams.values())


#: So many messages of a channel, or so much of their log time [ns], are looked at to know its rate.
#: Chosen by judgement: some seconds of a worn sensor, and thirty fixes of a receiver.
PROBE_MESSAGES, PROBE_NS = 500, 30 * NS_PER_S
_LOCATION_KINDS = {"foxglove.LocationFix", "foxglove.LocationFixes"}


class LoggedBlock(NamedTuple):
    """A block and the log time of the (last) message it came from [ns]."""

    log_ns: int
    block: SignalBlock


class ChannelReader(Protocol):
    """Turns the messages of one channel into blocks of the streams it holds."""

    streams: tuple[Stream, ...]

    def blocks(self, messages: MessageTable, *, joined: bool = False) -> Iterator[LoggedBlock]:
        """Yield the blocks of consecutive messages of the channel, joined where they continue."""


def probe(file: McapFile, channel_id: int) -> MessageTable:
    """Return the first messages of a channel, at most 500 and 30 s, enough to know its rate."""
    messages = MessageTable.none()
    for table in file.tables({channel_id}):
        end_ns = (messages or table)[0].log_time + PROBE_NS
        count = min(table.before(end_ns), PROBE_MESSAGES - len(messages))
        messages = MessageTable.joined([messages, table[:count]])
        if count < len(table):
            break
    return messages


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


def _where(file: McapFile, channel: ChannelRecord) -> str:
    return f"{file.name}: {channel.topic}"


def median_rate(times_ns: NDArray[np.int64]) -> float:
    """Return the inverse of the median interval [Hz]; 1 where there are no two distinct times."""
    steps = np.diff(np.unique(times_ns))
    return NS_PER_S / float(np.median(steps)) if len(steps) else 1.0


class WaveformReader:
    """Reads ``groundtrace.WaveformBlock`` messages, one block each unless they are joined."""

    def __init__(self, stream: Stream, where: str) -> None:
        self.streams: tuple[Stream, ...] = (stream,)
        self._where = where
        self._count = 0  # samples of the last message: most have as many

    def blocks(self, messages: MessageTable, *, joined: bool = False) -> Iterator[LoggedBlock]:
        """Yield one block per message, or per run of messages that continue each other."""
        run: WaveformRun | None = None
        log_ns = 0
        for message in messages:
            if run is None or not (joined and run.take(message.data)):
                if run is not None:
                    yield LoggedBlock(log_ns, run.block())
                run = WaveformRun(self.streams[0], message.data, self._where, self._count)
                self._count = run.count
            log_ns = message.log_time
        if run is not None:
            yield LoggedBlock(log_ns, run.block())


def _waveform_reader(file: McapFile, channel: ChannelRecord) -> WaveformReader | None:
    where = _where(file, channel)
    if STREAM_KEY in channel.metadata:
        text = channel.metadata[STREAM_KEY]
        return WaveformReader(stream_from_json(text, channel.topic, where), where)
    wave = _first_wave(probe(file, channel.id), where)
    if wave is None:
        return None
    columns = range(1, 1 + wave.samples.shape[1])
    channels = tuple(Channel(f"ch{i}", "seismic", "count") for i in columns)
    rate = wave.rate_hz if wave.times_ns is None else median_rate(wave.times_ns)
    stream = Stream(channel.topic, channels, rate, irregular=wave.times_ns is not None)
    return WaveformReader(stream, where)


def _first_wave(messages: Sequence[Message], where: str) -> Waveform | None:
    """Return the first message that can be decoded."""
    for message in messages:
        with suppress(CodecError):
            return decode_waveform(message.data, where)
    return None


class RosReader:
    """Reads ROS 2 messages, many at once; a message may hold several streams.

    Attributes
    ----------
    streams
        What the messages hold.
    sources
        Where in the messages each is.
    assumed
        One line for each stream that the type of its message does not tell to be one.
    """

    def __init__(
        self,
        definition: Definition,
        sources: Sequence[RosSource],
        streams: Sequence[Stream],
        where: str,
    ) -> None:
        self.streams: tuple[Stream, ...] = tuple(streams)
        self._where = where
        self.sources = sources
        self._decoder = CdrDecoder(definition, where)
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

    def blocks(self, messages: MessageTable, *, joined: bool = True) -> Iterator[LoggedBlock]:  # noqa: ARG002
        """Yield the blocks of consecutive messages: one per stream and contiguous run."""
        log_ns = log_times(messages, self._where)
        tables = list(self._decoder.tables(messages.by_size()))
        for source, stream, order in zip(self.sources, self.streams, self._orders, strict=True):
            samples = read_samples(source, tables, log_ns)
            if not len(samples.times_ns):
                continue
            as_decoded = order == list(range(samples.values.shape[1]))
            values = samples.values if as_decoded else samples.values[:, order]
            if stream.irregular:
                first = messages[0].sequence
                block = SignalBlock(
                    stream, int(samples.times_ns[0]), first, values, samples.times_ns
                )
                yield LoggedBlock(messages[-1].log_time, block)
            else:
                indices = messages.rows["sequence"]
                yield from _runs(stream, indices, samples.times_ns, values, log_ns)


def log_times(messages: MessageTable, where: str) -> NDArray[np.int64]:
    """Return the log time of every message [ns].

    Raises
    ------
    SchemaError
        Where one does not fit an int64; names ``where``.
    """
    times = messages.rows["log_time"].astype(np.int64)
    if (times < 0).any():
        latest = messages.rows["log_time"].max()
        raise SchemaError(f"{where}: log_time: expected less than 2^63 ns, found {latest}")
    return times


def _runs(
    stream: Stream,
    indices: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    log_ns: NDArray[np.int64],
) -> Iterator[LoggedBlock]:
    """Cut uniform samples where index or anchor jump; the index is the message's sequence."""
    anchors = times_ns - np.rint(indices * stream.period_ns).astype(np.int64)
    breaks = np.flatnonzero((np.diff(indices) != 1) | (np.diff(anchors) != 0)) + 1
    for start, stop in zip([0, *breaks], [*breaks, len(indices)], strict=True):
        block = SignalBlock(stream, int(anchors[start]), int(indices[start]), values[start:stop])
        yield LoggedBlock(int(log_ns[stop - 1]), block)


def _ros_reader(file: McapFile, channel: ChannelRecord, schema: Schema) -> RosReader | None:
    where = _where(file, channel)
    try:
        definition = parse_ros2msg(schema.name, schema.data.decode("utf-8", "replace"))
    except SchemaError:
        # A foreign schema that cannot be read is a channel left alone, not a broken recording.
        return None
    sources = find_sources(definition)
    if not sources:
        return None
    if STREAM_KEY in channel.metadata:
        stream = stream_from_json(channel.metadata[STREAM_KEY], channel.topic, where)
        if definition.name not in KINDS or kind_of(stream) != definition.name:
            raise SchemaError(f"{where}: expected the channels of {definition.name}, found others")
        return RosReader(definition, sources, (stream,), where)
    return _estimated(file, channel, definition)


def nominal_reader(definition: Definition, topic: str, where: str) -> RosReader | None:
    """Return the reader of a topic of another tool at a nominal 1 Hz, None without signals."""
    sources = find_sources(definition)
    if not sources:
        return None
    streams = [Stream(topic + s.suffix, s.channels, 1.0, irregular=True) for s in sources]
    return RosReader(definition, sources, streams, where)


def _estimated(file: McapFile, channel: ChannelRecord, definition: Definition) -> RosReader | None:
    """Return the reader of a foreign channel; its rates are those of its first messages."""
    messages = probe(file, channel.id)
    reader = nominal_reader(definition, channel.topic, _where(file, channel))
    if not messages or reader is None:
        return None
    blocks = [b for _, b in readable(reader, messages, pass_over)]
    if reader.assumed and not all(in_range(b.samples) for b in blocks):
        return None
    times = {b.topic: b.sample_times() for b in blocks}
    streams = [
        replace(telling(s, blocks), rate_hz=median_rate(times.get(s.topic, np.empty(0, np.int64))))
        for s in reader.streams
    ]
    return RosReader(definition, reader.sources, streams, _where(file, channel))


def telling(stream: Stream, blocks: Iterable[SignalBlock]) -> Stream:
    """Return a stream of fixes without the accuracy, where none of its first blocks tells any."""
    accuracy = stream.columns_of(ACCURACY)
    first = [b.samples[:, accuracy] for b in blocks if b.topic == stream.topic]
    if any(np.isfinite(samples).any() for samples in first):
        return stream
    return stream.select([i for i in range(len(stream.channels)) if i not in accuracy])


class LocationReader:
    """Reads ``foxglove.LocationFix`` and ``foxglove.LocationFixes``."""

    def __init__(self, stream: Stream, schema_name: str, where: str) -> None:
        self.streams: tuple[Stream, ...] = (stream,)
        self._many = schema_name.endswith("Fixes")
        self._where = where

    def _fixes(self, message: Message) -> Sequence[Any]:
        if self._many:
            from foxglove_schemas_protobuf.LocationFixes_pb2 import LocationFixes

            fixes: Sequence[Any] = parse(LocationFixes, message.data, self._where).fixes
            return fixes
        from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

        return (parse(LocationFix, message.data, self._where),)

    def blocks(self, messages: MessageTable, *, joined: bool = True) -> Iterator[LoggedBlock]:  # noqa: ARG002
        """Yield one block of all the fixes."""
        logs = log_times(messages, self._where)
        pairs = [(m, fix) for m in messages for fix in self._fixes(m)]
        if not pairs:
            return
        times = [get_time(fix.timestamp, self._where) or m.log_time for m, fix in pairs]
        rows = [(f.latitude, f.longitude, f.altitude, _accuracy_m(f)) for _, f in pairs]
        values = np.array(rows, np.float64)[:, : len(self.streams[0].channels)]
        block = SignalBlock(self.streams[0], times[0], 0, values, np.array(times, np.int64))
        yield LoggedBlock(int(logs[-1]), block)


def _location_reader(
    file: McapFile, channel: ChannelRecord, schema_name: str
) -> LocationReader | None:
    try:
        import foxglove_schemas_protobuf  # noqa: F401
    except ImportError as error:
        raise CodecError(f"{file.name}: expected foxglove-schemas-protobuf, found none") from error
    messages = probe(file, channel.id)
    channels = tuple(c for _, c in fields_of("sensor_msgs/NavSatFix"))
    stream = Stream(channel.topic, channels, 1.0, irregular=True)
    reader = LocationReader(stream, schema_name, _where(file, channel))
    blocks = [b for _, b in readable(reader, messages, pass_over)]
    if not blocks:
        return None
    rate_hz = median_rate(blocks[0].sample_times())
    reader.streams = (replace(telling(stream, blocks), rate_hz=rate_hz),)
    return reader


def _accuracy_m(fix: Any) -> float:
    """Return the accuracy of a ``foxglove.LocationFix``, NaN where it tells none."""
    covariance = list(fix.position_covariance)
    if len(covariance) != 9 or not fix.position_covariance_type:
        return float("nan")
    return float(accuracy_m(np.array(covariance[0] + covariance[4])))


def readable(
    reader: ChannelReader,
    messages: MessageTable,
    leave_out: Callable[[Message, CodecError], None],
    *,
    joined: bool = False,
) -> list[LoggedBlock]:
    """Decode messages without those that are not what their schema says.

    Parameters
    ----------
    reader
        Of their channel.
    messages
        In order; where some cannot be decoded, halves of them are tried.
    leave_out
        Is told each message that is left out, and why; it may raise instead.
    joined
        Whether messages that continue each other become one block.
    """
    try:
        return list(reader.blocks(messages, joined=joined))
    except CodecError as error:
        # millions of empty messages are not tried one by one
        times = messages.rows["log_time"]
        if (
            messages.same_payload_count() == len(messages)
            and times.min() >> 63 == times.max() >> 63
        ):
            for message in messages:
                leave_out(message, error)
            return []
    half = len(messages) // 2
    first = readable(reader, messages[:half], leave_out, joined=joined)
    return first + readable(reader, messages[half:], leave_out, joined=joined)


def pass_over(_message: Message, _error: CodecError) -> None:
    """Say nothing: reading the recording says it."""


@dataclass(frozen=True, slots=True)
class OtherTopic:
    """A topic that carries no known signal and is left alone.

    Attributes
    ----------
    topic, schema, encoding
        Of the channel; ``encoding`` is that of its messages.
    messages
        How many there are.
    fields
        Names of the message's own fields, where its schema can be read.
    """

    topic: str
    schema: str
    encoding: str
    messages: int
    fields: tuple[str, ...] = ()


def is_ours(file: Described, channel: ChannelRecord) -> bool:
    """Tell whether groundtrace wrote a channel: an event, a preview, a mirror."""
    schema = file.schemas.get(channel.schema_id)
    if schema is not None and schema.name.startswith("groundtrace."):
        return True
    return any(key.startswith("groundtrace.") for key in channel.metadata)


def other_topic(file: McapFile, channel: ChannelRecord) -> OtherTopic:
    """Describe a channel that is left alone."""
    schema = file.schemas.get(channel.schema_id)
    count = file.message_counts.get(channel.id, 0)
    if schema is None:
        return OtherTopic(channel.topic, "", channel.message_encoding, count)
    fields: tuple[str, ...] = ()
    if schema.encoding == "protobuf":
        fields = field_names(schema.data, schema.name)
    elif schema.encoding == "ros2msg":
        try:
            text = schema.data.decode("utf-8", "replace")
            fields = tuple(f.name for f in parse_ros2msg(schema.name, text).fields)
        except SchemaError:
            fields = ()
    return OtherTopic(channel.topic, schema.name, channel.message_encoding, count, fields)


_channel = itemgetter(0)


def batches(
    tables: Iterable[MessageTable], batch_ns: int
) -> Iterator[list[tuple[int, MessageTable]]]:
    """Yield the messages between multiples of ``batch_ns`` of log time, by channel id.

    Parameters
    ----------
    tables
        Messages in order of log time.
    batch_ns
        Length of a span.
    """
    pending: list[MessageTable] = []
    number = None
    for table in tables:
        done = 0
        while done < len(table):
            batch_index = int(table.rows["log_time"][done]) // batch_ns
            if batch_index != number and pending:
                yield _by_channel(pending)
                pending = []
            number = batch_index
            stop = table.before((batch_index + 1) * batch_ns)
            pending.append(table[done:stop])
            done = stop
    if pending:
        yield _by_channel(pending)


def _by_channel(tables: Sequence[MessageTable]) -> list[tuple[int, MessageTable]]:
    """Return the messages of each channel as one table, in the order of their ids."""
    parts = [(i, table.of_channels([i])) for table in tables for i in table.counts()]
    grouped = groupby(sorted(parts, key=_channel), key=_channel)
    return [(i, MessageTable.joined([part for _, part in group])) for i, group in grouped]


@dataclass(frozen=True, slots=True)
class Lag:
    """Range of log time minus sample time at the start of a channel, and its first sample."""

    low_ns: int
    high_ns: int
    first_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class CountedMessages:
    """Where the messages of a uniform stream are, by the index of its file.

    Attributes
    ----------
    file, channel_id, reader, stream
        What holds the messages, and what is made of them.
    first_ns
        The first sample [ns].
    chunks
        Those with messages, in the order of the file.
    before
        Shape (n_chunks,): messages before each.
    """

    file: McapFile
    channel_id: int
    reader: ChannelReader
    stream: Stream
    first_ns: int
    chunks: tuple[ChunkEntry, ...]
    before: NDArray[np.int64]

    def chunk_at(self, log_ns: int) -> int:
        """Return the last chunk that begins at a log time [ns] or before; -1 if none does."""
        starts = [chunk.start_ns for chunk in self.chunks]
        return bisect_right(starts, log_ns) - 1

    def blocks(self, chunk: int) -> Iterator[SignalBlock]:
        """Yield a block for each message from a chunk on; one that cannot be decoded is left out.

        Chunks are read when they are asked for.
        """
        for entry in self.chunks[chunk:]:
            table = self.file.chunk(entry, self.channel_id)
            for i in range(len(table)):
                for _, block in readable(self.reader, table[i : i + 1], pass_over):
                    if block.topic == self.stream.topic:
                        yield block


def lags_of(file: McapFile, readers: dict[int, ChannelReader]) -> dict[int, Lag]:
    """Return the lag of each channel that has samples, by its id."""
    begin = next(file.tables(readers.keys()), MessageTable.none())
    lags = {i: _lag([begin.of_channels([i])], reader) for i, reader in readers.items()}
    del begin  # its memory is wanted for what comes first of each other channel
    late = {i: lags[i] or _lag(file.tables({i}), reader) for i, reader in readers.items()}
    return {i: lag for i, lag in late.items() if lag is not None}


def _lag(tables: Iterable[MessageTable], reader: ChannelReader) -> Lag | None:
    """Return the lag of a channel's first message that can be read."""
    for message in (first for table in tables for first in _firsts(table)):
        try:
            times = [b.sample_times() for _, b in reader.blocks(message)]
        except CodecError:
            continue  # reading says it
        if times:
            early = min(int(t.min()) for t in times)
            late = max(int(t.max()) for t in times)
            logged = message[0].log_time
            return Lag(logged - late, logged - early, early)
    return None


def _firsts(table: MessageTable) -> Iterator[MessageTable]:
    """Yield the messages of a table, of those in a row that are the same the first alone."""
    while table:
        yield table[:1]
        table = table[table.same_payload_count() :]
