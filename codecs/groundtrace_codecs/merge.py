"""Merges several recordings into one file on one clock, with the whole content of each."""

from __future__ import annotations

import heapq
import struct
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from .annotations import ANNOTATIONS_TOPIC
from .copies import atomic_write
from .device_clocks import MERGE, SAME_CLOCK, DeviceClock, MergedClock, clocks_record
from .errors import CodecError, FormatError, SchemaError
from .events import PreviousLabels
from .geometry import SITE_NAME
from .mcap.writer import Container
from .schemas.event_messages import TRUTH_TOPIC, decode_label, label_channels
from .schemas.protobuf import get_time, message_class, parse, set_time
from .schemas.ros2 import CdrDecoder, Layout, parse_ros2msg
from .signals import NS_PER_S, PREVIEW_KEY, STREAM_KEY, stream_from_json, stream_json
from .writer import TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from .events import Label
    from .mcap.chunks import ChannelRecord, Damage, Message, Schema
    from .mcap.reader import McapFile
    from .recording import Recording
    from .signals import Stream

#: Topics that every recording may have; of signals each topic belongs to one file.
SHARED_TOPICS = frozenset({TRUTH_TOPIC, ANNOTATIONS_TOPIC, TRANSFORM_TOPIC})


@dataclass(frozen=True, slots=True)
class Merged:
    """What a merged file holds.

    Attributes
    ----------
    messages
        How many of each topic.
    conflicts
        What two files say differently or both, and where it is kept; one line each.
    unmoved
        Topics whose messages hold no times that are known: only their log times were moved.
    damage
        What could not be read, of any file.
    """

    messages: dict[str, int]
    conflicts: tuple[str, ...]
    unmoved: tuple[str, ...]
    damage: tuple[Damage, ...]


def merge(
    parts: Sequence[Part], path: Path, clocks: Sequence[MergedClock], *, force: bool = False
) -> Merged:
    """Write recordings as one, on the clock of the first.

    Every message, attachment and metadata record is in the merged file. A label that an earlier
    file has too (same kind and target within 0.1 s; a span that overlaps one) goes to
    ``/truth/NAME`` instead of ``/truth``. The geometry is that of the first file that has one;
    attachments, metadata records and transforms of a name that is taken get the file's name too.

    Parameters
    ----------
    parts
        The files; the first one's clock is the common one.
    path
        The merged file.
    clocks
        What is written about the clocks. Empty: an earlier merge is undone, its record goes.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        Where two files have a topic of one name, or a file cannot be used.
    """
    check_topics(parts)
    profiles = {part.recording.file.profile for part in parts}
    profile = profiles.pop() if len(profiles) == 1 else ""
    with atomic_write(Container(path, "zstd", force, profile=profile)) as container:
        writer = _Merger(container, undoing=not clocks)
        for part in parts:
            writer.add(part)
        counts = writer.write()
        if clocks:
            container.add_metadata(MERGE, clocks_record(clocks))
    damage = tuple(d for part in parts for d in part.recording.file.damage)
    return Merged(counts, tuple(writer.conflicts), tuple(sorted(writer.unmoved)), damage)


def check_topics(parts: Sequence[Part]) -> None:
    """Refuse two files that have a topic of one name.

    Raises
    ------
    CodecError
        Names the topic and the option that mends it.
    """
    owner: dict[str, str] = {}
    for part in parts:
        topics = (part.renamed(c).topic for c in part.recording.file.channels.values())
        for topic in sorted({t for t in topics if t not in SHARED_TOPICS}):
            if topic in owner:
                raise CodecError(
                    f"{part.name}: {topic}: expected a topic that no other file has, found it in "
                    f"{owner[topic]} too; try --rename {part.name}:{topic}={topic}/{part.name} or "
                    f"--prefix {part.name}=/{part.name}"
                )
            owner[topic] = part.name


