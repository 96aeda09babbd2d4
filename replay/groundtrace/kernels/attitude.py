"""Loops over frames, compiled: quaternions, attitude, compass, and two beliefs about the field.

Quaternions are those of :mod:`.inertial.rotations`, one at a time: as plain numbers, or into arrays
that are given.

The two beliefs about the field are the clean one and, while tests fail, one in which the iron on
the sensor has changed. A field that fails but holds still while the sensor turns is that of the
place: the reference at the start may have been taken beside something magnetic. A field whose norm
and inclination then stay the same is neither iron on the sensor, which would change them with its
orientation, nor a magnet in passing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .compiling import inlined as compiled
from .compiling import inlined as in_place
from .lanes import LANES, every, put_row, row_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Quaternion = tuple[float, float, float, float]
    Vector = tuple[float, float, float]
    Rows = NDArray[np.bool_]
    Counts = NDArray[np.int64]
    Compass = tuple[Array, Array, Array, Counts]


@in_place
def held(a: Array) -> Quaternion:
    """Return a quaternion out of an array."""
    return a[0], a[1], a[2], a[3]


@in_place
def times(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product a b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@in_place
def of_angles(x: float, y: float, z: float) -> Quaternion:
    """Return the quaternion of a rotation vector [rad]."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    share = 0.5 * (math.sin(half) / half if half > 0.0 else 1.0)
    return math.cos(half), share * x, share * y, share * z


@in_place
def crossed(a: Vector, b: Vector) -> Vector:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@in_place
def rotated(q: Quaternion, v: Vector) -> Vector:
    """Return a vector turned by a quaternion."""
    x, y, z = crossed((q[1], q[2], q[3]), v)
    twice = (2.0 * x, 2.0 * y, 2.0 * z)
    a, b, c = crossed((q[1], q[2], q[3]), twice)
    return v[0] + q[0] * twice[0] + a, v[1] + q[0] * twice[1] + b, v[2] + q[0] * twice[2] + c


@in_place
def put(q: Quaternion, out: Array) -> None:
    """Put a quaternion in an array."""
    out[0], out[1], out[2], out[3] = q


@in_place
def multiply(a: Array, b: Array, out: Array) -> None:
    """Put the product a b in ``out``, which may be either of them."""
    put(times(held(a), held(b)), out)


