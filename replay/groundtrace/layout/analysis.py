"""What a layout of sensors can do: errors over a lattice of locations, ambiguity, advice.

The number of time differences with a wrong sign is computed for each location. Source: the thesis
on footstep localisation, section 5.3.2; (5.26) is corrected: it lacks the absolute value of the
time difference. The number of wrong signs follows the Poisson-binomial law, of which the thesis's
Poisson law is the limit; its mean is the same lambda.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ..errors import PipelineError
from ..localizers import arrival_order, tdoa
from ..localizers.arrival_order import chance_wrong, pairs
from ..localizers.base import outline_of
from ..localizers.methods import THETA_S
from ..localizers.tdoa import distances
from ..localizers.wave_physics import Plate, arrivals, front_arrival_s
from ..pipeline.stage import LEAST_PICKS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from ..localizers.arrival_order import Regions

    Array = NDArray[np.float64]

#: Sensors nearer to one line than this part of their extent lie on it; likewise at one place.
#: Chosen by judgement: places are given in millimetres at best.
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
        retained = [i for i in range(len(self.sensors)) if i != index]
        return replace(
            self,
            sensors=tuple(self.sensors[i] for i in retained),
            streams=tuple(self.streams[i] for i in retained),
            positions=self.positions[retained],
        )

    def plus(self, position: Array) -> Layout:
        """Return the layout with one sensor more, at a place of shape (2,)."""
        return replace(
            self,
            sensors=(*self.sensors, "new"),
            streams=(*self.streams, max(self.streams) + 1),
            positions=np.vstack([self.positions, position]),
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
    retained, remarks = _apart(every, [s.name for s in geometry.sensors])
    if len(retained) < LEAST_PICKS:
        raise PipelineError(
            f"{name}: sensor: expected at least {LEAST_PICKS} at different places, "
            f"found {len(retained)}"
        )
    positions = every[retained]
    room = _room(positions, geometry.outline, name)
    if not geometry.outline:
        remarks.append(
            "no outline: the sensors' rectangle, widened by a tenth, stands for the room"
        )
    if not (theta_s or geometry.medium.theta_s):
        remarks.append(f"no theta_s in the medium: {THETA_S:g} s assumed")
    layout = Layout(
        name,
        tuple(geometry.sensors[i].name for i in retained),
        tuple(range(len(retained))),
        positions,
        shapely.get_coordinates(room.exterior)[:-1],
        theta_s or geometry.medium.theta_s or THETA_S,
        geometry.medium.thickness_m,
        sigma_s,
    )
    outside = ~shapely.intersects_xy(room, *positions.T)
    if outside.any():
        remarks.append("outside the outline: " + ", ".join(np.array(layout.sensors)[outside]))
    return layout, (*remarks, *_collinear(positions, room))


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
    retained: list[int] = []
    remarks = []
    for i, position in enumerate(places):
        near = [j for j in retained if np.hypot(*(places[j] - position)) <= TOLERANCE * extent]
        if near:
            remarks.append(f"{names[near[0]]} and {names[i]} stand at one place and count once")
        else:
            retained.append(i)
    return retained, remarks


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


#: Layouts are compared on half as fine a lattice with half the draws, but at least this many; and
#: candidate places on one this coarse with this many draws. Chosen by judgement: they bound the
#: cost of a proposal.
TRIAL_LATTICE, TRIAL_DRAWS, SCREEN_LATTICE, SCREEN_DRAWS = 9, 16, 7, 12
#: Draws at the worst place for the law of wrong signs; cells along the room where it is drawn.
#: Chosen by judgement: a probability is then told to 0.4 %.
SIGN_DRAWS, RASTER = 20_000, 160
#: Cells of the map of wrong signs for each of the error maps: odd, so that middles stay. Source:
#: definition.
FINER = 3


@dataclass(frozen=True, slots=True)
class Settings:
    """How thoroughly to analyse.

    Attributes
    ----------
    lattice
        Cells along the longer side of the room.
    draws
        Random errors at each.
    seed
        Of everything random.
    localizer
        Which one the advice is for: one of :data:`METHODS`.
    """

    lattice: int = 21
    draws: int = 50
    seed: int = 0
    localizer: str = "power-law"

    @property
    def trial(self) -> Trial:
        """How whole layouts are compared."""
        lattice = min(self.lattice, max(TRIAL_LATTICE, self.lattice // 2))
        return Trial(lattice, min(self.draws, max(TRIAL_DRAWS, self.draws // 2)), self.seed)

    @property
    def screen(self) -> Trial:
        """How candidate places are compared at first."""
        return Trial(min(self.lattice, SCREEN_LATTICE), min(self.draws, SCREEN_DRAWS), self.seed)


@dataclass(frozen=True, slots=True, eq=False)
class RoomAnalysis:
    """What is known of a layout before anyone records.

    Attributes
    ----------
    layout, remarks
        Sensors and room, and what was assumed of them.
    settings
        How thoroughly it was analysed.
    grid
        Where errors were computed.
    errors
        Of each localizer.
    sign_grid, signs
        Wrong signs, and where they were computed.
    raster, ambiguity
        Regions, and places to draw them at.
    contributions
        By how much the mean error rises without each sensor, by localizer [m]; empty where no
        sensor can be spared.
    advice
        Changes: one sensor more, and one moved.
    """

    layout: Layout
    remarks: tuple[str, ...]
    settings: Settings
    grid: Grid
    errors: tuple[ErrorMap, ...]
    sign_grid: Grid
    signs: SignErrors
    raster: Grid
    ambiguity: Ambiguity
    contributions: tuple[dict[str, float], ...]
    advice: tuple[Advice, ...]

    @property
    def best(self) -> ErrorMap:
        """Errors of the localizer that is best on average."""
        return min(self.errors, key=lambda errors: errors.mean_m)

    def worst(self, errors: ErrorMap) -> tuple[float, float]:
        """Return where a localizer is worst [m]."""
        x, y = self.grid.nodes[errors.rmse_m.argmax()]
        return float(x), float(y)


def analyze_room(
    layout: Layout,
    remarks: tuple[str, ...] = (),
    settings: Settings | None = None,
    show: Callable[[float], None] = lambda _: None,
) -> RoomAnalysis:
    """Analyse a layout.

    Parameters
    ----------
    layout, remarks
        Of :func:`layout_of`.
    settings
        How thoroughly.
    show
        Called with the part of the work that is done, within [0, 1].
    """
    how = settings or Settings()
    done = _Steps(_work(layout), show)
    room = layout.room
    grid, fine, raster = (grid_of(room, n) for n in (how.lattice, FINER * how.lattice, RASTER))
    errors = []
    for method in METHODS:
        errors.append(error_map(layout, method, grid.nodes, how.draws, how.seed))
        done(MAP_STEPS)
    signs = sign_errors(layout.arrivals(fine.nodes), layout.sigma_s, SIGN_DRAWS, how.seed)
    regions = ambiguity(layout, raster, how.seed)
    before = how.trial.means_m(layout)
    spared = contributions(layout, how.trial, before, lambda: done(SPARED_STEPS))
    least = sorted(range(len(spared)), key=lambda i: spared[i][how.localizer])[:1]
    changes = [
        best_change(layout, moved, how.localizer, how.screen, how.trial, before, lambda: done(1))
        for moved in (None, *least)
    ]
    advice = tuple(a for a in changes if a is not None)
    show(1.0)
    return RoomAnalysis(
        layout, remarks, how, grid, tuple(errors), fine, signs, raster, regions, spared, advice
    )


#: What a map and leaving a sensor out cost, as candidates screened. Chosen by judgement: they pace
#: the progress that is shown.
MAP_STEPS, SPARED_STEPS = 20, 6


def _work(layout: Layout) -> int:
    count = len(layout.sensors)
    return MAP_STEPS * len(METHODS) + SPARED_STEPS * count + 2 * len(candidates(layout))


class _Steps:
    """Counts work that is done."""

    def __init__(self, total: int, show: Callable[[float], None]) -> None:
        self._total, self._show, self._done = total, show, 0

    def __call__(self, steps: int) -> None:
        self._done += steps
        self._show(min(1.0, self._done / self._total))


#: Candidates along the longer side of the room, walls included. Chosen by judgement: they bound the
#: cost; a metre or so apart.
CANDIDATES = 7
#: Candidates nearer to a sensor than this part of their spacing are left out. Source: definition:
#: nearer to the sensor than to another candidate.
APART = 0.5
#: So many of the best candidates are tried again. Chosen by judgement: screening with few draws
#: ranks the best ones roughly.
FINALISTS = 3


@dataclass(frozen=True, slots=True)
class Trial:
    """How thoroughly layouts are compared.

    Attributes
    ----------
    lattice
        Cells along the longer side of the room.
    draws
        Random errors at each.
    seed
        Of them.
    """

    lattice: int
    draws: int
    seed: int

    def mean_m(self, layout: Layout, method: str) -> float:
        """Return the mean error of a localizer over the room [m]."""
        nodes = grid_of(layout.room, self.lattice).nodes
        return error_map(layout, method, nodes, self.draws, self.seed).mean_m

    def means_m(self, layout: Layout) -> dict[str, float]:
        """Return the mean error of each localizer [m]."""
        return {method: self.mean_m(layout, method) for method in METHODS}


@dataclass(frozen=True, slots=True)
class Advice:
    """A change of the layout.

    Attributes
    ----------
    moved
        Index of the sensor that is moved; None where one is added.
    position
        Where to [m].
    method
        The localizer that the position was chosen for.
    before_m, after_m
        Mean error of each localizer without and with the change [m].
    tried
        How many changes were tried.
    """

    moved: int | None
    position: tuple[float, float]
    method: str
    before_m: dict[str, float]
    after_m: dict[str, float]
    tried: int

    @property
    def gain_m(self) -> float:
        """By how much the mean error falls [m]; negative where the best of all tried is worse."""
        return self.before_m[self.method] - self.after_m[self.method]


def contributions(
    layout: Layout, trial: Trial, before_m: dict[str, float], done: Callable[[], None]
) -> tuple[dict[str, float], ...]:
    """Return by how much the mean error rises without each sensor, by localizer [m].

    Nothing where there are but three sensors: without one of them none locates.
    """
    if len(layout.sensors) <= LEAST_PICKS:
        return ()
    rises = []
    for index in range(len(layout.sensors)):
        after = trial.means_m(layout.without(index))
        rises.append({method: after[method] - before_m[method] for method in METHODS})
        done()
    return tuple(rises)


def candidates(layout: Layout) -> Array:
    """Return where a sensor may go: a lattice over the room and its walls, shape (c, 2) [m]."""
    room = layout.room
    low, high = np.array(room.bounds).reshape(2, 2)
    spacing = float((high - low).max()) / (CANDIDATES - 1)
    counts = np.maximum(2, np.rint((high - low) / spacing).astype(int) + 1)
    x, y = (np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = places[shapely.intersects_xy(room, *places.T)]
    apart = np.linalg.norm(places[:, None] - layout.positions, axis=2).min(axis=1)
    free: Array = places[apart >= APART * spacing]
    return free


def best_change(
    layout: Layout,
    moved: int | None,
    method: str,
    screen: Trial,
    trial: Trial,
    before_m: dict[str, float],
    done: Callable[[], None],
) -> Advice | None:
    """Return the best place for one more sensor, or for one that is moved.

    Parameters
    ----------
    layout
        As it is.
    moved
        Index of the sensor to move; None to add one.
    method
        The localizer to choose the place for.
    screen, trial
        How all places are compared, and then the best of them.
    before_m
        Mean errors of the layout as it is, of ``trial`` [m].
    done
        Called after each place.

    Returns
    -------
    The best; None where there is no free place.
    """
    rest = layout if moved is None else layout.without(moved)
    screened = []
    places = candidates(layout)
    for position in places:
        screened.append(screen.mean_m(rest.plus(position), method))
        done()
    finalists = [rest.plus(places[i]) for i in np.argsort(screened, kind="stable")[:FINALISTS]]
    if not finalists:
        return None
    means = [trial.mean_m(changed, method) for changed in finalists]
    best = finalists[int(np.argmin(means))]
    x, y = (float(v) for v in best.positions[-1])
    return Advice(moved, (x, y), method, before_m, trial.means_m(best), len(places))


#: A region is tiny below this part of the median area. Chosen by judgement: a region of 0.1 m2
#: where 1 m2 is usual.
TINY = 0.1
#: A rival that differs in so few signs is near; one is far at so many typical regions' sides.
#: Chosen by judgement: two wrong signs of 36 are common at 0.5 ms.
FEW_SIGNS, FAR = 2, 3.0
#: A region is confused where more than this part of impacts is taken to be beyond its neighbours.
#: Source: definition, more than half.
CONFUSED = 0.5
#: Draws in each region: at most so many, and so few that all regions together cost this much.
#: Chosen by judgement: a share is told to 4 %; some seconds.
MOST_DRAWS, LEAST_DRAWS, BUDGET = 200, 10, 40_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Ambiguity:
    """How easily regions are taken for others.

    Attributes
    ----------
    regions
        The q regions.
    sources
        Shape (q, 2): a place inside each [m].
    rival
        Shape (q,), intp: the region, not a neighbour, that differs in the fewest signs, and of
        several such the farthest; -1 where all others are neighbours.
    rival_signs
        Shape (q,): in how many signs it differs; inf where there is none.
    rival_m
        Shape (q,): how far it is [m]; 0 where there is none.
    confusion
        Shape (q,): part of impacts inside whose best regions are neither itself nor a neighbour;
        NaN where there are too many regions to try each.
    """

    regions: Regions
    sources: Array
    rival: NDArray[np.intp]
    rival_signs: Array
    rival_m: Array
    confusion: Array

    @property
    def tiny(self) -> NDArray[np.bool_]:
        """Shape (q,): whether there is next to nothing of it."""
        small: NDArray[np.bool_] = self.regions.areas < TINY * np.median(self.regions.areas)
        return small

    @property
    def doubled(self) -> NDArray[np.bool_]:
        """Shape (q,): whether a place far away differs in very few signs."""
        side = float(np.sqrt(np.median(self.regions.areas)))
        return (self.rival_signs <= FEW_SIGNS) & (self.rival_m > FAR * side)

    @property
    def confused(self) -> NDArray[np.bool_]:
        """Shape (q,): whether it is mostly taken for a region beyond its neighbours."""
        return self.confusion > CONFUSED

    def reasons(self, region: int) -> tuple[str, ...]:
        """Return why a region is ambiguous; nothing where it is not."""
        kinds = {"tiny": self.tiny, "double": self.doubled, "confused": self.confused}
        return tuple(name for name, which in kinds.items() if which[region])


def ambiguity(layout: Layout, raster: Grid, seed: int) -> Ambiguity:
    """Return how easily the regions of a layout are taken for others.

    Parameters
    ----------
    layout
        Sensors, room, and the errors of arrivals.
    raster
        Places of which one inside each region is looked for.
    seed
        Of the errors.
    """
    regions = arrival_order.known_regions(layout.positions, layout.outline)
    sources = _inside(regions, raster)
    near = _near(regions)
    rival, signs, apart = _rivals(regions, near)
    confusion = _confusion(layout, regions, sources, near, seed)
    return Ambiguity(regions, sources, rival, signs, apart, confusion)


def region_at(regions: Regions, places: Array) -> NDArray[np.intp]:
    """Return in which region each place lies, shape (m,) for (m, 2)."""
    apart = np.linalg.norm(places[:, None] - regions.sensors, axis=2)
    signs = np.sign(apart[:, regions.first] - apart[:, regions.second])
    agree = signs.astype(np.float32) @ regions.signs.T.astype(np.float32)
    indices: NDArray[np.intp] = agree.argmax(axis=1)
    return indices


def _inside(regions: Regions, raster: Grid) -> Array:
    """Return a place in each region: its centre, or where that lies outside the nearest to it."""
    sources, places = regions.centres.copy(), raster.nodes
    lost = np.flatnonzero(region_at(regions, sources) != np.arange(len(regions)))
    if len(lost):
        home = region_at(regions, places)
        for region in lost:
            members = places[home == region]
            if len(members):
                far = np.linalg.norm(members - regions.centres[region], axis=1)
                sources[region] = members[far.argmin()]
    return sources


def _near(regions: Regions) -> NDArray[np.bool_]:
    """Return which regions are the same or neighbours, shape (q, q)."""
    near = np.eye(len(regions), dtype=bool)
    one, other = regions.neighbours.T
    near[one, other] = near[other, one] = True
    return near


def _rivals(regions: Regions, near: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array, Array]:
    """Return each region's rival, in how many signs it differs, and how far it is."""
    signs = regions.signs.astype(np.float64)
    compared = (regions.signs != 0).any(axis=0)
    rival, fewest, far = [], [], []
    for index, sign in enumerate(signs):
        differ = np.where(near[index], np.inf, arrival_order.distances(regions, sign, compared))
        apart = np.linalg.norm(regions.centres - regions.centres[index], axis=1)
        least = differ.min()
        candidates = np.where(differ == least, apart, -1.0)
        has_rival = np.isfinite(least)
        rival.append(int(candidates.argmax()) if has_rival else -1)
        fewest.append(float(least))
        far.append(float(candidates.max()) if has_rival else 0.0)
    return np.array(rival, np.intp), np.array(fewest), np.array(far)


