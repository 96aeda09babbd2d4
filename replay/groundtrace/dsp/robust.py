"""Constants of robust statistics, in standard deviations of a normal law."""

#: Standard deviation over the median of absolute deviations. Source: definition, 1 / Phi^-1(3/4).
MAD_SIGMA = 1.4826

#: Huber's loss is linear beyond this, at 95 % efficiency. Source: P. W. Holland, R. E. Welsch,
#: Robust regression using iteratively reweighted least squares, Commun. Stat. A 6 (1977).
HUBER = 1.345

#: Tukey's biweight is nothing beyond this, at 95 % efficiency. Source: as of :data:`HUBER`.
TUKEY = 4.685

#: Cauchy's weight is a half at this, at 95 % efficiency. Source: as of :data:`HUBER`.
CAUCHY = 2.385
