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

from ..heading.rotations import normalised
from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading import rotation_kernels
    from . import strapdown_kernels as compiled
    from .stances import Segment

    Array = NDArray[np.float64]
else:
    compiled = Later("groundtrace.inertial.strapdown_kernels")
    rotation_kernels = Later("groundtrace.heading.rotation_kernels")

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

    @property
    def row(self) -> Array:
        """All of it, one after the other, shape (16,)."""
        parts = (self.orientation, self.velocity, self.place, self.gyro_bias, self.force_bias)
        return np.concatenate(parts)

    @classmethod
    def of(cls, row: Array) -> Pose:
        """Return the pose of a row, shape (16,)."""
        return cls(*np.split(row, [4, 7, 10, 13]))

    def moved(self, error: Array) -> Pose:
        """Return the pose that an error state, shape (15,), says is the true one."""
        orientation = self.orientation.copy()
        rotation_kernels.turn_by(error, orientation)
        return Pose(
            orientation,
            self.velocity + error[SPEED],
            self.place + error[PLACE],
            self.gyro_bias + error[GYRO],
            self.force_bias + error[FORCE],
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
    row, moved, transition = pose.row, np.empty(compiled.MOVED), np.empty((STATES, STATES))
    given = (segment.interval_s, segment.rate, segment.force, GRAVITY_MPS2)
    compiled.integrate(row, *given, moved)
    compiled.transition(row, moved, segment.length_s, GRAVITY_MPS2, np.empty((4, 4)), transition)
    orientation, velocity, place, _ = np.split(moved, [4, 7, compiled.GAINED])
    after = Pose(normalised(orientation), velocity, place, pose.gyro_bias, pose.force_bias)
    turned_rad, pushed_mps = moved[compiled.TURNED :].tolist()
    return Step(after, transition, turned_rad, pushed_mps)
