"""A layout of sensors as the analysis takes it, and the lattice of places it is tried at."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..errors import PipelineError
from ..localizers.arrival_fit import distances
from ..localizers.location import LEAST_PICKS
from ..localizers.methods import THETA_S
from ..localizers.outline import outline_of
from ..physics.perceived import arrivals, front_arrival_s
from ..simulate.plate import Plate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    Array = NDArray[np.float64]

#: Sensors nearer to one line than this part of their extent lie on it; likewise at one place.
TOLERANCE = 1e-6
#: The remark on sensors that cannot tell the two sides of their line apart.
MIRRORED = "sensors on one line: a place and its mirror image beyond the line are alike"


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Sensors in a room, and how well they tell times.

    Attributes
    ----------
    name
        File it comes from.
    sensors
        Names of the sensors.
    streams
        Which random numbers each sensor draws: they stay with it when others come or go.
    positions
        Shape (n, 2) [m].
    outline
        Shape (k, 2): corners of the room [m].
    theta_s
        Time scale of the velocity law (4.25) [s].
    thickness_m
        Of the floor [m]; None stands for the plate constant of the thesis's, a = 183 m^2/s.
    sigma_s
        Standard deviation of an arrival [s].
    """

    name: str
    sensors: tuple[str, ...]
    streams: tuple[int, ...]
    positions: Array
    outline: Array
    theta_s: float
    thickness_m: float | None
    sigma_s: float

    @property
    def room(self) -> shapely.Polygon:
        """The area that is looked at."""
        return outline_of(self.positions, self.outline)

    def arrivals(self, places: Array) -> Array:
        """Return when waves from places, shape (m, 2), arrive, shape (m, n) [s].

        By (4.24) as printed, with 8 a^2, as the thesis simulates them.
        """
        apart = distances(places, self.positions)
        if self.thickness_m is None:
            return arrivals(apart, self.theta_s)
        return front_arrival_s(Plate(thickness_m=self.thickness_m, loss_s=self.theta_s), apart)

    def without(self, index: int) -> Layout:
        """Return the layout that lacks a sensor."""
        kept = [i for i in range(len(self.sensors)) if i != index]
        return replace(
            self,
            sensors=tuple(self.sensors[i] for i in kept),
            streams=tuple(self.streams[i] for i in kept),
            positions=self.positions[kept],
        )

    def plus(self, place: Array) -> Layout:
        """Return the layout with one sensor more, at a place of shape (2,)."""
        return replace(
            self,
            sensors=(*self.sensors, "new"),
            streams=(*self.streams, max(self.streams) + 1),
            positions=np.vstack([self.positions, place]),
        )


def layout_of(
    geometry: Geometry, name: str, sigma_s: float, theta_s: float | None = None
) -> tuple[Layout, tuple[str, ...]]:
    """Return the layout of a geometry, and remarks on what was assumed or is degenerate.

    Parameters
    ----------
    geometry
        Sensors, outline and medium.
    name
        File it comes from, for errors.
    sigma_s
        Standard deviation of an arrival [s].
    theta_s
        Instead of the medium's [s].

    Raises
    ------
    PipelineError
        Where fewer than three sensors stand at different places, the outline has no area, or the
        unit of length is unknown.
    """
    every = np.array([(s.x, s.y) for s in geometry.sensors], np.float64).reshape(-1, 2)
    _check(geometry, every, name)
    kept, remarks = _apart(every, [s.name for s in geometry.sensors])
    if len(kept) < LEAST_PICKS:
        raise PipelineError(
            f"{name}: sensor: expected at least {LEAST_PICKS} at different places, "
            f"found {len(kept)}"
        )
    positions = every[kept]
    room = _room(positions, geometry.outline, name)
    if not geometry.outline:
        remarks.append(
            "no outline: the sensors' rectangle, widened by a tenth, stands for the room"
        )
    if not (theta_s or geometry.medium.theta_s):
        remarks.append(f"no theta_s in the medium: {THETA_S:g} s assumed")
    found = Layout(
        name,
        tuple(geometry.sensors[i].name for i in kept),
        tuple(range(len(kept))),
        positions,
        shapely.get_coordinates(room.exterior)[:-1],
        theta_s or geometry.medium.theta_s or THETA_S,
        geometry.medium.thickness_m,
        sigma_s,
    )
    outside = ~shapely.intersects_xy(room, *positions.T)
    if outside.any():
        remarks.append("outside the outline: " + ", ".join(np.array(found.sensors)[outside]))
    return found, (*remarks, *_collinear(positions, room))


