"""Codes of channels as seismology's formats have them: network, station, location, channel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace_codecs.signals import Channel, Stream

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
    kept = "".join(c for c in name.upper() if c.isascii() and c.isalnum())
    return kept[-_LENGTHS[1] :] or "X"


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
