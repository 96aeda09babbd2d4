"""Importer for seismic files, read by ObsPy: SEG-2 shots, miniSEED, SAC, SEG-Y and others.

Hammer shots of one line become one recording. Shots lie in the order they were fired (acquisition
time, then file name). Each is a contiguous run at its own time, or laid end to end where the
headers give no distinct times, see :mod:`.map`. Receivers are named ``G01``, ``G02``, ... by
position along the whole line. Where the spread is moved between shots each spread is a stream of
its own, and the name of a receiver position stays.

StationXML among the files, or beside them, gives the sensitivity of each channel and the position
of its sensor. A channel has epochs, each with its own sensitivity and position; the one that holds
at a sample's time counts. The sensitivity is that at one frequency: the response of the instrument
stays in the samples. Azimuth and dip give the positive direction (FDSN StationXML 1.2, Channel).
"""

from __future__ import annotations

import datetime
import io
import math
import re
import struct
import sys
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ..errors import CodecError, FormatError, MissingReaderError, SchemaError
from ..events import TRIGGER, Label
from ..geometry import Geometry, Sensor, TangentPlane
from ..signals import NS_PER_S, Channel, SignalBlock, Stream, to_si
from .base import Imported
from .map import MAX_NS, Part, lay_out, sample_format
from .stored import Computed, Pieces, Spool, part_of, pieces

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .base import ImportMap, Source
    from .stored import Column

    Position = tuple[float, float, float]

_SUFFIXES = frozenset(
    {".sg2", ".seg2", ".mseed", ".miniseed", ".ms", ".sac", ".sgy", ".segy", ".su", ".gse2"}
)
_SEG2 = (b"\x55\x3a", b"\x3a\x55")
#: The same with the number of the one revision.
_SEG2_STARTS = (b"\x55\x3a\x01\x00", b"\x3a\x55\x00\x01")
#: Metres per unit of coordinates, as the header names it.
_LENGTHS_M = {"METERS": 1.0, "FEET": 0.3048, "CENTIMETERS": 0.01, "INCHES": 0.0254}
#: First bytes of GSE 2.x and 1.0 waveforms, of TSPAIR and SLIST, of Seismic Handler, of K-NET.
_TEXTS = (b"WID2 ", b"WID1 ", b"XW01", b"TIMESERIES ", b"DELTA: ", b"Origin Time")
#: SEED: a record's number, its type (data, or a control header with its first blockette).
_SEED = re.compile(rb"\d{6}(?:[DRQM]|V[ *]0(?:05|08|10)|[AST][ *]0\d\d)")
_SEGY_TRACES = 3600
_TRACE_HEADER = 240
#: Bytes of a sample by the format code of SEG-Y (SEG-Y rev 2, bytes 3225-3226).
_SEGY_BYTES = {1: 4, 2: 4, 3: 2, 4: 4, 5: 4, 6: 8, 8: 1, 9: 8, 10: 4, 11: 2, 12: 8, 16: 1}
#: Trace identification codes of SU go no further.
_LAST_TRACE_CODE = 200
#: What formats keep of the start time.
_KEPT = {
    **dict.fromkeys(("SEGY", "SU"), "whole seconds"),
    **dict.fromkeys(("GSE2", "GSE1", "SH_ASC"), "milliseconds"),
}
_AXES = {"Z": "z", "N": "y", "E": "x"}


class SeismicImporter:
    """Reads what ObsPy reads; SEG-2 files become the shots of one line."""

    name = "obspy"
    description = "seismic files by ObsPy: SEG-2 shots, miniSEED, SAC, SEG-Y"

    def sniff(self, path: Path) -> float:
        """Return how surely ObsPy reads a file, by what it holds.

        1 for SEG-2, 0.9 for SEED, GSE, other text and StationXML, 0.8 for the headers of SAC and
        SEG-Y, 0.6 for that of SU, or for a seismic suffix alone.
        """
        with path.open("rb") as file:
            head = file.read(_SEGY_TRACES + _TRACE_HEADER)
        size = path.stat().st_size
        if head[:2] in _SEG2 and len(head) >= 32:
            return 1.0
        if head.startswith(_TEXTS) or _SEED.match(head) or is_station_xml(path):
            return 0.9
        if _is_sac(head) or _is_segy(head, size):
            return 0.8
        return 0.6 if _is_su(head, size) or path.suffix.lower() in _SUFFIXES else 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recording.

        Raises
        ------
        MissingReaderError
            Without ObsPy.
        FormatError
            Where ObsPy cannot read a file.
        SchemaError
            Where the files do not make one recording, or a map is given.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for seismic files, found one")
        described = [p for p in paths if is_station_xml(p)]
        waves = [p for p in paths if p not in described]
        if not waves:
            raise FormatError(
                f"{paths[0].name}: expected files with samples, found StationXML only"
            )
        read, lost, spool = [], [], Spool(np.uint8)
        for path in waves:
            traces, lines = _read(path, spool)
            read.append((path, traces))
            lost += lines
        formats = {trace.form for _, traces in read for trace in traces}
        if "SEG2" in formats:
            if formats != {"SEG2"} or described:
                others = [*sorted(formats), *(["STATIONXML"] if described else [])]
                raise SchemaError(
                    f"{waves[0].name}: expected shots of one format, found {', '.join(others)}"
                )
            shots = assemble_shots([_shot(path, traces) for path, traces in read])
            return replace(shots, warnings=(*lost, *shots.warnings))
        traces = [trace for _, segments in read for trace in segments]
        stations, doubts = _stations(waves, described, traces)
        imported = _continuous(traces, formats, waves[0].name, stations)
        return replace(imported, warnings=(*lost, *imported.warnings, *doubts))


def _is_sac(head: bytes) -> bool:
    """Tell a SAC header: version 6 or 7, some points, evenly spaced or not (SAC manual)."""
    if len(head) < 632:
        return False
    return any(
        words[76] in (6, 7) and words[79] > 0 and words[105] in (0, 1)
        for words in (struct.unpack_from(f"{order}110i", head) for order in "<>")
    )


def _is_segy(head: bytes, size: int) -> bool:
    """Tell the headers of SEG-Y: a known format, and traces of that many samples to the end."""
    if len(head) < _SEGY_TRACES + _TRACE_HEADER:
        return False
    for order in "<>":
        interval_us, _, samples, _, code = struct.unpack_from(f"{order}5H", head, 3216)
        (trace_samples,) = struct.unpack_from(f"{order}H", head, _SEGY_TRACES + 114)
        if code not in _SEGY_BYTES or not interval_us or not (trace_samples or samples):
            continue
        trace = _TRACE_HEADER + (trace_samples or samples) * _SEGY_BYTES[code]
        if (size - _SEGY_TRACES) % trace == 0 or (
            trace_samples == samples and size - _SEGY_TRACES >= trace
        ):
            return True
    return False


