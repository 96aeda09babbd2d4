"""Error-state Kalman filter of a foot: attitude, velocity, position and the biases of both sensors.

Source: Foxlin, IEEE Computer Graphics and Applications 25(6), 2005, and Skog, Nilsson and Haendel,
Indoor Positioning and Indoor Navigation, 2010, for zero-velocity updates. How sure a standing foot
is of its velocity depends on how still it stands: it rolls over the ball of the foot, and the
sensor is above the sole. So a fast walker's short stances count, but count less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later
from .strapdown import FORCE, GYRO, PLACE, SPEED, STATES, TURN, Pose, integrate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading import rotation_kernels
    from .stances import Segment

    Array = NDArray[np.float64]
else:
    rotation_kernels = Later("groundtrace.heading.rotation_kernels")

#: Rows of the state that a measurement leaves alone: none.
_NONE = np.zeros(STATES, np.bool_)
#: Velocity of a foot of which nothing is known [m/s].
LOST_MPS = 2.0


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """What the filter takes its sensors for.

    Attributes
    ----------
    gyro_walk, force_walk
        Random walk of the integrated rate [rad/sqrt(s)] and specific force [m/s/sqrt(s)].
    gyro_scale, force_scale
        Unknown part of a turn or push (scale, axes, bandwidth), as white noise: error over the
        square root of what was turned [sqrt(rad)] or pushed [sqrt(m/s)].
    gyro_bias, force_bias
        Biases at the start [rad/s], [m/s2].
    gyro_bias_walk, force_bias_walk
        Their random walks [rad/s/sqrt(s)], [m/s2/sqrt(s)].
    tilt
        Of the levelling at the start [rad].
    """

    gyro_walk: float = 5e-4
    force_walk: float = 0.03
    gyro_scale: float = 5e-3
    force_scale: float = 0.01
    gyro_bias: float = 0.01
    force_bias: float = 0.1
    gyro_bias_walk: float = 1e-5
    force_bias_walk: float = 1e-4
    tilt: float = 0.035


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """What a measurement says that the filter did not expect.

    Attributes
    ----------
    value, spread
        Shape (n,), and its covariance, shape (n, n).
    pick, noise
        Shape (n, 15): what it sees of the error state; and its covariance, shape (n, n).
    """

    value: Array
    spread: Array
    pick: Array
    noise: Array

    @property
    def distance(self) -> float:
        """Mahalanobis distance."""
        return float(np.sqrt(self.value @ np.linalg.solve(self.spread, self.value)))


class ErrorStateFilter:
    """A pose and the covariance of its error.

    Parameters
    ----------
    noise
        What the sensors are taken for.
    orientation
        At the start, shape (4,); its heading is the frame's, so without error.
    """

    def __init__(self, noise: SensorNoise, orientation: Array) -> None:
        self.noise = noise
        self.pose = Pose(orientation)
        sigma = np.zeros(STATES)
        sigma[TURN] = noise.tilt, noise.tilt, 0.0
        sigma[SPEED] = 0.1
        sigma[GYRO], sigma[FORCE] = noise.gyro_bias, noise.force_bias
        self.covariance = np.diag(sigma**2)

    def predict(self, segment: Segment) -> Array:
        """Go on to the end of a segment; return its transition, shape (15, 15)."""
        step, noise, length_s = integrate(self.pose, segment), self.noise, segment.length_s
        growth = np.zeros(STATES)
        growth[TURN] = noise.gyro_walk**2 * length_s + noise.gyro_scale**2 * step.turned_rad
        growth[SPEED] = noise.force_walk**2 * length_s + noise.force_scale**2 * step.pushed_mps
        growth[PLACE] = growth[SPEED] * length_s**2 / 3
        growth[GYRO] = noise.gyro_bias_walk**2 * length_s
        growth[FORCE] = noise.force_bias_walk**2 * length_s
        self.pose = step.pose
        self.covariance = self.covariance.copy()
        rotation_kernels.carry(step.transition, self.covariance, np.empty((2, STATES, STATES)))
        np.einsum("ii->i", self.covariance)[:] += growth
        return step.transition

    def still(self, sigma_mps: float) -> Innovation:
        """Return what a velocity of zero says."""
        return self._innovation(SPEED, -self.pose.velocity, sigma_mps)

    def not_turning(self, rate: Array, sigma_radps: float) -> Innovation:
        """Return what a rate of zero says, where ``rate`` was measured, shape (3,) [rad/s]."""
        return self._innovation(GYRO, rate - self.pose.gyro_bias, sigma_radps)

    def turned(self, angle_rad: float, sigma_rad: float) -> Innovation:
        """Return what it says that the frame has turned by an angle about the vertical."""
        pick = np.zeros((1, STATES))
        pick[0, TURN.stop - 1] = 1.0
        noise = np.array([[sigma_rad**2]])
        spread = pick @ self.covariance @ pick.T + noise
        return Innovation(np.array([angle_rad]), spread, pick, noise)

    def update(self, seen: Innovation) -> None:
        """Correct the pose by a measurement."""
        gain, self.covariance = rotation_kernels.joseph(
            self.covariance, seen.pick, seen.spread, seen.noise, _NONE
        )
        self.pose = self.pose.moved(gain @ seen.value)

    def lose_velocity(self) -> None:
        """Give the velocity up: it is anything that a foot may do."""
        self.pose = replace(self.pose, velocity=np.zeros(3))
        self.covariance = self.covariance.copy()
        self.covariance[SPEED] = self.covariance[:, SPEED] = 0.0
        self.covariance[SPEED, SPEED] = np.eye(3) * LOST_MPS**2

    def _innovation(self, rows: slice, value: Array, sigma: float) -> Innovation:
        pick = np.zeros((3, STATES))
        pick[:, rows] = np.eye(3)
        noise = np.eye(3) * sigma**2
        return Innovation(value, self.covariance[rows, rows] + noise, pick, noise)
