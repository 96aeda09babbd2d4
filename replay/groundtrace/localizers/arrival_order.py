"""SO-TDOA: a location from the signs of time differences alone.

Source: the thesis on footstep localisation, chapter 5: regions whose signs differ least from the
measured ones (5.5), and the mean of their centres (5.10). Nothing is presumed of the medium but
that a wave reaches the nearer of two sensors first.

All points of a region have the same order of distances to the sensors. Section 5.1 of the thesis
finds the regions by sampling the room and grouping the samples; here the lines halfway between the
sensors of each pair are arranged exactly, so that no region is missed and centres and areas have no
lattice in them. The thesis's bound on the number of regions is corrected: the three lines of any
three sensors meet in one point, so there are at most 1 + C(N, 2) + (3N - 1) C(N, 3) / 4.

The Bernoulli model of sign errors gives how likely each region makes the measured signs (section
5.3.2), with two corrections. The chance of a wrong sign is

    (1 + erf(-abs(tau) / (sqrt 2 sigma))) / 2:

(5.26) lacks the absolute value. And arrivals err, not differences: sigma of a difference is sqrt 2
times that of an arrival, and as the differences then hang together, the likelihood of N(N - 1)/2
signs is raised to the power 2 / N.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..pipeline.stage import LEAST_PICKS, LocationEstimate, no_location
from .base import outline_of
from .wave_physics import arrivals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Regions count less by this factor for every sign more that contradicts them; for the covariance.
#: The more signs contradict even the best region, the less one more sign says. Bench: room_laws.py
#: --first 101 --last 140, by the truths in claimed regions, of 0.04, 0.1 and 0.25.
NEAR = 0.1
#: Distances of so many impacts times regions are held at once. Chosen by judgement: 16 MB of
#: doubles.
CELLS = 2_000_000


def locate(positions: Array, times_s: Array, outline: Array | None = None) -> LocationEstimate:
    """Return the mean centre of the regions whose signs differ least from the measured ones.

    Parameters
    ----------
    positions
        Shape (n, 2): sensors [m].
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.

    Returns
    -------
    The place; its residual is the part of the compared signs that differ.
    """
    return among(known_regions(positions, outline), times_s)


def known_regions(positions: Array, outline: Array | None = None) -> Regions:
    """Return the regions of a layout; the layouts used last are remembered."""
    positions = np.ascontiguousarray(positions, np.float64)
    corners = None if outline is None else np.ascontiguousarray(outline, np.float64).tobytes()
    return _regions(positions.tobytes(), corners)


@lru_cache(maxsize=8)
def _regions(positions: bytes, outline: bytes | None) -> Regions:
    sensors = np.frombuffer(positions).reshape(-1, 2)
    corners = None if outline is None else np.frombuffer(outline).reshape(-1, 2)
    return find_regions(sensors, outline_of(sensors, corners))


def among(regions: Regions, times_s: Array) -> LocationEstimate:
    """Return the mean centre of the regions that fit the arrivals best, as :func:`locate`."""
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    signs, compared = measured_signs(regions, times_s)
    wrong = distances(regions, signs, compared)
    best = wrong == wrong.min()
    x, y = mean_of_nearest(regions, wrong)
    weight = regions.areas * NEAR ** ((wrong - wrong.min()) / (1 + wrong.min() / 2))
    covariance = spread(regions, weight, np.array([x, y]))
    residual = float(wrong.min()) / max(int(compared.sum()), 1)
    return LocationEstimate(float(x), float(y), covariance, residual, picks, int(best.sum()))


def places(regions: Regions, times_s: Array) -> Array:
    """Return the places of many impacts, as :func:`among` does of one.

    Parameters
    ----------
    regions
        Of the room.
    times_s
        Shape (m, n): arrivals [s], all finite.

    Returns
    -------
    Shape (m, 2) [m].
    """
    rows = max(1, CELLS // max(len(regions), 1))
    blocks = (times_s[i : i + rows] for i in range(0, len(times_s), rows))
    by_block = [
        mean_of_nearest(regions, distances(regions, *measured_signs(regions, block)))
        for block in blocks
    ]
    return np.concatenate([np.empty((0, 2)), *by_block])


def mean_of_nearest(regions: Regions, wrong: Array) -> Array:
    """Return the mean of the centres of least distance (5.10), shape (..., 2) for (..., q)."""
    best = wrong == wrong.min(axis=-1, keepdims=True)
    mean: Array = best @ regions.centres / best.sum(axis=-1, keepdims=True)
    return mean


def measured_signs(regions: Regions, times_s: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return sign(t_i - t_j) of all pairs, and which of them are measured and tell regions apart.

    Two arrivals at the same time have the sign 0. Shape (..., n_pairs) for arrivals (..., n).
    """
    with np.errstate(invalid="ignore"):
        signs = np.sign(times_s[..., regions.first] - times_s[..., regions.second])
    compared = np.isfinite(signs) & regions.determined
    return np.where(compared, signs, 0.0), compared


