"""The velocity a floor seems to have, and when its waves seem to arrive.

Source: the thesis, sections 4.2 and 4.3. The envelope (4.21) has a maximum over distance at a fixed
time, (4.22): where the wave is highest now. That gives (4.24), t = (theta d^4 / (8 a^2))^(1/3), and
(4.25). A sensor stays where it is and sees the maximum over time at a fixed distance; setting the
derivative by t to 0 puts 16 a^2 for 8 a^2, so that the sensor sees the maximum 2^(1/3) = 1.26 times
faster than (4.25) says. The velocity falls with d^(-1/3); chapter 4 concludes with 1/d^3, a slip.

A picker sees neither, but what first rises over the noise: :func:`onset_s`, faster still. So theta
is a parameter to fit, not a constant of the material. Nor does that onset strictly keep the order
of distances, as (4.13) says: the swings run at half the speed of the envelope, so that the first
one over the level changes, and at some distances the onset jumps back by up to 0.4 ms. Of two
places from 3 to 20 m off that differ by up to 0.45 m, the farther may come first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..simulate.plate import Plate
    from .response import Response

    Array = NDArray[np.float64]

#: 8 a^2 of (4.24), with the thesis's a = 183 m^2/s.
PLATE = 8 * 183.0**2


def arrivals(distance_m: Array, theta_s: float) -> Array:
    """Return when a wave arrives [s], equation (4.24): t^3 = theta d^4 / (8 a^2)."""
    times: Array = np.cbrt(theta_s / PLATE * distance_m**4)
    return times


def front_arrival_s(plate: Plate, distance_m: Array) -> Array:
    """Return when the wave is highest of all places at a place [s], (4.24) as printed: 8 a^2.

    The shape is that of ``distance_m``, as everywhere here.
    """
    return _arrival_s(plate, distance_m, 8.0)


def sensor_arrival_s(plate: Plate, distance_m: Array) -> Array:
    """Return when a place is highest of all times [s], (4.24) corrected: 16 a^2."""
    return _arrival_s(plate, distance_m, 16.0)


def front_mps(plate: Plate, distance_m: Array) -> Array:
    """Return the perceived velocity (4.25) as printed [m/s]: (8 a^2 / (theta d))^(1/3)."""
    velocity: Array = distance_m / front_arrival_s(plate, distance_m)
    return velocity


def sensor_mps(plate: Plate, distance_m: Array) -> Array:
    """Return the perceived velocity at a sensor [m/s]: (16 a^2 / (theta d))^(1/3)."""
    velocity: Array = distance_m / sensor_arrival_s(plate, distance_m)
    return velocity


def _arrival_s(plate: Plate, distance_m: Array, squares: float) -> Array:
    """Return (theta d^4 / (squares a^2))^(1/3) [s]."""
    # only theta / a^2 counts, so another floor is that of PLATE with another theta
    scale = PLATE / (squares * plate.dispersion_m2s**2)
    return arrivals(distance_m, plate.loss_s * scale)


def onset_s(
    response: Response, distance_m: Array, level: float = 200.0, rate_hz: float = 50_000.0
) -> Array:
    """Return when the displacement (4.9) of a white source first exceeds a level [s].

    This is the threshold of section 4.2; 200 is that of figure 4.3.

    Parameters
    ----------
    response
        The floor and the sum's terms.
    distance_m
        Shape (n,), from 3 m.
    level
        In the unit of the response.
    rate_hz
        How finely time is sampled.

    Returns
    -------
    NDArray
        Shape (n,); NaN where the level is never exceeded.
    """
    time_s = response.time_s(rate_hz)
    onset = np.full(distance_m.shape, np.nan)
    for place, distance in enumerate(distance_m):  # one by one: a long sum is many megabytes
        above = np.abs(response.analytic(distance[None], rate_hz)[0].real) > level
        if above.any():
            onset[place] = time_s[np.argmax(above)]
    return onset
