"""Navigation of a foot and dead reckoning, compiled: many segments or steps in one call.

They compute the same as :class:`.inertial.ins.InsTrajectory` and
:class:`.inertial.strapdown.ErrorStateFilter` segment by segment, where nothing has to be decided:
the foot is under way, or goes on standing.

A finished walk is smoothed: every time is estimated from all stances after it as well. Source: H.
E. Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic systems, AIAA
Journal 3 (1965), for the error state: what is smoothed is the difference from the pose that was
predicted.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .attitude import (
    add_matrix,
    carry,
    gains,
    held,
    identity,
    lessen,
    normalise,
    of_angles,
    product,
    put,
    rotated,
    times,
    turn_by,
    wrap_angle,
)
from .compiling import inlined as compiled
from .compiling import inlined as in_place
from .lanes import LANES, every, put_row, row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .attitude import Vector

    Array = NDArray[np.float64]
    Times = NDArray[np.int64]
    Columns = tuple[Times, NDArray[np.bool_], Array, Array, Array, Array, Array]
    Noise = tuple[float, float, float, float]

SIZE = 15
#: Rows of the error state that a measurement may not change: none.
NONE = np.zeros(SIZE, np.bool_)
#: Shape of the room that is written over.
ROOM_SHAPE = (3, SIZE, SIZE)
#: Places among the settings: noise, the navigator's parameters, and others.
(
    GYRO_WALK, FORCE_WALK, GYRO_SCALE, FORCE_SCALE, GYRO_BIAS_WALK, FORCE_BIAS_WALK,
    SURE, SHARE, SOLE, STILL_MPS, STILL_RADPS, REST_S, LOST_S, POINT_NS,
    CORRELATION_S, LOST_MPS, GRAVITY, ALL, SETTINGS,
) = range(19)  # fmt: skip
#: Most knots of one call: fresh memory for many costs more than what it takes to fill a few.
ROOM = 128
#: Places among the clocks: how long the foot stood, was under way, rested; whether it stands.
STOOD, SWUNG, RESTED, STANDS = range(4)


@in_place
def correct(
    pose: Array, covariance: Array, first: int, value: Vector, sigma: float, room: Array
) -> None:
    """Update, in place, by a measurement of three states from ``first`` on.

    The room, shape ROOM_SHAPE, is written over, as that of the others.
    """
    across, gain, spread, change = room[0, :3], room[0, 3:6], room[0, 6:9], room[0, 9]
    for a in range(3):
        for i in range(SIZE):
            across[a, i] = covariance[first + a, i]
        for b in range(3):
            spread[a, b] = across[a, first + b] + (sigma * sigma if a == b else 0.0)
    gains(across, spread, gain)
    lessen(covariance, across, gain, NONE)
    change[:] = 0.0
    for a in range(3):
        for i in range(SIZE):
            change[i] += gain[a, i] * value[a]
    move(pose, change)


@in_place
def move(pose: Array, error: Array) -> None:
    """Add an error state, shape (15,), to a pose in place."""
    turn_by(error, pose[:SPEED])
    for i in range(3, SIZE):
        pose[i + 1] += error[i]


@in_place
def predict(
    pose: Array,
    covariance: Array,
    since: Array,
    interval_s: Array,
    rate: Array,
    force: Array,
    length_s: float,
    p: Array,
    room: Array,
) -> None:
    """Go on by a segment, in place; ``since`` is the transition since the last knot."""
    step, moved = room[2], room[0, 0]
    integrate(pose, interval_s, rate, force, p[GRAVITY], moved)
    transition(pose, moved, length_s, p[GRAVITY], room[1], step)
    turned, pushed = moved[TURNED], moved[PUSHED]
    for k in range(GYRO):
        pose[k] = moved[k]
    normalise(pose[:SPEED])
    carry(step, covariance, room)
    speed = p[FORCE_WALK] ** 2 * length_s + p[FORCE_SCALE] ** 2 * pushed
    for i in range(3):
        covariance[i, i] += p[GYRO_WALK] ** 2 * length_s + p[GYRO_SCALE] ** 2 * turned
        covariance[3 + i, 3 + i] += speed
        covariance[6 + i, 6 + i] += speed * length_s**2 / 3
        covariance[9 + i, 9 + i] += p[GYRO_BIAS_WALK] ** 2 * length_s
        covariance[12 + i, 12 + i] += p[FORCE_BIAS_WALK] ** 2 * length_s
    product(step, since, room[0])
    for i in range(SIZE):
        for k in range(SIZE):
            since[i, k] = room[0, i, k]


@in_place
def lose_velocity(pose: Array, covariance: Array, sigma: float) -> None:
    """Give the velocity up, in place."""
    for i in range(3):
        pose[SPEED + i] = 0.0
        covariance[3 + i, :] = 0.0
        covariance[:, 3 + i] = 0.0
    for i in range(3):
        covariance[3 + i, 3 + i] = sigma * sigma


@in_place
def stand(
    pose: Array,
    covariance: Array,
    clocks: Array,
    rate: Array,
    length_s: float,
    p: Array,
    room: Array,
) -> None:
    """Take it, in place, that the foot stands in a segment that was just predicted."""
    square, mean = 0.0, room[1, 0]
    mean[:] = 0.0
    for i in range(1, len(rate)):
        for k in range(3):
            square += (rate[i, k] - pose[GYRO + k]) ** 2
            mean[k] += rate[i, k] / (len(rate) - 1)
    lasting = math.sqrt(max(1.0, p[CORRELATION_S] / length_s))
    rolling = p[SOLE] * math.sqrt(square / (len(rate) - 1))
    sigma = math.hypot(p[STILL_MPS], rolling) * lasting
    moving = (-pose[SPEED], -pose[SPEED + 1], -pose[SPEED + 2])
    correct(pose, covariance, 3, moving, sigma, room)
    clocks[STOOD] += length_s
    clocks[SWUNG] = 0.0
    if clocks[STOOD] >= p[REST_S]:
        off = (mean[0] - pose[GYRO], mean[1] - pose[GYRO + 1], mean[2] - pose[GYRO + 2])
        turning = off[0] * off[0] + off[1] * off[1] + off[2] * off[2]
        sigma = math.hypot(p[STILL_RADPS], math.sqrt(turning)) * lasting
        correct(pose, covariance, 9, off, sigma, room)


@in_place
def keep_clocks(
    pose: Array, covariance: Array, clocks: Array, still: bool, length_s: float, p: Array
) -> None:
    """Count, in place, how long the foot is under way; no swing is as long as it takes to lose."""
    if not still:
        clocks[STANDS] = clocks[STOOD] = 0.0
        clocks[SWUNG] += length_s
    if clocks[SWUNG] >= p[LOST_S]:
        lose_velocity(pose, covariance, p[LOST_MPS])
        clocks[SWUNG] = 0.0


@compiled
def walk(
    start: int,
    time_ns: NDArray[np.int64],
    interval_s: Array,
    rate: Array,
    force: Array,
    statistic: Array,
    peak: Array,
    length_s: Array,
    pose: Array,
    covariance: Array,
    since: Array,
    clocks: Array,
    pointed_ns: int,
    p: Array,
) -> tuple[int, int, NDArray[np.int64], NDArray[np.bool_], Array, Array, Array, Array, Array]:
    """Navigate from segment ``start`` on, in place, until something is to be decided.

    It also ends where there are :data:`ROOM` knots.

    Parameters
    ----------
    time_ns, interval_s, rate, force, statistic, peak, length_s
        Segments, as :class:`.inertial.strapdown.SegmentRun` has them.
    pose, covariance, since, clocks
        Of the walk, as laid out above; ``since`` is the transition since the last knot.
    pointed_ns
        When the last point of the track was.
    p
        Settings as laid out above.

    Returns
    -------
    The segment that was not gone on by; when the last point was; and the knots: time, whether
    shown, pose predicted, its covariance, pose, its covariance, transition from the knot before.
    """
    samples, most = interval_s.shape[1], min(len(time_ns) - start, ROOM)
    times, shown = np.empty(most, np.int64), np.empty(most, np.bool_)
    guesses, poses = np.empty((most, POSE)), np.empty((most, POSE))
    wide, spreads = np.empty((most, SIZE, SIZE)), np.empty((most, SIZE, SIZE))
    moves, count, at = np.empty((most, SIZE, SIZE)), 0, start
    room = np.empty(ROOM_SHAPE)
    while at < len(time_ns) and count < most:
        still = statistic[at] <= max(p[SURE], p[SHARE] * peak[at])
        if still and clocks[STANDS] == 0.0:
            break
        both, length = slice(at * samples, (at + 1) * samples + 1), length_s[at]
        predict(pose, covariance, since, interval_s[at], rate[both], force[both], length, p, room)
        rests = 1 / (1 + statistic[at]) >= 0.5
        clocks[RESTED] = clocks[RESTED] + length if rests else 0.0
        keep_clocks(pose, covariance, clocks, still, length, p)
        due = time_ns[at] - pointed_ns >= p[POINT_NS]
        guesses[count], wide[count] = pose, covariance
        if still:
            stand(pose, covariance, clocks, rate[both], length, p, room)
        if due or still:
            if due or p[ALL] > 0.0:
                times[count], shown[count], poses[count] = time_ns[at], due, pose
                spreads[count], moves[count] = covariance, since
                count += 1
            identity(since)
        if due:
            pointed_ns = time_ns[at]
        at += 1
    kept = (times[:count], shown[:count], guesses[:count], wide[:count], poses[:count])
    return at, pointed_ns, *kept, spreads[:count], moves[:count]


#: Columns of a pose: orientation, velocity, place, biases of gyroscope and accelerometer.
SPEED, PLACE, GYRO, FORCE, POSE = 4, 7, 10, 13, 16
#: Places in what is told of a segment, after orientation, velocity and place at its end: what was
#: gained of velocity, and how far it turned and was pushed.
GAINED, TURNED, PUSHED, MOVED = 10, 13, 14, 15


@in_place
def felt(sample: Array, bias: Array) -> Vector:
    """Return a sample less its bias, shape (3,) each."""
    return sample[0] - bias[0], sample[1] - bias[1], sample[2] - bias[2]


@in_place
def integrate(
    pose: Array, interval_s: Array, rate: Array, force: Array, gravity: float, out: Array
) -> None:
    """Go over a segment, rates and forces taken as straight between samples.

    Parameters
    ----------
    pose
        At its start, as :attr:`.inertial.strapdown.Pose.row`.
    interval_s, rate, force
        Shapes (n,), (n + 1, 3), (n + 1, 3).
    gravity
        Its acceleration [m/s2].
    out
        Takes orientation, velocity and place at its end, what was gained of velocity, and how far
        it turned and was pushed, in the places above.
    """
    q, velocity, there, gained = (
        held(pose),
        pose[SPEED:PLACE],
        out[PLACE:GAINED],
        out[GAINED:TURNED],
    )
    turned_rad, pushed_mps = 0.0, 0.0
    for k in range(3):
        there[k], gained[k] = pose[PLACE + k], 0.0
    before = rotated(q, felt(force[0], pose[FORCE:POSE]))
    for i in range(len(interval_s)):
        dt = interval_s[i]
        last, rates = felt(rate[i], pose[GYRO:FORCE]), felt(rate[i + 1], pose[GYRO:FORCE])
        x, y, z = (
            0.5 * (rates[0] + last[0]) * dt,
            0.5 * (rates[1] + last[1]) * dt,
            0.5 * (rates[2] + last[2]) * dt,
        )
        turned_rad += math.sqrt(x * x + y * y + z * z)
        q = times(q, of_angles(x, y, z))
        now = rotated(q, felt(force[i + 1], pose[FORCE:POSE]))
        size = 0.0
        for k in range(3):
            push = 0.5 * (now[k] + before[k]) * dt - (gravity * dt if k == 2 else 0.0)
            gained[k] += push
            there[k] += (velocity[k] + gained[k] - 0.5 * push) * dt
            size += push * push
        before = now
        pushed_mps += math.sqrt(size)
    put(q, out)
    for k in range(3):
        out[SPEED + k] = velocity[k] + gained[k]
    out[TURNED], out[PUSHED] = turned_rad, pushed_mps


@in_place
def transition(
    pose: Array, moved: Array, length_s: float, gravity: float, room: Array, out: Array
) -> None:
    """Put the transition of a short segment in ``out``, shape (15, 15).

    ``moved`` is what :func:`integrate` made of the pose; the room, shape (4, 4) or more, is written
    over.
    """
    middle, axes, gained = room[3], room[:3, :3], moved[GAINED:TURNED]
    identity(out)
    axes[:] = 0.0
    for k in range(4):
        middle[k] = 0.5 * (pose[k] + moved[k])
    normalise(middle)
    add_matrix(held(middle), length_s, axes)
    x, y, z = gained[0], gained[1], gained[2] + gravity * length_s
    force = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    for i in range(3):
        out[6 + i, 3 + i] = length_s
        for k in range(3):
            out[i, 9 + k] = -axes[i, k]
            out[3 + i, k] = -force[i][k]
            out[3 + i, 12 + k] = -axes[i, k]
            coupled = 0.0
            for j in range(3):
                coupled += force[i][j] * axes[j, k]
            out[3 + i, 9 + k] = 0.5 * coupled
            out[6 + i, k] = 0.5 * length_s * out[3 + i, k]
            out[6 + i, 12 + k] = 0.5 * length_s * out[3 + i, 12 + k]
            out[6 + i, 9 + k] = length_s / 3.0 * out[3 + i, 9 + k]


#: Least variance of a part of a state, where the others' are 1.
_KNOWN = 1e-12


@in_place
def error_between(pose: Array, other: Array, out: Array) -> None:
    """Put the error state that moves the ``other`` pose to a pose in ``out``, shape (15,)."""
    turned = times(held(pose), (other[0], -other[1], -other[2], -other[3]))
    # small turns: twice the vector part, of the quaternion whose scalar part is positive
    sign = math.copysign(2.0, turned[0])
    for i in range(3):
        out[i] = sign * turned[i + 1]
    for i in range(3, SIZE):
        out[i] = pose[i + 1] - other[i + 1]


@in_place
def factored(matrix: Array, least: float) -> None:
    """Put the upper factor U of a covariance U' U in its place; no pivot is below ``least``.

    Shape (n, m), m a multiple of LANES; what lies left of the factor's diagonal means nothing.
    """
    groups = matrix.shape[1] // LANES
    for i in range(len(matrix)):
        for g in range(i // LANES, groups):
            left = row(matrix, i * groups + g)
            for r in range(i):
                left = left - every(matrix[r, i]) * row(matrix, r * groups + g)
            put_row(matrix, i * groups + g, left)
        share = every(1.0 / math.sqrt(max(matrix[i, i], least)))
        for g in range(i // LANES, groups):
            put_row(matrix, i * groups + g, share * row(matrix, i * groups + g))


@in_place
def solve_factored(upper: Array, sides: Array) -> None:
    """Solve ``U' U x = sides`` in place, shapes (n, m) and (n, k), k a multiple of LANES."""
    n, groups = len(sides), sides.shape[1] // LANES
    for g in range(groups):
        for i in range(n):
            left = row(sides, i * groups + g)
            for r in range(i):
                left = left - every(upper[r, i]) * row(sides, r * groups + g)
            put_row(sides, i * groups + g, every(1.0 / upper[i, i]) * left)
        for i in range(n - 1, -1, -1):
            left = row(sides, i * groups + g)
            for r in range(i + 1, n):
                left = left - every(upper[i, r]) * row(sides, r * groups + g)
            put_row(sides, i * groups + g, every(1.0 / upper[i, i]) * left)


