"""Plateaus: which of many equal settings to take, and which of all are not beaten by any."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .grid import Grid


def middle(grid: Grid, equal: NDArray[np.bool_]) -> int:
    """Return the setting in the middle of those that are equally good.

    A setting whose neighbours do as well will not fall over on the next recording. In a full grid
    that is the deepest one of the largest connected set, where the grid's edge counts as an end;
    of random settings the one furthest from all others.

    Parameters
    ----------
    grid
        The settings.
    equal
        Which of them to choose from, shape (n,); at least one.
    """
    chosen = np.flatnonzero(equal)
    if len(chosen) == 1:
        return int(chosen[0])
    if grid.shape is not None:
        return _deepest(equal.reshape(grid.shape))
    return _furthest(grid.places(), equal)


def _deepest(equal: NDArray[np.bool_]) -> int:
    from scipy import ndimage

    along = [axis for axis, count in enumerate(equal.shape) if count > 1]
    inside = equal.squeeze()
    parts, count = ndimage.label(inside)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    largest = parts == 1 + int(np.argmax(sizes[1:]))
    depth = ndimage.distance_transform_cdt(np.pad(largest, 1), "chessboard")
    depth = depth[(slice(1, -1),) * len(along)]
    places = np.argwhere(largest & (depth == depth[largest].max()))
    centre = np.argwhere(largest).mean(axis=0)
    best = places[int(np.argmin(((places - centre) ** 2).sum(axis=1)))]
    return int(np.ravel_multi_index(tuple(best), inside.shape))


def _furthest(places: NDArray[np.float64], equal: NDArray[np.bool_]) -> int:
    from scipy.spatial import cKDTree

    chosen = np.flatnonzero(equal)
    if equal.all():
        return int(np.argmin(((places - places.mean(axis=0)) ** 2).sum(axis=1)))
    distance, _ = cKDTree(places[~equal]).query(places[chosen])
    return int(chosen[int(np.argmax(distance))])


def pareto_front(missed: NDArray[np.int64], false: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the pairs (missed, false) that no other pair beats, the fewest missed first.

    One beats another where it is better in one of the two and not worse in the other.
    """
    front: list[tuple[int, int]] = []
    for row in np.lexsort([false, missed]):
        pair = int(missed[row]), int(false[row])
        if not front or pair[1] < front[-1][1]:
            front.append(pair)
    return front
