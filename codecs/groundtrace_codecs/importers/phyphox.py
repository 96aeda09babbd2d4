"""Tables of the app phyphox: one per sensor, or one in all.

The first column is ``Time (s)``, since the experiment began; the others say their unit. Separator
and decimal sign are the user's choice, the words those of the phone's language, so that a column
is known by its unit. ``meta/time.csv`` says when on the calendar the experiment ran and paused: the
time of the experiment stands still in a pause.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ..errors import SchemaError
from ..signals import NS_PER_S
from .phone_app import PLACEMENT, TOPICS, Found, Wanted, sampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .phone_app import AppFile
    from .sampled import Sampled

_TIME = re.compile(r"(?i)(time|t|zeit|temps|tempo|tiempo)\s*\(s\)")
_COLUMN = re.compile(r"(?P<words>.*?)\s*\b(?P<axis>[xyzXYZ])?\s*\((?P<unit>[^()]+)\)")
#: Unit to what is measured in it and what we call it.
_UNITS = {
    "m/s^2": ("acceleration", "m/s2"),
    "m/s²": ("acceleration", "m/s2"),
    "rad/s": ("angular_velocity", "rad/s"),
    "µT": ("magnetic_field", "uT"),
    "μT": ("magnetic_field", "uT"),
    "hPa": ("pressure", "hPa"),
    "°C": ("temperature", "degC"),
}
_AXIS: dict[str, Literal["x", "y", "z", ""]] = {"x": "x", "y": "y", "z": "z", "": ""}
_VECTORS = frozenset({"acceleration", "angular_velocity", "magnetic_field"})
_LINEAR = re.compile(r"(?i)linear|without g|ohne g")
_FIX = ("latitude", "longitude", "altitude")


class Piece(NamedTuple):
    """The experiment ran from one of its times [ns] on; what to add for unix time [ns]."""

    start_ns: int
    offset_ns: int


def is_table(file: AppFile) -> bool:
    """Return whether a file is a table of samples."""
    return bool(file.header) and bool(_TIME.fullmatch(file.header[0])) and bool(_groups(file))


def is_clock(file: AppFile) -> bool:
    """Return whether a file says when the experiment ran."""
    return {"event", "experiment time", "system time"} <= set(file.header)


def read(files: Sequence[AppFile]) -> Found:
    """Return the streams of the tables of one experiment.

    Raises
    ------
    SchemaError
        Where a table does not hold what it should, or two hold the same.
    """
    pieces = [p for file in files if is_clock(file) for p in _pieces(file)]
    found: dict[str, Sampled] = {}
    for file in (f for f in files if is_table(f)):
        for topic, columns in _groups(file).items():
            read_ = sampled(file, topic, columns, file.header[0], "s")
            if read_ is None:
                continue
            if topic in found:
                raise SchemaError(f"{file.name}: {topic}: expected one table of it, found two")
            found[topic] = _on_calendar(read_, pieces)
    warnings = [] if pieces else ["no meta/time.csv: times count from the start of the experiment"]
    if f"/acc_linear/{PLACEMENT}" in found and f"/acc/{PLACEMENT}" not in found:
        warnings.append("the acceleration is without gravity, and nothing else has it")
    return Found(tuple(found.values()), (), tuple(warnings))


def _groups(file: AppFile) -> dict[str, tuple[Wanted, ...]]:
    """Return the columns of each stream of a table, by topic."""
    groups: dict[str, list[Wanted]] = {}
    for cell in file.header[1:]:
        match = _COLUMN.fullmatch(cell)
        if match is None:
            continue
        place = _place(cell, match["words"])
        if place is not None:
            groups.setdefault(f"/fix/{PLACEMENT}", []).append(place)
            continue
        quantity, unit = _UNITS.get(match["unit"], ("", ""))
        axis = _AXIS[(match["axis"] or "").lower()] if quantity in _VECTORS else ""
        if not quantity or (quantity in _VECTORS and not axis):
            continue
        part = "_linear" if quantity == "acceleration" and _LINEAR.search(cell + file.name) else ""
        topic = f"{TOPICS[quantity]}{part}/{PLACEMENT}"
        groups.setdefault(topic, []).append(Wanted(cell, quantity, unit, axis))
    return {t: tuple(c) for t, c in groups.items() if _whole(c)}


def _place(cell: str, words: str) -> Wanted | None:
    """Return a column of a place on the globe."""
    word = words.strip().lower()
    if word == "height":
        word = "altitude"
    if word not in _FIX:
        return None
    return Wanted(cell, word, "m" if word == "altitude" else "deg")


def _whole(columns: list[Wanted]) -> bool:
    """Return whether each axis is there once; places need all three numbers."""
    have = [c.axis or c.quantity for c in columns]
    if columns[0].quantity in _FIX:
        return sorted(have) == sorted(_FIX)
    return len(set(have)) == len(have)


def _pieces(file: AppFile) -> list[Piece]:
    """Return the pieces of a clock; a row without numbers is no piece."""
    pieces = []
    for row in file.records():
        if row.get("event", "").strip().upper() != "START":
            continue
        try:
            experiment, system = (
                float(row[key].replace(",", ".")) for key in ("experiment time", "system time")
            )
        except (KeyError, ValueError) as error:
            raise SchemaError(f"{file.name}: START: expected two times, found {row}") from error
        if not (0 <= system < 9e9 and abs(experiment) < 9e9):
            raise SchemaError(f"{file.name}: START: expected unix seconds, found {system}")
        start_ns = round(experiment * NS_PER_S)
        # seconds since 1970 with three decimals: the float keeps them, its last digits do not
        pieces.append(Piece(start_ns, round(system * 1000) * 1_000_000 - start_ns))
    return sorted(pieces)


def _on_calendar(found: Sampled, pieces: Sequence[Piece]) -> Sampled:
    """Return the samples at their times on the calendar, a pause being a gap."""
    if not pieces:
        return found
    starts: NDArray[np.int64] = np.array([p.start_ns for p in pieces], np.int64)
    offsets: NDArray[np.int64] = np.array([p.offset_ns for p in pieces], np.int64)
    which = np.maximum(np.searchsorted(starts, found.times_ns, side="right") - 1, 0)
    return replace(found, times_ns=found.times_ns + offsets[which])
