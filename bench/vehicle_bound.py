"""The Cramer-Rao bound of a straight course under fading, for the vehicles of vehicle_accuracy.py.

Fading makes a power an exponential deviate about its mean, another at each sensor and anew after
each coherence length: its logarithm scatters by 5.57 dB, and one such deviate tells ln P with
variance 1. A power that correlates with itself by exp(-d^2 / D^2) over the way d, as of paths whose
amplitude does so by exp(-d^2 / 2 D^2), has one independent deviate in sqrt(pi) D. So the
information on (place, velocity, ln mu) is the sum over sensors of the integral of the outer product
of the slopes of ln P over the way, divided by sqrt(pi) D, noise lowering the slopes.
"""

from __future__ import annotations

import argparse

import numpy as np

from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace.vehicles.medium import ranges

NEAR_M, REACH_M, EXPONENT, CELL_M = 45.0, 150.0, 1.5, 0.25
#: Power of the noise over that of a vehicle at 10 m.
NOISE = 0.01
MIDDLE = np.array([15.0, 15.0])


def information(
    sensors: np.ndarray, heading: np.ndarray, offset_m: float, coherence_m: float
) -> np.ndarray:
    """Return the information on (across, along, turn, stretch, ln mu), shape (5, 5).

    Turn is the way across for each metre along, stretch the relative error of the speed.
    """
    way = np.arange(-REACH_M, REACH_M, CELL_M)
    across = np.array([-heading[1], heading[0]])
    places = MIDDLE + offset_m * across + way[:, None] * heading
    r = ranges(places, sensors)
    power = r**-EXPONENT
    share = power / (power + NOISE * 10.0**-EXPONENT)
    off = places[:, None] - sensors
    slope = -EXPONENT * share[..., None] / r[..., None] ** 2 * off
    aside, ahead = slope @ across, slope @ heading
    lever = way[:, None]
    rows = np.stack([aside, ahead, aside * lever, ahead * lever, share], axis=-1).reshape(-1, 5)
    fisher: np.ndarray = rows.T @ rows * CELL_M / (np.sqrt(np.pi) * coherence_m)
    return fisher


def bound(count: int, coherence_m: float, draws: int = 200) -> tuple[float, float]:
    """Return the median and 90 % of the mean error across [m] that the bound allows."""
    rng, drawn = np.random.default_rng(5), np.random.default_rng(0)
    sensors = simulate_vehicle(VehicleOptions(spacing_m=15)).geometry.stations().places
    errors = []
    for _ in range(count):
        rng.uniform(3, 15)
        offset, angle = rng.uniform(-15, 15), np.deg2rad(rng.uniform(0, 360))
        heading = np.array([np.cos(angle), np.sin(angle)])
        spread = np.linalg.inv(information(sensors, heading, offset, coherence_m))
        half = np.sqrt(NEAR_M**2 - offset**2)
        way = np.linspace(-half, half, 50)
        off = drawn.multivariate_normal(np.zeros(5), spread, draws)
        errors.append(np.abs(off[:, :1] + off[:, 2:3] * way).mean(axis=1))
    median, most = np.percentile(np.concatenate(errors), [50, 90])
    return float(median), float(most)


def main() -> None:
    """Print the bound for some coherence lengths."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=50)
    given = parser.parse_args()
    for coherence_m in (0.25, 0.5, 1.0, 1.5, 2.0, 4.0):
        median, most = bound(given.vehicles, coherence_m)
        print(f"coherence {coherence_m:4.2f} m: at best {median:.2f} m, 90 % {most:.2f} m")


if __name__ == "__main__":
    main()
