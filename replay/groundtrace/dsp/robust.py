"""Robust statistics: constants in standard deviations of a normal law, and its chi-square."""

import math

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
