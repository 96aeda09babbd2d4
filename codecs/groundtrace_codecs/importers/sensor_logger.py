"""Tables of the app Sensor Logger, one per sensor.

Columns are ``time`` (unix time, ns), ``seconds_elapsed`` and the sensor's, whose axes stand in the
order z, y, x. Units and signs are those its UNITS and COORDINATES pages give: Android's, except
that an iPhone without "Standardise Units & Frames" gives every acceleration with the opposite
sign, and that of the uncalibrated accelerometer in g.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..labels import Label
from .phone_app import PLACEMENT, TOPICS, Found, Wanted, sampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .phone_app import AppFile
    from .sampled import Sampled

#: Tables of each stream that is one sensor, best first, with what their columns are.
_AXES = {
    "angular_velocity": (("Gyroscope", "GyroscopeUncalibrated"), "rad/s"),
    "magnetic_field": (("Magnetometer", "MagnetometerUncalibrated"), "uT"),
}
_FIX = (
    Wanted("latitude", "latitude", "deg"),
    Wanted("longitude", "longitude", "deg"),
    Wanted("altitude", "altitude", "m"),
)
_ACC = TOPICS["acceleration"]
_SUM = ("Accelerometer", "Gravity")
#: Tables with samples that are read, whole or as the second best.
_SENSORS = frozenset(
    {
        *(name for names, _ in _AXES.values() for name in names),
        *_SUM,
        "TotalAcceleration",
        "AccelerometerUncalibrated",
        "Barometer",
        "Location",
    }
)


def is_table(file: AppFile) -> bool:
    """Return whether a file is the table of a sensor."""
    return {"time", "seconds_elapsed"} <= set(file.header)


def is_metadata(file: AppFile) -> bool:
    """Return whether a file says which phone and settings the others are of."""
    return {"platform", "appVersion"} <= set(file.header)


def read(files: Sequence[AppFile]) -> Found:
    """Return the streams and annotations of the tables of one recording.

    Raises
    ------
    SchemaError
        Where a table does not hold what it should.
    """
    tables = {f.stem: f for f in files if is_table(f)}
    sign, warnings = _sign([f for f in files if is_metadata(f)])
    found = [_single(tables, q, *_AXES[q]) for q in _AXES]
    found.append(_columns(tables, "Barometer", (Wanted("pressure", "pressure", "mbar"),)))
    found.append(_columns(tables, "Location", _FIX))
    acceleration, remarks = _acceleration(tables, sign)
    others = sorted(tables.keys() - _SENSORS - {"Annotation"})
    if others:
        remarks += (f"left alone: {', '.join(others)}",)
    return Found(
        tuple(s for s in (acceleration, *found) if s is not None),
        _notes(tables.get("Annotation")),
        (*warnings, *remarks),
    )


def _sign(metadata: Sequence[AppFile]) -> tuple[float, tuple[str, ...]]:
    """Return what takes an acceleration to Android's sign, -1 also for g, and a remark."""
    rows = [row for file in metadata for row in file.records()]
    if not rows:
        return 1.0, ("no Metadata.csv: units and signs are taken as an Android phone gives them",)
    ios = rows[0].get("platform", "").strip().lower() == "ios"
    standard = rows[0].get("standardisation", "").strip().lower() == "true"
    if not ios or standard:
        return 1.0, ()
    return -1.0, ("iOS without Standardise Units & Frames: accelerations are turned round",)


def _axes(quantity: str, unit: str) -> tuple[Wanted, ...]:
    return tuple(Wanted(axis, quantity, unit, axis) for axis in ("x", "y", "z"))


def _columns(
    tables: dict[str, AppFile], name: str, columns: tuple[Wanted, ...], part: str = ""
) -> Sampled | None:
    """Return the samples of one table, None where there is none with those columns."""
    file = tables.get(name)
    if file is None or not all(c.column in file.header for c in columns):
        return None
    topic = f"{TOPICS[columns[0].quantity]}{part}/{PLACEMENT}"
    return sampled(file, topic, columns, "time", "ns")


def _single(
    tables: dict[str, AppFile], quantity: str, names: tuple[str, ...], unit: str
) -> Sampled | None:
    read_ = (_columns(tables, name, _axes(quantity, unit)) for name in names)
    return next((s for s in read_ if s is not None), None)


def _acceleration(
    tables: dict[str, AppFile], sign: float
) -> tuple[Sampled | None, tuple[str, ...]]:
    """Return the acceleration with gravity, as an accelerometer measures it, and remarks."""
    axes = _axes("acceleration", "m/s2")
    total = _columns(tables, "TotalAcceleration", axes)
    if total is not None:
        return _turned(total, sign), ()
    linear, gravity = (_columns(tables, name, axes) for name in _SUM)
    if (
        linear is not None
        and gravity is not None
        and np.array_equal(linear.times_ns, gravity.times_ns)
    ):
        summed = replace(linear, values=linear.values + gravity.values)
        return _turned(summed, sign), ("acceleration is Accelerometer.csv plus Gravity.csv",)
    raw = _columns(
        tables, "AccelerometerUncalibrated", _axes("acceleration", "g" if sign < 0 else "m/s2")
    )
    if raw is not None:
        return _turned(raw, sign), ("acceleration is AccelerometerUncalibrated.csv",)
    if linear is None:
        return None, ()
    bare = replace(linear, topic=f"{_ACC}_linear/{PLACEMENT}")
    return _turned(bare, sign), ("Accelerometer.csv is without gravity, and nothing else has it",)


def _turned(found: Sampled, sign: float) -> Sampled:
    return replace(found, values=found.values * sign)


def _notes(file: AppFile | None) -> tuple[Label, ...]:
    """Return what the user wrote while recording; a row without a time is left out."""
    rows = [] if file is None else file.records()
    return tuple(
        Label(int(row["time"]), "note", note=row.get("text", "").strip(), author="Sensor Logger")
        for row in rows
        if re.fullmatch(r"\d{1,18}|[1-8]\d{18}", row.get("time", ""), re.ASCII)
    )