class _Merger:
    """Collects the files, then writes their messages by their times."""

    def __init__(self, container: Container, *, undoing: bool) -> None:
        self._container = container
        self._undoing = undoing
        self._queues: list[Iterator[tuple[int, int, Message]]] = []
        self._topics: dict[int, str] = {}
        self._truth = PreviousLabels()
        self._attached: dict[str, bytes] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._placed = False
        self.conflicts: list[str] = []
        self.unmoved: set[str] = set()

    def add(self, part: Part) -> None:
        """Take a file: what is no message is written at once."""
        file = part.recording.file
        labels = label_channels(file, TRUTH_TOPIC)
        places = {i for i, c in file.channels.items() if c.topic == TRANSFORM_TOPIC}
        aside = "" if not self._placed else f"/{part.name}"
        channels = {i: retimed(file, c, part.clock_of(c)) for i, c in file.channels.items()}
        groups: dict[DeviceClock, list[int]] = {}
        ids: dict[int, int] = {}
        for i, channel in sorted(channels.items()):
            target = self._record(part, channel)
            target = replace(target, topic=target.topic + aside) if i in places else target
            ids[i] = self._register(file, target)
            if channel.mover is None and not channel.clock.same:
                self.unmoved.add(target.topic)
            if i not in labels:
                groups.setdefault(channel.clock, []).append(i)
        for members in groups.values():
            self._queues.append(_queue(file, members, channels, ids))
        self._add_truth(part, {i: ids[i] for i in labels}, channels)
        self._add_attachments(part)
        self._add_metadata(part)
        self._placed |= bool(places)

    def write(self) -> dict[str, int]:
        """Write all messages by their times; return how many of each topic."""
        counts: Counter[str] = Counter(dict.fromkeys(self._topics.values(), 0))
        for _, channel_id, message in heapq.merge(*self._queues, key=lambda item: item[0]):
            self._container.copy(channel_id, message)
            counts[self._topics[channel_id]] += 1
        return dict(sorted(counts.items()))

    def _record(self, part: Part, channel: RetimedChannel) -> ChannelRecord:
        named = part.renamed(channel.channel)
        if self._undoing:
            return named
        return replace(named, metadata=named.metadata | {ORIGIN_KEY: part.name})

    def _register(self, file: McapFile, channel: ChannelRecord) -> int:
        channel_id = self._container.copy_channel(channel, file.schemas.get(channel.schema_id))
        self._topics[channel_id] = channel.topic
        return channel_id

    def _add_truth(
        self, part: Part, ids: Mapping[int, int], channels: Mapping[int, RetimedChannel]
    ) -> None:
        """Take a file's labels; what an earlier file says too goes to a topic of its own."""
        file = part.recording.file
        fresh: list[Label] = []
        queue: list[tuple[int, int, Message]] = []
        aside: dict[int, int] = {}
        for message in file.messages(ids.keys()):
            channel = channels[message.channel_id]
            # labels wait until they are in order, and a view would keep the whole chunk
            moved = channel.message(message._replace(data=bytes(message.data)))
            label = decode_label(moved.data, file.name)
            target = ids[message.channel_id]
            if self._truth.holds(label):
                if message.channel_id not in aside:
                    record = replace(self._record(part, channel), topic=_aside(part))
                    aside[message.channel_id] = self._register(file, record)
                target = aside[message.channel_id]
            else:
                fresh.append(label)
            queue.append((moved.log_time, target, moved))
        self._truth.add(fresh)
        self._queues.append(iter(sorted(queue, key=lambda item: item[0])))
        if doubled := len(queue) - len(fresh):
            self.conflicts.append(
                f"{part.name}: {doubled} of {len(queue)} labels say what an earlier file says: "
                f"kept on {_aside(part)}"
            )

    def _add_attachments(self, part: Part) -> None:
        file = part.recording.file
        for ref in file.attachments:
            try:
                data = file.attachment(ref)
            except FormatError as error:
                self.conflicts.append(f"{error}; it is not in the merged file")
                continue
            name = ref.name
            if name in self._attached:
                if self._attached[name] == data:
                    continue
                name = f"{part.name}/{name}"
                what = "geometry" if ref.name == SITE_NAME else f"attachment {ref.name}"
                self.conflicts.append(f"{part.name}: another {what}: kept as attachment {name}")
            self._attached[name] = data
            log_ns = part.clock.common(ref.log_time) if ref.log_time else 0
            made = ref.create_time
            self._container.add_attachment(max(log_ns, 0), name, ref.media_type, data, made)

    def _add_metadata(self, part: Part) -> None:
        for record in part.recording.file.metadata:
            name = record.name
            if name in self._metadata:
                if self._metadata[name] == record.values:
                    continue
                name = f"{name}/{part.name}"
            elif name == MERGE:
                if self._undoing:
                    continue
                name = f"{name}/{part.name}"
            self._metadata[name] = dict(record.values)
            self._container.add_metadata(name, record.values)