def _confusion(
    layout: Layout, regions: Regions, sources: Array, near: NDArray[np.bool_], seed: int
) -> Array:
    draws = min(MOST_DRAWS, BUDGET // len(regions) ** 2)
    if draws < LEAST_DRAWS:
        return np.full(len(regions), np.nan)
    noise = np.random.default_rng(seed).standard_normal((draws, len(layout.sensors)))
    confusion = np.empty(len(regions))
    for index, clean in enumerate(layout.arrivals(sources)):
        signs, compared = arrival_order.measured_signs(regions, clean + layout.sigma_s * noise)
        wrong = arrival_order.distances(regions, signs, compared)
        best = wrong == wrong.min(axis=1, keepdims=True)
        confusion[index] = 1 - (best & near[index]).any(axis=1).mean()
    return confusion


#: This part of all steps has at most :attr:`SignErrors.most` wrong signs. Chosen by judgement: the
#: usual one.
USUAL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class SignErrors:
    """Wrong signs over a room.

    Attributes
    ----------
    pairs
        How many signs there are.
    independent
        Shape (m,): mean number where every difference errs on its own by sigma, as the thesis
        simulates it.
    physical
        Shape (m,): mean number where arrivals err by sigma, and differences by sqrt 2 times that.
    variance, most
        Of the number at the worst place of ``physical``: variance, and the number that 95 % of
        steps do not exceed, from draws, since differences that share a sensor hang together.
    variance_independent, most_independent
        The same of the Poisson-binomial law at the worst place of ``independent``.
    """

    pairs: int
    independent: Array
    physical: Array
    variance: float
    most: int
    variance_independent: float
    most_independent: int


def mean_wrong(times_s: Array, sigma_s: float) -> Array:
    """Return lambda (5.25), the mean number of wrong signs.

    Parameters
    ----------
    times_s
        Shape (..., n): true arrivals [s].
    sigma_s
        Standard deviation of a difference [s].
    """
    wrong: Array = chance_wrong(times_s, *pairs(times_s.shape[-1]), sigma_s).sum(axis=-1)
    return wrong


def poisson_binomial(chances: Array) -> Array:
    """Return the law of the number of events of given chances, shape (n,): shape (n + 1,)."""
    law = np.ones(1)
    for chance in chances:
        law = np.convolve(law, (1 - chance, chance))
    return law


def sign_errors(times_s: Array, sigma_s: float, draws: int, seed: int) -> SignErrors:
    """Return how many signs are wrong.

    Parameters
    ----------
    times_s
        Shape (m, n): true arrivals from each node [s].
    sigma_s
        Standard deviation of an arrival, and of a difference where those are independent [s].
    draws
        Random errors at the worst place.
    seed
        Of them.
    """
    first, second = pairs(times_s.shape[-1])
    independent = mean_wrong(times_s, sigma_s)
    physical = mean_wrong(times_s, np.sqrt(2) * sigma_s)
    chances = chance_wrong(times_s[independent.argmax()], first, second, sigma_s)
    reached = np.cumsum(poisson_binomial(chances)) >= USUAL
    counts = drawn_wrong(times_s[physical.argmax()], sigma_s, draws, seed)
    return SignErrors(
        len(first),
        independent,
        physical,
        float(counts.var()),
        int(np.quantile(counts, USUAL, method="inverted_cdf")),
        float(np.sum(chances * (1 - chances))),
        int(reached.argmax()),
    )


def drawn_wrong(times_s: Array, sigma_s: float, draws: int, seed: int) -> NDArray[np.intp]:
    """Return how many signs are wrong in each of many draws of arrivals, shape (draws,).

    Parameters
    ----------
    times_s
        Shape (n,): true arrivals [s].
    sigma_s
        Standard deviation of an arrival [s].
    draws, seed
        Number and seed of the draws.
    """
    first, second = pairs(len(times_s))
    true = times_s[first] - times_s[second]
    measured = times_s + sigma_s * np.random.default_rng(seed).standard_normal(
        (draws, len(times_s))
    )
    wrong: NDArray[np.intp] = np.sum((measured[:, first] - measured[:, second]) * true <= 0, axis=1)
    # where both arrive at once any sign is wrong half the time
    level = np.flatnonzero(true == 0)
    late = (measured[:, first[level]] > measured[:, second[level]]).sum(axis=1)
    wrong += late - len(level)
    return wrong


#: Errors below this count as small [m]. Chosen by judgement: a step's length and a little.
SMALL_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMap:
    """Errors of one localizer.

    Attributes
    ----------
    method
        Name of the localizer.
    rmse_m
        Shape (m,): root mean square error at each node [m].
    """

    method: str
    rmse_m: Array

    @property
    def mean_m(self) -> float:
        """Mean over the room [m]."""
        return float(self.rmse_m.mean())


def times_of(layout: Layout, nodes: Array, draws: int, seed: int) -> Array:
    """Return arrivals with errors, shape (m, draws, n) [s].

    A sensor's errors are the same in every layout that has it, so that layouts are compared
    without the chance of other errors.
    """
    shape = (len(nodes), draws)
    noise = [np.random.default_rng([seed, k]).standard_normal(shape) for k in layout.streams]
    return layout.arrivals(nodes)[:, None] + layout.sigma_s * np.stack(noise, axis=-1)


def _so_tdoa(layout: Layout, nodes: Array, times_s: Array) -> Array:  # noqa: ARG001
    return arrival_order.places(
        arrival_order.known_regions(layout.positions, layout.outline), times_s
    )


def _hyperbolic(layout: Layout, nodes: Array, times_s: Array) -> Array:
    clean = layout.arrivals(nodes)
    velocity = tdoa.calibrated_velocity(nodes, layout.positions, clean)
    return tdoa.hyperbolic_places(layout.positions, times_s, velocity, layout.outline)


def _power_law(layout: Layout, nodes: Array, times_s: Array) -> Array:  # noqa: ARG001
    return tdoa.power_law_places(layout.positions, times_s, layout.outline, sigma_s=layout.sigma_s)


#: Localizers by name: layout, nodes of controlled impacts, and arrivals (m, n) to places (m, 2).
METHODS: dict[str, Callable[[Layout, Array, Array], Array]] = {
    "so-tdoa": _so_tdoa,
    "hyperbolic": _hyperbolic,
    "power-law": _power_law,
}


def error_map(layout: Layout, method: str, nodes: Array, draws: int, seed: int) -> ErrorMap:
    """Return the root mean square error of a localizer at places.

    Parameters
    ----------
    layout
        Sensors, room, and the errors of arrivals.
    method
        One of :data:`METHODS`. The velocity of ``hyperbolic`` is calibrated by noise-free impacts
        at all nodes; ``power-law`` fits by least squares, as there are no late arrivals.
    nodes
        Shape (m, 2): where impacts are [m].
    draws
        Random errors at each.
    seed
        Of the errors.
    """
    times = times_of(layout, nodes, draws, seed)
    places = METHODS[method](layout, nodes, times.reshape(-1, times.shape[-1]))
    off = places.reshape(len(nodes), draws, 2) - nodes[:, None]
    return ErrorMap(method, np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=1)))
