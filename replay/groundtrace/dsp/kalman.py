"""The linear Kalman filter and its smoother, a few matrices wide.

Source: R. E. Kalman, A new approach to linear filtering and prediction problems, 1960; the
covariance after a measurement as P. D. Joseph writes it, which stays symmetric; the smoother of H.
E. Rauch, F. Tung, C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA
Journal 3 (1965). filterpy has them too, and imports scipy.stats: half a second before a first fix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class KalmanFilter:
    """A state of n numbers and what is known of it.

    Parameters
    ----------
    x, p
        State at the start, shape (n,), and its covariance, shape (n, n).

    Attributes
    ----------
    x, p
        The same, now.
    gain
        What the last innovation moved the state by, shape (n, m); zeros before the first.
    """

    def __init__(self, x: Array, p: Array) -> None:
        self.x = np.array(x, np.float64)
        self.p = np.array(p, np.float64)
        self.gain: Array = np.zeros((len(self.x), 1))

    def predict(self, f: Array, q: Array) -> None:
        """Go on by a transition, whose error has the covariance q; shapes (n, n)."""
        self.x = f @ self.x
        self.p = f @ self.p @ f.T + q

    def update(self, z: Array, h: Array, r: Array) -> float:
        """Take a measurement in.

        Parameters
        ----------
        z, h, r
            What is measured, shape (m,), how it hangs on the state, shape (m, n), and the
            covariance of its error, shape (m, m).

        Returns
        -------
        The normalised innovation squared, of m degrees of freedom.
        """
        off = z - h @ self.x
        across = self.p @ h.T
        weight = np.linalg.inv(h @ across + r)
        self.gain = across @ weight
        self.x = self.x + self.gain @ off
        kept = np.eye(len(self.x)) - self.gain @ h
        self.p = kept @ self.p @ kept.T + self.gain @ r @ self.gain.T
        return float(off @ weight @ off)


class Transition(Protocol):
    """How a state goes on: by f, with an error of the covariance q; shapes (n, n)."""

    @property
    def f(self) -> Array:
        """The matrix."""

    @property
    def q(self) -> Array:
        """The covariance."""


def smoothed(states: Array, spreads: Array, steps: Sequence[Transition]) -> tuple[Array, Array]:
    """Return filtered states as all measurements tell them, later ones too.

    Parameters
    ----------
    states, spreads
        Of the filter after each measurement, shapes (k, n) and (k, n, n).
    steps
        How each was predicted; the first is not used.

    Returns
    -------
    States and covariances, shapes (k, n) and (k, n, n); the last are the filter's own.
    """
    x, p = states.copy(), spreads.copy()
    for k in range(len(x) - 2, -1, -1):
        f, q = steps[k + 1].f, steps[k + 1].q
        predicted = f @ p[k] @ f.T + q
        gain = p[k] @ f.T @ np.linalg.inv(predicted)
        x[k] += gain @ (x[k + 1] - f @ x[k])
        p[k] += gain @ (p[k + 1] - predicted) @ gain.T
    return x, p
