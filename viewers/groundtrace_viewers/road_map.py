"""A road on the map: a broad line, with signs that point in its forward direction."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .palette import ROAD, ROAD_SIGN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .timeline import Timeline

#: Between two signs and size of one, as parts of the site's extent; more would hide the road.
APART, SIZE, MOST_SIGNS = 0.2, 0.03, 60
#: A tip that points along x.
TIP = np.array([(-1.0, 0.8), (0.0, 0.0), (-1.0, -0.8)])


def log_road(
    timeline: Timeline, site: str, road: Sequence[tuple[float, float]], extent_m: float
) -> None:
    """Log a road below the entity of a site, beneath all else.

    Parameters
    ----------
    timeline
        Where to.
    site
        Entity of the site.
    road
        Corners [m].
    extent_m
        Of the site.
    """
    import rerun as rr

    line = rr.LineStrips2D([list(road)], colors=[ROAD], radii=-5.0, draw_order=-25.0)
    timeline.static(f"{site}/road", line)
    tips = signs(road, APART * extent_m, SIZE * extent_m)
    if tips:
        drawn = rr.LineStrips2D(tips, colors=[ROAD_SIGN], radii=-0.8, draw_order=-3.0)
        timeline.static(f"{site}/road/forward", drawn)


def signs(
    road: Sequence[tuple[float, float]], apart_m: float, size_m: float
) -> list[NDArray[np.float32]]:
    """Return tips along a road, each of shape (3, 2) [m], the same way apart from one another."""
    corners = np.array(road, np.float64)
    length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    apart_m = max(apart_m, length / MOST_SIGNS)
    tips: list[NDArray[np.float32]] = []
    gone = 0.0
    for start, end in pairwise(corners):
        way = float(np.hypot(*(end - start)))
        if way == 0.0:
            continue
        x, y = (end - start) / way
        turned = size_m * TIP @ np.array([(x, y), (-y, x)])
        first = np.ceil(gone / apart_m) * apart_m
        along = np.arange(first, gone + way, apart_m) - gone
        at = start + np.outer(along, (x, y))
        tips += list((at[:, np.newaxis] + turned).astype(np.float32))
        gone += way
    return tips
