"""The error-state filter over many frames in one call, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from . import attitude_kernels as at
from . import belief_kernels as by
from . import frame_kernels as of
from .attitude_kernels import alone, move, predict
from .compass_kernels import TESLA, passes, tests, turn_about_vertical, without, wrapped
from .frame_kernels import headings_into, sum_up
from .rotation_kernels import add_matrix, held, rotated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rotation_kernels import Quaternion, Vector

    Array = NDArray[np.float64]
    Counts = NDArray[np.int64]
    Compass = tuple[Array, Array, Array, Counts]


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
    :func:`.belief_kernels.learn`.
    """
    belief, fields, recent, counts = compass
    before, doubted = held(state), belief[by.DOUBTED] > 0.0
    sigma = p[at.DRIFT] * min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
    iron = (state[at.IRON], state[at.IRON + 1], state[at.IRON + 2])
    if doubted:
        iron = (belief[by.CLEAN], belief[by.CLEAN + 1], belief[by.CLEAN + 2])
    seen = without(iron, turned, field)
    tests(state[at.EARTH : at.RESTED], seen, sigma, recent, counts, dt, values)
    off = values[0] * TESLA
    values[7] = by.iron_change(state, covariance, turned, field, off, belief, room) / TESLA
    passed = passes(values, limits)
    said = (turned, field, seen, turned_rad, dt)
    by.learn(state, covariance, belief, fields, *said, passed, p, room)
    state[at.OFFSET] -= turn_about_vertical(before, held(state))
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
        As :mod:`.frame_kernels` lays it out.
    turned
        Takes what its mean turn makes of the body in the earth frame, shape (3, 3).
    state, covariance, p, room
        As :mod:`.attitude_kernels` lays them out.
    """
    axes = room[at.APART : at.GAIN, :3]
    axes[:] = 0.0
    add_matrix(start, 1.0, axes)
    for i in range(3):
        for k in range(3):
            turned[i, k] = 0.0
            for j in range(3):
                turned[i, k] += axes[i, j] * said[of.MEAN_TURN + 3 * j + k]
    bias = (state[at.BIAS], state[at.BIAS + 1], state[at.BIAS + 2])
    rate = (said[of.RATE], said[of.RATE + 1], said[of.RATE + 2])
    pushed = rotated(start, (said[of.FORCE], said[of.FORCE + 1], said[of.FORCE + 2]))
    predict(state, covariance, turned, pushed, last, said[of.SPEED], dt, p)
    still = math.sqrt(rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2) < p[at.REST_RATE]
    still = still and said[of.RATE_SPREAD] < p[at.REST_SPREAD]
    still = still and said[of.FORCE_SPREAD] < p[at.REST_FORCE]
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
    values, turned_rad = told[at.VALUES : at.VALUES + 8], said[of.SPEED] * dt
    given = (turned, field, turned_rad, dt, p, limits, values, room)
    passed = look(state, covariance, compass, *given)
    if passed:
        state[at.DELAY] += said[of.ACROSS] + delay_s * said[of.ALONG]
        state[at.DELAY + 1] += said[of.ALONG]
    told[at.VALUES + 9] = recent[1, counts[1, 0] - 1]
    told[at.PASSED] = 1.0 if passed else 0.0


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
        Of the filter, as :mod:`.attitude_kernels` lays them out.
    compass
        Belief and fields, as :mod:`.belief_kernels` lays them out; norms and azimuths of the last
        frames, and how many there are and may be, as :func:`.compass_kernels.tests` has them.
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
    count, dt = len(rate) // length, length * p[at.STEP]
    orientation, heading = np.empty((count * length, 4)), np.empty(count * length)
    told, turned = np.full((count, at.TOLD), np.nan), np.empty((3, 3))
    said, turns, each = np.empty(of.FRAME), np.empty((length, 2, 4)), np.empty((length + 1, 6))
    room = np.empty((at.ROOM, at.SIZE))
    for f in range(count):
        part, start, row = slice(f * length, (f + 1) * length), held(state), told[f]
        delay_s, bias = state[at.DELAY] / state[at.DELAY + 1], state[at.BIAS : at.IRON]
        sum_up(rate[part], force[part], field[part], bias, delay_s, p[at.STEP], turns, each, said)
        earth = rotated(start, (said[of.FIELD], said[of.FIELD + 1], said[of.FIELD + 2]))
        sees = math.isfinite(earth[0] + earth[1] + earth[2])
        if sees and math.isnan(state[at.EARTH]):
            return f, orientation, heading, told
        headings_into(start, turns, axis, orientation[part], heading[part])
        row[at.SIGMA] = min(math.sqrt(max(covariance[2, 2], 0.0)), math.pi)
        row[at.VALUES + 8], row[at.PASSED] = state[at.OFFSET], 1.0
        resting = go_on(start, said, turns[length - 1, 0], turned, state, covariance, dt, p, room)
        row[at.RESTING] = 1.0 if resting else 0.0
        if sees:
            given = (turned, earth, said, delay_s, dt, p, limits, row, room)
            take_field(state, covariance, compass, *given)
        for k in (at.VALUES + 8, at.VALUES + 9):
            row[k] = math.degrees(wrapped(heading[f * length] + row[k]))
        for k in range(3):
            row[at.TOLD_BIAS + k] = state[at.BIAS + k]
        if sees and due(watched, row[at.PASSED] > 0.0, tries):
            return f + 1, orientation, heading, told
    return count, orientation, heading, told
