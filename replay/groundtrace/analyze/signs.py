"""How many signs of time differences are measured wrong, place by place.

Source: the thesis on footstep localisation, section 5.3.2; (5.26) is corrected: it lacks the
absolute value of the time difference. The number of wrong signs follows the Poisson-binomial law,
of which the thesis's Poisson law is the limit; its mean is the same lambda.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers.regions import pairs
from ..localizers.sign_model import chance_wrong

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: This part of all steps has at most :attr:`SignErrors.most` wrong signs.
USUAL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class SignErrors:
    """Wrong signs over a room.

    Attributes
    ----------
    pairs
        How many signs there are.
    independent
        Shape (m,): mean number where every difference errs on its own by sigma, as the thesis
        simulates it.
    physical
        Shape (m,): mean number where arrivals err by sigma, and differences by sqrt 2 times that.
    variance, most
        Of the number at the worst place of ``physical``: variance, and the number that 95 % of
        steps do not exceed, from draws, since differences that share a sensor hang together.
    variance_independent, most_independent
        The same of the Poisson-binomial law at the worst place of ``independent``.
    """

    pairs: int
    independent: Array
    physical: Array
    variance: float
    most: int
    variance_independent: float
    most_independent: int


def mean_wrong(times_s: Array, sigma_s: float) -> Array:
    """Return lambda (5.25), the mean number of wrong signs.

    Parameters
    ----------
    times_s
        Shape (..., n): true arrivals [s].
    sigma_s
        Standard deviation of a difference [s].
    """
    wrong: Array = chance_wrong(times_s, *pairs(times_s.shape[-1]), sigma_s).sum(axis=-1)
    return wrong


def poisson_binomial(chances: Array) -> Array:
    """Return the law of the number of events of given chances, shape (n,): shape (n + 1,)."""
    law = np.ones(1)
    for chance in chances:
        law = np.convolve(law, (1 - chance, chance))
    return law


def sign_errors(times_s: Array, sigma_s: float, draws: int, seed: int) -> SignErrors:
    """Return how many signs are wrong.

    Parameters
    ----------
    times_s
        Shape (m, n): true arrivals from each node [s].
    sigma_s
        Standard deviation of an arrival, and of a difference where those are independent [s].
    draws
        Random errors at the worst place.
    seed
        Of them.
    """
    first, second = pairs(times_s.shape[-1])
    independent = mean_wrong(times_s, sigma_s)
    physical = mean_wrong(times_s, np.sqrt(2) * sigma_s)
    chances = chance_wrong(times_s[independent.argmax()], first, second, sigma_s)
    reached = np.cumsum(poisson_binomial(chances)) >= USUAL
    counts = drawn_wrong(times_s[physical.argmax()], sigma_s, draws, seed)
    return SignErrors(
        len(first),
        independent,
        physical,
        float(counts.var()),
        int(np.quantile(counts, USUAL, method="inverted_cdf")),
        float(np.sum(chances * (1 - chances))),
        int(reached.argmax()),
    )


def drawn_wrong(times_s: Array, sigma_s: float, draws: int, seed: int) -> NDArray[np.intp]:
    """Return how many signs are wrong in each of many draws of arrivals, shape (draws,).

    Parameters
    ----------
    times_s
        Shape (n,): true arrivals [s].
    sigma_s
        Standard deviation of an arrival [s].
    draws, seed
        Number and seed of the draws.
    """
    first, second = pairs(len(times_s))
    true = times_s[first] - times_s[second]
    measured = times_s + sigma_s * np.random.default_rng(seed).standard_normal(
        (draws, len(times_s))
    )
    wrong: NDArray[np.intp] = np.sum((measured[:, first] - measured[:, second]) * true <= 0, axis=1)
    # where both arrive at once any sign is wrong half the time
    level = np.flatnonzero(true == 0)
    late = (measured[:, first[level]] > measured[:, second[level]]).sum(axis=1)
    wrong += late - len(level)
    return wrong
