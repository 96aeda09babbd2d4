"""What is known of a vehicle in a cycle: the powers of stations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..gates import Candidates

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Stations no further off the line through them than this part of their length are in a row. At a
#: distance d beside the row the power at one that is e off differs from that of the mirror image by
#: 3 e / d (n = 1.5), less than the third by which a power errs where e < d / 9; d is taken to be a
#: quarter of the length.
_ROW = 1 / 36


def line_through(places: Array) -> tuple[Array, Array]:
    """Return the middle of places, shape (n, 2), and the direction they lie along, (2,) each."""
    centre = places.mean(axis=0)
    along = np.linalg.svd(places - centre)[2][0]
    return np.asarray(centre), np.asarray(along)


def row_doubt(names: Sequence[str], places: Array) -> str:
    """Return what to doubt of places by powers of stations in a row; empty where they are not."""
    centre, along = line_through(places)
    off = places - centre
    across = off @ np.array([-along[1], along[0]])
    if np.abs(across).max() > _ROW * np.ptp(off @ along):
        return ""
    return f"{', '.join(names)} stand in a row: which side of it a place is on, powers do not tell"


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """One working cycle at all stations.

    Attributes
    ----------
    time_ns
        Its middle.
    powers, floors, floor_sigmas
        Shape (n,): sums over the channels of a station, noise included, of the noise, and the
        standard deviation of that [unit^2]; NaN where nothing was recorded.
    present
        Shape (n,): whether any channel of the station hears a vehicle.
    """

    time_ns: int
    powers: Array
    floors: Array
    floor_sigmas: Array
    present: NDArray[np.bool_]


def candidates_of(rows: list[tuple[int, int, list[float]]], columns: int) -> Candidates:
    """Return rows of (time [ns], channel, values) as candidates, in the order of the first two."""
    if not rows:
        return Candidates.empty(columns)
    return Candidates(
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int32),
        np.array([row[2] for row in rows], np.float32),
    )
