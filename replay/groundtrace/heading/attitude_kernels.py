"""The error-state filter of an orientation over a frame, in place, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import in_place
from .rotation_kernels import held, multiply, normalise, product, put, times, turn_by

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rotation_kernels import Vector

    Array = NDArray[np.float64]
    Rows = NDArray[np.bool_]

SIZE = 14
#: Places in the state: orientation, velocity, bias, iron, earth's field; how long the sensor has
#: rested; sums that tell the magnetometer's delay; the gyroscope alone: turn, bias, rests.
VELOCITY, BIAS, IRON, EARTH, RESTED, DELAY, OFFSET, ALONE, RESTS, STATE = (
    4, 7, 10, 13, 15, 16, 18, 19, 22, 23,
)  # fmt: skip
#: Columns of what is told of a frame: its deviation of heading, whether it rests, the bias, the
#: values of its tests and headings, whether all tests of its field passed.
SIGMA, RESTING, TOLD_BIAS, VALUES, PASSED, TOLD = 0, 1, 2, 5, 15, 16
#: Places among the settings: noise of the attitude, thresholds of rest, the compass.
(
    WALK, SCALE, BIAS_WALK, FORCE_WALK, SPEED, REST_RATE_LEFT, IRON_WALK, EARTH_WALK,
    REST_RATE, REST_SPREAD, REST_FORCE, REST_S, REST_SPEED, GRAVITY, FIELD_SIGMA, PLAIN_SIGMA,
    IRON_START, DRIFT, FREE, STEP, SETTINGS,
) = range(21)  # fmt: skip


#: Rows of the room that a measurement of three values writes over, shape (ROOM, SIZE): what it
#: sees of the state, its covariance with the state, the innovation's, the gain, and the change.
SEES, ACROSS, APART, GAIN, CHANGE, ROOM = 0, 3, 6, 9, 12, 13
#: Rows of the error state that a measurement may not change.
NONE = np.zeros(SIZE, np.bool_)


@in_place
def forget(covariance: Array, first: int, count: int) -> None:
    """Let a few neighbours in the error state have no errors, in place."""
    for i in range(first, first + count):
        for k in range(len(covariance)):
            covariance[i, k] = covariance[k, i] = 0.0


@in_place
def gains(across: Array, spread: Array, gain: Array) -> None:
    """Put the gain of a measurement of three values in ``gain``, shape (3, n): one column a value.

    ``across`` is the covariance of measurement and state, shape (3, n), ``spread`` that of the
    innovation, shape (3, 3).
    """
    l00 = math.sqrt(spread[0, 0])
    l10, l20 = spread[1, 0] / l00, spread[2, 0] / l00
    l11 = math.sqrt(spread[1, 1] - l10 * l10)
    l21 = (spread[2, 1] - l20 * l10) / l11
    l22 = math.sqrt(spread[2, 2] - l20 * l20 - l21 * l21)
    for i in range(across.shape[1]):
        a = across[0, i] / l00
        b = (across[1, i] - l10 * a) / l11
        c = (across[2, i] - l20 * a - l21 * b) / l22 / l22
        b = (b - l21 * c) / l11
        gain[0, i], gain[1, i], gain[2, i] = (a - l10 * b - l20 * c) / l00, b, c


@in_place
def lessen(covariance: Array, across: Array, gain: Array, kept: Rows) -> None:
    """Lessen a covariance, shape (n, n), in place, by a measurement with a gain, shape (3, n).

    Rows that are kept have no gain (Schmidt): the covariance then is that of what is done.
    """
    n = len(covariance)
    for i in range(n):
        one, other = (across, gain) if kept[i] else (gain, across)
        a, b, c = one[0, i], one[1, i], one[2, i]
        for j in range(i, n):
            covariance[i, j] -= a * other[0, j] + b * other[1, j] + c * other[2, j]
        for j in range(i):
            covariance[i, j] = covariance[j, i]


@in_place
def learn(state: Array, covariance: Array, innovation: Vector, kept: Rows, room: Array) -> None:
    """Update by a measurement of three values, given its covariances in the room.

    Rows that are ``kept`` learn nothing.
    """
    across, gain, change = room[ACROSS:APART], room[GAIN:CHANGE], room[CHANGE]
    gains(across, room[APART:GAIN], gain)
    for i in range(SIZE):
        if kept[i]:
            gain[0, i] = gain[1, i] = gain[2, i] = 0.0
        change[i] = (
            gain[0, i] * innovation[0] + gain[1, i] * innovation[1] + gain[2, i] * innovation[2]
        )
    lessen(covariance, across, gain, kept)
    turn_by(change, state[:4])
    for k in range(3, SIZE):
        state[1 + k] += change[k]


@in_place
def update(
    state: Array,
    covariance: Array,
    pick: Array,
    innovation: Vector,
    variance: float,
    kept: Rows,
    room: Array,
) -> None:
    """Update, in place, by a measurement of three values; ``pick``, (3, SIZE), is what it sees."""
    across, spread = room[ACROSS:APART], room[APART:GAIN]
    product(pick, covariance, across)
    for a in range(3):
        for b in range(3):
            spread[a, b] = variance if a == b else 0.0
            for k in range(SIZE):
                spread[a, b] += across[a, k] * pick[b, k]
    learn(state, covariance, innovation, kept, room)


@in_place
def hold(
    state: Array, covariance: Array, first: int, values: Vector, variance: float, room: Array
) -> None:
    """Update by a measurement of three neighbours in the error state, which have these values."""
    across, spread = room[ACROSS:APART], room[APART:GAIN]
    for a in range(3):
        for k in range(SIZE):
            across[a, k] = covariance[first + a, k]
        for b in range(3):
            spread[a, b] = across[a, first + b] + (variance if a == b else 0.0)
    at = first + 1
    off = (values[0] - state[at], values[1] - state[at + 1], values[2] - state[at + 2])
    learn(state, covariance, off, NONE, room)


@in_place
def know_heading(covariance: Array, sigma: float) -> None:
    """Take the heading to be known to ``sigma`` [rad], by what this filter does not see."""
    forget(covariance, 2, 1)
    covariance[2, 2] = sigma * sigma


@in_place
def turn_heading(state: Array, covariance: Array, angle: float) -> None:
    """Turn the whole estimate about the vertical, counter-clockwise, in place."""
    put(times((math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)), held(state)), state)
    normalise(state[:4])
    c, s = math.cos(angle), math.sin(angle)
    x, y = state[VELOCITY], state[VELOCITY + 1]
    state[VELOCITY], state[VELOCITY + 1] = c * x - s * y, s * x + c * y
    for first in (0, 3):
        for k in range(SIZE):
            x, y = covariance[first, k], covariance[first + 1, k]
            covariance[first, k], covariance[first + 1, k] = c * x - s * y, s * x + c * y
    for first in (0, 3):
        for k in range(SIZE):
            x, y = covariance[k, first], covariance[k, first + 1]
            covariance[k, first], covariance[k, first + 1] = c * x - s * y, s * x + c * y


@in_place
def face(state: Array, covariance: Array, field: Vector, sigma: float, iron: float) -> None:
    """Turn north to where a field points, earth frame, known to ``sigma`` and iron by ``iron``."""
    turn_heading(state, covariance, math.atan2(field[0], field[1]))
    flat = max(math.hypot(field[0], field[1]), 1e-9)
    know_heading(covariance, math.hypot(sigma, iron) / flat)


@in_place
def take_earth(state: Array, covariance: Array, north: float, up: float, sigma: float) -> None:
    """Take a field for the earth's, by its horizontal and vertical part, in place."""
    state[EARTH], state[EARTH + 1] = north, up
    forget(covariance, 12, 2)
    covariance[12, 12] = covariance[13, 13] = sigma * sigma