def _aside(part: Part) -> str:
    """Return the topic of labels that an earlier file has too."""
    return f"{TRUTH_TOPIC}/{part.name}"


def _queue(
    file: McapFile,
    members: Sequence[int],
    channels: Mapping[int, RetimedChannel],
    ids: Mapping[int, int],
) -> Iterator[tuple[int, int, Message]]:
    """Yield the messages of channels of one clock, which keep their order."""
    for message in file.as_recorded(set(members)):
        moved = channels[message.channel_id].message(message)
        yield moved.log_time, ids[message.channel_id], moved


_TIMESTAMP = "google.protobuf.Timestamp"
_ROS_STAMP_S = 1 << 31


class TimestampRewriter(Protocol):
    """Puts the content of a channel's messages on another clock."""

    def moved(self, message: Message) -> bytes:
        """Return the message's content."""
        ...


@dataclass(frozen=True, slots=True)
class RetimedChannel:
    """A channel on another clock.

    Attributes
    ----------
    channel
        Its record, with the rate the common clock measures.
    clock
        The clock it was recorded with.
    mover
        Moves what is inside its messages; None where they hold no times that are known.
    """

    channel: ChannelRecord
    clock: DeviceClock
    mover: TimestampRewriter | None

    def message(self, message: Message) -> Message:
        """Return a message with all its times on the common clock.

        Raises
        ------
        CodecError
            Where a time would lie before 1970, which MCAP cannot hold.
        """
        if self.clock.same:
            return message
        log_ns, publish_ns = (
            self.clock.common(t) for t in (message.log_time, message.publish_time)
        )
        if min(log_ns, publish_ns) < 0:
            raise CodecError(
                f"{self.channel.topic}: expected times >= 0 on the common clock, found "
                f"{min(log_ns, publish_ns)} ns"
            )
        data: bytes | memoryview = message.data
        if self.mover is not None:
            with suppress(SchemaError, FormatError):  # whoever reads it says what is wrong with it
                data = self.mover.moved(message)
        return message._replace(log_time=log_ns, publish_time=publish_ns, data=data)


def retimed(file: McapFile, channel: ChannelRecord, clock: DeviceClock) -> RetimedChannel:
    """Return how a channel comes onto the common clock.

    Waveforms and ROS messages of groundtrace keep their sample counters: their times are those of
    the run's start and the counter at the new rate, so that no sample is off by rounding.

    Parameters
    ----------
    file, channel
        Where it was recorded.
    clock
        The clock it was recorded with.
    """
    if clock.same:
        return RetimedChannel(channel, clock, None)
    where = f"{file.name}: {channel.topic}"
    stream: Stream | None = None
    if STREAM_KEY in channel.metadata:
        stream = stream_from_json(channel.metadata[STREAM_KEY], channel.topic, where)
        faster = replace(stream, rate_hz=stream.rate_hz * clock.speed)
        metadata = channel.metadata | {STREAM_KEY: stream_json(faster)}
        channel = replace(channel, metadata=metadata)
    mover = _mover(file.schemas.get(channel.schema_id), channel, stream, clock, where)
    return RetimedChannel(channel, clock, mover)