@in_place
def normalise(q: Array) -> None:
    """Make a quaternion's length 1."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= length


@in_place
def turn_by(error: Array, orientation: Array) -> None:
    """Turn an orientation, shape (4,), by a small rotation in the earth frame, (3,)."""
    put(times(of_angles(error[0], error[1], error[2]), held(orientation)), orientation)
    normalise(orientation)


@in_place
def add_matrix(q: Quaternion, share: float, out: Array) -> None:
    """Add ``share`` times the rotation matrix of a quaternion to ``out``, shape (3, 3)."""
    w, x, y, z = q
    out[0, 0] += share * (w * w + x * x - y * y - z * z)
    out[0, 1] += share * 2.0 * (x * y - w * z)
    out[0, 2] += share * 2.0 * (x * z + w * y)
    out[1, 0] += share * 2.0 * (x * y + w * z)
    out[1, 1] += share * (w * w - x * x + y * y - z * z)
    out[1, 2] += share * 2.0 * (y * z - w * x)
    out[2, 0] += share * 2.0 * (x * z - w * y)
    out[2, 1] += share * 2.0 * (y * z + w * x)
    out[2, 2] += share * (w * w - x * x - y * y + z * z)


@in_place
def identity(out: Array) -> None:
    """Make a matrix, shape (n, n), the identity."""
    out[:] = 0.0
    for i in range(len(out)):
        out[i, i] = 1.0


@in_place
def product(left: Array, right: Array, out: Array) -> None:
    """Put ``left @ right`` in ``out``; zeros of the left matrix are passed over.

    Each row of the right matrix and of ``out`` lies in one piece.
    """
    width = right.shape[1]
    if right.strides[1] != right.itemsize or out.strides[1] != out.itemsize:
        raise ValueError("expected rows that lie in one piece")
    for i in range(left.shape[0]):
        if width < LANES:
            out[i] = 0.0
            for k in range(left.shape[1]):
                if left[i, k] != 0.0:
                    for j in range(width):
                        out[i, j] += left[i, k] * right[k, j]
        for j in range(0, width if width >= LANES else 0, LANES):
            # the last row of lanes ends where the matrix does
            first, total = min(j, width - LANES), every(0.0)
            for k in range(left.shape[1]):
                if left[i, k] != 0.0:
                    total = total + every(left[i, k]) * row_from(right[k], first)
            put_row(out[i, first:], 0, total)


@in_place
def carry(step: Array, covariance: Array, room: Array) -> None:
    """Put ``step @ covariance @ step.T`` in the covariance, shape (n, n).

    Zeros of the step are passed over. ``room``, shape (2, n, n), is written over.
    """
    half, across = room[0], room[1]
    product(step, covariance, half)
    transpose(half, across)
    # the result's transpose, so that neighbours in memory are added
    product(step, across, half)
    transpose(half, covariance)


@in_place
def transpose(matrix: Array, out: Array) -> None:
    """Put the transpose of a matrix, shape (n, m), in ``out``."""
    for i in range(matrix.shape[0]):
        for k in range(matrix.shape[1]):
            out[k, i] = matrix[i, k]


@in_place
def solve(matrix: Array, sides: Array) -> None:
    """Solve ``matrix @ x = sides`` in place, by elimination with the largest pivot.

    Both are overwritten: ``sides``, shape (n, k), by the solution.
    """
    n, width = sides.shape
    for i in range(n):
        best = i
        for r in range(i + 1, n):
            if abs(matrix[r, i]) > abs(matrix[best, i]):
                best = r
        if best != i:
            for j in range(n):
                matrix[i, j], matrix[best, j] = matrix[best, j], matrix[i, j]
            for j in range(width):
                sides[i, j], sides[best, j] = sides[best, j], sides[i, j]
        for r in range(i + 1, n):
            share = matrix[r, i] / matrix[i, i]
            if share != 0.0:
                for j in range(i, n):
                    matrix[r, j] -= share * matrix[i, j]
                for j in range(width):
                    sides[r, j] -= share * sides[i, j]
    for i in range(n - 1, -1, -1):
        for r in range(i + 1, n):
            share = matrix[i, r]
            if share != 0.0:
                for j in range(width):
                    sides[i, j] -= share * sides[r, j]
        pivot = matrix[i, i]
        for j in range(width):
            sides[i, j] /= pivot


@compiled
def joseph(
    covariance: Array, pick: Array, spread: Array, noise: Array, kept: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return gain, shape (n, m), and covariance after a measurement, in Joseph's form.

    Parameters
    ----------
    covariance
        Before, shape (n, n).
    pick
        What the measurement sees of the state, shape (m, n).
    spread, noise
        Covariance of the innovation, and the measurement's part of it, shape (m, m).
    kept
        Shape (n,): rows that keep their estimate.
    """
    n, m = len(covariance), len(pick)
    across, gain, left = np.empty((m, n)), np.empty((n, m)), np.zeros((n, n))
    product(pick, covariance, across)
    solve(spread.copy(), across)
    transpose(across, gain)
    for i in range(n):
        left[i, i] = 1.0
        for k in range(m):
            share = 0.0 if kept[i] else gain[i, k]
            gain[i, k] = share
            for j in range(n):
                left[i, j] -= share * pick[k, j]
    after = covariance.copy()
    carry(left, after, np.empty((2, n, n)))
    for i in range(n):
        for a in range(m):
            for b in range(m):
                share = gain[i, a] * noise[a, b]
                if share != 0.0:
                    for j in range(n):
                        after[i, j] += share * gain[j, b]
    return gain, after


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


#: Places in what is told of a frame: the matrix of its mean turn, mean force and field in the axes
#: of its start, mean rate in moving ones; root mean square rate, and how far rate and force are off
#: their means; the sums that tell the field's delay.
MEAN_TURN, FORCE, FIELD, RATE, FRAME_SPEED, RATE_SPREAD, FORCE_SPREAD, CROSSWISE, ALONG, FRAME = (
    0, 9, 12, 15, 18, 19, 20, 21, 22, 23,
)  # fmt: skip


@in_place
def spread(x: Array) -> float:
    """Return the root mean square deviation of vectors, shape (n, 3), from their mean."""
    apart = 0.0
    for k in range(3):
        mean = 0.0
        for i in range(len(x)):
            mean += x[i, k]
        mean /= len(x)
        for i in range(len(x)):
            apart += (x[i, k] - mean) * (x[i, k] - mean)
    return math.sqrt(apart / len(x))


