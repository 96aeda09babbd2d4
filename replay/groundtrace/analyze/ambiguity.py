"""Which regions of a room are easily taken for others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..localizers import so_tdoa

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..localizers.regions import Regions
    from .layout import Grid, Layout

    Array = NDArray[np.float64]

#: A region is tiny below this part of the median area.
TINY = 0.1
#: A rival that differs in so few signs is near; one is far at so many typical regions' sides.
FEW_SIGNS, FAR = 2, 3.0
#: A region is confused where more than this part of impacts is taken to be beyond its neighbours.
CONFUSED = 0.5
#: Draws in each region: at most so many, and so few that all regions together cost this much.
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
    regions = so_tdoa.known_regions(layout.positions, layout.outline)
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
    found: NDArray[np.intp] = agree.argmax(axis=1)
    return found


def _inside(regions: Regions, raster: Grid) -> Array:
    """Return a place in each region: its centre, or where that lies outside the nearest to it."""
    sources, places = regions.centres.copy(), raster.nodes
    lost = np.flatnonzero(region_at(regions, sources) != np.arange(len(regions)))
    if len(lost):
        home = region_at(regions, places)
        for region in lost:
            own = places[home == region]
            if len(own):
                far = np.linalg.norm(own - regions.centres[region], axis=1)
                sources[region] = own[far.argmin()]
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
    told = (regions.signs != 0).any(axis=0)
    rival, fewest, far = [], [], []
    for index, sign in enumerate(signs):
        differ = np.where(near[index], np.inf, so_tdoa.distances(regions, sign, told))
        apart = np.linalg.norm(regions.centres - regions.centres[index], axis=1)
        least = differ.min()
        candidates = np.where(differ == least, apart, -1.0)
        found = np.isfinite(least)
        rival.append(int(candidates.argmax()) if found else -1)
        fewest.append(float(least))
        far.append(float(candidates.max()) if found else 0.0)
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
        signs, compared = so_tdoa.measured_signs(regions, clean + layout.sigma_s * noise)
        wrong = so_tdoa.distances(regions, signs, compared)
        best = wrong == wrong.min(axis=1, keepdims=True)
        confusion[index] = 1 - (best & near[index]).any(axis=1).mean()
    return confusion
