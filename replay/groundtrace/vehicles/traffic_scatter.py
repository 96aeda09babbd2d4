"""How powers scatter about their mean: how much, alike at stations, and alike from cycle to cycle.

A vehicle's own noise is heard by all stations, so that where nothing fades they scatter alike, and
their ratio tells far more than each of them. Where paths interfere, each scatters by itself, and
for as long as a fade lasts. Which it is, is found from the powers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Cycles with a mean above so many times the noise tell the scatter.
_CLEAR = 3.0
_FEWEST = 20
_LEAST_VARIANCE = 0.02
_MOST_SHARED, _MOST_LASTING = 0.95, 0.8


@dataclass(frozen=True, slots=True)
class Scatter:
    """Of powers about their mean.

    Attributes
    ----------
    variance
        Relative.
    shared
        Correlation between stations, where one vehicle is all that they hear.
    lasting
        Correlation from a cycle to the next.
    """

    variance: float = 0.15
    shared: float = 0.0
    lasting: float = 0.0

    @property
    def effective(self) -> float:
        """Variance by which as many independent cycles would tell as little."""
        return self.variance * (1 + self.lasting) / (1 - self.lasting)

    def correlation(self, parts: Array, known: NDArray[np.bool_]) -> Array:
        """Return how alike stations scatter, shape (c, n, n).

        Parameters
        ----------
        parts
            Shape (v, c, n): part of the mean power that is each vehicle's.
        known
            Shape (c, n): where there is a power.
        """
        alike = self.shared * np.einsum("vci,vcj->cij", parts, parts)
        alike[~(known[:, :, None] & known[:, None, :])] = 0
        own = np.arange(known.shape[1])
        alike[:, own, own] = 1.0
        return np.asarray(alike)


def rooted(ratio: Array) -> Array:
    """Return 3 (ratio^(1/3) - 1), any shape: a gamma deviate becomes nearly Gaussian.

    E. B. Wilson, M. M. Hilferty: The distribution of chi-square, PNAS 17, 1931.
    """
    return np.asarray(3 * (np.cbrt(ratio) - 1))


def scatter_of(powers: Array, noise: Array, known: NDArray[np.bool_], mean: Array) -> Scatter:
    """Return the scatter of powers about a mean, by quantiles.

    A few cycles in which the mean is wrong, as a vehicle lacks, tell little in it.

    Parameters
    ----------
    powers, noise
        Shape (c, n): noise included, and of the noise alone [unit^2].
    known
        Shape (c, n): where there is a power.
    mean
        Shape (c, n) [unit^2].
    """
    clear = known & (mean > _CLEAR * noise)
    off = np.where(clear, rooted(np.where(clear, powers, 1.0) / mean), np.nan)
    if clear.sum() < _FEWEST:
        return Scatter()
    spread = _spread(off[clear])
    one, other = np.triu_indices(off.shape[1], 1)
    shared = _alike(off[:, one].ravel(), off[:, other].ravel())
    variance = max(spread**2, _LEAST_VARIANCE)
    return Scatter(variance, float(np.clip(shared, 0, _MOST_SHARED)), lasting_of(off))


def lasting_of(off: Array) -> float:
    """Return how alike what is off the mean is from a cycle to the next, shape (c, n); 0 to 0.8."""
    return float(np.clip(_alike(off[1:].ravel(), off[:-1].ravel()), 0, _MOST_LASTING))


def _spread(values: Array) -> float:
    low, high = np.percentile(values, [16, 84])
    return float(high - low) / 2


def _alike(one: Array, other: Array) -> float:
    """Return the correlation of pairs, by the spreads of their sums and differences."""
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST:
        return 0.0
    sums, differences = _spread((one + other)[both]) ** 2, _spread((one - other)[both]) ** 2
    return float((sums - differences) / max(sums + differences, np.finfo(float).tiny))