def _check(geometry: Geometry, places: Array, name: str) -> None:
    """Raise PipelineError where a number of the geometry is none that a place or floor can have."""
    if geometry.unit != "m":
        raise PipelineError(
            f"{name}: unit: expected a known unit of length, found {geometry.unit!r}: how long "
            f"waves take needs metres"
        )
    if not np.isfinite(places).all():
        raise PipelineError(f"{name}: sensor: expected finite places, found others")
    for key in ("theta_s", "thickness_m"):
        value = getattr(geometry.medium, key)
        if value is not None and not 0 < value < np.inf:
            raise PipelineError(f"{name}: medium: {key}: expected a positive number, found {value}")


def _apart(places: Array, names: list[str]) -> tuple[list[int], list[str]]:
    """Return which sensors stand at places of their own, and who shares one."""
    extent = float(np.ptp(places, axis=0).max(initial=0.0)) if len(places) else 0.0
    kept: list[int] = []
    remarks = []
    for i, place in enumerate(places):
        near = [j for j in kept if np.hypot(*(places[j] - place)) <= TOLERANCE * extent]
        if near:
            remarks.append(f"{names[near[0]]} and {names[i]} stand at one place and count once")
        else:
            kept.append(i)
    return kept, remarks


def _room(positions: Array, outline: tuple[tuple[float, float], ...], name: str) -> shapely.Polygon:
    try:
        return outline_of(positions, np.array(outline, np.float64) if outline else None)
    except PipelineError as error:
        raise PipelineError(f"{name}: {str(error).removeprefix('geometry: ')}") from error


def _collinear(positions: Array, room: shapely.Polygon) -> list[str]:
    """Return the remark that sensors on one line cannot tell its two sides apart."""
    middle = positions.mean(axis=0)
    _, size, axes = np.linalg.svd(positions - middle)
    if size[1] > TOLERANCE * size[0]:
        return []
    side = (shapely.get_coordinates(room) - middle) @ axes[1]
    if min(side.max(), -side.min()) <= TOLERANCE * size[0]:
        return ["sensors on one line, along a wall: none stands beside it"]
    return [MIRRORED]


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Places on a lattice inside a room, each in the middle of its cell.

    Attributes
    ----------
    x, y
        Shape (nx,), (ny,): columns and rows [m].
    inside
        Shape (ny, nx): which cells' middles lie in the room.
    """

    x: Array
    y: Array
    inside: NDArray[np.bool_]

    @property
    def nodes(self) -> Array:
        """Shape (m, 2): the places inside, row by row [m]."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)[self.inside]

    @property
    def cell(self) -> tuple[float, float]:
        """Width and height of a cell [m]."""
        low, high = self.bounds
        return (high[0] - low[0]) / len(self.x), (high[1] - low[1]) / len(self.y)

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lower left and upper right corner of all cells [m]."""
        half = [(a[-1] - a[0]) / max(len(a) - 1, 1) / 2 for a in (self.x, self.y)]
        wide = max(half)
        half = [h or wide for h in half]
        return (
            (float(self.x[0] - half[0]), float(self.y[0] - half[1])),
            (float(self.x[-1] + half[0]), float(self.y[-1] + half[1])),
        )

    def image(self, values: Array) -> Array:
        """Return values of the nodes, shape (m,), as rows of cells, NaN outside, (ny, nx)."""
        cells = np.full(self.inside.shape, np.nan)
        cells[self.inside] = values
        return cells

    def borders(self, values: NDArray[np.intp]) -> list[Array]:
        """Return the lines between cells of different values, shape (2, 2) each [m].

        Parameters
        ----------
        values
            Shape (m,), of the nodes, from 0.
        """
        cells = np.full(self.inside.shape, -1)
        cells[self.inside] = values
        (left, bottom), _ = self.bounds
        corner, (wide, high) = np.array([left, bottom]), self.cell
        row, column = np.nonzero(cells[:, 1:] != cells[:, :-1])
        upright = corner + np.stack([wide * (column + 1), high * row], axis=1)
        row, column = np.nonzero(cells[1:] != cells[:-1])
        level = corner + np.stack([wide * column, high * (row + 1)], axis=1)
        return [
            *np.stack([upright, upright + np.array([0.0, high])], axis=1),
            *np.stack([level, level + np.array([wide, 0.0])], axis=1),
        ]


def grid_of(room: shapely.Polygon, count: int) -> Grid:
    """Return the lattice with ``count`` cells along the longer side of a room."""
    low, high = np.array(room.bounds).reshape(2, 2)
    sides = high - low
    counts = np.maximum(1, np.rint(sides / (sides.max() / count))).astype(int)
    x, y = (a + w * (np.arange(n) + 0.5) / n for a, w, n in zip(low, sides, counts, strict=True))
    return Grid(x, y, shapely.intersects_xy(room, *np.meshgrid(x, y)))
