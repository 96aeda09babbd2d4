"""The filter of dead reckoning over many steps, and the smoothing of its track, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..heading.compass_kernels import wrapped
from ..heading.rotation_kernels import carry, identity
from ..inertial.smoothing_kernels import gain_of, gain_room

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Times = NDArray[np.int64]
    Columns = tuple[Times, NDArray[np.bool_], Array, Array, Array, Array, Array]
    Noise = tuple[float, float, float, float]

SIZE = 6
#: Rows of the state: offset, its drift, mount, scale.
OFFSET, DRIFT, MOUNT, SCALE = 2, 3, 4, 5
#: Columns of a stride: length, heading, what the compass says as an offset, its deviation and how
#: many in a row err alike, how long the sensor has rested since the step before.
LENGTH, HEADING, SEEN, SIGMA, REPEATS, RESTED, STRIDE = range(7)
#: Random walk of the gyroscope's heading [rad/sqrt(s)].
GYRO_WALK = math.radians(0.3)
#: What a second at rest leaves of a gyroscope's bias [rad/s]; falls with the root of the time.
REST_DRIFT = 0.0016
#: An azimuth further off than this, in standard deviations, loses weight.
CLEAR = 2.0


@in_place
def rest(state: Array, covariance: Array, rested_s: float, drift: float) -> None:
    """Take it, in place, that the gyroscope was zeroed at rest; ``drift`` is its at the start."""
    state[DRIFT] = 0.0
    for k in range(SIZE):
        covariance[DRIFT, k] = covariance[k, DRIFT] = 0.0
    covariance[DRIFT, DRIFT] = min(drift, REST_DRIFT / math.sqrt(rested_s)) ** 2


@in_place
def wait(
    state: Array, covariance: Array, elapsed_s: float, wander: float, step: Array, room: Array
) -> None:
    """Let time pass, in place; ``step`` takes the transition. ``wander`` is the noise's [rad].

    The room, shape (2, SIZE, SIZE), is written over, as that of the others.
    """
    identity(step)
    step[OFFSET, DRIFT] = elapsed_s
    state[OFFSET] += elapsed_s * state[DRIFT]
    carry(step, covariance, room)
    covariance[OFFSET, OFFSET] += GYRO_WALK**2 * elapsed_s + wander**2


@in_place
def go(
    state: Array,
    covariance: Array,
    length_m: float,
    heading_rad: float,
    error: float,
    way: float,
    step: Array,
    room: Array,
) -> None:
    """Go a step, in place; ``step`` takes the transition.

    Parameters
    ----------
    state, covariance
        Go on in place.
    length_m, heading_rad
        As measured; the state scales and turns them.
    error, way
        Deviation of a length, as a part, and of the azimuth [rad].
    step
        Takes the transition.
    """
    azimuth = heading_rad + (state[OFFSET] + state[MOUNT])
    length = length_m * math.exp(state[SCALE])
    ahead = (math.cos(azimuth), math.sin(azimuth))
    aside = (-ahead[1], ahead[0])
    identity(step)
    for i in range(2):
        step[i, OFFSET] = step[i, MOUNT] = length * aside[i]
        step[i, SCALE] = length * ahead[i]
        state[i] += length * ahead[i]
    carry(step, covariance, room)
    along, across = (error * length) ** 2, (way * length) ** 2
    for i in range(2):
        for k in range(2):
            covariance[i, k] += ahead[i] * along * ahead[k] + aside[i] * across * aside[k]


@in_place
def sight(
    state: Array,
    covariance: Array,
    offset_rad: float,
    sigma_rad: float,
    repeats: float,
    room: Array,
) -> None:
    """Take a magnetic azimuth in, in place, as the offset it asks for."""
    off, known = wrapped(offset_rad - state[OFFSET]), covariance[OFFSET, OFFSET]
    variance = sigma_rad**2 * max(repeats, 1.0)
    variance *= max(1.0, abs(off) / CLEAR / math.sqrt(sigma_rad**2 + known)) ** 2
    row, gain = room[0, 0], room[0, 1]
    for i in range(SIZE):
        row[i], gain[i] = covariance[OFFSET, i], covariance[i, OFFSET] / (known + variance)
    for i in range(SIZE):
        state[i] += gain[i] * off
        for k in range(SIZE):
            covariance[i, k] -= gain[i] * row[k]


@in_place
def turn_place(state: Array, origin: Array, angle_rad: float) -> None:
    """Turn the place of a state about another place, shape (2,), and its offset with it."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    x, y = state[0] - origin[0], state[1] - origin[1]
    state[0], state[1] = origin[0] + cos * x - sin * y, origin[1] + sin * x + cos * y
    state[OFFSET] += angle_rad


