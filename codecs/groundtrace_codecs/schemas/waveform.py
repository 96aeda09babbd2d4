"""``groundtrace.WaveformBlock``: samples of one stream, channel by channel.

Integers are stored as planes of bytes, which compress best and fastest. A sample is
``sum(digit[k] * 256**k)``, modulo its range, with signed digits of one byte. The lowest digits of
all samples come first, then the next ones, as far as there are any. A quiet signal takes one byte a
sample, where two's complement has 0x00 and 0xff in turn between bytes of noise.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from google.protobuf.message import DecodeError

from ..errors import CodecError, SchemaError
from ..signals import NS_PER_S, SignalBlock, Stream
from .protobuf import get_time, message_class, parse, set_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Sample formats and their numpy types; 24-bit samples travel in ``i32le``.
FORMATS = {"i16le": "<i2", "i32le": "<i4", "f32le": "<f4", "f64le": "<f8"}
#: As what integers are written; they are read as both.
_IN_PLANES = {"i16le": "i16planes", "i32le": "i32planes"}
_NAMES = {np.dtype(kind): name for name, kind in FORMATS.items()}
_STORED = {**FORMATS, **{stored: FORMATS[plain] for plain, stored in _IN_PLANES.items()}}
_MAX_ANCHOR_NS = 1 << 62
#: Bytes of the widest sample.
_WIDEST = 8
#: Key of the field ``data``: number 8, length-delimited.
_DATA_KEY = 8 << 3 | 2


class Waveform(NamedTuple):
    """A decoded WaveformBlock: first sample's time, rate, index, samples (n, channels), times.

    And the format in which it was stored.
    """

    start_ns: int
    rate_hz: float
    first: int
    samples: NDArray[Any]
    times_ns: NDArray[np.int64] | None
    stored: str


def fits(size: int, name: str, count: int) -> bool:
    """Tell whether ``count`` samples, at least one, stored as ``name`` can take ``size`` bytes."""
    most = count * np.dtype(_STORED[name]).itemsize
    if name in FORMATS:
        return size == most
    return 0 < size <= most and size % count == 0


def _samples(message: Any, data: bytes | memoryview, where: str) -> NDArray[Any]:
    if message.format not in _STORED:
        formats = ", ".join(_STORED)
        raise SchemaError(f"{where}: format: expected one of {formats}, found {message.format!r}")
    dtype = np.dtype(_STORED[message.format])
    shape = (message.channels, message.samples)
    count = math.prod(shape)
    if not count:
        raise SchemaError(
            f"{where}: expected at least 1 channel and 1 sample, found {shape[0]} and {shape[1]}"
        )
    if not fits(len(data), message.format, count):
        least = dtype.itemsize if message.format in FORMATS else 1
        sizes = " or ".join(str(count * width) for width in range(least, dtype.itemsize + 1))
        raise SchemaError(
            f"{where}: data: expected {sizes} bytes for {shape[0]} channels of {shape[1]} samples, "
            f"found {len(data)}"
        )
    # The transposed view keeps each channel contiguous, as stored.
    if message.format in FORMATS:
        return np.frombuffer(data, dtype).reshape(shape).T
    values = np.empty(shape, dtype)
    put_samples(data, message.format, values)
    return values.T


def stored(samples: NDArray[Any]) -> tuple[str, bytes]:
    """Return as what samples of shape (n_samples, n_channels) are written, and their bytes."""
    planar = np.ascontiguousarray(samples.T)
    name = _NAMES[samples.dtype]
    if name in _IN_PLANES:
        return _IN_PLANES[name], to_planes(planar)
    return name, planar.tobytes()


def put_samples(data: bytes | memoryview, name: str, out: NDArray[Any]) -> None:
    """Put samples stored as ``name`` into ``out``; their bytes must fit it."""
    if name in FORMATS:
        out[...] = np.frombuffer(data, out.dtype).reshape(out.shape)
    else:
        from_planes(data, out)


def _times(message: Any, where: str) -> NDArray[np.int64] | None:
    data = message.sample_times_ns
    if not data:
        return None
    if len(data) != 8 * message.samples:
        raise SchemaError(
            f"{where}: sample_times_ns: expected {8 * message.samples} bytes, found {len(data)}"
        )
    return np.frombuffer(data, "<i8")


@cache
def _opening(length: int) -> bytes:
    """Return what stands before the samples in a message: the field's key and their length."""
    prefix = bytearray([_DATA_KEY])
    while length >= 0x80:
        prefix.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes([*prefix, length])


