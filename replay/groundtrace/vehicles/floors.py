"""The noise floor of powers: a low quantile of the last minutes.

What passes lasts shorter than what is quiet, so the low powers of a few minutes are the noise's
(after R. Martin: Noise power spectral density estimation based on optimal smoothing and minimum
statistics, IEEE Trans. Speech Audio Process. 9, 2001, with a quantile in the minimum's place).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Floors:
    """The floor at each cycle.

    Attributes
    ----------
    power, sigma
        Shape (n_channels, n): mean power of the noise and its standard deviation [unit^2].
    """

    power: Array
    sigma: Array


class NoiseFloor:
    """Running low quantile of the last cycles, made up to the mean.

    Powers of noise are gamma distributed with half their degrees of freedom as shape; the quantile
    of that law over its mean is what the quantile found is divided by. The cycle itself counts in.

    Parameters
    ----------
    cycles
        How many are looked back on; the quantile's part of them should be quiet.
    quantile
        From 0 to 1: where a quarter of the cycles is quiet at least, below that.
    least
        Until there are so many, the floor's standard deviation is as large as itself at least.
    """

    def __init__(self, cycles: int = 120, quantile: float = 0.2, least: int = 5) -> None:
        self.cycles, self.quantile, self.least = cycles, quantile, least
        self._power: Array | None = None
        self._freedom: Array | None = None

    def __call__(self, power: Array, freedom: Array) -> Floors:
        """Take powers and their degrees of freedom, shapes (n_channels, n); return the floors."""
        if self._power is None or self._freedom is None:
            self._power, self._freedom = power[:, :0], freedom[:, :0]
        old = self._power.shape[1]
        powers = np.concatenate([self._power, power], axis=1)
        freedoms = np.concatenate([self._freedom, freedom], axis=1)
        found = np.empty((2, *power.shape))
        for column in range(power.shape[1]):
            end = old + column + 1
            span = slice(max(0, end - self.cycles), end)
            found[:, :, column] = self._level(powers[:, span], freedoms[:, span])
        self._power, self._freedom = powers[:, -self.cycles :], freedoms[:, -self.cycles :]
        return Floors(found[0], found[1])

    def _level(self, powers: Array, freedoms: Array) -> tuple[Array, Array]:
        n = powers.shape[1]
        low = np.quantile(powers, self.quantile, axis=1)
        # a pass concentrates on few lines at times: the freedom of the quiet half is the noise's
        quiet = powers <= np.median(powers, axis=1, keepdims=True)
        shape = 0.5 / np.array([np.mean(1 / f[q]) for f, q in zip(freedoms, quiet, strict=True)])
        expected = special.gammaincinv(shape, self.quantile) / shape
        floor = low / expected
        x = expected * shape
        density = shape * np.exp((shape - 1) * np.log(x) - x - special.gammaln(shape))
        spread = np.sqrt(self.quantile * (1 - self.quantile) / n) / (density * expected)
        return floor, floor * np.maximum(spread, 1.0 if n < self.least else 0.0)
