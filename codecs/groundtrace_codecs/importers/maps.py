"""Map TOML: what the columns of a table or archive mean, typed and checked when loaded."""

from __future__ import annotations

import datetime
import re
import tomllib
from typing import TYPE_CHECKING

import msgspec

from ..errors import SchemaError, did_you_mean
from ..labels import TRUTH_KINDS
from ..units import to_quantity
from .api import (
    ColumnMap,
    CounterMap,
    ImportMap,
    OrientationMap,
    StartMap,
    StreamMap,
    TimeMap,
    TruthMap,
)
from .moments import zone_of
from .time_map import check_time

if TYPE_CHECKING:
    from pathlib import Path


def load_map(path: Path) -> ImportMap:
    """Read and check a map TOML.

    Parameters
    ----------
    path
        The map.

    Raises
    ------
    SchemaError
        One line "FILE: KEY: expected X, found Y": unknown key, wrong type, unknown unit,
        quantity or kind, or a stream without time.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SchemaError(f"{path.name}: expected TOML, found: {error}") from error
    start = table.get("start")
    if isinstance(start, datetime.datetime | datetime.date):
        table["start"] = start.isoformat()
    try:
        map_ = msgspec.convert({**table, "file": path.name}, ImportMap)
    except msgspec.ValidationError as error:
        raise SchemaError(f"{path.name}: {_sentence(str(error))}") from error
    _check(map_)
    return map_


def _sentence(message: str) -> str:
    """Return msgspec's message as "KEY: expected X, found Y"."""
    what, _, where = message.partition(" - at `$")
    key = where.rstrip("`").removeprefix(".")
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", what):
        known = _TABLES.get(re.sub(r"\[\d*\]|\[\.\.\.\]", "", key))
        names = [] if known is None else [n for n in known.__struct_fields__ if n != "file"]
        return (
            f"{_join(key, unknown[1])}: expected a known key, found an unknown one"
            f"{did_you_mean(unknown[1], names)}"
        )
    if missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        return f"{_join(key, missing[1])}: expected a value, found none"
    if wrong := re.fullmatch(r"Expected `(.*)`, got `(.*)`", what):
        return f"{key}: expected {wrong[1]}, found {wrong[2]}"
    if value := re.fullmatch(r"Invalid enum value '?(.*?)'?", what):
        said, choices = _CHOICES.get(key.rpartition(".")[2], ("another value", ()))
        return f"{key}: expected {said}, found {value[1]!r}{did_you_mean(value[1], choices)}"
    return f"{key or 'map'}: expected a map, found: {what}"


#: What a map's tables are, by their place without indices.
_TABLES: dict[str, type[msgspec.Struct]] = {
    "": ImportMap,
    "stream": StreamMap,
    "stream.columns": ColumnMap,
    "truth": TruthMap,
    "orientation": OrientationMap,
    "start": StartMap,
    **dict.fromkeys(("time", "stream.time"), TimeMap),
    **dict.fromkeys(("counter", "stream.counter"), CounterMap),
}
#: What a key may be, in words and as a list.
_CHOICES: dict[str, tuple[str, tuple[str, ...]]] = {
    "axis": (
        "x, y, z or w of the sensor, or e, n or u (east, north, up)",
        ("x", "y", "z", "w", "east", "north", "up"),
    ),
    "decimal": ("'.' or ','", ()),
    "files": ("events or continuous", ("events", "continuous")),
    "missing": ("ignore or error", ("ignore", "error")),
    "scale": ("utc, gps or tai", ("utc", "gps", "tai")),
    "unit": (
        "s, ms, us, ns, iso (times of samples) or sample (times of events)",
        ("s", "ms", "us", "ns", "iso", "sample"),
    ),
}


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _check(map_: ImportMap) -> None:
    """Refuse what types cannot: units, quantities, kinds, rates, and streams without time."""
    if not map_.stream:
        raise SchemaError(f"{map_.file}: stream: expected at least one, found none")
    if map_.delimiter is not None and len(map_.delimiter) != 1:
        raise SchemaError(
            f"{map_.file}: delimiter: expected one character, found {map_.delimiter!r}"
        )
    if map_.skip_rows < 0:
        raise SchemaError(f"{map_.file}: skip_rows: expected 0 or more, found {map_.skip_rows}")
    if map_.zone:
        zone_of(map_.zone, f"{map_.file}: zone")
    topics = [s.topic for s in map_.stream]
    for i, stream in enumerate(map_.stream):
        place = f"{map_.file}: stream[{i}]"
        if not stream.topic.startswith("/") or topics.count(stream.topic) > 1:
            raise SchemaError(
                f"{place}.topic: expected a name of its own that starts with /, "
                f"found {stream.topic!r}"
            )
        _check_stream(map_, stream, place)
    for i, truth in enumerate(map_.truth):
        _check_truth(truth, f"{map_.file}: truth[{i}]")


def _check_stream(map_: ImportMap, stream: StreamMap, place: str) -> None:
    if not stream.columns:
        raise SchemaError(f"{place}.columns: expected at least one, found none")
    for j, column in enumerate(stream.columns):
        try:
            to_quantity(column.quantity, column.unit)
        except SchemaError as error:
            raise SchemaError(f"{place}.columns[{j}].{error}") from error
    check_time(map_, stream, place)


def _check_truth(truth: TruthMap, place: str) -> None:
    if truth.kind not in TRUTH_KINDS:
        raise SchemaError(
            f"{place}.kind: expected one of {', '.join(sorted(TRUTH_KINDS))}, found {truth.kind!r}"
            f"{did_you_mean(truth.kind, TRUTH_KINDS)}"
        )
    origins = (truth.time, truth.increments_of, truth.total_of)
    if sum(o is not None for o in origins) != 1:
        raise SchemaError(
            f"{place}: expected one of time, increments_of and total_of, "
            f"found {sum(o is not None for o in origins)}"
        )
    if truth.total_of is not None and truth.kind != "count":
        raise SchemaError(f"{place}.kind: expected count with total_of, found {truth.kind!r}")
    if truth.kind in ("walking", "ignore") and truth.end is None:
        raise SchemaError(f"{place}.end: expected a path, as {truth.kind} is a span, found none")
