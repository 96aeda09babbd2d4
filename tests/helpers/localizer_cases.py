"""Arrivals at nine sensors by the law (4.24), as the tests of the localisers share them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers.tdoa import calibrated_velocity
from groundtrace.localizers.wave_physics import arrivals

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.pipeline.stage import LocationEstimate

SENSORS = np.array([(x, y) for y in (0.0, 5.0, 10.0) for x in (0.0, 5.0, 10.0)])
ROOM = np.array([(0.0, 0.0), (10, 0), (10, 10), (0, 10)])
SOURCE = np.array([[1.0, 3.0]])
THETA_S = 1e-5


def times_of(sources: np.ndarray, theta_s: float = THETA_S) -> np.ndarray:
    """Shape (m, 9) [s]."""
    return arrivals(np.linalg.norm(sources[:, None] - SENSORS, axis=2), theta_s)


def velocity(sources: np.ndarray, theta_s: float = THETA_S) -> float:
    return calibrated_velocity(sources, SENSORS, times_of(sources, theta_s))


def uniform(runs: int, sigma_s: float, late: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Sources in the room, and their arrivals with errors; a part of them late."""
    rng = np.random.default_rng(5)
    sources = rng.uniform(0, 10, (runs, 2))
    times = times_of(sources) + rng.normal(0, sigma_s, (runs, 9))
    delayed = rng.random((runs, 9)) < late
    return sources, times + delayed * rng.exponential(5e-3, (runs, 9))


def repeated(theta_s: float, sigma_s: float, runs: int = 500) -> np.ndarray:
    """The same source again and again, shape (runs, 9)."""
    rng = np.random.default_rng(11)
    return times_of(SOURCE, theta_s) + rng.normal(0, sigma_s, (runs, 9))


def distances_off(
    locate: Callable[[np.ndarray], LocationEstimate], times: np.ndarray, sources: np.ndarray
) -> np.ndarray:
    found = [locate(row) for row in times]
    return np.hypot(*(np.array([(p.x, p.y) for p in found]) - sources).T)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
