"""How a vehicle's seismic power falls with distance, and what a geophone does to it.

Source: the paper, equations (1) to (4). Two are corrected here:

- (2) has the prefactor N0 / (2 r^2); the square of r^-0.5 in (1) is 1 / r. Only with it do (2) and
  an integral that falls as r^-0.5 make the r^-1.5 of (4).
- (3) has j 4 pi f xi and (2 pi f T)^2 with T = 1 / f0, which is off by 2 pi; it is 2 j xi f / f0
  and (f / f0)^2.

Nor does the integral fall as r^-0.5 but at one distance (a table is in docs/vehicles.md). And (3)
is a low-pass, while a geophone is a high-pass. So the exponent of the law (4) is a parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Exponent of (4).
EXPONENT = 1.5
#: Distances are taken to be at least this [m]: the law has no end on top of a sensor.
NEAREST_M = 0.5
Kind = Literal["low-pass", "high-pass"]


def clamped(distance_m: Array) -> Array:
    """Return distances, each at least :data:`NEAREST_M`, any shape [m]."""
    return np.maximum(distance_m, NEAREST_M)


def ranges(places: Array, sensors: Array) -> Array:
    """Return clamped distances of places to sensors.

    Parameters
    ----------
    places
        Shape (..., 2) [m].
    sensors
        Shape (n, 2) [m].

    Returns
    -------
    Shape (..., n) [m].
    """
    return clamped(np.linalg.norm(places[..., None, :] - sensors, axis=-1))


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """Mean power at a distance, P = mu r^-n exp(-a r): (4), and the loss of (1) in a narrow band.

    Attributes
    ----------
    mu
        Energy parameter: power at 1 m without loss [unit^2 m^n].
    exponent
        n.
    loss_per_m
        a = 2 rho pi f of the band [1/m], see :func:`loss_per_m`.
    """

    mu: float = 1.0
    exponent: float = EXPONENT
    loss_per_m: float = 0.0

    def power(self, distance_m: Array) -> Array:
        """Return the mean power at distances of any shape, clamped [unit^2]."""
        r = clamped(distance_m)
        return self.mu * np.exp(-self.exponent * np.log(r) - self.loss_per_m * r)

    def slope(self, distance_m: Array) -> Array:
        """Return d ln P / d r [1/m]; 0 where the distance is clamped."""
        r = clamped(distance_m)
        return np.where(distance_m > NEAREST_M, -self.exponent / r - self.loss_per_m, 0.0)


def loss_per_m(loss_spm: float, frequency_hz: float) -> float:
    """Return a = 2 rho pi f, by which power of one frequency falls, twice that of (1) [1/m].

    Parameters
    ----------
    loss_spm
        rho of (1) [s/m].
    frequency_hz
        f [Hz].
    """
    return 2 * np.pi * loss_spm * frequency_hz


@dataclass(frozen=True, slots=True)
class Geophone:
    """An oscillator on the ground.

    Attributes
    ----------
    natural_hz
        f0 [Hz].
    damping
        xi, as a part of the critical.
    kind
        ``low-pass``: (3) as corrected. ``high-pass``: what a geophone makes of the ground's
        velocity, (f / f0)^2 times that.
    """

    natural_hz: float = 10.0
    damping: float = 0.7
    kind: Kind = "high-pass"

    def response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Return H(j 2 pi f) for numpy's sign of time, exp(+i w t); any shape.

        The low-pass is 1 at 0 Hz, the high-pass far above its natural frequency.
        """
        x = frequency_hz / self.natural_hz
        low = 1 / (1 + 2j * self.damping * x - x**2)
        found = low if self.kind == "low-pass" else -(x**2) * low
        return np.asarray(found, np.complex128)
