"""Lengths where the unit is unknown: what stages have in metres is brought to the site's size.

Nothing tells how many metres an unknown unit has. The simplest sound rule: lengths that were chosen
for a room of common size keep their proportion to the room, by the sensors' spread.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from groundtrace_codecs.geometry_toml import UNKNOWN_UNIT

from .parameters import describe

if TYPE_CHECKING:
    from groundtrace_codecs.events import StageSpec
    from groundtrace_codecs.geometry import Geometry

    P = TypeVar("P")

#: Root mean square distance of nine sensors in a room of 5.4 m x 5.4 m from their middle [m].
COMMON_RADIUS_M = 3.118
#: Power of length in the units of parameters that have one.
POWERS = {"m": 1, "m^2": 2, "m/s": 1, "m/s^2": 1}


def units_per_metre(geometry: Geometry | None) -> float:
    """Return how many of a site's units count as a metre: 1 where its unit is known."""
    if geometry is None or geometry.unit != UNKNOWN_UNIT or not geometry.sensors:
        return 1.0
    places = np.array([(s.x, s.y) for s in geometry.sensors], np.float64)
    radius = float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))
    return radius / COMMON_RADIUS_M if radius > 0 else 1.0


def scaled_lengths(parameters: P, geometry: Geometry | None) -> P:
    """Return a stage's parameters with the lengths among them in the site's units."""
    factor = units_per_metre(geometry)
    if factor == 1.0:
        return parameters
    given: Any = parameters
    lengths = {
        info.name: getattr(given, info.name) * factor ** POWERS[info.unit]
        for info in describe(type(given))
        if info.unit in POWERS
    }
    changed: P = replace(given, **lengths)
    return changed


def length_note(geometry: Geometry | None) -> str:
    """Return what a person must know of the lengths; an empty text where the unit is known."""
    factor = units_per_metre(geometry)
    if geometry is None or geometry.unit != UNKNOWN_UNIT:
        return ""
    return (
        f"the unit of length is unknown: places are in units; lengths of stages in m are taken "
        f"times {factor:.3g}, by the sensors' spread"
    )


def in_length_unit(spec: StageSpec, geometry: Geometry | None) -> StageSpec:
    """Return what a stage's columns and gates mean, metres being the site's units."""
    if geometry is None or geometry.unit != UNKNOWN_UNIT:
        return spec
    unit = geometry.length_unit
    return replace(
        spec,
        columns=tuple(replace(c, unit=unit) if c.unit == "m" else c for c in spec.columns),
        gates=tuple(replace(g, unit=unit) if g.unit == "m" else g for g in spec.gates),
    )
