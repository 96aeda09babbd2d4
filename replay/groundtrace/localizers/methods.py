"""The localizers that pipelines know by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from ..dsp.robust import HUBER
from ..pipeline.parameters import gate, measured
from . import arrival_order, joint_calibration, tdoa
from .base import (
    EXPONENT,
    ArrivalLocalizer,
    LocalizerParameters,
    ModelCheck,
    RunningSigma,
    columns,
    gates,
)
from .path_errors import PathErrors

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..pipeline.stage import LocationEstimate
    from .base import PlacedSensors

    Times = NDArray[np.float64]

#: Time scale of the velocity law where the geometry names none [s]: that of the thesis's floor.
#: Source: thesis, chapters 5 and 6, where it is 5e-6 to 5e-5.
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


class SoTdoa(ArrivalLocalizer):
    """Regions of the room by the order of arrivals: nothing of the floor need be known."""

    Parameters = SoTdoaParameters
    columns = columns("1")
    gates = gates("1", "max_residual")

    def path_errors(self) -> PathErrors:
        """Return what learns how far arrivals err alike."""
        return PathErrors(self._positions)

    def prepare(self, site: PlacedSensors) -> str:
        """Find the regions."""
        self.regions = arrival_order.known_regions(site.positions, site.outline)
        self.theta_s = site.medium.theta_s or THETA_S
        if self.parameters.sign_sigma_s > 0 and site.length_unit != "m":
            return "a known unit of length (or sign_sigma_s = 0)"
        return ""

    def locate(self, times_s: Times) -> LocationEstimate:
        """Return the mean of the regions that fit best, or of all by their likelihood."""
        sigma = self.parameters.sign_sigma_s
        if sigma > 0:
            return arrival_order.likeliest(self.regions, times_s, self.theta_s, sigma)
        return arrival_order.among(self.regions, times_s)


@dataclass(frozen=True, slots=True)
class HyperbolicParameters(LocalizerParameters):
    """Parameters of :class:`Hyperbolic`."""

    max_residual_s: Annotated[
        float, gate("s", "Largest root mean square that arrivals are off.", ge=0)
    ] = 0.003
    velocity_mps: Annotated[
        float, measured("m/s", "Calibrated velocity; 0 takes the geometry's.", ge=0)
    ] = 0.0
    sigma_s: Annotated[
        float, measured("s", "Error of an arrival until the places found tell it.", gt=0)
    ] = 5e-4


class Hyperbolic(ArrivalLocalizer):
    """Differences of arrivals at one calibrated velocity."""

    Parameters = HyperbolicParameters
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def prepare(self, site: PlacedSensors) -> str:
        """Settle the velocity."""
        self.site = site
        self.velocity_mps = self.parameters.velocity_mps or site.medium.velocity_mps or 0.0
        first_s = site.medium.arrival_sigma_s or self.parameters.sigma_s
        self.sigma = RunningSigma(first_s, tdoa.HYPERBOLIC_UNKNOWNS)
        unit = " in units/s" if site.length_unit != "m" else ""
        return "" if self.velocity_mps > 0 else f"a velocity{unit} (of the medium, or velocity_mps)"

    def model_check(self) -> ModelCheck:
        """Return the check of places with more arrivals than unknowns."""
        return ModelCheck(self.parameters.sigma_s, tdoa.HYPERBOLIC_UNKNOWNS)

    def path_errors(self) -> PathErrors:
        """Return what learns how far arrivals err alike."""
        return PathErrors(self.site.positions, scale=1 / self.velocity_mps)

    def locate(self, times_s: Times) -> LocationEstimate:
        """Return the place that fits best."""
        site, sigma = self.site, self.sigma.value_s
        estimate = tdoa.locate_hyperbolic(
            site.positions, times_s, self.velocity_mps, site.outline, sigma
        )
        self.sigma.learn(estimate)
        return estimate


@dataclass(frozen=True, slots=True)
class PowerLawParameters(LocalizerParameters):
    """Parameters of :class:`PowerLaw`."""

    max_residual_s: Annotated[
        float, gate("s", "Largest root of the mean loss of the arrivals.", ge=0)
    ] = 0.003
    exponent: Annotated[
        float, measured("1", "Power of distance that arrivals grow with.", gt=0, le=2)
    ] = EXPONENT
    sigma_s: Annotated[
        float, measured("s", "Error of an arrival until the places found tell it.", gt=0)
    ] = 5e-4
    huber: Annotated[
        float, measured("1", "Residuals beyond so many sigma_s, as given, count linearly.", gt=0)
    ] = HUBER


class PowerLaw(ArrivalLocalizer):
    """Arrivals that grow with a power of distance: calibration-free, and recommended."""

    Parameters = PowerLawParameters
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def prepare(self, site: PlacedSensors) -> str:
        """Remember the site."""
        self.site = site
        first_s = site.medium.arrival_sigma_s or self.parameters.sigma_s
        self.sigma = RunningSigma(first_s, tdoa.POWER_LAW_UNKNOWNS)
        return ""

    def model_check(self) -> ModelCheck:
        """Return the check of places with more arrivals than unknowns."""
        return ModelCheck(self.parameters.sigma_s, tdoa.POWER_LAW_UNKNOWNS)

    def path_errors(self) -> PathErrors:
        """Return what learns how far arrivals err alike."""
        return PathErrors(self.site.positions, self.parameters.exponent)

    def locate(self, times_s: Times) -> LocationEstimate:
        """Return the place that fits best."""
        p, site, sigma = self.parameters, self.site, self.sigma.value_s
        # the threshold is of the parameters: a place must not depend on those before it
        huber = p.huber * p.sigma_s / sigma
        estimate = tdoa.locate_power_law(
            site.positions, times_s, site.outline, p.exponent, sigma, huber
        )
        self.sigma.learn(estimate)
        return estimate


@dataclass(frozen=True, slots=True)
class SelfCalibratingParameters(LocalizerParameters):
    """Parameters of :class:`SelfCalibrating`."""

    max_residual_s: Annotated[
        float, gate("s", "Largest root of the mean loss of the arrivals.", ge=0)
    ] = 0.003
    least_impacts: Annotated[
        int, measured("1", "Impacts before the scale of the floor is shared.", ge=3)
    ] = 6
    memory: Annotated[int, measured("1", "Impacts looked back on.", ge=6)] = 64
    exponent: Annotated[
        float, measured("1", "Exponent where the geometry names none.", gt=0, le=2)
    ] = EXPONENT
    exponent_deviation: Annotated[
        float, measured("1", "How far the exponent may stray; 0 keeps it.", ge=0)
    ] = 0.1
    sigma_s: Annotated[
        float, measured("s", "Error of an arrival until the impacts tell it.", gt=0)
    ] = 5e-4
    huber: Annotated[
        float, measured("1", "Residuals beyond so many deviations count linearly.", gt=0)
    ] = HUBER


class SelfCalibrating(ArrivalLocalizer):
    """A power law whose scale and exponent are learnt from the impacts so far."""

    Parameters = SelfCalibratingParameters
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def prepare(self, site: PlacedSensors) -> str:
        """Begin with what the geometry knows of the floor."""
        p = self.parameters
        self.running = joint_calibration.running_arrival_model(
            site.positions,
            site.outline,
            site.medium,
            p.exponent,
            p.exponent_deviation,
            p.least_impacts,
            p.memory,
        )
        return ""

    def model_check(self) -> ModelCheck:
        """Return the check of places with more arrivals than unknowns."""
        return ModelCheck(self.parameters.sigma_s, tdoa.HYPERBOLIC_UNKNOWNS)

    def path_errors(self) -> PathErrors:
        """Return what learns how far arrivals err alike."""
        return PathErrors(self.running.positions, self.running.prior.exponent)

    def locate(self, times_s: Times) -> LocationEstimate:
        """Return the place that fits best, and learn from it."""
        p = self.parameters
        return joint_calibration.locate(self.running, times_s, p.sigma_s, p.huber)
