"""Runs: the cycles from a vehicle's coming to its going, which a course is fitted to."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .courses import Observed
from .medium import PowerLaw

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Stations

    from .api import Cycle

#: Power over the noise from which a station hears a vehicle on its way [1].
_HEARD = 2.0
_LEAST_HEARD = 2
#: A vehicle is near while the loudest station has this part of the run's greatest power.
_NEAR = 0.1


@dataclass(frozen=True, slots=True)
class RunLimits:
    """When a run begins and ends.

    Attributes
    ----------
    lead_s
        How much before the first cycle with a vehicle belongs to it [s].
    quiet_s
        It ends when so long no station has heard any [s].
    most_s
        And after this at the latest [s].
    """

    lead_s: float
    quiet_s: float
    most_s: float


class RunCollector:
    """Collects the cycles of runs.

    Parameters
    ----------
    limits
        When runs begin and end.
    """

    def __init__(self, limits: RunLimits) -> None:
        self.limits = limits
        self._lead: deque[Cycle] = deque()
        self._cycles: list[Cycle] = []
        self._last_ns = 0

    def take(self, cycle: Cycle) -> list[Cycle]:
        """Take the next cycle; return the run that has ended with it, else nothing."""
        if cycle.present.any():
            if not self._cycles:
                self._cycles = list(self._lead)
                self._lead.clear()
            self._last_ns = cycle.time_ns
        if not self._cycles and not cycle.present.any():
            self._lead.append(cycle)
            while self._lead[0].time_ns < cycle.time_ns - self.limits.lead_s * NS_PER_S:
                self._lead.popleft()
            return []
        self._cycles.append(cycle)
        quiet_ns = cycle.time_ns - self._last_ns
        long_ns = cycle.time_ns - self._cycles[0].time_ns
        if quiet_ns > self.limits.quiet_s * NS_PER_S or long_ns > self.limits.most_s * NS_PER_S:
            return self.finish()
        return []

    def finish(self) -> list[Cycle]:
        """Return the run that has not ended yet, as one that has."""
        run, self._cycles = self._cycles, []
        self._lead.clear()
        return run


def observed_of(run: list[Cycle], site: Stations, exponent: float) -> Observed:
    """Return the powers of a run; times count from its first cycle [s].

    A cycle is as long as the shortest step between two.
    """
    times = np.array([cycle.time_ns - run[0].time_ns for cycle in run], np.int64) / NS_PER_S
    powers = np.array([cycle.powers for cycle in run])
    floors = np.array([cycle.floors for cycle in run])
    sigmas = np.array([cycle.floor_sigmas for cycle in run])
    cycle_s = float(np.diff(times).min()) if len(times) > 1 else 0.0
    law = PowerLaw(1.0, exponent)
    return Observed(times, powers, floors, site.places, law, cycle_s, sigmas)


def heard_span(observed: Observed) -> slice:
    """Return the cycles from the first to the last in which two stations hear a vehicle."""
    over = np.where(observed.floors > 0, observed.powers, 0) > _HEARD * observed.floors
    return _span(over.sum(axis=1) >= _LEAST_HEARD)


def near_span(observed: Observed) -> slice:
    """Return the cycles from the first to the last in which a vehicle is near for single cycles.

    From afar all stations hear it nearly alike, and a single cycle puts it amid them as well.
    """
    signal = np.nan_to_num(observed.powers - observed.floors).max(axis=1)
    return _span(signal > _NEAR * signal.max())


def _span(which: NDArray[np.bool_]) -> slice:
    found = np.flatnonzero(which)
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, 0)


def part_of(observed: Observed, span: slice) -> Observed:
    """Return some of the cycles."""
    sigmas = observed.floor_sigmas
    return replace(
        observed,
        times_s=observed.times_s[span],
        powers=observed.powers[span],
        floors=observed.floors[span],
        floor_sigmas=None if sigmas is None else sigmas[span],
    )
