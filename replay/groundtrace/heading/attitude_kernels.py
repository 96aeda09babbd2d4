"""The error-state filter of an orientation over a frame, in place, compiled.

The same as :class:`.attitude.Attitude` and :class:`.alone.GyroscopeAlone`, which go by objects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled
from .rotation_kernels import carry, joseph, multiply, normalise, product, turned_by

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SIZE = 14
#: Places in the state: orientation, velocity, bias, iron, earth's field; how long the sensor has
#: rested; sums that tell the magnetometer's delay; the gyroscope alone: turn, bias, rests; how far
#: the sensor turned while the reference field passed.
VELOCITY, BIAS, IRON, EARTH, RESTED, DELAY, OFFSET, ALONE, RESTS, VERIFIED, STATE = (
    4, 7, 10, 13, 15, 16, 18, 19, 22, 23, 24,
)  # fmt: skip
#: Columns of what is told of a frame: its deviation of heading, whether it rests, the bias, and
#: the values of its tests and headings.
SIGMA, RESTING, TOLD_BIAS, VALUES, TOLD = 0, 1, 2, 5, 15
#: Places among the settings: noise of the attitude, thresholds of rest, the compass.
(
    WALK, SCALE, BIAS_WALK, FORCE_WALK, SPEED, REST_RATE_LEFT, IRON_WALK, EARTH_WALK,
    REST_RATE, REST_SPREAD, REST_FORCE, REST_S, REST_SPEED, GRAVITY, FIELD_SIGMA, DRIFT, FREE,
    STEP, SETTINGS,
) = range(19)  # fmt: skip


@compiled
def update(
    state: Array,
    covariance: Array,
    pick: Array,
    innovation: Array,
    variance: float,
    kept: NDArray[np.bool_],
) -> None:
    """Update state and covariance, in place, by a measurement of three values."""
    noise, spread = np.zeros((3, 3)), np.zeros((3, 3))
    across = product(pick, covariance)
    for a in range(3):
        noise[a, a] = spread[a, a] = variance
        for b in range(3):
            for k in range(SIZE):
                spread[a, b] += across[a, k] * pick[b, k]
    gain, after = joseph(covariance, pick, spread, noise, kept)
    covariance[:] = after
    change = np.zeros(SIZE)
    for i in range(SIZE):
        for a in range(3):
            change[i] += gain[i, a] * innovation[a]
    state[:4] = turned_by(change[:3], state[:4])
    state[VELOCITY:RESTED] += change[3:]


@compiled
def predict(
    state: Array,
    covariance: Array,
    axes: Array,
    force: Array,
    mean_turn: Array,
    last: Array,
    speed: float,
    dt: float,
    p: Array,
) -> None:
    """Go on to the end of a frame, in place; ``force`` is in the earth frame."""
    step = np.eye(SIZE)
    for i in range(3):
        for k in range(3):
            for j in range(3):
                step[i, 6 + k] -= dt * axes[i, j] * mean_turn[j, k]
    x, y, z = force
    step[3, 1], step[3, 2], step[4, 0] = dt * z, -dt * y, -dt * z
    step[4, 2], step[5, 0], step[5, 1] = dt * x, dt * y, -dt * x
    covariance[:] = carry(step, covariance)
    for i in range(3):
        covariance[i, i] += p[WALK] ** 2 * dt + p[SCALE] ** 2 * speed * dt
        covariance[3 + i, 3 + i] += p[FORCE_WALK] ** 2 * dt
        covariance[6 + i, 6 + i] += p[BIAS_WALK] ** 2 * dt
        covariance[9 + i, 9 + i] += p[IRON_WALK] ** 2 * dt
        state[VELOCITY + i] += dt * (force[i] - (p[GRAVITY] if i == 2 else 0.0))
    for i in range(12, 14):
        covariance[i, i] += p[EARTH_WALK] ** 2 * dt
    multiply(state[:4], last, state[:4])
    normalise(state[:4])


@compiled
def move(state: Array, covariance: Array, rate: Array, still: bool, dt: float, p: Array) -> bool:
    """Hold velocity and, at rest, bias; return whether the sensor rests. ``rate`` as measured."""
    none, pick = np.zeros(SIZE, np.bool_), np.zeros((3, SIZE))
    state[RESTED] = state[RESTED] + dt if still else 0.0
    resting = bool(state[RESTED] > p[REST_S])
    if p[FREE] > 0.0:
        covariance[2, :] = 0.0
        covariance[:, 2] = 0.0
    for i in range(3):
        pick[i, 3 + i] = 1.0
    variance = p[REST_SPEED] ** 2 if resting else p[SPEED] ** 2 * 2.0 / dt
    update(state, covariance, pick, -state[VELOCITY:BIAS], variance, none)
    if resting:
        pick[:] = 0.0
        for i in range(3):
            pick[i, 6 + i] = 1.0
        update(state, covariance, pick, rate - state[BIAS:IRON], p[REST_RATE_LEFT] ** 2, none)
    return resting


@compiled
def alone(
    state: Array, axes: Array, mean_turn: Array, bias: Array, rate: Array, resting: bool, dt: float
) -> None:
    """Go on with the gyroscope alone by a frame that was integrated with a bias."""
    left = 0.0
    for j in range(3):
        for k in range(3):
            left += axes[2, j] * mean_turn[j, k] * (bias[k] - state[ALONE + k])
    state[OFFSET] += left * dt
    if resting:
        state[RESTS] += 1.0
        for k in range(3):
            state[ALONE + k] += (rate[k] - state[ALONE + k]) / state[RESTS]
