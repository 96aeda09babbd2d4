"""The thesis's paths of 25 steps, located by SO-TDOA out of simulated arrivals, and tracked."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.localizers import arrival_order
from groundtrace.localizers.wave_physics import arrivals
from groundtrace.trackers.kalman import Motion, StepFilter, first_spread, smoothed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace.trackers.kalman import WalkModel

    Array = NDArray[np.float64]

SIDE = 5.4
SENSORS = np.array([(x, y) for y in (0, SIDE / 2, SIDE) for x in (0, SIDE / 2, SIDE)])
ROOM = np.array([(0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)])
THETA_S, SIGMA_S = 1e-5, 5e-4
TURN = 2 * np.pi * np.arange(25) / 25


def v_shaped(start: tuple[float, float], slope_deg: float) -> Array:
    """Return two legs down and up that meet in the 12th step, shape (25, 2) [m]."""
    slope = np.radians(np.where(np.arange(24) < 11, -slope_deg, slope_deg))
    paces = 0.35 * np.stack([np.cos(slope), np.sin(slope)], axis=1)
    return np.array(start) + np.concatenate([np.zeros((1, 2)), np.cumsum(paces, axis=0)])


#: A right angle at the 12th step, turns by 120 and 112 degrees there, and a circle; (25, 2) [m].
PATHS = {
    "v": v_shaped((0.7, 4.5), 60),
    "wide v": v_shaped((0.4, 4.4), 56),
    "bent": np.array([(0.5 + 0.35 * max(k - 11, 0), 0.5 + 0.35 * min(k, 11)) for k in range(25)]),
    "circle": SIDE / 2 + 1.44 * np.stack([np.cos(TURN), np.sin(TURN)], axis=1),
}


def located(path: Array, runs: int) -> Array:
    """Return places by SO-TDOA, shape (runs, 25, 2); each arrival errs by 0.5 ms."""
    return _located(path.tobytes(), runs)


@cache
def _located(path: bytes, runs: int) -> Array:
    steps = np.frombuffer(path).reshape(-1, 2)
    regions = arrival_order.known_regions(SENSORS, ROOM)
    clean = arrivals(np.linalg.norm(steps[:, None] - SENSORS, axis=2), THETA_S)
    times = clean + np.random.default_rng(3).normal(0, SIGMA_S, (runs, *clean.shape))
    fixes = [arrival_order.among(regions, row) for row in times.reshape(-1, len(SENSORS))]
    return np.array([(fix.x, fix.y) for fix in fixes]).reshape(runs, len(steps), 2)


def filtered(places: Array, model: WalkModel) -> tuple[Array, Array]:
    """Return the states and covariances after each fix, shapes (n, 4) and (n, 4, 4)."""
    walker = StepFilter(model, places[0], first_spread(model.r))
    states, spreads = [walker.state], [walker.spread]
    for place in places[1:]:
        walker.step(place, model.r)
        states.append(walker.state)
        spreads.append(walker.spread)
    return np.array(states), np.array(spreads)


def tracked(places: Array, model: WalkModel) -> tuple[Array, Array]:
    """Return filtered and smoothed places of runs, each of the shape of ``places``."""
    both = []
    for run in places:
        states, spreads = filtered(run, model)
        both.append(
            (
                states[:, 2:],
                smoothed(states, spreads, [Motion.ahead(model)] * len(states))[0][:, 2:],
            )
        )
    one, other = zip(*both, strict=True)
    return np.array(one), np.array(other)


def rms(errors: Array) -> float:
    """Return the root mean square of vectors, shape (..., 2)."""
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))
