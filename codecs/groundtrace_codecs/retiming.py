"""Messages on another clock: every known time in them is moved, samples stay as they are."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from .description import STREAM_KEY, stream_from_json, stream_json
from .errors import CodecError, FormatError, SchemaError
from .schemas.cdr import CdrDecoder, Layout
from .schemas.protobuf import get_time, message_class, parse, set_time
from .schemas.ros2msg import parse_ros2msg
from .signals import NS_PER_S

if TYPE_CHECKING:
    from .clocks import DeviceClock
    from .mcap import ChannelRecord, McapFile, Message, Schema
    from .signals import Stream

_TIMESTAMP = "google.protobuf.Timestamp"
_ROS_STAMP_S = 1 << 31


class Mover(Protocol):
    """Puts the content of a channel's messages on another clock."""

    def moved(self, message: Message) -> bytes:
        """Return the message's content."""
        ...


@dataclass(frozen=True, slots=True)
class Retimed:
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
    mover: Mover | None

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


def retimed(file: McapFile, channel: ChannelRecord, clock: DeviceClock) -> Retimed:
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
        return Retimed(channel, clock, None)
    place = f"{file.name}: {channel.topic}"
    stream: Stream | None = None
    if STREAM_KEY in channel.metadata:
        stream = stream_from_json(channel.metadata[STREAM_KEY], channel.topic, place)
        faster = replace(stream, rate_hz=stream.rate_hz * clock.speed)
        metadata = channel.metadata | {STREAM_KEY: stream_json(faster)}
        channel = replace(channel, metadata=metadata)
    mover = _mover(file.schemas.get(channel.schema_id), channel, stream, clock, place)
    return Retimed(channel, clock, mover)


def _mover(
    schema: Schema | None,
    channel: ChannelRecord,
    stream: Stream | None,
    clock: DeviceClock,
    place: str,
) -> Mover | None:
    if schema is None:
        return None
    kind = (channel.message_encoding, schema.encoding)
    if kind == ("protobuf", "protobuf"):
        if schema.name == "groundtrace.WaveformBlock":
            return _Waveforms(clock, place)
        return _Protobuf.of(schema, clock, place)
    if kind == ("cdr", "ros2msg"):
        return _Ros.of(schema, stream, clock, place)
    return None


class _Waveforms:
    """WaveformBlocks: start, own times, and the rate."""

    def __init__(self, clock: DeviceClock, place: str) -> None:
        self._clock = clock
        self._place = place

    def moved(self, message: Message) -> bytes:
        wave = parse(message_class("WaveformBlock"), message.data, self._place)
        start_ns = get_time(wave.timestamp, self._place)
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

    def __init__(self, kind: Any, clock: DeviceClock, place: str) -> None:
        self._kind = kind
        self._clock = clock
        self._place = place

    @classmethod
    def of(cls, schema: Schema, clock: DeviceClock, place: str) -> _Protobuf | None:
        """Return the mover of a message type; None where its schema cannot be read."""
        pool = descriptor_pool.DescriptorPool()
        try:
            for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(file)
            kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        except (DecodeError, KeyError, TypeError):
            return None
        return cls(kind, clock, place)

    def moved(self, message: Message) -> bytes:
        content = parse(self._kind, message.data, self._place)
        self._walk(content)
        encoded: bytes = content.SerializeToString()
        return encoded

    def _walk(self, content: Any) -> None:
        if content.DESCRIPTOR.full_name == _TIMESTAMP:
            set_time(content, self._clock.common(get_time(content, self._place)))
            return
        for field, value in content.ListFields():
            if field.message_type is None:
                continue
            if field.message_type.GetOptions().map_entry:
                continue
            for inner in [value] if hasattr(value, "DESCRIPTOR") else value:
                self._walk(inner)


class _Ros:
    """ROS 2 messages: every header's stamp that is not zero."""

    def __init__(
        self, decoder: CdrDecoder, stream: Stream | None, clock: DeviceClock, place: str
    ) -> None:
        self._decoder = decoder
        self._clock = clock
        self._place = place
        self._layouts: dict[int, tuple[Layout, list[tuple[int, int, str]]]] = {}
        counted = stream is not None and not stream.irregular
        self._rate_hz = stream.rate_hz if stream is not None and counted else None

    @classmethod
    def of(
        cls, schema: Schema, stream: Stream | None, clock: DeviceClock, place: str
    ) -> _Ros | None:
        """Return the mover of a message type; None where its schema cannot be read."""
        try:
            definition = parse_ros2msg(schema.name, schema.data.decode("utf-8", "replace"))
        except SchemaError:
            return None
        return cls(CdrDecoder(definition, place), stream, clock, place)

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
                    f"{self._place}: expected a stamp of 1970 to 2038, found {seconds} s"
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
        known = self._layouts.get(len(data))
        if known is None or not known[0].fits(np.frombuffer(data, f"V{len(data)}"))[0]:
            layout = self._decoder.layout(data)
            known = self._layouts[len(data)] = (layout, _stamps_in(layout))
        return known[1]


def _stamps_in(layout: Layout) -> list[tuple[int, int, str]]:
    found = []
    for path, places in layout.places.items():
        if not path.endswith("stamp.sec"):
            continue
        nanos = layout.places.get(f"{path.removesuffix('sec')}nanosec", [])
        for sec, nanosec in zip(places, nanos, strict=False):
            if sec.dtype[1:] in ("i4", "u4") and nanosec.dtype[1:] == "u4":
                found.append((sec.offset, nanosec.offset, sec.dtype[0]))
    return found
