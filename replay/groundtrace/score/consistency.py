"""Whether estimates err as much as they say: NEES and NIS with their chi-square bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .places import found_places, match_places, true_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, TrackPoint
    from groundtrace_codecs.labels import Label

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mean of normalised squares and the bounds it should keep.

    Attributes
    ----------
    n, dof
        How many squares, and their degrees of freedom each.
    mean
        Should be near ``dof``; above: the stage is too sure of itself, below: not enough.
    lower, upper
        Bounds of the mean of independent squares at 95 %. Errors of one track depend on each
        other, so that its NEES strays further than that; NIS should not.
    consistent
        Whether the mean keeps its bounds.
    inside_fraction
        Part of the single squares below their own 95 % bound; should be near 0.95.
    """

    n: int
    dof: int
    mean: float
    lower: float
    upper: float
    consistent: bool
    inside_fraction: float


@dataclass(frozen=True, slots=True)
class ConsistencyScore:
    """Consistency by what it is of; None where covariances or innovations are unknown.

    Attributes
    ----------
    nees_fixes, nees_tracks
        Normalised estimation error squared of the places of fixes and of track points.
    nis
        Normalised innovation squared, as the tracker gives it.
    """

    nees_fixes: Consistency | None
    nees_tracks: Consistency | None
    nis: Consistency | None


def normalised_squares(
    vectors: NDArray[np.float64], covariances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return e' P^-1 e for each vector: NEES of errors, NIS of innovations.

    Parameters
    ----------
    vectors
        Shape (n, d).
    covariances
        Shape (n, d, d).

    Returns
    -------
    Shape (n,); NaN where a covariance is unknown or not positive definite.

    Notes
    -----
    Y. Bar-Shalom, X.-R. Li, T. Kirubarajan: Estimation with Applications to Tracking and
    Navigation (2001), equations (5.4.2-1) and (5.4.2-3).
    """
    out = np.full(len(vectors), np.nan)
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(vectors).all(axis=1)
    known = np.flatnonzero(finite)
    known = known[np.linalg.eigvalsh(covariances[known])[:, 0] > 0]
    solved = np.linalg.solve(covariances[known], vectors[known][..., None])[..., 0]
    out[known] = np.einsum("nd,nd->n", vectors[known], solved)
    return out


def consistency(squares: NDArray[np.float64], dof: int) -> Consistency | None:
    """Compare normalised squares, NaN left out, to the chi-square law; None of none."""
    from scipy.stats import chi2

    known = squares[~np.isnan(squares)]
    n = len(known)
    if not n:
        return None
    tail = (1 - CONFIDENCE) / 2
    lower, upper = (float(chi2.ppf(q, n * dof)) / n for q in (tail, 1 - tail))
    mean = float(known.mean())
    inside = float(np.mean(known <= chi2.ppf(CONFIDENCE, dof)))
    return Consistency(n, dof, mean, lower, upper, lower <= mean <= upper, inside)


def score_consistency(
    labels: Sequence[Label],
    fixes: Sequence[Fix],
    points: Sequence[TrackPoint],
    tolerance_s: float = 0.12,
    filtered: Sequence[TrackPoint] | None = None,
) -> ConsistencyScore | None:
    """Compare the errors of places to their covariances, each of one stage.

    Parameters
    ----------
    labels
        The truth.
    fixes, points
        Whose places and covariances are compared.
    tolerance_s
        Within which a place answers a true one [s].
    filtered
        Points whose innovations are looked at; None: those of ``points``.

    Returns
    -------
    The score, or None where neither covariances with truth nor innovations are known.
    """
    nis = np.array([x.nis for x in (points if filtered is None else filtered)], np.float64)
    score = ConsistencyScore(
        nees_fixes=consistency(place_squares(labels, fixes, tolerance_s), 2),
        nees_tracks=consistency(place_squares(labels, points, tolerance_s), 2),
        nis=consistency(nis, 2),
    )
    return None if score == ConsistencyScore(None, None, None) else score


def place_squares(
    labels: Sequence[Label], events: Sequence[Fix | TrackPoint], tolerance_s: float
) -> NDArray[np.float64]:
    """Return the NEES of the places that answer a true one, in order of time."""
    truth = true_places(labels)
    if not len(truth) or not events:
        return np.empty(0)
    ordered = sorted(events, key=lambda event: event.time_ns)
    found = found_places(ordered)
    pairs = match_places(truth, found, tolerance_s)
    spread = np.array([ordered[j].covariance for j in pairs[:, 1]], np.float64).reshape(-1, 3)
    covariances = spread[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return normalised_squares(found.xy[pairs[:, 1]] - truth.xy[pairs[:, 0]], covariances)