@in_place
def turn_through(
    rate: Array, force: Array, bias: Array, step_s: float, turns: Array, out: Array
) -> None:
    """Follow the turn of a frame; put means over it in ``out``. As :func:`sum_up` has it."""
    count, square, end = len(rate), 0.0, (1.0, 0.0, 0.0, 0.0)
    out[:FRAME] = 0.0
    mean = out[MEAN_TURN:FORCE].reshape(3, 3)
    for i in range(count):
        x, y, z = rate[i, 0] - bias[0], rate[i, 1] - bias[1], rate[i, 2] - bias[2]
        square += x * x + y * y + z * z
        half = of_angles(0.5 * step_s * x, 0.5 * step_s * y, 0.5 * step_s * z)
        middle = times(end, half)
        end = times(middle, half)
        put(end, turns[i, 0])
        put(middle, turns[i, 1])
        add_matrix(middle, 1.0 / count, mean)
        pushed = rotated(middle, (force[i, 0], force[i, 1], force[i, 2]))
        for k in range(3):
            out[FORCE + k] += pushed[k] / count
            out[RATE + k] += rate[i, k] / count
    out[FRAME_SPEED] = math.sqrt(square / count)


@in_place
def field_of(
    field: Array, rate: Array, bias: Array, turns: Array, delay_s: float, room: Array, out: Array
) -> None:
    """Put the mean field in the axes of the frame's start, and sums that tell its delay, in one.

    ``room``, shape (n + 1, 6), is written over.
    """
    count = len(field)
    mean = room[count]
    mean[:] = 0.0
    for i in range(count):
        w = (rate[i, 0] - bias[0], rate[i, 1] - bias[1], rate[i, 2] - bias[2])
        ahead = of_angles(-delay_s * w[0], -delay_s * w[1], -delay_s * w[2])
        still = rotated(ahead, (field[i, 0], field[i, 1], field[i, 2]))
        middle = held(turns[i, 1])
        room[i, 0], room[i, 1], room[i, 2] = rotated(middle, still)
        room[i, 3], room[i, 4], room[i, 5] = rotated(middle, crossed(w, still))
        for k in range(6):
            mean[k] += room[i, k]
    across, along = 0.0, 0.0
    for i in range(count):
        for k in range(3):
            off = room[i, 3 + k] - mean[3 + k] / count
            across += off * (room[i, k] - mean[k] / count)
            along += off * off
    for k in range(3):
        out[FIELD + k] = mean[k] / count
    out[CROSSWISE], out[ALONG] = across, along


@in_place
def sum_up(
    rate: Array,
    force: Array,
    field: Array,
    bias: Array,
    delay_s: float,
    step_s: float,
    turns: Array,
    room: Array,
    out: Array,
) -> None:
    """Put what a frame says in ``out``, shape (FRAME,), in the places above.

    Parameters
    ----------
    rate, force, field
        Of its samples, shape (n, 3) each.
    bias, delay_s
        Of the gyroscope [rad/s]; how much later than it the magnetometer answers [s].
    step_s
        Time between samples [s].
    turns
        Takes the rotations from the end and from the middle of each sample's interval to the
        frame's start, shape (n, 2, 4).
    room
        Shape (n + 1, 6), written over.
    """
    turn_through(rate, force, bias, step_s, turns, out)
    out[RATE_SPREAD], out[FORCE_SPREAD] = spread(rate), spread(force)
    field_of(field, rate, bias, turns, delay_s, room, out)


@in_place
def headings_into(
    start: Quaternion, turns: Array, axis: Array, orientation: Array, heading: Array
) -> None:
    """Put the orientation after each sample, and the direction of a body axis, in the last two.

    ``turns`` are as those of :func:`sum_up`.
    """
    ahead = (axis[0], axis[1], axis[2])
    for i in range(len(turns)):
        now = times(start, held(turns[i, 0]))
        put(now, orientation[i])
        x, y, _ = rotated(now, ahead)
        heading[i] = math.atan2(y, x)


@compiled
def headings(start: Array, turns: Array, axis: Array) -> tuple[Array, Array]:
    """Return the orientation after each turn, (n, 4), and the direction of a body axis, (n,)."""
    orientation, heading = np.empty((len(turns), 4)), np.empty(len(turns))
    headings_into(held(start), turns.reshape(-1, 1, 4), axis, orientation, heading)
    return orientation, heading


@compiled
def due_places(
    time_ns: NDArray[np.int64], due_ns: int, every_ns: float, period_ns: float
) -> tuple[NDArray[np.int64], int]:
    """Return the samples at which something is due every so often, and when it is due next.

    ``due_ns`` is when that is first; -1 for the first sample.
    """
    found, count = np.empty(len(time_ns), np.int64), 0
    for i in range(len(time_ns)):
        if due_ns < 0 or time_ns[i] >= due_ns - period_ns / 2:
            found[count] = i
            count += 1
            due_ns = round(max(max(due_ns, 0), time_ns[i] - every_ns / 2) + every_ns)
    return found[:count], due_ns


