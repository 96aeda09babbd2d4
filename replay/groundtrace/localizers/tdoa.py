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
    arrived = np.isfinite(times_s)
    picks = int(arrived.sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    area = for_sensors(lattice(positions, outline), arrived)
    times = times_s[None, arrived]
    best = search(area, positions[arrived], times, Model(1.0, 1.0 / velocity_mps))
    noise = noise_s(best, times, HYPERBOLIC_UNKNOWNS, sigma_s, OF_SPREAD_GIVEN)
    noise *= max(1.0, picks / ALIKE) ** 0.5
    covariance = moments(area, best, picks, noise)[1][0]
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
    blocks = [search(area, positions, block, model).places for block in in_blocks(area, times_s)]
    return np.concatenate([np.empty((0, 2)), *blocks])


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
    arrived = np.isfinite(times_s)
    picks = int(arrived.sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    area = for_sensors(lattice(positions, outline, exponent), arrived)
    model = Model(exponent, None, huber * sigma_s)
    times = times_s[None, arrived]
    best = search(area, positions[arrived], times, model)
    noise = noise_s(best, times, POWER_LAW_UNKNOWNS, sigma_s)
    noise *= USUAL if picks > POWER_LAW_UNKNOWNS else 1.0
    (mean,), (covariance,) = moments(area, best, picks, noise)
    if picks > POWER_LAW_UNKNOWNS:
        x, y = best.places[0]
    else:
        (x, y), covariance = mean, ON_A_CURVE * covariance
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
    picks, blocks = len(positions), [np.empty((0, 2))]
    for block in in_blocks(area, times_s):
        best = search(area, positions, block, model)
        if picks > POWER_LAW_UNKNOWNS:
            blocks.append(best.places)
        else:
            noise = noise_s(best, block, POWER_LAW_UNKNOWNS, sigma_s)
            blocks.append(moments(area, best, picks, noise)[0])
    return np.concatenate(blocks)


#: Nodes along the longer side of the room. Source: thesis, chapter 5 has 25; chosen by judgement:
#: about as many, as a refinement about the best node follows.
NODES = 28
#: Nodes along both sides of the refinements, and how many of its own nodes the first one has for
#: each node before: it stands for the best node and its neighbours, the second one for the best
#: node of the first and its neighbours. Chosen by judgement: from 10 m over 28 nodes they end at
#: 1.5 cm, below the error of arrivals.
FINER, PARTS = (15, 11), 5
#: Passes of reweighting. Chosen by judgement: a third one moves places by less than a node.
PASSES = 2
#: The nodes of refinements about the best one, in their steps, shapes (f, 2). Source: definition.
AROUND = tuple(
    np.stack(np.meshgrid(*[np.arange(count) - count // 2] * 2, indexing="ij"), -1).reshape(-1, 2)
    for count in FINER
)
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
    def box(self) -> Array | None:
        """Lowest and highest x and y of a room that is a rectangle along both, shape (2, 2) [m]."""
        low, high = np.array(self.room.bounds).reshape(2, 2)
        return np.array([low, high]) if self.room.equals(shapely.box(*low, *high)) else None

    def inside(self, nodes: Array) -> NDArray[np.bool_]:
        """Return which places, shape (..., 2), are in the room or on its walls."""
        if self.box is None:
            is_inside: NDArray[np.bool_] = shapely.intersects_xy(
                self.room, nodes[..., 0], nodes[..., 1]
            )
            return is_inside
        x, y, ((left, low), (right, high)) = nodes[..., 0], nodes[..., 1], self.box
        return np.asarray((x >= left) & (x <= right) & (y >= low) & (y <= high))


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
    finer
        Shape (m, f, 2): nodes of the first refinement [m].
    finer_losses
        Shape (m, f): loss there [s^2]; inf outside the room.
    """

    places: Array
    loss: Array
    losses: Array
    finer: Array
    finer_losses: Array


def lattice(
    positions: Array, outline: Array | None = None, exponent: float = 1.0, nodes: int = NODES
) -> Lattice:
    """Return the lattice of a layout; the layouts used last are remembered."""
    positions = np.ascontiguousarray(positions, np.float64)
    corners = None if outline is None else np.ascontiguousarray(outline, np.float64).tobytes()
    return _lattice(positions.tobytes(), corners, exponent, nodes)


@lru_cache(maxsize=8)
def _lattice(positions: bytes, outline: bytes | None, exponent: float, count: int) -> Lattice:
    plain = _distant(positions, outline, count)
    return plain if exponent == 1.0 else replace(plain, u=plain.u**exponent)


@lru_cache(maxsize=8)
def _distant(positions: bytes, outline: bytes | None, count: int) -> Lattice:
    """Return the lattice whose u are the distances themselves."""
    sensors = np.frombuffer(positions).reshape(-1, 2)
    corners = None if outline is None else np.frombuffer(outline).reshape(-1, 2)
    room = outline_of(sensors, corners)
    low, high = np.array(room.bounds).reshape(2, 2)
    spacing = float(np.max(high - low)) / (count - 1)
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
    passes = PASSES if np.isfinite(model.threshold_s) else 0
    slope = float("nan") if model.slope is None else model.slope
    nodes = u if u.ndim == 3 else u[None]
    loss = np.empty((len(times_s), nodes.shape[2]))
    kernels.locate.robust_losses(nodes, times_s, slope, model.threshold_s, passes, loss)
    return loss


def _centred(u: Array) -> tuple[Array, Array]:
    """Return u, shape (n, q), less its mean over sensors, and the sums of squares of that."""
    offset = u - u.mean(axis=0)
    return offset, np.einsum("nq,nq->q", offset, offset)


def _squares(offset: Array, square: Array, times_s: Array, slope: float | None) -> Array:
    """Return the mean square of the residuals: without weights it needs but one product."""
    late = times_s - times_s.mean(axis=-1, keepdims=True)
    along = late @ offset
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


def for_sensors(area: Lattice, arrived: NDArray[np.bool_]) -> Lattice:
    """Return a lattice for the sensors that have an arrival, shape (n,)."""
    return area if arrived.all() else replace(area, u=area.u[arrived])


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
    position, loss = area.nodes[best], every[row, best]
    step, refined = area.spacing, []
    for around in AROUND:
        step /= PARTS
        nodes = position[:, None] + step * around
        finer = losses(distances(sensors, nodes) ** model.exponent, times, model)
        finer[~area.inside(nodes)] = np.inf
        best = finer.argmin(axis=1)
        better = finer[row, best] < loss
        position = np.where(better[:, None], nodes[row, best], position)
        loss = np.where(better, finer[row, best], loss)
        refined.append((nodes, finer))
    return GridOptimum(position, loss, every, *refined[0])


def in_blocks(area: Lattice, times_s: Array) -> list[Array]:
    """Return arrivals, shape (m, n), in blocks whose losses are held at once."""
    rows = max(1, CELLS // len(area.nodes))
    return [times_s[i : i + rows] for i in range(0, len(times_s), rows)]


#: A deviation told beforehand counts as so many arrivals to spare. Chosen by judgement: a place of
#: few arrivals follows what is told, one of many its own residuals.
TOLD = 4
#: Arrivals err by this part of how far they are apart, as no law of waves is right to less; more
#: where their velocity is given instead of fitted. Bench: room_laws.py --first 101 --last 124, by
#: the truths in claimed regions, of 0, 0.1, 0.2 and 0.35.
OF_SPREAD, OF_SPREAD_GIVEN = 0.1, 0.35
#: Arrivals at a given velocity tell as much as so many at most: all are off by the one error of the
#: velocity. Bench: room_laws.py --first 101 --last 140, by the truths in claimed regions, of 6, 8
#: and any number.
ALIKE = 8
#: A region of the power law reckons with this part of what residuals tell: a few late arrivals
#: raise their mean square over what most are off. Where no arrival is to spare it takes all. Bench:
#: room_laws.py --first 101 --last 140, by the truths in claimed regions, of 0.8 and 1.
USUAL = 0.8
#: Up to four arrivals leave a curve of places that all fit; the truth is nearer to its middle than
#: the covariance of an even curve. Bench: room_laws.py --first 101 --last 140 --sensors 4, by the
#: truths in claimed regions, of 0.6 to 1.
ON_A_CURVE = 0.7


def noise_s(
    best: GridOptimum,
    times_s: Array,
    unknowns: int,
    prior_s: float,
    of_spread: float = OF_SPREAD,
) -> Array:
    """Return the standard deviation of an arrival that a region reckons with, shape (m,) [s].

    Its square is that of what is told, with a part of the arrivals' own scatter, and that of the
    residuals, weighed by what each has to spare.

    Parameters
    ----------
    best
        The fit.
    times_s
        Shape (m, n): arrivals [s].
    unknowns
        How much of their scatter the fit took away.
    prior_s
        What is known of it beforehand [s].
    of_spread
        By what part of their scatter arrivals err besides.
    """
    picks = times_s.shape[1]
    variance = prior_s**2 + (of_spread * times_s.std(axis=1)) ** 2
    left = (TOLD * variance + picks * best.loss) / (TOLD + max(picks - unknowns, 0))
    return np.asarray(np.sqrt(left))


def excesses(best: GridOptimum, picks: int) -> Array:
    """Return the sum of all arrivals' losses over the least, shape (m, q + f) [s^2].

    At the nodes of the lattice, then of the refinement.
    """
    every = np.concatenate([best.losses, best.finer_losses], axis=1)
    excess: Array = picks * (every - best.loss[:, None])
    return excess


def posterior(area: Lattice, best: GridOptimum, likelihood: Array) -> tuple[Array, Array]:
    """Return mean, shape (m, 2) [m], and covariance, (m, 2, 2) [m^2], of places by likelihood.

    Nodes stand for squares; those about the best node are the refinement's.

    Parameters
    ----------
    area
        The lattice.
    best
        The fit.
    likelihood
        Shape (m, q + f), in the order of :func:`excesses`.
    """
    middle, square, q = best.finer[:, best.finer.shape[1] // 2], area.spacing**2, len(area.nodes)
    apart = np.abs(area.nodes - middle[:, None]).max(axis=2) > 1.5 * area.spacing
    share = np.concatenate([likelihood[:, :q] * apart, likelihood[:, q:] / PARTS**2], axis=1)
    share /= share.sum(axis=1, keepdims=True)
    far, near = share[:, :q], share[:, q:]
    mean = far @ area.nodes + np.einsum("mf,mfx->mx", near, best.finer)
    off, off_near = area.nodes - mean[:, None], best.finer - mean[:, None]
    covariance = np.matmul((off * far[..., None]).transpose(0, 2, 1), off)
    covariance += np.matmul((off_near * near[..., None]).transpose(0, 2, 1), off_near)
    within = square / 12 * (far.sum(axis=1) + near.sum(axis=1) / PARTS**2)
    return mean, covariance + within[:, None, None] * np.eye(2)


def moments(area: Lattice, best: GridOptimum, picks: int, sigma_s: Array) -> tuple[Array, Array]:
    """Return mean, shape (m, 2), and covariance, shape (m, 2, 2), of places.

    Parameters
    ----------
    area
        The lattice.
    best
        The fit.
    picks
        How many arrivals its losses are the mean of.
    sigma_s
        Shape (m,): standard deviation of an arrival [s].
    """
    likelihood = np.exp(-excesses(best, picks) / (2 * sigma_s[:, None] ** 2))
    return posterior(area, best, likelihood)
