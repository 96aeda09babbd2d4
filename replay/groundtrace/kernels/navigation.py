"""Navigation of a foot, and its smoothing: an error-state Kalman filter of 15 states.

The error state is a rotation in the earth frame, errors of velocity and position, and of the biases
of gyroscope and accelerometer. The loop goes on as :class:`.inertial.ins.InsTrajectory` does
segment by segment, where nothing has to be decided: the foot is under way, or goes on standing.

A finished walk is smoothed: every time is estimated from all stances after it as well. Source: H.
E. Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic systems, AIAA
Journal 3 (1965), for the error state: what is smoothed is the difference from the pose that was
predicted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from numba import float64, from_dtype, int64, void
from numba.types import UniTuple

from .algebra import (
    add_rotation_matrix,
    add_variances,
    copy_matrix,
    kalman_gain,
    product,
    propagate_covariance,
    put_normalised,
    quaternion,
    quaternion_product,
    rotate,
    rotation_of,
    rts_gain,
    squared_distance,
)
from .compiling import compiled, inlined, record

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .algebra import Array

#: Rows of the error state; places in a pose: orientation, velocity, position, biases of gyroscope
#: and accelerometer. Source: definition.
SIZE = 15
VELOCITY, POSITION, GYRO_BIAS, FORCE_BIAS, POSE = 4, 7, 10, 13, 16

#: Shapes. Source: definition.
_MATRIX, _ROWS = (SIZE, SIZE), (3, SIZE)
#: What the filter knows: the pose, the covariance of its error, the transition of errors since the
#: last knot, clocks, whether the foot stands, when the last point of the track was, and the fastest
#: since the foot stood. Of the stance under way: the mean rate of its last segment, and the sum and
#: the squares of all such. Of the segment gone on by last: its transition, the velocity gained, and
#: how far it turned and was pushed. The others are written over.
STATE = record(
    ("pose", "f8", POSE),
    ("covariance", "f8", _MATRIX),
    ("transition", "f8", _MATRIX),
    ("stood_s", "f8"),
    ("swung_s", "f8"),
    ("still_s", "f8"),
    ("stands", "i8"),
    ("pointed_ns", "i8"),
    ("fastest_mps", "f8"),
    ("rate", "f8", 3),
    ("rate_sum", "f8", 3),
    ("rate_square", "f8"),
    ("step", "f8", _MATRIX),
    ("gained", "f8", 3),
    ("turned_rad", "f8"),
    ("pushed_mps", "f8"),
    ("half", "f8", _MATRIX),
    ("across", "f8", _MATRIX),
    ("gain", "f8", _ROWS),
    ("spread", "f8", (3, 3)),
    ("axes", "f8", (3, 3)),
    ("middle", "f8", 4),
)
#: Noise, as :class:`.inertial.strapdown.SensorNoise` explains it, and parameters of the navigator.
SETTINGS = record(
    ("gyro_walk", "f8"),
    ("force_walk", "f8"),
    ("gyro_scale", "f8"),
    ("force_scale", "f8"),
    ("gyro_bias_walk", "f8"),
    ("force_bias_walk", "f8"),
    ("gravity_mps2", "f8"),
    ("sure", "f8"),
    ("share", "f8"),
    ("sole_m", "f8"),
    ("still_mps", "f8"),
    ("still_radps", "f8"),
    ("rest_s", "f8"),
    ("lost_s", "f8"),
    ("lost_mps", "f8"),
    ("correlation_s", "f8"),
    ("rest_correlation_s", "f8"),
    ("missed_part", "f8"),
    ("missed_sigma", "f8"),
    ("point_ns", "f8"),
    ("keep_all", "i8"),
)
#: A moment of the walk: when, whether a point of the track lies there, the pose before the
#: measurements there and the covariance of its error, the same after them, and the transition of
#: errors from the knot before.
KNOT = record(
    ("time_ns", "i8"),
    ("shown", "i8"),
    ("predicted", "f8", POSE),
    ("predicted_covariance", "f8", _MATRIX),
    ("pose", "f8", POSE),
    ("covariance", "f8", _MATRIX),
    ("transition", "f8", _MATRIX),
)
#: What is known of an axis of the gyroscope, upward and downward: its highest value so far, and of
#: the run of samples near that under way the lowest value, the step into it, and the count.
PLATEAUS = record(
    ("highest", "f8", (3, 2)),
    ("lowest", "f8", (3, 2)),
    ("entered", "f8", (3, 2)),
    ("count", "i8", (3, 2)),
    ("last", "f8", 3),
    ("began", "i8"),
)
_STATE, _SETTINGS, _KNOT = from_dtype(STATE), from_dtype(SETTINGS), from_dtype(KNOT)
_PLATEAUS = from_dtype(PLATEAUS)
_SAMPLES, _VALUES = float64[:, ::1], float64[::1]
_PAIR = UniTuple(int64, 2)


@compiled(void(_SAMPLES, _PLATEAUS, float64, int64, float64, _SAMPLES, _VALUES))
def plateaus(
    rate: Array,
    state: Any,
    within: float,
    shortest: int,
    corner: float,
    missed: Array,
    samples: Array,
) -> None:
    """Find where a gyroscope was held at its limit, and about how much of a turn it missed.

    A plateau is a run of samples near an axis's extreme so far, with steps into and out of it that
    are steep for its length. A parabola that goes through both flanks, of steps a and b a sample,
    encloses n^2 / 3 * ab / (a + b) over n samples.

    Parameters
    ----------
    rate
        Shape (n, 3) [rad/s].
    state
        Goes on from run to run.
    within
        A sample is near the extreme from ``1 - within`` of it on.
    shortest
        Samples of a plateau, at least.
    corner
        Its steps in those of a smooth top that stays near its extreme for as long, at least.
    missed, samples
        Take, at the sample after each plateau, its missed turn over the time between samples,
        shape (n, 3) [rad/s], and its samples, shape (n,); 0 elsewhere.
    """
    missed[:], samples[:] = 0.0, 0.0
    for i in range(len(rate)):
        for k in range(3):
            before = state.last[k] if state.began else rate[i, k]
            for side in range(2):
                sign = 1.0 - 2.0 * side
                now, count = sign * rate[i, k], state.count[k, side]
                highest = max(state.highest[k, side], now)
                near = highest * (1.0 - within)
                state.highest[k, side] = highest
                if now >= near and now > 0.0:
                    if count == 0 or state.lowest[k, side] < near:  # the extreme rose: anew
                        state.lowest[k, side], state.count[k, side] = now, 1
                        state.entered[k, side] = now - sign * before
                    else:
                        state.lowest[k, side] = min(state.lowest[k, side], now)
                        state.count[k, side] = count + 1
                    continue
                entered, left = state.entered[k, side], sign * before - now
                if (
                    count >= shortest
                    and min(entered, left) * count >= corner * 4 * within * highest
                ):
                    more = count * count / 3.0 * entered * left / (entered + left)
                    missed[i, k] += sign * more
                    samples[i] = max(samples[i], float(count))
                state.count[k, side] = 0
            state.last[k] = rate[i, k]
        state.began = 1


@compiled(void(_STATE, _VALUES, _SAMPLES, _SAMPLES, float64))
def strapdown(state: Any, interval_s: Array, rate: Array, force: Array, gravity: float) -> None:
    """Integrate a segment, rates and forces taken as straight between samples.

    With q the orientation and b the biases: q' = q exp((w - b) dt), v' = v + (q (f - b) - g) dt,
    and the position by the mean of the velocities. The orientation's length stays as it comes.

    Parameters
    ----------
    interval_s, rate, force
        Shapes (n,), (n + 1, 3), (n + 1, 3): the first sample is the last of the segment before.
    gravity
        Its acceleration [m/s2].
    """
    pose, gained = state.pose, state.gained
    u, v, w = pose[GYRO_BIAS], pose[GYRO_BIAS + 1], pose[GYRO_BIAS + 2]
    a, b, c = pose[FORCE_BIAS], pose[FORCE_BIAS + 1], pose[FORCE_BIAS + 2]
    state.turned_rad = state.pushed_mps = 0.0
    gained[:] = 0.0
    q = quaternion(pose)
    before = rotate(q, (force[0, 0] - a, force[0, 1] - b, force[0, 2] - c))
    for i in range(len(interval_s)):
        dt = interval_s[i]
        x = 0.5 * ((rate[i + 1, 0] - u) + (rate[i, 0] - u)) * dt
        y = 0.5 * ((rate[i + 1, 1] - v) + (rate[i, 1] - v)) * dt
        z = 0.5 * ((rate[i + 1, 2] - w) + (rate[i, 2] - w)) * dt
        state.turned_rad += math.sqrt(x * x + y * y + z * z)
        q = quaternion_product(q, rotation_of(x, y, z))
        now = rotate(q, (force[i + 1, 0] - a, force[i + 1, 1] - b, force[i + 1, 2] - c))
        square = 0.0
        for k in range(3):
            push = 0.5 * (now[k] + before[k]) * dt - (gravity * dt if k == 2 else 0.0)
            gained[k] += push
            pose[POSITION + k] += (pose[VELOCITY + k] + gained[k] - 0.5 * push) * dt
            square += push * push
        before = now
        state.pushed_mps += math.sqrt(square)
    pose[0], pose[1], pose[2], pose[3] = q
    for k in range(3):
        pose[VELOCITY + k] += gained[k]


@compiled(void(_STATE, float64, float64))
def error_transition(state: Any, length_s: float, gravity: float) -> None:
    """Put what an error before a short segment is after it in ``state.step``.

    With R the rotation matrix in its middle, f the mean force in the earth frame and T the length:
    rotation takes -R T of the gyroscope's bias; velocity takes -[f x] T of the rotation, and of the
    biases [f x] R T^2 / 2 and -R T; the position takes T of the velocity and their integrals.
    """
    out, axes, gained = state.step, state.axes, state.gained
    axes[:] = 0.0
    out[:] = 0.0
    for k in range(SIZE):
        out[k, k] = 1.0
    add_rotation_matrix(quaternion(state.middle), length_s, axes)
    x, y, z = gained[0], gained[1], gained[2] + gravity * length_s
    for k in range(3):
        a, b, c = axes[0, k], axes[1, k], axes[2, k]
        out[3, 9 + k] = 0.5 * (0.0 * a + -z * b + y * c)
        out[4, 9 + k] = 0.5 * (z * a + 0.0 * b + -x * c)
        out[5, 9 + k] = 0.5 * (-y * a + x * b + 0.0 * c)
    out[3, 1], out[3, 2], out[4, 0] = z, -y, -z
    out[4, 2], out[5, 0], out[5, 1] = x, y, -x
    for i in range(3):
        out[6 + i, 3 + i] = length_s
        for k in range(3):
            out[i, 9 + k] = out[3 + i, 12 + k] = -axes[i, k]
            out[6 + i, k] = 0.5 * length_s * out[3 + i, k]
            out[6 + i, 12 + k] = 0.5 * length_s * out[3 + i, 12 + k]
            out[6 + i, 9 + k] = length_s / 3.0 * out[3 + i, 9 + k]


@compiled(void(_STATE, _VALUES, float64, float64))
def add_missed_turn(state: Any, missed: Array, part: float, sigma: float) -> None:
    """Turn the pose by a part of what the gyroscope missed, and know it as much less well.

    Parameters
    ----------
    missed
        In the sensor's axes, shape (3,) [rad].
    part, sigma
        What of it is made good, and its standard deviation, both as parts of it.
    """
    axes = state.axes
    axes[:] = 0.0
    add_rotation_matrix(quaternion(state.pose), 1.0, axes)
    variances = ((sigma * missed[0]) ** 2, (sigma * missed[1]) ** 2, (sigma * missed[2]) ** 2)
    add_variances(state.covariance, 0, axes, variances)
    turn = rotation_of(part * missed[0], part * missed[1], part * missed[2])
    put_normalised(quaternion_product(quaternion(state.pose), turn), state.pose)


@compiled(void(_STATE, _VALUES))
def add_unseen_motion(state: Any, unseen: Array) -> None:
    """Know a pose less well for samples that were lost before it.

    Parameters
    ----------
    unseen
        Variances of turn and velocity along the sensor's axes, shape (6,) [rad2, m2/s2].
    """
    axes = state.axes
    axes[:] = 0.0
    add_rotation_matrix(quaternion(state.pose), 1.0, axes)
    add_variances(state.covariance, 0, axes, unseen[:3])
    add_variances(state.covariance, 3, axes, unseen[3:])


@compiled(void(_STATE, _VALUES, _SAMPLES, _SAMPLES, float64, _VALUES, _VALUES, _SETTINGS))
def propagate(
    state: Any,
    interval_s: Array,
    rate: Array,
    force: Array,
    length_s: float,
    missed: Array,
    unseen: Array,
    p: Any,
) -> None:
    """Go on by a segment of some length [s]: pose, P' = F P F' + Q, and transition since the knot.

    The samples are as those of :func:`strapdown`; what the gyroscope missed, and what lost samples
    leave unknown, is added at the end.
    """
    covariance, step, dt = state.covariance, state.step, length_s
    w, x, y, z = quaternion(state.pose)
    strapdown(state, interval_s, rate, force, p.gravity_mps2)
    a, b, c, d = quaternion(state.pose)
    put_normalised((0.5 * (w + a), 0.5 * (x + b), 0.5 * (y + c), 0.5 * (z + d)), state.middle)
    put_normalised((a, b, c, d), state.pose)
    error_transition(state, dt, p.gravity_mps2)
    propagate_covariance(step, covariance, state.half, state.across)
    speed = p.force_walk**2 * dt + p.force_scale**2 * state.pushed_mps
    for i in range(3):
        covariance[i, i] += p.gyro_walk**2 * dt + p.gyro_scale**2 * state.turned_rad
        covariance[3 + i, 3 + i] += speed
        covariance[6 + i, 6 + i] += speed * dt**2 / 3
        covariance[9 + i, 9 + i] += p.gyro_bias_walk**2 * dt
        covariance[12 + i, 12 + i] += p.force_bias_walk**2 * dt
    if missed[0] != 0.0 or missed[1] != 0.0 or missed[2] != 0.0:
        add_missed_turn(state, missed, p.missed_part, p.missed_sigma)
    if unseen.any():
        add_unseen_motion(state, unseen)
    product(step, state.transition, state.half)
    copy_matrix(state.half, state.transition)


@inlined
def add_error(pose: Array, error: Array) -> None:
    """Add an error state, shape (15,), to a pose in place."""
    turn = rotation_of(error[0], error[1], error[2])
    put_normalised(quaternion_product(turn, quaternion(pose)), pose)
    for k in range(3, SIZE):
        pose[k + 1] += error[k]


@inlined
def pose_error(pose: Array, other: Array, out: Array) -> None:
    """Put the error state that moves the ``other`` pose to a pose in ``out``, shape (15,)."""
    w, x, y, z = quaternion(other)
    rotation = quaternion_product(quaternion(pose), (w, -x, -y, -z))
    # small turns: twice the vector part, of the quaternion whose scalar part is positive
    sign = math.copysign(2.0, rotation[0])
    for k in range(3):
        out[k] = sign * rotation[k + 1]
    for k in range(3, SIZE):
        out[k] = pose[k + 1] - other[k + 1]


@compiled(void(_STATE, int64, float64, float64, float64, float64))
def state_update(state: Any, first: int, x: float, y: float, z: float, sigma: float) -> None:
    """Update by a measurement of three errors from ``first`` on, which have the values x, y, z.

    With H what picks them: K = P H' (H P H' + R)^-1, P' = P - K H P.
    """
    covariance, across, gain, spread = state.covariance, state.across, state.gain, state.spread
    change = state.half[0]
    for a in range(3):
        for k in range(SIZE):
            across[a, k] = covariance[first + a, k]
        for b in range(3):
            spread[a, b] = covariance[first + a, first + b] + (sigma * sigma if a == b else 0.0)
    kalman_gain(across, spread, gain)
    for i in range(SIZE):
        change[i] = gain[0, i] * x + gain[1, i] * y + gain[2, i] * z
        for j in range(i, SIZE):
            covariance[i, j] -= (
                gain[0, i] * across[0, j] + gain[1, i] * across[1, j] + gain[2, i] * across[2, j]
            )
        for j in range(i):
            covariance[i, j] = covariance[j, i]
    add_error(state.pose, change)


@compiled(void(_STATE, _SAMPLES, float64))
def stand_on(state: Any, rate: Array, length_s: float) -> None:
    """Count a segment of a stance, and the rates in it: mean and square of the means."""
    count, square = len(rate) - 1, 0.0
    for k in range(3):
        mean = 0.0
        for i in range(1, len(rate)):
            mean += rate[i, k] / count
        state.rate[k] = mean
        state.rate_sum[k] += mean * length_s
        square += mean * mean
    state.rate_square += square * length_s
    state.stood_s += length_s


@compiled(void(_STATE))
def end_stance(state: Any) -> None:
    """Begin to count anew how long the foot stands, and how it turns meanwhile."""
    state.stands, state.stood_s, state.rate_square = 0, 0.0, 0.0
    state.rate_sum[:] = 0.0


@compiled(void(_STATE, float64))
def swing_on(state: Any, length_s: float) -> None:
    """Count a segment of a swing, and how fast the foot moves at its end."""
    x, y, z = state.pose[VELOCITY], state.pose[VELOCITY + 1], state.pose[VELOCITY + 2]
    state.swung_s += length_s
    state.fastest_mps = max(state.fastest_mps, math.sqrt(x * x + y * y + z * z))


@compiled(void(_STATE, _SAMPLES, float64, _SETTINGS))
def stance_update(state: Any, rate: Array, length_s: float, p: Any) -> None:
    """Take it that the foot stands in a segment just predicted: velocity and, at rest, rate are 0.

    How sure it is of its velocity depends on how fast it rolls over the sole. When a stance becomes
    a rest, the mean rate of all of it so far is the gyroscope's bias; then that of each segment.
    """
    pose, square, before_s = state.pose, 0.0, state.stood_s
    u, v, w, count = pose[GYRO_BIAS], pose[GYRO_BIAS + 1], pose[GYRO_BIAS + 2], len(rate) - 1
    for i in range(1, len(rate)):
        square += (rate[i, 0] - u) ** 2
        square += (rate[i, 1] - v) ** 2
        square += (rate[i, 2] - w) ** 2
    lasting = math.sqrt(max(1.0, p.correlation_s / length_s))
    sigma = math.hypot(p.still_mps, p.sole_m * math.sqrt(square / count)) * lasting
    state_update(state, 3, -pose[VELOCITY], -pose[VELOCITY + 1], -pose[VELOCITY + 2], sigma)
    state.swung_s = state.fastest_mps = 0.0
    stand_on(state, rate, length_s)
    if state.stood_s < p.rest_s:
        return
    x, y, z = state.rate[0], state.rate[1], state.rate[2]
    if before_s < p.rest_s:
        length_s, part = state.stood_s, 1.0 / state.stood_s
        x, y, z = (
            part * state.rate_sum[0],
            part * state.rate_sum[1],
            part * state.rate_sum[2],
        )
        square = max(part * state.rate_square - (x * x + y * y + z * z), 0.0)
    x, y, z = x - pose[GYRO_BIAS], y - pose[GYRO_BIAS + 1], z - pose[GYRO_BIAS + 2]
    if before_s >= p.rest_s:
        square = x * x + y * y + z * z
    lasting = math.sqrt(max(1.0, p.rest_correlation_s / length_s))
    state_update(state, 9, x, y, z, math.hypot(p.still_radps, math.sqrt(square)) * lasting)


@compiled(void(_STATE, float64))
def doubt(state: Any, sigma: float) -> None:
    """Be less sure of everything where the velocity contradicts one of 0, known to ``sigma`` [m/s].

    Where the two are further apart than both together explain, the covariance is scaled by the
    excess: the normalised square of their difference over the 3 expected of three values. The
    velocity then corrects tilt, heading and place as well, as far as errors of these
    have made it, and each of them says how far it may be off. Source: covariance inflation, as in
    Anderson, Monthly Weather Review 129 (2001).
    """
    covariance, spread, pose = state.covariance, state.spread, state.pose
    for a in range(3):
        for b in range(3):
            spread[a, b] = covariance[3 + a, 3 + b] + (sigma * sigma if a == b else 0.0)
    seen = squared_distance(spread, pose[VELOCITY], pose[VELOCITY + 1], pose[VELOCITY + 2])
    excess = seen / 3.0
    if excess > 1.0:
        for i in range(SIZE):
            for k in range(SIZE):
                covariance[i, k] *= excess


@compiled(void(_STATE, float64))
def speed_update(state: Any, sigma: float) -> None:
    """Update by a velocity of 0, known to ``sigma`` [m/s]."""
    x, y, z = state.pose[VELOCITY], state.pose[VELOCITY + 1], state.pose[VELOCITY + 2]
    state_update(state, 3, -x, -y, -z, sigma)


@compiled(
    _PAIR(
        *(int64, int64[::1], _SAMPLES, _SAMPLES, _SAMPLES, _VALUES, _VALUES, _VALUES),
        *(_SAMPLES, _SAMPLES, _STATE, _SETTINGS, _KNOT[::1]),
    )
)
def navigate(
    at: int,
    time_ns: NDArray[np.int64],
    interval_s: Array,
    rate: Array,
    force: Array,
    statistic: Array,
    peak: Array,
    length_s: Array,
    missed: Array,
    unseen: Array,
    state: Any,
    p: Any,
    knots: Any,
) -> tuple[int, int]:
    """Navigate from segment ``at`` on, until it is to be decided whether a stance begins.

    It also ends where there is no room for more knots.

    Parameters
    ----------
    time_ns, interval_s, rate, force, statistic, peak, length_s, missed, unseen
        Segments, as :class:`.inertial.strapdown.SegmentRun` has them.
    state, p
        Of the walk; the state goes on in place.
    knots
        Takes the moments that are kept.

    Returns
    -------
    The segment that was not gone on by, and the number of knots.
    """
    samples, count = interval_s.shape[1], 0
    while at < len(time_ns) and count < len(knots):
        still = statistic[at] <= max(p.sure, p.share * peak[at])
        if still and not state.stands:
            break
        first, last, length = at * samples, (at + 1) * samples + 1, length_s[at]
        parts = (interval_s[at], rate[first:last], force[first:last])
        propagate(state, *parts, length, missed[at], unseen[at], p)
        if not still:
            end_stance(state)
            swing_on(state, length)
            state.still_s = 0.0
        lost = state.swung_s >= p.lost_s  # no swing is so long
        if lost:
            doubt(state, p.lost_mps)
        is_point = time_ns[at] - state.pointed_ns >= p.point_ns
        knot = knots[count]
        for k in range(POSE):
            knot.predicted[k] = state.pose[k]
        copy_matrix(state.covariance, knot.predicted_covariance)
        if still:
            stance_update(state, rate[first:last], length, p)
        elif lost:
            speed_update(state, p.lost_mps)
            state.swung_s = 0.0
        if is_point or ((still or lost) and p.keep_all):
            knot.time_ns, knot.shown = time_ns[at], 1 if is_point else 0
            for k in range(POSE):
                knot.pose[k] = state.pose[k]
            copy_matrix(state.covariance, knot.covariance)
            copy_matrix(state.transition, knot.transition)
            count += 1
        if is_point or still or lost:
            state.transition[:] = 0.0
            for k in range(SIZE):
                state.transition[k, k] = 1.0
        if is_point:
            state.pointed_ns = time_ns[at]
        at += 1
    return at, count


@compiled(void(_KNOT[::1], _KNOT, _STATE, _SAMPLES, _SAMPLES))
def smooth(knots: Any, later: Any, state: Any, poses: Array, planar: Array) -> None:
    """Smooth knots backward (RTS): x = x + G (x' - x_p'), P = P + G (P' - P_p') G'.

    The gain G is P F' P_p'^-1; what is marked ' is of the knot after, p what was predicted there.

    Parameters
    ----------
    knots, later
        The knots, and the one after the last of them.
    state
        Pose and covariance of that one, smoothed; both go on in place, the rest is written over.
    poses, planar
        Take those of the knots, shape (n, 16), and their covariances' planar parts, shape (n, 3).
    """
    spread, gain, off = state.covariance, state.step, state.transition
    error, change = state.gain[0], state.gain[1]
    for i in range(len(knots) - 1, -1, -1):
        knot, wide = knots[i], later.predicted_covariance
        work = (state.half, state.across, state.gain[2])
        rts_gain(knot.covariance, later.transition, wide, *work, gain)
        pose_error(state.pose, later.predicted, error)
        for r in range(SIZE):
            change[r] = 0.0
            for k in range(SIZE):
                change[r] += gain[r, k] * error[k]
                off[r, k] = spread[r, k] - wide[r, k]
        for k in range(POSE):
            state.pose[k] = knot.pose[k]
        add_error(state.pose, change)
        propagate_covariance(gain, off, state.half, state.across)
        for r in range(SIZE):
            for k in range(SIZE):
                spread[r, k] = knot.covariance[r, k] + off[r, k]
        for k in range(POSE):
            poses[i, k] = state.pose[k]
        planar[i, 0], planar[i, 1], planar[i, 2] = spread[6, 6], spread[6, 7], spread[7, 7]
        later = knot
