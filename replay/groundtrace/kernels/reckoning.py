"""Dead reckoning over many steps in one call, and its smoothing: a Kalman filter of 6 states.

The states are the position [m], the offset of the gyroscope's heading [rad] and its drift [rad/s],
the angle from the sensor's axis to the way [rad], and the logarithm of the scale of all lengths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from numba import float64, from_dtype, int64, void

from .algebra import copy_matrix, propagate_covariance, rts_gain
from .compiling import compiled, inlined, record

if TYPE_CHECKING:
    from .algebra import Array

#: How many rows the state has; of them: offset, its drift, mount, scale. Source: definition.
SIZE = 6
OFFSET, DRIFT, MOUNT, SCALE = 2, 3, 4, 5
#: Random walk of the gyroscope's heading [rad/sqrt(s)]. Chosen by judgement: of cheap sensors.
HEADING_WALK = math.radians(0.3)
#: What a second at rest leaves of a gyroscope's bias [rad/s]; falls with the root of the
#: time. Chosen by judgement: the noise of a cheap gyroscope over a second.
REST_DRIFT = 0.0016
#: An azimuth further off than this, in standard deviations, loses weight. Chosen by
#: judgement: one of twenty does by chance.
CLEAR = 2.0


#: A moment of a track: when, whether a point lies there, the state before the measurements there
#: and the covariance of its error, the same after them, and the transition from the knot before.
KNOT = record(
    ("time_ns", "i8"),
    ("shown", "i8"),
    ("predicted", "f8", SIZE),
    ("predicted_covariance", "f8", (SIZE, SIZE)),
    ("state", "f8", SIZE),
    ("covariance", "f8", (SIZE, SIZE)),
    ("transition", "f8", (SIZE, SIZE)),
)
#: A step: when it ends, its length [m] and heading by the gyroscope [rad]; the offset that the
#: compass asks for and its deviation [rad], NaN where it says nothing, and how many in a row err
#: alike; how long the sensor has rested since the step before [s], and the variance of how far it
#: may have turned since then beside what its samples say [rad2].
STRIDE = record(
    ("time_ns", "i8"),
    ("length_m", "f8"),
    ("heading_rad", "f8"),
    ("offset_rad", "f8"),
    ("sigma_rad", "f8"),
    ("repeats", "f8"),
    ("rested_s", "f8"),
    ("unseen_rad2", "f8"),
)
#: Deviations: the gyroscope's drift at the start [rad/s], its wander from step to step [rad], a
#: length, as a part, and the azimuth of a step [rad].
NOISE = record(("drift", "f8"), ("wander", "f8"), ("length", "f8"), ("way", "f8"))
_KNOT, _STRIDE, _NOISE = from_dtype(KNOT), from_dtype(STRIDE), from_dtype(NOISE)
_STATE, _MATRIX, _ROOM = float64[::1], float64[:, ::1], float64[:, :, ::1]


@compiled(void(_STATE, _MATRIX, float64, float64))
def zero_drift(state: Array, covariance: Array, rested_s: float, drift: float) -> None:
    """Take it that the gyroscope was zeroed at rest; ``drift`` is its deviation at the start."""
    state[DRIFT] = 0.0
    for k in range(SIZE):
        covariance[DRIFT, k] = covariance[k, DRIFT] = 0.0
    covariance[DRIFT, DRIFT] = min(drift, REST_DRIFT / math.sqrt(rested_s)) ** 2


@inlined
def identity(out: Array) -> None:
    """Make a matrix, shape (6, 6), the identity."""
    for i in range(SIZE):
        for k in range(SIZE):
            out[i, k] = 1.0 if i == k else 0.0


@compiled(void(_STATE, _MATRIX, float64, float64, _ROOM))
def wait(state: Array, covariance: Array, elapsed_s: float, wander: float, room: Array) -> None:
    """Let time pass: the offset drifts, and walks. The room takes the transition first.

    The room, shape (3, 6, 6), is written over.
    """
    step = room[0]
    identity(step)
    step[OFFSET, DRIFT] = elapsed_s
    state[OFFSET] += elapsed_s * state[DRIFT]
    propagate_covariance(step, covariance, room[1], room[2])
    covariance[OFFSET, OFFSET] += HEADING_WALK**2 * elapsed_s + wander**2


@compiled(void(_STATE, _MATRIX, float64, float64, _NOISE, _ROOM))
def advance(
    state: Array, covariance: Array, length_m: float, heading_rad: float, noise: Any, room: Array
) -> None:
    """Go a step: the position moves by length * exp(scale) along heading + offset + mount.

    The room, shape (3, 6, 6), is written over; it takes the transition first.
    """
    step, azimuth = room[0], heading_rad + (state[OFFSET] + state[MOUNT])
    length = length_m * math.exp(state[SCALE])
    ahead = (math.cos(azimuth), math.sin(azimuth))
    aside = (-ahead[1], ahead[0])
    identity(step)
    for i in range(2):
        step[i, OFFSET] = step[i, MOUNT] = length * aside[i]
        step[i, SCALE] = length * ahead[i]
        state[i] += length * ahead[i]
    propagate_covariance(step, covariance, room[1], room[2])
    along, across = (noise.length * length) ** 2, (noise.way * length) ** 2
    for i in range(2):
        for k in range(2):
            covariance[i, k] += ahead[i] * along * ahead[k] + aside[i] * across * aside[k]


@compiled(void(_STATE, _MATRIX, float64, float64, float64, _ROOM))
def azimuth_update(
    state: Array,
    covariance: Array,
    offset_rad: float,
    sigma_rad: float,
    repeats: float,
    room: Array,
) -> None:
    """Take in a magnetic azimuth, as the offset it asks for; one that is far off weighs less.

    The room, shape (3, 6, 6), is written over.
    """
    off = (offset_rad - state[OFFSET] + math.pi) % (2.0 * math.pi) - math.pi
    variance_before, row, gain = covariance[OFFSET, OFFSET], room[0, 0], room[0, 1]
    variance = sigma_rad**2 * max(repeats, 1.0)
    variance *= max(1.0, abs(off) / CLEAR / math.sqrt(sigma_rad**2 + variance_before)) ** 2
    for i in range(SIZE):
        row[i], gain[i] = (
            covariance[OFFSET, i],
            covariance[i, OFFSET] / (variance_before + variance),
        )
    for i in range(SIZE):
        state[i] += gain[i] * off
        for k in range(SIZE):
            covariance[i, k] -= gain[i] * row[k]


@inlined
def turn_position(state: Array, origin: Array, angle_rad: float) -> None:
    """Turn the position of a state about another one, and its offset with it."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    x, y = state[0] - origin[0], state[1] - origin[1]
    state[0], state[1] = origin[0] + cos * x - sin * y, origin[1] + sin * x + cos * y
    state[OFFSET] += angle_rad


