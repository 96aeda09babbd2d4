"""Curved paths: a Kalman filter of nearly constant velocity, on places or on powers.

On powers it is an extended filter for the logarithm of the paper's (4) with the noise added,
smoothed, and linearised anew about what it finds until that stays (B. M. Bell: The iterated Kalman
smoother as a Gauss-Newton method, SIAM J. Optim. 4, 1994). The logarithm of a gamma distributed
power has a mean and a variance that depend on its degrees of freedom alone: all cycles weigh alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import digamma, polygamma

from ..trackers.kalman import LinearFilter, smoothed
from ..trackers.kalman import Motion as Step
from .likelihood import CyclePlace, noise_subtracted
from .lines import Course
from .medium import cube_root_normalised, ranges, repeated, usable
from .presence import RELATIVE_SIGMA

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .courses import Observed

    Array = NDArray[np.float64]

#: State of the filter on powers: x, y, vx, vy, ln mu; on places it lacks the last. Source:
#: definition.
_STATES = 5
#: Variances of the first state: nothing is known of it [m^2, m^2/s^2, 1]. Chosen by judgement:
#: deviations of 100 m, 20 m/s and a factor of e^10.
_UNKNOWN = np.array([1e4, 1e4, 400.0, 400.0, 100.0])
#: Variance of ln U that leaves a power without influence. Chosen by judgement: a ten-millionth of a
#: usual power's information.
_DEAF = 1e6
#: Rounds of linearisation, and by what the variance of powers is raised in the first of them, in
#: which their slopes are those of a rough path. Chosen by judgement: without the caution rough
#: paths draw the fit away; it settles in fewer rounds.
_ROUNDS, _CAUTION = 25, (16.0, 9.0, 4.0, 2.0)
#: A path that moves by less has settled [m]. Chosen by judgement: a thousandth of its error.
_STAYS_M = 1e-3
#: Greatest standard deviation of a power over its mean that is believed. Chosen by judgement: more
#: is no scatter but another vehicle.
_MOST_SIGMA = 3.0
#: A cycle has a place if so many powers are above the noise. Source: definition: two coordinates
#: and a strength.
_LEAST_HEARD = 3


@dataclass(frozen=True, slots=True)
class MotionModel:
    """How a vehicle's motion strays from uniform.

    Attributes
    ----------
    acceleration
        Spectral density of its white acceleration [m^2/s^3]: velocity strays by the root of it
        times the root of time.
    strength
        Spectral density of the change of ln mu [1/s].
    """

    acceleration: float = 1.0
    strength: float = 0.02

    def noise(self, interval_s: float) -> Array:
        """Return the covariance of the state's change beside uniform motion, shape (5, 5)."""
        t = abs(interval_s)
        block = self.acceleration * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        noise = np.zeros((_STATES, _STATES))
        noise[:4, :4] = np.kron(block, np.eye(2))
        noise[4, 4] = self.strength * t
        return noise


