"""A localizer that learns the floor while people walk on it: one k and p for all impacts so far.

A place alone leaves the scale k free for every impact, so that four sensors have as many unknowns
as times. The floor is the same under all impacts: with k and p estimated over those so far, four
sensors have one arrival to spare, and more of them place as well as with a calibrated floor.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from . import power_law
from .arrival_fit import Model, heard_by, lattice, losses, search
from .floor import Floor, Prior, reference_distance
from .joint_fit import Free, Impacts, fit
from .joint_start import bounds_of, start
from .location import LEAST_PICKS, Location, nowhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Medium

    from .arrival_fit import Lattice
    from .joint_fit import JointFit

    Array = NDArray[np.float64]

#: An impact tells of the floor what its own three unknowns leave over.
TELLING = 4
#: Reweightings with each impact: the fit goes on from the one before.
ROUNDS = 1
#: The floor is estimated anew when one in so many of the impacts is new.
RENEWAL = 8
#: A pace known to this is taken as it is.
SURE = 0.05
#: The paces a place is averaged over: three points that have the moments of a normal law, by
#: deviations from the best one, and their weights.
ABSCISSA, WEIGHTS = 3**0.5, (2 / 3, 1 / 6, 1 / 6)
#: How far a floor may stray from the one that the geometry names, of the logarithm of its pace.
KNOWN_DEVIATION = 0.1


@dataclass(slots=True)
class RunningFloor:
    """The floor by the impacts so far.

    Attributes
    ----------
    positions
        Shape (n, 2): sensors [m].
    outline
        Shape (k, 2): corners of the room [m]; None stands for the sensors' rectangle, widened.
    prior
        What is known beforehand.
    first
        The floor before there are impacts; None where nothing is known of it.
    least
        Impacts needed for a first estimate where nothing is known.
    memory
        Impacts looked back on.
    """

    positions: Array
    outline: Array | None
    prior: Prior
    first: Floor | None
    least: int
    memory: int
    found: JointFit | None = None
    rows: deque[Array] = field(default_factory=deque)
    places: deque[Array] = field(default_factory=deque)
    fresh: int = 0

    @property
    def floor(self) -> Floor | None:
        """The best estimate by now; None before there is one."""
        return self.first if self.found is None else self.found.floor

    @property
    def pace_deviation(self) -> float:
        """Standard deviation of the logarithm of its pace."""
        known = self.prior.pace_deviation if self.found is None else self.found.deviations[0]
        return float(min(known, 1.0))

    def learn(self, times_s: Array, place: Array) -> None:
        """Take an impact in: arrivals, shape (n,) [s], and about where it was, shape (2,) [m]."""
        if np.isfinite(times_s).sum() < TELLING:
            return
        self.rows.append(times_s)
        self.places.append(place)
        if len(self.rows) > self.memory:
            self.rows.popleft()
            self.places.popleft()
        self.fresh += 1
        if len(self.rows) < self.least or self.fresh < len(self.rows) // RENEWAL:
            return
        self.fresh = 0
        impacts = Impacts(
            self.positions, np.array(self.rows), bounds_of(self.positions, self.outline)
        )
        places, floor = np.array(self.places), self.floor
        if floor is None:
            begun = start(impacts, self.outline, exponent=self.prior.exponent)
            floor, places = begun.floor, begun.places
        free = Free(exponent=self.prior.exponent_deviation > 0)
        self.found = fit(
            impacts, floor, places, loss="cauchy", free=free, prior=self.prior, rounds=ROUNDS
        )
        self.places = deque(self.found.places)


def running_floor(
    positions: Array,
    outline: Array | None,
    medium: Medium,
    exponent: float,
    exponent_deviation: float,
    least: int,
    memory: int,
) -> RunningFloor:
    """Return a floor to learn; the geometry's arrival scale and exponent are its prior."""
    exponent = medium.arrival_exponent or exponent
    reference = reference_distance(positions)
    prior = Prior(exponent=exponent, exponent_deviation=exponent_deviation)
    first = None
    if medium.arrival_scale is not None:
        pace = medium.arrival_scale * reference**exponent
        first = Floor(reference, pace, exponent, np.zeros(len(positions)))
        prior = replace(prior, pace_s=pace, pace_deviation=KNOWN_DEVIATION)
    return RunningFloor(positions, outline, prior, first, least, memory)


def locate(
    running: RunningFloor, times_s: Array, sigma_s: float = 5e-4, huber: float = power_law.HUBER
) -> Location:
    """Return the place of an impact on the floor that is known by now, and learn from it.

    Parameters
    ----------
    running
        The floor by the impacts before; it takes this one in.
    times_s
        Shape (n,): arrivals [s], from any origin; NaN where a sensor has none.
    sigma_s
        Standard deviation of an arrival until the impacts tell it [s].
    huber
        Residuals beyond this many deviations count linearly.

    Returns
    -------
    The place; its residual is the root of the mean loss [s]. Before the floor is known it is that
    of the power law with a scale of its own.
    """
    picks = int(np.isfinite(times_s).sum())
    if picks < LEAST_PICKS:
        return nowhere(picks)
    floor = running.floor
    if floor is None:
        exponent = running.prior.exponent
        found = power_law.locate(
            running.positions, times_s, running.outline, exponent, sigma_s, huber
        )
    else:
        found = _on_floor(running, floor, times_s, sigma_s, huber)
    running.learn(times_s, np.array([found.x, found.y]))
    return found


def _on_floor(
    running: RunningFloor, floor: Floor, times_s: Array, sigma_s: float, huber: float
) -> Location:
    """Return the place on a floor whose pace is as uncertain as the fit says."""
    heard = np.isfinite(times_s)
    here, times, picks = running.positions[heard], times_s[None, heard], int(heard.sum())
    sigma = sigma_s if running.found is None else running.found.sigma_s
    area = heard_by(lattice(running.positions, running.outline, floor.exponent), heard)
    model = Model(floor.exponent, floor.scale, huber * sigma)
    best = search(area, here, times, model)
    excess = best.losses * picks
    if running.pace_deviation > SURE:
        slower, faster = (
            losses(area.u, times - times.min(), replace(model, slope=floor.scale * factor))
            for factor in np.exp(np.array([1, -1]) * ABSCISSA * running.pace_deviation)
        )
        excess = np.concatenate([best.losses, slower, faster]) * picks
    mean, covariance = mixed_moments(area, excess, sigma)
    x, y = best.places[0] if picks > power_law.UNKNOWNS else mean
    return Location(float(x), float(y), covariance, float(np.sqrt(best.loss[0])), picks)


def mixed_moments(area: Lattice, excess: Array, sigma_s: float) -> tuple[Array, Array]:
    """Return mean, shape (2,), and covariance, shape (2, 2), of the place over several paces.

    Parameters
    ----------
    area
        The lattice.
    excess
        Shape (w, q): sum of the losses of all arrivals, for each of the paces [s^2]; one, or those
        of :data:`WEIGHTS`.
    sigma_s
        Standard deviation of an arrival [s].
    """
    weights = np.array(WEIGHTS[: len(excess)])[:, None]
    likely = weights * np.exp(-(excess - excess.min()) / (2 * sigma_s**2))
    share = likely.sum(axis=0) / likely.sum()
    mean = share @ area.nodes
    offset = area.nodes - mean
    # nodes stand for squares
    return mean, (offset * share[:, None]).T @ offset + area.spacing**2 / 12 * np.eye(2)
