"""Direction of arrival at a station of three axes, by the polarisation of surface waves.

Source: the thesis on footstep localisation, appendix A. A Rayleigh wave, and the bending wave of a
floor, move the surface in an ellipse in the plane of the vertical and the direction of propagation:
the radial motion is a quarter period from the vertical. Two equations are corrected here:

- (A.1) has sine and cosine of the direction interchanged against (A.3), which as printed returns
  90 degrees minus the direction; here x goes with the cosine.
- (A.4) is the covariance of the real signals; there the quarter period makes vertical and radial
  motion uncorrelated, so that the azimuth of the eigenvector is noise. Here it is the covariance
  of the analytic signals, which sees the quarter period as a phase.

Without knowing which way round the ellipse is run the direction has an ambiguity of pi. Rayleigh
waves in a homogeneous ground and bending waves of a floor are retrograde.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Method = Literal["covariance", "surface-wave"]
#: Parts of the window that are left out one at a time, for the error of the direction.
PARTS = 8


@dataclass(frozen=True, slots=True)
class Polarization:
    """The motion of the ground at one station.

    Attributes
    ----------
    azimuth_rad
        Towards the source of a retrograde wave, counter-clockwise from x [rad].
    sigma_rad
        Its standard deviation, by leaving out parts of the window [rad].
    degree
        Degree of polarisation: 1 for one wave, 0 for noise of three equal axes.
    ellipticity
        Radial over vertical amplitude.
    """

    azimuth_rad: float
    sigma_rad: float
    degree: float
    ellipticity: float


def analytic(values: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the analytic signals of columns, each less its mean, shape (n, 3)."""
    from scipy.signal import hilbert

    signal: NDArray[np.complex128] = hilbert(values - values.mean(axis=0), axis=0)
    return signal


def polarization(values: NDArray[np.float64], method: Method = "covariance") -> Polarization:
    """Return the polarisation of a window of signal.

    Parameters
    ----------
    values
        Shape (n, 3): x, y and z (up), n at least 2 * :data:`PARTS`.
    method
        ``covariance``: the eigenvector of the analytic covariance (AMC, (A.4) to (A.8)).
        ``surface-wave``: the vertical, a quarter period on, against the horizontal (AOS, (A.2)
        and (A.3)).

    Notes
    -----
    ``surface-wave`` averages out transverse (Love) waves whose frequencies differ by more than the
    inverse of the window; ``covariance`` does so only while they are the weaker motion. A
    transverse wave in step with the vertical turns both.
    """
    signal = analytic(values)
    # motion of axis i with axis j is part.T @ conj(part); the parts add up to the whole
    parts = np.array([p.T @ p.conj() for p in np.array_split(signal, PARTS)])
    whole = parts.sum(axis=0)
    azimuth, radial = _direction(whole, method)
    others = np.array([_direction(whole - part, method)[0] for part in parts])
    turns = np.angle(np.exp(1j * (others - azimuth)))
    sigma = float(np.sqrt((PARTS - 1) / PARTS * np.sum(turns**2)))
    trace = float(np.trace(whole).real)
    if trace <= 0:
        return Polarization(0.0, np.pi, 0.0, 0.0)
    squares = float(np.trace(whole @ whole).real)
    degree = float(np.sqrt(max((3 * squares / trace**2 - 1) / 2, 0.0)))
    vertical = float(np.sqrt(whole[2, 2].real))
    return Polarization(azimuth, sigma, degree, radial / vertical if vertical > 0 else np.inf)


def _direction(covariance: NDArray[np.complex128], method: Method) -> tuple[float, float]:
    """Return the azimuth of a retrograde wave's source, and the radial amplitude.

    Up is cos(w t) and away from the source -sin(w t), whose analytic signal is i exp(i w t): so
    with the vertical's phase taken off, the imaginary part points away from the source.
    """
    if method == "surface-wave":
        away = covariance[:2, 2].imag
        scale = max(float(covariance[2, 2].real), np.finfo(float).tiny)
        return float(np.arctan2(-away[1], -away[0])), float(np.hypot(*away) / np.sqrt(scale))
    values, vectors = np.linalg.eigh(covariance)
    main = vectors[:, -1] * np.sqrt(max(values[-1], 0.0))
    away = (main[:2] * np.exp(-1j * np.angle(main[2]))).imag
    return float(np.arctan2(-away[1], -away[0])), float(np.hypot(*away))
