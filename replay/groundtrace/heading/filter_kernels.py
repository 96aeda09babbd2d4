"""The error-state filter over many frames in one call, compiled.

The same as :class:`.estimator.HeadingEstimator` does frame by frame, where nothing is out of the
ordinary: the tests of the field pass, and no other iron is believed in. The first frame of which
that does not hold ends the run, unchanged.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from .attitude_kernels import (
    BIAS,
    DELAY,
    DRIFT,
    EARTH,
    FIELD_SIGMA,
    IRON,
    OFFSET,
    REST_FORCE,
    REST_RATE,
    REST_SPREAD,
    RESTING,
    SIGMA,
    STEP,
    TOLD,
    TOLD_BIAS,
    VALUES,
    VERIFIED,
    alone,
    move,
    predict,
)  # fmt: skip
from .compass_kernels import correct_field, passes, tests, turn_about_vertical, wrapped
from .frame_kernels import field_of, mean_and_spread, mean_turned, turns_of
from .rotation_kernels import add_matrix, multiply, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@compiled
def headings_into(
    start: Array, turns: Array, axis: Array, orientation: Array, heading: Array
) -> None:
    """Put the orientation after each turn, and the direction of a body axis, in the last two."""
    pointing = np.empty(3)
    for i in range(len(turns)):
        multiply(start, turns[i], orientation[i])
        turn(orientation[i], axis, pointing)
        heading[i] = math.atan2(pointing[1], pointing[0])


@compiled
def look(
    state: Array,
    covariance: Array,
    axes: Array,
    mean_turn: Array,
    field: Array,
    recent: Array,
    counts: NDArray[np.int64],
    dt: float,
    p: Array,
    limits: Array,
    values: Array,
) -> bool:
    """Test a frame's field and learn from it, in place; return whether it passes.

    ``axes`` are those of the frame's start, ``values`` take what the tests look at.
    """
    turned, earth, moved = axes @ mean_turn, axes @ field, state[:4].copy()
    sigma = p[DRIFT] * min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
    seen = earth - turned @ state[IRON:EARTH]
    tests(state, seen, sigma, recent, counts, dt, values)
    if not passes(values, limits):
        return False
    correct_field(state, covariance, turned, earth, p[FIELD_SIGMA] ** 2)
    state[OFFSET] -= turn_about_vertical(moved, state[:4])
    return True


@compiled
def go_on(
    rate: Array,
    force: Array,
    field: Array,
    state: Array,
    covariance: Array,
    recent: Array,
    counts: NDArray[np.int64],
    axis: Array,
    p: Array,
    limits: Array,
    orientation: Array,
    heading: Array,
    told: Array,
) -> bool:
    """Go on by one frame, in place; return whether it is ordinary. As :func:`frames` has it."""
    bias, start, dt = state[BIAS:IRON].copy(), state[:4].copy(), len(rate) * p[STEP]
    free, axes, pushed = rate - bias, np.zeros((3, 3)), np.empty(3)
    turns, middles, mean_turn = turns_of(free, p[STEP])
    measured, _, rate_spread = mean_and_spread(rate)
    delay_s = state[DELAY] / state[DELAY + 1]
    seen, across, along = field_of(field, free, middles, delay_s)
    compass = np.isfinite(seen).all()
    if compass and math.isnan(state[EARTH]):
        return False
    add_matrix(start, 1.0, axes)
    headings_into(start, turns, axis, orientation, heading)
    told[SIGMA] = min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
    turn(start, mean_turned(middles, force), pushed)
    speed = mean_and_spread(free)[1]
    predict(state, covariance, axes, pushed, mean_turn, turns[len(turns) - 1], speed, dt, p)
    size = math.sqrt(measured[0] ** 2 + measured[1] ** 2 + measured[2] ** 2)
    still = size < p[REST_RATE] and rate_spread < p[REST_SPREAD]
    still = still and mean_and_spread(force)[2] < p[REST_FORCE]
    resting = move(state, covariance, measured, still, dt, p)
    told[RESTING] = 1.0 if resting else 0.0
    told[VALUES + 8] = math.degrees(wrapped(heading[0] + state[OFFSET]))
    alone(state, axes, mean_turn, bias, measured, resting, dt)
    if compass:
        values = told[VALUES : VALUES + 8]
        if not look(
            state, covariance, axes, mean_turn, seen, recent, counts, dt, p, limits, values
        ):
            return False
        state[VERIFIED] += speed * dt
        state[DELAY] += across + delay_s * along
        state[DELAY + 1] += along
        told[VALUES + 9] = math.degrees(wrapped(heading[0] + recent[1, counts[1, 0] - 1]))
    told[TOLD_BIAS:VALUES] = state[BIAS:IRON]
    return True


@compiled
def frames(
    rate: Array,
    force: Array,
    field: Array,
    length: int,
    state: Array,
    covariance: Array,
    recent: Array,
    counts: NDArray[np.int64],
    axis: Array,
    p: Array,
    limits: Array,
) -> tuple[int, Array, Array, Array]:
    """Filter frame after frame; state, covariance and the rest go on in place.

    Parameters
    ----------
    rate, force, field
        Samples, shape (n, 3) each; the field is NaN where there is none.
    length
        Samples of a frame.
    state, covariance
        Of the filter, as laid out above.
    recent, counts
        Norms and azimuths of the last frames, shape (2, m), and how many there are and may be,
        shape (2, 2).
    axis
        Whose heading is told, shape (3,).
    p, limits
        Settings as laid out above, and thresholds of the tests.

    Returns
    -------
    How many frames were gone on by, and of their samples orientation, shape (n, 4), and heading;
    and of each what is told of it, shape (frames, 15).
    """
    count = len(rate) // length
    orientation, heading = np.empty((count * length, 4)), np.empty(count * length)
    told = np.full((count, TOLD), np.nan)
    for f in range(count):
        before, spread, kept, known = state.copy(), covariance.copy(), recent.copy(), counts.copy()
        part = slice(f * length, (f + 1) * length)
        if not go_on(
            rate[part],
            force[part],
            field[part],
            state,
            covariance,
            recent,
            counts,
            axis,
            p,
            limits,
            orientation[part],
            heading[part],
            told[f],
        ):
            state[:], covariance[:], recent[:], counts[:] = before, spread, kept, known
            return f, orientation, heading, told
    return count, orientation, heading, told