def _is_su(head: bytes, size: int) -> bool:
    """Tell a trace header of Seismic Unix: traces of that many samples fill the file."""
    if len(head) < _TRACE_HEADER:
        return False
    for order in "<>":
        code, samples, interval_us = struct.unpack_from(f"{order}h84xHH", head, 28)
        fills_file = samples and size % (_TRACE_HEADER + 4 * samples) == 0
        if fills_file and interval_us and 0 <= code <= _LAST_TRACE_CODE:
            return True
    return False


def _stations(
    waves: Sequence[Path], described: Sequence[Path], traces: Sequence[Segment]
) -> tuple[Stations | None, tuple[str, ...]]:
    """Return the metadata given, or the only one beside the files, and what to say about it."""
    if described:
        return load_stations(described), ()
    files = matching_station_files(waves, {trace.codes[1] for trace in traces} - {""})
    if not files:
        return None, ()
    if len(files) == 1:
        return load_stations(files), ()
    names = ", ".join(p.name for p in files)
    return None, (f"expected one StationXML of the stations, found {names}: none was used",)


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Samples of one channel without a gap.

    Attributes
    ----------
    codes
        Of network, station, location and channel.
    start_ns, rate_hz
        Time of the first sample [ns], and how many there are in a second.
    form
        ObsPy's name of the format.
    data
        The samples.
    header
        What else the file says of a channel, of SEG-2.
    """

    codes: tuple[str, str, str, str]
    start_ns: int
    rate_hz: float
    form: str
    data: Column
    header: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, stats: Any, data: Column, form: str = "") -> Segment:
        """Return the samples of a trace of which ObsPy read the header."""
        network, station, location, channel = (
            str(stats[key]) for key in ("network", "station", "location", "channel")
        )
        return cls(
            (network, station, location, channel),
            int(stats.starttime.ns),
            float(stats.sampling_rate),
            form or str(stats._format),
            data,
            stats.seg2 if form == "SEG2" else {},
        )

    @property
    def id(self) -> str:
        """The channel as ``NET.STA.LOC.CHA``."""
        return ".".join(self.codes)

    @property
    def end_ns(self) -> int:
        """One period after the last sample [ns]."""
        return self.start_ns + round(len(self.data) * NS_PER_S / self.rate_hz)


def _read(path: Path, spool: Spool) -> tuple[list[Segment], list[str]]:
    """Return the segments of one file that hold samples, and what is lost of it.

    Samples are read from the file when they are asked for, or wait in a temporary one.
    """
    with path.open("rb") as file:
        head = file.read(_SEED_HEADER)
        if _SEED.match(head):
            traces, lines = _read_miniseed(path, spool)
        else:
            traces, lines = _read_other(path, file, spool), []
    segments = [s for s in traces if len(s.data) and s.rate_hz > 0]
    if not segments:
        raise FormatError(f"{path.name}: expected traces with samples, found none")
    for segment in segments:
        length_ns = len(segment.data) / segment.rate_hz * NS_PER_S
        if abs(segment.start_ns) + length_ns > MAX_NS:
            raise FormatError(
                f"{path.name}: {segment.id}: expected times within 146 years, found "
                f"{len(segment.data)} samples at {segment.rate_hz:g} Hz from {segment.start_ns} ns"
            )
    if len(segments) < len(traces):
        empty = len(traces) - len(segments)
        lines.append(f"{path.name}: {empty} of {len(traces)} traces hold no samples: left out")
    return segments, list(dict.fromkeys(lines))


@contextmanager
def _obspy(path: Path, at: int = 0) -> Iterator[list[str]]:
    """Read a file, or a part of one from a place on, by ObsPy; yield what it says is lacking."""
    try:
        with warnings.catch_warnings():
            # ObsPy's own use of importlib, matplotlib and its remarks on custom headers
            warnings.simplefilter("ignore")
            import obspy  # noqa: F401 (whether it is there)
    except ImportError as error:
        raise MissingReaderError(path.name, "obspy", "seismic") from error
    lines: list[str] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield lines
    except CodecError:
        raise
    except Exception as error:  # ObsPy's readers raise whatever their parsers meet
        text = _offset(str(error), at)
        raise FormatError(
            f"{path.name}: expected a seismic file ObsPy can read, found: {text}"
        ) from error
    lines += [
        f"{path.name}: {_offset(' '.join(str(w.message).split()), at)}"
        for w in caught
        # its reader of miniSEED warns of records it cannot read, others of their own use of Python
        if "MSEED" in w.category.__name__
    ]


def _read_other(path: Path, file: IO[bytes], spool: Spool) -> list[Segment]:
    """Return the segments of a file that is no miniSEED."""
    with _obspy(path):
        form = _format(file, path.name)
        if form == "SAC":
            return [_sac(path, file)]
        if form == "SEG2":
            return list(_seg2(path, file, spool))
        if form in ("SEGY", "SU"):
            return list(_segy(file, form, spool))
        return [
            Segment.of(trace.stats, _spooled(spool, trace.data))
            for content in _sections(file)
            for trace in _traces(content, form)
        ]


def _spooled(spool: Spool, samples: NDArray[Any]) -> Pieces:
    column = Pieces(spool, samples.dtype)
    column.add(samples)
    return column


def _traces(content: bytes, form: str, **more: Any) -> list[Any]:
    """Return ObsPy's traces of the bytes of a file of a format."""
    from obspy import read

    return list(read(io.BytesIO(content), format=form, **more))


def _sac(path: Path, file: IO[bytes]) -> Segment:
    """Return the one trace of a file of SAC: a header, and numbers of 4 bytes."""
    file.seek(0)
    head = file.read(_SAC_HEADER)
    (trace,) = _traces(head, "SAC", headonly=True, fsize=False)
    # ObsPy takes the order of this machine where both could be
    orders = sorted("<>", key=lambda order: order != {"little": "<", "big": ">"}[sys.byteorder])
    versions = [struct.unpack_from(f"{order}i", head, 304)[0] for order in orders]
    order = next(o for o, version in zip(orders, versions, strict=True) if 0 < version < 20)
    count = int(struct.unpack_from(f"{order}i", head, 316)[0])
    size, expected = path.stat().st_size, _SAC_HEADER + 4 * count
    if size != expected:
        raise FormatError(
            f"{path.name}: expected {expected} bytes for {count} samples, found {size}"
        )

    def samples(rows: slice) -> NDArray[Any]:
        with path.open("rb") as again:
            again.seek(_SAC_HEADER + 4 * rows.start)
            values = np.frombuffer(again.read(4 * (rows.stop - rows.start)), f"{order}f4")
        if len(values) < rows.stop - rows.start:
            raise FormatError(f"{path.name}: expected {expected} bytes, found fewer")
        return values

    return Segment.of(trace.stats, Computed(count, samples))


