"""Importer for sound files of recorders: WAV, RF64, W64 and FLAC, read by soundfile.

A sample stays the integer the converter gave, 24 bits too; what one count is worth only a map can
say, so that without one the channels are seismic counts. Files are read block by block while the
recording is written.
"""

from __future__ import annotations

import re
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import FormatError, MissingReaderError, SchemaError
from ..signals import NS_PER_S, Channel, SignalBlock, Stream, to_quantity
from .base import Imported
from .map import GAP_S, Part, lay_out
from .time import parse_start

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import ImportMap, Source, StreamMap

_SUFFIXES = frozenset({".wav", ".flac", ".w64", ".rf64"})
#: Encoding to the type soundfile reads, the bits it puts below the sample, and our format.
_ENCODINGS = {
    "PCM_S8": ("int16", 8, "i16le"),
    "PCM_U8": ("int16", 8, "i16le"),
    "PCM_16": ("int16", 0, "i16le"),
    "PCM_24": ("int32", 8, "i32le"),
    "PCM_32": ("int32", 0, "i32le"),
    "FLOAT": ("float32", 0, "f32le"),
    "DOUBLE": ("float64", 0, "f64le"),
}
#: A recorder that goes on after midnight goes on counting, for days [s].
_LONGEST_S = 1e7
#: Frames read at once.
_FRAMES = 1 << 16