@inlined
def turn_errors(matrix: Array, angle_rad: float) -> None:
    """Turn the positions of both errors that a matrix is about, shape (6, 6)."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    for k in range(SIZE):
        x, y = matrix[0, k], matrix[1, k]
        matrix[0, k], matrix[1, k] = cos * x - sin * y, sin * x + cos * y
    for i in range(SIZE):
        x, y = matrix[i, 0], matrix[i, 1]
        matrix[i, 0], matrix[i, 1] = cos * x - sin * y, sin * x + cos * y


@compiled(void(_STATE, _MATRIX, _STATE, float64, _KNOT[::1]))
def turn_track(
    state: Array, covariance: Array, origin: Array, angle_rad: float, knots: Any
) -> None:
    """Turn a walk so far about its beginning, and all knots of it.

    A filter that is lost is turned towards the first thing that tells a direction: far from it
    nothing could be linearised.
    """
    turn_position(state, origin, angle_rad)
    turn_errors(covariance, angle_rad)
    for i in range(len(knots)):
        turn_position(knots[i].predicted, origin, angle_rad)
        turn_position(knots[i].state, origin, angle_rad)
        turn_errors(knots[i].predicted_covariance, angle_rad)
        turn_errors(knots[i].covariance, angle_rad)
        turn_errors(knots[i].transition, angle_rad)


@inlined
def keep(knot: Any, time_ns: int, shown: int, state: Array, covariance: Array) -> None:
    """Put in a knot when it is, and the state as after the measurements there."""
    knot.time_ns, knot.shown = time_ns, shown
    for k in range(SIZE):
        knot.state[k] = state[k]
    copy_matrix(covariance, knot.covariance)


@inlined
def predict(knot: Any, state: Array, covariance: Array, step: Array) -> None:
    """Put the state as predicted, and the transition to there, in a knot."""
    for k in range(SIZE):
        knot.predicted[k] = state[k]
    copy_matrix(covariance, knot.predicted_covariance)
    copy_matrix(step, knot.transition)


@compiled(
    void(
        *(_STATE, _MATRIX, _STATE, _STRIDE[::1], float64, float64, _NOISE, _KNOT[::1], int64),
        *(int64, _ROOM),
    )
)
def reckon(
    state: Array,
    covariance: Array,
    origin: Array,
    strides: Any,
    turn_rad: float,
    lost_rad: float,
    noise: Any,
    knots: Any,
    count: int,
    ns_per_s: int,
    room: Array,
) -> None:
    """Go steps; a walk that is lost is turned first where the compass says something.

    Parameters
    ----------
    state, covariance
        Go on in place.
    origin
        Where the walk began, shape (2,).
    strides
        The steps, as :data:`STRIDE` names what is known of them.
    turn_rad
        The way ahead against the axis whose heading they have.
    lost_rad
        Standard deviation of an offset that is not known at all.
    noise
        As :data:`NOISE` names it.
    knots, count
        Take two knots of each step, and how many there are before.
    ns_per_s
        Of all times.
    room
        Shape (3, 6, 6), written over.
    """
    step = room[0]
    for i in range(len(strides)):
        stride, at = strides[i], count + 2 * i
        repeats, seen = stride.repeats, not math.isnan(stride.offset_rad)
        if seen and covariance[OFFSET, OFFSET] > lost_rad**2:
            angle_rad, repeats = stride.offset_rad - state[OFFSET], 1.0
            turn_track(state, covariance, origin, angle_rad, knots[:at])
        if stride.rested_s > 0:
            zero_drift(state, covariance, stride.rested_s, noise.drift)
        elapsed_s = max(0, stride.time_ns - knots[at - 1].time_ns) / ns_per_s
        wait(state, covariance, elapsed_s, noise.wander, room)
        covariance[OFFSET, OFFSET] += stride.unseen_rad2
        if stride.rested_s > 0:
            for k in range(SIZE):
                step[k, DRIFT] = 0.0
        predict(knots[at], state, covariance, step)
        if seen:
            sight = (stride.offset_rad, stride.sigma_rad, repeats)
            azimuth_update(state, covariance, *sight, room)
        keep(knots[at], stride.time_ns, 0, state, covariance)
        heading_rad = stride.heading_rad + turn_rad
        advance(state, covariance, stride.length_m, heading_rad, noise, room)
        predict(knots[at + 1], state, covariance, step)
        keep(knots[at + 1], stride.time_ns, 1, state, covariance)


@compiled(void(_KNOT[::1], _ROOM))
def smooth(knots: Any, room: Array) -> None:
    """Smooth knots backward (RTS), in place: x = x + G (x' - x_p'), P = P + G (P' - P_p') G'.

    The gain G is P F' P_p'^-1; what is marked ' is of the knot after, p what was predicted there.
    The last knot is as it is. The room, shape (6, 6, 6), is written over.
    """
    gain, off = room[3], room[4]
    for i in range(len(knots) - 2, -1, -1):
        knot, later = knots[i], knots[i + 1]
        wide = later.predicted_covariance
        rts_gain(knot.covariance, later.transition, wide, room[0], room[1], room[2, 0], gain)
        for r in range(SIZE):
            for k in range(SIZE):
                off[r, k] = later.covariance[r, k] - wide[r, k]
        propagate_covariance(gain, off, room[0], room[1])
        for r in range(SIZE):
            for k in range(SIZE):
                knot.covariance[r, k] += off[r, k]
                knot.state[r] += gain[r, k] * (later.state[k] - later.predicted[k])