def distances(regions: Regions, signs: Array, compared: NDArray[np.bool_]) -> Array:
    """Return the Hamming distance (5.6) of each region over the compared pairs, shape (..., q).

    A sign of 0 is as far from +1 as from -1: it counts a half.
    """
    agreement = (signs.astype(np.float32) @ regions.across).astype(np.float64)
    apart: Array = (compared.sum(axis=-1, keepdims=True) - agreement) / 2
    return apart


def spread(regions: Regions, weight: Array, about: Array) -> Array:
    """Return the mean square distance of weighted regions from a place, shape (2, 2) [m^2].

    A region counts with its centre and, as a square of its area would, with a twelfth of it.
    """
    share = weight / weight.sum()
    offset = regions.axes - about[:, None]
    within = float(share @ regions.areas) / 12
    covariance: Array = (offset * share) @ offset.T + within * np.eye(2)
    return covariance


#: Points nearer to a line than this part of the room's extent lie on it. Chosen by judgement: above
#: the rounding of doubles (1e-16), far below any region.
TOLERANCE = 1e-9
#: Rows compared at once where regions are compared with each other. Chosen by judgement: it bounds
#: memory.
ROWS = 512


@dataclass(frozen=True, slots=True, eq=False)
class Regions:
    """The regions of a room.

    Attributes
    ----------
    sensors
        Shape (n, 2) [m].
    first, second
        Shape (n_pairs,), intp: sensors i < j of each pair, in the order of equation (5.4),
        l = (j - 2)(j - 1) / 2 + i counted from one.
    signs
        Shape (q, n_pairs), int8: sign of d_i - d_j in each region, equation (5.4); 0 for sensors at
        one place, which no source tells apart.
    centres
        Shape (q, 2): barycentres [m].
    areas
        Shape (q,) [m^2].
    neighbours
        Shape (m, 2), intp: regions with a common edge.
    shapes
        Shape (q,): polygons [m], of several parts where walls cut a region.
    determined
        Shape (n_pairs,), bool: pairs whose sign tells regions apart.
    across
        The signs as each step is compared with them, shape (n_pairs, q), float32: their sums are
        whole numbers, which that holds, in half the memory.
    axes
        x and y of the centres, each in one piece, shape (2, q) [m].
    """

    sensors: Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    signs: NDArray[np.int8]
    centres: Array
    areas: Array
    neighbours: NDArray[np.intp]
    shapes: NDArray[np.object_]
    determined: NDArray[np.bool_] = field(init=False)
    across: NDArray[np.float32] = field(init=False)
    axes: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "determined", (self.signs != 0).any(axis=0))
        object.__setattr__(self, "across", self.signs.T.astype(np.float32))
        object.__setattr__(self, "axes", np.ascontiguousarray(self.centres.T))

    def __len__(self) -> int:
        return len(self.areas)


def pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the sensors i < j of all pairs in the order of equation (5.4), counted from zero."""
    second, first = np.tril_indices(count, -1)
    return first, second


def find_regions(sensors: Array, room: shapely.Polygon) -> Regions:
    """Arrange the lines halfway between all sensors inside a room.

    Parameters
    ----------
    sensors
        Shape (n, 2) [m], in any layout: sensors on one line make strips, and two at one place no
        line between them.
    room
        Convex or not; a region that the room's walls cut in two stays one, as in the thesis.
    """
    sensors = np.asarray(sensors, np.float64).reshape(-1, 2)
    first, second = pairs(len(sensors))
    low, high = np.array(room.bounds).reshape(2, 2)
    origin, extent = (low + high) / 2, float(np.max(high - low))
    lines, owner = _lines((sensors - origin) / extent, first, second)
    hull = (shapely.get_coordinates(room.convex_hull)[:-1] - origin) / extent
    shapes = _polygons([part * extent + origin for part in _arranged(hull, lines)])
    if room.area < room.convex_hull.area * (1 - TOLERANCE):
        shapes = shapely.intersection(shapes, room)
        shapes = shapes[shapely.area(shapes) > TOLERANCE * extent**2]
    inside = shapely.get_coordinates(shapely.point_on_surface(shapes))
    apart = np.linalg.norm(inside[:, None] - sensors, axis=2)
    signs = np.sign(apart[:, first] - apart[:, second]).astype(np.int8)
    signs[:, owner < 0] = 0
    return Regions(
        sensors,
        first,
        second,
        signs,
        shapely.get_coordinates(shapely.centroid(shapes)),
        shapely.area(shapes),
        _neighbours(signs, owner, shapes, room, extent),
        shapes,
    )


def borders(regions: Regions, room: shapely.Polygon) -> list[Array]:
    """Return the lines between regions inside a room, each of shape (2, 2) [m]."""
    low, high = np.array(room.bounds).reshape(2, 2)
    origin, extent = (low + high) / 2, float(np.max(high - low))
    lines, _ = _lines((regions.sensors - origin) / extent, regions.first, regions.second)
    normal, along = lines[:, :2], lines[:, [1, 0]] * np.array([-1.0, 1.0])
    foot = normal * lines[:, 2:]
    reach = 2.0 + np.abs(lines[:, 2:])
    ends = np.stack([foot - reach * along, foot + reach * along], axis=1) * extent + origin
    inside = shapely.get_parts(shapely.intersection(shapely.linestrings(ends), room))
    lines_inside = inside[shapely.length(inside) > TOLERANCE * extent]
    return [shapely.get_coordinates(line) for line in lines_inside]


def corners(regions: Regions, row: int) -> list[Array]:
    """Return the closed rings around one region, each of shape (k, 2) [m].

    There is one, unless walls cut the region in several.
    """
    pieces = [piece for piece in shapely.get_parts(regions.shapes[row]) if piece.area > 0]
    return [shapely.get_coordinates(piece.exterior) for piece in pieces]


def _lines(
    sensors: Array, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp]]:
    """Return the distinct lines (a, b, c) with ax + by = c, and the line of each pair or -1."""
    across = sensors[second] - sensors[first]
    length = np.hypot(*across.T)
    apart = length > TOLERANCE
    normal = across / np.where(apart, length, 1.0)[:, None]
    # one of the two directions: that of larger x, then of larger y
    reversed_sense = (normal[:, 0] < -TOLERANCE) | (
        (abs(normal[:, 0]) <= TOLERANCE) & (normal[:, 1] < 0)
    )
    normal = np.where(reversed_sense[:, None], -normal, normal)
    offset = np.sum(normal * (sensors[first] + sensors[second]) / 2, axis=1)
    every = np.column_stack([normal, offset])
    equal = (np.abs(every[:, None] - every).max(axis=2, initial=0.0) <= TOLERANCE) & apart
    leader = np.where(apart, equal.argmax(axis=1), -1) if len(every) else np.empty(0, np.intp)
    distinct = np.unique(leader[leader >= 0])
    return every[distinct], np.where(leader >= 0, np.searchsorted(distinct, leader), -1)


def _arranged(hull: Array, lines: Array) -> list[Array]:
    """Return the convex parts that lines cut a convex polygon into."""
    parts = [hull]
    for a, b, c in lines:
        counts = np.array([len(part) for part in parts])
        height = np.concatenate(parts) @ np.array([a, b]) - c
        # what lies on the line up to rounding lies on it, or three lines through one point
        # would leave splinters
        height[np.abs(height) <= TOLERANCE] = 0.0
        starts = np.cumsum(counts) - counts
        below = np.minimum.reduceat(height, starts) < 0
        above = np.maximum.reduceat(height, starts) > 0
        uncut = [parts[i] for i in np.flatnonzero(~(below & above))]
        for i in np.flatnonzero(below & above):
            uncut += _halves(parts[i], height[starts[i] : starts[i] + counts[i]])
        parts = uncut
    return parts


def _halves(part: Array, height: Array) -> tuple[Array, Array]:
    """Cut a convex polygon where its corners' height changes its sign."""
    above: list[tuple[float, float]] = []
    below: list[tuple[float, float]] = []
    # a few corners: as plain numbers they are cut faster than as an array
    points, heights = part.tolist(), height.tolist()
    following = zip(points[1:] + points[:1], heights[1:] + heights[:1], strict=True)
    for (x, y), h, ((next_x, next_y), next_h) in zip(points, heights, following, strict=True):
        if h >= 0:
            above.append((x, y))
        if h <= 0:
            below.append((x, y))
        if h * next_h < 0:
            share = h / (h - next_h)
            between = (x + share * (next_x - x), y + share * (next_y - y))
            above.append(between)
            below.append(between)
    return np.array(above), np.array(below)


