"""What is learned of a field, whether it passes its tests or not, compiled.

There are two beliefs: the clean one, and, while tests fail, one in which the iron on the sensor
has changed. A field that fails but holds still while the sensor turns is that of the place: the
reference at the start may have been taken beside something magnetic. One whose norm and
inclination stay the same then is neither iron on the sensor, which would change them with its
orientation, nor a magnet in passing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..compiled import in_place
from .attitude_kernels import (
    ACROSS,
    APART,
    CHANGE,
    EARTH,
    FIELD_SIGMA,
    GAIN,
    IRON,
    IRON_START,
    PLAIN_SIGMA,
    SEES,
    SIZE,
    face,
    forget,
    take_earth,
)
from .compass_kernels import correct_field, deviation, seen_by_field, total, without
from .rotation_kernels import identity, product, solve

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .rotation_kernels import Vector

    Array = NDArray[np.float64]

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
        As those of :func:`.compass_kernels.without`.
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
def learn(
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
        Go on in place; as laid out above and in :mod:`.attitude_kernels`.
    turned, field
        As those of :func:`.compass_kernels.without`; ``seen`` is what that makes of the field
        by the clean belief.
    turned_rad, length_s
        How far the sensor turned in the frame, and its length.
    room
        As :mod:`.attitude_kernels` lays it out, written over.
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
