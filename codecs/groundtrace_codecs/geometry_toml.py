"""The TOML of a geometry: units of length on the way in, text for people on the way out."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Any

import msgspec

from .errors import SchemaError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

#: The unit of places that nobody measured against a known length.
UNKNOWN_UNIT = "unknown"
#: Metres of each unit that places may be written in.
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
KEYS = ("unit", "outline", "start", "road", "sensor", "source", "medium")
#: Where numbers that are lengths in the unit of the file stand in a table.
PLACES = ("x", "y", "z")


def geometry_table(path: Path) -> dict[str, Any]:
    """Return the fields of a geometry as a TOML has them, lengths of a known unit in metres.

    The medium's values carry their own units and are not converted.

    Raises
    ------
    SchemaError
        Where the file is not TOML, has an unknown key, or a unit that is none of length.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SchemaError(f"{path.name}: expected TOML, found: {error}") from error
    unknown = sorted(set(table) - set(KEYS))
    if unknown:
        raise SchemaError(
            f"{path.name}: {unknown[0]}: expected one of {', '.join(KEYS)}, found an unknown key"
        )
    unit = table.pop("unit", "m")
    if unit != UNKNOWN_UNIT and unit not in METRES:
        raise SchemaError(
            f"{path.name}: unit: expected one of {', '.join(METRES)}, {UNKNOWN_UNIT}, "
            f"found {unit!r}"
        )
    metres = 1.0 if unit == UNKNOWN_UNIT else METRES[unit]
    return {
        "sensors": _scaled(table.pop("sensor", []), metres),
        "sources": _scaled(table.pop("source", []), metres),
        "unit": unit if unit == UNKNOWN_UNIT else "m",
        "medium": table.pop("medium", {}),
    } | {key: _scaled(value, metres) for key, value in table.items()}


def _scaled(value: Any, metres: float) -> Any:
    """Return a value with its lengths in metres; what is no length stays as it is."""
    if isinstance(value, dict):
        return {k: _scaled(v, metres) if k in PLACES else v for k, v in value.items()}
    if isinstance(value, list):
        return [_scaled(item, metres) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool) and metres != 1.0:
        return value * metres
    return value


def geometry_text(fields: Mapping[str, Any]) -> str:
    """Return a geometry, as its fields, as TOML; fields without a value are left out."""
    lines = [f"unit = {_toml(fields['unit'])}"]
    kept = [key for key in ("outline", "start", "road") if fields[key]]
    lines += [f"{key} = {_toml(fields[key])}" for key in kept]
    if fields["sources"]:
        lines.append(f"source = {_toml(fields['sources'])}")
    for sensor in fields["sensors"]:
        lines += ["", "[[sensor]]", *_pairs(sensor)]
    lines += ["", "[medium]", *_pairs(fields["medium"])]
    return "\n".join(lines) + "\n"


def _pairs(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {_toml(value)}" for key, value in table.items() if value is not None]


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    return repr(value)