@in_place
def look(
    state: Array,
    covariance: Array,
    compass: Compass,
    turned: Array,
    field: Vector,
    turned_rad: float,
    dt: float,
    p: Array,
    limits: Array,
    values: Array,
    room: Array,
) -> bool:
    """Test a frame's field and learn from it, in place; return whether it passes.

    ``values`` take what the tests look at; the others are as those of :func:`frames` and of
    :func:`learn_field`.
    """
    belief, fields, recent, counts = compass
    before, doubted = held(state), belief[DOUBTED] > 0.0
    sigma = p[DRIFT] * min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
    iron = (state[IRON], state[IRON + 1], state[IRON + 2])
    if doubted:
        iron = (belief[CLEAN], belief[CLEAN + 1], belief[CLEAN + 2])
    seen = without(iron, turned, field)
    tests(state[EARTH:RESTED], seen, sigma, recent, counts, dt, values)
    off = values[0] * TESLA
    values[7] = iron_change(state, covariance, turned, field, off, belief, room) / TESLA
    passed = passes(values, limits)
    said = (turned, field, seen, turned_rad, dt)
    learn_field(state, covariance, belief, fields, *said, passed, p, room)
    state[OFFSET] -= turn_about_vertical(before, held(state))
    return passed


@in_place
def go_on(
    start: Quaternion,
    said: Array,
    last: Array,
    turned: Array,
    state: Array,
    covariance: Array,
    dt: float,
    p: Array,
    room: Array,
) -> bool:
    """Go on to the end of a frame that says so, in place; return whether the sensor rests.

    Parameters
    ----------
    start, last
        Orientation at its start, and the turn from its end to there.
    said
        As laid out above.
    turned
        Takes what its mean turn makes of the body in the earth frame, shape (3, 3).
    state, covariance, p, room
        As laid out above.
    """
    axes = room[APART:GAIN, :3]
    axes[:] = 0.0
    add_matrix(start, 1.0, axes)
    for i in range(3):
        for k in range(3):
            turned[i, k] = 0.0
            for j in range(3):
                turned[i, k] += axes[i, j] * said[MEAN_TURN + 3 * j + k]
    bias = (state[BIAS], state[BIAS + 1], state[BIAS + 2])
    rate = (said[RATE], said[RATE + 1], said[RATE + 2])
    pushed = rotated(start, (said[FORCE], said[FORCE + 1], said[FORCE + 2]))
    predict(state, covariance, turned, pushed, last, said[FRAME_SPEED], dt, p)
    still = math.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2) < p[REST_RATE]
    still = still and said[RATE_SPREAD] < p[REST_SPREAD]
    still = still and said[FORCE_SPREAD] < p[REST_FORCE]
    resting = move(state, covariance, rate, still, dt, p, room)
    alone(state, turned, bias, rate, resting, dt)
    return resting


@in_place
def take_field(
    state: Array,
    covariance: Array,
    compass: Compass,
    turned: Array,
    field: Vector,
    said: Array,
    delay_s: float,
    dt: float,
    p: Array,
    limits: Array,
    told: Array,
    room: Array,
) -> None:
    """Let a frame's field be looked at, and tell of it what :func:`frames` does."""
    _, _, recent, counts = compass
    values, turned_rad = told[VALUES : VALUES + 8], said[FRAME_SPEED] * dt
    given = (turned, field, turned_rad, dt, p, limits, values, room)
    passed = look(state, covariance, compass, *given)
    if passed:
        state[DELAY] += said[CROSSWISE] + delay_s * said[ALONG]
        state[DELAY + 1] += said[ALONG]
    told[VALUES + 9] = recent[1, counts[1, 0] - 1]
    told[PASSED] = 1.0 if passed else 0.0


@in_place
def due(watched: Counts, passed: bool, tries: tuple[int, int, float]) -> bool:
    """Count a field; return whether so many failed that a calibration is to be tried."""
    every, least, failing = tries
    watched[0] += 1
    watched[1] += 0 if passed else 1
    now = watched[0] >= least and watched[0] % every == 0
    return bool(now and watched[1] >= failing * watched[0])


