"""``groundtrace.WaveformBlock``: samples of one stream as planar little-endian bytes."""

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
_MAX_ANCHOR_NS = 1 << 62
#: Key of the field ``data``: number 8, length-delimited.
_DATA_KEY = 8 << 3 | 2


class Waveform(NamedTuple):
    """A decoded WaveformBlock: first sample's time, rate, index, samples (n, channels), times."""

    start_ns: int
    rate_hz: float
    first: int
    samples: NDArray[Any]
    times_ns: NDArray[np.int64] | None


def _samples(message: Any, data: bytes | memoryview, place: str) -> NDArray[Any]:
    if message.format not in FORMATS:
        known = ", ".join(FORMATS)
        raise SchemaError(f"{place}: format: expected one of {known}, found {message.format!r}")
    dtype = np.dtype(FORMATS[message.format])
    shape = (message.channels, message.samples)
    size = math.prod(shape) * dtype.itemsize
    if size == 0 or size != len(data):
        raise SchemaError(
            f"{place}: data: expected {size} bytes for {shape[0]} channels of {shape[1]} samples, "
            f"found {len(data)}"
        )
    # The transposed view keeps each channel contiguous, as stored: no copy.
    return np.frombuffer(data, dtype).reshape(shape).T


def _times(message: Any, place: str) -> NDArray[np.int64] | None:
    data = message.sample_times_ns
    if not data:
        return None
    if len(data) != 8 * message.samples:
        raise SchemaError(
            f"{place}: sample_times_ns: expected {8 * message.samples} bytes, found {len(data)}"
        )
    return np.frombuffer(data, "<i8")


@cache
def _opening(length: int) -> bytes:
    """Return what stands before the samples in a message: the field's key and their length."""
    found = bytearray([_DATA_KEY])
    while length >= 0x80:
        found.append(length & 0x7F | 0x80)
        length >>= 7
    return bytes([*found, length])


def _apart(
    data: bytes | memoryview, length: int
) -> tuple[bytes | memoryview, bytes | memoryview | None]:
    """Split a message before its last field where that is ``length`` bytes of samples.

    A message is a sequence of fields, so what comes before is one as well; None where it is not
    known to end so.
    """
    opening = _opening(length)
    start = len(data) - length
    fields = start - len(opening)
    if length <= 0 or fields < 0 or data[fields:start] != opening:
        return data, None
    return data[:fields], data[start:]


def _parsed(data: bytes | memoryview, place: str, length: int) -> tuple[Any, bytes | memoryview]:
    """Parse a message, and give its samples' bytes, where they lie if that can be."""
    block = message_class("WaveformBlock")
    fields, samples = _apart(data, length)
    if samples is not None:
        with suppress(DecodeError):
            return block.FromString(fields), samples
    message = parse(block, data, place)
    return message, message.data


def decode_waveform(
    data: bytes | memoryview, place: str = "WaveformBlock", length: int = 0
) -> Waveform:
    """Decode a WaveformBlock.

    Parameters
    ----------
    data
        The message.
    place
        Named in errors.
    length
        How many bytes of samples it has, if it has as many as others: they are then not copied.

    Raises
    ------
    SchemaError
        Where the bytes are not a WaveformBlock with at least one sample of one channel; names
        ``place``.
    """
    message, stored = _parsed(data, place, length)
    times = _times(message, place)
    rate = message.sample_rate
    if times is None and not 0.0 < rate < math.inf:
        raise SchemaError(f"{place}: sample_rate: expected a positive number, found {rate}")
    if message.first_sample >= 1 << 63:
        raise SchemaError(
            f"{place}: first_sample: expected less than 2^63, found {message.first_sample}"
        )
    samples = _samples(message, stored, place)
    return Waveform(get_time(message.timestamp, place), rate, message.first_sample, samples, times)


