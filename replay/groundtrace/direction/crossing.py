"""Places where the bearings of one step cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Bearing, Fix, Quantity, StepEvent

from ..gates import Level
from ..localizers.api import place_candidate
from ..parameters import gate, measured
from ..stage import Context, Input, Stage
from .bearings import placed
from .intersection import Norm, intersect

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event

    from ..localizers.location import Location
    from ..stage import Output

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CrossingParameters:
    """Parameters of :class:`Crossing`."""

    norm: Annotated[Norm, measured("", "l1 bears outlying bearings, l2 averages noise.")] = "l1"
    min_bearings: Annotated[int, gate("1", "Least number of bearings.", ge=2)] = 2
    max_residual_rad: Annotated[
        float, gate("rad", "Largest root mean square that bearings are off.", gt=0)
    ] = 0.5


class Crossing(Stage):
    """The place that a step's bearings point to."""

    Parameters = CrossingParameters
    takes = (Input(Bearing), Input(StepEvent))
    gives = (Fix,)
    scope = "recording"
    ends_at = "clock step"
    columns = (
        Quantity("bearings", "1"),
        Quantity("residual", "rad"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )
    gates = (
        Level("bearings", "1", "min_bearings"),
        Level("residual", "rad", "max_residual_rad", at_least=False),
    )

    def __init__(self, parameters: CrossingParameters) -> None:
        self.parameters = parameters
        self._latest: dict[str, Bearing] = {}

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with the stations that give bearings, and none of these."""
        self._context = context
        self._stations = placed(context.source.channels, context.geometry)
        self._latest.clear()
        return ("all",)

    def process(self, item: Bearing | StepEvent) -> Iterator[Output]:
        """Gather the latest bearing of each station; cross those at the very time of a step."""
        if isinstance(item, Bearing):
            self._latest[item.station] = item
            return
        own = [
            b
            for b in self._latest.values()
            if b.time_ns == item.time_ns and b.station in self._stations
        ]
        places = np.array([self._stations[b.station] for b in own], np.float64).reshape(-1, 2)
        azimuths = np.array([b.azimuth_rad for b in own], np.float64)
        sigmas = np.array([b.sigma_rad for b in own], np.float64)
        self._found = item.time_ns, self.locate(places, azimuths, sigmas)
        yield place_candidate(*self._found)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts."""
        if block.accepted[0]:
            time_ns, location = self._found
            yield location.fix(time_ns, self._context.plugin, self._context.stage)

    def locate(self, stations: Array, azimuths_rad: Array, sigmas_rad: Array) -> Location:
        """Return the place for bearings, shapes (n, 2), (n,) and (n,)."""
        return intersect(stations, azimuths_rad, sigmas_rad, self.parameters.norm)