@in_place
def carry_on(covariance: Array, turned: Array, force: Vector, dt: float) -> None:
    """Carry a covariance to the end of a frame, in place.

    ``turned``, shape (3, 3), is what the frame's mean turn makes of the bias in the earth frame;
    ``force`` is in the earth frame.
    """
    x, y, z = dt * force[0], dt * force[1], dt * force[2]
    for j in range(SIZE):
        a, b, c = covariance[0, j], covariance[1, j], covariance[2, j]
        covariance[3, j] += z * b - y * c
        covariance[4, j] += x * c - z * a
        covariance[5, j] += y * a - x * b
        u, v, w = covariance[6, j], covariance[7, j], covariance[8, j]
        for i in range(3):
            covariance[i, j] -= dt * (turned[i, 0] * u + turned[i, 1] * v + turned[i, 2] * w)
    for j in range(SIZE):
        a, b, c = covariance[j, 0], covariance[j, 1], covariance[j, 2]
        covariance[j, 3] += z * b - y * c
        covariance[j, 4] += x * c - z * a
        covariance[j, 5] += y * a - x * b
        u, v, w = covariance[j, 6], covariance[j, 7], covariance[j, 8]
        for i in range(3):
            covariance[j, i] -= dt * (turned[i, 0] * u + turned[i, 1] * v + turned[i, 2] * w)


@in_place
def predict(
    state: Array,
    covariance: Array,
    turned: Array,
    force: Vector,
    last: Array,
    speed: float,
    dt: float,
    p: Array,
) -> None:
    """Go on to the end of a frame, in place. ``turned`` and ``force`` as :func:`carry_on` has them.

    ``last`` is the turn from the frame's end to its start, ``speed`` its angular velocity [rad/s].
    """
    carry_on(covariance, turned, force, dt)
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


@in_place
def move(
    state: Array, covariance: Array, rate: Vector, still: bool, dt: float, p: Array, room: Array
) -> bool:
    """Hold velocity and, at rest, bias; return whether the sensor rests. ``rate`` as measured."""
    state[RESTED] = state[RESTED] + dt if still else 0.0
    resting = bool(state[RESTED] > p[REST_S])
    if p[FREE] > 0.0:
        forget(covariance, 2, 1)
    variance = p[REST_SPEED] ** 2 if resting else p[SPEED] ** 2 * 2.0 / dt
    hold(state, covariance, 3, (0.0, 0.0, 0.0), variance, room)
    if resting:
        hold(state, covariance, 6, rate, p[REST_RATE_LEFT] ** 2, room)
    return resting


@in_place
def alone(
    state: Array, turned: Array, bias: Vector, rate: Vector, resting: bool, dt: float
) -> None:
    """Go on with the gyroscope alone by a frame that was integrated with a bias."""
    left = 0.0
    for k in range(3):
        left += turned[2, k] * (bias[k] - state[ALONE + k])
    state[OFFSET] += left * dt
    if resting:
        state[RESTS] += 1.0
        for k in range(3):
            state[ALONE + k] += (rate[k] - state[ALONE + k]) / state[RESTS]