def _mover(
    schema: Schema | None,
    channel: ChannelRecord,
    stream: Stream | None,
    clock: DeviceClock,
    where: str,
) -> TimestampRewriter | None:
    if schema is None:
        return None
    kind = (channel.message_encoding, schema.encoding)
    if kind == ("protobuf", "protobuf"):
        if schema.name == "groundtrace.WaveformBlock":
            return _Waveforms(clock, where)
        return _Protobuf.of(schema, clock, where)
    if kind == ("cdr", "ros2msg"):
        return _Ros.of(schema, stream, clock, where)
    return None


class _Waveforms:
    """WaveformBlocks: start, own times, and the rate."""

    def __init__(self, clock: DeviceClock, where: str) -> None:
        self._clock = clock
        self._where = where

    def moved(self, message: Message) -> bytes:
        wave = parse(message_class("WaveformBlock"), message.data, self._where)
        start_ns = get_time(wave.timestamp, self._where)
        if wave.sample_times_ns:
            times = np.frombuffer(wave.sample_times_ns, "<i8")
            wave.sample_times_ns = self._clock.common_times(times).astype("<i8").tobytes()
            set_time(wave.timestamp, self._clock.common(start_ns))
        elif wave.sample_rate > 0:
            rate_hz = wave.sample_rate * self._clock.speed
            first, before = wave.first_sample, NS_PER_S / wave.sample_rate
            anchor_ns = self._clock.common(start_ns - round(first * before))
            wave.sample_rate = rate_hz
            set_time(wave.timestamp, anchor_ns + round(first * (NS_PER_S / rate_hz)))
        encoded: bytes = wave.SerializeToString()
        return encoded


class _Protobuf:
    """Any protobuf message: every Timestamp in it, however deep."""

    def __init__(self, kind: Any, clock: DeviceClock, where: str) -> None:
        self._kind = kind
        self._clock = clock
        self._where = where

    @classmethod
    def of(cls, schema: Schema, clock: DeviceClock, where: str) -> _Protobuf | None:
        """Return the mover of a message type; None where its schema cannot be read."""
        pool = descriptor_pool.DescriptorPool()
        try:
            for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(file)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        except (DecodeError, KeyError, TypeError):
            return None
        return cls(kind, clock, where)

    def moved(self, message: Message) -> bytes:
        content = parse(self._kind, message.data, self._where)
        self._walk(content)
        encoded: bytes = content.SerializeToString()
        return encoded

    def _walk(self, content: Any) -> None:
        if content.DESCRIPTOR.full_name == _TIMESTAMP:
            set_time(content, self._clock.common(get_time(content, self._where)))
            return
        for member, value in content.ListFields():
            if member.message_type is None:
                continue
            if member.message_type.GetOptions().map_entry:
                continue
            for inner in [value] if hasattr(value, "DESCRIPTOR") else value:
                self._walk(inner)


