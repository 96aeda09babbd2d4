"""What a calibration does to the places of the impacts that it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers import power_law
from ..localizers.joint_fit import Impacts
from ..localizers.joint_start import bounds_of, places_on

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..localizers.joint_fit import JointFit
    from .arrivals import Gathered

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlaceErrors:
    """Errors of the places of impacts whose true places are known.

    Attributes
    ----------
    n
        How many.
    rmse_before
        By the power law with a scale of its own for each impact, clocks as they are [unit].
    rmse_after
        By the floor and the clocks found [unit].
    """

    n: int
    rmse_before: float
    rmse_after: float


def place_errors(gathered: Gathered, found: JointFit, room: Array | None) -> PlaceErrors | None:
    """Locate the impacts without and with a calibration; None where no true place is known."""
    picks = np.isfinite(gathered.times_s).sum(axis=1)
    rows = np.flatnonzero(np.isfinite(gathered.known).all(axis=1) & (picks >= power_law.UNKNOWNS))
    if not len(rows):
        return None
    times, true = gathered.times_s[rows], gathered.known[rows]
    before = [power_law.locate(gathered.positions, row, room) for row in times]
    impacts = Impacts(gathered.positions, times, bounds_of(gathered.positions, room))
    after = places_on(impacts, found.floor, room, power_law.HUBER * found.sigma_s)
    return PlaceErrors(
        len(rows), _rms(np.array([(p.x, p.y) for p in before]) - true), _rms(after - true)
    )


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
