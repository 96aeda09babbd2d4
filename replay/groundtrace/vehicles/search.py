"""Where the fit of a course may start: the best of a lattice of courses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .medium import ranges
from .scoring import deviance, usable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .courses import Observed

    Array = NDArray[np.float64]

#: Courses scored at once, times powers.
_CELLS = 2_000_000


@dataclass(frozen=True, slots=True)
class Search:
    """Which courses are tried.

    Attributes
    ----------
    low, high
        Corners of the area in which a vehicle is in the middle of the time [m].
    speeds_mps
        From slowest to fastest [m/s].
    places, headings, speeds
        How many of each: places along either axis.
    kept
        How many of the best, each from another place or heading, are refined.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    speeds_mps: tuple[float, float] = (1.0, 25.0)
    places: int = 9
    headings: int = 16
    speeds: int = 5
    kept: int = 12

    @classmethod
    def about(cls, sensors: Array, margin: float = 0.75) -> Search:
        """Return the rectangle of sensors, shape (n, 2), widened on all sides.

        ``margin`` is in parts of its longer side.
        """
        low, high = sensors.min(axis=0), sensors.max(axis=0)
        wider = margin * float((high - low).max())
        (x0, y0), (x1, y1) = (low - wider).tolist(), (high + wider).tolist()
        return cls((x0, y0), (x1, y1))

    def courses(self) -> Array:
        """Return all courses, shape (m, 4): x, y [m], vx, vy [m/s] in the middle of the time."""
        x, y = (np.linspace(a, b, self.places) for a, b in zip(self.low, self.high, strict=True))
        heading = 2 * np.pi * np.arange(self.headings) / self.headings
        speed = np.geomspace(*self.speeds_mps, self.speeds)
        mesh = np.meshgrid(x, y, heading, speed, indexing="ij")
        xs, ys, headings, speeds = (m.ravel() for m in mesh)
        return np.stack([xs, ys, speeds * np.cos(headings), speeds * np.sin(headings)], axis=1)


def starts(observed: Observed, search: Search, each_mu: bool) -> Array:
    """Return the courses of a lattice from which to start, shape (k, 4), the best first.

    Parameters
    ----------
    observed
        Powers of cycles.
    search
        The lattice.
    each_mu
        Whether the vehicle's strength may differ from cycle to cycle.
    """
    courses = search.courses()
    step = max(1, _CELLS // max(1, observed.powers.size))
    lost = np.concatenate(
        [_lost(observed, courses[a : a + step], each_mu) for a in range(0, len(courses), step)]
    )
    order = np.argsort(lost, kind="stable")
    apart = max((b - a) / (search.places - 1) for a, b in zip(search.low, search.high, strict=True))
    kept: list[Array] = []
    for course in courses[order]:
        if all(_apart(course, other, apart) for other in kept):
            kept.append(course)
            if len(kept) == search.kept:
                break
    return np.array(kept)


def strengths(powers: Array, floors: Array, spread: Array, axes: tuple[int, ...]) -> Array:
    """Return ln mu, the mean over axes of what stands out of the noise, those kept of length 1.

    Powers count by the square of the vehicle's part of them, so that cycles lost in the noise do
    not.

    Parameters
    ----------
    powers, floors
        Noise included, and that of the noise, shapes that numpy joins.
    spread
        Powers of mu = 1.
    axes
        Over which mu is one.
    """
    share = np.clip(1 - floors / powers, 1e-3, 1.0)
    weights = share**2
    logs = np.log(powers * share / spread)
    total = np.broadcast_to(weights, logs.shape).sum(axis=axes, keepdims=True)
    return np.asarray((weights * logs).sum(axis=axes, keepdims=True) / total)


def _apart(one: Array, other: Array, distance_m: float) -> bool:
    """Return whether courses lie in other places by more than neighbours, or go another way."""
    turn = one[2:] @ other[2:] / (np.hypot(*one[2:]) * np.hypot(*other[2:]))
    return bool(np.abs(one[:2] - other[:2]).max() > 1.1 * distance_m or turn < np.cos(0.5))


def _lost(observed: Observed, courses: Array, each_mu: bool) -> Array:
    """Return the deviance of courses, shape (m,), each with the strength that suits it."""
    used = usable(observed.powers)
    powers = np.where(used, observed.powers, 1.0)
    floors = np.where(used, observed.floors, 0.0)
    ahead = observed.times_s - observed.times_s.mean()
    places = courses[:, None, :2] + courses[:, None, 2:] * ahead[:, None]
    spread = observed.law.power(ranges(places, observed.sensors))
    mu = np.exp(strengths(powers, floors, spread, (2,) if each_mu else (1, 2)))
    lost = np.where(used, deviance(powers, mu * spread + floors), 0.0)
    return np.asarray(lost.sum(axis=(1, 2)))
