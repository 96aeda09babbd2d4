"""Crossing bearings: norms of (A.10), as printed and each distance over its own error.

Four stations at the corners of a room, or in a row along one wall, 10 m x 10 m; 2000 random places;
bearings with the errors that they claim, at every station another, and a tenth of them wild.
Beside them the simplest rival: the middle of the room. Errors are in metres; 68 % and 90 % are the
parts of places inside the claimed regions.
"""

from __future__ import annotations

import argparse
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from groundtrace.localizers.bearings import intersect

if TYPE_CHECKING:
    from groundtrace.localizers.bearings import Norm, Weights

LAYOUTS = {
    "corners": np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]),
    "in a row": np.array([(0.5, 0.0), (3.5, 0.0), (6.5, 0.0), (9.5, 0.0)]),
}
NORMS: tuple[Norm, ...] = ("l1", "l2")
WEIGHTS: tuple[Weights, ...] = ("errors", "none")


def drawn(
    places: np.ndarray,
    stations: np.ndarray,
    sigma_rad: float,
    wild: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings and what they claim, shapes (n, n_stations)."""
    away = places[:, None] - stations
    claimed = sigma_rad * np.exp(rng.normal(0, 0.5, away.shape[:2]))
    azimuths = np.arctan2(away[..., 1], away[..., 0]) + claimed * rng.standard_normal(claimed.shape)
    lost = rng.random(azimuths.shape) < wild
    return np.where(lost, rng.uniform(-np.pi, np.pi, azimuths.shape), azimuths), claimed


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    count = parser.parse_args().count
    limits = stats.chi2.ppf([0.68, 0.90], 2)
    print(f"{'':36} {'median':>7} {'95 %':>7} {'68 %':>6} {'90 %':>6}")
    for layout, sigma_deg, wild in product(LAYOUTS, (2.0, 6.0), (0.0, 0.1)):
        rng, stations = np.random.default_rng(1), LAYOUTS[layout]
        places = rng.uniform(0.5, 9.5, (count, 2))
        azimuths, claimed = drawn(places, stations, np.deg2rad(sigma_deg), wild, rng)
        print(f"{layout}, {sigma_deg:g} deg, {wild:.0%} wild")
        for norm, weights in product(NORMS, WEIGHTS):
            off, inside = [], []
            for position, a, s in zip(places, azimuths, claimed, strict=True):
                fix = intersect(stations, a, s, norm, weights)
                if fix.located:
                    miss = np.array([fix.x, fix.y]) - position
                    off.append(np.hypot(*miss))
                    inside.append(miss @ np.linalg.solve(fix.covariance, miss) <= limits)
            part = np.mean(inside, axis=0)
            name = f"  {norm}, {'own errors' if weights == 'errors' else 'as printed'}"
            middle, most = np.median(off), np.percentile(off, 95)
            print(f"{name:36} {middle:7.2f} {most:7.2f} {part[0]:6.0%} {part[1]:6.0%}")
        rival = np.hypot(*(places - 5.0).T)
        print(
            f"{'  middle of the room':36} {np.median(rival):7.2f} {np.percentile(rival, 95):7.2f}"
        )


if __name__ == "__main__":
    main()
