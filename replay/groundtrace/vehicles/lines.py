"""A straight course in uniform motion: through positions of single cycles, and across a line.

Source: the paper, equations (8) and (9). The sums of (9), in which three things are printed wrongly
(docs/vehicles.md), are least squares, which :func:`through` does at any times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..dsp.robust import MAD_SIGMA, TUKEY
from ..localizers.joint_calibration import LOSS_WEIGHTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

Loss = Literal["squares", "huber", "tukey"]
#: Reweightings at most. Chosen by judgement: far more than it takes.
_ROUNDS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """Where and when a course crosses a line.

    Attributes
    ----------
    time_s, time_sigma_s
        When, and its standard deviation [s].
    position
        Where, shape (2,) [m].
    along_m, along_sigma_m
        How far from the line's first point, and its standard deviation [m].
    inside
        Whether that is between the line's two points.
    rightwards
        Whether the vehicle goes to the right of one who looks from the first point to the second.
    """

    time_s: float
    time_sigma_s: float
    position: Array
    along_m: float
    along_sigma_m: float
    inside: bool
    rightwards: bool


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Straight uniform motion, z(t) = z0 + V (t - t0), (8).

    Attributes
    ----------
    time_s
        t0 [s].
    position
        z0, shape (2,) [m].
    velocity
        V, shape (2,) [m/s].
    covariance
        Shape (4, 4): of (x, y, vx, vy).
    """

    time_s: float
    position: Array
    velocity: Array
    covariance: Array

    def at(self, times_s: Array) -> Array:
        """Return the places at times, shape (..., 2) from (...) [m]."""
        return np.asarray(self.position + self.velocity * (times_s - self.time_s)[..., None])

    def spread_at(self, times_s: Array) -> Array:
        """Return the covariances of those places, shape (..., 2, 2) [m^2]."""
        ahead = (times_s - self.time_s)[..., None, None]
        c = self.covariance
        mixed = c[:2, 2:] + c[2:, :2]
        return np.asarray(c[:2, :2] + ahead * mixed + ahead**2 * c[2:, 2:])

    @property
    def speed_mps(self) -> float:
        """Length of V [m/s]."""
        return float(np.hypot(*self.velocity))

    @property
    def speed_sigma_mps(self) -> float:
        """Standard deviation of the speed [m/s]."""
        return self._sigma(self.velocity / self.speed_mps)

    @property
    def heading_rad(self) -> float:
        """Direction of V, counter-clockwise from x [rad]."""
        return float(np.arctan2(self.velocity[1], self.velocity[0]))

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation of the heading [rad]."""
        vx, vy = self.velocity
        return self._sigma(np.array([-vy, vx]) / self.speed_mps**2)

    def _sigma(self, gradient: Array) -> float:
        return float(np.sqrt(gradient @ self.covariance[2:, 2:] @ gradient))

    def crossing(self, start: Array, end: Array) -> Crossing | None:
        """Return the crossing of the line through two points, or None for a parallel course.

        Parameters
        ----------
        start, end
            Shapes (2,) [m].
        """
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        across = np.array([along[1], -along[0]])
        rate = float(across @ self.velocity)
        if abs(rate) <= 1e-9 * self.speed_mps:
            return None
        ahead = float(across @ (start - self.position)) / rate
        position = self.position + ahead * self.velocity
        # delta method: what the moment, and the way along the line, owe to (x, y, vx, vy)
        moved = np.concatenate([np.eye(2), ahead * np.eye(2)], axis=1)
        time_slope = -(across @ moved) / rate
        along_slope = along @ moved + float(along @ self.velocity) * time_slope
        time_sigma, along_sigma = (
            float(np.sqrt(slope @ self.covariance @ slope)) for slope in (time_slope, along_slope)
        )
        way = float(along @ (position - start))
        when = self.time_s + ahead
        return Crossing(
            when, time_sigma, position, way, along_sigma, 0 <= way <= length, rightwards=rate > 0
        )


def through(times_s: Array, places: Array, loss: Loss = "huber") -> Course:
    """Return the course through places at any times, by reweighting.

    The scale comes from the median of the distances off the course, so that less than half of the
    cycles may be outliers; Tukey's loss starts where Huber's ends, and leaves far ones out wholly.

    Parameters
    ----------
    times_s
        Shape (n,), n at least 3 [s].
    places
        Shape (n, 2) [m].
    loss
        ``squares``: (9). ``huber``, ``tukey``: robust ones.

    Returns
    -------
    The course, at the mean of the times; its covariance is that of a reweighted fit.
    """
    start = float(times_s.mean())
    design = np.stack([np.ones_like(times_s), times_s - start], axis=1)
    weights = np.ones(len(times_s))
    coefficients = _weighted(design, places, weights)
    for kind in {"squares": (), "huber": ("huber",), "tukey": ("huber", "tukey")}[loss]:
        for _ in range(_ROUNDS):
            before = coefficients
            weights = _weights(kind, places - design @ coefficients)
            coefficients = _weighted(design, places, weights)
            if np.abs(coefficients - before).max() <= 1e-12 * (1 + np.abs(coefficients).max()):
                break
    off = places - design @ coefficients
    variance = np.einsum("n,ni,nj->ij", weights, off, off) / max(weights.sum() - 2, 1e-9)
    inverse = np.linalg.inv(design.T @ (design * weights[:, None]))
    return Course(start, coefficients[0], coefficients[1], np.kron(inverse, variance))


def _weighted(design: Array, places: Array, weights: Array) -> Array:
    scaled = design * weights[:, None]
    return np.asarray(np.linalg.solve(design.T @ scaled, scaled.T @ places), np.float64)


def _weights(kind: str, off: Array) -> Array:
    """Return a weight per place for its distances off the course, shape (n, 2)."""
    scale = MAD_SIGMA * np.median(np.abs(off - np.median(off, axis=0)), axis=0)
    z = np.linalg.norm(off / np.maximum(scale, 1e-9), axis=1) / np.sqrt(2)
    if kind == "huber":
        return LOSS_WEIGHTS["huber"](z)
    return np.asarray(np.where(z < TUKEY, (1 - (z / TUKEY) ** 2) ** 2, 0.0), np.float64)
