"""Smoothing a finished track: every step in the light of all steps after it as well.

Source: H. E. Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic
systems, AIAA Journal 3 (1965), on the model of :mod:`groundtrace.trackers.kalman`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .kalman import Motion

    Array = NDArray[np.float64]


def smoothed(states: Array, spreads: Array, motions: Sequence[Motion]) -> tuple[Array, Array]:
    """Return the states of a track as all of its fixes tell them.

    Parameters
    ----------
    states
        Shape (n, 4): the filter's after each step [m].
    spreads
        Shape (n, 4, 4): their covariances [m^2].
    motions
        How each was predicted; the first is none of them, so that its motion does not count.

    Returns
    -------
    States, shape (n, 4) [m], and their covariances, shape (n, 4, 4) [m^2]; the last are the
    filter's own.
    """
    from filterpy.kalman import KalmanFilter

    n = len(states)
    if n < 2:
        return states.copy(), spreads.copy()
    smoother = KalmanFilter(dim_x=4, dim_z=2)
    found, covariances, _, _ = smoother.rts_smoother(
        states, spreads, [motion.f for motion in motions], [motion.q for motion in motions]
    )
    return np.asarray(found, np.float64), np.asarray(covariances, np.float64)
