"""Powers of vehicles by the law, with gamma distributed fluctuation: no waveforms."""

from __future__ import annotations

import numpy as np

from groundtrace.vehicles.courses import Observed
from groundtrace.vehicles.medium import PowerLaw, ranges

LAW = PowerLaw(1.0, 1.5)
#: Two antennas of three sensors [m].
ANTENNAS = np.array([(0, 0), (15, 0), (30, 0), (0, 30), (15, 30), (30, 30)], float)
MU, FLOOR = 500.0, 0.2
#: Degrees of freedom of a power: its standard deviation is a third of it.
FREEDOM = 18


def fluctuating(mean: np.ndarray, rng: np.random.Generator, freedom: float = FREEDOM) -> np.ndarray:
    return mean * rng.gamma(freedom / 2, 2 / freedom, mean.shape)


def observed(
    places: np.ndarray,
    times_s: np.ndarray,
    rng: np.random.Generator,
    freedom: float = FREEDOM,
    sensors: np.ndarray = ANTENNAS,
) -> Observed:
    """Powers of a vehicle at places of the middles of cycles, as if it jumped there."""
    mean = MU * ranges(places, sensors) ** -1.5 + FLOOR
    floors = np.full(mean.shape, FLOOR)
    return Observed(times_s, fluctuating(mean, rng, freedom), floors, sensors, LAW)


def straight(
    times_s: np.ndarray, place: tuple[float, float], velocity: tuple[float, float]
) -> np.ndarray:
    """Places of a straight course that is at a place in the middle of the time, shape (c, 2)."""
    return np.array(place) + np.array(velocity) * (times_s - times_s.mean())[:, None]
