"""Waves of an isotropic elastic solid: P and S inside it, Rayleigh's on its surface.

Source: the thesis, sections 1.1 and 1.2. Its example (lambda = 7000 MPa, mu = 10000 MPa,
2500 kg/m3) says c_p = 4400 m/s; equation (1.2) gives 3286 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from ..errors import PipelineError
from .bisection import bisect

if TYPE_CHECKING:
    from ..simulate.plate import Plate


@dataclass(frozen=True, slots=True)
class Solid:
    """An isotropic elastic solid.

    Attributes
    ----------
    young_pa
        Young's modulus E [Pa].
    density_kgm3
        rho [kg/m3].
    poisson
        Poisson's ratio, from 0 to below 1/2.

    Raises
    ------
    PipelineError
        Where a constant lies outside its range.
    """

    young_pa: float
    density_kgm3: float
    poisson: float

    def __post_init__(self) -> None:
        for name in ("young_pa", "density_kgm3"):
            if not getattr(self, name) > 0:
                raise PipelineError(f"solid: {name}: expected > 0, found {getattr(self, name)}")
        # of_velocities may round to just below 0
        if not -1e-9 <= self.poisson < 0.5:
            raise PipelineError(f"solid: poisson: expected 0 <= ratio < 0.5, found {self.poisson}")

    @classmethod
    def of_plate(cls, plate: Plate) -> Self:
        """Return what a plate is made of."""
        return cls(plate.young_pa, plate.density_kgm3, plate.poisson)

    @classmethod
    def of_lame(cls, lame_pa: float, shear_pa: float, density_kgm3: float) -> Self:
        """Return the solid of Lame's constants lambda and mu [Pa], under (1.3)."""
        poisson = lame_pa / (2 * (lame_pa + shear_pa))
        return cls(2 * shear_pa * (1 + poisson), density_kgm3, poisson)

    @classmethod
    def of_velocities(cls, p_mps: float, s_mps: float, density_kgm3: float) -> Self:
        """Return the solid of measured velocities [m/s]: how soils are usually described."""
        shear_pa = density_kgm3 * s_mps**2
        return cls.of_lame(density_kgm3 * p_mps**2 - 2 * shear_pa, shear_pa, density_kgm3)

    @property
    def shear_pa(self) -> float:
        """Lame's mu, the shear modulus [Pa]."""
        return self.young_pa / (2 * (1 + self.poisson))

    @property
    def lame_pa(self) -> float:
        """Lame's lambda [Pa]."""
        return 2 * self.shear_pa * self.poisson / (1 - 2 * self.poisson)

    @property
    def p_mps(self) -> float:
        """Velocity of compression waves, sqrt((lambda + 2 mu) / rho), (1.2)."""
        return float(np.sqrt((self.lame_pa + 2 * self.shear_pa) / self.density_kgm3))

    @property
    def s_mps(self) -> float:
        """Velocity of shear waves, sqrt(mu / rho), (1.2)."""
        return float(np.sqrt(self.shear_pa / self.density_kgm3))

    @property
    def rayleigh_mps(self) -> float:
        """Velocity of the Rayleigh wave: root of the equation of a free surface.

        With s = (c / c_s)^2 and p = (c / c_p)^2 that is (2 - s)^2 = 4 sqrt(1 - p) sqrt(1 - s).
        """
        squared = (self.s_mps / self.p_mps) ** 2
        ratio = bisect(
            lambda c: (2 - c**2) ** 2 - 4 * np.sqrt((1 - squared * c**2) * (1 - c**2)),
            np.array([0.5]),  # c = 0 is a root too, but no wave
            np.array([1.0]),
        )
        return float(ratio[0]) * self.s_mps

    @property
    def plate_mps(self) -> float:
        """Velocity of S0 at low frequency, 2 c_s sqrt(1 - (c_s / c_p)^2), (1.6)."""
        return 2 * self.s_mps * float(np.sqrt(1 - (self.s_mps / self.p_mps) ** 2))
