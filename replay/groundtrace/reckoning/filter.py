"""The filter of dead reckoning: place, azimuth and scale, step by step.

A step goes ``length * exp(scale)`` along ``heading + offset + mount``, where the heading is the
gyroscope's. What the filter estimates besides the place is the offset of the gyroscope's frame
from the map's, how fast that drifts, how far the sensor looks away from the way, and by how much
all lengths are off. A magnetic azimuth tells the offset alone; a known place tells everything that
led there, by the covariances that steps have built up.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..heading.rotations import wrapped
from ..later import Later

if TYPE_CHECKING:
    from . import track_kernels
else:
    track_kernels = Later("groundtrace.reckoning.track_kernels")

Array = NDArray[np.float64]

#: Rows of the state: place [m], offset [rad], its drift [rad/s], mount [rad], scale.
PLACE, OFFSET, DRIFT, MOUNT, SCALE = slice(0, 2), 2, 3, 4, 5
SIZE = 6
#: An offset less sure than this is not known at all: nothing can be linearised about it [rad].
LOST_RAD = 1.0


@dataclass(frozen=True, slots=True)
class ReckoningNoise:
    """What the filter takes steps and sensors for, as standard deviations.

    Attributes
    ----------
    drift
        Of the gyroscope at the start [rad/s].
    mount
        Of the sensor's axis from the way [rad].
    length, scale
        Of one length, and of all of them together, as parts.
    way
        Of a single step from the azimuth [rad].
    wander
        Of the gyroscope's heading from step to step [rad]; not 0 where it is not to be trusted.
    """

    drift: float
    mount: float
    length: float
    scale: float
    way: float
    wander: float = 0.0


class ReckoningFilter:
    """Follows one walker.

    Parameters
    ----------
    noise
        What steps and sensors are taken for.
    place
        Where the walk begins, shape (2,) [m].
    sigma_m
        How sure that is, per axis [m].
    learns_scale
        Whether known places calibrate the lengths.
    """

    def __init__(
        self, noise: ReckoningNoise, place: Array, sigma_m: float, *, learns_scale: bool
    ) -> None:
        self.noise = noise
        self.learns_scale = learns_scale
        self.state = np.zeros(SIZE)
        self.state[PLACE] = place
        sigmas = [sigma_m, sigma_m, math.pi, noise.drift, noise.mount, noise.scale]
        self.covariance = np.diag(np.square(sigmas))
        self.origin = self.state[PLACE].copy()

    def copy(self) -> ReckoningFilter:
        """Return an independent copy."""
        made = copy.copy(self)
        made.state, made.covariance = self.state.copy(), self.covariance.copy()
        made.origin = self.origin.copy()
        return made

    @property
    def lost(self) -> bool:
        """Whether nothing has told the offset yet."""
        return float(self.covariance[OFFSET, OFFSET]) > LOST_RAD**2

    def azimuth(self, heading_rad: float) -> float:
        """Return the azimuth of a step whose heading the gyroscope says [rad]."""
        return heading_rad + float(self.state[OFFSET] + self.state[MOUNT])

    @property
    def azimuth_sigma_rad(self) -> float:
        """Standard deviation of an azimuth [rad]."""
        p = self.covariance
        variance = p[OFFSET, OFFSET] + p[OFFSET, MOUNT] + p[MOUNT, OFFSET] + p[MOUNT, MOUNT]
        return min(math.sqrt(max(float(variance), 0.0)), math.pi)

    def wait(self, elapsed_s: float) -> Array:
        """Let time pass; return the transition, shape (6, 6)."""
        step = np.empty((SIZE, SIZE))
        track_kernels.wait(self.state, self.covariance, elapsed_s, self.noise.wander, step, _room())
        return step

    def rest(self, rested_s: float) -> None:
        """Take it that the gyroscope was zeroed at rest."""
        track_kernels.rest(self.state, self.covariance, rested_s, self.noise.drift)

    def step(self, length_m: float, heading_rad: float) -> Array:
        """Go a step; return the transition, shape (6, 6)."""
        step, errors = np.empty((SIZE, SIZE)), (self.noise.length, self.noise.way)
        track_kernels.go(self.state, self.covariance, length_m, heading_rad, *errors, step, _room())
        return step

    def sight(self, offset_rad: float, sigma_rad: float, repeats: float) -> None:
        """Take a magnetic azimuth in, as the offset it asks for.

        Parameters
        ----------
        offset_rad, sigma_rad
            The offset, and its standard deviation [rad].
        repeats
            How many sights in a row err alike.
        """
        track_kernels.sight(self.state, self.covariance, offset_rad, sigma_rad, repeats, _room())

    def fix(self, place: Array, sigma_m: float) -> float:
        """Take a known place in, shape (2,) [m]; return the NIS (2 degrees of freedom)."""
        spread = self.covariance[PLACE, PLACE] + sigma_m**2 * np.eye(2)
        off = place - self.state[PLACE]
        gain = np.linalg.solve(spread, self.covariance[PLACE, :]).T
        if not self.learns_scale:
            gain[SCALE] = 0.0
        keep = np.eye(SIZE)
        keep[:, PLACE] -= gain
        self.state = self.state + gain @ off
        self.covariance = keep @ self.covariance @ keep.T + sigma_m**2 * gain @ gain.T
        return float(off @ np.linalg.solve(spread, off))

    def angle_to(self, place: Array, sigma_m: float) -> float | None:
        """Return by how much the walk must turn to lead towards a place [rad].

        None where walk and place are too near the beginning to tell.
        """
        gone, seen = self.state[PLACE] - self.origin, place - self.origin
        if min(float(np.linalg.norm(gone)), float(np.linalg.norm(seen))) < sigma_m:
            return None
        return wrapped(math.atan2(seen[1], seen[0]) - math.atan2(gone[1], gone[0]))


def _room() -> Array:
    """Return what compiled functions write over."""
    return np.empty((2, SIZE, SIZE))
