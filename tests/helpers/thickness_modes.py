"""The modes of a free plate by Rayleigh and Ritz: an oracle that knows no Rayleigh-Lamb equation.

Across the thickness the displacement is a polynomial; free faces need no condition of their own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eigh

if TYPE_CHECKING:
    from groundtrace.localizers.wave_physics import Solid

DEGREE = 24


def mode_hz(solid: Solid, thickness_m: float, wavenumber: float, symmetric: bool) -> np.ndarray:
    """Frequencies of the modes of one family at a wavenumber [rad/m], lowest first."""
    z, weight = legendre.leggauss(2 * DEGREE)
    values = legendre.legvander(z, DEGREE).T
    slopes = np.array([legendre.legval(z, legendre.legder(row)) for row in np.eye(DEGREE + 1)])
    slopes *= 2 / thickness_m
    even, odd = slice(0, None, 2), slice(1, None, 2)
    along, across = (even, odd) if symmetric else (odd, even)
    none_u, none_w = np.zeros_like(values[along]), np.zeros_like(values[across])
    stretch = np.concatenate([-wavenumber * values[along], none_w])
    thicken = np.concatenate([none_u, slopes[across]])
    shear = np.concatenate([slopes[along], wavenumber * values[across]])
    moved = [np.concatenate([values[along], none_w]), np.concatenate([none_u, values[across]])]

    def product(field: np.ndarray) -> np.ndarray:
        return (field * weight) @ field.T

    stiffness = solid.lame_pa * product(stretch + thicken)
    stiffness += 2 * solid.shear_pa * (product(stretch) + product(thicken))
    stiffness += solid.shear_pa * product(shear)
    mass = solid.density_kgm3 * sum(product(field) for field in moved)
    squares = eigh(stiffness, mass, eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0)) / (2 * np.pi)
