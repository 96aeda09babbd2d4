"""Station metadata in StationXML: what one count of a channel is worth, and where it stands.

A channel has epochs, each with its own sensitivity and place: the one that holds at a sample's
time counts. The sensitivity is that at one frequency; the instrument's response beside it stays
in the samples. Azimuth and dip say which way is positive (FDSN StationXML 1.2, Channel).
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import FormatError, MissingReaderError
from ..units import to_si

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

_MARK = b"FDSNStationXML"
_HEAD_BYTES = 4096
SUFFIXES = frozenset({".xml", ".stationxml"})
#: Units of the ground or air that a sensitivity counts from, as :mod:`..units` spells them.
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
    def place(self) -> tuple[float, float, float]:
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


def beside(paths: Sequence[Path], stations: Iterable[str]) -> list[Path]:
    """Return the StationXML files in the folders of some files that name one of some stations."""
    codes = [f'code="{station}"'.encode() for station in stations]
    folders = dict.fromkeys(p.resolve().parent for p in paths)
    inside = (p for folder in folders for p in sorted(folder.iterdir()))
    found = (p for p in inside if p.suffix.lower() in SUFFIXES and p.is_file())
    return [p for p in found if is_station_xml(p) and any(code in p.read_bytes() for code in codes)]


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
    found = _sensitivity(channel)
    fault = found if isinstance(found, str) else ""
    unit, scale = ("count", 1.0) if isinstance(found, str) else found
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
    told = channel.response.instrument_sensitivity if channel.response is not None else None
    if told is None or not told.value:
        return "has no sensitivity"
    to, given = str(told.output_units or ""), str(told.input_units or "")
    if "count" not in to.lower():
        return f"has a sensitivity to {to or 'no unit'}, not to counts"
    plain = given.lower().replace("**", "").replace("^", "").replace("/s/s", "/s2")
    if plain not in _INPUTS:
        return f"has a sensitivity from {given or 'no unit'}, which is not known here"
    unit, factor = to_si(_INPUTS[plain])
    return unit, factor / float(told.value)


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
