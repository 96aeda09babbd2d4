"""Arrival times as a line over distance: t = t0 + k u, fitted at every node of a lattice.

For a place given, t0 and k enter linearly: the best of them is in closed form, so that a lattice
over the room costs a few products of arrays, and no start value can lead astray.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely

from .outline import outline_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Nodes along the longer side of the room, and along both sides of a refinement.
NODES, FINER = 55, 9
#: Passes of reweighting, and refinements about the best node, each four times as fine.
PASSES, REFINEMENTS = 2, 2


@dataclass(frozen=True, slots=True)
class Model:
    """How arrivals depend on distance.

    Attributes
    ----------
    exponent
        p of u = d^p.
    slope
        k where it is known [s/m^p]; None where it is fitted.
    threshold_s
        Residuals beyond it count linearly, not squared (Huber's loss); inf counts all squared.
    """

    exponent: float
    slope: float | None = None
    threshold_s: float = float("inf")


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Nodes inside a room.

    Attributes
    ----------
    room
        The room.
    nodes
        Shape (q, 2) [m].
    spacing
        Between neighbours [m].
    u
        Shape (n, q): distances to the sensors to the power of the exponent.
    """

    room: shapely.Polygon
    nodes: Array
    spacing: float
    u: Array


@dataclass(frozen=True, slots=True, eq=False)
class Best:
    """The best place found: its node, its loss [s^2], and the loss of all nodes, shape (q,)."""

    place: Array
    loss: float
    losses: Array


def lattice(positions: Array, outline: Array | None = None, exponent: float = 1.0) -> Lattice:
    """Return the lattice of a layout; the layouts used last are remembered."""
    positions = np.ascontiguousarray(positions, np.float64)
    corners = None if outline is None else np.ascontiguousarray(outline, np.float64).tobytes()
    return _lattice(positions.tobytes(), corners, exponent)


@lru_cache(maxsize=8)
def _lattice(positions: bytes, outline: bytes | None, exponent: float) -> Lattice:
    sensors = np.frombuffer(positions).reshape(-1, 2)
    corners = None if outline is None else np.frombuffer(outline).reshape(-1, 2)
    room = outline_of(sensors, corners)
    low, high = np.array(room.bounds).reshape(2, 2)
    spacing = float(np.max(high - low)) / (NODES - 1)
    counts = np.rint((high - low) / spacing).astype(int) + 1
    x, y = (a + spacing * np.arange(count) for a, count in zip(low, counts, strict=True))
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    shapely.prepare(room)
    nodes = nodes[shapely.intersects_xy(room, *nodes.T)]
    return Lattice(room, nodes, spacing, distances(sensors, nodes) ** exponent)


def distances(one: Array, other: Array) -> Array:
    """Return the distances of places, shape (m, 2), to others, shape (q, 2); shape (m, q) [m]."""
    apart: Array = np.hypot(*(one[:, None] - other).transpose(2, 0, 1))
    return apart


def losses(u: Array, times_s: Array, model: Model) -> Array:
    """Return the mean loss of the best t0 and k at every node.

    Parameters
    ----------
    u
        Shape (n, q): d^p.
    times_s
        Shape (n,), finite.
    model
        Its slope, and the threshold of the loss.

    Returns
    -------
    Shape (q,) [s^2]: twice Huber's loss, which is the mean square of the residuals where none is
    beyond the threshold. A slope that is fitted is at least 0: waves do not arrive before they
    leave.
    """
    t = times_s[:, None]
    left = _residuals(u, t, np.ones_like(t), model.slope)
    threshold = model.threshold_s
    if not np.isfinite(threshold):
        plain: Array = np.einsum("nq,nq->q", left, left) / len(t)
        return plain
    for _ in range(PASSES):
        size = np.abs(left)
        left = _residuals(u, t, threshold / np.maximum(size, threshold), model.slope)
    size = np.abs(left)
    inner = np.minimum(size, threshold)
    size *= 2
    size -= inner
    loss: Array = np.einsum("nq,nq->q", inner, size) / len(t)
    return loss


def _residuals(u: Array, t: Array, weight: Array, slope: float | None) -> Array:
    """Return t - t0 - k u with the best t0 and k under weights, shape (n, q)."""
    whole = weight.sum(axis=0)
    weighted = weight * u
    u_mean = weighted.sum(axis=0) / whole
    t_mean = (weight * t).sum(axis=0) / whole
    if slope is None:
        square = np.einsum("nq,nq->q", weighted, u) - whole * u_mean**2
        along = (t[:, 0] @ weighted) - whole * u_mean * t_mean
        square = np.maximum(square, np.finfo(np.float64).tiny)
        k = np.maximum(along / square, 0.0)
    else:
        k = np.full_like(u_mean, slope)
    left: Array = t - k * u
    left -= t_mean - k * u_mean
    return left


def search(area: Lattice, sensors: Array, times_s: Array, model: Model) -> Best:
    """Return the place of least loss: the best node, then the best of ever finer ones about it.

    Parameters
    ----------
    area
        Lattice of all sensors of the layout.
    sensors
        Shape (n, 2) [m].
    times_s
        Shape (n,); NaN where a sensor has no arrival.
    model
        Of the arrivals.
    """
    heard = np.isfinite(times_s)
    times, here = times_s[heard] - times_s[heard].min(), sensors[heard]
    every = losses(area.u if heard.all() else area.u[heard], times, model)
    place, loss = area.nodes[int(np.argmin(every))], float(every.min())
    step, ticks = area.spacing, np.linspace(-1, 1, FINER)
    cross = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    for _ in range(REFINEMENTS):
        nodes = place + step * cross
        nodes = nodes[shapely.intersects_xy(area.room, *nodes.T)]
        if len(nodes):
            finer = losses(distances(here, nodes) ** model.exponent, times, model)
            if float(finer.min()) < loss:
                place, loss = nodes[int(np.argmin(finer))], float(finer.min())
        step *= 2 / (FINER - 1)
    return Best(place, loss, every)


def noise_s(best: Best, picks: int, unknowns: int, least_s: float) -> float:
    """Return the standard deviation of an arrival that the residuals tell of [s].

    Parameters
    ----------
    best
        The fit.
    picks, unknowns
        Arrivals, and how much of their scatter the fit took away.
    least_s
        The least to answer [s].
    """
    return max(least_s, float(np.sqrt(best.loss * picks / max(picks - unknowns, 1))))


def moments(area: Lattice, excess: Array, sigma_s: float) -> tuple[Array, Array]:
    """Return mean, shape (2,), and covariance, shape (2, 2), of the place among the nodes.

    Parameters
    ----------
    area
        The lattice.
    excess
        Shape (q,): sum of the losses of all arrivals [s^2].
    sigma_s
        Standard deviation of an arrival [s].
    """
    weight = np.exp(-(excess - excess.min()) / (2 * sigma_s**2))
    share = weight / weight.sum()
    mean = share @ area.nodes
    offset = area.nodes - mean
    # nodes stand for squares
    covariance = (offset * share[:, None]).T @ offset + area.spacing**2 / 12 * np.eye(2)
    return mean, covariance
