"""The localizers that pipelines know by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from ..parameters import gate, measured
from . import hyperbolic, power_law, sign_model, so_tdoa
from .api import LocalizerParameters, columns, gates

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..detector import Emits
    from .api import Site
    from .location import Location

    Times = NDArray[np.float64]

#: Time scale of the velocity law where the geometry names none [s]: that of the thesis's floor.
THETA_S = 1e-5


@dataclass(frozen=True, slots=True)
class SoTdoaParameters(LocalizerParameters):
    """Parameters of :class:`SoTdoa`."""

    max_residual: Annotated[
        float, gate("1", "Largest part of the signs that the place contradicts.", ge=0, le=1)
    ] = 0.25
    sign_sigma_s: Annotated[
        float,
        measured("s", "Error of an arrival in the model of sign errors; 0 counts signs.", ge=0),
    ] = 0.0


class SoTdoa:
    """Regions of the room by the order of arrivals: nothing of the floor need be known."""

    Parameters = SoTdoaParameters
    emits: Emits = "fix"
    columns = columns("1")
    gates = gates("1", "max_residual")

    def __init__(self, parameters: SoTdoaParameters) -> None:
        self.parameters = parameters

    def start(self, site: Site) -> str:
        """Find the regions."""
        self.regions = so_tdoa.known_regions(site.positions, site.outline)
        self.theta_s = site.medium.theta_s or THETA_S
        return ""

    def locate(self, times_s: Times) -> Location:
        """Return the mean of the regions that fit best, or of all by their likelihood."""
        sigma = self.parameters.sign_sigma_s
        if sigma > 0:
            return sign_model.likeliest(self.regions, times_s, self.theta_s, sigma)
        return so_tdoa.among(self.regions, times_s)


@dataclass(frozen=True, slots=True)
class HyperbolicParameters(LocalizerParameters):
    """Parameters of :class:`Hyperbolic`."""

    max_residual_s: Annotated[
        float, gate("s", "Largest root mean square that arrivals are off.", ge=0)
    ] = 0.003
    velocity_mps: Annotated[
        float, measured("m/s", "Calibrated velocity; 0 takes the geometry's.", ge=0)
    ] = 0.0
    sigma_s: Annotated[float, measured("s", "Least error of an arrival reckoned with.", gt=0)] = (
        5e-4
    )


class Hyperbolic:
    """Differences of arrivals at one calibrated velocity."""

    Parameters = HyperbolicParameters
    emits: Emits = "fix"
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def __init__(self, parameters: HyperbolicParameters) -> None:
        self.parameters = parameters

    def start(self, site: Site) -> str:
        """Settle the velocity."""
        self.site = site
        self.velocity_mps = self.parameters.velocity_mps or site.medium.velocity_mps or 0.0
        return "" if self.velocity_mps > 0 else "a velocity (of the medium, or velocity_mps)"

    def locate(self, times_s: Times) -> Location:
        """Return the place that fits best."""
        site, sigma = self.site, self.parameters.sigma_s
        return hyperbolic.locate(site.positions, times_s, self.velocity_mps, site.outline, sigma)


@dataclass(frozen=True, slots=True)
class PowerLawParameters(LocalizerParameters):
    """Parameters of :class:`PowerLaw`."""

    max_residual_s: Annotated[
        float, gate("s", "Largest root of the mean loss of the arrivals.", ge=0)
    ] = 0.003
    exponent: Annotated[
        float, measured("1", "Power of distance that arrivals grow with.", gt=0, le=2)
    ] = power_law.EXPONENT
    sigma_s: Annotated[float, measured("s", "Least error of an arrival reckoned with.", gt=0)] = (
        5e-4
    )
    huber: Annotated[
        float, measured("1", "Residuals beyond so many sigma_s count linearly.", gt=0)
    ] = power_law.HUBER


class PowerLaw:
    """Arrivals that grow with a power of distance: calibration-free, and recommended."""

    Parameters = PowerLawParameters
    emits: Emits = "fix"
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def __init__(self, parameters: PowerLawParameters) -> None:
        self.parameters = parameters

    def start(self, site: Site) -> str:
        """Remember the site."""
        self.site = site
        return ""

    def locate(self, times_s: Times) -> Location:
        """Return the place that fits best."""
        p, site = self.parameters, self.site
        return power_law.locate(
            site.positions, times_s, site.outline, p.exponent, p.sigma_s, p.huber
        )
