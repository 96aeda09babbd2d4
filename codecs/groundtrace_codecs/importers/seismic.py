"""Importer for seismic files, read by ObsPy: SEG-2 shots, miniSEED, SAC, SEG-Y and others.

StationXML among the files, or alone beside them, says what counts are worth and where sensors
stand.
"""

from __future__ import annotations

import io
import re
import struct
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, MissingReaderError, SchemaError
from ..signals import NS_PER_S, Channel, SignalBlock, Stream
from .api import Imported
from .mapped import sample_format
from .shots import Shot, lay
from .station_channels import Described, describe, split
from .station_xml import beside, is_station_xml, load_stations

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import ImportMap, Source
    from .station_xml import Stations

_SUFFIXES = frozenset(
    {".sg2", ".seg2", ".mseed", ".miniseed", ".ms", ".sac", ".sgy", ".segy", ".su", ".gse2"}
)
_SEG2 = (b"\x55\x3a", b"\x3a\x55")
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
        read, lost = [], []
        for path in waves:
            traces, said = _read(path)
            read.append((path, traces))
            lost += said
        formats = {str(trace.stats._format) for _, traces in read for trace in traces}
        if "SEG2" in formats:
            if formats != {"SEG2"} or described:
                others = [*sorted(formats), *(["STATIONXML"] if described else [])]
                raise SchemaError(
                    f"{waves[0].name}: expected shots of one format, found {', '.join(others)}"
                )
            shots = lay([_shot(path, traces) for path, traces in read])
            return replace(shots, warnings=(*lost, *shots.warnings))
        traces = [trace for _, found in read for trace in found]
        stations, doubts = _stations(waves, described, traces)
        found = _continuous(traces, formats, waves[0].name, stations)
        return replace(found, warnings=(*lost, *found.warnings, *doubts))


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
        (own,) = struct.unpack_from(f"{order}H", head, _SEGY_TRACES + 114)
        if code not in _SEGY_BYTES or not interval_us or not (own or samples):
            continue
        trace = _TRACE_HEADER + (own or samples) * _SEGY_BYTES[code]
        if (size - _SEGY_TRACES) % trace == 0 or (own == samples and size - _SEGY_TRACES >= trace):
            return True
    return False


def _is_su(head: bytes, size: int) -> bool:
    """Tell a trace header of Seismic Unix: traces of that many samples fill the file."""
    if len(head) < _TRACE_HEADER:
        return False
    for order in "<>":
        code, samples, interval_us = struct.unpack_from(f"{order}h84xHH", head, 28)
        whole = samples and size % (_TRACE_HEADER + 4 * samples) == 0
        if whole and interval_us and 0 <= code <= _LAST_TRACE_CODE:
            return True
    return False


def _stations(
    waves: Sequence[Path], described: Sequence[Path], traces: Sequence[Any]
) -> tuple[Stations | None, tuple[str, ...]]:
    """Return the metadata given, or the only one beside the files, and what to say about it."""
    if described:
        return load_stations(described), ()
    found = beside(waves, {trace.stats.station for trace in traces} - {""})
    if not found:
        return None, ()
    if len(found) == 1:
        return load_stations(found), ()
    names = ", ".join(p.name for p in found)
    return None, (f"expected one StationXML of the stations, found {names}: none was used",)


def _read(path: Path) -> tuple[list[Any], list[str]]:
    """Return ObsPy's traces of one file that hold samples, and what is lost of it."""
    try:
        with warnings.catch_warnings():
            # ObsPy's own use of importlib, matplotlib and its remarks on custom headers
            warnings.simplefilter("ignore")
            from obspy import read
    except ImportError as error:
        raise MissingReaderError(path.name, "obspy", "seismic") from error
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            # from memory: a reader that fails would leave its file open
            traces = list(read(io.BytesIO(path.read_bytes())))
    except Exception as error:  # ObsPy's readers raise whatever their parsers meet
        raise FormatError(
            f"{path.name}: expected a seismic file ObsPy can read, found: {error}"
        ) from error
    kept = [t for t in traces if len(t.data) and t.stats.sampling_rate > 0]
    if not kept:
        raise FormatError(f"{path.name}: expected traces with samples, found none")
    lines = [
        f"{path.name}: {' '.join(str(w.message).split())}"
        for w in said
        # its reader of miniSEED warns of records it cannot read, others of their own use of Python
        if "MSEED" in w.category.__name__
    ]
    if len(kept) < len(traces):
        empty = len(traces) - len(kept)
        lines.append(f"{path.name}: {empty} of {len(traces)} traces hold no samples: left out")
    return kept, list(dict.fromkeys(lines))


