"""The navigation of a foot over many segments in one call, compiled.

The same as :class:`.walk.Walk` and :class:`.error_state.ErrorStateFilter` do segment by segment,
where nothing is to be decided: the foot is under way, or goes on standing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..heading.attitude_kernels import gains, lessen
from ..heading.rotation_kernels import carry, identity, normalise, product, turn_by
from .strapdown_kernels import (
    GYRO,
    POSE,
    PUSHED,
    SPEED,
    TURNED,
    integrate,
    transition,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading.rotation_kernels import Vector

    Array = NDArray[np.float64]

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
        Segments, as :class:`.stances.SegmentRun` has them.
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
