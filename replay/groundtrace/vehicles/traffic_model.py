"""Vehicles on a road as the powers of all stations see them at once.

A vehicle of constant speed v that is d from a station at the nearest has there the power

    P(t) = mu / ((v (t - t0 - x / v))^2 + d^2)^(n/2),

by the paper's (4), x along the road. One moment, one slowness and one distance thus hold for all
stations; a single station's fit has a moment and a width of its own in each, which is what makes
two vehicles within a second look like one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)
#: Columns of a vehicle: moment, ln slowness, ln peak, ln distance, then ln gain at each station.
MOMENT, SLOWNESS, PEAK, DISTANCE, GAINS = range(5)
#: Slowness is kept between these [s/m].
_SLOWNESS = (1 / 60, 1.0)
#: Distance from the lane where no road is known, and the least that is believed [m].
_USUAL_M, _LEAST_M = 5.0, 2.0
#: Standard deviations of what is known beforehand: of the moment about where it is looked for [s],
#: and of logarithms: 2 to 60 m/s within two of 11 m/s, peaks of 13 dB over the noise within two of
#: 9 dB each, lanes of a road, gains of stations.
_SIGMAS = (3.0, 0.7, 2.0, 0.35, 0.3)
_USUAL_MPS, _USUAL_OVER_FLOOR = 11.0, 20.0
#: Vehicles expected, one in so many seconds.
_EVERY_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """A vehicle on a road.

    Attributes
    ----------
    values
        Shape (4 + n_stations,): when it is at the middle of the stations [s], ln slowness [s/m],
        ln of its power at the nearest [unit^2], ln of its mean distance from the stations [m], ln
        of each station's gain.
    direction
        1 towards greater distance along the road, else -1.
    """

    values: Array
    direction: int

    @property
    def slowness(self) -> float:
        """Seconds a metre, below 0 backward [s/m]."""
        return self.direction * float(np.exp(np.clip(self.values[SLOWNESS], *np.log(_SLOWNESS))))

    @property
    def speed_mps(self) -> float:
        """Speed [m/s]."""
        return 1 / abs(self.slowness)


@dataclass(frozen=True, eq=False)
class RoadPowers:
    """The powers of all stations beside a road.

    Attributes
    ----------
    times_s
        Shape (c,): middles of even cycles [s].
    powers, floors
        Shape (c, n): noise included, and of the noise [unit^2]; NaN or 0 where there is none.
    along_m, offsets_m
        Shape (n,): along the road, and distance from it, 0 for all where unknown [m].
    exponent
        n of the law.
    cycle_s
        Length of a cycle [s].
    """

    times_s: Array
    powers: Array
    floors: Array
    along_m: Array
    offsets_m: Array
    exponent: float
    cycle_s: float

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Where there is a power, shape (c, n)."""
        return (
            np.isfinite(self.powers)
            & (self.powers > 0)
            & np.isfinite(self.floors)
            & (self.floors > 0)
        )

    @cached_property
    def noise(self) -> Array:
        """The floors, 1 where there is none, shape (c, n) [unit^2]."""
        return np.where(self.known, self.floors, 1.0)

    @cached_property
    def centred_m(self) -> Array:
        """Places along the road from the middle of the stations, shape (n,) [m]."""
        return np.asarray(self.along_m - self.along_m.mean())

    @cached_property
    def distances_m(self) -> Array:
        """How far stations are from the lane, shape (n,) [m]."""
        if not self.offsets_m.any():
            return np.full(len(self.along_m), _USUAL_M)
        return np.maximum(self.offsets_m, _LEAST_M)

    @cached_property
    def usual(self) -> Array:
        """The values of a vehicle of which nothing is known, shape (4 + n,); its moment is 0."""
        peak = _USUAL_OVER_FLOOR * float(np.median(self.noise[self.known]))
        known = [0.0, -np.log(_USUAL_MPS), np.log(peak), np.log(self.distances_m.mean())]
        return np.concatenate([known, np.zeros(len(self.along_m))])

    @cached_property
    def precision(self) -> Array:
        """Of what is known beforehand of each value, shape (4 + n,)."""
        sigmas = np.concatenate([_SIGMAS[:GAINS], np.full(len(self.along_m), _SIGMAS[GAINS])])
        return np.asarray(sigmas**-2, np.float64)

    @property
    def log_chance(self) -> float:
        """Logarithm of the chance of a vehicle about a moment, of either direction."""
        return float(np.log(np.sqrt(2 * np.pi) * _SIGMAS[MOMENT] / _EVERY_S / 2))

    def moments(self, vehicle: Vehicle) -> Array:
        """Return when a vehicle is nearest to each station, shape (n,) [s]."""
        return np.asarray(vehicle.values[MOMENT] + vehicle.slowness * self.centred_m)

    def widths(self, vehicle: Vehicle) -> Array:
        """Return distance over speed at each station, shape (n,) [s]."""
        scale = self.distances_m / self.distances_m.mean()
        return np.asarray(np.exp(vehicle.values[DISTANCE]) * scale * abs(vehicle.slowness))

    def peaks(self, vehicle: Vehicle) -> Array:
        """Return its power at the nearest to each station, shape (n,) [unit^2]."""
        scale = self.distances_m / self.distances_m.mean()
        level = vehicle.values[PEAK] + vehicle.values[GAINS:]
        return np.asarray(np.exp(np.clip(level - self.exponent * np.log(scale), -600, 600)))

    def power(self, vehicle: Vehicle, rows: slice) -> tuple[Array, Array]:
        """Return the mean power of a vehicle in some cycles, and its slopes by its values.

        Returns
        -------
        Shapes (r, n) and (r, n, 4 + n).
        """
        n = len(self.along_m)
        width = self.widths(vehicle)[:, None]
        late = self.times_s[rows, None, None] + _POINTS * self.cycle_s / 2
        x = (late - self.moments(vehicle)[:, None]) / width
        parts = self.peaks(vehicle)[:, None] * (1 + x**2) ** (-self.exponent / 2) * (_WEIGHTS / 2)
        falling = self.exponent * x / (1 + x**2) * parts
        power, wider = parts.sum(axis=-1), (falling * x).sum(axis=-1)
        later = (falling / width).sum(axis=-1)
        slopes = np.zeros((*power.shape, GAINS + n))
        slopes[..., MOMENT], slopes[..., PEAK] = later, power
        slopes[..., SLOWNESS] = wider + later * vehicle.slowness * self.centred_m
        slopes[..., DISTANCE] = wider
        slopes[:, np.arange(n), GAINS + np.arange(n)] = power
        return power, slopes
