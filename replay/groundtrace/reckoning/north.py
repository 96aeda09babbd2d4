"""Magnetic azimuths of steps, each with what it may be off by.

Iron in a building turns the field as often as it makes it stronger or steeper, so that a field
whose horizontal and vertical parts are not the usual ones is doubted by just as much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..later import Later
from .strides import Sight

if TYPE_CHECKING:
    from . import step_kernels
    from .level_motion import Motion
    from .parameters import ReckoningParameters
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

#: Weight of a step's field in the usual one, once there were some.
NEWEST = 0.02
#: The earth's field has a horizontal part of at least about this, where a compass works [T].
LEAST_T = 5e-6


@dataclass(slots=True)
class North:
    """Compares the field of each step with the usual one.

    Attributes
    ----------
    parameters
        Of the reckoning.
    usual
        Horizontal and vertical part of the field so far [T]; None before the first step.
    steps
        How many steps that rests on.
    """

    parameters: ReckoningParameters
    usual: tuple[float, float] | None = None
    steps: int = 0

    def sight(
        self, motion: Motion, start_ns: int, stop_ns: int, length_m: float
    ) -> tuple[Sight | None, float]:
        """Return the azimuth that a step's field tells, and how far that field is off [T].

        Without a field that is None and NaN. The step lies in ``[start_ns, stop_ns)``.
        """
        east, north, up = step_kernels.mean_vector(motion.time_ns, motion.field, start_ns, stop_ns)
        flat = math.hypot(east, north)
        if not math.isfinite(flat + up) or flat == 0:
            return None, math.nan
        before = (flat, up) if self.usual is None else self.usual
        off = math.hypot(flat - before[0], up - before[1])
        self._learn(flat, up, before)
        p = self.parameters
        sigma = math.hypot(math.radians(p.compass_deg), off / max(before[0], LEAST_T))
        # the level frame's magnetic north, against the map's
        offset = math.pi / 2 - math.radians(p.declination_deg) - math.atan2(north, east)
        repeats = 2 * p.compass_memory_m / max(length_m, 0.1)
        return Sight(offset, sigma, repeats), off

    def _learn(self, flat: float, up: float, before: tuple[float, float]) -> None:
        self.steps += 1
        weight = max(NEWEST, 1 / self.steps)
        self.usual = (
            before[0] + weight * (flat - before[0]),
            before[1] + weight * (up - before[1]),
        )