class _Ros:
    """ROS 2 messages: every header's stamp that is not zero."""

    def __init__(
        self, decoder: CdrDecoder, stream: Stream | None, clock: DeviceClock, where: str
    ) -> None:
        self._decoder = decoder
        self._clock = clock
        self._where = where
        self._layouts: dict[int, tuple[Layout, list[tuple[int, int, str]]]] = {}
        counted = stream is not None and not stream.irregular
        self._rate_hz = stream.rate_hz if stream is not None and counted else None

    @classmethod
    def of(
        cls, schema: Schema, stream: Stream | None, clock: DeviceClock, where: str
    ) -> _Ros | None:
        """Return the mover of a message type; None where its schema cannot be read."""
        try:
            definition = parse_ros2msg(schema.name, schema.data.decode("utf-8", "replace"))
        except SchemaError:
            return None
        return cls(CdrDecoder(definition, where), stream, clock, where)

    def moved(self, message: Message) -> bytes:
        data = bytearray(message.data)
        for sec, nanosec, order in self._stamps(bytes(data)):
            (seconds,) = struct.unpack_from(f"{order}i", data, sec)
            (nanos,) = struct.unpack_from(f"{order}I", data, nanosec)
            if seconds == 0 and nanos == 0:  # an unset stamp says: see the log time
                continue
            time_ns = self._time(seconds * NS_PER_S + nanos, message.sequence)
            seconds, nanos = divmod(time_ns, NS_PER_S)
            if not 0 <= seconds < _ROS_STAMP_S:
                raise CodecError(
                    f"{self._where}: expected a stamp of 1970 to 2038, found {seconds} s"
                )
            struct.pack_into(f"{order}i", data, sec, seconds)
            struct.pack_into(f"{order}I", data, nanosec, nanos)
        return bytes(data)

    def _time(self, time_ns: int, sequence: int) -> int:
        if self._rate_hz is None:
            return self._clock.common(time_ns)
        anchor_ns = self._clock.common(time_ns - round(sequence * (NS_PER_S / self._rate_hz)))
        # divided as whoever reads it divides, or the last digit would differ
        return anchor_ns + round(sequence * (NS_PER_S / (self._rate_hz * self._clock.speed)))

    def _stamps(self, data: bytes) -> list[tuple[int, int, str]]:
        """Return where seconds and nanoseconds of each stamp lie, and the byte order."""
        cached = self._layouts.get(len(data))
        if cached is None or not cached[0].fits(np.frombuffer(data, f"V{len(data)}"))[0]:
            layout = self._decoder.layout(data)
            cached = self._layouts[len(data)] = (layout, _stamps_in(layout))
        return cached[1]


def _stamps_in(layout: Layout) -> list[tuple[int, int, str]]:
    stamps = []
    for path, places in layout.places.items():
        if not path.endswith("stamp.sec"):
            continue
        nanos = layout.places.get(f"{path.removesuffix('sec')}nanosec", [])
        for sec, nanosec in zip(places, nanos, strict=False):
            if sec.dtype[1:] in ("i4", "u4") and nanosec.dtype[1:] == "u4":
                stamps.append((sec.offset, nanosec.offset, sec.dtype[0]))
    return stamps


#: Channel metadata: name of the file that a channel was in.
ORIGIN_KEY = "merged_from"


@dataclass(frozen=True, slots=True)
class Part:
    """One file of a merge.

    Attributes
    ----------
    recording
        The file.
    name
        What it is called in the merged file, each by another name.
    clock
        Its clock.
    topic_clocks
        Clocks of topics that have their own.
    renames
        New names of topics.
    origin_clocks
        Clocks of channels by the file they were in before an earlier merge.
    """

    recording: Recording
    name: str
    clock: DeviceClock = SAME_CLOCK
    topic_clocks: Mapping[str, DeviceClock] = field(default_factory=dict)
    renames: Mapping[str, str] = field(default_factory=dict)
    origin_clocks: Mapping[str, DeviceClock] = field(default_factory=dict)

    def clock_of(self, channel: ChannelRecord) -> DeviceClock:
        """Return the clock of a channel; a preview has that of the stream it was made from."""
        for topic in (channel.topic, channel.metadata.get(PREVIEW_KEY, "")):
            if topic in self.topic_clocks:
                return self.topic_clocks[topic]
        return self.origin_clocks.get(channel.metadata.get(ORIGIN_KEY, ""), self.clock)

    def renamed(self, channel: ChannelRecord) -> ChannelRecord:
        """Return a channel under its new name; previews go with their streams."""
        made_from = channel.metadata.get(PREVIEW_KEY, "")
        if made_from in self.renames:
            new = self.renames[made_from]
            metadata = channel.metadata | {PREVIEW_KEY: new}
            topic = self.renames.get(channel.topic, new + channel.topic.removeprefix(made_from))
            return replace(channel, topic=topic, metadata=metadata)
        return replace(channel, topic=self.renames.get(channel.topic, channel.topic))
