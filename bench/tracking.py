"""RMSE of static, filtered and smoothed places on the thesis's paths (its figures 6.3 and 6.5).

25 steps, nine sensors on 5.4 m x 5.4 m, law (4.24) with theta = 1e-5 s, errors of 0.5 ms of each
arrival, places by SO-TDOA. The thesis does not print where its paths lie; a figure passes within
12 % of an independent reproduction, and gains and the golden row within what it prints.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np

from groundtrace.localizers import arrival_order
from groundtrace.localizers.wave_physics import arrivals
from groundtrace.trackers.kalman import Motion, StepFilter, WalkModel, first_spread, smoothed

SIDE = 5.4
SENSORS = np.array([(x, y) for y in (0, SIDE / 2, SIDE) for x in (0, SIDE / 2, SIDE)])
ROOM = np.array([(0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)])
THETA_S, SIGMA_S = 1e-5, 5e-4
STEPS, PACE_M, TURN = 25, 0.35, 12
TOLERANCE = 0.12
#: Standard deviations of prediction and fix of the columns [m].
MODELS = (WalkModel(0.1, 0.5), WalkModel(0.5, 0.5), WalkModel(0.1, 1.0))
COLUMNS = ("static", "filtered", "step 11", "after turn", "step 25", "sQ .5", "sR 1", "smoothed")
#: Reference [m] of each path, by column; a circle has no turn, and none is given for its steps.
REFERENCE = {
    "L": (0.748, 0.516, 0.46, 0.62, 0.45, 0.623, 0.527, 0.321),
    "V": (0.798, 0.570, 0.51, 0.73, 0.44, 0.665, 0.603, 0.331),
    "wide V": (0.790, 0.560, 0.55, 0.75, 0.46, 0.657, 0.594, 0.335),
    "circle": (0.824, 0.632, None, None, None, 0.691, 0.713, 0.356),
}
#: Steady gains of the place before and the present one.
GAINS = ((0.326039, 0.471443), (0.288553, 0.769087), (0.281880, 0.361769))
FIXES = np.array([(0, 0), (0.4, 0.1), (0.6, 0.1), (1.1, 0), (1.3, 0.2)])
GOLDEN = ((0.380989, 0.095247), (0.602306, 0.112239), (1.011827, 0.047791), (1.306878, 0.136948))


@dataclass(frozen=True)
class Errors:
    """Squared errors by run and step, shape (runs, 25) [m^2]."""

    static: np.ndarray
    filtered: np.ndarray
    smoothed: np.ndarray


def legs(start: tuple[float, float], *headings_deg: float) -> np.ndarray:
    """A path of two straight legs that turns at the 12th step, shape (25, 2)."""
    first, second = np.radians(headings_deg)
    heading = np.where(np.arange(STEPS - 1) < TURN - 1, first, second)
    paces = PACE_M * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.array(start) + np.concatenate([np.zeros((1, 2)), np.cumsum(paces, axis=0)])


def circle(radius: float = 1.44) -> np.ndarray:
    """A path round the middle of the room, shape (25, 2)."""
    turn = 2 * np.pi * np.arange(STEPS) / STEPS
    return SIDE / 2 + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


#: V turns by 120 degrees, wide V by 112: two legs that turn less do not fit well into the room.
PATHS = {
    "L": legs((0.5, 0.5), 90, 0),
    "V": legs((0.7, 4.5), -60, 60),
    "wide V": legs((0.4, 4.4), -56, 56),
    "circle": circle(),
}


def located(path: np.ndarray, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Places by SO-TDOA, shape (runs, 25, 2)."""
    regions = arrival_order.known_regions(SENSORS, ROOM)
    clean = arrivals(np.linalg.norm(path[:, None] - SENSORS, axis=2), THETA_S)
    times = clean + rng.normal(0, SIGMA_S, (runs, *clean.shape))
    fixes = [arrival_order.among(regions, row) for row in times.reshape(-1, len(SENSORS))]
    return np.array([(fix.x, fix.y) for fix in fixes]).reshape(runs, len(path), 2)


