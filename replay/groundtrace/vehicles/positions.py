"""A place from the ratios of powers at sensors to that at a reference.

Source: the paper, equations (16) and (17). Corrected here:

- (16) has the ratio of powers to the power 1 / 1.5, but its left side is a ratio of *squared*
  distances: it is 2 / n.
- (17) compares theta to ratios of distances; theta is their n-th power, so theta^(1 / n) (2/3 for
  n = 1.5) stands in its place.
- (17) leaves out the reference, whose ratio is 1 on both sides. Without it the normalisation loses
  a common factor of all ratios, so with three sensors one of two measurements.

The first sensor is the reference throughout.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..localizers.location import Location
from .medium import EXPONENT, ranges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_STEPS = 30


def lattice(low: tuple[float, float], high: tuple[float, float], step_m: float) -> Array:
    """Return the nodes of a table, shape (n, 2) [m], x running fastest.

    Parameters
    ----------
    low, high
        Opposite corners [m].
    step_m
        Distance of neighbours; the paper takes 0.5 or 1 m.
    """
    x, y = (np.arange(a, b + step_m / 2, step_m) for a, b in zip(low, high, strict=True))
    return np.stack([c.ravel() for c in np.meshgrid(x, y)], axis=1)


def correlation(
    nodes: Array, sensors: Array, log_theta: Array, exponent: float = EXPONENT
) -> Array:
    """Return the metric (17) as corrected at every node.

    Parameters
    ----------
    nodes
        Shape (m, 2) [m].
    sensors
        Shape (n, 2), the reference first [m].
    log_theta
        Shape (..., n - 1): ln (r_i / r_0)^n of the others.
    exponent
        n.

    Returns
    -------
    Shape (..., m), at most 1.
    """
    r = ranges(nodes, sensors)
    table = r / np.linalg.norm(r, axis=1, keepdims=True)
    measured = np.exp(with_reference(log_theta) / exponent)
    measured /= np.linalg.norm(measured, axis=-1, keepdims=True)
    return np.asarray(measured @ table.T)


def squares(
    nodes: Array,
    sensors: Array,
    log_theta: Array,
    exponent: float = EXPONENT,
    sensor_sigma: float | Array = 1.0,
) -> Array:
    """Return the mean square misfit of the logarithms of distances, common part taken off.

    The logarithms of power err independently at the sensors, so those of the ratios do
    not, the reference being in all of them; with the common part free no sensor is special.

    Parameters
    ----------
    nodes, sensors, log_theta, exponent
        As of :func:`correlation`.
    sensor_sigma
        Standard deviation of ln of a sensor's power, one or of each, shape (n,): the misfits weigh
        by the inverse of its square.

    Returns
    -------
    Shape (..., m).
    """
    weights = _weights(sensor_sigma, len(sensors))
    table = _centred(np.log(ranges(nodes, sensors)), weights)
    measured = _centred(with_reference(log_theta) / exponent, weights)
    square = table**2 @ weights + (measured**2 @ weights)[..., None]
    return np.asarray(square - 2 * (weights * measured) @ table.T)


def locate(
    nodes: Array,
    sensors: Array,
    log_theta: Array,
    sensor_sigma: float | Array,
    exponent: float = EXPONENT,
) -> Location:
    """Return the place whose logarithms of distance fit best, refined below the table.

    Parameters
    ----------
    nodes, sensors, exponent
        As of :func:`correlation`.
    log_theta
        Shape (n - 1,).
    sensor_sigma
        Standard deviation of ln of a sensor's power, one or of each, shape (n,); of a ratio of two
        alike it is sqrt(2) times that.

    Returns
    -------
    The place; its residual is the root of :func:`squares`. Ties counts the nodes that fit no worse
    than by one standard deviation.
    """
    n = len(sensors)
    misfit = squares(nodes, sensors, log_theta, exponent, sensor_sigma)
    weights = _weights(sensor_sigma, n)
    variance = 1 / np.sum(np.broadcast_to(sensor_sigma / exponent, n) ** -2.0)  # of all together
    measured = _centred(with_reference(log_theta) / exponent, weights)
    place, slopes, residual = _refined(nodes[misfit.argmin()], sensors, measured, weights)
    information = slopes.T @ slopes
    covariance = np.full((2, 2), np.inf)
    if np.linalg.cond(information) < 1e12:
        covariance = np.linalg.inv(information) * variance
    ties = int((misfit - misfit.min() <= variance).sum())
    x, y = place.tolist()
    return Location(x, y, covariance, residual, n, ties)


def _refined(
    place: Array, sensors: Array, measured: Array, weights: Array
) -> tuple[Array, Array, float]:
    """Go downhill from a node; return the place, the slopes there and the residual."""
    damping = 1e-3
    off, slopes = _misfit(place, sensors, measured, weights)
    for _ in range(_STEPS):
        information = slopes.T @ slopes
        ridge = damping * np.trace(information) * np.eye(2)
        step = np.linalg.solve(information + ridge + 1e-12 * np.eye(2), -slopes.T @ off)
        tried, tried_slopes = _misfit(place + step, sensors, measured, weights)
        if tried @ tried <= off @ off:
            place, off, slopes, damping = place + step, tried, tried_slopes, damping / 4
        else:
            damping *= 8
    return place, slopes, float(np.sqrt(off @ off))


def _misfit(place: Array, sensors: Array, measured: Array, weights: Array) -> tuple[Array, Array]:
    """Return misfits and their slopes, each times the root of its weight."""
    r, root = ranges(place, sensors), np.sqrt(weights)
    off = _centred(np.log(r), weights) - measured
    slopes = _centred(((place - sensors) / r[:, None] ** 2).T, weights)
    return root * off, (root * slopes).T


def solve(sensors: Array, log_theta: Array, exponent: float = EXPONENT) -> Array:
    """Solve (16) as corrected for three sensors.

    Parameters
    ----------
    sensors
        Shape (3, 2), the reference first [m].
    log_theta
        Shape (2,): of the other two.
    exponent
        n.

    Returns
    -------
    Shape (k, 2): none, one or two places [m]; two that mirror each other if the sensors stand in
    a line.
    """
    sides = sensors[1:] - sensors[0]
    squared = np.exp(2 / exponent * log_theta)  # of the distances, (r_i / r_0)^2
    # with q = |z|^2: q (1 - a_i) - 2 p_i . z + |p_i|^2 = 0
    length = (sides**2).sum(axis=1)
    area = abs(float(sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]))
    if area > 1e-9 * float(length.max()):
        base = np.linalg.solve(2 * sides, length)
        turn = np.linalg.solve(2 * sides, 1 - squared)
        roots = _roots(float(turn @ turn), float(2 * base @ turn - 1), float(base @ base))
        return np.asarray(sensors[0] + base + np.outer(roots, turn))
    along = sides[length.argmax()] / np.sqrt(length.max())
    system = np.stack([1 - squared, -2 * sides @ along], axis=1)
    if abs(np.linalg.det(system)) < 1e-12:
        return np.empty((0, 2))
    q, x = np.linalg.solve(system, -length)
    if q < x * x:
        return np.empty((0, 2))
    y = np.sqrt(q - x * x) * np.array([1.0, -1.0])
    return np.asarray(sensors[0] + x * along + np.outer(y, [-along[1], along[0]]))


def _roots(a: float, b: float, c: float) -> Array:
    """Return the real roots of a q^2 + b q + c, also where a is 0."""
    if abs(a) < 1e-15 * max(abs(b), abs(c)):
        return np.array([-c / b])
    inside = b * b - 4 * a * c
    if inside < 0:
        return np.empty(0)
    # without a difference of nearly equal numbers
    t = -0.5 * (b + np.copysign(np.sqrt(inside), b))
    return np.array([t / a, c / t]) if t else np.array([0.0])


def with_reference(log_theta: Array) -> Array:
    """Return ln theta with that of the reference, 0, in front, shape (..., n)."""
    zero = np.zeros((*log_theta.shape[:-1], 1))
    return np.concatenate([zero, log_theta], axis=-1)


def _weights(sensor_sigma: float | Array, n: int) -> Array:
    """Return weights of n sensors, their sum 1."""
    inverse = np.broadcast_to(sensor_sigma, n) ** -2.0
    return np.asarray(inverse / inverse.sum())


def _centred(values: Array, weights: Array) -> Array:
    return np.asarray(values - (values @ weights)[..., None])