@compiled
def frames(
    rate: Array,
    force: Array,
    field: Array,
    length: int,
    state: Array,
    covariance: Array,
    compass: Compass,
    watched: Counts,
    tries: tuple[int, int, float],
    axis: Array,
    p: Array,
    limits: Array,
) -> tuple[int, Array, Array, Array]:
    """Filter frame after frame; state, covariance and the rest go on in place.

    It ends before a field where no reference is known, and after a frame at which a calibration is
    due.

    Parameters
    ----------
    rate, force, field
        Samples, shape (n, 3) each; the field is NaN where there is none.
    length
        Samples of a frame.
    state, covariance
        Of the filter, as laid out above.
    compass
        Belief and fields, as laid out above; norms and azimuths of the last
        frames, and how many there are and may be, as :func:`tests` has them.
    watched, tries
        Fields so far and those that failed; every how many, from how many on, and where what part
        of them failed a calibration is due.
    axis
        Whose heading is told, shape (3,).
    p, limits
        Settings as laid out there, and thresholds of the tests.

    Returns
    -------
    How many frames were gone on by, and of their samples orientation, shape (n, 4), and heading;
    and of each what is told of it, shape (frames, TOLD).
    """
    count, dt = len(rate) // length, length * p[STEP]
    orientation, heading = np.empty((count * length, 4)), np.empty(count * length)
    told, turned = np.full((count, TOLD), np.nan), np.empty((3, 3))
    said, turns, each = np.empty(FRAME), np.empty((length, 2, 4)), np.empty((length + 1, 6))
    room = np.empty((ROOM, SIZE))
    for f in range(count):
        part, start, row = slice(f * length, (f + 1) * length), held(state), told[f]
        delay_s, bias = state[DELAY] / state[DELAY + 1], state[BIAS:IRON]
        sum_up(rate[part], force[part], field[part], bias, delay_s, p[STEP], turns, each, said)
        earth = rotated(start, (said[FIELD], said[FIELD + 1], said[FIELD + 2]))
        sees = math.isfinite(earth[0] + earth[1] + earth[2])
        if sees and math.isnan(state[EARTH]):
            return f, orientation, heading, told
        headings_into(start, turns, axis, orientation[part], heading[part])
        row[SIGMA] = min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
        row[VALUES + 8], row[PASSED] = state[OFFSET], 1.0
        resting = go_on(start, said, turns[length - 1, 0], turned, state, covariance, dt, p, room)
        row[RESTING] = 1.0 if resting else 0.0
        if sees:
            given = (turned, earth, said, delay_s, dt, p, limits, row, room)
            take_field(state, covariance, compass, *given)
        for k in (VALUES + 8, VALUES + 9):
            row[k] = math.degrees(wrap_angle(heading[f * length] + row[k]))
        for k in range(3):
            row[TOLD_BIAS + k] = state[BIAS + k]
        if sees and due(watched, row[PASSED] > 0.0, tries):
            return f + 1, orientation, heading, told
    return count, orientation, heading, told


TESLA = 1e-6
#: A field must not change the tilt; and the earth's field only where it is surely that.
TILT = np.isin(np.arange(SIZE), [0, 1, 3, 4, 5])
TILT_AND_EARTH = np.isin(np.arange(SIZE), [0, 1, 3, 4, 5, 12, 13])
_TWO_PI = 2.0 * math.pi


@in_place
def wrap_angle(angle: float) -> float:
    """Return an angle within [-pi, pi)."""
    return (angle + math.pi) % _TWO_PI - math.pi


@in_place
def turn_about_vertical(before: Quaternion, after: Quaternion) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    w = after[0] * before[0] + after[1] * before[1] + after[2] * before[2] + after[3] * before[3]
    z = -after[0] * before[3] - after[1] * before[2] + after[2] * before[1] + after[3] * before[0]
    return wrap_angle(2.0 * math.atan2(z, w))


@in_place
def keep(values: Array, counts: NDArray[np.int64], row: int, value: float) -> None:
    """Add a value to those of a row, and drop the oldest where there are too many."""
    count, most = counts[row, 0], counts[row, 1]
    if count == most:
        for k in range(1, most):
            values[row, k - 1] = values[row, k]
        count -= 1
    values[row, count] = value
    counts[row, 0] = count + 1


@in_place
def total(values: Array, count: int, column: int) -> float:
    """Return the sum of the first few values of a column."""
    summed = 0.0
    for i in range(count):
        summed += values[i, column]
    return summed


