"""Heading filters of one angle, after EPFL.

Source: Moix, Steiner, Ladetto and Merminod (EPFL), "Recalage du systeme avec un filtre a
correlation exponentielle" and "... avec un filtre de Kalman". Two signs are corrected:

- the azimuth's correction ``(1 - a) dT db`` is printed as added; it must be subtracted, as ``db``
  is the gyroscope's lead over the compass: ``phi* = a phi_gyro + (1 - a) phi_compass``;
- the bias is printed as ``b_{j+1} = b_j + db``; the gyroscope is mechanised with ``b*``, so that it
  must be ``b_{j+1} = b*_j + db``. As printed the loop overshoots (poles of modulus sqrt(a)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .rotations import wrap_angle

if TYPE_CHECKING:
    from .rotations import Array


class ScalarFilter(Protocol):
    """Turns the gyroscope's azimuth and its vertical bias towards the compass."""

    def advance(self, dt_s: float, walk_rad2: float) -> float:
        """Go on by a frame; return the turn that takes the bias out [rad].

        ``walk_rad2`` is by how much the variance of the gyroscope's azimuth grew.
        """

    def correct(self, difference_rad: float, sigma_rad: float) -> float:
        """Take compass minus gyroscope; return the turn to apply [rad]."""

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the azimuth [rad]."""


def exponential_update(
    gyro: float, compass: float, bias: float, alpha: float, elapsed: float
) -> tuple[float, float]:
    """Return azimuth and bias after one update of the exponential-correlation filter.

    Parameters
    ----------
    gyro, compass
        Azimuths, in one unit.
    bias
        ``b*`` of the update before, that unit per second.
    alpha
        1 ignores the compass, 0 takes it as it is.
    elapsed
        Time since the update before [s].
    """
    change = (gyro - compass) / elapsed
    corrected = (1 - alpha) * (bias + change) + alpha * bias
    return gyro - (1 - alpha) * elapsed * change, corrected


@dataclass(slots=True)
class Exponential:
    """The exponential-correlation filter: an update each time the gyroscope's error is too large.

    Attributes
    ----------
    alpha
        Of the filter.
    tolerance_rad
        Error of the gyroscope's azimuth from which on it is updated [rad].
    least_s
        Time between updates at least: the bias is a difference over this time [s].
    """

    alpha: float = 0.7
    tolerance_rad: float = np.radians(1.0)
    least_s: float = 10.0
    bias: float = 0.0
    variance: float = 0.0
    _elapsed_s: float = 0.0
    _bias_sigma: float = np.radians(0.05)

    def advance(self, dt_s: float, walk_rad2: float) -> float:
        """Go on by a frame."""
        before = self._elapsed_s
        self._elapsed_s += dt_s
        grown = self._elapsed_s**2 - before**2
        self.variance += walk_rad2 + self._bias_sigma**2 * grown
        return -self.bias * dt_s

    def correct(self, difference_rad: float, sigma_rad: float) -> float:
        """Update where the gyroscope's error is beyond the tolerance."""
        if self.sigma_rad < self.tolerance_rad or self._elapsed_s < self.least_s:
            return 0.0
        turn, self.bias = exponential_update(
            0.0, difference_rad, self.bias, self.alpha, self._elapsed_s
        )
        self.variance = self.alpha**2 * self.variance + ((1 - self.alpha) * sigma_rad) ** 2
        self._elapsed_s = 0.0
        return turn

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the azimuth [rad]."""
        return float(np.sqrt(self.variance))


def _two_states() -> Any:
    from filterpy.kalman import KalmanFilter

    made = KalmanFilter(dim_x=2, dim_z=1)
    made.H = np.array([[1.0, 0.0]])
    made.P = np.diag([1e-6, np.radians(0.05) ** 2])
    return made


@dataclass(slots=True)
class AzimuthKalman:
    """The Kalman filter over increments of azimuth and bias, the bias a Markov process.

    Attributes
    ----------
    memory_s
        Correlation time of the bias [s].
    bias_rps
        Its standard deviation [rad/s].
    """

    memory_s: float = 300.0
    bias_rps: float = np.radians(0.05)
    _filter: Any = field(default_factory=_two_states)

    def advance(self, dt_s: float, walk_rad2: float) -> float:
        """Predict; the azimuth's increment is applied at once, so that it is 0 again."""
        decay = np.exp(-dt_s / self.memory_s)
        f = self._filter
        f.F = np.array([[1.0, -dt_s], [0.0, decay]])
        f.Q = np.diag([walk_rad2, self.bias_rps**2 * (1 - decay**2)])
        f.predict()
        return self._applied()

    def correct(self, difference_rad: float, sigma_rad: float) -> float:
        """Update by the compass."""
        self._filter.update(np.array([difference_rad]), R=np.array([[sigma_rad**2]]))
        return self._applied()

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the azimuth [rad]."""
        return float(np.sqrt(self._filter.P[0, 0]))

    def _applied(self) -> float:
        turn = float(self._filter.x[0, 0])
        self._filter.x[0, 0] = 0.0
        return turn


def turn_about_vertical(before: Array, after: Array) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    # w and z of after times the inverse of before; there is no x and y where the tilt is kept
    (bw, bx, by, bz), (aw, ax, ay, az) = before.tolist(), after.tolist()
    w = aw * bw + ax * bx + ay * by + az * bz
    z = -aw * bz - ax * by + ay * bx + az * bw
    return wrap_angle(2 * math.atan2(z, w))
