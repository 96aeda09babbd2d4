"""Lamb waves of a free plate: P and SV waves coupled by its two faces.

Source: the thesis, section 1.3; the velocity of A0 is a root of a Rayleigh-Lamb equation, with
which (1.7) shares only the limit of low frequency. With s = (c / c_s)^2, p = (c / c_p)^2,
k = omega / c, alpha = k sqrt(1 - p), beta = k sqrt(1 - s) and half the thickness b::

    A0:  (2 - s)^2 tanh(alpha b) = 4 sqrt(1 - p) sqrt(1 - s) tanh(beta b)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .bisection import bisect
from .solid import Solid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..simulate.plate import Plate

    Array = NDArray[np.float64]


def thin_a0_mps(plate: Plate, frequency_hz: Array) -> Array:
    """Return the phase velocity of bending waves of a thin plate [m/s], (1.7): sqrt(a omega).

    It grows without bound, where A0 ends at the Rayleigh velocity: see :func:`thin_limit_hz`. The
    group velocity is twice that, (4.6).
    """
    velocity: Array = np.sqrt(plate.dispersion_m2s * 2 * np.pi * frequency_hz)
    return velocity


def thin_limit_hz(plate: Plate) -> float:
    """Return where six thicknesses are one wavelength of (1.7), under (4.1) [Hz].

    Section 4.1 says 2000 Hz for 0.2 m of concrete, with 2400 m/s for the velocity. By (1.7) itself
    it is 797 Hz: there the wave runs at 956 m/s, 8.7 % faster than A0.
    """
    return float(plate.dispersion_m2s * 2 * np.pi / (6 * plate.thickness_m) ** 2)


def a0_mps(plate: Plate, frequency_hz: Array) -> Array:
    """Return the phase velocity of A0 [m/s], from the bending wave's to the Rayleigh velocity.

    Parameters
    ----------
    plate
        Its loss does not count.
    frequency_hz
        Shape (n,), above 0.

    Returns
    -------
    NDArray
        Shape (n,).
    """
    solid = Solid.of_plate(plate)

    def bent(c: Array) -> Array:
        s, p, half_turn = _terms(plate, solid, frequency_hz, c)
        alpha, beta = np.sqrt(1 - p), np.sqrt(1 - s)
        balance: Array = (2 - s) ** 2 * np.tanh(half_turn * alpha)
        balance -= 4 * alpha * beta * np.tanh(half_turn * beta)
        return balance

    highest = np.full(np.shape(frequency_hz), solid.s_mps)
    # A0 stays above half of its two limits, and below that bound only c = 0 is a root
    lowest = 0.5 * np.minimum(thin_a0_mps(plate, frequency_hz), solid.rayleigh_mps)
    return bisect(bent, lowest, highest)


def _terms(plate: Plate, solid: Solid, frequency_hz: Array, c: Array) -> tuple[Array, Array, Array]:
    """Return (c / c_s)^2, (c / c_p)^2 and k b, each shape (n,)."""
    half_turn: Array = np.pi * frequency_hz * plate.thickness_m / c
    return (c / solid.s_mps) ** 2, (c / solid.p_mps) ** 2, half_turn


@dataclass(frozen=True, slots=True)
class Cutoff:
    """Where a Lamb mode begins.

    Attributes
    ----------
    mode
        "A1", "S1", "S2", ...: numbered upwards in each family.
    frequency_hz
        Below it the mode carries no energy [Hz].
    wave
        What crosses the thickness there: "P" or "S".
    """

    mode: str
    frequency_hz: float
    wave: Literal["P", "S"]


def cutoffs(plate: Plate, top_hz: float) -> list[Cutoff]:
    """Return the cut-offs of the higher Lamb modes up to a frequency, lowest first.

    At each the thickness is p half wavelengths, (1.5): of the shear wave for odd p of antisymmetric
    and even p of symmetric modes, of the compression wave the other way about.
    """
    solid = Solid.of_plate(plate)
    found: dict[str, list[tuple[float, Literal["P", "S"]]]] = {"A": [], "S": []}
    waves: tuple[tuple[Literal["P", "S"], float, str], ...] = (
        ("S", solid.s_mps, "SA"),
        ("P", solid.p_mps, "AS"),
    )
    for wave, velocity, family in waves:
        lowest_hz = velocity / (2 * plate.thickness_m)
        for p in range(1, int(top_hz / lowest_hz) + 1):
            found[family[p % 2]].append((p * lowest_hz, wave))
    numbered = [
        Cutoff(f"{family}{number}", frequency_hz, wave)
        for family, begins in found.items()
        for number, (frequency_hz, wave) in enumerate(sorted(begins), 1)
    ]
    return sorted(numbered, key=lambda cutoff: cutoff.frequency_hz)