@in_place
def deviation(values: Array, count: int, column: int) -> float:
    """Return the standard deviation of the first few values of a column."""
    mean, square = total(values, count, column) / count, 0.0
    for i in range(count):
        square += (values[i, column] - mean) * (values[i, column] - mean)
    return math.sqrt(square / count)


@in_place
def tests(
    earth: Array,
    seen: Vector,
    sigma: float,
    recent: Array,
    counts: NDArray[np.int64],
    length_s: float,
    out: Array,
) -> None:
    """Put what the tests but the last look at in ``out``; ``seen`` is the field, earth frame.

    ``earth`` is the earth's field, north and up, ``sigma`` how far the azimuth may be off.
    Norms and azimuths of the last frames are ``recent``, shape (2, m), and how many there are and
    may be ``counts``, shape (2, 2).
    """
    flat = math.hypot(seen[0], seen[1])
    norm = math.sqrt(seen[0] * seen[0] + seen[1] * seen[1] + seen[2] * seen[2])
    north, up = earth[0], earth[1]
    turned = math.atan2(seen[0], seen[1])
    left = math.copysign(max(abs(turned) - sigma, 0.0), turned)
    x, y, z = flat * math.sin(left), flat * math.cos(left) - north, seen[2] - up
    keep(recent, counts, 0, norm)
    keep(recent, counts, 1, turned)
    count = counts[1, 0]
    changed = math.degrees(wrap_angle(recent[1, count - 1] - recent[1, 0]))
    out[0] = math.sqrt(x * x + y * y + z * z) / TESLA
    out[1] = abs(norm - math.hypot(north, up)) / TESLA
    out[2] = deviation(recent.T, counts[0, 0], 0) / TESLA
    out[3] = abs(flat - north) / TESLA
    out[4] = abs(math.degrees(left))
    out[5] = abs(changed) / (count * length_s)
    out[6] = abs(math.degrees(math.atan2(-seen[2], flat) - math.atan2(-up, north)))


@in_place
def passes(values: Array, limits: Array) -> bool:
    """Return whether all tests pass, their values as they are stored."""
    passed = 0
    for k in range(len(limits)):
        if limits[k] - np.float64(np.float32(values[k])) >= 0.0:
            passed += 1
    return passed == len(limits)


@in_place
def without(iron: Vector, turned: Array, field: Vector) -> Vector:
    """Return a field in the earth frame without that of iron on the sensor, shape (3,).

    ``turned``, shape (3, 3), is what the frame's mean turn makes of it there.
    """
    x, y, z = iron
    return (
        field[0] - (turned[0, 0] * x + turned[0, 1] * y + turned[0, 2] * z),
        field[1] - (turned[1, 0] * x + turned[1, 1] * y + turned[1, 2] * z),
        field[2] - (turned[2, 0] * x + turned[2, 1] * y + turned[2, 2] * z),
    )


@in_place
def seen_by_field(turned: Array, seen: Vector, pick: Array) -> None:
    """Put what a field in the earth frame, the sensor's iron taken out, sees of the errors in one.

    That is ``pick``, shape (3, SIZE); ``turned`` is as that of :func:`without`.
    """
    pick[:] = 0.0
    for i in range(3):
        for k in range(3):
            pick[i, 9 + k] = -turned[i, k]
    x, y, z = seen
    pick[0, 1], pick[0, 2], pick[1, 0] = z, -y, -z
    pick[1, 2], pick[2, 0], pick[2, 1] = x, y, -x
    pick[1, 12] = pick[2, 13] = -1.0


@in_place
def correct_field(
    state: Array,
    covariance: Array,
    turned: Array,
    field: Vector,
    variance: float,
    earth: bool,
    room: Array,
) -> None:
    """Turn towards north by a field, earth frame; ``earth``: it may correct the earth's as well.

    ``turned`` is as that of :func:`without`.
    """
    x, y, z = without((state[IRON], state[IRON + 1], state[IRON + 2]), turned, field)
    innovation = (-x, state[EARTH] - y, state[EARTH + 1] - z)
    pick = room[SEES:ACROSS]
    seen_by_field(turned, (x, y, z), pick)
    update(state, covariance, pick, innovation, variance, TILT if earth else TILT_AND_EARTH, room)


