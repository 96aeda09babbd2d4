"""Geometry of a site: outline, sensors, medium. TOML for people, JSON inside a recording."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from .errors import SchemaError

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor at a place.

    Attributes
    ----------
    name
        Shown to people.
    channel
        Channel of the recording it feeds.
    x, y, z
        Position [m].
    axis
        Direction of sensitivity: ``x``, ``y`` or ``z``.
    """

    name: str
    channel: str
    x: float
    y: float
    z: float = 0.0
    axis: str = "z"


@dataclass(frozen=True, slots=True)
class Medium:
    """What the waves run through; unknown values are None.

    Attributes
    ----------
    thickness_m
        Of the floor [m].
    velocity_mps
        Calibrated propagation velocity [m/s].
    theta_s
        Time scale of the perceived velocity law [s].
    """

    thickness_m: float | None = None
    velocity_mps: float | None = None
    theta_s: float | None = None


@dataclass(frozen=True, slots=True)
class Geometry:
    """A site: metres, right-handed, z up.

    Attributes
    ----------
    sensors
        In the order of the file.
    outline
        Corners of the room or site [m].
    start
        Where a walk starts [m], or None.
    sources
        Named places of controlled impacts [m], e.g. shot points.
    medium
        What the waves run through.
    """

    sensors: tuple[Sensor, ...] = ()
    outline: tuple[tuple[float, float], ...] = ()
    start: tuple[float, float] | None = None
    sources: tuple[tuple[str, float, float], ...] = ()
    medium: Medium = Medium()

    def to_json(self) -> bytes:
        """Return the geometry as the JSON of a recording's ``site.json``."""
        return msgspec.json.encode(self)

    @classmethod
    def from_json(cls, data: bytes, place: str = "site.json") -> Geometry:
        """Read a recording's ``site.json``.

        Raises
        ------
        SchemaError
            Where the JSON is not a geometry; names ``place``.
        """
        try:
            return msgspec.json.decode(data, type=cls)
        except msgspec.DecodeError as error:
            raise SchemaError(f"{place}: expected a geometry, found: {error}") from error

    @classmethod
    def from_toml(cls, path: Path) -> Geometry:
        """Read a geometry TOML: ``unit``, ``outline``, ``start``, ``[[sensor]]``, ``[medium]``.

        Raises
        ------
        SchemaError
            Where the file is not TOML, has an unknown key, a wrong type, or a unit other than m.
        """
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SchemaError(f"{path.name}: expected TOML, found: {error}") from error
        unit = table.pop("unit", "m")
        if unit != "m":
            raise SchemaError(f"{path.name}: unit: expected 'm', found {unit!r}")
        table["sensors"] = table.pop("sensor", [])
        table["sources"] = table.pop("source", [])
        unknown = sorted(set(table) - {"sensors", "sources", "outline", "start", "medium"})
        if unknown:
            raise SchemaError(
                f"{path.name}: {unknown[0]}: expected one of unit, outline, start, sensor, source, "
                f"medium, found an unknown key"
            )
        try:
            return msgspec.convert(table, cls)
        except msgspec.ValidationError as error:
            raise SchemaError(f"{path.name}: expected a geometry, found: {error}") from error
