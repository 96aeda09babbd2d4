"""Exports for seismology: miniSEED and QuakeML, by ObsPy."""

from __future__ import annotations

import io
import math
import warnings
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.errors import MissingReaderError
from groundtrace_codecs.events import Pick
from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..errors import RecordingError
from ..runtime import installed_version
from .base import Written, events_of_kind, pieces_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path
    from typing import BinaryIO

    from numpy.typing import NDArray

    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import Channel, SignalBlock, Stream

    from .base import Material

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


_PUBLISHER = "smi:local/groundtrace"


class QuakeMlExporter:
    """Writes picks into one event, for nobody says here which of them belong together.

    Channels have the codes of the miniSEED of the same recording, where it is there; a comment
    keeps each pick's own channel and stage. Needs ObsPy.
    """

    name = "quakeml"
    description = "picks as QuakeML 1.2, times to the microsecond (needs ObsPy)"
    suffixes = (".quakeml", ".qml", ".xml")
    kinds = ("picks",)
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write the picks."""
        core = obspy_part("obspy.core", path.name)
        event = core.event
        picks = [p for p in events_of_kind(material, "picks") if isinstance(p, Pick)]
        recording = material.recording()
        codes = seed_codes(recording.streams) if recording is not None else {}
        made = [_pick(core, i, p, codes) for i, p in enumerate(picks)]
        quake_event = event.Event(
            resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/event/1"),
            picks=made,
            event_descriptions=[event.EventDescription(text=f"picks of {material.name}")],
            creation_info=event.CreationInfo(author="groundtrace", version=installed_version()),
        )
        catalog = event.Catalog(
            [quake_event], resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/catalog/1")
        )
        content = io.BytesIO()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ObsPy's, on identifiers and on its entry points
            catalog.write(content, format="QUAKEML")
        path.write_bytes(content.getvalue())
        return Written(dict.fromkeys(kinds, len(picks)), ("times are rounded to the microsecond",))


def _pick(core: Any, number: int, pick: Pick, codes: dict[tuple[str, str], SeedCode]) -> Any:
    event = core.event
    seed_code = codes.get((pick.topic, pick.channel))
    code = seed_code or SeedCode("XX", station_code(pick.channel), "", "")
    comment = f"channel {pick.channel} of {pick.topic}, stage {pick.stage}, value {pick.value:g}"
    sigma_s = pick.uncertainty_s
    errors = event.QuantityError(uncertainty=sigma_s) if math.isfinite(sigma_s) else None
    return event.Pick(
        resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/pick/{number + 1}"),
        time=core.UTCDateTime(ns=pick.time_ns),
        time_errors=errors,
        waveform_id=event.WaveformStreamID(
            network_code=code.network,
            station_code=code.station,
            location_code=code.location,
            channel_code=code.channel or None,
        ),
        evaluation_mode="automatic",
        comments=[
            event.Comment(
                text=comment,
                resource_id=event.ResourceIdentifier(f"{_PUBLISHER}/pick/{number + 1}/comment"),
                force_resource_id=False,
            )
        ],
    )


#: Longest network, station, location and channel code.
_LENGTHS = (2, 5, 2, 3)
#: Second letter of a channel code (FDSN Source Identifiers, "Instrument and subsource codes"):
#: accelerometer, rotation rate, magnetometer, pressure, temperature; H is a high-gain seismometer,
#: Y any other instrument.
_INSTRUMENTS = {
    **dict.fromkeys(SEISMIC_QUANTITIES, "H"),
    "acceleration": "N",
    "ground_acceleration": "N",
    "angular_velocity": "J",
    "magnetic_field": "F",
    "pressure": "D",
    "temperature": "K",
}
#: Lowest rate [Hz] of each band code of short-period instruments (the same, "Band codes").
_BANDS = ((5000.0, "J"), (1000.0, "G"), (250.0, "D"), (80.0, "E"), (10.0, "S"), (1.0001, "M"))
#: Axes of the site are those of the compass only in name, as the importer of these formats has it.
_SITE_AXES = {"x": "E", "y": "N", "z": "Z"}
_BODY_AXES = {"x": "1", "y": "2", "z": "3"}


@dataclass(frozen=True, slots=True)
class SeedCode:
    """Network, station, location and channel code."""

    network: str
    station: str
    location: str
    channel: str

    def __str__(self) -> str:
        return f"{self.network}.{self.station}.{self.location}.{self.channel}"


def seed_codes(streams: Iterable[Stream]) -> dict[tuple[str, str], SeedCode]:
    """Return a code for each channel, by topic and name; no two are the same.

    A channel that is named ``NET.STA.LOC.CHA`` keeps these codes. Of others a seismic channel is a
    station of its name, and others are channels of a station with the last name of their topic.
    Where two would be the same, the location code counts them.
    """
    codes: dict[tuple[str, str], SeedCode] = {}
    taken: set[SeedCode] = set()
    for stream in streams:
        for channel in stream.channels:
            code = _named(channel.name) or _made(stream, channel)
            number = 0
            while code in taken:
                number += 1
                code = replace(code, location=f"{number:02d}")
            taken.add(code)
            codes[stream.topic, channel.name] = code
    return codes


def station_code(name: str) -> str:
    """Return a name as a station's code: letters and digits, at most five, the last ones."""
    named = _named(name)
    if named is not None:
        return named.station
    characters = "".join(c for c in name.upper() if c.isascii() and c.isalnum())
    return characters[-_LENGTHS[1] :] or "X"


def _named(name: str) -> SeedCode | None:
    parts = name.split(".")
    fits = len(parts) == len(_LENGTHS) and all(
        len(part) <= longest for part, longest in zip(parts, _LENGTHS, strict=True)
    )
    return SeedCode(*parts) if fits and name.isascii() and parts[1] and parts[3] else None


def _made(stream: Stream, channel: Channel) -> SeedCode:
    band = next((letter for lowest, letter in _BANDS if stream.rate_hz >= lowest), "L")
    instrument = _INSTRUMENTS.get(channel.quantity, "Y")
    if channel.quantity in SEISMIC_QUANTITIES:
        station, axis = station_code(channel.name), _SITE_AXES.get(channel.axis, "0")
    else:
        station = station_code(stream.topic.rsplit("/", 1)[-1])
        axis = _BODY_AXES.get(channel.axis, "0")
    return SeedCode("XX", station, "", band + instrument + axis)


def obspy_part(name: str, where: str) -> Any:
    """Import a part of ObsPy, e.g. ``obspy.core``.

    Raises
    ------
    MissingReaderError
        Where ObsPy is not installed; names ``where`` and the command that installs it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # ObsPy's own use of importlib and matplotlib
            return import_module(name)
    except ImportError as error:
        raise MissingReaderError(where, "obspy", "seismic") from error
