"""Places of vehicles from single cycles: the likelihood (7) over a lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Fix, Note, Quantity
from groundtrace_codecs.traffic import quantised

from ..gates import Level
from ..parameters import gate, measured
from .api import candidates_of, row_doubt
from .joining import CycleStage
from .likelihood import CyclePlace, less_noise
from .medium import PowerLaw

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.geometry import Stations

    from ..gates import Candidates
    from ..localizers.location import Location
    from .api import Cycle
    from .likelihood import Surface

_PLUGIN = "vehicle-likelihood"


@dataclass(frozen=True, slots=True)
class PlaceParameters:
    """Parameters of :class:`LikelihoodPlaces`."""

    exponent: Annotated[float, measured("1", "n of the power mu / r^n.", gt=0)] = 1.5
    mu: Annotated[
        float, measured("unit^2 m^n", "Energy parameter; 0 where it is unknown.", ge=0)
    ] = 0.0
    relative_sigma: Annotated[
        float, measured("1", "Standard deviation of a power over its mean.", gt=0)
    ] = 1 / 3
    step_m: Annotated[float, measured("m", "Between the nodes of the lattice.", gt=0)] = 1.0
    margin_m: Annotated[float, measured("m", "Of the lattice about the stations.", ge=0)] = 20.0
    least_over_floor: Annotated[
        float, measured("1", "Power over the noise from which a station counts.", ge=1)
    ] = 1.5
    heard: Annotated[float, gate("1", "Fewest stations that count.", ge=3)] = 3.0
    sigma: Annotated[
        float, gate("m", "Largest standard deviation, along the longer axis.", gt=0)
    ] = 15.0


class LikelihoodPlaces(CycleStage):
    """The likeliest place of every cycle in which a vehicle is heard, and the surface about it."""

    Parameters = PlaceParameters
    gives = (Fix,)
    columns = (
        Quantity("heard", "1"),
        Quantity("residual", "1"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )
    gates = (Level("heard", "1", "heard"), Level("sigma", "m", "sigma", at_least=False))
    least_stations = 3

    def __init__(self, parameters: PlaceParameters) -> None:
        super().__init__(parameters)
        self._found: tuple[int, Location, Surface] | None = None

    def begin(self, site: Stations, stage: str) -> tuple[str, ...]:
        """Begin with a lattice about the stations."""
        p = self.parameters
        self._site, self._stage = site, stage
        self._doubt = row_doubt(site.names, site.places)
        low, high = site.places.min(axis=0) - p.margin_m, site.places.max(axis=0) + p.margin_m
        self._x, self._y = (
            np.arange(a, b + p.step_m / 2, p.step_m) for a, b in zip(low, high, strict=True)
        )
        return ("all",)

    def take(self, cycle: Cycle) -> Candidates:
        """Locate in a cycle in which any station hears a vehicle."""
        p = self.parameters
        self._found = None
        if not cycle.present.any():
            return candidates_of([], len(self.columns))
        counted = cycle.powers > p.least_over_floor * cycle.floors
        heard = int(counted.sum())
        if heard < self.least_stations:
            return candidates_of([(cycle.time_ns, 0, [heard, *[np.nan] * 4])], len(self.columns))
        law = PowerLaw(p.mu or 1.0, p.exponent)
        signal, sigmas = less_noise(
            cycle.powers, cycle.floors, cycle.floor_sigmas, p.relative_sigma
        )
        powers = np.where(counted, signal, np.nan)
        place = CyclePlace(powers, self._site.places, law, p.mu > 0, sigmas)
        surface = place.surface(self._x, self._y)
        found = place.locate(surface)
        self._found = cycle.time_ns, found, surface
        inside = self._x[0] < found.x < self._x[-1] and self._y[0] < found.y < self._y[-1]
        # at the edge of the lattice the maximum is not one: it lies beyond
        sigma = found.larger_sigma_m if inside else np.inf
        row = [heard, found.residual, found.x, found.y, sigma]
        return candidates_of([(cycle.time_ns, 0, row)], len(self.columns))

    def finish(self) -> Candidates:
        """Return nothing: no cycle is held back."""
        self._found = None
        return candidates_of([], len(self.columns))

    def follow(self, accepted: NDArray[np.bool_]) -> Iterator[Event]:
        """Yield the surface, and the place if it was accepted."""
        if self._found is None:
            return
        time_ns, location, surface = self._found
        yield quantised(time_ns, surface.x, surface.y, surface.values, self._stage)
        if accepted[0]:
            if self._doubt:
                yield Note(time_ns, self._doubt, "WARN", self._stage)
                self._doubt = ""
            yield location.fix(time_ns, _PLUGIN, self._stage)