def _shot(path: Path, traces: list[Any]) -> Shot:
    """Return one SEG-2 file as a shot.

    ``DESCALING_FACTOR`` takes a sample to millivolts at the input, ``DELAY`` is the time from the
    shot to the first sample (S. E. Pullan, Recommended standard for seismic (/radar) data files
    in the personal computer environment, Geophysics 55, 1990).
    """
    headers = [t.stats.seg2 for t in traces]
    shapes = {(t.stats.npts, t.stats.sampling_rate) for t in traces}
    delays = {_number(path, h, "DELAY", 0.0) for h in headers}
    if len(shapes) != 1 or len(delays) != 1:
        raise SchemaError(
            f"{path.name}: expected traces of one length, rate and DELAY, "
            f"found {len(shapes)} lengths or rates and {len(delays)} delays"
        )
    receivers = [_place(path, h, "RECEIVER_LOCATION") for h in headers]
    known = [r for r in receivers if r is not None]
    scales = [_number(path, h, "DESCALING_FACTOR", 0.0) * 1e-3 for h in headers]
    return Shot(
        name=path.stem,
        start_ns=int(traces[0].stats.starttime.ns),
        rate_hz=float(traces[0].stats.sampling_rate),
        delay_s=delays.pop(),
        source=_place(path, headers[0], "SOURCE_LOCATION"),
        receivers=tuple(known) if len(known) == len(receivers) else None,
        scales_v=tuple(scales) if all(s > 0 for s in scales) else None,
        samples=np.stack([t.data for t in traces], axis=1),
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


def _place(path: Path, header: Any, key: str) -> tuple[float, float, float] | None:
    """Return a place of the header [m]: one to three coordinates, the rest 0."""
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
    traces: list[Any], formats: set[str], place: str, stations: Stations | None
) -> Imported:
    """Return traces as streams: those with one rate and the same segments share a stream."""
    start_ns = min(int(t.stats.starttime.ns) for t in traces)
    if start_ns < 0:
        raise SchemaError(f"{place}: start time: expected 1970 or later, found {start_ns} ns")
    channels = _segments(traces if stations is None else split(traces, stations))
    plain = {name: _channel(name, segments[0]) for name, segments in channels.items()}
    known = Described(plain, {}) if stations is None else describe(channels, plain, stations)
    streams: dict[Any, dict[str, list[Any]]] = {}
    for name, segments in channels.items():
        key = (
            segments[0].stats.sampling_rate,
            *((int(t.stats.starttime.ns), t.stats.npts) for t in segments),
        )
        streams.setdefault(key, {})[name] = segments
    several = len(streams) > 1
    return Imported(
        sources=tuple(
            _stream(f"/seismic/{i}" if several else "/seismic", of_stream, known)
            for i, of_stream in enumerate(streams.values(), start=1)
        ),
        start_ns=start_ns,
        geometry=known.geometry,
        metadata=known.metadata,
        warnings=(
            *(f"{f}: the start time has {_KEPT[f]} only" for f in sorted(formats & _KEPT.keys())),
            *known.warnings,
        ),
        remarks=known.remarks,
        attachments=() if stations is None else stations.files,
    )


def _segments(traces: list[Any]) -> dict[str, list[Any]]:
    """Return the segments of each channel in time order; traces without an id are channels."""
    channels: dict[str, list[Any]] = {}
    for i, trace in enumerate(traces, start=1):
        name = trace.id if trace.id.strip(".") else f"G{i:02d}"
        known = channels.get(name)
        if known and known[0].stats.sampling_rate != trace.stats.sampling_rate:
            name += f" {trace.stats.sampling_rate:g} Hz"
        channels.setdefault(name, []).append(trace)
    return {n: sorted(ts, key=lambda t: int(t.stats.starttime.ns)) for n, ts in channels.items()}


def _stream(topic: str, channels: dict[str, list[Any]], known: Described) -> Source:
    """Return one stream; a segment starts at its own time to the nanosecond."""
    segments = list(zip(*channels.values(), strict=True))
    rate_hz = float(segments[0][0].stats.sampling_rate)
    stream = Stream(topic, tuple(known.channels[name] for name in channels), rate_hz)
    ones = (1.0,) * len(segments)
    gains = zip(*(known.factors.get(name, ones) for name in channels), strict=True)
    rows = [
        np.stack([t.data if gain == 1.0 else t.data * gain for t, gain in pairs], axis=1)
        for pairs in (zip(*both, strict=True) for both in zip(segments, gains, strict=True))
    ]
    name, samples = sample_format(np.concatenate(rows).astype(np.float64))
    start_ns = int(segments[0][0].stats.starttime.ns)
    blocks, row = [], 0
    for segment in segments:
        begin_ns, count = int(segment[0].stats.starttime.ns), segment[0].stats.npts
        first = round((begin_ns - start_ns) * rate_hz / NS_PER_S)
        anchor_ns = begin_ns - round(first * NS_PER_S / rate_hz)
        blocks.append(SignalBlock(stream, anchor_ns, first, samples[row : row + count]))
        row += count
    return stream, name, blocks


def _channel(name: str, trace: Any) -> Channel:
    return Channel(name, "seismic", "count", _AXES.get(trace.stats.channel[-1:], ""))
