"""Layouts that the tests of the room analysis share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundtrace.layout.analysis import Layout, layout_of
from groundtrace_codecs.geometry import Geometry, Medium, Sensor

NINE = tuple((x, y) for y in (0.0, 5.0, 10.0) for x in (0.0, 5.0, 10.0))
SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))


def geometry(
    places: tuple[tuple[float, float], ...] = NINE,
    outline: tuple[tuple[float, float], ...] = SQUARE,
    theta_s: float | None = 5e-5,
) -> Geometry:
    sensors = tuple(Sensor(f"S{i + 1}", f"c{i}", x, y) for i, (x, y) in enumerate(places))
    return Geometry(sensors, outline, medium=Medium(theta_s=theta_s))


def layout(
    places: tuple[tuple[float, float], ...] = NINE, sigma_s: float = 5e-4, **medium: float
) -> Layout:
    found, _ = layout_of(geometry(places), "room.toml", sigma_s)
    return replace(found, **medium)


def at_1000_mps(places: np.ndarray) -> np.ndarray:
    """Arrivals at one velocity at nine sensors, as the thesis's section 5.3.2 has them."""
    apart = np.linalg.norm(np.asarray(places)[:, None] - np.array(NINE), axis=2)
    return np.asarray(apart / 1000.0)
