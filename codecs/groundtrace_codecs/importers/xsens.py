"""Importer for the text that Xsens MT Manager exports: one file per sensor.

Comments of ``//``, a row of names, rows of numbers. Units are those of the manual: m/s2, rad/s,
degrees, and for the magnetometer the field where it was calibrated (MTw Awinda User Manual,
"Exporting data": a.u.). Older versions write ``Counter`` and ``Sample rate``, newer ones
``PacketCounter`` and, not always, ``Update Rate``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError, SchemaError
from ..signals import Channel
from ..units import to_quantity
from .api import ImportMap
from .delimited import TextTable
from .sampled import Sampled, together
from .xsens_time import PacketTimes, packet_times

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from .api import Imported

_HEAD_BYTES = 4096
_NAMES = re.compile(rb"^[^/\r\n]*\b(?:Packet)?Counter\b[^\r\n]*\b(?:Acc|Gyr|Mag)_X\b", re.M)
_RATE = re.compile(r"(?:Update|Sample) Rate:\s*(\d+(?:\.\d+)?)\s*Hz", re.I)
_DEVICE = re.compile(r"Device ?Id:\s*([0-9A-F]{8})\b", re.I)
_DEVICE_IN_NAME = re.compile(r"_([0-9A-F]{8})$", re.I)
_DELIMITERS = ("\t", ";", ",")
_MAG = "magnetic_field_normalised"
_NOT_TESLA = (
    f"the magnetic field is in units of that where the sensor was calibrated: kept as {_MAG}, "
    f"of which no heading is made"
)


def _axes(word: str, name: str, quantity: str, unit: str) -> tuple[tuple[str, Channel], ...]:
    return tuple((f"{word}_{a.upper()}", Channel(f"{name}_{a}", quantity, unit, a)) for a in "xyz")


def _quaternion(names: str) -> tuple[tuple[str, Channel], ...]:
    channels = (Channel(f"q_{a}", "orientation", "1", a) for a in "wxyz")
    return tuple(zip((f"Quat_{n}" for n in names.split()), channels, strict=True))


#: Topic to the columns of a stream and what they are; a stream is there where all its columns are.
STREAMS: tuple[tuple[str, tuple[tuple[str, Channel], ...]], ...] = (
    (
        "/imu",
        (
            *_axes("Acc", "acc", "acceleration", "m/s2"),
            *_axes("Gyr", "gyro", "angular_velocity", "rad/s"),
        ),
    ),
    ("/acc", _axes("Acc", "acc", "acceleration", "m/s2")),
    ("/gyro", _axes("Gyr", "gyro", "angular_velocity", "rad/s")),
    ("/mag", _axes("Mag", "mag", _MAG, "1")),
    ("/orientation", _quaternion("q0 q1 q2 q3")),
    ("/orientation", _quaternion("w x y z")),
    ("/baro", (("Pressure", Channel("pressure", "pressure", "Pa")),)),
    ("/temperature", (("Temperature", Channel("temperature", "temperature", "degC")),)),
    (
        "/fix",
        tuple(
            (name, Channel(name.lower(), name.lower(), unit))
            for name, unit in (("Latitude", "deg"), ("Longitude", "deg"), ("Altitude", "m"))
        ),
    ),
)


class XsensImporter:
    """Reads the files of the sensors of one recording."""

    name = "xsens"
    description = "text exported by Xsens MT Manager, a file per sensor"

    def sniff(self, path: Path) -> float:
        """Return 0.95 for comments of // and the names of columns below, 0.8 for names alone."""
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if not _NAMES.search(head):
            return 0.0
        return 0.95 if head.lstrip(b"\xef\xbb\xbf").startswith(b"//") else 0.8

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recording; they need no map.

        Raises
        ------
        SchemaError
            For a map, or two files of one sensor.
        FormatError
            Where a file is no such text, or nothing in it says how fast it was sampled.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for an Xsens export, found one")
        files = [_open(path) for path in paths]
        devices = [file.device for file in files]
        if len(set(devices)) < len(devices):
            raise SchemaError(
                f"{paths[0].name}: expected a sensor of its own in each file, "
                f"found {', '.join(devices)}"
            )
        times, remarks = packet_times([(f.table, f.rate_hz) for f in files])
        found: list[Sampled] = []
        warnings: list[str] = []
        for file, when in zip(files, times, strict=True):
            suffix = f"/{file.device}" if len(files) > 1 else ""
            found += _streams(file.table, when, suffix, warnings)
        if not found:
            raise FormatError(f"{paths[0].name}: expected columns with samples, found none")
        if any(each.channels[0].quantity == _MAG for each in found):
            remarks = (*remarks, _NOT_TESLA)
        return replace(together(found, warnings=tuple(warnings)), remarks=remarks)


@dataclass(frozen=True, slots=True)
class _File:
    """The rows of one sensor, its id, and the rate the comments tell, if they do [Hz]."""

    table: TextTable
    device: str
    rate_hz: float | None


def _open(path: Path) -> _File:
    """Read a file; the sensor's id is in the comments or ends the file's name."""
    lines = path.read_bytes()[:_HEAD_BYTES].decode("latin-1").splitlines()
    comments = "\n".join(line for line in lines if line.lstrip("\ufeffï»¿").startswith("//"))
    names = next((line for line in lines if line and not line.startswith(("//", "ï»¿//"))), "")
    delimiter = max(_DELIMITERS, key=names.count)
    layout = ImportMap("xsens", (), delimiter=delimiter, comment="//", encoding="utf-8-sig")
    table = TextTable.load(path, layout)
    rate = _RATE.search(comments)
    device = _DEVICE.search(comments) or _DEVICE_IN_NAME.search(path.stem)
    return _File(
        table, device[1].upper() if device else path.stem, float(rate[1]) if rate else None
    )


def _streams(
    table: TextTable, when: PacketTimes, suffix: str, warnings: list[str]
) -> list[Sampled]:
    """Return the streams of a table; adds a line for each thing to know."""
    found: dict[str, Sampled] = {}
    used = set(when.columns)
    for topic, columns in STREAMS:
        names = [name for name, _ in columns]
        if not set(names) <= set(table.header) or set(names) <= used:
            continue
        used |= set(names)
        values = np.stack([table.numbers(name) for name in names], axis=1)
        kept = np.isfinite(values).any(axis=1)
        if topic == "/fix":  # the device writes zeros where it has no fix
            kept &= values[:, :2].any(axis=1)
        if not kept.any():
            continue
        channels = tuple(
            _channel(channel, values[kept, i]) for i, (_, channel) in enumerate(columns)
        )
        found[topic] = Sampled(topic + suffix, "", channels, when.times_ns[kept], values[kept])
    warnings += [f"{table.name}: {line}" for line in when.warnings]
    others = [name for name in table.header if name and name not in used]
    if others:
        warnings.append(f"{table.name}: left out: {', '.join(others)}")
    return list(found.values())


def _channel(channel: Channel, values: NDArray[np.float64]) -> Channel:
    """Return a channel; pressure is in Pa or, of an older device, in mbar: its size tells."""
    if channel.quantity != "pressure" or np.nanmedian(values) > 3000:
        return channel
    unit, factor = to_quantity("pressure", "mbar")
    return Channel(channel.name, channel.quantity, unit, scale=factor)
