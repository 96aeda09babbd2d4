"""Waves of horizontal shear: SH modes of a plate, Love waves of a soft layer on a harder ground.

Source: the thesis, section 1.4, which names them and gives the bounds of Love's velocity; the
equations are the classical ones. A vertical force excites neither, edges and oblique forces do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import PipelineError
from .bisection import bisect
from .solid import Solid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..simulate.plate import Plate

    Array = NDArray[np.float64]


def sh_cutoff_hz(plate: Plate, mode: int) -> float:
    """Return where SH mode 0, 1, ... begins: the thickness is that many half wavelengths [Hz]."""
    return mode * Solid.of_plate(plate).s_mps / (2 * plate.thickness_m)


def sh_mps(plate: Plate, frequency_hz: Array, mode: int = 0) -> Array:
    """Return the phase velocity of an SH mode [m/s]; NaN up to its cut-off.

    Mode 0 is the shear wave itself, without dispersion. The group velocity is c_s^2 over this.

    Parameters
    ----------
    plate
        The plate.
    frequency_hz
        Shape (n,), above 0.
    mode
        0, 1, ...

    Returns
    -------
    NDArray
        Shape (n,).
    """
    across = sh_cutoff_hz(plate, mode) / frequency_hz
    along = np.sqrt(1 - across**2, out=np.full(across.shape, np.nan), where=across < 1)
    velocity: Array = Solid.of_plate(plate).s_mps / along
    return velocity


@dataclass(frozen=True, slots=True)
class Layered:
    """A layer on a half space in which shear waves are faster.

    Attributes
    ----------
    layer, ground
        What they are made of.
    thickness_m
        Of the layer [m].

    Raises
    ------
    PipelineError
        Where the layer is not the slower one: there is no Love wave.
    """

    layer: Solid
    ground: Solid
    thickness_m: float

    def __post_init__(self) -> None:
        slow, fast = self.layer.s_mps, self.ground.s_mps
        if not slow < fast:
            raise PipelineError(
                f"layered ground: expected a layer slower than {fast:.0f} m/s, found {slow:.0f}"
            )

    def love_cutoff_hz(self, mode: int) -> float:
        """Return where Love mode 0, 1, ... begins [Hz]; mode 0 at 0."""
        slowness = np.sqrt(self.layer.s_mps**-2 - self.ground.s_mps**-2)
        return float(mode / (2 * self.thickness_m * slowness))

    def love_mps(self, frequency_hz: Array, mode: int = 0) -> Array:
        """Return the phase velocity of a Love mode [m/s]; NaN up to its cut-off.

        It falls from the ground's shear velocity at the cut-off to the layer's.

        Parameters
        ----------
        frequency_hz
            Shape (n,), above 0.
        mode
            0, 1, ...

        Returns
        -------
        NDArray
            Shape (n,).
        """
        slow, fast = self.layer.s_mps, self.ground.s_mps

        def turns(c: Array) -> Array:
            down = np.sqrt(slow**-2 - c**-2)
            out = np.sqrt(np.maximum(c**-2 - fast**-2, 0))
            lag = np.arctan2(self.ground.shear_pa * out, self.layer.shear_pa * down)
            phase: Array = 2 * np.pi * frequency_hz * self.thickness_m * down
            return phase - mode * np.pi - lag

        shape = np.shape(frequency_hz)
        velocity = bisect(turns, np.full(shape, slow), np.full(shape, fast))
        return np.where(frequency_hz > self.love_cutoff_hz(mode), velocity, np.nan)