def _seg2(path: Path, file: IO[bytes], spool: Spool) -> Iterator[Segment]:
    """Yield the traces of a SEG-2 file: ObsPy is given some samples at a time.

    A trace descriptor block says at byte 2 how long it is, at 8 how many samples follow it and at
    12 how they are written (Pullan 1990, as of :func:`_shot`).
    """
    from obspy import Stream
    from obspy.io.seg2.seg2 import SEG2

    file.seek(0)
    reader = SEG2()
    reader.file_pointer, reader.stream = io.BytesIO(file.read(_PIECE_BYTES)), Stream()
    reader.read_file_descriptor_block()
    order = reader.endian.decode()
    for number, offset in enumerate(reader.trace_pointers, start=1):
        file.seek(offset)
        head = file.read(32)
        size, count, code = struct.unpack_from(f"{order}2xH4xLB", head)
        head += file.read(max(0, size - len(head)))
        if len(head) != size:
            raise FormatError(
                f"{path.name}: trace {number}: expected a header of {size} bytes, found {len(head)}"
            )
        column: Pieces | None = None
        done, stats = 0, None
        while column is None or done < count:
            now = min(count - done, _SEG2_SAMPLES)
            data = file.read(int(now * _SEG2_BYTES.get(code, 0)))
            part = head[:8] + struct.pack(f"{order}L", now) + head[12:] + data
            reader.file_pointer = io.BytesIO(part)
            trace = reader.parse_next_trace()
            if len(data) < now * _SEG2_BYTES[code]:
                raise FormatError(
                    f"{path.name}: trace {number}: expected {count} samples, found fewer"
                )
            stats = stats or trace.stats
            column = column or Pieces(spool, trace.data.dtype)
            column.add(trace.data)
            done += now
        yield Segment.of(stats, column, "SEG2")


def _segy(file: IO[bytes], form: str, spool: Spool) -> Iterator[Segment]:
    """Yield the traces of a file of SEG-Y or Seismic Unix, of 65 535 samples at most."""
    from obspy.io.segy.segy import iread_segy, iread_su

    file.seek(0)
    for trace in {"SEGY": iread_segy, "SU": iread_su}[form](file):
        yield Segment.of(trace.stats, _spooled(spool, trace.data), form)