@compiled
def gain_room(n: int) -> Array:
    """Return what :func:`gain_of` writes over."""
    return np.zeros((2, n + 1, -(-n // LANES) * LANES))


@in_place
def gain_of(spread: Array, step: Array, predicted: Array, room: Array, gain: Array) -> None:
    """Put ``spread @ step.T`` times the inverse of ``predicted`` in ``gain``, shape (n, n).

    Rows of that matrix differ much.
    """
    n = len(spread)
    # the transpose of what is wanted
    sides, even, scale = room[0, :n], room[1, :n], room[0, n]
    product(step, spread, sides)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(max(predicted[i, i], 1e-30))
    for i in range(n):
        for k in range(n):
            even[i, k] = predicted[i, k] * scale[i] * scale[k]
            sides[i, k] *= scale[i]
        even[i, i] += _KNOWN  # the heading may be known exactly at the start
    factored(even, _KNOWN)
    solve_factored(even, sides)
    for i in range(n):
        for k in range(n):
            gain[k, i] = sides[i, k] * scale[i]


@compiled
def smooth(
    poses: Array,
    spreads: Array,
    guesses: Array,
    wide: Array,
    moves: Array,
    guess: Array,
    widest: Array,
    step: Array,
    pose: Array,
    spread: Array,
) -> tuple[Array, Array]:
    """Smooth knots backward; return their poses, shape (n, 16), and covariances' planar parts.

    Parameters
    ----------
    poses, spreads
        Of the knots, shapes (n, 16) and (n, 15, 15).
    guesses, wide, moves
        What was predicted of them, its covariance, and the transition to them.
    guess, widest, step
        The same of the knot after the last.
    pose, spread
        Of that knot, smoothed; both go on in place.
    """
    count = len(poses)
    found, planar = np.empty((count, POSE)), np.empty((count, 3))
    off, room, rooms = np.empty((SIZE, SIZE)), np.empty((2, SIZE, SIZE)), gain_room(SIZE)
    gain, error, change = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty(SIZE)
    for i in range(count - 1, -1, -1):
        gain_of(spreads[i], step, widest, rooms, gain)
        error_between(pose, guess, error)
        for r in range(SIZE):
            change[r] = 0.0
            for k in range(SIZE):
                change[r] += gain[r, k] * error[k]
                off[r, k] = spread[r, k] - widest[r, k]
        pose[:] = poses[i]
        move(pose, change)
        carry(gain, off, room)
        for r in range(SIZE):
            for k in range(SIZE):
                spread[r, k] = spreads[i, r, k] + off[r, k]
        found[i] = pose
        planar[i, 0], planar[i, 1], planar[i, 2] = spread[6, 6], spread[6, 7], spread[7, 7]
        guess, widest, step = guesses[i], wide[i], moves[i]
    return found, planar


_TWO_PI = 2.0 * math.pi


@compiled
def spread_of(x: Array) -> float:
    """Return the largest less the smallest value."""
    return float(x.max() - x.min())


@in_place
def rows_between(time_ns: Times, start_ns: int, stop_ns: int) -> tuple[int, int]:
    """Return first and last place plus one of samples in ``[start_ns, stop_ns)``.

    Where there is none it is those of one sample that is near.
    """
    first = min(int(np.searchsorted(time_ns, start_ns)), len(time_ns) - 1)
    return first, max(int(np.searchsorted(time_ns, stop_ns)), first + 1)


@compiled
def shape(
    time_ns: Times,
    acceleration: Array,
    start_ns: int,
    stop_ns: int,
    margin_ns: int,
    smooth_s: float,
) -> tuple[float, float]:
    """Return swing and rise of a step by its accelerations, shape (n, 3), the last of them upward.

    Averages over ``smooth_s`` reach as far as there are samples, up to ``margin_ns`` before and
    after the step, and count as nothing beyond. Without three samples both are 0.
    """
    begin, end = rows_between(time_ns, start_ns - margin_ns, stop_ns + margin_ns)
    time_ns, acceleration = time_ns[begin:end], acceleration[begin:end]
    n = len(time_ns)
    if n < 3:
        return 0.0, 0.0
    period_s = (time_ns[n - 1] - time_ns[0]) / 1e9 / (n - 1)
    width = max(1, round(smooth_s / period_s))
    later = (width - 1) // 2
    up, count, all_up = np.empty(n), 0, np.empty(n)
    for i in range(n):
        total = 0.0
        for k in range(max(0, i + later - width + 1), min(n, i + later + 1)):
            total += acceleration[k, 2] * (1 / width)
        all_up[i] = total
        first, last = time_ns[0] + margin_ns, time_ns[n - 1] - margin_ns
        if first <= time_ns[i] <= last:
            up[count] = total
            count += 1
    inside = up[:count] if count >= 3 else all_up
    speed = np.cumsum(inside - inside.mean()) * period_s
    height = np.cumsum(speed - speed.mean()) * period_s
    return spread_of(inside), spread_of(height)


@in_place
def mean_heading(
    time_ns: Times, orientation: Array, axis: Array, start_ns: int, stop_ns: int
) -> float:
    """Return the mean direction of a body axis in the horizontal plane, turns followed [rad]."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    ahead, total, before, turns = (axis[0], axis[1], axis[2]), 0.0, 0.0, 0.0
    for i in range(begin, end):
        x, y, _ = rotated(held(orientation[i]), ahead)
        angle = math.atan2(y, x)
        if i > begin:
            turns -= _TWO_PI * round((angle - before) / _TWO_PI)
        before = angle
        total += angle + turns
    return total / (end - begin)


@compiled
def mean_up(time_ns: Times, orientation: Array, start_ns: int, stop_ns: int) -> Vector:
    """Return which way up is in the axes of a body, on average."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    mean = np.zeros((3, 3))
    for i in range(begin, end):
        add_matrix(held(orientation[i]), 1.0 / (end - begin), mean)
    return mean[2, 0], mean[2, 1], mean[2, 2]


@in_place
def swing(values: Array, phase: Array) -> tuple[bool, complex, complex]:
    """Return the swing of two signals as parts of the third's, shape (3, n), at one per step.

    Over two whole steps, in which what repeats with every second step adds up to nothing; False
    first where the third has none.
    """
    ahead, right, up = 0j, 0j, 0j
    for i in range(len(phase)):
        if -1.0 <= phase[i] < 1.0:
            angle = -_TWO_PI * phase[i]
            wave = complex(math.cos(angle), math.sin(angle))
            ahead += values[0, i] * wave
            right += values[1, i] * wave
            up += values[2, i] * wave
    size = abs(up)
    if not size > 0:
        return False, 0j, 0j
    back = up.conjugate() / size**2
    return True, ahead * back, right * back


@in_place
def resolve(orientation: Array, acceleration: Array, axis: Array, out: Array) -> None:
    """Put accelerations along an axis' heading, to the right of it and up, (n, 3), in (3, n)."""
    ahead = (axis[0], axis[1], axis[2])
    for i in range(len(orientation)):
        x, y, _ = rotated(held(orientation[i]), ahead)
        flat = math.sqrt(x * x + y * y)
        cos, sin = (x / flat, y / flat) if flat > 0 else (1.0, 0.0)
        east, north = acceleration[i, 0], acceleration[i, 1]
        out[0, i], out[1, i] = cos * east + sin * north, sin * east - cos * north
        out[2, i] = acceleration[i, 2]


@compiled
def swing_about(
    time_ns: Times,
    orientation: Array,
    acceleration: Array,
    axis: Array,
    step_ns: int,
    reach_ns: int,
) -> tuple[bool, complex, complex]:
    """Return the swing along an axis' heading and to the right, as :func:`swing`, about a step.

    False first as well where a twentieth of the time within ``reach_ns`` of it has no samples.
    """
    begin, end = rows_between(time_ns, step_ns - reach_ns, step_ns + reach_ns)
    if time_ns[end - 1] - time_ns[begin] < 1.9 * reach_ns:
        return False, 0j, 0j
    values, phase = np.empty((3, end - begin)), np.empty(end - begin)
    resolve(orientation[begin:end], acceleration[begin:end], axis, values)
    for i in range(end - begin):
        phase[i] = (time_ns[begin + i] - step_ns) / reach_ns
    return swing(values, phase)


@in_place
def mean_vector(time_ns: Times, vectors: Array, start_ns: int, stop_ns: int) -> Vector:
    """Return the mean of vectors, shape (n, 3), in a time; NaN where there is none."""
    begin, end = rows_between(time_ns, start_ns, stop_ns)
    x, y, z, count = 0.0, 0.0, 0.0, float(end - begin)
    for i in range(begin, end):
        x, y, z = x + vectors[i, 0], y + vectors[i, 1], z + vectors[i, 2]
    return x / count, y / count, z / count


@in_place
def mean_near(time_ns: Times, values: Array, middle_ns: int, reach_ns: int) -> float:
    """Return the mean of the values at most ``reach_ns`` from a time; NaN where there is none."""
    total, count = 0.0, 0.0
    for i in range(len(time_ns)):
        if abs(time_ns[i] - middle_ns) <= reach_ns:
            total += values[i]
            count += 1.0
    return total / count


TRACK_SIZE = 6
#: Rows of the state: offset, its drift, mount, scale.
OFFSET, DRIFT, MOUNT, SCALE = 2, 3, 4, 5
#: Columns of a stride: length, heading, what the compass says as an offset, its deviation and how
#: many in a row err alike, how long the sensor has rested since the step before.
LENGTH, HEADING, SEEN, SIGMA, REPEATS, STRIDE_RESTED, STRIDE = range(7)
#: Random walk of the gyroscope's heading [rad/sqrt(s)].
HEADING_WALK = math.radians(0.3)
#: What a second at rest leaves of a gyroscope's bias [rad/s]; falls with the root of the time.
REST_DRIFT = 0.0016
#: An azimuth further off than this, in standard deviations, loses weight.
CLEAR = 2.0


@in_place
def rest(state: Array, covariance: Array, rested_s: float, drift: float) -> None:
    """Take it, in place, that the gyroscope was zeroed at rest; ``drift`` is its at the start."""
    state[DRIFT] = 0.0
    for k in range(TRACK_SIZE):
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
    covariance[OFFSET, OFFSET] += HEADING_WALK**2 * elapsed_s + wander**2


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
    off, known = wrap_angle(offset_rad - state[OFFSET]), covariance[OFFSET, OFFSET]
    variance = sigma_rad**2 * max(repeats, 1.0)
    variance *= max(1.0, abs(off) / CLEAR / math.sqrt(sigma_rad**2 + known)) ** 2
    row, gain = room[0, 0], room[0, 1]
    for i in range(TRACK_SIZE):
        row[i], gain[i] = covariance[OFFSET, i], covariance[i, OFFSET] / (known + variance)
    for i in range(TRACK_SIZE):
        state[i] += gain[i] * off
        for k in range(TRACK_SIZE):
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
    for k in range(TRACK_SIZE):
        x, y = matrix[0, k], matrix[1, k]
        matrix[0, k], matrix[1, k] = cos * x - sin * y, sin * x + cos * y
    for i in range(TRACK_SIZE):
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
        Columns, as :class:`.inertial.pdr_filter.TrackHistory` has them, which take two knots of
        each step, and how many there are.
    ns_per_s
        Of all times.
    """
    time_ns, shown, predicted, predicted_spread, pose, spread, transition = knots
    drift, wander, error, way = noise
    room = np.empty((2, TRACK_SIZE, TRACK_SIZE))
    for i in range(len(times)):
        row, at, repeats = rows[i], count + 2 * i, rows[i, REPEATS]
        seen = not math.isnan(row[SEEN])
        if seen and covariance[OFFSET, OFFSET] > lost_rad**2:
            turn(state, covariance, origin, row[SEEN] - state[OFFSET], knots, at)
            repeats = 1.0
        if row[STRIDE_RESTED] > 0:
            rest(state, covariance, row[STRIDE_RESTED], drift)
        elapsed_s = max(0, times[i] - time_ns[at - 1]) / ns_per_s
        wait(state, covariance, elapsed_s, wander, transition[at], room)
        if row[STRIDE_RESTED] > 0:
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
def smooth_track(
    predicted: Array, predicted_spread: Array, pose: Array, spread: Array, transition: Array
) -> tuple[Array, Array]:
    """Return state and covariance at each knot as all knots tell them, (n, 6) and (n, 6, 6)."""
    poses, spreads = pose.copy(), spread.copy()
    off, apart, room = (
        np.empty(TRACK_SIZE),
        np.empty((TRACK_SIZE, TRACK_SIZE)),
        np.empty((2, TRACK_SIZE, TRACK_SIZE)),
    )
    gain, rooms = np.empty((TRACK_SIZE, TRACK_SIZE)), gain_room(TRACK_SIZE)
    for i in range(len(pose) - 2, -1, -1):
        gain_of(spread[i], transition[i + 1], predicted_spread[i + 1], rooms, gain)
        for r in range(TRACK_SIZE):
            off[r] = poses[i + 1, r] - predicted[i + 1, r]
            for k in range(TRACK_SIZE):
                apart[r, k] = spreads[i + 1, r, k] - predicted_spread[i + 1, r, k]
        carry(gain, apart, room)
        spreads[i] += apart
        for r in range(TRACK_SIZE):
            for k in range(TRACK_SIZE):
                poses[i, r] += gain[r, k] * off[k]
    return poses, spreads
