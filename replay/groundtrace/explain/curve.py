"""The arrival curve of a recording: t = t0 + k d^p with one k and p, and one t0 a step.

It judges arrivals apart from any localizer. The exponent lies between 1 (a front that does not
disperse) and 4/3 (thesis, equation (4.24)); of a few in between the one that fits best is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers import power_law
from ..localizers.arrival_fit import distances

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .relocate import Arrivals

    Array = NDArray[np.float64]

EXPONENTS = (1.0, 7 / 6, power_law.EXPONENT)
#: Passes of reweighting.
PASSES = 8
#: The least error of an arrival reckoned with [s]: no picker is better.
LEAST_NOISE_S = 5e-5
#: Turns a median of absolute values into a standard deviation.
NORMAL = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A fitted curve.

    Attributes
    ----------
    exponent, slope
        p, and k [s/m^p].
    origin_s
        Shape (m,): t0 of each step [s]; NaN where it has no arrival.
    noise_s
        Standard deviation of an arrival, robust [s].
    """

    exponent: float
    slope: float
    origin_s: Array
    noise_s: float

    def misfit_s(self, sources: Array, place: Array, times_s: Array) -> Array:
        """Return by how much arrivals at one sensor come after the curve, shape (m,) [s].

        Parameters
        ----------
        sources
            Shape (m, 2): places of the steps [m].
        place
            Shape (2,): the sensor's [m].
        times_s
            Shape (m,): arrivals there [s]; NaN where there is none.
        """
        apart = np.hypot(*(sources - place).T)
        late: Array = times_s - self.origin_s - self.slope * apart**self.exponent
        return late


def fit_curve(sources: Array, positions: Array, times_s: Array) -> Curve | None:
    """Return the curve that fits arrivals best; None where they do not grow with distance.

    Parameters
    ----------
    sources
        Shape (m, 2): places of the steps [m]; NaN where unknown.
    positions
        Shape (n, 2): of the sensors [m].
    times_s
        Shape (m, n): arrivals [s]; NaN where there is none.
    """
    apart = distances(sources, positions)
    known = np.isfinite(times_s) & np.isfinite(apart)
    if known.sum() < 2 * len(positions):
        return None
    curves = [_fitted(apart, times_s, known, exponent) for exponent in EXPONENTS]
    good = [curve for curve in curves if curve.slope > 0]
    return min(good, key=lambda curve: curve.noise_s, default=None)


def _fitted(apart: Array, times_s: Array, known: NDArray[np.bool_], exponent: float) -> Curve:
    """Fit by reweighting: residuals beyond 1.345 standard deviations count linearly."""
    u = np.where(known, apart, 0.0) ** exponent
    t = np.where(known, times_s, 0.0)
    weight = known.astype(np.float64)
    for _ in range(PASSES):
        whole = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        u_off = u - (weight * u).sum(axis=1, keepdims=True) / whole
        t_off = t - (weight * t).sum(axis=1, keepdims=True) / whole
        slope = float((weight * u_off * t_off).sum() / max((weight * u_off**2).sum(), 1e-12))
        left = t_off - slope * u_off
        noise_s = max(NORMAL * float(np.median(np.abs(left[known]))), LEAST_NOISE_S)
        bound = power_law.HUBER * noise_s
        weight = known * np.minimum(1.0, bound / np.maximum(np.abs(left), bound))
    heard = known.any(axis=1)
    origin = np.where(heard, (t - slope * u - left)[:, 0], np.nan)
    return Curve(exponent, slope, origin, noise_s)


def blind_sources(positions: Array, arrivals: Arrivals, outline: Array | None) -> Array:
    """Return places of the steps from their arrivals alone, shape (m, 2) [m]; NaN with too few.

    By :mod:`~groundtrace.localizers.power_law`, which needs no calibration; with no more arrivals
    than it has unknowns there is no telling an arrival that is off.
    """
    found = np.full((len(arrivals.step_ns), 2), np.nan)
    for row, times in enumerate(arrivals.times_s):
        if np.isfinite(times).sum() > power_law.UNKNOWNS:
            location = power_law.locate(positions, times, outline)
            found[row] = location.x, location.y
    return found