#: Places in a belief: whether there is another one than the clean one; frames in a row that speak
#: for the clean one and for other iron; how far the sensor turned while the reference passed; how
#: many fields are watched because they may be the place's; the clean iron, and its covariance.
DOUBTED, FOR_CLEAN, FOR_IRON, VERIFIED, WATCHED, CLEAN, SPREAD, BELIEF = 0, 1, 2, 3, 4, 5, 8, 17
#: So many frames in a row must be explained by the learned iron before it is believed in, and so
#: many better explained by the clean belief before it is dropped.
_TO_BELIEVE, _TO_CLEAN = 5, 2
#: What is left of a field when it is blamed on iron [T].
_BLAME_SIGMA_T = 2e-6
#: A field this far from what the learned iron explains says that it is not iron [T].
_CONSISTENT_T = 3e-6
#: Turning faster than this counts [rad/s]; so much of it makes a field known [s], [rad].
TURNING_RPS, LEAST_S, LEAST_RAD = 0.3, 10.0, 4 * math.pi
#: Norm and inclination hold still within these standard deviations [T], [rad].
STILL_T, STILL_RAD = 1.5e-6, math.radians(2.5)
#: Columns of a watched field: horizontal and vertical part, norm [T], inclination, turn [rad].
WATCH = 5


@in_place
def iron_change(
    state: Array,
    covariance: Array,
    turned: Array,
    field: Vector,
    off: float,
    belief: Array,
    room: Array,
) -> float:
    """Return how much the iron changed [T], 0 where that is no better explanation of a field.

    Parameters
    ----------
    turned, field
        As those of :func:`without`.
    off
        How far the field is from what the clean belief explains [T].
    """
    if belief[DOUBTED] == 0.0:
        return 0.0
    x, y, z = without((state[IRON], state[IRON + 1], state[IRON + 2]), turned, field)
    miss = math.sqrt(x * x + (state[EARTH] - y) ** 2 + (state[EARTH + 1] - z) ** 2)
    pick, across, trace = room[SEES:ACROSS], room[ACROSS:APART], 0.0
    seen_by_field(turned, (x, y, z), pick)
    product(pick, covariance, across)
    for a in range(3):
        for k in range(SIZE):
            trace += across[a, k] * pick[a, k]
    explained = miss <= _CONSISTENT_T + 2 * math.sqrt(trace / 3)
    belief[FOR_IRON] = belief[FOR_IRON] + 1 if explained else 0.0
    belief[FOR_CLEAN] = belief[FOR_CLEAN] + 1 if off < miss else 0.0
    if belief[FOR_IRON] < _TO_BELIEVE or belief[FOR_CLEAN] >= _TO_CLEAN:
        return 0.0
    change = 0.0
    for k in range(3):
        change += (state[IRON + k] - belief[CLEAN + k]) ** 2
    return math.sqrt(change)


@in_place
def come_clean(state: Array, covariance: Array, belief: Array) -> None:
    """Drop the belief in other iron, in place."""
    if belief[DOUBTED] == 0.0:
        return
    forget(covariance, 9, 3)
    for i in range(3):
        state[IRON + i] = belief[CLEAN + i]
        for k in range(3):
            covariance[9 + i, 9 + k] = belief[SPREAD + 3 * i + k]
    belief[DOUBTED] = belief[FOR_IRON] = belief[FOR_CLEAN] = 0.0


@in_place
def begin_doubt(state: Array, covariance: Array, belief: Array) -> None:
    """Keep the clean belief, where it is not kept yet; nothing speaks for one or the other."""
    if belief[DOUBTED] == 0.0:
        belief[DOUBTED] = 1.0
        for i in range(3):
            belief[CLEAN + i] = state[IRON + i]
            for k in range(3):
                belief[SPREAD + 3 * i + k] = covariance[9 + i, 9 + k]
    belief[FOR_CLEAN] = belief[FOR_IRON] = 0.0


@in_place
def blame_iron(
    state: Array, covariance: Array, turned: Array, field: Vector, sigma_t: float, room: Array
) -> None:
    """Explain a frame's field by iron alone, in place; it is known as well as orientation is."""
    north, up = state[EARTH], state[EARTH + 1]
    slope, across = room[SEES:ACROSS], room[ACROSS:APART]
    back, rest = room[APART:GAIN, :3], room[GAIN:CHANGE, :3]
    slope[:] = 0.0
    identity(back)
    for i in range(3):
        for k in range(3):
            rest[i, k] = turned[i, k]
    solve(rest, back)
    forget(covariance, 9, 3)
    for i in range(3):
        a, b, c = back[i, 0], back[i, 1], back[i, 2]
        state[IRON + i] = a * field[0] + b * (field[1] - north) + c * (field[2] - up)
        slope[i, 0], slope[i, 1], slope[i, 2] = c * north - b * up, a * up, -a * north
        slope[i, 12], slope[i, 13] = -b, -c
    product(slope, covariance, across)
    for i in range(3):
        for k in range(SIZE):
            covariance[9 + i, k] = covariance[k, 9 + i] = across[i, k]
    for i in range(3):
        for j in range(3):
            covariance[9 + i, 9 + j] = sigma_t**2 if i == j else 0.0
            for k in range(SIZE):
                covariance[9 + i, 9 + j] += across[i, k] * slope[j, k]


