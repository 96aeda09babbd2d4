"""TDOA: locations from differences of arrivals, hyperbolic or by a power law of distance.

Hyperbolic, with a known velocity: the thesis on footstep localisation, equation (5.14). The sum
over all pairs of squares is n times the sum of squares about the mean, so arrivals are fitted
directly, with the time of the impact free.

Power law, without calibration: t = t0 + k d^p. Source: the thesis on footstep localisation,
equation (4.24): t grows with d^(4/3), and the constant of the floor only scales it. So the time t0
and the scale k are fitted along with the location, and no velocity is needed. Huber's loss bounds
what a late or false arrival may do.

For a given location, t0 and k enter linearly: the best of them is in closed form. So a lattice over
the room costs a few products of arrays, and no start value can lead astray.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely

from .. import kernels
from ..dsp.robust import HUBER
from ..errors import PipelineError
from ..pipeline.stage import LEAST_PICKS, LocationEstimate, no_location
from .base import EXPONENT, outline_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Place and moment. Source: definition.
HYPERBOLIC_UNKNOWNS = 3


def locate_hyperbolic(
    positions: Array,
    times_s: Array,
    velocity_mps: float,
    outline: Array | None = None,
    sigma_s: float = 5e-4,
) -> LocationEstimate:
    """Return the place whose distances fit the arrivals best at a velocity.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    velocity_mps
        Calibrated velocity [m/s].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    sigma_s
        Standard deviation of an arrival that the covariance reckons with at least [s].

    Returns
    -------
    The place; its residual is the root mean square of what the arrivals are off [s].
    """
    heard = np.isfinite(times_s)
    picks = int(heard.sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    area = for_sensors(lattice(positions, outline), heard)
    best = search(area, positions[heard], times_s[None, heard], Model(1.0, 1.0 / velocity_mps))
    noise = float(noise_s(best, picks, HYPERBOLIC_UNKNOWNS, sigma_s)[0])
    _, covariance = moments(area, best.losses[0] * picks, noise)
    x, y = best.places[0]
    return LocationEstimate(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


def hyperbolic_places(
    positions: Array, times_s: Array, velocity_mps: float, outline: Array | None = None
) -> Array:
    """Return the places of many impacts, shape (m, 2) [m], as ``locate_hyperbolic`` does of one.

    Parameters
    ----------
    positions, velocity_mps, outline
        As of :func:`locate_hyperbolic`.
    times_s
        Shape (m, n): arrivals [s], all finite.
    """
    area, model = lattice(positions, outline), Model(1.0, 1.0 / velocity_mps)
    found = [search(area, positions, block, model).places for block in in_blocks(area, times_s)]
    return np.concatenate([np.empty((0, 2)), *found])


def calibrated_velocity(sources: Array, positions: Array, times_s: Array) -> float:
    """Return the velocity that best turns time differences into those of distances [m/s].

    Parameters
    ----------
    sources
        Shape (m, 2): places of controlled impacts [m].
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (m, n): arrivals [s]; NaN where there is none.

    Raises
    ------
    PipelineError
        Where the arrivals do not grow with distance.
    """
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isfinite(times_s), distances(sources, positions), np.nan)
    tau = times_s - np.nanmean(times_s, axis=1, keepdims=True)
    further = apart - np.nanmean(apart, axis=1, keepdims=True)
    along = float(np.nansum(tau * further))
    if not along > 0:
        raise PipelineError("calibration: expected arrivals that grow with distance, found others")
    return along / float(np.nansum(tau**2))


#: Place, moment and scale: with fewer arrivals than this a curve of places fits equally well.
#: Source: definition.
POWER_LAW_UNKNOWNS = 4


def locate_power_law(
    positions: Array,
    times_s: Array,
    outline: Array | None = None,
    exponent: float = EXPONENT,
    sigma_s: float = 5e-4,
    huber: float = HUBER,
) -> LocationEstimate:
    """Return the place from which arrivals grow most nearly with a power of distance.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    exponent
        p; 4/3 on a thin plate, 1 where velocity is constant.
    sigma_s
        Standard deviation of an arrival [s]; the covariance reckons with at least that.
    huber
        Residuals beyond this many ``sigma_s`` count linearly; inf counts all squared.

    Returns
    -------
    The place; its residual is the root of the mean loss [s]. Up to four arrivals leave a curve of
    places that all fit: then the place is its middle.
    """
    heard = np.isfinite(times_s)
    picks = int(heard.sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    area = for_sensors(lattice(positions, outline, exponent), heard)
    model = Model(exponent, None, huber * sigma_s)
    best = search(area, positions[heard], times_s[None, heard], model)
    noise = float(noise_s(best, picks, POWER_LAW_UNKNOWNS, sigma_s)[0])
    mean, covariance = moments(area, best.losses[0] * picks, noise)
    x, y = best.places[0] if picks > POWER_LAW_UNKNOWNS else mean
    return LocationEstimate(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


def power_law_places(
    positions: Array,
    times_s: Array,
    outline: Array | None = None,
    exponent: float = EXPONENT,
    sigma_s: float = 5e-4,
) -> Array:
    """Return places of impacts, shape (m, 2) [m], as :func:`locate_power_law` with huber = inf.

    Least squares cost a product of arrays for all impacts, any threshold an array for each.

    Parameters
    ----------
    positions, outline, exponent, sigma_s
        As of :func:`locate_power_law`.
    times_s
        Shape (m, n): arrivals [s], all finite.
    """
    area, model = lattice(positions, outline, exponent), Model(exponent)
    picks, found = len(positions), [np.empty((0, 2))]
    for block in in_blocks(area, times_s):
        best = search(area, positions, block, model)
        if picks > POWER_LAW_UNKNOWNS:
            found.append(best.places)
        else:
            noise = noise_s(best, picks, POWER_LAW_UNKNOWNS, sigma_s)
            found.append(node_posterior(best.losses * picks, noise) @ area.nodes)
    return np.concatenate(found)


#: Nodes along the longer side of the room, and along both sides of a refinement. Source: thesis,
#: chapter 5 has 25 nodes; chosen by judgement: finer, 3025 nodes cost 0.2 ms an impact.
NODES, FINER = 55, 9
#: Passes of reweighting, and refinements about the best node, each four times as fine. Chosen by
#: judgement: from 10 m over 55 nodes they end at 1 cm, below the error of arrivals.
PASSES, REFINEMENTS = 2, 2
#: The nodes of a refinement about the best one, in its steps, shape (FINER^2, 2). Source:
#: definition.
AROUND = np.stack(np.meshgrid(*[np.linspace(-1, 1, FINER)] * 2), axis=-1).reshape(-1, 2)
#: Losses of so many impacts times nodes are held at once. Chosen by judgement: 8 MB of doubles.
CELLS = 1_000_000


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


@dataclass(frozen=True, eq=False)
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

    @cached_property
    def centred(self) -> tuple[Array, Array]:
        """What :func:`_centred` makes of u."""
        return _centred(self.u)

    @cached_property
    def axes(self) -> Array:
        """Both coordinates of the nodes, each in one piece, shape (2, q) [m]."""
        return np.ascontiguousarray(self.nodes.T)


@dataclass(frozen=True, slots=True, eq=False)
class GridOptimum:
    """The best places found of m impacts.

    Attributes
    ----------
    places
        Shape (m, 2) [m].
    loss
        Shape (m,): least loss [s^2].
    losses
        Shape (m, q): loss at every node of the lattice [s^2].
    """

    places: Array
    loss: Array
    losses: Array


def lattice(positions: Array, outline: Array | None = None, exponent: float = 1.0) -> Lattice:
    """Return the lattice of a layout; the layouts used last are remembered."""
    positions = np.ascontiguousarray(positions, np.float64)
    corners = None if outline is None else np.ascontiguousarray(outline, np.float64).tobytes()
    return _lattice(positions.tobytes(), corners, exponent)


@lru_cache(maxsize=8)
def _lattice(positions: bytes, outline: bytes | None, exponent: float) -> Lattice:
    plain = _distant(positions, outline)
    return plain if exponent == 1.0 else replace(plain, u=plain.u**exponent)


@lru_cache(maxsize=8)
def _distant(positions: bytes, outline: bytes | None) -> Lattice:
    """Return the lattice whose u are the distances themselves."""
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
    return Lattice(room, nodes, spacing, distances(sensors, nodes))


def distances(one: Array, other: Array) -> Array:
    """Return the distances of places, shape (..., m, 2), to others, (..., q, 2), (..., m, q)."""
    square: Array = (one[..., :, None, 0] - other[..., None, :, 0]) ** 2
    square += (one[..., :, None, 1] - other[..., None, :, 1]) ** 2
    return np.sqrt(square, out=square)


def losses(u: Array, times_s: Array, model: Model) -> Array:
    """Return the mean loss of the best t0 and k at every node.

    Parameters
    ----------
    u
        Shape (n, q), or (m, n, q) for nodes of their own for every impact: d^p.
    times_s
        Shape (m, n), finite.
    model
        Its slope, and the threshold of the loss.

    Returns
    -------
    Shape (m, q) [s^2]: twice Huber's loss, which is the mean square of the residuals where none is
    beyond the threshold. A slope that is fitted is at least 0: waves do not arrive before they
    leave.
    """
    threshold = model.threshold_s
    if not np.isfinite(threshold):
        return _squares(*_centred(u), times_s, model.slope)
    slope = float("nan") if model.slope is None else model.slope
    nodes = u if u.ndim == 3 else u[None]
    loss = np.empty((len(times_s), nodes.shape[2]))
    kernels.locate.robust_losses(nodes, times_s, slope, threshold, PASSES, loss)
    return loss


def _centred(u: Array) -> tuple[Array, Array]:
    """Return u, shape (..., n, q), less its mean over sensors, and the sums of squares of that."""
    offset = u - u.mean(axis=-2, keepdims=True)
    return offset, np.einsum("...nq,...nq->...q", offset, offset)


def _squares(offset: Array, square: Array, times_s: Array, slope: float | None) -> Array:
    """Return the mean square of the residuals: without weights it needs but one product."""
    late = times_s - times_s.mean(axis=-1, keepdims=True)
    along = late @ offset if offset.ndim == 2 else np.einsum("mn,mnq->mq", late, offset)
    if slope is None:
        taken = np.maximum(along, 0.0)
        taken *= taken
        taken /= np.maximum(square, np.finfo(np.float64).tiny)
    else:
        taken = slope * (2 * along - slope * square)
    loss: Array = np.einsum("mn,mn->m", late, late)[:, None] - taken
    loss /= times_s.shape[-1]
    # rounding may leave less than nothing
    return np.maximum(loss, 0.0, out=loss)


def for_sensors(area: Lattice, heard: NDArray[np.bool_]) -> Lattice:
    """Return a lattice for the sensors that have an arrival, shape (n,)."""
    return area if heard.all() else replace(area, u=area.u[heard])


def search(area: Lattice, sensors: Array, times_s: Array, model: Model) -> GridOptimum:
    """Return the places of least loss: the best node, then the best of ever finer ones about it.

    Parameters
    ----------
    area
        Lattice of these sensors.
    sensors
        Shape (n, 2) [m].
    times_s
        Shape (m, n): arrivals of each impact, all finite.
    model
        Of the arrivals.
    """
    times = times_s - times_s.min(axis=1, keepdims=True)
    if np.isfinite(model.threshold_s):
        every = losses(area.u, times, model)
    else:
        every = _squares(*area.centred, times, model.slope)
    row, best = np.arange(len(times)), every.argmin(axis=1)
    place, loss = area.nodes[best], every[row, best]
    step = area.spacing
    for _ in range(REFINEMENTS):
        nodes = place[:, None] + step * AROUND
        finer = losses(distances(sensors, nodes) ** model.exponent, times, model)
        best = finer.argmin(axis=1)
        # what lies outside matters only where it is the best
        if not shapely.intersects_xy(area.room, *nodes[row, best].T).all():
            inside = shapely.intersects_xy(area.room, nodes[..., 0], nodes[..., 1])
            finer[~inside] = np.inf
            best = finer.argmin(axis=1)
        better = finer[row, best] < loss
        place = np.where(better[:, None], nodes[row, best], place)
        loss = np.where(better, finer[row, best], loss)
        step *= 2 / (FINER - 1)
    return GridOptimum(place, loss, every)


def in_blocks(area: Lattice, times_s: Array) -> list[Array]:
    """Return arrivals, shape (m, n), in blocks whose losses are held at once."""
    rows = max(1, CELLS // len(area.nodes))
    return [times_s[i : i + rows] for i in range(0, len(times_s), rows)]


def noise_s(best: GridOptimum, picks: int, unknowns: int, least_s: float) -> Array:
    """Return the standard deviation of an arrival that the residuals tell of, shape (m,) [s].

    Parameters
    ----------
    best
        The fit.
    picks, unknowns
        Arrivals, and how much of their scatter the fit took away.
    least_s
        The least to answer [s].
    """
    found: Array = np.maximum(least_s, np.sqrt(best.loss * picks / max(picks - unknowns, 1)))
    return found


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
    return weighted_moments(area, node_posterior(excess, np.asarray(sigma_s)))


def weighted_moments(area: Lattice, share: Array) -> tuple[Array, Array]:
    """Return mean, shape (2,), and covariance, shape (2, 2), of nodes that count a share each."""
    mean = share @ area.nodes
    offset = area.axes - mean[:, None]
    # nodes stand for squares
    return mean, (offset * share) @ offset.T + area.spacing**2 / 12 * np.eye(2)


def node_posterior(excess: Array, sigma_s: Array) -> Array:
    """Return how likely each node is, shape (..., q), for :func:`moments`' excess and sigma."""
    least = excess.min(axis=-1, keepdims=True)
    weight = np.exp(-(excess - least) / (2 * sigma_s[..., None] ** 2))
    share: Array = weight / weight.sum(axis=-1, keepdims=True)
    return share
