"""Onsets by the Akaike information criterion (AIC) of variances.

Source: Maeda 1985, AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]). Instead of the minimum alone,
the onset is the mean of k under Akaike weights exp(-(AIC - min) / 2), with the sum divided by the
signal's correlation length, since neighbouring samples are not independent. The spread of the
weights is the uncertainty of the onset.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Samples at both ends of the window where a variance means nothing.
EDGE = 3


def aic(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return AIC(k) for k = 1 ... n-1 of windows of shape (m, n); shape (m, n-1)."""
    n = windows.shape[1]
    k = np.arange(1, n, dtype=np.float64)
    total = np.cumsum(windows, axis=1)
    square = np.cumsum(windows * windows, axis=1)
    before = square[:, :-1] / k - (total[:, :-1] / k) ** 2
    after_sum = total[:, -1:] - total[:, :-1]
    after = (square[:, -1:] - square[:, :-1]) / (n - k) - (after_sum / (n - k)) ** 2
    least = 1e-8 * np.maximum(after.max(axis=1, keepdims=True), 1e-300)
    return np.asarray(
        k * np.log(np.maximum(before, 0) + least) + (n - k) * np.log(np.maximum(after, 0) + least)
    )


def aic_onset(
    windows: NDArray[np.float64], correlation: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the onset in each window and its standard deviation, both in samples.

    Parameters
    ----------
    windows
        Shape (m, n): each holds noise, then signal. Windows that are too short for a variance on
        both sides (n < 9) give their middle.
    correlation
        Correlation length of the signal [samples].

    Returns
    -------
    onset
        Shape (m,): index of the first sample of the signal, with fraction.
    deviation
        Shape (m,).
    """
    m, n = windows.shape
    if n < 2 * EDGE + 3:
        return np.full(m, n / 2), np.full(m, n / np.sqrt(12))
    centred = windows - windows[:, :1]
    criterion = aic(centred)[:, EDGE:-EDGE]
    k = np.arange(1 + EDGE, n - EDGE, dtype=np.float64)
    least = criterion.min(axis=1, keepdims=True)
    weight = np.exp(-(criterion - least) / (2 * max(correlation, 1.0)))
    weight /= weight.sum(axis=1, keepdims=True)
    # row by row: a matrix product would round each window according to those beside it
    onset = (weight * k).sum(axis=1)
    variance = (weight * (k[None, :] - onset[:, None]) ** 2).sum(axis=1)
    return onset, np.sqrt(variance)
