"""Whose step a fix is: the next one of a track, the same one again, or a stranger's.

A track is matched by the likeliest of its motions: straight on; straight on with steps missed, of
which its pace tells how many; or anywhere within a pace, as when it turns about. Of several fixes
and tracks the pairs are made at once, first for the tracks that count: a track that has just begun
knows so little that it is near everything, and must not take a walker's fix from him.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..score.assignment import assign
from .kalman import PACE_M, Motion

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from .kalman import WalkModel
    from .track import Track

    Array = NDArray[np.float64]

#: How improbable a turn is, as minus twice the logarithm of 5 %.
TURN_SURPRISE = 6.0
#: A walker can only turn when his next step is due: from this part of his pace on.
TURN_DUE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """A fix as a tracker takes it.

    Attributes
    ----------
    time_ns
        When.
    place
        Shape (2,) [m].
    noise
        Its covariance, shape (2, 2) [m^2].
    """

    time_ns: int
    place: Array
    noise: Array


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How a fix fits the next step of a track.

    Attributes
    ----------
    distance
        Mahalanobis distance.
    surprise
        Minus twice the logarithm of the likelihood.
    motion
        The likeliest.
    """

    distance: float
    surprise: float
    motion: Motion


@dataclass(frozen=True, slots=True)
class Limits:
    """How far apart, in distance and in time, a fix and the last step of a track may be."""

    max_distance: float
    least_pace_s: float


def fit(track: Track, seen: Observed, model: WalkModel, limits: Limits) -> Fit | None:
    """Return the likeliest motion of a track to a fix, or None where it is too soon for a step.

    A motion out of the gate is never the likeliest while another is inside.
    """
    elapsed_s = (seen.time_ns - track.last_ns) / NS_PER_S
    # here and below of the precision that is stored: the gates then decide what is decided here
    if elapsed_s <= 0 or np.float32(elapsed_s) < limits.least_pace_s:
        return None
    fits = [
        Fit(
            track.filter.distance(seen.place, seen.noise, motion),
            track.filter.surprise(seen.place, seen.noise, motion) + penalty,
            motion,
        )
        for motion, penalty in _motions(track, elapsed_s, model)
    ]
    return min(fits, key=lambda f: (max(f.distance, limits.max_distance), f.surprise))


def _motions(track: Track, elapsed_s: float, model: WalkModel) -> list[tuple[Motion, float]]:
    found = [(Motion.ahead(model), 0.0)]
    pace_s = track.pace_s
    if track.counts and pace_s is not None:
        ticks = max(1, round(elapsed_s / pace_s))
        if ticks > 1:
            found.append((Motion.ahead(model, ticks), 0.0))
        if elapsed_s >= TURN_DUE * pace_s:
            found.append((Motion.turned(PACE_M, ticks), TURN_SURPRISE))
    return found


def paired(
    fits: Sequence[Sequence[Fit | None]], tracks: Sequence[Track], limits: Limits
) -> dict[int, int]:
    """Pair fixes and tracks one to one inside the gate: the likeliest of as many as can be.

    Returns
    -------
    Index of the track by that of the fix.
    """
    surprise = np.full((len(fits), len(tracks)), np.inf)
    for row, each in enumerate(fits):
        for column, found in enumerate(each):
            if found is not None and np.float32(found.distance) <= limits.max_distance:
                surprise[row, column] = max(found.surprise, 0.0)
    owner: dict[int, int] = {}
    counts = np.array([track.counts for track in tracks], np.bool_)
    for among in (counts, ~counts):
        left = np.where(among, surprise, np.inf)
        left[list(owner)] = np.inf
        owner |= {int(row): int(column) for row, column in assign(left, np.inf)}
    return owner


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """Where and when a foot was last set down; ``spread`` is the covariance of the place."""

    time_ns: int
    place: Array
    spread: Array

    def distance(self, seen: Observed) -> float:
        """Return the Mahalanobis distance of a fix from this very place."""
        innovation = seen.place - self.place
        solved = np.linalg.solve(self.spread + seen.noise, innovation)
        return float(np.sqrt(innovation @ solved))

    def since_s(self, seen: Observed) -> float:
        """Return the time between this and a fix [s]."""
        return abs(seen.time_ns - self.time_ns) / NS_PER_S


def foot_of(track: Track) -> Foot:
    """Return the last step of a track."""
    last = track.steps[-1]
    return Foot(last.time_ns, last.state[2:], last.spread[2:, 2:])


def nearest(
    seen: Observed, feet: Mapping[int, Foot], fits: Sequence[Fit | None], limits: Limits
) -> tuple[float, float]:
    """Return distance and time [s] of a fix from the track that is nearest to it.

    Parameters
    ----------
    seen
        A fix that is the next step of no track.
    feet
        Where each track, then each stranger, was last, the fixes beside this one counted.
    fits
        How it fits each track.
    limits
        A foot set down within the least pace is compared to where it stands: one cannot step
        again so soon, but set down the toe.

    Returns
    -------
    0 and infinity where there is none.
    """
    found = [(0.0, float("inf"))] if not feet else []
    for index, foot in feet.items():
        since_s = foot.since_s(seen)
        step = fits[index] if index < len(fits) else None
        if step is None or since_s < limits.least_pace_s:
            found.append((foot.distance(seen), since_s))
        else:
            found.append((step.distance, since_s))
    return min(found)