class AudioImporter:
    """Reads the files of one recorder."""

    name = "audio"
    description = "sound files by soundfile: WAV, RF64, W64, FLAC; a map gives the unit"

    def sniff(self, path: Path) -> float:
        """Return 1 for the first bytes of a sound file, 0.4 for its suffix."""
        with path.open("rb") as file:
            head = file.read(12)
        wave = head[:4] in (b"RIFF", b"RF64") and head[8:] == b"WAVE"
        if wave or head[:4] == b"fLaC" or head == b"riff\x2e\x91\xcf\x11\xa5\xd6\x28\xdb":
            return 1.0
        return 0.4 if path.suffix.lower() in _SUFFIXES else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recorder; several lie where :mod:`.map` puts them.

        Parameters
        ----------
        paths
            In the order of time.
        map_
            Streams of channels by 0-based number, and ``start``; without it all are counts.

        Raises
        ------
        MissingReaderError
            Without soundfile.
        FormatError
            Where a file is no sound file or lossy, or ends before its header says.
        SchemaError
            Where files or map do not fit each other.
        """
        sounds = [_look(path) for path in paths]
        _check_alike(sounds)
        first = sounds[0]
        starts = [_start_ns(sound, map_) for sound in sounds]
        apart = map_ is not None and map_.files == "events"
        parts = [
            Part(s.path.name, t, t + round(s.frames * NS_PER_S / s.rate_hz))
            for s, t in zip(sounds, starts, strict=True)
        ]
        laid = lay_out(parts, "files", GAP_S if apart else 0.0)
        sounds = [sounds[i] for i in laid.order]
        first, start_ns = sounds[0], laid.starts_ns[0]
        streams = _streams(first, map_)
        warnings = [w for s in sounds for w in s.warnings]
        if len(sounds) > 1 and not (laid.own_times or apart):
            warnings.append(
                f"{len(sounds)} files: each taken to go on where the one before ends "
                f'(files = "events" in a map lays them {GAP_S:g} s apart)'
            )
        if map_ is None:
            warnings.append(
                f"{first.path.name}: samples are counts: a map gives the unit of the channels"
            )
        form = _ENCODINGS[first.encoding][2]
        if start_ns and (map_ is None or map_.start is None):
            warnings.append(f"{first.path.name}: the recorder's clock is taken as UTC")
        return Imported(
            sources=tuple(
                _source(sounds, s, columns, form, laid.starts_ns) for s, columns in streams
            ),
            start_ns=start_ns,
            warnings=tuple(warnings),
            remarks=(laid.note,) if len(sounds) > 1 and (laid.own_times or apart) else (),
            files=tuple((s.path.name, t) for s, t in zip(sounds, laid.starts_ns, strict=True)),
        )


@dataclass(frozen=True, slots=True)
class _Sound:
    """What the header of a file says."""

    path: Path
    rate_hz: int
    channels: int
    frames: int
    encoding: str
    warnings: tuple[str, ...]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from soundfile import SoundFile
    except (ImportError, OSError) as error:  # OSError: the package without its library
        raise MissingReaderError(path.name, "soundfile", "audio") from error
    try:
        with SoundFile(path) as sound:
            yield sound
    except RuntimeError as error:  # soundfile's errors
        text = " ".join(str(error).replace(str(path), path.name).split())
        raise FormatError(f"{path.name}: expected a whole sound file, found: {text}") from error


def _look(path: Path) -> _Sound:
    """Return what a file is; a WAV file cut short gives what it has."""
    with _opened(path) as sound:
        if sound.subtype not in _ENCODINGS:
            raise FormatError(
                f"{path.name}: expected one of {', '.join(_ENCODINGS)}, found {sound.subtype}"
            )
        frames = int(sound.frames)
        if not frames:
            raise FormatError(f"{path.name}: expected samples, found none")
        # a compressed file that was cut does not hold its last sample
        sound.seek(frames - 1)
        if len(sound.read(1, dtype="int32")) != 1:
            raise FormatError(f"{path.name}: expected {frames} frames, found fewer")
        lost = bytes_missing(path)
        cut = f"{path.name}: cut short: {lost} bytes of samples are missing, the rest is read"
        return _Sound(
            path,
            int(sound.samplerate),
            int(sound.channels),
            frames,
            str(sound.subtype),
            (cut,) if lost else (),
        )


def _check_alike(sounds: Sequence[_Sound]) -> None:
    first = sounds[0]
    for sound in sounds[1:]:
        for what in ("rate_hz", "channels", "encoding"):
            have, want = getattr(sound, what), getattr(first, what)
            if have != want:
                raise SchemaError(
                    f"{sound.path.name}: {what}: expected {want} as in {first.path.name}, "
                    f"found {have}"
                )


def _start_ns(first: _Sound, map_: ImportMap | None) -> int:
    """Return the time of the first sample: the map's, the recorder's, or zero."""
    start = None if map_ is None else map_.start
    if map_ is not None and start is not None:
        if isinstance(start, str):
            return parse_start(start, f"{map_.file}: start", map_.zone, map_.scale)
        if isinstance(start, float | int) and 0 <= start < 9e9:
            return round(start * NS_PER_S)
        raise SchemaError(f"{map_.file}: start: expected ISO 8601 or unix seconds, found {start}")
    origin = origination(first.path)
    if origin is None:
        return 0
    where = f"{first.path.name}: bext"
    later_s = origin.samples / first.rate_hz
    if later_s > _LONGEST_S:
        raise FormatError(
            f"{where}: expected samples since midnight, found {later_s:.3g} s of them"
        )
    return parse_start(origin.date, where) + round(origin.samples * NS_PER_S / first.rate_hz)


def _streams(first: _Sound, map_: ImportMap | None) -> list[tuple[Stream, list[int]]]:
    """Return the streams and the channels of the file each takes."""
    if map_ is None:
        channels = tuple(Channel(f"ch{i + 1}", "seismic", "count") for i in range(first.channels))
        return [(Stream("/seismic", channels, first.rate_hz), list(range(first.channels)))]
    return [_mapped(first, map_, stream) for stream in map_.stream]


def _mapped(first: _Sound, map_: ImportMap, stream: StreamMap) -> tuple[Stream, list[int]]:
    channels, columns = [], []
    for i, column in enumerate(stream.columns):
        number = column.column
        if not isinstance(number, int) or not 0 <= number < first.channels:
            raise SchemaError(
                f"{map_.file}: {stream.topic}: expected channels 0 to {first.channels - 1} of "
                f"{first.path.name}, found {number!r}"
            )
        unit, factor = to_quantity(column.quantity, column.unit)
        name = column.name or f"ch{i + 1}"
        channels.append(
            Channel(name, column.quantity, unit, column.channel_axis, column.scale * factor)
        )
        columns.append(number)
    made = Stream(stream.topic, tuple(channels), first.rate_hz, stream.placement)
    return made, columns


def _source(
    sounds: Sequence[_Sound],
    stream: Stream,
    columns: list[int],
    form: str,
    starts_ns: Sequence[int],
) -> Source:
    def blocks() -> Iterator[SignalBlock]:
        for sound, begin_ns in zip(sounds, starts_ns, strict=True):
            first = round((begin_ns - starts_ns[0]) * stream.rate_hz / NS_PER_S)
            anchor_ns = begin_ns - round(first * stream.period_ns)
            for samples in _samples(sound):
                yield SignalBlock(stream, anchor_ns, first, samples[:, columns])
                first += len(samples)

    return stream, form, blocks()


def _samples(sound: _Sound) -> Iterator[NDArray[Any]]:
    """Yield the samples of a file as recorded, shape (n, n_channels)."""
    dtype, below, _ = _ENCODINGS[sound.encoding]
    read = 0
    with _opened(sound.path) as file:
        while read < sound.frames:
            samples = np.asarray(file.read(_FRAMES, dtype=dtype, always_2d=True))
            if not len(samples):
                raise FormatError(
                    f"{sound.path.name}: frame {read}: expected {sound.frames} frames, found fewer"
                )
            read += len(samples)
            yield samples >> below if below else samples


#: Size of a chunk that is given elsewhere (RF64) or was never filled in.
_OPEN = (0, 0xFFFF_FFFF)
_HEAD = 8
_MAX_CHUNKS = 1000


class Chunk(NamedTuple):
    """One chunk: its name, where its content starts, and its size [bytes]."""

    name: bytes
    start: int
    size: int


@dataclass(frozen=True, slots=True)
class Origination:
    """When a Broadcast WAV file starts (EBU Tech 3285, chunk ``bext``).

    Attributes
    ----------
    date
        ISO 8601 text of the day.
    samples
        From midnight to the first sample.
    """

    date: str
    samples: int


def chunks(path: Path) -> Iterator[Chunk]:
    """Yield the chunks of a RIFF or RF64 file; nothing where it is neither."""
    with path.open("rb") as file:
        if file.read(4) not in (b"RIFF", b"RF64"):
            return
        offset = 12
        for _ in range(_MAX_CHUNKS):
            file.seek(offset)
            head = file.read(_HEAD)
            if len(head) < _HEAD:
                return
            size = int.from_bytes(head[4:], "little")
            yield Chunk(head[:4], offset + _HEAD, size)
            offset += _HEAD + size + size % 2


def bytes_missing(path: Path) -> int:
    """Return how many bytes of samples a WAV file promises and does not have."""
    end = path.stat().st_size
    for chunk in chunks(path):
        if chunk.name == b"data" and chunk.size not in _OPEN:
            return max(0, chunk.start + chunk.size - end)
    return 0


def origination(path: Path) -> Origination | None:
    """Return when a Broadcast WAV file says it starts, None without a date.

    The time of day is that of the sample count since midnight (``TimeReference``), which is exact;
    recorders that leave it at zero give whole seconds (``OriginationTime``) instead.
    """
    bext = next((c for c in chunks(path) if c.name == b"bext"), None)
    if bext is None:
        return None
    with path.open("rb") as file:
        file.seek(bext.start + 320)
        date, time, reference = file.read(10), file.read(8), file.read(8)
    day = re.fullmatch(rb"(\d{4}).(\d\d).(\d\d)", date)
    clock = re.fullmatch(rb"(\d\d).(\d\d).(\d\d)", time)
    if day is None or int(day[1]) < 1970:
        return None
    text = "-".join(part.decode() for part in day.groups())
    samples = int.from_bytes(reference, "little")
    if not samples and clock is not None:
        text += "T" + ":".join(part.decode() for part in clock.groups())
    return Origination(text, samples)