def _sections(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the parts of a text that begin as the first does, such as traces of GSE2."""
    file.seek(0)
    head = file.read(_SEED_HEADER)
    mark = next((mark for mark in _TEXTS if head.startswith(mark)), None)
    file.seek(0)
    if mark is None:
        yield file.read()
        return
    section: list[bytes] = []
    while line := file.readline(_PIECE_BYTES):
        if section and line.startswith(mark) and section[-1].endswith(b"\n"):
            yield b"".join(section)
            section.clear()
        section.append(line)
    yield b"".join(section)


def _offset(text: str, at: int) -> str:
    """Return what ObsPy says of a part of a file, with offsets in the whole."""
    return re.sub(r"(?<=offset )\d+", lambda match: str(int(match[0]) + at), text)


#: Parts of a file of miniSEED read at once [bytes].
_PIECE_BYTES = 1 << 20
_SEED_HEADER = 48
_SAC_HEADER = 632
#: Samples of a SEG-2 trace read at once: those of 20 bits come in fours.
_SEG2_SAMPLES = 1 << 18
#: Bytes of a sample by the format code of SEG-2.
_SEG2_BYTES = {1: 2, 2: 4, 3: 2.5, 4: 4, 5: 8}
#: A record with samples: its number and quality, whose it is, and a year from 1792 to 2303.
_RECORD = re.compile(rb"[\d \0]{6}[DRQM][ \0].{12}(?:[\x07\x08].|.[\x07\x08])", re.DOTALL)
#: The most samples that a byte of data can be, by its encoding (SEED 2.4, blockette 1000, and
#: appendix B: 7 to a word of Steim 2, 4 of Steim 1, of whose frames of 16 words 15 hold data).
_DENSITY = {
    0: 1.0, 1: 1 / 2, 2: 1 / 3, 3: 1 / 4, 4: 1 / 4, 5: 1 / 8, 10: 60 / 64, 11: 105 / 64, 12: 1 / 3,
    13: 1 / 2, 14: 1 / 2, 15: 1 / 2, 16: 1 / 2, 17: 1 / 2, 18: 1 / 2, 30: 1 / 2, 31: 1 / 2,
    32: 1 / 2, 33: 1 / 2,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Record:
    """What the header of one record says: where it ends, whose it is, its time and samples.

    Attributes
    ----------
    stop
        Place of the next record [bytes].
    channel
        Network, station, location and channel, and quality.
    start_s, count
        Time of the first sample, and number of samples.
    """

    stop: int
    channel: bytes
    start_s: float
    count: int


def _record(data: bytes, at: int, name: str, begin: int) -> _Record | None:
    """Return the record at a place (SEED 2.4, fixed section of data header, blockette 1000).

    None where it does not tell its length. A record that claims more samples than it has bytes for
    is a FormatError: libmseed would read on behind it.
    """
    order = ">" if data[at + 20] in (7, 8) else "<"
    year, day, hour, minute, second, _, part = struct.unpack_from(f"{order}HHBBBBH", data, at + 20)
    (count,) = struct.unpack_from(f"{order}H", data, at + 30)
    samples, blockette = struct.unpack_from(f"{order}HH", data, at + 44)
    length = encoding = 0
    for _ in range(16):
        if not blockette >= _SEED_HEADER or at + blockette + 8 > len(data):
            break
        kind, after = struct.unpack_from(f"{order}HH", data, at + blockette)
        if kind == 1000:
            encoding, length = data[at + blockette + 4], 1 << data[at + blockette + 6] % 32
        if after <= blockette:
            break
        blockette = after
    if not length:
        return None
    most = int(_DENSITY.get(encoding, 2.0) * max(0, length - samples))
    if count > most and samples:
        raise FormatError(
            f"{name}: byte {begin + at}: expected at most {most} samples in a record of {length} "
            f"bytes, found {count}"
        )
    days = datetime.date(min(max(year, 1), 9999), 1, 1).toordinal() + day - 1
    start_s = days * 86_400.0 + hour * 3600 + minute * 60 + second + part * 1e-4
    channel = data[at + 6 : at + 20].replace(b"\0", b" ")
    return _Record(at + length, channel, start_s, count)


def _read_miniseed(path: Path, spool: Spool) -> tuple[list[Segment], list[str]]:
    """Return the segments of a file of miniSEED, which is read in parts, and what is lost of it.

    Parts are whole records. The samples are kept in a temporary file, in the order of the records:
    a segment is what lies in many places of it.
    """
    joined = _Joined()
    lines: list[str] = []
    for at, content, records in _parts(path):
        with _obspy(path, at) as remarks:
            traces = _traces(content, "MSEED")
        lines += remarks
        for trace in traces:
            if trace.data.dtype.kind not in "iuf":
                raise FormatError(f"{path.name}: {trace.id}: expected numbers, found text")
        joined.add(traces, records, spool)
    return joined.segments, lines


def _parts(path: Path) -> Iterator[tuple[int, bytes, list[_Record]]]:
    """Yield where parts of a file of miniSEED begin, their bytes, and the records in them."""
    at, begin, content = 0, 0, b""
    records: list[_Record] = []
    with path.open("rb") as file:
        while block := file.read(_PIECE_BYTES):
            content += block
            at = _walk(content, at, records, path.name, begin)
            if not records:
                continue
            yield begin, content[:at], records
            begin, content, at, records = begin + at, content[at:], 0, []
    if content:
        yield begin, content, records


def _walk(content: bytes, at: int, records: list[_Record], name: str, begin: int) -> int:
    """Add the whole records from a place on; return where what is not whole begins."""
    while at + 2 * _SEED_HEADER <= len(content):
        record = _record(content, at, name, begin) if _RECORD.match(content, at) else None
        if record is None:  # what is between records ObsPy passes over
            after = _RECORD.search(content, at + 1)
            if after is None:
                return max(at, len(content) - _SEED_HEADER)
            at = after.start()
        elif record.stop > len(content):
            break
        else:
            records.append(record)
            at = record.stop
    return at


@dataclass(slots=True)
class _Joined:
    """Segments that grow by the traces of parts of a file.

    Attributes
    ----------
    segments
        In the order in which they began.
    last
        By channel its last segment, and when and how fast its last record ends [s], [Hz].
    """

    segments: list[Segment] = field(default_factory=list)
    last: dict[bytes, tuple[Segment, float, float]] = field(default_factory=dict)

    def add(self, traces: Sequence[Any], records: Sequence[_Record], spool: Spool) -> None:
        """Keep the samples of a part's traces; one that goes on where its channel ended joins it.

        libmseed takes records of one channel for one trace where they are apart by no more than
        half a sample from the next (ObsPy, ``readMSEEDBuffer``), and so are parts.
        """
        first: dict[bytes, _Record] = {}
        final: dict[bytes, _Record] = {}
        for record in (r for r in records if r.count):
            first.setdefault(record.channel, record)
            final[record.channel] = record
        seen: dict[bytes, Segment] = {}
        for trace in traces:
            key = _key(trace)
            before = self.last.get(key) if key not in seen else None
            begin = first.get(key)
            if before and begin and _goes_on(before, begin, trace):
                segment = before[0]
            else:
                segment = Segment.of(trace.stats, Pieces(spool, trace.data.dtype))
                self.segments.append(segment)
            pieces_ = segment.data
            assert isinstance(pieces_, Pieces)
            pieces_.add(trace.data)
            seen[key] = segment
        for key, segment in seen.items():
            if end := final.get(key):
                rate_hz = segment.rate_hz or 1.0
                self.last[key] = segment, end.start_s + end.count / rate_hz, rate_hz


def _key(trace: Any) -> bytes:
    """Return a trace's channel as the headers of its records write it."""
    stats = trace.stats
    quality = str(stats.mseed.dataquality)
    names = ((stats.station, 5), (stats.location, 2), (stats.channel, 3), (stats.network, 2))
    padded = "".join(name.ljust(size) for name, size in names)
    return f"{quality} {padded}".encode("latin-1", "replace")


def _goes_on(before: tuple[Segment, float, float], begin: _Record, trace: Any) -> bool:
    """Tell whether a trace goes on where its channel ended."""
    segment, end_s, rate_hz = before
    same = segment.rate_hz == trace.stats.sampling_rate
    assert isinstance(segment.data, Pieces)
    same_type = segment.data.dtype == trace.data.dtype
    return bool(same and same_type and abs(begin.start_s - end_s) * rate_hz <= 0.5)


def _format(content: IO[bytes], name: str) -> str:
    """Return ObsPy's name of a format; its own search would run what a pickle says.

    Some of ObsPy's tests read all that they are given: it is the begin of the file.
    """
    content.seek(0)
    head, size = content.read(_SEGY_TRACES + _TRACE_HEADER), content.seek(0, 2)
    if head[:4] in _SEG2_STARTS:
        return "SEG2"
    if _is_sac(head):
        return "SAC"
    if _is_segy(head, size) and not head.startswith(_TEXTS):
        return "SEGY"
    content.seek(0)
    begin = io.BytesIO(content.read(_PIECE_BYTES))
    from obspy.core.util.base import ENTRY_POINTS, buffered_load_entry_point

    for format_, point in ENTRY_POINTS["waveform"].items():
        if format_ == "PICKLE":
            continue
        group = f"obspy.plugin.waveform.{format_}"
        begin.seek(0)
        matched = buffered_load_entry_point(point.dist.name, group, "isFormat")(begin)
        if matched:
            return str(format_)
    raise FormatError(f"{name}: expected a seismic file ObsPy can read, found another file")


def _shot(path: Path, traces: Sequence[Segment]) -> Shot:
    """Return one SEG-2 file as a shot.

    ``DESCALING_FACTOR`` takes a sample to millivolts at the input, ``DELAY`` is the time from the
    shot to the first sample (S. E. Pullan, Recommended standard for seismic (/radar) data files
    in the personal computer environment, Geophysics 55, 1990).
    """
    headers = [t.header for t in traces]
    shapes = {(len(t.data), t.rate_hz) for t in traces}
    delays = {_number(path, h, "DELAY", 0.0) for h in headers}
    if len(shapes) != 1 or len(delays) != 1:
        raise SchemaError(
            f"{path.name}: expected traces of one length, rate and DELAY, "
            f"found {len(shapes)} lengths or rates and {len(delays)} delays"
        )
    receivers = [_position(path, h, "RECEIVER_LOCATION") for h in headers]
    positions = [r for r in receivers if r is not None]
    scales = [_number(path, h, "DESCALING_FACTOR", 0.0) * 1e-3 for h in headers]
    return Shot(
        name=path.stem,
        start_ns=traces[0].start_ns,
        rate_hz=traces[0].rate_hz,
        delay_s=delays.pop(),
        source=_position(path, headers[0], "SOURCE_LOCATION"),
        receivers=tuple(positions) if len(positions) == len(receivers) else None,
        scales_v=tuple(scales) if all(s > 0 for s in scales) else None,
        channels=tuple(t.data for t in traces),
    )


def _number(path: Path, header: Any, key: str, default: float) -> float:
    text = str(header.get(key, default)).strip()
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise FormatError(f"{path.name}: {key}: expected a number, found {text[:40]!r}")
    return value


def _position(path: Path, header: Any, key: str) -> tuple[float, float, float] | None:
    """Return a position of the header [m]: one to three coordinates, the rest 0."""
    words = str(header.get(key, "")).split()
    if not words:
        return None
    unit = str(header.get("UNITS", "METERS")).strip().upper() or "METERS"
    metres = _LENGTHS_M.get(unit, 1.0)
    try:
        x, y, z = [float(w) * metres for w in words] + [0.0] * (3 - len(words))
    except ValueError as error:
        raise FormatError(
            f"{path.name}: {key}: expected one to three coordinates, found {' '.join(words)[:40]!r}"
        ) from error
    return x, y, z


def _continuous(
    traces: Sequence[Segment], formats: set[str], where: str, stations: Stations | None
) -> Imported:
    """Return traces as streams: those with one rate and the same segments share a stream."""
    start_ns = min(t.start_ns for t in traces)
    if start_ns < 0:
        raise SchemaError(f"{where}: start time: expected 1970 or later, found {start_ns} ns")
    channels = _segments(traces if stations is None else split(traces, stations))
    plain = {name: _channel(name, segments[0]) for name, segments in channels.items()}
    site = Described(plain, {}) if stations is None else describe(channels, plain, stations)
    streams: dict[Any, dict[str, list[Segment]]] = {}
    for name, segments in channels.items():
        key = (segments[0].rate_hz, *((t.start_ns, len(t.data)) for t in segments))
        streams.setdefault(key, {})[name] = segments
    several = len(streams) > 1
    return Imported(
        sources=tuple(
            _stream(f"/seismic/{i}" if several else "/seismic", of_stream, site)
            for i, of_stream in enumerate(streams.values(), start=1)
        ),
        start_ns=start_ns,
        geometry=site.geometry,
        warnings=(
            *(f"{f}: the start time has {_KEPT[f]} only" for f in sorted(formats & _KEPT.keys())),
            *site.warnings,
        ),
        remarks=site.remarks,
        attachments=() if stations is None else stations.files,
    )


def _segments(traces: Sequence[Segment]) -> dict[str, list[Segment]]:
    """Return the segments of each channel in time order; traces without an id are channels."""
    channels: dict[str, list[Segment]] = {}
    for i, trace in enumerate(traces, start=1):
        name = trace.id if trace.id.strip(".") else f"G{i:02d}"
        segments = channels.get(name)
        if segments and segments[0].rate_hz != trace.rate_hz:
            name += f" {trace.rate_hz:g} Hz"
        channels.setdefault(name, []).append(trace)
    return {n: sorted(ts, key=lambda t: t.start_ns) for n, ts in channels.items()}


def _stream(topic: str, channels: dict[str, list[Segment]], site: Described) -> Source:
    """Return one stream; a segment starts at its own time to the nanosecond."""
    segments = list(zip(*channels.values(), strict=True))
    rate_hz = segments[0][0].rate_hz
    stream = Stream(topic, tuple(site.channels[name] for name in channels), rate_hz)
    ones = (1.0,) * len(segments)
    gains = list(zip(*(site.factors.get(name, ones) for name in channels), strict=True))
    name, samples = sample_format(_joined([[t.data for t in each] for each in segments], gains))
    starts = [segment[0].start_ns for segment in segments]
    firsts = [round((start_ns - starts[0]) * rate_hz / NS_PER_S) for start_ns in starts]
    counts = [len(segment[0].data) for segment in segments]
    return stream, name, _Blocks(stream, samples, starts, firsts, counts)


def _joined(segments: Sequence[Sequence[Column]], gains: Sequence[Iterable[float]]) -> Column:
    """Return the samples of segments, one after the other, each channel by its gain there.

    Parameters
    ----------
    segments
        The channels of each, all of one length.
    gains
        Of these channels.
    """
    counts = [len(channels[0]) for channels in segments]
    ends = np.cumsum(counts)

    def rows(wanted: slice) -> NDArray[Any]:
        parts = []
        first, last = np.searchsorted(ends, [wanted.start, wanted.stop - 1], "right").tolist()
        for at in range(first, last + 1):
            begin = int(ends[at]) - counts[at]
            inside = slice(max(0, wanted.start - begin), min(counts[at], wanted.stop - begin))
            both = zip(segments[at], gains[at], strict=True)
            with np.errstate(invalid="ignore"):  # what a damaged file has for numbers
                columns = [data[inside] * (1 if gain == 1.0 else gain) for data, gain in both]
            parts.append(np.stack(columns, axis=1))
        return np.concatenate(parts)

    return Computed(int(ends[-1]), rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Segments of a stream as blocks.

    Attributes
    ----------
    stream, samples
        The stream, and the samples of all segments.
    starts_ns, firsts, counts
        Of each segment: when it starts [ns], the number of its first sample from the stream's
        begin, and how many it has.
    """

    stream: Stream
    samples: Column
    starts_ns: Sequence[int]
    firsts: Sequence[int]
    counts: Sequence[int]

    def __iter__(self) -> Iterator[SignalBlock]:
        row = 0
        segments = zip(self.starts_ns, self.firsts, self.counts, strict=True)
        for begin_ns, first, count in segments:
            anchor_ns = begin_ns - round(first * self.stream.period_ns)
            for piece in pieces(count, len(self.stream.channels)):
                samples = self.samples[row + piece.start : row + piece.stop]
                yield SignalBlock(self.stream, anchor_ns, first + piece.start, samples)
            row += count


def _channel(name: str, trace: Segment) -> Channel:
    return Channel(name, "seismic", "count", _AXES.get(trace.codes[3][-1:], ""))


_MARK = b"FDSNStationXML"
_HEAD_BYTES = 4096
SUFFIXES = frozenset({".xml", ".stationxml"})
#: Units of the ground or air that a sensitivity counts from, as :mod:`.signals` spells them.
_INPUTS = {
    text.lower(): text
    for text in (
        *("m/s", "mm/s", "um/s", "nm/s", "m/s2", "mm/s2", "m", "cm", "mm", "um"),
        *("Pa", "hPa", "kPa", "V", "mV", "uV", "T", "nT", "rad/s", "deg/s"),
    )
}
_QUANTITIES = {
    "m/s": "ground_velocity",
    "m/s2": "ground_acceleration",
    "m": "ground_displacement",
    "Pa": "pressure",
    "V": "voltage",
    "T": "magnetic_field",
    "rad/s": "angular_velocity",
}
#: Quantities that have no direction, whatever the azimuth and dip of their channel say.
_SCALARS = frozenset({"pressure", "voltage"})
#: A channel points along an axis where it is no further from it than this [deg].
_ALONG_DEG = 5.0
_LETTERS = {"Z": "z", "N": "y", "E": "x"}
_OPEN_NS = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Epoch:
    """What held for a channel in one span of time.

    Attributes
    ----------
    start_ns, end_ns
        Of the span, half-open [ns].
    quantity, unit, scale
        What a count is worth; ``seismic``, ``count`` and 1 where ``fault`` says why it is not
        known.
    axis
        Along which positive values point; empty where along none.
    latitude_deg, longitude_deg, height_m
        Where the sensor stands: WGS 84 and above the sea.
    fault
        Why the sensitivity cannot be used, or nothing.
    """

    start_ns: int
    end_ns: int
    quantity: str
    unit: str
    scale: float
    axis: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    fault: str = ""

    @property
    def position(self) -> tuple[float, float, float]:
        """Latitude, longitude [deg] and height [m]."""
        return self.latitude_deg, self.longitude_deg, self.height_m


@dataclass(frozen=True, slots=True)
class Stations:
    """Epochs of channels by ``NET.STA.LOC.CHA``.

    Attributes
    ----------
    name
        Of the file, for messages.
    epochs
        By the channel's id, in order of time.
    files
        Name, media type and content of each file, to keep with the recording: the whole response.
    """

    name: str
    epochs: dict[str, tuple[Epoch, ...]]
    files: tuple[tuple[str, str, bytes], ...] = ()

    def at(self, channel: str, time_ns: int) -> Epoch | None:
        """Return the epoch of a channel that holds at a time, the latest where several do."""
        holding = [e for e in self.epochs.get(channel, ()) if e.start_ns <= time_ns < e.end_ns]
        return holding[-1] if holding else None

    def changes(self, channel: str, start_ns: int, stop_ns: int) -> list[int]:
        """Return when, within a span, what a count is worth changes [ns]."""
        edges = {t for e in self.epochs.get(channel, ()) for t in (e.start_ns, e.end_ns)}
        inside = sorted(t for t in edges if start_ns < t < stop_ns)
        return [t for t in inside if _worth(self.at(channel, t - 1)) != _worth(self.at(channel, t))]


def _worth(epoch: Epoch | None) -> object:
    return None if epoch is None else (epoch.quantity, epoch.unit, epoch.scale, epoch.axis)


def is_station_xml(path: Path) -> bool:
    """Tell whether a file begins as StationXML does."""
    with path.open("rb") as file:
        return _MARK in file.read(_HEAD_BYTES)


def matching_station_files(paths: Sequence[Path], stations: Iterable[str]) -> list[Path]:
    """Return the StationXML files in the folders of some files that name one of some stations."""
    codes = [f'code="{station}"'.encode() for station in stations]
    folders = dict.fromkeys(p.resolve().parent for p in paths)
    inside = (p for folder in folders for p in sorted(folder.iterdir()))
    candidates = (p for p in inside if p.suffix.lower() in SUFFIXES and p.is_file())
    return [
        p for p in candidates if is_station_xml(p) and any(code in p.read_bytes() for code in codes)
    ]


def load_stations(paths: Sequence[Path]) -> Stations:
    """Read StationXML files.

    Raises
    ------
    MissingReaderError
        Without ObsPy.
    FormatError
        Where a file is no StationXML.
    """
    epochs: dict[str, list[Epoch]] = {}
    files = [(path.name, "application/xml", path.read_bytes()) for path in paths]
    for name, _, content in files:
        for network in _inventory(name, content):
            for station in network:
                for channel in station:
                    codes = (network.code, station.code, channel.location_code, channel.code)
                    epochs.setdefault(".".join(codes), []).append(_epoch(channel))
    return Stations(
        ", ".join(p.name for p in paths),
        {name: tuple(sorted(es, key=lambda e: e.start_ns)) for name, es in epochs.items()},
        tuple(files),
    )


def _inventory(name: str, content: bytes) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ObsPy's, on its own imports and on versions of the schema
        try:
            from obspy import read_inventory
        except ImportError as error:
            raise MissingReaderError(name, "obspy", "seismic") from error
        try:
            return read_inventory(io.BytesIO(content), format="STATIONXML")
        except Exception as error:  # ObsPy and lxml raise whatever they meet
            text = " ".join(str(error).split())[:200]
            raise FormatError(f"{name}: expected StationXML, found: {text}") from error


def _epoch(channel: Any) -> Epoch:
    """Return one epoch of a channel, as ObsPy has it."""
    sensitivity = _sensitivity(channel)
    fault = sensitivity if isinstance(sensitivity, str) else ""
    unit, scale = ("count", 1.0) if isinstance(sensitivity, str) else sensitivity
    quantity = _QUANTITIES.get(unit, "seismic")
    axis, sign = ("", 1.0) if quantity in _SCALARS else _direction(channel)
    return Epoch(
        0 if channel.start_date is None else int(channel.start_date.ns),
        _OPEN_NS if channel.end_date is None else int(channel.end_date.ns),
        quantity,
        unit,
        sign * scale,
        axis,
        float(channel.latitude),
        float(channel.longitude),
        float(channel.elevation),
        fault,
    )


def _sensitivity(channel: Any) -> tuple[str, float] | str:
    """Return the SI unit and what one count is in it, or why that is not known."""
    sensitivity = channel.response.instrument_sensitivity if channel.response is not None else None
    if sensitivity is None or not sensitivity.value:
        return "has no sensitivity"
    to, given = str(sensitivity.output_units or ""), str(sensitivity.input_units or "")
    if "count" not in to.lower():
        return f"has a sensitivity to {to or 'no unit'}, not to counts"
    plain = given.lower().replace("**", "").replace("^", "").replace("/s/s", "/s2")
    if plain not in _INPUTS:
        return f"has a sensitivity from {given or 'no unit'}, which is not known here"
    unit, factor = to_si(_INPUTS[plain])
    return unit, factor / float(sensitivity.value)


def _direction(channel: Any) -> tuple[str, float]:
    """Return the axis of a channel and whether it counts along it or against it.

    Dip is downwards from the horizon, azimuth clockwise from north [deg]; a channel without them
    goes by the last letter of its code.
    """
    if channel.dip is None or (channel.azimuth is None and abs(channel.dip) < 90 - _ALONG_DEG):
        return _LETTERS.get(channel.code[-1:], ""), 1.0
    if abs(channel.dip) >= 90 - _ALONG_DEG:
        return "z", 1.0 if channel.dip < 0 else -1.0
    if abs(channel.dip) > _ALONG_DEG:
        return "", 1.0
    for degrees, axis, sign in ((0, "y", 1.0), (90, "x", 1.0), (180, "y", -1.0), (270, "x", -1.0)):
        if abs((channel.azimuth - degrees + 180) % 360 - 180) <= _ALONG_DEG:
            return axis, sign
    return "", 1.0


@dataclass(frozen=True, slots=True)
class Described:
    """What the channels of some files are.

    Attributes
    ----------
    channels
        By name.
    factors
        By name, for each segment: what its samples have to be multiplied with to be worth what
        the first segment's are.
    geometry
        Where the sensors stand, where that is known.
    warnings, remarks
        One line each.
    """

    channels: dict[str, Channel]
    factors: dict[str, tuple[float, ...]]
    geometry: Geometry | None = None
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def split(traces: Sequence[Segment], stations: Stations) -> list[Segment]:
    """Return segments, cut where what a count is worth changes."""
    parts = []
    for trace in traces:
        count, rate_hz = len(trace.data), trace.rate_hz
        changes = stations.changes(trace.id, trace.start_ns, trace.end_ns)
        rows = [math.ceil((t - trace.start_ns) * rate_hz / NS_PER_S) for t in changes]
        edges = [0, *(r for r in rows if 0 < r < count), count]
        for first, stop in pairwise(edges):
            begin_ns = trace.start_ns + round(first * NS_PER_S / rate_hz)
            data = part_of(trace.data, first, stop)
            parts.append(replace(trace, start_ns=begin_ns, data=data))
    return parts


def describe(
    channels: Mapping[str, Sequence[Segment]], plain: Mapping[str, Channel], stations: Stations
) -> Described:
    """Return channels in the units and at the places of their epochs.

    Parameters
    ----------
    channels
        The segments of each channel, in order of time.
    plain
        The channels without metadata: what stays where there is none.
    stations
        The metadata.
    """
    made, factors, places, warnings = dict(plain), {}, {}, []
    for name, traces in channels.items():
        epochs = [stations.at(trace.id, trace.start_ns) for trace in traces]
        valid_epochs = [epoch for epoch in epochs if epoch is not None]
        if fault := _fault(traces, epochs, stations):
            warnings.append(f"{fault}: its samples stay counts")
        else:
            made[name] = replace(
                plain[name],
                quantity=valid_epochs[0].quantity,
                unit=valid_epochs[0].unit,
                axis=valid_epochs[0].axis,
                scale=valid_epochs[0].scale,
            )
            factors[name] = tuple(epoch.scale / valid_epochs[0].scale for epoch in valid_epochs)
        if valid_epochs:
            places[name] = valid_epochs[0].position
            if any(epoch.position != valid_epochs[0].position for epoch in valid_epochs):
                warnings.append(f"{stations.name}: {name}: was moved: its first place is kept")
    site = Described(made, factors, warnings=tuple(warnings))
    return _placed(site, places, stations.name) if places else site


def _fault(
    traces: Sequence[Segment], epochs: Sequence[Epoch | None], stations: Stations
) -> str | None:
    """Return why the channel of some traces cannot be brought to units."""
    name = traces[0].id
    if name not in stations.epochs:
        near = [other for other in stations.epochs if other.split(".")[:2] == name.split(".")[:2]]
        near_names = ", ".join(near) or "no channel of this station"
        return f"{stations.name}: {name}: expected this channel, found {near_names}"
    for trace, epoch in zip(traces, epochs, strict=True):
        if epoch is None:
            when = np.datetime64(trace.start_ns // 1000, "us")
            return f"{stations.name}: {name}: expected an epoch at {when}Z, found none"
        if epoch.fault:
            return f"{stations.name}: {name}: {epoch.fault}"
    if len({(e.quantity, e.unit, e.axis) for e in epochs if e is not None}) > 1:
        return f"{stations.name}: {name}: expected one quantity and axis, found several epochs'"
    return None


def _placed(
    site: Described, places: Mapping[str, tuple[float, float, float]], file: str
) -> Described:
    """Return the site with its sensors in metres east, north and up of the first one."""
    first, origin = next(iter(places.items()))
    plane = TangentPlane(origin=(math.radians(origin[0]), math.radians(origin[1])))
    channels = dict(site.channels)
    sensors = []
    for name, point in places.items():
        east, north = plane.map_position(math.radians(point[0]), math.radians(point[1]))
        position = (round(east, 3), round(north, 3), round(point[2] - origin[2], 3))
        channels[name] = replace(channels[name], position_m=position)
        sensors.append(Sensor(name, name, *position, channels[name].axis or "z"))
    remark = (
        f"places are metres east, north and up of {origin[0]:.6f}, {origin[1]:.6f} at "
        f"{origin[2]:g} m, where {first} stands ({file})"
    )
    return replace(
        site,
        channels=channels,
        geometry=Geometry(sensors=tuple(sensors), origin=origin),
        remarks=(remark, *_scaled(site, file)),
    )


def _scaled(site: Described, file: str) -> list[str]:
    """Say what was done to the samples."""
    kinds = dict.fromkeys(
        f"{site.channels[name].quantity} in {site.channels[name].unit}" for name in site.factors
    )
    if not kinds:
        return []
    return [f"{', '.join(kinds)} by the sensitivity of {file}; the response was not taken out"]


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One shot record.

    Attributes
    ----------
    name
        Of the file, without suffix.
    start_ns
        Acquisition time as the header has it (whole seconds in most files) [ns].
    rate_hz
        Sampling rate.
    delay_s
        From the shot to the first sample [s]; negative where the record starts before the shot.
    source
        Place of the shot [m], or None.
    receivers
        Places of the channels [m]; None where the header has none.
    scales_v
        Volts at the instrument's input for a sample of one; None where unknown.
    channels
        The samples of each channel, as recorded, all of one length.
    """

    name: str
    start_ns: int
    rate_hz: float
    delay_s: float
    source: Position | None
    receivers: tuple[Position, ...] | None
    scales_v: tuple[float, ...] | None
    channels: tuple[Column, ...]

    def __len__(self) -> int:
        return len(self.channels[0])


def assemble_shots(shots: Sequence[Shot]) -> Imported:
    """Return shots as one recording with geometry, ``impact`` and ``trigger`` at each time zero.

    Raises
    ------
    SchemaError
        Where the shots do not share a sampling rate, or only some have positions or scales.
    """
    shots = sorted(shots, key=lambda s: s.start_ns)  # stable: files come in natural order
    _check_one_line(shots)
    shots, starts, note = _in_time(shots)
    start_ns, rate_hz = starts[0], shots[0].rate_hz
    firsts = [round((t - start_ns) * rate_hz / NS_PER_S) for t in starts]
    names = _names(shots)
    spreads: dict[tuple[str, ...], list[int]] = {}
    for i, shot_names in enumerate(names):
        spreads.setdefault(shot_names, []).append(i)
    sources = []
    for number, (spread, members) in enumerate(spreads.items(), start=1):
        topic = "/seismic" if len(spreads) == 1 else f"/seismic/{number}"
        offsets = [firsts[i] - firsts[members[0]] for i in members]
        spread_shots = [shots[i] for i in members]
        sources.append(_spread(topic, spread, spread_shots, offsets, [starts[i] for i in members]))
    moved = f"the spread was moved: {len(spreads)} streams, receivers named by place"
    return Imported(
        sources=tuple(sources),
        start_ns=start_ns,
        geometry=_geometry(shots, names),
        labels=tuple(x for s, t in zip(shots, starts, strict=True) for x in _time_zero(s, t)),
        warnings=(moved,) if len(spreads) > 1 else (),
        remarks=note,
        files=tuple((s.name, t) for s, t in zip(shots, starts, strict=True)),
    )


def _check_one_line(shots: Sequence[Shot]) -> None:
    first = shots[0]
    for shot in shots[1:]:
        if shot.rate_hz != first.rate_hz:
            raise SchemaError(
                f"{shot.name}: sampling rate: expected {first.rate_hz:g} Hz as in {first.name}, "
                f"found {shot.rate_hz:g} Hz"
            )
        for what in ("receivers", "scales_v"):
            if (getattr(shot, what) is None) != (getattr(first, what) is None):
                raise SchemaError(
                    f"{shot.name}: {what}: expected in every shot or in none, as {first.name}"
                )
        if shot.receivers is None and len(shot.channels) != len(first.channels):
            raise SchemaError(
                f"{shot.name}: expected {len(first.channels)} channels as in {first.name}, "
                f"which have no positions to tell them by, found {len(shot.channels)}"
            )


def _in_time(shots: Sequence[Shot]) -> tuple[list[Shot], list[int], tuple[str, ...]]:
    """Return the shots in order, when the first sample of each is [ns], and of several why then.

    A shot takes its time from the hammer's blow, where that comes before the first sample.
    """
    leads = [max(0, round(s.delay_s * NS_PER_S)) for s in shots]
    period_ns = NS_PER_S / shots[0].rate_hz
    parts = []
    for shot, lead_ns in zip(shots, leads, strict=True):
        # a file without a date starts at the clock's zero, its shot no earlier
        first_ns = max(shot.start_ns, lead_ns)
        end_ns = first_ns + round(len(shot) * period_ns)
        parts.append(Part(shot.name, first_ns - lead_ns, end_ns))
    laid = lay_out(parts, "shots")
    starts = [t + leads[i] for i, t in zip(laid.order, laid.starts_ns, strict=True)]
    return [shots[i] for i in laid.order], starts, (laid.note,) if len(shots) > 1 else ()


def _names(shots: Sequence[Shot]) -> list[tuple[str, ...]]:
    """Return the channel names of each shot: receivers numbered by place as they first appear."""
    keys = [_keys(shot) for shot in shots]
    numbers: dict[tuple[Any, int], int] = {}
    for key in (k for shot in keys for k in shot):
        numbers.setdefault(key, len(numbers) + 1)
    width = max(2, len(str(len(numbers))))
    return [tuple(f"G{numbers[k]:0{width}d}" for k in shot) for shot in keys]


def _keys(shot: Shot) -> list[tuple[Any, int]]:
    """Return what tells receivers apart: place, and count where a place has several."""
    if shot.receivers is None:
        return [(None, i) for i in range(len(shot.channels))]
    return [(p, shot.receivers[:i].count(p)) for i, p in enumerate(shot.receivers)]


def _spread(
    topic: str,
    names: tuple[str, ...],
    shots: Sequence[Shot],
    offsets: Sequence[int],
    starts: Sequence[int],
) -> Any:
    """Return the shots of one spread as a stream; gains are brought to the first shot's."""
    first = shots[0]
    scales = first.scales_v
    ones = np.ones(len(names))
    gains = [np.array(s.scales_v) / scales if scales else ones for s in shots]
    name, samples = sample_format(_joined([s.channels for s in shots], gains))
    positions = first.receivers or (None,) * len(names)
    channels = tuple(
        Channel(g, "voltage", "V", "z", scale, position)
        if scales
        else Channel(g, "seismic", "count", "z", 1.0, position)
        for g, scale, position in zip(names, scales or (1.0,) * len(names), positions, strict=True)
    )
    stream = Stream(topic, channels, first.rate_hz)
    return stream, name, _Blocks(stream, samples, starts, offsets, [len(s) for s in shots])


def _geometry(shots: Sequence[Shot], names: Sequence[tuple[str, ...]]) -> Geometry | None:
    places: dict[str, Position] = {}
    for shot, shot_names in zip(shots, names, strict=True):
        places.update(zip(shot_names, shot.receivers or (), strict=False))
    points = tuple((s.name, s.source[0], s.source[1]) for s in shots if s.source is not None)
    if not places and not points:
        return None
    sensors = tuple(Sensor(name, name, *position) for name, position in places.items())
    return Geometry(sensors=sensors, sources=points)


def _time_zero(shot: Shot, first_sample_ns: int) -> tuple[Label, Label]:
    """Return the labels of the shot's time zero: the impact, and the trigger that tells of it."""
    time_ns = first_sample_ns - round(shot.delay_s * NS_PER_S)
    x, y, _ = shot.source or (None, None, None)
    impact = Label(time_ns, "impact", x_m=x, y_m=y, label=shot.name)
    return impact, replace(impact, kind=TRIGGER)
