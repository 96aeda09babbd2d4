"""Two vehicles in one run: two courses fitted to the powers of all cycles.

Powers of vehicles add up, so that each is fitted with the other's mean power as a part of the
noise, in turn. Whether there are two is decided by Schwarz's criterion, with a margin, since under
fading the powers of one vehicle stay off its law for some cycles.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .courses import fit_course, vehicle_power
from .medium import ranges
from .scoring import usable
from .search import strengths
from .traffic_scatter import rooted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .courses import CourseFit, Observed
    from .search import Search

    Array = NDArray[np.float64]

#: Standard deviation of a power over its mean from which one course may be of two vehicles: that
#: of one vehicle is a third, and up to 0.8 under fading.
UNLIKE = 0.4
#: Unknowns of a second vehicle; by what part of the powers' number Schwarz's criterion must be
#: better, as if each scattered by a fifth less.
_UNKNOWNS, _MARGIN = 5, 0.4
_ROUNDS = 3


def scatter_along(observed: Observed, places: Array) -> float:
    """Return by how much powers scatter about those of one vehicle of one strength at places.

    The standard deviation of a power over its mean, of powers made nearly Gaussian, so that one
    sensor that is passed closely does not decide.

    Parameters
    ----------
    observed
        Powers of a run.
    places
        Shape (c, 2): the vehicle's [m].
    """
    used = usable(observed.powers)
    powers = np.where(used, observed.powers, 1.0)
    floors = np.where(used, observed.floors, powers)
    spread = observed.law.power(ranges(places, observed.sensors))
    mean = np.exp(strengths(powers, floors, spread, (0, 1))) * spread + observed.floors
    return float(np.sqrt(np.mean(rooted(powers / mean)[used] ** 2)))


def fit_two(
    observed: Observed, search: Search, one: CourseFit
) -> tuple[tuple[CourseFit, Observed], tuple[CourseFit, Observed]] | None:
    """Fit two courses, or return None where one is as likely.

    Parameters
    ----------
    observed
        Powers of a run.
    search
        Where and how fast vehicles may be.
    one
        The course fitted to them as if they were of one vehicle.

    Returns
    -------
    The courses in the order in which vehicles come by the sensors' middle, each with what it
    was fitted to: the other's power is in the floors.
    """
    if one.relative_sigma < UNLIKE:
        return None
    found = [(one, observed), (one, observed)]
    for turn in range(2 * _ROUNDS):
        fit, noisier = _beside(observed, search, found[turn % 2][0])
        if fit is None:
            return None
        found[1 - turn % 2] = fit, noisier
    first, second = (fit for fit, _ in found)
    n = one.samples
    scatter = max(first.relative_sigma, second.relative_sigma)
    gain = 2 * n * np.log(one.relative_sigma / scatter) - _UNKNOWNS * np.log(n)
    if not gain > _MARGIN * n:
        return None
    centre = observed.sensors.mean(axis=0)
    found.sort(key=lambda pair: _middle_s(pair[0], centre))
    return found[0], found[1]


def _beside(
    observed: Observed, search: Search, other: CourseFit
) -> tuple[CourseFit | None, Observed]:
    """Fit one vehicle, the other one's power being noise."""
    noisier = replace(observed, floors=observed.floors + vehicle_power(observed, other))
    return fit_course(noisier, search), noisier


def _middle_s(fit: CourseFit, centre: Array) -> float:
    course = fit.course
    ahead = (centre - course.place) @ course.velocity / course.speed_mps**2
    return float(course.time_s + ahead)
