"""A place from the powers of one working cycle.

Source: the paper, equation (7): each power is Gaussian about mu / r^n with a third of that as
standard deviation. mu is known from a survey, or profiled: with a_n = U_n r_n^n the likeliest
q = 1 / mu solves q^2 sum a^2 - q sum a - N sigma^2 = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers.location import Location
from .cycles import RELATIVE_SIGMA
from .medium import PowerLaw, ranges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Refinements about the best node, each so many times as fine.
REFINEMENTS, FINER = 4, 4


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The log-likelihood over a lattice.

    Attributes
    ----------
    x, y
        Shapes (nx,) and (ny,): even [m].
    values
        Shape (ny, nx): the logarithm of (7), constants left out.
    """

    x: Array
    y: Array
    values: Array

    @property
    def best(self) -> Array:
        """The likeliest node, shape (2,) [m]."""
        row, column = divmod(int(np.nanargmax(self.values)), len(self.x))
        return np.array([self.x[column], self.y[row]])


@dataclass(frozen=True, slots=True, eq=False)
class CyclePlace:
    """Powers of one cycle, and what of them is known.

    Attributes
    ----------
    powers
        Shape (n,): less the noise; those not above 0 do not count.
    sensors
        Shape (n, 2) [m].
    law
        How power falls; its mu counts only where it is known.
    mu_known
        Whether it is; else it is profiled.
    relative_sigma
        Standard deviation of a power over its mean: one, or of each, shape (n,).
    """

    powers: Array
    sensors: Array
    law: PowerLaw
    mu_known: bool = False
    relative_sigma: float | Array = RELATIVE_SIGMA

    def log_likelihood(self, places: Array) -> Array:
        """Return the logarithm of (7) at places, shape (...) from (..., 2) [m]."""
        heard = self._heard()
        unit = PowerLaw(1.0, self.law.exponent, self.law.loss_per_m)
        spread = unit.power(ranges(places, self.sensors[heard]))
        a = self.powers[heard] / spread
        sigma = self._sigma(heard)
        mu = np.full(a.shape[:-1], self.law.mu) if self.mu_known else profiled_mu(a, sigma)
        off = (a / mu[..., None] - 1) / sigma
        scale = np.log(spread).sum(axis=-1) + a.shape[-1] * np.log(mu)
        return np.asarray(-scale - 0.5 * (off**2).sum(axis=-1))

    def surface(self, x: Array, y: Array) -> Surface:
        """Return the log-likelihood over even coordinates, shapes (nx,) and (ny,) [m]."""
        nodes = np.stack(np.meshgrid(x, y), axis=-1)
        return Surface(x, y, self.log_likelihood(nodes))

    def locate(self, surface: Surface) -> Location:
        """Return the likeliest place, refined below the lattice of its surface.

        Its covariance is the inverse Hessian there, inf where the surface is not curved, as at the
        edge; its residual the relative root mean square of what the law leaves.
        """
        step = float(surface.x[1] - surface.x[0])
        place = surface.best
        reach = np.arange(-FINER, FINER + 1)
        for _ in range(REFINEMENTS):
            step /= FINER
            offsets = step * np.stack(np.meshgrid(reach, reach), axis=-1)
            near = place + offsets
            place = near.reshape(-1, 2)[int(self.log_likelihood(near).argmax())]
        heard = int(self._heard().sum())
        x, y = place.tolist()
        return Location(x, y, self._covariance(place), self._residual(place), heard)

    def _covariance(self, place: Array) -> Array:
        h = 0.05  # [m]: far below what one cycle tells apart, far above rounding
        axes = h * np.eye(2)
        corners = [place + i * axes[0] + j * axes[1] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        f = self.log_likelihood(np.array(corners)).reshape(3, 3)
        xx, yy = f[2, 1] - 2 * f[1, 1] + f[0, 1], f[1, 2] - 2 * f[1, 1] + f[1, 0]
        xy = (f[2, 2] - f[2, 0] - f[0, 2] + f[0, 0]) / 4
        hessian = -np.array([[xx, xy], [xy, yy]]) / h**2
        if np.linalg.eigvalsh(hessian)[0] <= 1e-9:
            return np.full((2, 2), np.inf)
        return np.asarray(np.linalg.inv(hessian), np.float64)

    def _residual(self, place: Array) -> float:
        heard = self._heard()
        unit = PowerLaw(1.0, self.law.exponent, self.law.loss_per_m)
        a = self.powers[heard] / unit.power(ranges(place, self.sensors[heard]))
        mu = self.law.mu if self.mu_known else float(profiled_mu(a, self._sigma(heard)))
        return float(np.sqrt(np.mean((a / mu - 1) ** 2)))

    def _heard(self) -> NDArray[np.bool_]:
        return np.isfinite(self.powers) & (self.powers > 0)

    def _sigma(self, heard: NDArray[np.bool_]) -> Array:
        return np.broadcast_to(self.relative_sigma, self.powers.shape)[heard]


def less_noise(
    powers: Array, floors: Array, floor_sigmas: Array | None, relative_sigma: float
) -> tuple[Array, Array]:
    """Return powers less the noise, and the standard deviation of each over itself.

    The variance is P^2 / K of the power, noise included, K = relative_sigma^-2, and that of the
    floor; so what hardly stands out of the noise weighs little in (7).

    Parameters
    ----------
    powers, floors
        Any shape: noise included, and of the noise.
    floor_sigmas
        The same shape: standard deviations of the floors; None: they are known.
    relative_sigma
        Standard deviation of a power over its mean.

    Returns
    -------
    The same shape twice; inf where there is no more than noise.
    """
    signal = powers - floors
    spread = np.hypot(relative_sigma * powers, 0.0 if floor_sigmas is None else floor_sigmas)
    sigma = np.divide(spread, signal, out=np.full(signal.shape, np.inf), where=signal > 0)
    return signal, sigma


def profiled_mu(a: Array, relative_sigma: float | Array) -> Array:
    """Return the mu at which (7) is greatest, shape (...).

    Parameters
    ----------
    a
        Shape (..., n): powers over what the law gives for mu = 1.
    relative_sigma
        Standard deviation of a power over its mean: one, or of each, shape (n,).
    """
    weights = np.broadcast_to(relative_sigma, a.shape[-1:]) ** -2.0
    first, second = a @ weights, a**2 @ weights
    return np.asarray(2 * second / (first + np.sqrt(first**2 + 4 * second * a.shape[-1])))
