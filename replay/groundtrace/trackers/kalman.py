"""A Kalman filter with a clock of steps: a walker goes on as the last step went.

Source: the thesis on footstep localisation, chapter 6: model (6.1) and (6.2), observation (6.3),
recursion (6.4). The state is the position before and the present one, (x', y', x, y). A walker who
stands still makes no step, so that the clock stands still too. The thesis does not say where the
filter starts: here both positions are the first fix, and the one before is unknown within a pace.
Nor does it follow a walker whose step is missed, or who turns about: see :class:`Motion`.

A finished track is smoothed: every step is estimated from all steps after it as well. Source: H. E.
Rauch, F. Tung, C. T. Striebel: Maximum likelihood estimates of linear dynamic systems, AIAA Journal
3 (1965), on the model of a walk by steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: How a step leads to the next, (6.2), and what of the state is observed, (6.3). Source: thesis,
#: equations (6.2) and (6.3).
F = np.kron(np.array([[0.0, 1.0], [-1.0, 2.0]]), np.eye(2))
H = np.kron(np.array([[0.0, 1.0]]), np.eye(2))
#: Usual distance between two steps [m], section 6.2.1 of the thesis. Source: thesis, section 6.2.1.
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
        return _present(self.sigma_q)

    @property
    def r(self) -> Array:
        """Covariance of a fix, shape (2, 2) [m^2]."""
        return self.sigma_r**2 * np.eye(2)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the state goes on from one fix to the next.

    Attributes
    ----------
    f, q
        Shapes (4, 4): the transition, and the covariance of its error [m^2].
    ticks
        How many steps it takes.
    """

    f: Array
    q: Array
    ticks: int = 1

    @classmethod
    @lru_cache(maxsize=64)
    def ahead(cls, model: WalkModel, ticks: int = 1) -> Motion:
        """Go straight on by some ticks of the clock: one, and one for each step that was missed."""
        f, q = F, model.q
        for _ in range(ticks - 1):
            f, q = F @ f, F @ q @ F.T + model.q
        return cls(f, q, ticks)

    @classmethod
    @lru_cache(maxsize=64)
    def turning(cls, reach_m: float = PACE_M, ticks: int = 1) -> Motion:
        """Go anywhere: so many steps from the present place, each of ``reach_m`` per axis."""
        f = np.kron(np.array([[0.0, 1.0], [0.0, 1.0]]), np.eye(2))
        return cls(f, _present(reach_m * ticks), ticks)


def _present(sigma_m: float) -> Array:
    return np.diag([0.0, 0.0, sigma_m**2, sigma_m**2])


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


class LinearFilter:
    """A Kalman filter, (6.4): what is known of a state, and what an observation says of it.

    The package filterpy has the same, to which tests hold it; but its import takes half a second,
    as all distributions of SciPy come with it.

    Attributes
    ----------
    state, spread
        Shape (n,), and its covariance, (n, n).
    gain
        What a unit of innovation moved the state by in the last update, shape (n, m).
    nis
        Square of its innovation, normalised by its covariance; 0 after a prediction.
    """

    def __init__(self, state: Array, spread: Array) -> None:
        self.state: Array = np.array(state, np.float64)
        self.spread: Array = np.array(spread, np.float64)
        self.gain: Array = np.empty((len(self.state), 0))
        self.nis = 0.0

    def predict(self, f: Array, q: Array) -> None:
        """Go on: x = F x, P = F P F' + Q.

        Parameters
        ----------
        f, q
            The transition, and the covariance of its error, shapes (n, n).
        """
        self.state = f @ self.state
        self.spread = f @ self.spread @ f.T + q
        self.nis = 0.0

    def update(self, z: Array, h: Array, noise: Array) -> None:
        """Take an observation in, the covariance by Joseph's form, which stays positive.

        Source: R. S. Bucy, P. D. Joseph: Filtering for stochastic processes with applications to
        guidance, 1968.

        Parameters
        ----------
        z, h, noise
            The observation, shape (m,), what it sees of the state, (m, n), and its covariance.
        """
        off = z - h @ self.state
        across = self.spread @ h.T
        weight = np.linalg.inv(h @ across + noise)
        self.gain = gain = across @ weight
        self.nis = float(off @ weight @ off)
        left = np.eye(len(self.state)) - gain @ h
        self.state = self.state + gain @ off
        self.spread = left @ self.spread @ left.T + gain @ noise @ gain.T


class StepFilter(LinearFilter):
    """The filter of one walker.

    Parameters
    ----------
    model
        Of the walk.
    position
        First fix, shape (2,) [m].
    spread
        Covariance of the state at the start, shape (4, 4) [m^2].
    """

    def __init__(self, model: WalkModel, position: Array, spread: Array) -> None:
        super().__init__(np.concatenate([position, position]), spread)
        self._straight = Motion.ahead(model)

    def fit(
        self, position: Array, noise: Array, motion: Motion | None = None
    ) -> tuple[float, float]:
        """Return how far a fix is from the predicted next step, and how surprising it is.

        Parameters
        ----------
        position, noise
            The fix, shape (2,) [m], and its covariance, shape (2, 2) [m^2].
        motion
            How it gets there; None: straight on.

        Returns
        -------
        The Mahalanobis distance; and minus twice the logarithm of the likelihood, 0 where nothing
        is surer. That is the square of the distance, and what a vaguer prediction spreads the
        likelihood over, in comparison to one that errs by nothing.
        """
        motion = motion or self._straight
        spread = motion.f @ self.spread @ motion.f.T + motion.q
        x, y = (position - (motion.f @ self.state)[2:]).tolist()
        (xx, xy), (yx, yy) = (spread[2:, 2:] + noise).tolist()
        (noise_xx, noise_xy), (noise_yx, noise_yy) = noise.tolist()
        determinant = xx * yy - xy * yx
        square = (yy * x * x - (xy + yx) * x * y + xx * y * y) / determinant
        ratio = determinant / (noise_xx * noise_yy - noise_xy * noise_yx)
        return math.sqrt(square), square + math.log(ratio)

    def step(self, position: Array, noise: Array, motion: Motion | None = None) -> float:
        """Predict the next step and take its fix in; return the NIS (2 degrees of freedom)."""
        motion = motion or self._straight
        self.predict(motion.f, motion.q)
        self.update(position, H, noise)
        return self.nis


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
    states, spreads = states.copy(), spreads.copy()
    for k in range(len(states) - 2, -1, -1):
        f, q = motions[k + 1].f, motions[k + 1].q
        ahead = f @ spreads[k] @ f.T + q
        gain = spreads[k] @ f.T @ np.linalg.inv(ahead)
        states[k] += gain @ (states[k + 1] - f @ states[k])
        spreads[k] += gain @ (spreads[k + 1] - ahead) @ gain.T
    return states, spreads
