"""Matching of event times, and the F1 that blind detectors reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CHANCE_DRAWS = 200
CHANCE_SEED = 20_170_319


def match(
    truth: NDArray[np.float64], found: NDArray[np.float64], tolerance_s: float
) -> NDArray[np.intp]:
    """Match two sorted lists of times one to one, each pair at most ``tolerance_s`` apart.

    Two pointers walk through both lists; with one common tolerance this finds as many pairs as the
    best assignment does, in linear time.

    Returns
    -------
    Index pairs (truth, found), shape (n, 2).
    """
    pairs: tuple[list[int], list[int]] = ([], [])
    steps, answers = truth.tolist(), found.tolist()  # Python's floats are the faster ones here
    n, m = len(steps), len(answers)
    i = j = 0
    while i < n and j < m:
        late = answers[j] - steps[i]
        if -tolerance_s <= late <= tolerance_s:
            pairs[0].append(i)
            pairs[1].append(j)
            i += 1
            j += 1
        elif late < 0:
            j += 1
        else:
            i += 1
    return np.array(pairs, np.intp).T


def f1_score(truth: int, found: int, matched: int) -> float:
    """Return the harmonic mean of precision and recall; 0 where nothing is there."""
    return 2 * matched / (truth + found) if truth + found else 0.0


def f1_of(truth: NDArray[np.float64], found: NDArray[np.float64], tolerance_s: float) -> float:
    """Return the F1 of detections at one tolerance."""
    return f1_score(len(truth), len(found), len(match(truth, found, tolerance_s)))


def random_f1(
    truth: NDArray[np.float64],
    spans: NDArray[np.float64],
    count: int,
    tolerance_s: float,
) -> float:
    """Return the mean F1 of ``count`` detections thrown at random into the spans.

    Parameters
    ----------
    truth
        Sorted times [s].
    spans
        Disjoint scored spans [s], shape (n, 2).
    count
        How many detections.
    tolerance_s
        Of the match [s].
    """
    rng = np.random.default_rng(CHANCE_SEED)
    lengths = spans[:, 1] - spans[:, 0]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    scores = []
    for _ in range(CHANCE_DRAWS):
        along = np.sort(rng.uniform(0, edges[-1], count))
        span = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(spans) - 1)
        scores.append(f1_of(truth, spans[span, 0] + along - edges[span], tolerance_s))
    return float(np.mean(scores))


def metronome_f1(
    truth: NDArray[np.float64],
    spans: NDArray[np.float64],
    count: int,
    tolerance_s: float,
) -> float:
    """Return the mean F1 over phases of a metronome that ticks ``count`` times in the spans."""
    if count == 0:
        return 0.0
    period = float((spans[:, 1] - spans[:, 0]).sum()) / count
    scores = []
    for phase in (np.arange(20) + 0.5) / 20:
        ticks = [np.arange(a + phase * period, b, period) for a, b in spans]
        scores.append(f1_of(truth, np.concatenate(ticks), tolerance_s))
    return float(np.mean(scores))
