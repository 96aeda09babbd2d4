"""Strapdown integration over a few samples, and how errors at its start show at its end.

Positions are in a frame with z up; x is the horizontal direction that the sensor was levelled to.
The error state is a small rotation in that frame (the true orientation is the estimate turned by
it), errors of velocity and position, and of the biases of gyroscope and accelerometer in the
sensor's axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..heading.rotations import matrix, normalised, of_vectors, product, running_products, skew
from ..heading.rotations import turned as turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .stances import Segment

    Array = NDArray[np.float64]

GRAVITY_MPS2 = 9.80665
#: Rows of the error state.
TURN, SPEED, PLACE, GYRO, FORCE = (slice(first, first + 3) for first in range(0, 15, 3))
STATES = 15


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the sensor is, how it is turned and moves, and the biases it is taken to have.

    Attributes
    ----------
    orientation
        Unit quaternion, body to earth, shape (4,).
    velocity, place
        Shape (3,) [m/s], [m].
    gyro_bias, force_bias
        In the sensor's axes, shape (3,) [rad/s], [m/s2].
    """

    orientation: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    place: Array = field(default_factory=lambda: np.zeros(3))
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    force_bias: Array = field(default_factory=lambda: np.zeros(3))

    def moved(self, error: Array) -> Pose:
        """Return the pose that an error state, shape (15,), says is the true one."""
        return Pose(
            normalised(product(of_vectors(error[TURN]), self.orientation)),
            self.velocity + error[SPEED],
            self.place + error[PLACE],
            self.gyro_bias + error[GYRO],
            self.force_bias + error[FORCE],
        )

    def error_from(self, other: Pose) -> Array:
        """Return the error state that moves ``other`` here, shape (15,)."""
        q = product(self.orientation, other.orientation * np.array([1.0, -1.0, -1.0, -1.0]))
        # small turns: twice the vector part, of the quaternion whose scalar part is positive
        turned = 2 * q[1:] * np.copysign(1.0, q[0])
        return np.concatenate(
            [
                turned,
                self.velocity - other.velocity,
                self.place - other.place,
                self.gyro_bias - other.gyro_bias,
                self.force_bias - other.force_bias,
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One segment integrated.

    Attributes
    ----------
    pose
        At its end.
    transition
        What an error at its start is at its end, shape (15, 15).
    turned_rad, pushed_mps
        How far it turned, and the integral of how much the force was off gravity.
    """

    pose: Pose
    transition: Array
    turned_rad: float
    pushed_mps: float


def integrate(pose: Pose, segment: Segment) -> Step:
    """Go from the end of the segment before to the end of this one.

    Rates and forces are taken as straight between samples.
    """
    dt = segment.interval_s[:, None]
    rate = segment.rate - pose.gyro_bias
    angles = 0.5 * (rate[1:] + rate[:-1]) * dt
    turns = np.empty((len(rate), 4))
    turns[0] = pose.orientation
    turns[1:] = product(pose.orientation, running_products(of_vectors(angles)))
    forces = turn(turns, segment.force - pose.force_bias)
    pushes = 0.5 * (forces[1:] + forces[:-1]) * dt
    pushes[:, 2] -= GRAVITY_MPS2 * segment.interval_s
    gained = pushes.cumsum(axis=0)
    velocity = pose.velocity + gained[-1]
    place = pose.place + ((pose.velocity + gained - 0.5 * pushes) * dt).sum(axis=0)
    after = Pose(normalised(turns[-1]), velocity, place, pose.gyro_bias, pose.force_bias)
    return Step(
        after,
        _transition(0.5 * (turns[0] + turns[-1]), gained[-1], segment.length_s),
        float(np.sqrt(np.einsum("ij,ij->i", angles, angles)).sum()),
        float(np.sqrt(np.einsum("ij,ij->i", pushes, pushes)).sum()),
    )


def _transition(middle: Array, gained: Array, length_s: float) -> Array:
    """Return the transition of a segment that is short beside how fast a foot turns."""
    axes = matrix(normalised(middle)) * length_s
    force = skew(gained + np.array([0.0, 0.0, GRAVITY_MPS2 * length_s]))
    out = np.eye(STATES)
    out[TURN, GYRO] = -axes
    out[SPEED, TURN] = -force
    out[SPEED, GYRO] = 0.5 * force @ axes
    out[SPEED, FORCE] = -axes
    out[PLACE, SPEED] = length_s * np.eye(3)
    for column in (TURN, FORCE):
        out[PLACE, column] = 0.5 * length_s * out[SPEED, column]
    out[PLACE, GYRO] = length_s / 3 * out[SPEED, GYRO]
    return out
