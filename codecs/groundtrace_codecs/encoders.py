"""Blocks of a stream as messages: which encoding a stream gets, and its preview for other viewers.

A full IMU, a magnetometer, barometer, thermometer or GNSS in SI units becomes a ROS 2 message,
which every viewer draws; everything else a ``groundtrace.WaveformBlock``. Messages and previews
are cut at multiples of absolute sample indices, so that they do not depend on how the samples came.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from .container import Output, Packet
from .description import PREVIEW_KEY, STREAM_KEY, stream_json
from .schemas.cdr_template import CdrTemplate
from .schemas.msgs import ros2msg
from .schemas.protobuf import schema_bytes
from .schemas.ros import RosWriter, kind_of
from .schemas.ros2msg import parse_ros2msg
from .schemas.waveform import encode_waveform, to_format
from .signals import as_one

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from .signals import SignalBlock, Stream

#: Length of a message of samples [s].
MESSAGE_S = 0.1
#: Rate of previews, and the rate above which a waveform gets one [Hz].
PREVIEW_HZ = 100.0
#: Above this rate an IMU is stored in blocks [Hz].
IMU_MAX_HZ = 500.0
_IMU = "sensor_msgs/Imu"
_ARRAY = "std_msgs/Float64MultiArray"
_U32 = (1 << 32) - 1


class Encoder(Protocol):
    """Turns the blocks of one stream into the messages of one channel."""

    @property
    def output(self) -> Output:
        """The channel the messages go to."""

    def encode(self, block: SignalBlock) -> Iterator[Packet]:
        """Yield the messages that a block completes."""

    def flush(self) -> Iterator[Packet]:
        """Yield the message left incomplete at the end."""


def protobuf_output(topic: str, name: str, metadata: tuple[tuple[str, str], ...] = ()) -> Output:
    """Return the channel of a groundtrace message."""
    schema = schema_bytes(name)
    return Output(topic, f"groundtrace.{name}", "protobuf", schema, "protobuf", metadata)


def _ros_output(topic: str, kind: str, key: str, value: str) -> Output:
    name = kind.replace("/", "/msg/")
    return Output(topic, name, "ros2msg", ros2msg(kind).encode(), "cdr", ((key, value),))


def encoders_for(stream: Stream, sample_format: str) -> tuple[Encoder, ...]:
    """Return the encoders of a stream: its own first, then its preview, if it gets one."""
    kind = kind_of(stream)
    slow = stream.irregular or stream.rate_hz <= IMU_MAX_HZ
    if kind is not None and (slow or kind != _IMU):
        return (RosEncoder(stream, kind),)
    waveform = WaveformEncoder(stream, sample_format)
    unscaled = replace(stream, channels=tuple(replace(c, scale=1.0) for c in stream.channels))
    if stream.irregular or stream.rate_hz <= PREVIEW_HZ:
        return (waveform,)
    if kind_of(unscaled) == _IMU:
        return (waveform, ImuPreview(stream))
    return (waveform, Envelope(stream))


class Buckets:
    """Joins blocks and gives them out in runs that end at multiples of ``size`` samples.

    A run ends early where the samples do not continue: another anchor, or a jump of the index.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._pending: list[SignalBlock] = []

    def push(self, block: SignalBlock) -> Iterator[SignalBlock]:
        """Yield the runs that a block completes."""
        if self._pending and not block.continues(self._pending[-1]):
            yield from self.flush()
        self._pending.append(block)
        first, end = self._pending[0].first, block.first + len(block)
        whole = end // self.size * self.size - first
        if whole <= 0:
            self._pending[-1] = _owned(block)
            return
        joined = as_one(self._pending)
        rest = joined.slice(whole, len(joined))
        self._pending = [_owned(rest)] if len(rest) else []
        yield joined.slice(0, whole)

    def flush(self) -> Iterator[SignalBlock]:
        """Yield what is left."""
        if self._pending:
            pending, self._pending = self._pending, []
            yield as_one(pending)

    def starts(self, run: SignalBlock) -> NDArray[np.intp]:
        """Return where in a run its buckets start, shape (n_buckets,)."""
        inner = np.arange(self.size - run.first % self.size, len(run), self.size)
        return np.concatenate([[0], inner]).astype(np.intp)


def _owned(block: SignalBlock) -> SignalBlock:
    """Return a copy: what is kept must not change with a buffer that its owner uses again."""
    times = None if block.times_ns is None else block.times_ns.copy()
    return replace(block, samples=block.samples.copy(), times_ns=times)


def pieces(block: SignalBlock, size: int) -> Iterator[SignalBlock]:
    """Cut a block at multiples of ``size`` samples of its run."""
    starts = Buckets(size).starts(block).tolist()
    for start, stop in zip(starts, [*starts[1:], len(block)], strict=True):
        yield block.slice(start, stop)


def message_samples(stream: Stream) -> int:
    """Return how many samples one message of a stream holds."""
    return max(1, round(MESSAGE_S * stream.rate_hz))


def merged_pieces(
    sources: Sequence[tuple[Stream, str, Iterable[SignalBlock]]],
) -> Iterator[SignalBlock]:
    """Yield pieces of one message's length of all streams' blocks, in order of their ends."""
    queues = [_pieces_of(stream, blocks) for stream, _, blocks in sources]
    return heapq.merge(*queues, key=lambda piece: piece.last_ns)