def tracked(places: np.ndarray, model: WalkModel) -> tuple[np.ndarray, np.ndarray]:
    """Filtered and smoothed places, shape (25, 2) each."""
    walker = StepFilter(model, places[0], first_spread(model.r))
    states, spreads = [walker.state], [walker.spread]
    for fix in places[1:]:
        walker.step(fix, model.r)
        states.append(walker.state)
        spreads.append(walker.spread)
    filtered, motions = np.array(states), [Motion.ahead(model)] * len(states)
    return filtered[:, 2:], smoothed(filtered, np.array(spreads), motions)[0][:, 2:]


def errors(path: np.ndarray, places: np.ndarray, model: WalkModel) -> Errors:
    """Return the errors of one path."""
    tracks = [tracked(run, model) for run in places]
    filtered, smooth = (np.array(x) for x in zip(*tracks, strict=True))
    return Errors(*(((x - path) ** 2).sum(axis=-1) for x in (places, filtered, smooth)))


def rms(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean()))


def row(path: np.ndarray, runs: int, rng: np.random.Generator) -> tuple[float, ...]:
    """Return the figures of a path, by column [m]."""
    places = located(path, runs, rng)
    nominal, loose, slow = (errors(path, places, model) for model in MODELS)
    steps = np.sqrt(nominal.filtered.mean(axis=0))
    return (
        rms(nominal.static),
        rms(nominal.filtered),
        float(steps[TURN - 2]),
        float(steps[TURN - 1 : TURN + 4].max()),
        float(steps[-1]),
        rms(loose.filtered),
        rms(slow.filtered),
        rms(nominal.smoothed),
    )


def table(runs: int) -> bool:
    """Print the figures of all paths with the reference beside; return whether all pass."""
    rng, passed = np.random.default_rng(0), True
    print(f"{'path':8}" + "".join(f"{name:>20}" for name in COLUMNS))
    for name, path in PATHS.items():
        cells = []
        for figure, expected in zip(row(path, runs, rng), REFERENCE[name], strict=True):
            if expected is None:
                cells.append(f"{figure:.3f}")
                continue
            good = abs(figure / expected - 1) <= TOLERANCE
            passed &= good
            cells.append(f"{figure:.3f} ({expected:.3f}) {'pass' if good else 'FAIL'}")
        print(f"{name:8}" + "".join(f"{cell:>20}" for cell in cells))
    return passed


def gains() -> bool:
    """Print the steady gains with the reference beside; return whether they are equal."""
    passed = True
    for model, expected in zip(MODELS, GAINS, strict=True):
        walker = StepFilter(model, np.zeros(2), first_spread(model.r))
        for _ in range(200):
            walker.step(np.zeros(2), model.r)
        gain = walker.gain[[0, 2], 0]
        good = bool(np.allclose(gain, expected, rtol=0, atol=1e-6))
        passed &= good
        print(f"gains {gain.round(6)} {expected} {'pass' if good else 'FAIL'}")
    return passed


def golden() -> bool:
    """Print the places of five fixes with the reference beside; return whether they are equal."""
    walker = StepFilter(MODELS[0], FIXES[0], np.eye(4))
    positions = []
    for fix in FIXES[1:]:
        walker.step(fix, MODELS[0].r)
        positions.append(walker.state[2:])
    good = bool(np.allclose(positions, GOLDEN, rtol=0, atol=1e-6))
    print(f"places {np.round(positions, 6).tolist()} {GOLDEN} {'pass' if good else 'FAIL'}")
    return good


def main() -> None:
    """Print everything; fail where a figure is off."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    options = parser.parse_args()
    if not all([table(options.runs), gains(), golden()]):
        sys.exit(1)


if __name__ == "__main__":
    main()
