"""The loops of :mod:`.strapdown` and :mod:`.error_state`, compiled: segment after segment."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..compiled import in_place
from ..heading.rotation_kernels import (
    add_matrix,
    held,
    identity,
    normalise,
    of_angles,
    put,
    rotated,
    times,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..heading.rotation_kernels import Vector

    Array = NDArray[np.float64]


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
        At its start, as :attr:`.strapdown.Pose.row`.
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
