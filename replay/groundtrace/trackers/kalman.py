"""A Kalman filter with a clock of steps: a walker goes on as the last step went.

Source: the thesis on footstep localisation, chapter 6: model (6.1) and (6.2), observation (6.3),
recursion (6.4). The state is the place before and the present one, (x', y', x, y). A walker who
stands still makes no step, so that the clock stands still too. The thesis does not say where the
filter starts: here both places are the first fix, and the one before is unknown within a pace.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: How a step leads to the next, (6.2), and what of the state is observed, (6.3). By hand: the
#: kinematic filters of filterpy observe sums of the coordinates.
F = np.kron(np.array([[0.0, 1.0], [-1.0, 2.0]]), np.eye(2))
H = np.kron(np.array([[0.0, 1.0]]), np.eye(2))
#: Usual distance between two steps [m], section 6.2.1 of the thesis.
PACE_M = 0.35


@dataclass(frozen=True, slots=True)
class WalkModel:
    """How far a step strays from going straight on, and a fix from the step [m, per axis].

    Attributes
    ----------
    sigma_q
        Standard deviation of the prediction [m].
    sigma_r
        Standard deviation of a fix whose own covariance is not taken [m].
    """

    sigma_q: float = 0.1
    sigma_r: float = 0.5

    @property
    def q(self) -> Array:
        """Covariance of the prediction's error, shape (4, 4) [m^2]; only the present place errs."""
        return np.diag([0.0, 0.0, self.sigma_q**2, self.sigma_q**2])

    @property
    def r(self) -> Array:
        """Covariance of a fix, shape (2, 2) [m^2]."""
        return self.sigma_r**2 * np.eye(2)


def first_spread(noise: Array, pace_m: float = PACE_M) -> Array:
    """Return the covariance of the state after one fix, shape (4, 4) [m^2].

    Parameters
    ----------
    noise
        Covariance of the fix, shape (2, 2) [m^2].
    pace_m
        How far off the place before may be: both places are the fix, so that they err alike.
    """
    spread: Array = np.tile(noise, (2, 2))
    spread[:2, :2] += pace_m**2 * np.eye(2)
    return spread


class StepFilter:
    """The filter of one walker; each call of :meth:`step` is a tick of its clock.

    Parameters
    ----------
    model
        Of the walk.
    place
        First fix, shape (2,) [m].
    spread
        Covariance of the state at the start, shape (4, 4) [m^2].
    """

    def __init__(self, model: WalkModel, place: Array, spread: Array) -> None:
        from filterpy.kalman import KalmanFilter

        self._filter = KalmanFilter(dim_x=4, dim_z=2)
        self._filter.x = np.concatenate([place, place])
        self._filter.P = np.array(spread, np.float64)
        self._filter.F, self._filter.H = F, H
        self._filter.Q = model.q

    @property
    def state(self) -> Array:
        """Place before and present place, shape (4,) [m]."""
        return np.array(self._filter.x, np.float64)

    @property
    def spread(self) -> Array:
        """Covariance of the state, shape (4, 4) [m^2]."""
        return np.array(self._filter.P, np.float64)

    @property
    def gain(self) -> Array:
        """What a metre of innovation moved the state by in the last step, shape (4, 2)."""
        return np.array(self._filter.K, np.float64)

    def distance(self, place: Array, noise: Array) -> float:
        """Return the Mahalanobis distance of a fix from the predicted next step.

        Parameters
        ----------
        place, noise
            The fix, shape (2,) [m], and its covariance, shape (2, 2) [m^2].
        """
        state, spread = self._filter.get_prediction()
        innovation = place - H @ state
        expected = H @ spread @ H.T + noise
        return float(np.sqrt(innovation @ np.linalg.solve(expected, innovation)))

    def step(self, place: Array, noise: Array) -> float:
        """Predict the next step and take its fix in; return the NIS (2 degrees of freedom)."""
        self._filter.predict()
        self._filter.update(place, R=noise)
        return float(self._filter.mahalanobis**2)