def _pieces_of(stream: Stream, blocks: Iterable[SignalBlock]) -> Iterator[SignalBlock]:
    for block in blocks:
        if len(block):
            yield from pieces(block, message_samples(stream))


class WaveformEncoder:
    """A stream as WaveformBlocks of 0.1 s."""

    def __init__(self, stream: Stream, sample_format: str) -> None:
        self.output = protobuf_output(
            stream.topic, "WaveformBlock", ((STREAM_KEY, stream_json(stream)),)
        )
        self._format = sample_format
        self._buckets = Buckets(message_samples(stream))
        self._sequence = 0

    def encode(self, block: SignalBlock) -> Iterator[Packet]:
        """Yield the messages that a block completes."""
        stored = to_format(block.samples, self._format, block.topic)
        for run in self._buckets.push(replace(block, samples=stored)):
            yield from self._packets(run)

    def flush(self) -> Iterator[Packet]:
        """Yield the message left incomplete at the end."""
        for run in self._buckets.flush():
            yield from self._packets(run)

    def _packets(self, run: SignalBlock) -> Iterator[Packet]:
        for piece in pieces(run, self._buckets.size):
            times = piece.times_ns
            log_ns = piece.last_ns if times is None else int(times.max())
            data = encode_waveform(piece)
            yield Packet(log_ns, piece.start_ns, self._sequence & _U32, data)
            self._sequence += 1


class RosEncoder:
    """A stream as one ROS 2 message per sample; the message's sequence is the sample's index."""

    def __init__(self, stream: Stream, kind: str) -> None:
        self.output = _ros_output(stream.topic, kind, STREAM_KEY, stream_json(stream))
        self._writer = RosWriter(kind, stream)

    def encode(self, block: SignalBlock) -> Iterator[Packet]:
        """Yield one message per sample."""
        times = block.sample_times()
        data = self._writer.encode(times, block.samples)
        for i, (time_ns, payload) in enumerate(zip(times.tolist(), data, strict=True)):
            yield Packet(time_ns, time_ns, (block.first + i) & _U32, payload)

    def flush(self) -> Iterator[Packet]:
        """Yield nothing: no sample is kept back."""
        yield from ()


def _preview_size(stream: Stream) -> int:
    return math.ceil(stream.rate_hz / PREVIEW_HZ)


def _spans(run: SignalBlock, starts: NDArray[np.intp]) -> Iterator[tuple[int, int]]:
    """Yield time of the first and of the last sample of every bucket."""
    ends = [*(starts[1:] - 1).tolist(), len(run) - 1]
    for start, end in zip(starts.tolist(), ends, strict=True):
        yield run.time_of(start), run.time_of(end)


class Envelope:
    """Minimum and maximum of every channel at 100 Hz, in units: ``[min, max]`` per channel."""

    def __init__(self, stream: Stream) -> None:
        topic = f"{stream.topic}/envelope"
        self.output = _ros_output(topic, _ARRAY, PREVIEW_KEY, stream.topic)
        self._buckets = Buckets(_preview_size(stream))
        self._count = len(stream.channels)
        self._template = CdrTemplate(
            parse_ros2msg(_ARRAY, ros2msg(_ARRAY)),
            {"layout.dim[].label": ["channel", "min_max"]},
            {"layout.dim": 2, "data": 2 * self._count},
        )

    def encode(self, block: SignalBlock) -> Iterator[Packet]:
        """Yield the messages that a block completes."""
        for run in self._buckets.push(block):
            yield from self._packets(run)

    def flush(self) -> Iterator[Packet]:
        """Yield the message left incomplete at the end."""
        for run in self._buckets.flush():
            yield from self._packets(run)

    def _packets(self, run: SignalBlock) -> Iterator[Packet]:
        starts = self._buckets.starts(run)
        values = run.values
        bounds = (np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts))
        table = self._template.table(len(starts))
        table.put("layout.dim[].size", np.array([[self._count, 2]]))
        table.put("layout.dim[].stride", np.array([[2 * self._count, 2]]))
        table.put("data", np.stack(bounds, axis=2).reshape(len(starts), -1))
        for (first, last), data in zip(_spans(run, starts), table.payloads(), strict=True):
            yield Packet(last, first, 0, data)


class ImuPreview:
    """An IMU stored in blocks, averaged to at most 100 Hz, as ``sensor_msgs/Imu``."""

    def __init__(self, stream: Stream) -> None:
        topic = f"{stream.topic}/preview"
        self.output = _ros_output(topic, _IMU, PREVIEW_KEY, stream.topic)
        self._buckets = Buckets(_preview_size(stream))
        self._writer = RosWriter(_IMU, stream)

    def encode(self, block: SignalBlock) -> Iterator[Packet]:
        """Yield the messages that a block completes."""
        for run in self._buckets.push(block):
            yield from self._packets(run)

    def flush(self) -> Iterator[Packet]:
        """Yield the message left incomplete at the end."""
        for run in self._buckets.flush():
            yield from self._packets(run)

    def _packets(self, run: SignalBlock) -> Iterator[Packet]:
        starts = self._buckets.starts(run)
        counts = np.diff([*starts, len(run)])[:, None]
        means = np.add.reduceat(run.values, starts) / counts
        spans = list(_spans(run, starts))
        stamps = np.array([last for _, last in spans], np.int64)
        for (first, last), data in zip(spans, self._writer.encode(stamps, means), strict=True):
            yield Packet(last, first, 0, data)
