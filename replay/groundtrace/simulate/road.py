"""Roads, and who drives along them how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: So long before and after its pass a vehicle is on the road at most [s].
LASTS_S = 180.0
_ARC_STEP_RAD = 0.01  # between two corners of a bend
_NEAR_S = 0.01  # grid on which the closest approach is looked for
_CONVERGED_S = 1e-9
_ROUNDS = 60  # each gains a factor of wave velocity over speed, 2.6 at least


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """The line of a road, straight between its corners and beyond its ends.

    Attributes
    ----------
    corners
        Shape (n, 2), n >= 2 [m].
    reached_m
        Distance along the road of each corner, shape (n,) [m].
    units
        Directions between corners, of length 1, shape (n - 1, 2).
    """

    corners: Array
    reached_m: Array
    units: Array

    @classmethod
    def through(cls, corners: Array) -> Road:
        """Return the road through corners, shape (n, 2), each another place than the last [m]."""
        steps = np.diff(corners, axis=0)
        lengths = np.hypot(*steps.T)
        return cls(corners, np.append(0.0, np.cumsum(lengths)), steps / lengths[:, None])

    @classmethod
    def straight(cls, place: Array, heading_rad: float) -> Road:
        """Return a straight road through a place; distances along it count from there."""
        ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
        return cls.through(np.array([place, place + ahead]))

    @classmethod
    def bend(cls, place: Array, heading_rad: float, radius_m: float) -> Road:
        """Return an arc of a third of a circle, whose middle is a place with a heading there.

        A positive radius turns left, a negative one right.
        """
        turned = np.arange(-np.pi / 3, np.pi / 3 + _ARC_STEP_RAD / 2, _ARC_STEP_RAD)
        angle = heading_rad + turned * np.sign(radius_m)
        centre = place + radius_m * np.array([-np.sin(heading_rad), np.cos(heading_rad)])
        return cls.through(centre + radius_m * np.column_stack([np.sin(angle), -np.cos(angle)]))

    def places(self, along_m: Array) -> Array:
        """Return the places at distances along the road, shape (..., 2) [m]."""
        segment = self._segment(along_m)
        beyond = along_m - self.reached_m[segment]
        places: Array = self.corners[segment] + beyond[..., None] * self.units[segment]
        return places

    def headings(self, along_m: Array) -> Array:
        """Return the road's heading at distances along it, the shape of ``along_m`` [rad]."""
        x, y = np.moveaxis(self.units[self._segment(along_m)], -1, 0)
        headings: Array = np.arctan2(y, x)
        return headings

    def nearest_m(self, place: Array) -> float:
        """Return the distance along the road of its point closest to a place [m]."""
        along = np.sum((place - self.corners[:-1]) * self.units, axis=1)
        low, high = np.zeros(len(along)), np.diff(self.reached_m)
        low[0], high[-1] = -np.inf, np.inf
        along = self.reached_m[:-1] + np.clip(along, low, high)
        return float(along[np.argmin(np.hypot(*(self.places(along) - place).T))])

    def beside(self, left_m: float) -> Road:
        """Return the road moved to its left, parallel to itself."""
        mitre = np.vstack([self.units[:1], self.units]) + np.vstack([self.units, self.units[-1:]])
        mitre *= 2 / np.maximum(np.sum(mitre**2, axis=1), 0.1)[:, None]
        return Road.through(self.corners + left_m * np.column_stack([-mitre[:, 1], mitre[:, 0]]))

    def _segment(self, along_m: Array) -> NDArray[np.intp]:
        after = np.searchsorted(self.reached_m, along_m, side="right") - 1
        return np.clip(after, 0, len(self.corners) - 2)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One vehicle's way along a road, its speed constant or changing evenly with time.

    Attributes
    ----------
    road
        Its lane.
    pass_s, along_m
        When it is at which distance along the road [s, m].
    speed_mps, end_speed_mps
        Until ``start_s`` and from ``end_s`` on; between them it changes evenly [m/s].
    start_s, end_s
        Between which the speed changes [s].
    forward
        Whether it goes as the road is drawn.
    """

    road: Road
    pass_s: float
    along_m: float
    speed_mps: float
    end_speed_mps: float
    start_s: float
    end_s: float
    forward: bool = True

    def speeds(self, time_s: Array) -> Array:
        """Return the speed at times of any shape [m/s]."""
        part = np.clip((time_s - self.start_s) / (self.end_s - self.start_s), 0, 1)
        return self.speed_mps + part * (self.end_speed_mps - self.speed_mps)

    def travelled(self, time_s: Array) -> Array:
        """Return the way since ``pass_s`` at times of any shape, negative before [m]."""
        way: Array = self._way(time_s) - self._way(np.array(self.pass_s))
        return way

    def places(self, time_s: Array) -> Array:
        """Return where the vehicle is, shape (..., 2) [m]."""
        return self.road.places(self._along(time_s))

    def headings(self, time_s: Array) -> Array:
        """Return where it goes to, counter-clockwise from x [rad, -pi to pi]."""
        turned = 0.0 if self.forward else np.pi
        angle: Array = self.road.headings(self._along(time_s)) + turned
        return np.arctan2(np.sin(angle), np.cos(angle))

    def distances(self, time_s: Array, places: Array) -> Array:
        """Return how far it is from a place, (2,), or from the place of each last index [m]."""
        away = self.places(time_s) - places
        distance: Array = np.hypot(away[..., 0], away[..., 1])
        return distance

    def emitted_s(self, heard_s: Array, places: Array, velocity_mps: float) -> Array:
        """Return when it made what is heard at places: heard = t + r(t) / c, solved for t.

        Parameters
        ----------
        heard_s
            Shape (n,) [s].
        places
            Shape (n_places, 2) [m].
        velocity_mps
            c of the waves, more than the vehicle's speed.

        Returns
        -------
        Shape (n, n_places) [s].
        """
        heard = np.repeat(heard_s[:, None], len(places), axis=1)
        emitted = heard
        for _ in range(_ROUNDS):
            before, emitted = emitted, heard - self.distances(emitted, places) / velocity_mps
            if np.abs(emitted - before).max(initial=0.0) < _CONVERGED_S:
                break
        return emitted

    def times(self, duration_s: float, step_s: float) -> Array:
        """Return the multiples of a step, from 0 to before the end, when it is on the road [s]."""
        first = np.ceil(max(0.0, self.pass_s - LASTS_S) / step_s)
        last = np.ceil(min(duration_s, self.pass_s + LASTS_S) / step_s)
        return np.arange(first, last, dtype=np.float64) * step_s

    def closest_s(self, place: Array, duration_s: float) -> float | None:
        """Return when it passes a place, or None where it does not before ``duration_s``."""
        time_s = self.times(duration_s, _NEAR_S)
        square = self.distances(time_s, place) ** 2
        near = int(np.argmin(square))
        if not 0 < near < len(time_s) - 1:
            return None
        before, at, after = square[near - 1 : near + 2]
        bend = before - 2 * at + after
        return float(time_s[near] + (_NEAR_S * (before - after) / (2 * bend) if bend else 0.0))

    def _along(self, time_s: Array) -> Array:
        return self.along_m + (1 if self.forward else -1) * self.travelled(time_s)

    def _way(self, time_s: Array) -> Array:
        inside = np.clip(time_s, self.start_s, self.end_s) - self.start_s
        gain = (self.end_speed_mps - self.speed_mps) / (self.end_s - self.start_s)
        way: Array = self.speed_mps * inside + gain * inside**2 / 2
        way = way + self.speed_mps * np.minimum(time_s - self.start_s, 0)
        return way + self.end_speed_mps * np.maximum(time_s - self.end_s, 0)