@in_place
def watch(belief: Array, fields: Array, seen: Vector, turned_rad: float, length_s: float) -> bool:
    """Take a field that failed, earth frame; return whether those watched are the place's.

    ``fields``, shape (m, WATCH), takes those in which the sensor turned.
    """
    if turned_rad < TURNING_RPS * length_s:
        return False
    flat, count = math.hypot(seen[0], seen[1]), int(belief[WATCHED])
    row = fields[count]
    row[0], row[1], row[4] = flat, seen[2], turned_rad
    row[2], row[3] = math.hypot(flat, seen[2]), math.atan2(seen[2], flat)
    count += 1
    if count * length_s > LEAST_S:
        for i in range(1, count):
            for k in range(WATCH):
                fields[i - 1, k] = fields[i, k]
        count -= 1
    elif count * length_s <= LEAST_S - length_s:
        belief[WATCHED] = count
        return False
    belief[WATCHED] = count
    still = deviation(fields, count, 2) < STILL_T and deviation(fields, count, 3) < STILL_RAD
    return still and total(fields, count, 4) >= LEAST_RAD


@in_place
def replace_reference(
    state: Array, covariance: Array, belief: Array, fields: Array, seen: Vector, p: Array
) -> None:
    """Take the watched fields for the place's, in place; face them where the one before failed."""
    verified, count = belief[VERIFIED] >= LEAST_RAD, int(belief[WATCHED])
    belief[VERIFIED], belief[WATCHED] = total(fields, count, 4), 0.0
    north, up = total(fields, count, 0) / count, total(fields, count, 1) / count
    take_earth(state, covariance, north, up, p[PLAIN_SIGMA])
    if not verified:
        face(state, covariance, seen, p[PLAIN_SIGMA], p[IRON_START])


@in_place
def learn_field(
    state: Array,
    covariance: Array,
    belief: Array,
    fields: Array,
    turned: Array,
    field: Vector,
    seen: Vector,
    turned_rad: float,
    length_s: float,
    undisturbed: bool,
    p: Array,
    room: Array,
) -> None:
    """Correct the attitude by a frame's field, as iron on the sensor where it is disturbed.

    Parameters
    ----------
    state, covariance, belief, fields
        Go on in place; as laid out above.
    turned, field
        As those of :func:`without`; ``seen`` is what that makes of the field
        by the clean belief.
    turned_rad, length_s
        How far the sensor turned in the frame, and its length.
    room
        As laid out above, written over.
    """
    doubted = belief[DOUBTED] > 0.0
    some_iron = belief[FOR_IRON] > 0.0
    undecided = some_iron and belief[FOR_IRON] < _TO_BELIEVE and belief[FOR_CLEAN] < _TO_CLEAN
    if undisturbed and doubted and undecided:
        # both beliefs explain it: neither is dropped, and the clean one learns nothing wrong
        correct_field(state, covariance, turned, field, p[FIELD_SIGMA] ** 2, False, room)
    elif undisturbed:
        belief[VERIFIED] += turned_rad
        belief[WATCHED] = 0.0
        come_clean(state, covariance, belief)
        correct_field(state, covariance, turned, field, p[FIELD_SIGMA] ** 2, True, room)
    elif watch(belief, fields, seen, turned_rad, length_s):
        replace_reference(state, covariance, belief, fields, seen, p)
        come_clean(state, covariance, belief)
    elif doubted and some_iron:
        correct_field(state, covariance, turned, field, p[FIELD_SIGMA] ** 2, False, room)
    else:
        begin_doubt(state, covariance, belief)
        blame_iron(state, covariance, turned, field, _BLAME_SIGMA_T, room)


@compiled
def far_apart(fields: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
    """Return which fields, shape (n, 3), are farther than ``least`` from the last that was.

    The first one is; the distance is that of the component that differs most.
    """
    far, last = np.zeros(len(fields), np.bool_), 0
    for i in range(len(fields)):
        off = 0.0
        for k in range(3):
            off = max(off, abs(fields[i, k] - fields[last, k]))
        far[i] = i == 0 or off > least
        last = i if far[i] else last
    return far
