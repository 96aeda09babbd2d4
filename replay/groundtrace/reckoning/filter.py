"""The filter of dead reckoning: place, azimuth and scale, step by step.

A step goes ``length * exp(scale)`` along ``heading + offset + mount``, where the heading is the
gyroscope's. What the filter estimates besides the place is the offset of the gyroscope's frame
from the map's, how fast that drifts, how far the sensor looks away from the way, and by how much
all lengths are off. A magnetic azimuth tells the offset alone; a known place tells everything that
led there, by the covariances that steps have built up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..heading.rotations import wrapped

Array = NDArray[np.float64]

#: Rows of the state: place [m], offset [rad], its drift [rad/s], mount [rad], scale.
PLACE, OFFSET, DRIFT, MOUNT, SCALE = slice(0, 2), 2, 3, 4, 5
SIZE = 6
#: Random walk of the gyroscope's heading [rad/sqrt(s)].
GYRO_WALK = math.radians(0.3)
#: What a second at rest leaves of a gyroscope's bias [rad/s]; falls with the root of the time.
REST_DRIFT = 0.0016
#: An azimuth further off than this, in standard deviations, loses weight.
CLEAR = 2.0
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


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A point of the filter's state space, shape (6,)."""

    values: Array

    def moved(self, error: Array) -> State:
        """Return the state with an error added, shape (6,)."""
        return State(self.values + error)

    def error_from(self, other: State) -> Array:
        """Return how far this state is from another, shape (6,)."""
        return self.values - other.values


class ReckoningFilter:
    """Follows one walker; a change makes a new state and covariance, so that others may keep them.

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

    def turn(self, angle_rad: float) -> Array:
        """Turn the walk so far about its beginning; return the matrix that turns a state's errors.

        A filter that is lost is turned towards the first thing that tells a direction: far from it
        nothing could be linearised.
        """
        self.state = turned_about(self.state, self.origin, angle_rad)
        turn = turning(angle_rad)
        self.covariance = turn @ self.covariance @ turn.T
        return turn

    def wait(self, elapsed_s: float) -> Array:
        """Let time pass; return the transition, shape (6, 6)."""
        # compiled functions are not imported where pipelines are only listed
        from . import step_kernels as compiled

        grown = GYRO_WALK**2 * elapsed_s + self.noise.wander**2
        step, self.state, self.covariance = compiled.wait(
            self.state, self.covariance, elapsed_s, grown
        )
        return step

    def rest(self, rested_s: float) -> Array:
        """Take it that the gyroscope was zeroed at rest; return the transition, shape (6, 6)."""
        self.state, self.covariance = self.state.copy(), self.covariance.copy()
        self.state[DRIFT] = 0.0
        self.covariance[DRIFT, :] = self.covariance[:, DRIFT] = 0.0
        left = REST_DRIFT / math.sqrt(rested_s)
        self.covariance[DRIFT, DRIFT] = min(self.noise.drift, left) ** 2
        forget = np.eye(SIZE)
        forget[DRIFT, DRIFT] = 0.0
        return forget

    def step(self, length_m: float, heading_rad: float) -> Array:
        """Go a step; return the transition, shape (6, 6)."""
        from . import step_kernels as compiled

        errors = (self.noise.length, self.noise.way)
        step, self.state, self.covariance = compiled.go(
            self.state, self.covariance, length_m, heading_rad, *errors
        )
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
        from . import step_kernels as compiled

        off = wrapped(offset_rad - float(self.state[OFFSET]))
        known = float(self.covariance[OFFSET, OFFSET])
        variance = sigma_rad**2 * max(repeats, 1.0)
        variance *= max(1.0, abs(off) / CLEAR / math.sqrt(sigma_rad**2 + known)) ** 2
        self.state, self.covariance = compiled.sight(self.state, self.covariance, off, variance)

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


def turning(angle_rad: float) -> Array:
    """Return the matrix that turns the place's part of an error, shape (6, 6)."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    turn = np.eye(SIZE)
    turn[PLACE, PLACE] = [[cos, -sin], [sin, cos]]
    return turn


def turned_about(values: Array, origin: Array, angle_rad: float) -> Array:
    """Return a state, shape (6,), of the same walk in another direction from its ``origin``."""
    out = values.copy()
    out[PLACE] = origin + turning(angle_rad)[PLACE, PLACE] @ (values[PLACE] - origin)
    out[OFFSET] += angle_rad
    return out
