"""Height over the start of a walk, by the pressure of the air."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..later import Later
from .level_motion import MEMORY_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock

    from . import step_kernels
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

#: Pressure of the standard atmosphere falls to 1/e over this, at 15 degrees [m].
SCALE_HEIGHT_M = 8434.5
#: The pressure is averaged over so long before and after a step [s].
AVERAGE_S = 1.0


@dataclass(slots=True)
class Barometer:
    """Remembers half a minute of pressure before what came last, and that of the first step.

    Attributes
    ----------
    start_pa
        Pressure at the first step [Pa]; NaN before.
    """

    start_pa: float = math.nan
    _time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    _pressure: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def hear(self, block: SignalBlock) -> None:
        """Take a block that has a pressure [Pa]."""
        values = block.values[:, block.stream.columns_of({"pressure"})[0]]
        sound = np.isfinite(values) & (values > 0)
        times = np.concatenate([self._time_ns, block.sample_times()[sound]])
        keep = times >= block.start_ns - round(MEMORY_S * NS_PER_S)
        self._time_ns = times[keep]
        self._pressure = np.concatenate([self._pressure, values[sound]])[keep]

    def height_m(self, time_ns: int) -> float:
        """Return the height over the first time asked for [m]; NaN where it is not known.

        By the barometric formula of an atmosphere of one temperature.
        """
        pressure = step_kernels.mean_near(
            self._time_ns, self._pressure, time_ns, round(AVERAGE_S * NS_PER_S)
        )
        if math.isnan(pressure):
            return math.nan
        if math.isnan(self.start_pa):
            self.start_pa = pressure
        return SCALE_HEIGHT_M * math.log(self.start_pa / pressure)