def transition(interval_s: float) -> Array:
    """Return how (x, y, vx, vy, ln mu) goes on in uniform motion, shape (5, 5)."""
    f = np.eye(_STATES)
    f[0, 2] = f[1, 3] = interval_s
    return f


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A path, cycle by cycle.

    Attributes
    ----------
    times_s
        Shape (c,) [s].
    states
        Shape (c, 4) or (c, 5): x, y [m], vx, vy [m/s] and, from powers, ln mu.
    covariances
        Shape (c, 4, 4) or (c, 5, 5).
    nis
        Shape (c,): squared Mahalanobis distance of each cycle's measurement from its prediction.
    freedom
        Shape (c,): of how many measurements, which is what ``nis`` is in the mean.
    """

    times_s: Array
    states: Array
    covariances: Array
    nis: Array
    freedom: NDArray[np.int64]

    @property
    def places(self) -> Array:
        """Shape (c, 2) [m]."""
        return self.states[:, :2]

    def course(self, cycle: int = -1) -> Course:
        """Return the course of one cycle: where the vehicle is if it goes straight on."""
        state, spread = self.states[cycle], self.covariances[cycle]
        return Course(float(self.times_s[cycle]), state[:2], state[2:4], spread[:4, :4])


def track_places(
    times_s: Array, places: Array, covariances: Array, motion: MotionModel | None = None
) -> Path:
    """Track a path by places of single cycles, smoothed by what comes after.

    Parameters
    ----------
    times_s
        Shape (c,) [s].
    places
        Shape (c, 2): of cycles, at least one of them finite [m]; NaN where there is none.
    covariances
        Shape (c, 2, 2) [m^2]; one that is not finite counts as no place.
    motion
        How the motion strays.
    """
    rows = np.concatenate([places, covariances.reshape(-1, 4)], axis=1)
    valid = np.asarray(np.isfinite(rows).all(axis=1))
    start = np.concatenate([places[valid][0], np.zeros(2)])
    run = _Run(times_s, start, motion or MotionModel())
    for cycle in range(len(times_s)):
        run.predict(cycle)
        if valid[cycle]:
            run.update(places[cycle], np.eye(2, 4), covariances[cycle])
        run.keep()
    return run.path(2 * valid.astype(np.int64))


def cycle_places(
    observed: Observed, x: Array, y: Array, relative_sigma: float = RELATIVE_SIGMA
) -> tuple[Array, Array]:
    """Return the likeliest place of each cycle by itself, (7) with mu profiled.

    Parameters
    ----------
    observed
        Powers.
    x, y
        Shapes (nx,) and (ny,): even coordinates of a lattice [m].
    relative_sigma
        Standard deviation of a power over its mean.

    Returns
    -------
    Places, shape (c, 2) [m], and covariances, shape (c, 2, 2) [m^2]; NaN and inf where fewer than
    three powers are above the noise, or their maximum is at an edge.
    """
    places = np.full((len(observed.times_s), 2), np.nan)
    covariances = np.full((len(places), 2, 2), np.inf)
    rows = noise_subtracted(observed.powers, observed.floors, observed.floor_sigmas, relative_sigma)
    for cycle, (signal, sigma) in enumerate(zip(*rows, strict=True)):
        cycle_place = CyclePlace(signal, observed.sensors, observed.law, False, sigma)
        if np.sum(cycle_place.powers > 0) < _LEAST_HEARD:
            continue
        estimate = cycle_place.locate(cycle_place.surface(x, y))
        if x[0] < estimate.x < x[-1] and y[0] < estimate.y < y[-1]:
            places[cycle], covariances[cycle] = (estimate.x, estimate.y), estimate.covariance
    return places, covariances


def track(
    observed: Observed,
    guess: Path,
    motion: MotionModel | None = None,
    relative_sigma: float = RELATIVE_SIGMA,
) -> Path:
    """Track a path by its powers, smoothed by what comes after.

    Parameters
    ----------
    observed
        Powers; its cycles are short against the path's curves.
    guess
        A path to begin with, of the same cycles: by :func:`track_places` from
        :func:`cycle_places`, or an earlier one.
    motion
        How the motion strays.
    relative_sigma
        Standard deviation of a power over its mean.
    """
    model = motion or MotionModel()
    used = usable(observed.powers)
    shape = relative_sigma**-2
    bias, variance = float(digamma(shape) - np.log(shape)), float(polygamma(1, shape))
    logs = np.log(np.where(used, observed.powers, 1.0)) - bias
    states = _with_strength(observed, guess.states)
    path = guess
    for caution in [*_CAUTION, *[1.0] * (_ROUNDS - len(_CAUTION))]:
        noise = np.where(used, caution * variance, _DEAF)
        path = _pass(observed, states, logs, noise, model)
        moved = float(np.abs(path.states[:, :2] - states[:, :2]).max())
        states = path.states
        if caution == 1 and moved < _STAYS_M:
            break
    return path


def scatter_about(observed: Observed, path: Path) -> float:
    """Return the standard deviation of powers over their mean on a path from powers.

    As of powers that are independent from cycle to cycle: where they stay off the path for longer,
    as under fading, each tells less. At least :data:`~.presence.RELATIVE_SIGMA`,
    since a path that follows its powers leaves little.
    """
    mean, _ = _linearised(observed, path.states)
    used = usable(observed.powers)
    off = np.where(
        used, cube_root_normalised(np.where(used, observed.powers, 1.0) / np.exp(mean)), np.nan
    )
    variance = float(np.nanvar(off)) * repeated(off)
    return float(np.clip(np.sqrt(variance), RELATIVE_SIGMA, _MOST_SIGMA))


def _pass(observed: Observed, about: Array, logs: Array, noise: Array, motion: MotionModel) -> Path:
    """Filter and smooth powers that are linearised about a path, shape (c, 5)."""
    mean, slopes = _linearised(observed, about)
    run = _Run(observed.times_s, about[0], motion)
    for cycle, state in enumerate(about):
        run.predict(cycle)
        z = logs[cycle] - mean[cycle] + slopes[cycle] @ state
        run.update(z, slopes[cycle], np.diag(noise[cycle]))
        run.keep()
    return run.path((noise < _DEAF).sum(axis=1))


def _linearised(observed: Observed, states: Array) -> tuple[Array, Array]:
    """Return ln of mean powers and their slopes, shapes (c, n) and (c, n, 5)."""
    r = ranges(states[:, :2], observed.sensors)
    vehicle = observed.law.power(r) * np.exp(np.clip(states[:, 4:], -600, 600))
    mean = vehicle + observed.floors
    slopes = np.zeros((*r.shape, _STATES))
    way = (states[:, None, :2] - observed.sensors) / r[..., None]
    slopes[..., :2] = observed.law.slope(r)[..., None] * way
    slopes[..., 4] = 1.0
    return np.log(mean), slopes * (vehicle / mean)[..., None]


def _with_strength(observed: Observed, states: Array) -> Array:
    """Return states with ln mu: one for all cycles, by the powers that stand out of the noise."""
    if states.shape[1] == _STATES:
        return states
    used = usable(observed.powers)
    share = np.where(
        used, np.clip(1 - observed.floors / np.where(used, observed.powers, 1), 0, 1), 0
    )
    spread = observed.law.power(ranges(states[:, :2], observed.sensors))
    logs = np.log(np.where(share > 0, observed.powers * share, 1.0) / spread)
    log_mu = float((share**2 * logs).sum() / max(float((share**2).sum()), 1e-12))
    return np.concatenate([states, np.full((len(states), 1), log_mu)], axis=1)


class _Run:
    """A filter on its way through the cycles, and what it finds in each."""

    def __init__(self, times_s: Array, start: Array, motion: MotionModel) -> None:
        n = len(start)
        intervals = [0.0, *np.diff(times_s).tolist()]
        self._steps = [Step(transition(t)[:n, :n], motion.noise(t)[:n, :n]) for t in intervals]
        self._times = times_s
        self._filter = LinearFilter(start, np.diag(_UNKNOWN[:n]))
        self._estimates: list[tuple[Array, Array, float]] = []

    def predict(self, cycle: int) -> None:
        step = self._steps[cycle]
        self._filter.predict(step.f, step.q)

    def update(self, z: Array, h: Array, noise: Array) -> None:
        self._filter.update(z, h, noise)

    def keep(self) -> None:
        self._estimates.append((self._filter.state, self._filter.spread, self._filter.nis))

    def path(self, freedom: NDArray[np.int64]) -> Path:
        states, spreads, nis = (np.array(rows) for rows in zip(*self._estimates, strict=True))
        states, spreads = smoothed(states, spreads, self._steps)
        return Path(self._times, states, spreads, nis, freedom)
