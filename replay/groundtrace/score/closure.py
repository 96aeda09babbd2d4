"""What can be said of a track in a frame of its own, as dead reckoning has one.

Such a track begins anywhere and heads anywhere: only how long it is, whether it returns to its
start as the walker did, and its shape can be right or wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .turn import turn_onto

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import TrackPoint

    from .places import Places

#: True places from which on a shape can be compared.
LEAST_PLACES = 3


@dataclass(frozen=True, slots=True)
class ClosureScore:
    """Length, end and shape of one track.

    Attributes
    ----------
    walked_m
        Length of the track between the first and the last true place [m].
    apart_m, true_apart_m
        How far its place at the last true time is from that at the first, and the truth of
        it [m]; where the walker returned to the start the latter is about 0.
    percent
        Difference of the two as a part of the way [%].
    aligned_rmse_m
        Root mean square distance from the true places after the rotation and shift that make it
        least [m], or None with fewer than three true places.
    aligned_end_m
        The distance of the last of them, or None.
    """

    walked_m: float
    apart_m: float
    true_apart_m: float
    percent: float
    aligned_rmse_m: float | None
    aligned_end_m: float | None


def score_closure(truth: Places, points: Sequence[TrackPoint]) -> ClosureScore | None:
    """Score the only track against the only target.

    Returns
    -------
    The score, or None where there are several of either, or no way between true places.
    """
    if len({point.track for point in points}) != 1 or len(truth.names()) != 1:
        return None
    if len(np.unique(truth.time_ns)) < max(2, len(truth)):
        return None
    ordered = sorted(points, key=lambda point: point.time_ns)
    time_ns = np.array([point.time_ns for point in ordered], np.int64)
    places = np.array([(point.x_m, point.y_m) for point in ordered])
    # counted from one time, nanoseconds are exact in floating point
    at = (truth.time_ns - time_ns[0]).astype(np.float64)
    since = (time_ns - time_ns[0]).astype(np.float64)
    found = np.column_stack([np.interp(at, since, column) for column in places.T])
    between = places[(since > at[0]) & (since < at[-1])]
    walked = float(_lengths(np.concatenate([found[:1], between, found[-1:]])).sum())
    if walked == 0:
        return None
    apart, true_apart = (float(np.linalg.norm(xy[-1] - xy[0])) for xy in (found, truth.xy))
    off = aligned_distances(found, truth.xy) if len(truth) >= LEAST_PLACES else None
    return ClosureScore(
        walked_m=walked,
        apart_m=apart,
        true_apart_m=true_apart,
        percent=100 * abs(apart - true_apart) / walked,
        aligned_rmse_m=None if off is None else float(np.sqrt((off**2).mean())),
        aligned_end_m=None if off is None else float(off[-1]),
    )


def aligned_distances(
    found: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances after the best rotation and shift of ``found``, both (n, 2) [m]."""
    return _norms(turn_onto(found, truth)(found) - truth)


def _lengths(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return _norms(np.diff(places, axis=0))


def _norms(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
