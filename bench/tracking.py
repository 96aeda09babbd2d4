"""RMSE of static, filtered and smoothed places on the thesis's paths (its figures 6.3 and 6.5).

25 steps, nine sensors on 5.4 m x 5.4 m, law (4.24) with theta = 1e-5 s, errors of 0.5 ms of each
arrival, places by SO-TDOA. The thesis does not print where its paths lie.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from groundtrace.localizers import sign_model, so_tdoa
from groundtrace.trackers.kalman import StepFilter, WalkModel, first_spread
from groundtrace.trackers.rts import smoothed

SIDE = 5.4
SENSORS = np.array([(x, y) for y in (0, SIDE / 2, SIDE) for x in (0, SIDE / 2, SIDE)])
ROOM = np.array([(0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)])
THETA_S, SIGMA_S = 1e-5, 5e-4
STEPS, PACE_M = 25, 0.35
MODELS = {
    "sQ .1 sR .5": WalkModel(0.1, 0.5),
    "sQ .5 sR .5": WalkModel(0.5, 0.5),
    "sQ .1 sR 1": WalkModel(0.1, 1.0),
}


@dataclass(frozen=True)
class Errors:
    """Squared errors by run and step, shape (runs, 25) [m^2]."""

    static: np.ndarray
    filtered: np.ndarray
    smoothed: np.ndarray


def bent(turn: int = 11) -> np.ndarray:
    """A path with a right angle at its 12th step, shape (25, 2)."""
    up = np.stack([np.zeros(turn), np.arange(turn)], axis=1)
    across = np.stack([np.arange(STEPS - turn), np.full(STEPS - turn, turn)], axis=1)
    return 0.5 + PACE_M * np.concatenate([up, across])


def circle(radius: float = 1.44) -> np.ndarray:
    """A path round the middle of the room, shape (25, 2)."""
    turn = 2 * np.pi * np.arange(STEPS) / STEPS
    return SIDE / 2 + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def located(path: np.ndarray, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Places by SO-TDOA, shape (runs, 25, 2)."""
    regions = so_tdoa.known_regions(SENSORS, ROOM)
    clean = sign_model.arrivals(np.linalg.norm(path[:, None] - SENSORS, axis=2), THETA_S)
    times = clean + rng.normal(0, SIGMA_S, (runs, *clean.shape))
    fixes = [so_tdoa.among(regions, row) for row in times.reshape(-1, len(SENSORS))]
    return np.array([(fix.x, fix.y) for fix in fixes]).reshape(runs, len(path), 2)


def tracked(places: np.ndarray, model: WalkModel) -> tuple[np.ndarray, np.ndarray]:
    """Filtered and smoothed places, shape (25, 2) each."""
    walker = StepFilter(model, places[0], first_spread(model.r))
    states, spreads = [walker.state], [walker.spread]
    for place in places[1:]:
        walker.step(place, model.r)
        states.append(walker.state)
        spreads.append(walker.spread)
    known = np.array(states)
    return known[:, 2:], smoothed(known, np.array(spreads), model)[0][:, 2:]


def errors(path: np.ndarray, places: np.ndarray, model: WalkModel) -> Errors:
    """Return the errors of one path."""
    found = [tracked(run, model) for run in places]
    filtered, smooth = (np.array(x) for x in zip(*found, strict=True))
    return Errors(*(((x - path) ** 2).sum(axis=-1) for x in (places, filtered, smooth)))


def rms(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5000)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    for name, path in (("right angle", bent()), ("circle", circle())):
        places = located(path, options.runs, rng)
        for label, model in MODELS.items():
            began = time.perf_counter()
            found = errors(path, places, model)
            each = (time.perf_counter() - began) / places[..., 0].size * 1e6
            by_step = np.sqrt(found.filtered.mean(axis=0))
            print(
                f"{name:12} {label:12} static {rms(found.static):.3f}  "
                f"filtered {rms(found.filtered):.3f} (step 11 {by_step[10]:.2f}, "
                f"worst of 12-16 {by_step[11:16].max():.2f}, step 25 {by_step[-1]:.2f})  "
                f"smoothed {rms(found.smoothed):.3f} m, {each:.0f} us a step"
            )


if __name__ == "__main__":
    main()
