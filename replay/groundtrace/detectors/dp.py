"""DP: steps by peak detection on the norm of the acceleration.

Source: Zeng et al. 2015 as described in the Dempster-Shafer thesis (peak detection, section IV.2
and the comparison of chapter IV). The documents give no parameters; the defaults here are ours. The
peak of the loading response comes about 50 ms after the initial contact at the waist, which is
taken out of the times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..detector import Emits, Measured
from ..gates import Candidates, Level, Refractory
from ..parameters import gate, measured
from .frames import FrameTrace
from .walking import WalkingSignal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream


@dataclass(frozen=True, slots=True)
class PeakParameters:
    """Parameters of :class:`PeakDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lead_s: Annotated[float, measured("s", "Initial contact precedes its peak by this.", ge=0)] = (
        0.05
    )
    floor: Annotated[float, measured("m/s2", "Lowest peak kept as a candidate.", ge=0)] = 0.05
    height: Annotated[float, gate("m/s2", "Lowest peak that is a step.", ge=0)] = 0.4
    swing: Annotated[float, gate("m/s2", "Least rise from the valley before.", ge=0)] = 0.8
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3


@dataclass(slots=True)
class _State:
    walking: WalkingSignal
    trace: FrameTrace
    values: NDArray[np.float64]
    times: NDArray[np.int64]
    lowest: float


class PeakDetector:
    """A step is a peak that is high enough, rises far enough from its valley, and comes in time."""

    Parameters = PeakParameters
    quantities = frozenset({"acceleration"})
    emits: Emits = "step"
    columns = (Quantity("height", "m/s2"), Quantity("swing", "m/s2"))
    trace = (Quantity("height", "m/s2"), Quantity("peak", "m/s2"), Quantity("noise", "m/s2"))
    gates = (
        Level("height", "m/s2", "height"),
        Level("swing", "m/s2", "swing"),
        Refractory(),
    )

    def __init__(self, parameters: PeakParameters) -> None:
        self.parameters = parameters

    def start(self, stream: Stream) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        p = self.parameters
        self.state = _State(
            WalkingSignal(stream.rate_hz, p.cutoff_hz, p.gravity_hz),
            FrameTrace(stream.rate_hz, 1),
            np.empty(0),
            np.empty(0, np.int64),
            np.inf,
        )
        return ("norm",)

    def measure(self, block: SignalBlock) -> Measured:
        """Find the local maxima; a maximum is known one sample later."""
        state = self.state
        y = state.walking(block)
        frames = state.trace.add(block.sample_times(), y, np.abs(y), y * y)
        values = np.concatenate([state.values, y[0]])
        times = np.concatenate([state.times, block.sample_times()])
        state.values, state.times = values[-2:], times[-2:]
        peaks = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
        peaks = peaks[values[peaks] > self.parameters.floor]
        swing = self._swings(values[1:-1], peaks - 1)
        return Measured(
            Candidates(
                times[peaks] - state.walking.delay_ns - round(self.parameters.lead_s * NS_PER_S),
                np.zeros(len(peaks), np.int32),
                np.column_stack([values[peaks], swing]).astype(np.float32),
            ),
            frames,
        )

    def finish(self) -> Measured:
        """End the run; a maximum at its very end is not one."""
        return Measured(Candidates.empty(len(self.columns)), self.state.trace.finish())

    def _swings(self, settled: NDArray[np.float64], peaks: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the rise of each peak from the lowest value since the peak before it."""
        swings = np.empty(len(peaks))
        start = 0
        for row, peak in enumerate(peaks):
            low = settled[start:peak].min(initial=self.state.lowest)
            swings[row] = settled[peak] - low
            self.state.lowest, start = np.inf, int(peak)
        self.state.lowest = float(settled[start:].min(initial=self.state.lowest))
        return swings
