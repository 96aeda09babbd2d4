"""What step detectors of worn sensors look at: the acceleration upward, on the even grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.units import UNKNOWN_UNITS

from .even_grid import EvenGrid, GridPart
from .filters import planar
from .gravity import CountScale, Gravity, along

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

FORCE = frozenset({"acceleration"})
MAGNITUDE = frozenset({"acceleration_magnitude"})


@dataclass(frozen=True, slots=True, eq=False)
class UpwardPart:
    """Consecutive points of the grid.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    up
        Specific force upward, low-passed, shape (1, n) [m/s2].
    recorded
        Norm of the specific force as recorded, shape (1, n) [m/s2].
    """

    time_ns: NDArray[np.int64]
    up: NDArray[np.float64]
    recorded: NDArray[np.float64]


class Upward:
    """Gives the specific force along gravity, however the sensor is turned.

    Of a sensor that gives a magnitude only, the magnitude. Where the unit is unknown, the mean of
    the length is taken to be gravity.

    Parameters
    ----------
    stream
        Its acceleration axes, or else its magnitude, are used.
    cutoff_hz
        Corner of the low-pass [Hz].
    """

    def __init__(self, stream: Stream, cutoff_hz: float) -> None:
        self._columns = stream.columns_of(FORCE) or stream.columns_of(MAGNITUDE)[:1]
        channels = stream.select(self._columns).channels
        unknown = channels[0].unit in UNKNOWN_UNITS
        self._scale = CountScale(stream.rate_hz) if unknown else None
        self._gravity = Gravity() if len(channels) > 1 else None
        self._grid = EvenGrid(stream.rate_hz, cutoff_hz)
        self._times = np.empty(0, np.int64)
        self._recorded = np.empty((1, 0))

    def __call__(self, block: SignalBlock) -> UpwardPart:
        """Take a block; return the points that are complete by now."""
        values = planar(block.select(self._columns))
        if self._scale is not None:
            values = self._scale(values)
        part = self._grid(block.sample_times(), values)
        if self._gravity is None:
            return UpwardPart(part.time_ns, part.values, np.abs(part.recorded))
        self._wait(part)
        return self._waited(along(*self._gravity(part.values)))

    def finish(self) -> UpwardPart:
        """Return the points up to the end of the run."""
        part = self._grid.finish()
        if self._gravity is None:
            return UpwardPart(part.time_ns, part.values, np.abs(part.recorded))
        self._wait(part)
        now = along(*self._gravity(part.values))
        return self._waited(np.concatenate([now, along(*self._gravity.finish())], axis=1))

    def _wait(self, part: GridPart) -> None:
        norm = np.sqrt(np.einsum("cn,cn->n", part.recorded, part.recorded))[None, :]
        self._times = np.concatenate([self._times, part.time_ns])
        self._recorded = np.concatenate([self._recorded, norm], axis=1)

    def _waited(self, up: NDArray[np.float64]) -> UpwardPart:
        count = up.shape[1]
        part = UpwardPart(self._times[:count], up, self._recorded[:, :count])
        self._times, self._recorded = self._times[count:], self._recorded[:, count:]
        return part
