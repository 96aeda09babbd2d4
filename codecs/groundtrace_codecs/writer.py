"""Writes recordings: streams, geometry, labels and events into one MCAP file.

A full IMU, a magnetometer, barometer, thermometer or GNSS in SI units becomes a ROS 2 message,
which every viewer draws; everything else a ``groundtrace.WaveformBlock``, with a preview for other
viewers. Messages and previews are cut at multiples of absolute sample indices, so that they do not
depend on the blocks in which the samples came.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from functools import cache
from itertools import chain, islice
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

from .annotations import ANNOTATIONS_TOPIC, SIDECAR, encode_annotation, replace_durably
from .errors import CodecError, NoRoomError
from .events import EVENTS, CandidateBlock, StageSpec, TraceBlock
from .geometry import SITE_NAME
from .mcap.writer import CHUNK_BYTES, TOOL, Container, Output, Packet, tool_version
from .schemas.event_messages import (
    TIMES,
    TRUTH_TOPIC,
    candidates_topic,
    encode_label,
    layout_of,
    spec_json,
    trace_topic,
)
from .schemas.protobuf import descriptor_set, message_class, schema_bytes, set_time
from .schemas.ros2 import CdrTemplate, RosWriter, kind_of, parse_ros2msg, ros2msg
from .schemas.waveform import FORMATS, encode_waveform, to_format
from .signals import PREVIEW_KEY, ROLE_KEY, SPEC_KEY, STREAM_KEY, as_one, stream_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from types import TracebackType

    from numpy.typing import NDArray

    from .annotations import Annotation, Sidecar
    from .events import Event, Label, SingleEvent
    from .geometry import Geometry
    from .signals import SignalBlock, Stream


class RecordingWriter:
    """Writes one recording; a context manager.

    The file grows as ``NAME.partial`` and gets its name when the block ends well. After an
    exception the partial file is finished and stays, readable.

    Parameters
    ----------
    path
        File to write.
    compression
        ``zstd``, ``lz4`` or ``none``.
    force
        Replace an existing file.
    chunk_bytes
        Length at which a chunk is ended, before compression.

    Raises
    ------
    CodecError
        Where the file exists already and ``force`` is not given, or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compression: str = "zstd",
        force: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        #: The file underneath.
        self.container = Container(Path(path), compression, force, chunk_bytes)
        self.path = self.container.path
        self._streams: dict[str, tuple[Stream, tuple[Encoder, ...]]] = {}
        self._geometry: Geometry | None = None
        self._began = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        complete = False
        try:
            self.flush()
            self.begin(0)
            complete = kind is None
        except CodecError:
            # After an exception the first error is the one to be told.
            if kind is None:
                raise
        finally:
            self.container.close(complete=complete)

    def add_stream(self, stream: Stream, sample_format: str = "f32le") -> None:
        """Announce a stream.

        Parameters
        ----------
        stream
            Its topic is new to the file.
        sample_format
            ``i16le``, ``i32le`` (24-bit samples too), ``f32le`` or ``f64le``: how samples are
            stored where the stream becomes WaveformBlocks; ROS 2 messages hold float64.

        Raises
        ------
        CodecError
            Where the topic is taken, the format unknown, or there are no channels.
        """
        where = f"{self.path}: {stream.topic}"
        if stream.topic in self._streams:
            raise CodecError(f"{where}: expected a new topic, found it already added")
        if sample_format not in FORMATS:
            formats = ", ".join(FORMATS)
            raise CodecError(f"{where}: expected one of {formats}, found {sample_format!r}")
        if not stream.channels or not stream.rate_hz > 0:
            raise CodecError(
                f"{where}: expected channels and a positive rate, found {len(stream.channels)} "
                f"channels at {stream.rate_hz} Hz"
            )
        encoders = encoders_for(stream, sample_format)
        self._streams[stream.topic] = (stream, encoders)
        for encoder in encoders:
            self.container.channel(encoder.output)

    def write(self, block: SignalBlock) -> None:
        """Write samples of a stream; blocks may have any length.

        A jump of ``first`` is stored as it is: that is how a gap is known exactly.

        Raises
        ------
        CodecError
            Where the stream was not added, or the samples do not fit it or its format.
        """
        if block.topic not in self._streams:
            raise CodecError(f"{self.path}: {block.topic}: expected an added stream, found none")
        stream, encoders = self._streams[block.topic]
        self._check(stream, block)
        if not len(block):
            return
        for encoder in encoders:
            self._send(encoder.output, encoder.encode(block))

    def _check(self, stream: Stream, block: SignalBlock) -> None:
        where = f"{self.path}: {block.topic}"
        columns = len(stream.channels)
        if block.samples.ndim != 2 or block.samples.shape[1] != columns:
            raise CodecError(
                f"{where}: expected samples of shape (n, {columns}), found {block.samples.shape}"
            )
        if stream.irregular != (block.times_ns is not None):
            expected, actual = ("own", "no") if stream.irregular else ("no", "own")
            raise CodecError(f"{where}: expected {expected} sample times, found {actual}")
        if block.first < 0:
            raise CodecError(f"{where}: expected a first index >= 0, found {block.first}")

    def set_geometry(self, geometry: Geometry) -> None:
        """Store the site: ``site.json`` and the sensors' frames on ``/tf_static``.

        Raises
        ------
        CodecError
            Where the file has one already.
        """
        if self._geometry is not None:
            raise CodecError(f"{self.path}: expected one geometry, found a second")
        self._geometry = geometry

    def add_labels(self, labels: Iterable[Label], topic: str = TRUTH_TOPIC) -> None:
        """Write labels; without a topic they are the recording's truth."""
        output = protobuf_output(topic, "Label")
        self.container.channel(output)
        packets = (Packet(x.time_ns, x.time_ns, 0, encode_label(x)) for x in labels)
        self._send(output, packets)

    def add_annotations(self, annotations: Iterable[Annotation]) -> None:
        """Write annotations, which keep their ids."""
        output = protobuf_output(ANNOTATIONS_TOPIC, "Label")
        self.container.channel(output)
        packets = (
            Packet(a.label.time_ns, a.label.time_ns, 0, encode_annotation(a)) for a in annotations
        )
        self._send(output, packets)

    def add_event(self, event: Event) -> None:
        """Write an event, with its line in ``/groundtrace/log`` where it is a single one."""
        for output, packet in encode_event(event):
            if packet is None or not self._began:
                self.container.channel(output)
            if packet is not None:
                self.begin(packet.publish_ns)
                self.container.send(output, packet)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a Metadata record."""
        self.container.add_metadata(name, values)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        self.container.add_attachment(0, name, media_type, data)

    def _send(self, output: Output, packets: Iterable[Packet]) -> None:
        for packet in packets:
            self.begin(packet.publish_ns)
            self.container.send(output, packet)

    def begin(self, time_ns: int) -> None:
        """Write the site once the first time is known: a transform at 1970 would lie far off."""
        if self._began or self._geometry is None:
            return
        self._began = True
        site = self._geometry.to_json()
        self.container.add_attachment(time_ns, SITE_NAME, "application/json", site)
        output, packet = transforms(self._geometry, time_ns)
        self.container.channel(output)
        self._send(output, (packet,))

    def flush(self) -> None:
        """Write what is held back, and end the chunks in progress."""
        for encoder in (e for _, encoders in self._streams.values() for e in encoders):
            self._send(encoder.output, encoder.flush())
        self.container.flush()


def write_recording(
    path: str | Path,
    sources: Sequence[tuple[Stream, str, Iterable[SignalBlock]]],
    *,
    geometry: Geometry | None = None,
    labels: Iterable[Label] = (),
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    attachments: Iterable[tuple[str, str, bytes]] = (),
    force: bool = False,
) -> None:
    """Write a whole recording: its labels, then its streams, merged in time.

    Labels get a chunk of their own: they are read without decompressing the samples. It is the
    first, so that a file that is cut short has them.

    Parameters
    ----------
    path
        File to write.
    sources
        Per stream: what it is, its sample format, its blocks in order of time.
    geometry, labels
        Site and truth, if known.
    metadata
        Metadata records by name; ``recording`` (start_ns, tool, version) is added.
    attachments
        Name, media type and content of each.
    force
        Replace an existing file.

    Raises
    ------
    CodecError
        As :class:`RecordingWriter`.
    """
    with RecordingWriter(path, force=force) as writer:
        if geometry is not None:
            writer.set_geometry(geometry)
        for stream, sample_format, _ in sources:
            writer.add_stream(stream, sample_format)
        blocks = merged_pieces(sources)
        first = list(islice(blocks, 1))
        start_ns = first[0].start_ns if first else 0
        if truth := sorted(labels, key=lambda label: label.time_ns):
            writer.begin(min(start_ns, truth[0].time_ns) if first else truth[0].time_ns)
            writer.add_labels(truth)
            writer.flush()
        for block in chain(first, blocks):
            start_ns = min(start_ns, block.start_ns)
            writer.write(block)
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, values)
        for attachment in attachments:
            writer.add_attachment(*attachment)
        writer.add_metadata("recording", _origin(start_ns))


def write_sidecar(path: Path, sidecar: Sidecar) -> None:
    """Write a sidecar so that at any moment the old or the new one is there, whole.

    Raises
    ------
    CodecError
        Where it cannot be written.
    """
    fresh = path.with_name(f"{path.name}.new")
    try:
        with RecordingWriter(fresh, force=True) as writer:
            writer.add_metadata(SIDECAR, sidecar.metadata())
            writer.add_annotations(sidecar.annotations)
    except NoRoomError as error:  # what was written of it is of no use: the journal has more
        fresh.with_name(f"{fresh.name}.partial").unlink(missing_ok=True)
        raise NoRoomError(path, error.reason) from error
    replace_durably(fresh, path)


def _origin(start_ns: int) -> dict[str, str]:
    return {"start_ns": str(start_ns), "tool": TOOL, "version": tool_version()}


#: Length of a message of samples [s], and the most values of all channels that one holds. chosen by
#: judgement: 4 MB of doubles are a few chunks; 16 channels at 20 kHz have 32 000 in 0.1 s.
MESSAGE_S = 0.1
_MESSAGE_VALUES = 1 << 19
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
        filled = end // self.size * self.size - first
        if filled <= 0:
            self._pending[-1] = _owned(block)
            return
        joined = as_one(self._pending)
        rest = joined.slice(filled, len(joined))
        self._pending = [_owned(rest)] if len(rest) else []
        yield joined.slice(0, filled)

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
    """Return how many samples one message of a stream holds, fewer of one with many channels."""
    most = _MESSAGE_VALUES // len(stream.channels)
    return max(1, min(round(MESSAGE_S * stream.rate_hz), most))


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
    """A stream as WaveformBlocks of 0.1 s, shorter ones where there are many channels."""

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


TRANSFORM_TOPIC = "/tf_static"
FRAME = "site"


def transforms(geometry: Geometry, time_ns: int) -> tuple[Output, Packet]:
    """Return the message that places every sensor in the frame ``site``."""
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message = FrameTransforms()
    for sensor in geometry.sensors:
        transform = message.transforms.add(parent_frame_id=FRAME, child_frame_id=sensor.name)
        set_time(transform.timestamp, time_ns)
        transform.translation.x = sensor.x
        transform.translation.y = sensor.y
        transform.translation.z = sensor.z
        transform.rotation.w = 1.0
    output = Output(
        TRANSFORM_TOPIC,
        "foxglove.FrameTransforms",
        "protobuf",
        descriptor_set(FrameTransforms),
        "protobuf",
        ((ROLE_KEY, "geometry"),),
    )
    return output, Packet(time_ns, time_ns, 0, message.SerializeToString())


Encoded = tuple[Output, Packet | None]


@cache
def _stage_output(spec: StageSpec, name: str) -> Output:
    topic = candidates_topic(spec) if name == "CandidateBlock" else trace_topic(spec)
    return protobuf_output(topic, name, ((SPEC_KEY, spec_json(spec)),))


def encode_event(event: Event) -> Sequence[Encoded]:
    """Return the messages of an event and the channels they go to.

    A stage's description is a channel without a message yet. Blocks without rows give nothing. A
    single event has its line in the log, where its kind has one.
    """
    if isinstance(event, StageSpec):
        kinds = ("CandidateBlock", "TraceBlock")
        return [(_stage_output(event, kind), None) for kind in kinds]
    if isinstance(event, CandidateBlock):
        message = _candidates(event) if len(event) else None
        return [(_stage_output(event.spec, "CandidateBlock"), message)] if message else []
    if isinstance(event, TraceBlock):
        message = _trace(event) if len(event) else None
        return [(_stage_output(event.spec, "TraceBlock"), message)] if message else []
    return _encoder_of(type(event))(event)


def _packet(message: Any, first_ns: int, last_ns: int) -> Packet:
    set_time(message.timestamp, first_ns)
    return Packet(last_ns, first_ns, 0, message.SerializeToString())


#: What columns of numbers are stored as.
_I8, _I4, _F4, _U1 = map(np.dtype, ("<i8", "<i4", "<f4", "u1"))


def _stored(values: NDArray[Any], kind: np.dtype[Any]) -> bytes:
    """Return numbers as they are stored; those of that kind are not converted."""
    return np.asarray(values, kind).tobytes()


def _candidates(block: CandidateBlock) -> Packet:
    message = message_class("CandidateBlock")(
        count=len(block),
        time_ns=_stored(block.time_ns, _I8),
        channel=_stored(block.channel, _I4),
        value=_stored(block.value, _F4),
        gate_value=_stored(block.gate_value, _F4),
        margin=_stored(block.margin, _F4),
        accepted=_stored(block.accepted, _U1),
    )
    return _packet(message, int(block.time_ns[0]), int(block.time_ns.max()))


def _trace(block: TraceBlock) -> Packet:
    message = message_class("TraceBlock")(
        count=len(block),
        time_ns=_stored(block.time_ns, _I8),
        value=_stored(block.value, _F4),
    )
    return _packet(message, int(block.time_ns[0]), int(block.time_ns.max()))


_ENCODERS: dict[type[Any], Callable[[Any], list[Encoded]]] = {}


def _encoder_of(cls: type[Any]) -> Callable[[Any], list[Encoded]]:
    """Return what encodes the events of a kind; made once."""
    if cls not in _ENCODERS:
        _ENCODERS[cls] = _made_encoder(cls)
    return _ENCODERS[cls]


def _made_encoder(cls: type[Any]) -> Callable[[Any], list[Encoded]]:
    """Return what encodes the events of a kind: the message's fields are the event's own."""
    layout = layout_of(cls)
    output, text_of = protobuf_output(EVENTS[cls].topic, cls.__name__), EVENTS[cls].text
    names = tuple(n for n in layout.names if n not in TIMES)
    message_of, values_of = layout.message, attrgetter(*names, "time_ns")
    span = "end_ns" in layout.names

    def encode(event: Any) -> list[Encoded]:
        values = values_of(event)
        message = message_of(**dict(zip(names, values, strict=False)))  # the time comes after them
        start_ns = last_ns = int(values[-1])
        if span:
            set_time(message.end, event.end_ns)
            last_ns = max(start_ns, int(event.end_ns))
        own_message = output, _packet(message, start_ns, last_ns)
        text = text_of(event)
        return [own_message, _log_line(event, text, last_ns)] if text else [own_message]

    return encode


LOG_TOPIC = "/groundtrace/log"
LEVELS = {"DEBUG": "DEBUG", "INFO": "INFO", "WARN": "WARNING", "ERROR": "ERROR"}


def _log_line(event: SingleEvent, text: str, time_ns: int) -> Encoded:
    """Return an event's line in the log; spans are told when they end."""
    level = LEVELS.get(getattr(event, "level", ""), "INFO")
    source = getattr(event, "stage", "") or getattr(event, "source", "")
    log, levels = _log_message()
    message = log(level=levels[level], message=text, name=source)
    set_time(message.timestamp, time_ns)
    return _log_output(), Packet(time_ns, time_ns, 0, message.SerializeToString())


@cache
def _log_message() -> tuple[Any, dict[str, int]]:
    """Return the class of a line in the log, and its levels by name."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    return Log, dict(Log.Level.items())


@cache
def _log_output() -> Output:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    content = descriptor_set(Log)
    role = ((ROLE_KEY, "mirror"),)
    return Output(LOG_TOPIC, "foxglove.Log", "protobuf", content, "protobuf", role)