def _polygons(parts: list[Array]) -> NDArray[np.object_]:
    """Return corners as polygons."""
    closed = [np.vstack([part, part[:1]]) for part in parts]
    ring = np.repeat(np.arange(len(closed)), [len(part) for part in closed])
    return np.asarray(shapely.polygons(shapely.linearrings(np.concatenate(closed), indices=ring)))


def _neighbours(
    signs: NDArray[np.int8],
    owner: NDArray[np.intp],
    shapes: NDArray[np.object_],
    room: shapely.Polygon,
    extent: float,
) -> NDArray[np.intp]:
    """Return which regions have a common edge.

    Two parts of an arrangement of lines have one just where they lie on the same side of all lines
    but one; inside a room that is not convex a wall may still part them.
    """
    sides = signs[:, np.unique(owner, return_index=True)[1]][:, np.unique(owner) >= 0]
    value = sides.astype(np.float32)
    met = [
        np.argwhere(value[i : i + ROWS] @ value.T == sides.shape[1] - 2) + np.array([i, 0])
        for i in range(0, len(value), ROWS)
    ]
    pairs = np.concatenate([np.empty((0, 2), np.intp), *met])
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    if not sides.shape[1] or room.area >= room.convex_hull.area * (1 - TOLERANCE):
        return pairs if sides.shape[1] else np.empty((0, 2), np.intp)
    reach = 1e-6 * extent
    common = shapely.intersection(shapely.buffer(shapes[pairs[:, 0]], reach), shapes[pairs[:, 1]])
    # an edge leaves its length times the reach, a corner only a square of the reach
    edged: NDArray[np.intp] = pairs[shapely.area(common) > 10 * reach**2]
    return edged


def chance_wrong(
    times_s: Array, first: NDArray[np.intp], second: NDArray[np.intp], sigma_s: float
) -> Array:
    """Return the chance of each sign of a time difference to be measured wrong, (5.26) corrected.

    Parameters
    ----------
    times_s
        Shape (..., n): true arrivals [s].
    first, second
        Shape (n_pairs,): sensors of each pair.
    sigma_s
        Standard deviation of a difference [s]: sqrt 2 times that of an arrival.

    Returns
    -------
    Shape (..., n_pairs), at most 0.5.
    """
    from scipy.special import ndtr

    chance: Array = ndtr(-np.abs(times_s[..., first] - times_s[..., second]) / sigma_s)
    return chance


def likeliest(regions: Regions, times_s: Array, theta_s: float, sigma_s: float) -> LocationEstimate:
    """Return the mean of all regions, weighted by area and likelihood of the signs.

    Parameters
    ----------
    regions
        Of the room.
    times_s
        Shape (n,): arrivals [s]; NaN where a sensor has none.
    theta_s
        Time scale of the velocity law (4.25) [s].
    sigma_s
        Standard deviation of an arrival [s].

    Returns
    -------
    The place; its residual is the part of the signs that the likeliest region contradicts.
    """
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return no_location(picks)
    signs, compared = measured_signs(regions, times_s)
    right = _chance_right(regions, theta_s, sigma_s)
    agree = regions.signs * signs
    logs = np.where(agree > 0, np.log(right), np.log1p(-right)) * np.abs(agree)
    level = logs.sum(axis=1) * 2 / picks
    weight = regions.areas * np.exp(level - level.max())
    x, y = weight @ regions.centres / weight.sum()
    wrong = distances(regions, signs, compared)[int(np.argmax(level))]
    residual = float(wrong) / max(int(compared.sum()), 1)
    about = np.array([x, y])
    return LocationEstimate(float(x), float(y), spread(regions, weight, about), residual, picks)


def _chance_right(regions: Regions, theta_s: float, sigma_s: float) -> Array:
    """Return the chance of each sign to be measured right, shape (q, n_pairs); at most 1 - 1e-3."""
    apart = np.linalg.norm(regions.centres[:, None] - regions.sensors, axis=2)
    times = arrivals(apart, theta_s)
    wrong = chance_wrong(times, regions.first, regions.second, np.sqrt(2) * sigma_s)
    return 1 - np.maximum(wrong, 1e-3)
