"""The direction of gravity in a worn accelerometer, and the acceleration along it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .even_grid import CentredFilter, Kept, gaussian
from .filters import UnbiasedMean

if TYPE_CHECKING:
    from numpy.typing import NDArray

GRAVITY_MPS2 = 9.80665
#: Standard deviation of the Gaussian that averages the movement away [s]: a walker's stride takes
#: about a second, a sensor turns in its pocket more slowly.
AVERAGE_S = 1.0
#: Memory of the mean that gives an uncalibrated sensor its scale [s].
SCALE_S = 10.0


class Gravity:
    """Mean specific force around each point of the grid: gravity, while nobody falls.

    Parameters
    ----------
    sigma_s
        Standard deviation of the averaging Gaussian [s].
    """

    def __init__(self, sigma_s: float = AVERAGE_S) -> None:
        self._average = CentredFilter(gaussian(sigma_s, 2.5))
        self._force: Kept | None = None

    def __call__(
        self, force: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Take the specific force on the grid [m/s2], shape (n_axes, n).

        Returns
        -------
        Specific force and gravity of the points that are complete by now, shape (n_axes, m) each.
        """
        if self._force is None:
            self._force = Kept(force.shape[0])
        self._force.add(force)
        return self._paired(self._average(force))

    def finish(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the points that waited for what comes after the end."""
        if self._force is None:
            return np.empty((1, 0)), np.empty((1, 0))
        return self._paired(self._average.finish())

    def _paired(
        self, gravity: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        assert self._force is not None
        start = self._force.first
        force = self._force.between(start, start + gravity.shape[1])
        self._force.forget_before(start + gravity.shape[1])
        return force, gravity


def along(force: NDArray[np.float64], gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of ``force`` along ``gravity``, up positive, shape (1, n); 0 where none is.

    Both have the shape (n_axes, n) and one unit.
    """
    length = np.sqrt(np.einsum("cn,cn->n", gravity, gravity))
    dot = np.einsum("cn,cn->n", force, gravity)
    upward: NDArray[np.float64] = np.divide(dot, length, out=np.zeros_like(dot), where=length > 0)
    return upward[None, :]


class CountScale:
    """Scale of a specific force in unknown units: its mean length over a time is gravity's."""

    def __init__(self, rate_hz: float) -> None:
        self._mean = UnbiasedMean(SCALE_S * rate_hz)

    def __call__(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force in m/s2: all axes, or the magnitude alone, shape (n_axes, n)."""
        length = force if len(force) == 1 else np.sqrt(np.einsum("cn,cn->n", force, force))[None, :]
        mean = self._mean(length)
        return np.divide(GRAVITY_MPS2 * force, mean, out=np.zeros_like(force), where=mean > 0)