@in_place
def turn_errors(matrix: Array, angle_rad: float) -> None:
    """Turn the places of both errors that a matrix is about, shape (SIZE, SIZE)."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    for k in range(SIZE):
        x, y = matrix[0, k], matrix[1, k]
        matrix[0, k], matrix[1, k] = cos * x - sin * y, sin * x + cos * y
    for i in range(SIZE):
        x, y = matrix[i, 0], matrix[i, 1]
        matrix[i, 0], matrix[i, 1] = cos * x - sin * y, sin * x + cos * y


@in_place
def turn(
    state: Array, covariance: Array, origin: Array, angle_rad: float, knots: Columns, count: int
) -> None:
    """Turn a walk so far about its beginning, in place, and all knots of it.

    A filter that is lost is turned towards the first thing that tells a direction: far from it
    nothing could be linearised.
    """
    _, _, predicted, predicted_spread, pose, spread, transition = knots
    turn_place(state, origin, angle_rad)
    turn_errors(covariance, angle_rad)
    for i in range(count):
        turn_place(predicted[i], origin, angle_rad)
        turn_place(pose[i], origin, angle_rad)
        turn_errors(predicted_spread[i], angle_rad)
        turn_errors(spread[i], angle_rad)
        turn_errors(transition[i], angle_rad)


@compiled
def strides(
    state: Array,
    covariance: Array,
    origin: Array,
    times: Times,
    rows: Array,
    turn_rad: float,
    lost_rad: float,
    noise: Noise,
    knots: Columns,
    count: int,
    ns_per_s: int,
) -> None:
    """Go steps, in place; one that is lost is turned first where the compass says something.

    Parameters
    ----------
    state, covariance
        Go on in place.
    origin
        Where the walk began, shape (2,).
    times, rows
        When steps end, shape (n,), and what is known of them, shape (n, STRIDE); SEEN is NaN where
        the compass says nothing.
    turn_rad
        The way ahead against the axis whose heading they have.
    lost_rad
        Standard deviation of an offset that is not known at all.
    noise
        Drift, wander, and the errors of length and way.
    knots, count
        Columns, as :class:`.knots.Knots` has them, which take two knots of each step, and how many
        there are.
    ns_per_s
        Of all times.
    """
    time_ns, shown, predicted, predicted_spread, pose, spread, transition = knots
    drift, wander, error, way = noise
    room = np.empty((2, SIZE, SIZE))
    for i in range(len(times)):
        row, at, repeats = rows[i], count + 2 * i, rows[i, REPEATS]
        seen = not math.isnan(row[SEEN])
        if seen and covariance[OFFSET, OFFSET] > lost_rad**2:
            turn(state, covariance, origin, row[SEEN] - state[OFFSET], knots, at)
            repeats = 1.0
        if row[RESTED] > 0:
            rest(state, covariance, row[RESTED], drift)
        elapsed_s = max(0, times[i] - time_ns[at - 1]) / ns_per_s
        wait(state, covariance, elapsed_s, wander, transition[at], room)
        if row[RESTED] > 0:
            transition[at, :, DRIFT] = 0.0
        predicted[at], predicted_spread[at] = state, covariance
        if seen:
            sight(state, covariance, row[SEEN], row[SIGMA], repeats, room)
        pose[at], spread[at] = state, covariance
        heading_rad = row[HEADING] + turn_rad
        go(state, covariance, row[LENGTH], heading_rad, error, way, transition[at + 1], room)
        predicted[at + 1], predicted_spread[at + 1] = state, covariance
        pose[at + 1], spread[at + 1] = state, covariance
        time_ns[at] = time_ns[at + 1] = times[i]
        shown[at], shown[at + 1] = False, True


@compiled
def smooth(
    predicted: Array, predicted_spread: Array, pose: Array, spread: Array, transition: Array
) -> tuple[Array, Array]:
    """Return state and covariance at each knot as all knots tell them, (n, 6) and (n, 6, 6)."""
    poses, spreads = pose.copy(), spread.copy()
    off, apart, room = np.empty(SIZE), np.empty((SIZE, SIZE)), np.empty((2, SIZE, SIZE))
    gain, rooms = np.empty((SIZE, SIZE)), gain_room(SIZE)
    for i in range(len(pose) - 2, -1, -1):
        gain_of(spread[i], transition[i + 1], predicted_spread[i + 1], rooms, gain)
        for r in range(SIZE):
            off[r] = poses[i + 1, r] - predicted[i + 1, r]
            for k in range(SIZE):
                apart[r, k] = spreads[i + 1, r, k] - predicted_spread[i + 1, r, k]
        carry(gain, apart, room)
        spreads[i] += apart
        for r in range(SIZE):
            for k in range(SIZE):
                poses[i, r] += gain[r, k] * off[k]
    return poses, spreads
