"""Wrong signs and error maps of nine sensors on 10 m x 10 m, beside the known numbers.

The thesis's sections 5.3.2 (wrong signs, at 1000 m/s) and 5.2 (errors over the room, law (4.24)).
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from groundtrace.layout.analysis import (
    Layout,
    drawn_wrong,
    error_map,
    grid_of,
    mean_wrong,
    poisson_binomial,
)
from groundtrace.localizers import arrival_order
from groundtrace.localizers.arrival_order import chance_wrong, pairs
from groundtrace.localizers.tdoa import distances

SENSORS = np.array([(x, y) for y in (0.0, 5.0, 10.0) for x in (0.0, 5.0, 10.0)])
ROOM = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)])
VELOCITY_MPS = 1000.0
#: Source, sigma [s]: lambda, and mean and variance of independent and of physical errors.
KNOWN_SIGNS = {
    ((1.0, 3.0), 5e-4): (0.515, 0.512, 0.41, 0.863, 0.66),
    ((1.0, 3.0), 1e-3): (1.467, 1.480, 1.15, 2.421, 1.98),
    ((0.5, 1.0), 5e-4): (0.821, 0.853, 0.67, 1.291, 1.08),
    ((0.5, 1.0), 1e-3): (1.865, 1.876, 1.34, 2.540, 2.17),
    ((4.5, 4.8), 5e-4): (1.921, 1.941, 1.51, 2.860, 2.46),
    ((4.5, 4.8), 1e-3): (4.055, 4.025, 2.91, 5.535, 5.77),
}
#: Sigma of a difference [s]: mean and maximum of lambda over the room.
KNOWN_MAPS = {1e-3: (2.32, 6.31), np.sqrt(2) * 1e-3: (3.24, 7.15)}
#: Sigma [s]: mean RMSE, 95th percentile, maximum [m], and share below 1 m.
KNOWN_ERRORS = {
    2e-4: ("0.58-0.60", "1.14", "1.67-1.70", "91-92 %"),
    5e-4: ("0.69-0.70", "1.19", "1.61-1.65", "87-90 %"),
    1e-3: ("0.93-0.94", "1.36", "1.63", "72-75 %"),
}
KNOWN_CORRUPTION = {
    (1.0, 2.0): (1, 0.97, 0.92, 0.87, 0.78, 0.73, 0.62, 0.50, 0.43, 0.37, 0.29),
    (4.5, 4.8): (1, 0.92, 0.85, 0.76, 0.62, 0.55, 0.48, 0.39, 0.27, 0.20, 0.11),
}


def layout(sigma_s: float, theta_s: float = 5e-5) -> Layout:
    names = tuple(f"S{i + 1}" for i in range(9))
    return Layout("nine", names, tuple(range(9)), SENSORS, ROOM, theta_s, None, sigma_s)


def constant(places: np.ndarray) -> np.ndarray:
    """Arrivals at one velocity, shape (m, 9) [s]."""
    return distances(places, SENSORS) / VELOCITY_MPS


def wrong_signs(draws: int) -> None:
    """Print how many signs are wrong at known places, beside the Poisson-binomial law."""
    print(f"wrong signs of 36 at 1000 m/s, {draws} draws: found (known)")
    print("source       sigma   lambda         variance     physical mean  variance")
    for (source, sigma), reference in KNOWN_SIGNS.items():
        times = constant(np.array([source]))[0]
        chances = chance_wrong(times, *pairs(9), sigma)
        law = poisson_binomial(chances)
        count = np.arange(len(law))
        mean = float(law @ count)
        variance = float(law @ (count - mean) ** 2)
        drawn = drawn_wrong(times, sigma, draws, 0)
        print(
            f"{source!s:12} {sigma * 1e3:.1f} ms  {mean:.3f} ({reference[0]:.3f})  "
            f"{variance:.2f} ({reference[2]:.2f})  {drawn.mean():.3f} ({reference[3]:.3f})  "
            f"{drawn.var():.2f} ({reference[4]:.2f})"
        )


def sign_maps(lattice: int) -> None:
    """Print the mean number of wrong signs over the room."""
    print(f"lambda over the room, {lattice} x {lattice} cells")
    nodes = grid_of(layout(1e-3).room, lattice).nodes
    for sigma, (mean, most) in KNOWN_MAPS.items():
        wrong_counts = mean_wrong(constant(nodes), float(sigma))
        x, y = nodes[wrong_counts.argmax()]
        print(
            f"differences err by {sigma * 1e3:.2f} ms: mean {wrong_counts.mean():.2f} ({mean}), "
            f"max {wrong_counts.max():.2f} ({most}) at ({x:.1f}, {y:.1f})"
        )


def corruption(draws: int, rng: np.random.Generator) -> None:
    """Print how often the true region survives a number of wrong signs."""
    print(f"wrong signs at random, {draws} draws: chance that the one best region is the true one")
    regions = arrival_order.known_regions(SENSORS, ROOM)
    compared = np.ones(36, bool)
    for source, reference in KNOWN_CORRUPTION.items():
        signs, _ = arrival_order.measured_signs(regions, distances(np.array([source]), SENSORS)[0])
        true = int(arrival_order.distances(regions, signs, compared).argmin())
        cells = []
        for k, expected in enumerate(reference):
            flips = np.argsort(rng.random((draws, 36)), axis=1) < k
            wrong = arrival_order.distances(regions, np.where(flips, -signs, signs), compared)
            best = wrong == wrong.min(axis=1, keepdims=True)
            share = np.mean(best[:, true] & (best.sum(axis=1) == 1))
            cells.append(f"{k}: {share:.2f} ({expected})")
        print(f"{source}  " + "  ".join(cells))


def error_maps(lattice: int, draws: int) -> None:
    """Print the error of SO-TDOA over the room."""
    print(f"SO-TDOA, theta 5e-5 s, {lattice} x {lattice} cells, {draws} draws: found (known)")
    nodes = grid_of(layout(1e-3).room, lattice).nodes
    for sigma, reference in KNOWN_ERRORS.items():
        began = time.perf_counter()
        rmse = error_map(layout(sigma), "so-tdoa", nodes, draws, 0).rmse_m
        taken = time.perf_counter() - began
        worst = nodes[np.argsort(rmse)[-8:]]
        distinct = sorted({(round(x), round(y)) for x, y in worst / 2.5})
        places = ", ".join(f"({2.5 * x:.1f}, {2.5 * y:.1f})" for x, y in distinct)
        print(
            f"{sigma * 1e3:.1f} ms  mean {rmse.mean():.3f} m ({reference[0]}), "
            f"p95 {np.quantile(rmse, 0.95):.2f} ({reference[1]}), "
            f"max {rmse.max():.2f} ({reference[2]}), "
            f"below 1 m {np.mean(rmse < 1):.0%} ({reference[3]}); the worst 8 near {places}; "
            f"{taken:.1f} s"
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--lattice", type=int, default=40)
    options = parser.parse_args()
    wrong_signs(20 * options.draws)
    sign_maps(options.lattice + 1)
    corruption(10 * options.draws, np.random.default_rng(0))
    error_maps(options.lattice, options.draws)


if __name__ == "__main__":
    main()
