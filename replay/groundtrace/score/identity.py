"""Which track is which target: switches of identity, IDF1, and the track of each target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .assignment import assign

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class TargetScore:
    """How one target was tracked.

    Attributes
    ----------
    target
        Its name; empty where truth names none.
    times, covered
        How many times it was there, and at how many of them a track was matched to it.
    track
        The track that is its own when tracks are given to targets for good, or None.
    own
        Times at which that track was within the cut-off.
    switches
        How often another track than before was matched to it.
    rmse_m
        Root mean square distance of the tracks matched [m], or None without any.
    """

    target: str
    times: int
    covered: int
    track: int | None
    own: int
    switches: int
    rmse_m: float | None


@dataclass(frozen=True, slots=True)
class IdentityScore:
    """Whether tracks stay with their targets.

    Attributes
    ----------
    switches
        Sum over the targets.
    idf1
        With each target one track for good: twice the times at which they were together over the
        times of all targets and all tracks; 1 is best.
    targets
        Each of them, by name.
    """

    switches: int
    idf1: float
    targets: tuple[TargetScore, ...]


def score_identity(
    names: Sequence[str],
    targets: NDArray[np.float64],
    numbers: Sequence[int],
    tracks: NDArray[np.float64],
    cutoff_m: float,
) -> IdentityScore:
    """Say which track was which target.

    Parameters
    ----------
    names
        Of the m targets.
    targets
        Shape (n, m, 2): where they were [m]; NaN where they were not.
    numbers
        Of the k tracks.
    tracks
        Shape (n, k, 2) [m]; NaN where they were not.
    cutoff_m
        Largest distance of a target and its track [m].

    Notes
    -----
    Switches: K. Bernardin, R. Stiefelhagen: Evaluating multiple object tracking performance: the
    CLEAR MOT metrics, EURASIP Journal on Image and Video Processing (2008), section 2.1: a pair
    lasts while it keeps the cut-off, and only what is left over is matched anew. IDF1: E. Ristani
    et al.: Performance measures and a data set for multi-target, multi-camera tracking, ECCV
    workshops (2016), section 3.
    """
    apart = np.hypot(*np.moveaxis(targets[:, :, None] - tracks[:, None], -1, 0))
    own = _owners(apart, cutoff_m)
    found = []
    for i, name in enumerate(names):
        matched, distance = (x[:, i] for x in _matched(apart, cutoff_m))
        followed = matched[matched >= 0]
        column = own.get(i)
        found.append(
            TargetScore(
                target=name,
                times=int((~np.isnan(targets[:, i, 0])).sum()),
                covered=len(followed),
                track=None if column is None else numbers[column],
                own=0 if column is None else int((apart[:, i, column] <= cutoff_m).sum()),
                switches=int(np.count_nonzero(np.diff(followed))),
                rmse_m=float(np.sqrt(np.nanmean(distance**2))) if len(followed) else None,
            )
        )
    there = int((~np.isnan(targets[..., 0])).sum() + (~np.isnan(tracks[..., 0])).sum())
    together = 2 * sum(each.own for each in found) / there if there else 0.0
    return IdentityScore(sum(each.switches for each in found), together, tuple(found))


def _owners(apart: NDArray[np.float64], cutoff_m: float) -> dict[int, int]:
    """Give targets one track each so that they are together most often, by index."""
    from scipy.optimize import linear_sum_assignment

    together = (apart <= cutoff_m).sum(axis=0)
    rows, columns = linear_sum_assignment(together, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return {row: column for row, column in pairs if together[row, column]}


def _matched(
    apart: NDArray[np.float64], cutoff_m: float
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Match tracks to targets time by time, shape (n, m): index or -1, and distance or NaN."""
    n, m, _ = apart.shape
    matched, distance = np.full((n, m), -1, np.intp), np.full((n, m), np.nan)
    last: dict[int, int] = {}
    for k, cost in enumerate(apart):
        kept = {i: j for i, j in last.items() if cost[i, j] <= cutoff_m}
        left = cost.copy()
        left[list(kept)] = np.inf
        left[:, list(kept.values())] = np.inf
        new = {int(i): int(j) for i, j in assign(left, cutoff_m)}
        # a target remembers its track while it has none, unless another has taken that track
        last = {i: j for i, j in last.items() if j not in new.values()} | kept | new
        for i, j in (kept | new).items():
            matched[k, i], distance[k, i] = j, cost[i, j]
    return matched, distance