def split_payload(
    data: bytes | memoryview, count: int
) -> tuple[bytes | memoryview, bytes | memoryview | None]:
    """Split a message before its last field where that holds ``count`` samples.

    A message is a sequence of fields, so what comes before is one as well; None where it is not
    known to end so.
    """
    width = min(_WIDEST, len(data) // count) if count else 0
    while width:
        opening = _opening(width * count)
        start = len(data) - width * count
        fields = start - len(opening)
        if fields >= 0 and data[fields:start] == opening:
            return data[:fields], data[start:]
        width -= 1
    return data, None


def _parsed(data: bytes | memoryview, where: str, count: int) -> tuple[Any, bytes | memoryview]:
    """Parse a message, and give its samples' bytes, where they lie if that can be."""
    block = message_class("WaveformBlock")
    fields, samples = split_payload(data, count)
    if samples is not None:
        with suppress(DecodeError):
            return block.FromString(fields), samples
    message = parse(block, data, where)
    return message, message.data


def decode_waveform(
    data: bytes | memoryview, where: str = "WaveformBlock", count: int = 0
) -> Waveform:
    """Decode a WaveformBlock.

    Parameters
    ----------
    data
        The message.
    where
        Named in errors.
    count
        How many samples it has, if it has as many as others: they are then not copied.

    Raises
    ------
    SchemaError
        Where the bytes are not a WaveformBlock with at least one sample of one channel; names
        ``where``.
    """
    message, packed = _parsed(data, where, count)
    times = _times(message, where)
    rate = message.sample_rate
    if times is None and not 0.0 < rate < math.inf:
        raise SchemaError(f"{where}: sample_rate: expected a positive number, found {rate}")
    if message.first_sample >= 1 << 63:
        raise SchemaError(
            f"{where}: first_sample: expected less than 2^63, found {message.first_sample}"
        )
    samples = _samples(message, packed, where)
    start_ns = get_time(message.timestamp, where)
    return Waveform(start_ns, rate, message.first_sample, samples, times, message.format)


def to_block(stream: Stream, wave: Waveform, where: str) -> SignalBlock:
    """Return a decoded waveform as a block of its stream.

    Raises
    ------
    SchemaError
        Where channels, rate or kind of sampling are not the stream's.
    """
    columns = len(stream.channels)
    if wave.samples.shape[1] != columns:
        raise SchemaError(f"{where}: expected {columns} channels, found {wave.samples.shape[1]}")
    if stream.irregular != (wave.times_ns is not None):
        expected, actual = ("own", "no") if stream.irregular else ("no", "own")
        raise SchemaError(f"{where}: expected {expected} sample times, found {actual}")
    if stream.irregular:
        return SignalBlock(stream, wave.start_ns, wave.first, wave.samples, wave.times_ns)
    if wave.rate_hz != stream.rate_hz:
        raise SchemaError(f"{where}: expected {stream.rate_hz} Hz, found {wave.rate_hz} Hz")
    anchor_ns = wave.start_ns - round(wave.first * stream.period_ns)
    if abs(anchor_ns) > _MAX_ANCHOR_NS:
        raise SchemaError(
            f"{where}: first_sample: expected a run that starts within 2^62 ns, found {wave.first}"
        )
    return SignalBlock(stream, anchor_ns, wave.first, wave.samples)


def encode_waveform(block: SignalBlock) -> bytes:
    """Encode a block whose samples have the type of a format; it says which."""
    name, data = stored(block.samples)
    message = message_class("WaveformBlock")(
        frame_id=block.stream.placement,
        sample_rate=0.0 if block.stream.irregular else block.stream.rate_hz,
        channels=len(block.stream.channels),
        samples=len(block),
        first_sample=block.first,
        format=name,
        data=data,
    )
    if block.times_ns is not None:
        message.sample_times_ns = block.times_ns.astype("<i8").tobytes()
    set_time(message.timestamp, block.start_ns)
    encoded: bytes = message.SerializeToString()
    return encoded


def to_format(samples: NDArray[Any], sample_format: str, where: str) -> NDArray[Any]:
    """Return samples in a stored format, refusing to change them.

    Integers must come out as they went in and nothing may overflow; rounding float64 to float32
    is the one loss allowed, as it is what asking for ``f32le`` means.

    Parameters
    ----------
    samples
        Shape (n_samples, n_channels), any integer or floating type.
    sample_format
        One of :data:`FORMATS`.
    where
        Named in the error.

    Raises
    ------
    CodecError
        Where a sample does not fit the format.
    """
    target = np.dtype(FORMATS[sample_format])
    if samples.dtype == target:
        return samples
    with np.errstate(invalid="ignore", over="ignore"):
        stored = samples.astype(target)
        if samples.dtype.kind == "f" and target.kind == "f":
            fitting = np.isfinite(stored) | ~np.isfinite(samples)
        else:
            fitting = stored.astype(samples.dtype) == samples
    if not fitting.all():
        value = samples[~fitting].flat[0]
        raise CodecError(f"{where}: expected samples that fit {sample_format}, found {value}")
    return stored


class WaveformRun:
    """Messages of a stream that continue each other, to become one block.

    Parameters
    ----------
    stream
        Theirs.
    data
        The first message.
    where
        Named in errors.
    count
        As :func:`decode_waveform` takes it.

    Attributes
    ----------
    count
        How many samples the first message has, all channels together.

    Raises
    ------
    SchemaError
        As :func:`decode_waveform` and :func:`to_block`.
    """

    def __init__(
        self, stream: Stream, data: bytes | memoryview, where: str, count: int = 0
    ) -> None:
        wave = decode_waveform(data, where, count)
        self._first = to_block(stream, wave, where)
        self._others: list[bytes | memoryview] = []
        self._next = self._first.first + len(self._first)
        self._stored = wave.stored
        self._same = (*wave.samples.T.shape, stream.rate_hz, b"")
        self.count = wave.samples.size

    def take(self, data: bytes | memoryview) -> bool:
        """Take a message that continues the run as plainly as most do; else return False."""
        fields, packed = split_payload(data, self.count)
        if packed is None or self._first.times_ns is not None:
            return False
        try:
            message = message_class("WaveformBlock").FromString(fields)
        except DecodeError:
            return False
        first = self._first
        same = (message.channels, message.samples, message.sample_rate, message.sample_times_ns)
        if message.format != self._stored or same != self._same:
            return False
        if not fits(len(packed), self._stored, self.count):
            return False
        if message.first_sample != self._next:
            return False
        stamp = message.timestamp
        lag_ns = stamp.seconds * NS_PER_S + stamp.nanos - first.anchor_ns
        if lag_ns != round(self._next * first.stream.period_ns):
            return False
        self._others.append(packed)
        self._next += len(first)
        return True

    def block(self) -> SignalBlock:
        """Return the messages' samples."""
        if not self._others:
            return self._first
        part = self._first.samples.T
        channels, n = part.shape
        samples = np.empty((channels, n * (1 + len(self._others))), part.dtype)
        samples[:, :n] = part
        for number, data in enumerate(self._others, start=1):
            put_samples(data, self._stored, samples[:, number * n : (number + 1) * n])
        return replace(self._first, samples=samples.T)


def to_planes(values: NDArray[np.signedinteger[Any]]) -> bytes:
    """Return integers as planes, at least one, their first axis first."""
    left, planes = values, []
    for _ in range(values.dtype.itemsize):
        digits = left.astype(np.int8)
        planes.append(digits.tobytes())
        left = (left - digits) >> 8
        if not left.any():
            break
    return b"".join(planes)


def from_planes(data: bytes | bytearray | memoryview, out: NDArray[np.signedinteger[Any]]) -> None:
    """Put integers into ``out``, of at most as many planes as one of them has bytes."""
    planes = np.frombuffer(data, np.int8).reshape(-1, *out.shape)
    out[...] = planes[0]
    for k in range(1, len(planes)):
        out += planes[k].astype(out.dtype) * out.dtype.type(1 << 8 * k)
