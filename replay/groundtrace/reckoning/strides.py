"""Steps as a track takes them, and those that it may have to go again."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import track_kernels

    Array = NDArray[np.float64]
else:
    track_kernels = Later("groundtrace.reckoning.track_kernels")


class Sight(NamedTuple):
    """A magnetic azimuth, as the offset of the gyroscope's frame that it asks for.

    Attributes
    ----------
    offset_rad, sigma_rad
        The offset and its standard deviation [rad].
    repeats
        How many sights in a row err alike.
    """

    offset_rad: float
    sigma_rad: float
    repeats: float


class Stride(NamedTuple):
    """A step as the track takes it.

    Attributes
    ----------
    time_ns
        When it ends.
    length_m
        Its length [m].
    heading_rad
        Direction by the gyroscope, but for what the way is turned from the sensor [rad].
    sight
        What the compass says of it.
    rested_s
        How long the sensor has been at rest since the step before [s].
    """

    time_ns: int
    length_m: float
    heading_rad: float
    sight: Sight | None
    rested_s: float

    @property
    def row(self) -> tuple[float, ...]:
        """All but the time, as compiled functions lay it out."""
        return self.length_m, self.heading_rad, *(self.sight or UNSEEN), self.rested_s


#: Of a step of which the compass says nothing.
UNSEEN = Sight(math.nan, math.nan, math.nan)


@dataclass(slots=True)
class Strides:
    """Strides in columns that have room for more.

    Attributes
    ----------
    count
        How many there are.
    time_ns, rows
        When they end, shape (m,), and what else is known of them, shape (m, STRIDE).
    """

    count: int = 0
    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(1, np.int64))
    rows: Array = field(default_factory=lambda: np.empty((1, track_kernels.STRIDE)))

    def add(self, stride: Stride) -> None:
        """Add one."""
        if self.count == len(self.time_ns):
            self.time_ns = np.resize(self.time_ns, 2 * self.count)
            self.rows = np.resize(self.rows, (2 * self.count, track_kernels.STRIDE))
        self.time_ns[self.count], self.rows[self.count] = stride.time_ns, stride.row
        self.count += 1
