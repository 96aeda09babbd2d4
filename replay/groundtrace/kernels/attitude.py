"""The heading filter over frames of about 0.1 s: an error-state Kalman filter of 14 states.

The error state is a rotation in the earth frame, the velocity about its mean, the gyroscope's bias,
the field of iron on the sensor (body frame), and the earth's field (north and up). What is done
with a field that fails its tests is rare, and stands in :mod:`.inertial.magnetometer`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import boolean, float64, from_dtype, int64, void
from numba.types import Array as ArrayType
from numba.types import UniTuple

from .algebra import (
    add_rotation_matrix,
    add_variances,
    kalman_gain,
    product,
    put_normalised,
    quaternion,
    quaternion_product,
    rotate,
    rotation_of,
    vector,
)
from .compiling import compiled, inlined, record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .algebra import Array, Quaternion, Vector

#: Rows of the error state, and the first of each of its parts. Source: definition.
SIZE = 14
ROTATION, VELOCITY, BIAS, IRON, EARTH = 0, 3, 6, 9, 12
#: Rows that a measurement must not change: a field must not change the tilt, and the earth's field
#: only where it is surely that. Source: definition.
NONE = np.zeros(SIZE, np.bool_)
TILT = np.isin(np.arange(SIZE), [0, 1, 3, 4, 5])
TILT_AND_EARTH = TILT | (np.arange(SIZE) >= EARTH)


#: What the filter knows; ``gyroscope`` is what the gyroscope alone would: its heading over that of
#: the filter, its bias as seen at rest, and in how many frames. ``delay_sums`` tell by how much the
#: field comes late; ``clean_iron`` is what is tested with where it is ``doubted`` that no iron was
#: added since; ``verified_rad`` is how far the sensor turned while the reference passed, ``fields``
#: how many of the last fields are known. The last are written over by each update: what it sees of
#: the errors H, H P, S, the gain, and the change.
STATE = record(
    ("orientation", "f8", 4),
    ("velocity", "f8", 3),
    ("gyro_bias", "f8", 3),
    ("hard_iron", "f8", 3),
    ("earth_field", "f8", 2),
    ("covariance", "f8", (SIZE, SIZE)),
    ("rested_s", "f8"),
    ("delay_sums", "f8", 2),
    ("gyroscope_offset_rad", "f8"),
    ("gyroscope_bias", "f8", 3),
    ("gyroscope_rests", "f8"),
    ("doubted", "i8"),
    ("clean_iron", "f8", 3),
    ("verified_rad", "f8"),
    ("fields", "i8"),
    ("seen", "f8", (3, SIZE)),
    ("across", "f8", (3, SIZE)),
    ("spread", "f8", (3, 3)),
    ("gain", "f8", (3, SIZE)),
    ("change", "f8", SIZE),
)
#: Noise and thresholds, as :class:`.inertial.attitude.AttitudeNoise` and the heading estimator
#: explain them.
SETTINGS = record(
    ("gyro_walk", "f8"),
    ("gyro_scale", "f8"),
    ("bias_walk", "f8"),
    ("force_walk", "f8"),
    ("iron_walk", "f8"),
    ("earth_walk", "f8"),
    ("speed_mps", "f8"),
    ("gravity_mps2", "f8"),
    ("rest_rate_left", "f8"),
    ("rest_rate", "f8"),
    ("rest_rate_spread", "f8"),
    ("rest_force_spread", "f8"),
    ("rest_s", "f8"),
    ("rest_speed_mps", "f8"),
    ("field_sigma_t", "f8"),
    ("drift_factor", "f8"),
    ("limits", "f8", 8),
    ("step_s", "f8"),
    ("deviation_frames", "i8"),
    ("derivative_frames", "i8"),
    ("gyroscope_heading", "i8"),
)
#: What a frame says, in the body axes at its start: matrix of its mean turn; means of specific
#: force and field there and of the rate in moving axes; root mean square rate; deviations of rate
#: and force from their means; sums that tell the field's delay; variances of turn and velocity by
#: straight lines between samples. Then the rotation matrix of its start, and in the earth frame the
#: mean turn, the field, and the field without that of the iron on the sensor; and what the field's
#: tests look at. The last is written over.
FRAME = record(
    ("mean_turn", "f8", (3, 3)),
    ("force", "f8", 3),
    ("field", "f8", 3),
    ("rate", "f8", 3),
    ("speed", "f8"),
    ("rate_spread", "f8"),
    ("force_spread", "f8"),
    ("delay_sums", "f8", 2),
    ("unseen", "f8", 6),
    ("axes", "f8", (3, 3)),
    ("earth_turn", "f8", (3, 3)),
    ("earth_field", "f8", 3),
    ("clean_field", "f8", 3),
    ("tests", "f8", 8),
    ("sums", "f8", 6),
)
#: What is told of a frame: heading's deviation at its start, whether the sensor rests, the bias,
#: what the tests look at, headings by gyroscope and compass over the filter's, whether the field
#: passed.
TOLD = record(
    ("sigma_rad", "f8"),
    ("resting", "f8"),
    ("gyro_bias", "f8", 3),
    ("tests", "f8", 8),
    ("gyroscope_rad", "f8"),
    ("compass_rad", "f8"),
    ("passed", "f8"),
)
_STATE, _SETTINGS, _FRAME = from_dtype(STATE), from_dtype(SETTINGS), from_dtype(FRAME)
_ROWS, _VALUES = float64[:, ::1], float64[::1]
_VECTOR, _QUATERNION = UniTuple(float64, 3), UniTuple(float64, 4)
_MASK = ArrayType(boolean, 1, "C", readonly=True)
#: A microtesla [T], and a full turn [rad]. Source: SI.
TESLA = 1e-6
_TWO_PI = 2.0 * math.pi


@inlined
def deviation(x: Array) -> float:
    """Return the root mean square deviation of vectors, shape (n, m), from their mean."""
    square = 0.0
    for k in range(x.shape[1]):
        mean = 0.0
        for i in range(x.shape[0]):
            mean += x[i, k]
        mean /= x.shape[0]
        for i in range(x.shape[0]):
            square += (x[i, k] - mean) * (x[i, k] - mean)
    return math.sqrt(square / x.shape[0])


@compiled(void(_ROWS, _ROWS, _ROWS, _VECTOR, float64, float64, _ROWS, _ROWS, _FRAME))
def integrate_frame(
    rate: Array,
    force: Array,
    field: Array,
    bias: Vector,
    delay_s: float,
    step_s: float,
    turns: Array,
    moved: Array,
    frame: Any,
) -> None:
    """Follow the gyroscope through a frame, and average what the sensors say in the frame's axes.

    Parameters
    ----------
    rate, force, field
        Samples, shape (n, 3) each.
    bias, delay_s
        Of the gyroscope [rad/s]; how much later than it the magnetometer answers [s].
    step_s
        Time between samples [s].
    turns
        Takes the rotations from the end of each sample's interval to the frame's start, (n, 4).
    moved
        Takes the field of each sample in the frame's axes, and how it would move there were it
        late, shape (n, 6).
    frame
        Takes the rest, as :data:`FRAME` says.
    """
    count, square, end = rate.shape[0], 0.0, (1.0, 0.0, 0.0, 0.0)
    mean_turn, sums = frame.mean_turn, frame.sums
    mean_turn[:] = 0.0
    sums[:] = 0.0
    for k in range(3):
        frame.force[k] = frame.rate[k] = 0.0
    for i in range(count):
        x, y, z = rate[i, 0] - bias[0], rate[i, 1] - bias[1], rate[i, 2] - bias[2]
        square += x * x + y * y + z * z
        half = rotation_of(0.5 * step_s * x, 0.5 * step_s * y, 0.5 * step_s * z)
        middle = quaternion_product(end, half)
        end = quaternion_product(middle, half)
        turns[i, 0], turns[i, 1], turns[i, 2], turns[i, 3] = end
        add_rotation_matrix(middle, 1.0 / count, mean_turn)
        pushed = rotate(middle, (force[i, 0], force[i, 1], force[i, 2]))
        # the field when the gyroscope said this; seen from here it changes by rate x field
        prompt = rotation_of(-delay_s * x, -delay_s * y, -delay_s * z)
        a, b, c = rotate(prompt, (field[i, 0], field[i, 1], field[i, 2]))
        still = rotate(middle, (a, b, c))
        change = rotate(middle, (y * c - z * b, z * a - x * c, x * b - y * a))
        for k in range(3):
            frame.force[k] += pushed[k] / count
            frame.rate[k] += rate[i, k] / count
            moved[i, k], moved[i, 3 + k] = still[k], change[k]
            sums[k] += still[k]
            sums[3 + k] += change[k]
    frame.speed = math.sqrt(square / count)
    frame.rate_spread, frame.force_spread = deviation(rate), deviation(force)
    frame.delay_sums[0] = frame.delay_sums[1] = 0.0
    for i in range(count):
        for k in range(3):
            off = moved[i, 3 + k] - sums[3 + k] / count
            frame.delay_sums[0] += off * (moved[i, k] - sums[k] / count)
            frame.delay_sums[1] += off * off
    for k in range(3):
        frame.field[k] = sums[k] / count


@compiled(void(_STATE, _VECTOR, float64, _MASK))
def measurement_update(
    state: Any, innovation: Vector, variance: float, frozen: NDArray[np.bool_]
) -> None:
    """Update by a measurement of three values that sees ``state.seen`` of the error state.

    With H what it sees, S = H P H' + R and K = P H' S^-1, the state is moved by K times the
    innovation, and P becomes (I - K H) P (I - K H)' + K R K'. Where no row is frozen that is
    P - K H P; rows of the state that are (Schmidt) have rows of K that are 0.

    Parameters
    ----------
    innovation
        The measurement less what was expected.
    variance
        Of each of its values, independent of each other.
    frozen
        Rows of the state that keep their estimate, shape (14,).
    """
    covariance, seen, across, gain = state.covariance, state.seen, state.across, state.gain
    spread, change = state.spread, state.change
    product(seen, covariance, across)
    for a in range(3):
        for b in range(3):
            spread[a, b] = variance if a == b else 0.0
            for k in range(SIZE):
                spread[a, b] += across[a, k] * seen[b, k]
    kalman_gain(across, spread, gain)
    for i in range(SIZE):
        if frozen[i]:
            gain[0, i] = gain[1, i] = gain[2, i] = 0.0
        change[i] = (
            gain[0, i] * innovation[0] + gain[1, i] * innovation[1] + gain[2, i] * innovation[2]
        )
    for i in range(SIZE):
        one, other = (across, gain) if frozen[i] else (gain, across)
        a, b, c = one[0, i], one[1, i], one[2, i]
        for j in range(i, SIZE):
            covariance[i, j] -= a * other[0, j] + b * other[1, j] + c * other[2, j]
        for j in range(i):
            covariance[i, j] = covariance[j, i]
    turn = rotation_of(change[0], change[1], change[2])
    put_normalised(quaternion_product(turn, quaternion(state.orientation)), state.orientation)
    for k in range(3):
        state.velocity[k] += change[VELOCITY + k]
        state.gyro_bias[k] += change[BIAS + k]
        state.hard_iron[k] += change[IRON + k]
    for k in range(2):
        state.earth_field[k] += change[EARTH + k]


@compiled(void(_STATE, _FRAME, _QUATERNION, float64, _SETTINGS))
def propagate(state: Any, frame: Any, last: Quaternion, length_s: float, p: Any) -> None:
    """Go on to the end of a frame: state and covariance, F P F' + Q.

    F takes ``dt earth_turn`` times the error of the bias from that of rotation, and
    ``dt [force x]`` times that of rotation from that of velocity.

    Parameters
    ----------
    frame
        As :func:`integrate_frame` has it; takes its turn in the earth frame.
    last
        Rotation from the frame's end to its start.
    length_s
        Of the frame [s].
    """
    covariance, dt, axes, rotation = state.covariance, length_s, frame.axes, frame.earth_turn
    start = quaternion(state.orientation)
    axes[:] = 0.0
    add_rotation_matrix(start, 1.0, axes)
    for i in range(3):
        for k in range(3):
            rotation[i, k] = 0.0
            for j in range(3):
                rotation[i, k] += axes[i, j] * frame.mean_turn[j, k]
    force = rotate(start, vector(frame.force))
    x, y, z = dt * force[0], dt * force[1], dt * force[2]
    for side in range(2):  # F P, then (F P) F'
        half = covariance.T if side else covariance[:, :]
        for j in range(SIZE):
            a, b, c = half[0, j], half[1, j], half[2, j]
            half[VELOCITY, j] += z * b - y * c
            half[VELOCITY + 1, j] += x * c - z * a
            half[VELOCITY + 2, j] += y * a - x * b
            u, v, w = half[BIAS, j], half[BIAS + 1, j], half[BIAS + 2, j]
            for i in range(3):
                half[i, j] -= dt * (rotation[i, 0] * u + rotation[i, 1] * v + rotation[i, 2] * w)
    for k in range(3):
        covariance[k, k] += p.gyro_walk**2 * dt + p.gyro_scale**2 * frame.speed * dt
        covariance[VELOCITY + k, VELOCITY + k] += p.force_walk**2 * dt
        covariance[BIAS + k, BIAS + k] += p.bias_walk**2 * dt
        covariance[IRON + k, IRON + k] += p.iron_walk**2 * dt
        state.velocity[k] += dt * (force[k] - (p.gravity_mps2 if k == 2 else 0.0))
    for k in range(EARTH, SIZE):
        covariance[k, k] += p.earth_walk**2 * dt
    if frame.unseen.any():
        add_variances(covariance, ROTATION, axes, frame.unseen[:3])
        add_variances(covariance, VELOCITY, axes, frame.unseen[3:])
    put_normalised(quaternion_product(start, last), state.orientation)


@compiled(float64(_STATE, _FRAME, float64, _SETTINGS))
def motion_update(state: Any, frame: Any, length_s: float, p: Any) -> float:
    """Hold the velocity near its mean and, at rest, the bias at the rate; return 1.0 at rest.

    The gyroscope alone goes on as well: its heading by the bias that was taken out of the frame.
    """
    covariance, seen, x, y, z = (
        state.covariance,
        state.seen,
        frame.rate[0],
        frame.rate[1],
        frame.rate[2],
    )
    bias, left = vector(state.gyro_bias), 0.0
    still = math.sqrt(x**2 + y**2 + z**2) < p.rest_rate
    still = still and frame.rate_spread < p.rest_rate_spread
    still = still and frame.force_spread < p.rest_force_spread
    state.rested_s = state.rested_s + length_s if still else 0.0
    resting = state.rested_s > p.rest_s
    if p.gyroscope_heading:  # a walker's velocity must not tell the heading
        for k in range(SIZE):
            covariance[2, k] = covariance[k, 2] = 0.0
    for first in (VELOCITY, BIAS):
        seen[:] = 0.0
        for k in range(3):
            seen[k, first + k] = 1.0
        u, v, w = vector(state.velocity)
        off, variance = (-u, -v, -w), p.speed_mps**2 * 2.0 / length_s
        if resting:
            variance = p.rest_speed_mps**2
        if first == BIAS:
            u, v, w = vector(state.gyro_bias)
            off, variance = (x - u, y - v, z - w), p.rest_rate_left**2
        if first == VELOCITY or resting:
            measurement_update(state, off, variance, NONE)
    for k in range(3):
        left += frame.earth_turn[2, k] * (bias[k] - state.gyroscope_bias[k])
    state.gyroscope_offset_rad += left * length_s
    if resting:
        state.gyroscope_rests += 1.0
        for k in range(3):
            away = frame.rate[k] - state.gyroscope_bias[k]
            state.gyroscope_bias[k] += away / state.gyroscope_rests
    return 1.0 if resting else 0.0


@compiled(_VECTOR(_STATE, _FRAME))
def field_innovation(state: Any, frame: Any) -> Vector:
    """Return the field that was expected less a frame's, and put what it sees in ``state.seen``.

    The field b = m - R i, what was measured less the iron's part, is expected to be (0, north, up):
    errors of rotation, iron and earth are seen by [b x], -R and -1.
    """
    seen, rotation, field = state.seen, frame.earth_turn, frame.earth_field
    a, b, c = vector(state.hard_iron)
    x = field[0] - (rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c)
    y = field[1] - (rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c)
    z = field[2] - (rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c)
    seen[:] = 0.0
    for i in range(3):
        for k in range(3):
            seen[i, IRON + k] = -rotation[i, k]
    seen[0, 1], seen[0, 2], seen[1, 0] = z, -y, -z
    seen[1, 2], seen[2, 0], seen[2, 1] = x, y, -x
    seen[1, EARTH] = seen[2, EARTH + 1] = -1.0
    return -x, state.earth_field[0] - y, state.earth_field[1] - z


@compiled(void(_STATE, _FRAME, _VALUES, _VALUES, float64, _SETTINGS))
def field_tests(
    state: Any, frame: Any, norms: Array, azimuths: Array, length_s: float, p: Any
) -> None:
    """Put what all tests of a frame's field but that of iron look at in the frame.

    Parameters
    ----------
    frame
        Takes the field without that of the iron, by the clean belief, too.
    norms, azimuths
        Of all fields so far, the last of which are set to those of this one [T], [rad].
    length_s
        Of the frame [s].
    """
    north, up, rotation = state.earth_field[0], state.earth_field[1], frame.earth_turn
    a, b, c = vector(state.clean_iron if state.doubted else state.hard_iron)
    for k in range(3):
        iron = rotation[k, 0] * a + rotation[k, 1] * b + rotation[k, 2] * c
        frame.clean_field[k] = frame.earth_field[k] - iron
    x, y, z = vector(frame.clean_field)
    sigma = p.drift_factor * min(math.sqrt(max(state.covariance[2, 2], 0.0)), math.pi)
    flat, azimuth = math.hypot(x, y), math.atan2(x, y)
    norms[-1], azimuths[-1] = math.sqrt(x * x + y * y + z * z), azimuth
    left = math.copysign(max(abs(azimuth) - sigma, 0.0), azimuth)
    x, y, u = flat * math.sin(left), flat * math.cos(left) - north, z - up
    norms, azimuths = norms[-p.deviation_frames :], azimuths[-p.derivative_frames :]
    out, mean, square = frame.tests, 0.0, 0.0
    for norm in norms:
        mean += norm
    mean /= len(norms)
    for norm in norms:
        square += (norm - mean) * (norm - mean)
    changed = (azimuth - azimuths[0] + math.pi) % _TWO_PI - math.pi
    out[0] = math.sqrt(x * x + y * y + u * u) / TESLA
    out[1] = abs(norms[-1] - math.hypot(north, up)) / TESLA
    out[2] = math.sqrt(square / len(norms)) / TESLA
    out[3] = abs(flat - north) / TESLA
    out[4] = abs(math.degrees(left))
    out[5] = abs(math.degrees(changed)) / (len(azimuths) * length_s)
    out[6] = abs(math.degrees(math.atan2(-z, flat) - math.atan2(-up, north)))
    out[7] = 0.0


@inlined
def turn_about_vertical(before: Quaternion, after: Quaternion) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    a, b, c, d = before
    w, x, y, z = after
    angle = 2.0 * math.atan2(-w * d - x * c + y * b + z * a, w * a + x * b + y * c + z * d)
    return (angle + math.pi) % _TWO_PI - math.pi


@inlined
def passes(tests: Array, limits: Array) -> bool:
    """Return whether no test is over its limit, as its value is stored (float32)."""
    passed = True
    for k in range(len(limits)):
        passed = passed and limits[k] - np.float64(np.float32(tests[k])) >= 0.0
    return passed


@compiled(
    int64(
        *(_ROWS, _ROWS, _ROWS, _ROWS, int64, int64, _STATE, _FRAME, _SETTINGS, _VALUES),
        *(_VALUES, _VALUES, _ROWS, _VALUES, from_dtype(TOLD)[::1]),
    )
)
def filter_frames(
    rate: Array,
    force: Array,
    field: Array,
    unseen: Array,
    length: int,
    first: int,
    state: Any,
    frame: Any,
    p: Any,
    axis: Array,
    norms: Array,
    azimuths: Array,
    orientation: Array,
    heading: Array,
    rows: Any,
) -> int:
    """Filter frame after frame, up to one whose field is to be judged.

    Such a field fails a test, or comes while it is doubted that the last ones were clean: nothing
    is learned of it here.

    Parameters
    ----------
    rate, force, field
        Samples, shape (n, 3) each; the field is NaN where there is none.
    unseen
        What straight lines between samples may be off in each frame: variances of turn and
        velocity, shape (n_frames, 6).
    length, first
        Samples of a frame, and the frame to begin with.
    state, p
        Of the filter; the state goes on in place.
    frame
        Takes what the last frame said.
    axis
        Whose heading is told, shape (3,).
    norms, azimuths
        Of the fields so far [T], [rad], with room for more.
    orientation, heading
        Take those of samples, shapes (n, 4) and (n,).
    rows
        Takes what is told of each frame.

    Returns
    -------
    The frame whose field is to be judged, or how many frames there are.
    """
    length_s = length * p.step_s
    turns, moved = np.empty((length, 4)), np.empty((length, 6))
    for f in range(first, len(rows)):
        start, stop, row = f * length, (f + 1) * length, rows[f]
        before, bias = quaternion(state.orientation), vector(state.gyro_bias)
        delay_s = state.delay_sums[0] / state.delay_sums[1]
        samples = (rate[start:stop], force[start:stop], field[start:stop])
        integrate_frame(*samples, bias, delay_s, p.step_s, turns, moved, frame)
        for i in range(length):
            rotation = quaternion_product(before, quaternion(turns[i]))
            x, y, _ = rotate(rotation, vector(axis))
            for k in range(4):
                orientation[start + i, k] = rotation[k]
            heading[start + i] = math.atan2(y, x)
        row.sigma_rad = min(math.sqrt(max(state.covariance[2, 2], 0.0)), math.pi)
        row.gyroscope_rad, row.passed = state.gyroscope_offset_rad, 1.0
        for k in range(6):
            frame.unseen[k] = unseen[f, k]
        propagate(state, frame, quaternion(turns[length - 1]), length_s, p)
        row.resting = motion_update(state, frame, length_s, p)
        x, y, z = rotate(before, vector(frame.field))
        if math.isfinite(x + y + z):
            frame.earth_field[0], frame.earth_field[1], frame.earth_field[2] = x, y, z
            state.fields += 1
            field_tests(state, frame, norms[: state.fields], azimuths[: state.fields], length_s, p)
            row.compass_rad = azimuths[state.fields - 1]
            for k in range(8):
                row.tests[k] = frame.tests[k]
            if state.doubted or not passes(frame.tests, p.limits):
                return f
            moved_from = quaternion(state.orientation)
            state.verified_rad += frame.speed * length_s
            measurement_update(state, field_innovation(state, frame), p.field_sigma_t**2, TILT)
            turn = turn_about_vertical(moved_from, quaternion(state.orientation))
            state.gyroscope_offset_rad -= turn
            state.delay_sums[0] += frame.delay_sums[0] + delay_s * frame.delay_sums[1]
            state.delay_sums[1] += frame.delay_sums[1]
        for k in range(3):
            row.gyro_bias[k] = state.gyro_bias[k]
    return len(rows)
