"""Where stations are along a road."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .api import Site

    Array = NDArray[np.float64]

#: Stations are in a line where they stray from it by less than this part of its length.
_STRAIGHT = 0.1


def along_road(site: Site) -> tuple[Array, Array]:
    """Return how far along the road each station is, and how far from it, shapes (n,) [m].

    Without a road: along the line through the stations, from the first on, and 0.
    """
    if len(site.road) < 2:
        along = _axis(site.places)
        way = (site.places - site.places[0]) @ along
        return way * (1 if way[-1] >= 0 else -1), np.zeros(len(way))
    found = [_projected(place, site.road) for place in site.places]
    return np.array([a for a, _ in found]), np.array([d for _, d in found])


def in_line(site: Site) -> bool:
    """Return whether the stations are in a line along the road, as they are beside one."""
    if len(site.names) < 2:
        return True
    centred = site.places - site.places.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    straight = len(spread) < 2 or spread[1] < _STRAIGHT * spread[0]
    if len(site.road) < 2:
        return bool(straight)
    along, _ = along_road(site)
    length = float(np.linalg.norm(site.places[:, None] - site.places, axis=2).max())
    return bool(straight and np.ptp(along) > 0.7 * length)


def _axis(places: Array) -> Array:
    centred = places - places.mean(axis=0)
    return np.asarray(np.linalg.svd(centred)[2][0])


def _projected(place: Array, road: Array) -> tuple[float, float]:
    """Return the way along the corners of a road to its point nearest to a place; the distance."""
    best, gone = (0.0, float("inf")), 0.0
    for a, b in pairwise(road):
        length = float(np.hypot(*(b - a)))
        part = float(np.clip((place - a) @ (b - a) / length**2, 0, 1)) if length else 0.0
        away = float(np.hypot(*(place - a - part * (b - a))))
        if away < best[1]:
            best = gone + part * length, away
        gone += length
    return best
