"""Robust statistics: constants in standard deviations of a normal law, and its chi-square."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Standard deviation over the median of absolute deviations. Source: definition, 1 / Phi^-1(3/4).
MAD_SIGMA = 1.4826

#: Huber's loss is linear beyond this, at 95 % efficiency. Source: P. W. Holland, R. E. Welsch,
#: Robust regression using iteratively reweighted least squares, Commun. Stat. A 6 (1977).
HUBER = 1.345

#: Tukey's biweight is nothing beyond this, at 95 % efficiency. Source: as of :data:`HUBER`.
TUKEY = 4.685

#: Cauchy's weight is a half at this, at 95 % efficiency. Source: as of :data:`HUBER`.
CAUCHY = 2.385


#: Deviations of a normal law that are exceeded once in a thousand times. Source: definition.
RARELY = 3.09


def medians(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return medians over the last axis; NaN is left out, and given where nothing else is.

    numpy's own leaves NaN out by masked arrays, 40 ms of a command, and takes a row at a time.
    """
    ordered = np.sort(values, axis=-1)
    last = np.maximum(np.sum(ordered == ordered, axis=-1, keepdims=True) - 1, 0)
    middle = np.take_along_axis(ordered, np.concatenate([last // 2, (last + 1) // 2], -1), -1)
    return np.asarray((middle[..., 0] + middle[..., 1]) / 2, np.float64)


def chi_square_quantile(freedom: float, normal: float) -> float:
    """Return the quantile of chi-square that a normal law has at ``normal`` deviations.

    Source: E. B. Wilson, M. M. Hilferty, The distribution of chi-square, PNAS 17 (1931).

    Parameters
    ----------
    freedom
        Degrees of freedom, over 0.
    normal
        Deviations from the mean.
    """
    part = 2 / (9 * freedom)
    return freedom * (1 - part + normal * math.sqrt(part)) ** 3


#: What a :class:`ChiSquareCheck` looks back on, the least of it, what each counts at most of what
#: is expected, and what is granted over the limit. Chosen by judgement: 20 are ten seconds of
#: steps, of which one in ten may be false.
LOOKED_BACK, LEAST, MOST_EACH, GRANTED = 20, 8, 10.0, 1.0


@dataclass(slots=True)
class ChiSquareCheck:
    """Whether what a model leaves over is as it presumes: chi-square of the last times."""

    _last: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=LOOKED_BACK))

    def learn(self, square: float, freedom: int = 1) -> None:
        """Take in a sum of squares in variances, and its degrees of freedom."""
        self._last.append((min(square, MOST_EACH * freedom), freedom))

    @property
    def ratio(self) -> float:
        """Chi-square over what it is expected to be; 0 while it is told by too few."""
        if len(self._last) < LEAST:
            return 0.0
        return sum(square for square, _ in self._last) / sum(freedom for _, freedom in self._last)

    @property
    def limit(self) -> float:
        """The ratio from which the model is contradicted."""
        freedom = sum(freedom for _, freedom in self._last) or 1
        return chi_square_quantile(freedom, RARELY) / freedom + GRANTED
