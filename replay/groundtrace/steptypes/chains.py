"""The patterns of one step: in the frontal chain, in the lateral chain, and what they measure.

Source: EPFL, sections on preprocessing and recognition, figures 2 and 3. On either axis a step is
what lies between two minima. The frontal ones are looked for in windows that the vertical signal
gives, from where it rises through its mean to where it falls through it; the lateral ones lie deep
in a window centred on them. What the document leaves open is ours: thresholds, and that the
lateral window follows the signal instead of having a fixed length, so that cadence does not matter.

All is measured on a strip: the three accelerations around a step on a grid of step times, smoothed
so that slow steps show as many harmonics as fast ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..heading.walking_axis import Swing
    from . import chain_kernels as compiled

    Array = NDArray[np.float64]
else:
    compiled = Later("groundtrace.steptypes.chain_kernels")

#: Points of the grid per step time; how far it reaches before and after the contact [steps]. With
#: the two steps that follow it, a step is then known within four.
POINTS, BEFORE, AFTER = 32, 2.5, 1.5625
#: Phase of the points of the grid, in steps about the contact.
PHASE: Array = np.arange(-BEFORE * POINTS, AFTER * POINTS + 1) / POINTS
#: Place of the contact on the grid.
CONTACT = round(BEFORE * POINTS)
#: Standard deviation of the Gaussian that smooths a strip [steps].
_SMOOTH = 0.1
#: The vertical maximum of a step lies in this span of its contact [steps].
_TOP = (-0.35, 0.65)
#: The frontal maximum of a step is looked for this near to its vertical maximum [steps].
_NEAR = 0.5
#: Lateral minima and maxima lie in this part of the range, from its ends.
_DEEP = 0.3
#: Where ranges are compared, and where the vertical mean is taken: first and last place.
_NEAR_CONTACT = (CONTACT - round(1.5 * POINTS), CONTACT + round(1.5 * POINTS))
_ABOUT = (CONTACT - POINTS, CONTACT + POINTS)
#: Weights of a point's neighbours.
_HALF = round(3 * _SMOOTH * POINTS)
_WEIGHTS: Array = np.exp(-0.5 * (np.arange(-_HALF, _HALF + 1) / (_SMOOTH * POINTS)) ** 2)


@dataclass(frozen=True, slots=True)
class Frontal:
    """The frontal pattern of a step.

    Attributes
    ----------
    window
        Length of the vertical signal's stay above its mean [steps].
    lead
        By how much its maximum comes before the vertical one [steps]; NaN where it has none.
    density
        Area of its triangle per length of its base, as a part of the vertical range.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    """

    window: float
    lead: float
    density: float
    slopes: float


@dataclass(frozen=True, slots=True)
class Lateral:
    """The lateral pattern of a step.

    Attributes
    ----------
    share
        Geometric mean of the lateral range over the frontal and over the vertical one.
    lobe
        Distance of its maximum from its middle, as a part of its length.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    inside
        How far on the steep side of the maximum the contact lies, as a part of its length.
    """

    share: float
    lobe: float
    slopes: float
    inside: float


def strip_of(times_s: Array, values: Array, step_s: float) -> Array:
    """Return accelerations on the grid, smoothed, shape (3, n).

    Parameters
    ----------
    times_s
        Of the samples, about the contact [s], shape (m,).
    values
        Accelerations ahead, to the right and up, shape (3, m).
    step_s
        Time of a step [s].
    """
    out = np.empty((len(values), len(PHASE)))
    compiled.strip(times_s, np.ascontiguousarray(values), PHASE * step_s, _WEIGHTS, out)
    return out


def frontal(strip: Array, swing: Swing | None) -> Frontal:
    """Measure the frontal pattern of a strip.

    Parameters
    ----------
    strip
        Shape (3, n).
    swing
        Of the step (:func:`groundtrace.heading.walking_axis.step_swing`); its phase is the lead of
        a step without a frontal maximum of its own.
    """
    window, lead, density, slopes = compiled.frontal(
        strip, PHASE, CONTACT, _TOP, _NEAR, _ABOUT, POINTS, _NEAR_CONTACT
    )
    if np.isnan(lead):
        lead = 0.0 if swing is None else float(np.angle(swing[0])) / (2 * np.pi)
    return Frontal(window, lead, density, slopes)


def lateral(strip: Array) -> Lateral:
    """Measure the lateral pattern of a strip."""
    # over two steps the mean is what a turn adds to the lateral acceleration
    found = compiled.lateral(strip, CONTACT, _DEEP, _NEAR_CONTACT, POINTS)
    return Lateral(*found)
