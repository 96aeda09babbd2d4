"""miniSEED: the samples of a recording as they are stored, by ObsPy."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import RecordingError
from .api import Written
from .obspy_quietly import obspy_part
from .runs import pieces_of
from .seed_codes import SeedCode, seed_codes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import BinaryIO

    from numpy.typing import NDArray

    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import Channel, SignalBlock, Stream

    from .api import Material

#: Length of what is written at once [s]; readers join what is continuous.
PIECE_S = 60.0
#: Encodings that keep every sample as it is.
_ENCODINGS = {"<i2": "INT16", "<i4": "INT32", "<f4": "FLOAT32", "<f8": "FLOAT64"}
#: Differences that STEIM2 holds: 30 bits with sign.
_STEIM_MAX = 1 << 29


class MiniSeedExporter:
    """Writes the stored samples bit by bit, integers packed; a gap begins a new trace.

    Times of first samples are rounded to the microsecond. Streams without a rate of their own are
    left out. Needs ObsPy.
    """

    name = "miniseed"
    description = "signals as miniSEED 2, samples as stored, times to the microsecond (needs ObsPy)"
    suffixes = (".mseed", ".miniseed", ".ms")
    kinds = ("signals",)
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the signals."""
        core = obspy_part("obspy.core", path.name)
        recording = material.signals()
        codes = seed_codes(recording.streams)
        regular = [s for s in recording.streams if not s.irregular]
        if not regular:
            raise RecordingError(f"{material.name}: expected a stream with a rate, found none")
        samples = 0
        with path.open("wb") as file:
            for stream in regular:
                samples += _write_stream(core, recording, stream, codes, file)
        return Written(dict.fromkeys(kinds, samples), tuple(_remarks(recording, codes)))


def _write_stream(
    core: Any,
    recording: Recording,
    stream: Stream,
    codes: dict[tuple[str, str], SeedCode],
    file: BinaryIO,
) -> int:
    """Write a stream; return how many samples each channel has."""
    samples = 0
    for block in pieces_of(recording, stream, PIECE_S):
        for column, channel in enumerate(stream.channels):
            code = codes[stream.topic, channel.name]
            data = np.ascontiguousarray(block.samples[:, column])
            file.write(_records(core, block, code, data))
        samples += len(block)
    return samples


def _records(core: Any, block: SignalBlock, code: SeedCode, data: NDArray[Any]) -> bytes:
    """Return samples of a channel as records."""
    header = {
        "network": code.network,
        "station": code.station,
        "location": code.location,
        "channel": code.channel,
        "sampling_rate": block.stream.rate_hz,
        "starttime": core.UTCDateTime(ns=block.start_ns),
    }
    encoding = encoding_of(data)
    if encoding == "STEIM2":
        data = data.astype(np.int32)
    content = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's, on its own entry points
        trace = core.Trace(data.astype(data.dtype.newbyteorder("=")), header)
        trace.write(content, format="MSEED", encoding=encoding)
    return content.getvalue()


def encoding_of(data: NDArray[Any]) -> str:
    """Return the smallest encoding that keeps every sample as it is."""
    if data.dtype.kind == "i" and data.dtype.itemsize <= 4:
        steps = np.diff(data.astype(np.int64), prepend=0)
        if len(steps) and np.abs(steps).max() < _STEIM_MAX:
            return "STEIM2"
    return _ENCODINGS[data.dtype.newbyteorder("<").str]


def _remarks(recording: Recording, codes: dict[tuple[str, str], SeedCode]) -> list[str]:
    """Say what the format does not hold: names, units and scales, and irregular streams."""
    lines = ["times of first samples are rounded to the microsecond"]
    for stream in recording.streams:
        if stream.irregular:
            lines.append(f"{stream.topic} is left out: its samples have times of their own")
            continue
        for channel in stream.channels:
            code = codes[stream.topic, channel.name]
            lines.append(f"{code} is {channel.name} of {stream.topic}: {_unit(channel)}")
    return lines


def _unit(channel: Channel) -> str:
    scale = "" if channel.scale == 1.0 else f"{channel.scale:.9g} "
    return f"{channel.quantity}, one is {scale}{channel.unit}"
