"""RMSE of the localisers on simulated arrivals: nine sensors, law (4.24), as the thesis's 5.2."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers import arrival_order, tdoa, wave_physics

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace.pipeline.stage import LocationEstimate

SENSORS = np.array([(x, y) for y in (0.0, 5.0, 10.0) for x in (0.0, 5.0, 10.0)])
ROOM = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)])
SOURCE = np.array([[1.0, 3.0]])
THETAS = (5e-6, 1e-5, 5e-5)
SIGMAS = (2e-4, 5e-4, 1e-3)


def arrivals(sources: np.ndarray, theta_s: float) -> np.ndarray:
    """Shape (m, 9): law (4.24) as printed."""
    return wave_physics.arrivals(np.linalg.norm(sources[:, None] - SENSORS, axis=2), theta_s)


def noisy(times: np.ndarray, sigma: float, rng: np.random.Generator, late: float = 0.0):
    """Gaussian errors, and a part of the arrivals late, by 5 ms on average."""
    times = times + rng.normal(0, sigma, times.shape)
    return times + rng.exponential(5e-3, times.shape) * (rng.random(times.shape) < late)


def on_lattice(times: np.ndarray) -> np.ndarray:
    """SO-TDOA on 25 x 25 samples, ties averaged, (5.13)."""
    axis = np.linspace(0, 10, 25)
    # off the lines between regions
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + np.sqrt([2e-12, 3e-12])
    regions = arrival_order.known_regions(SENSORS, ROOM)
    apart = np.linalg.norm(nodes[:, None] - SENSORS, axis=2)
    signs = np.where(apart[:, regions.first] > apart[:, regions.second], 1, -1)
    measured = np.sign(times[:, regions.first] - times[:, regions.second])
    agree = measured @ signs.T
    best = agree == agree.max(axis=1, keepdims=True)
    return best @ nodes / best.sum(axis=1, keepdims=True)


def methods(
    velocity: float, theta_s: float, sigma: float
) -> dict[str, Callable[..., LocationEstimate]]:
    """Return the localisers by name."""
    regions = arrival_order.known_regions(SENSORS, ROOM)
    return {
        "SO-TDOA": lambda t: arrival_order.locate(SENSORS, t, ROOM),
        "Bernoulli": lambda t: arrival_order.likeliest(regions, t, theta_s, sigma),
        "hyperbolic": lambda t: tdoa.locate_hyperbolic(SENSORS, t, velocity, ROOM),
        "power law": lambda t: tdoa.locate_power_law(SENSORS, t, ROOM, huber=np.inf),
        "Huber": lambda t: tdoa.locate_power_law(SENSORS, t, ROOM),
    }


def errors(
    method: Callable[..., LocationEstimate], times: np.ndarray, sources: np.ndarray
) -> np.ndarray:
    """Return how far the places that a method finds are from the sources [m]."""
    estimates = [method(row) for row in times]
    return np.hypot(*(np.array([(p.x, p.y) for p in estimates]) - sources).T)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def one_source(runs: int, rng: np.random.Generator) -> None:
    """Table of the thesis's figure 5.7: source at [1, 3]."""
    print(f"source [1, 3], {runs} runs, RMSE [m]")
    print("theta   sigma    SO-TDOA  lattice  Bernoulli  hyperbolic  power law  Huber   us/fix")
    for theta in THETAS:
        velocity = tdoa.calibrated_velocity(SOURCE, SENSORS, arrivals(SOURCE, theta))
        for sigma in SIGMAS:
            times = noisy(np.tile(arrivals(SOURCE, theta), (runs, 1)), sigma, rng)
            lattice = rms(np.hypot(*(on_lattice(times) - SOURCE).T))
            cells, taken = [], []
            for method in methods(velocity, theta, sigma).values():
                began = time.perf_counter()
                cells.append(rms(errors(method, times, SOURCE)))
                taken.append((time.perf_counter() - began) / runs * 1e6)
            cells.insert(1, lattice)
            figures = "  ".join(f"{c:7.2f}" for c in cells)
            print(f"{theta:.0e}  {sigma * 1e3:.1f} ms {figures}   {[round(t) for t in taken]}")


def everywhere(runs: int, rng: np.random.Generator) -> None:
    """Uniform sources, with and without late arrivals."""
    print(f"uniform sources, theta 1e-5, {runs} runs, RMSE/CEP50 [m]")
    for sigma, late in ((2e-4, 0.0), (5e-4, 0.0), (1e-3, 0.0), (5e-4, 0.15)):
        sources = rng.uniform(0, 10, (runs, 2))
        clean = arrivals(sources, 1e-5)
        velocity = tdoa.calibrated_velocity(sources, SENSORS, clean)
        times = noisy(clean, sigma, rng, late)
        cells = []
        for name, method in methods(velocity, 1e-5, sigma).items():
            off = errors(method, times, sources)
            cells.append(f"{name} {rms(off):.2f}/{np.median(off):.2f}")
        print(f"{sigma * 1e3:.1f} ms, {late:.0%} late: {'  '.join(cells)}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5000)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    one_source(options.runs, rng)
    everywhere(min(options.runs, 3000), rng)


if __name__ == "__main__":
    main()