def to_block(stream: Stream, wave: Waveform, place: str) -> SignalBlock:
    """Return a decoded waveform as a block of its stream.

    Raises
    ------
    SchemaError
        Where channels, rate or kind of sampling are not the stream's.
    """
    columns = len(stream.channels)
    if wave.samples.shape[1] != columns:
        raise SchemaError(f"{place}: expected {columns} channels, found {wave.samples.shape[1]}")
    if stream.irregular != (wave.times_ns is not None):
        expected, found = ("own", "no") if stream.irregular else ("no", "own")
        raise SchemaError(f"{place}: expected {expected} sample times, found {found}")
    if stream.irregular:
        return SignalBlock(stream, wave.start_ns, wave.first, wave.samples, wave.times_ns)
    if wave.rate_hz != stream.rate_hz:
        raise SchemaError(f"{place}: expected {stream.rate_hz} Hz, found {wave.rate_hz} Hz")
    anchor_ns = wave.start_ns - round(wave.first * stream.period_ns)
    if abs(anchor_ns) > _MAX_ANCHOR_NS:
        raise SchemaError(
            f"{place}: first_sample: expected a run that starts within 2^62 ns, found {wave.first}"
        )
    return SignalBlock(stream, anchor_ns, wave.first, wave.samples)


class WaveformRun:
    """Messages of a stream that continue each other, to become one block.

    Parameters
    ----------
    stream
        Theirs.
    data
        The first message.
    place
        Named in errors.
    length
        As :func:`decode_waveform` takes it.

    Attributes
    ----------
    length
        How many bytes of samples the first message has.

    Raises
    ------
    SchemaError
        As :func:`decode_waveform` and :func:`to_block`.
    """

    def __init__(
        self, stream: Stream, data: bytes | memoryview, place: str, length: int = 0
    ) -> None:
        self._first = to_block(stream, decode_waveform(data, place, length), place)
        part = self._first.samples.T
        self._parts = [part]
        self._next = self._first.first + len(self._first)
        self._same = (part.dtype.str, *part.shape, stream.rate_hz, b"")
        self.length = part.nbytes

    def take(self, data: bytes | memoryview) -> bool:
        """Take a message that continues the run as plainly as most do; else return False."""
        fields, stored = _apart(data, self.length)
        if stored is None or self._first.times_ns is not None:
            return False
        try:
            message = message_class("WaveformBlock").FromString(fields)
        except DecodeError:
            return False
        first, part = self._first, self._parts[0]
        same = (
            FORMATS.get(message.format),
            message.channels,
            message.samples,
            message.sample_rate,
            message.sample_times_ns,
        )
        if same != self._same or message.first_sample != self._next:
            return False
        stamp = message.timestamp
        lag_ns = stamp.seconds * NS_PER_S + stamp.nanos - first.anchor_ns
        if lag_ns != round(self._next * first.stream.period_ns):
            return False
        self._parts.append(np.frombuffer(stored, part.dtype).reshape(part.shape))
        self._next += part.shape[1]
        return True

    def block(self) -> SignalBlock:
        """Return the messages' samples."""
        if len(self._parts) == 1:
            return self._first
        return replace(self._first, samples=np.concatenate(self._parts, axis=1).T)


def encode_waveform(block: SignalBlock, sample_format: str) -> bytes:
    """Encode a block whose samples already have the type of ``sample_format``."""
    message = message_class("WaveformBlock")(
        frame_id=block.stream.placement,
        sample_rate=0.0 if block.stream.irregular else block.stream.rate_hz,
        channels=len(block.stream.channels),
        samples=len(block),
        first_sample=block.first,
        format=sample_format,
        data=np.ascontiguousarray(block.samples.T).tobytes(),
    )
    if block.times_ns is not None:
        message.sample_times_ns = block.times_ns.astype("<i8").tobytes()
    set_time(message.timestamp, block.start_ns)
    encoded: bytes = message.SerializeToString()
    return encoded


def to_format(samples: NDArray[Any], sample_format: str, place: str) -> NDArray[Any]:
    """Return samples in a stored format, refusing to change them.

    Integers must come out as they went in and nothing may overflow; rounding float64 to float32
    is the one loss allowed, as it is what asking for ``f32le`` means.

    Parameters
    ----------
    samples
        Shape (n_samples, n_channels), any integer or floating type.
    sample_format
        One of :data:`FORMATS`.
    place
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
            kept = np.isfinite(stored) | ~np.isfinite(samples)
        else:
            kept = stored.astype(samples.dtype) == samples
    if not kept.all():
        value = samples[~kept].flat[0]
        raise CodecError(f"{place}: expected samples that fit {sample_format}, found {value}")
    return stored
