"""Places where the bearings of one step cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from groundtrace_codecs.events import Quantity

from ..gates import Level
from ..parameters import gate, measured
from .intersection import Norm, intersect

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..detector import Emits
    from ..localizers.location import Location

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CrossingParameters:
    """Parameters of :class:`Crossing`."""

    norm: Annotated[Norm, measured("", "l1 bears outlying bearings, l2 averages noise.")] = "l1"
    min_bearings: Annotated[int, gate("1", "Least number of bearings.", ge=2)] = 2
    max_residual_rad: Annotated[
        float, gate("rad", "Largest root mean square that bearings are off.", gt=0)
    ] = 0.5


class Crossing:
    """The place that a step's bearings point to."""

    Parameters = CrossingParameters
    takes = "bearing"
    emits: Emits = "fix"
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

    def locate(self, stations: Array, azimuths_rad: Array, sigmas_rad: Array) -> Location:
        """Return the place for bearings, shapes (n, 2), (n,) and (n,)."""
        return intersect(stations, azimuths_rad, sigmas_rad, self.parameters.norm)
