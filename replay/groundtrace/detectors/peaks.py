"""DP: steps by peak detection on the norm of the acceleration.

Source: Zeng et al. 2015 as described in the Dempster-Shafer thesis (peak detection, section IV.2
and the comparison of chapter IV). The documents give no parameters; the defaults here are ours. At
the waist the peak of the loading response comes about 50 ms after the initial contact; this delay
is subtracted from the times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Curve, Input, Measured, Memory, Stage
from .body_signals import OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ, SHIFTED_S, Activity, WalkingSignal
from .trace import TRACE, FrameTrace, trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class PeakParameters:
    """Parameters of :class:`PeakDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lead_s: Annotated[float, measured("s", "Initial contact precedes its peak by this.", ge=0)] = (
        0.05
    )
    around_s: Annotated[float, measured("s", "Time before and after that is around.", gt=0)] = 1.0
    floor: Annotated[float, measured("m/s2", "Lowest peak kept as a candidate.", ge=0)] = 0.05
    height: Annotated[float, gate("m/s2", "Lowest peak that is a step.", ge=0)] = 0.4
    swing: Annotated[float, gate("m/s2", "Least rise from the valley before.", ge=0)] = 0.8
    activity: Annotated[float, gate("m/s2", "Lowest level around it that is walking.", ge=0)] = 0.2
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3


class _Peak(NamedTuple):
    sample: int
    time_ns: int
    height: float
    swing: float


@dataclass(slots=True)
class _State:
    walking: WalkingSignal
    trace: FrameTrace
    activity: Activity
    values: NDArray[np.float64]  # the last two samples, which may hold a maximum
    times: NDArray[np.int64]
    lowest: float  # since the last maximum
    waiting: list[_Peak]  # maxima whose surroundings are not complete
    curve: Curve | None = None


class PeakDetector(Stage):
    """A step is a peak high enough, over its valley far enough, among walking, and in time."""

    Parameters = PeakParameters
    takes = (Input(SignalBlock, frozenset({"acceleration"})),)
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    columns = (Quantity("height", "m/s2"), Quantity("swing", "m/s2"), Quantity("activity", "m/s2"))
    trace = trace_of(Quantity("height", "m/s2"), "m/s2", "m/s2")
    gates = (
        Level("height", "m/s2", "height"),
        Level("swing", "m/s2", "swing"),
        Level("activity", "m/s2", "activity"),
        Refractory(),
    )

    @classmethod
    def unfiltered(cls, parameters: PeakParameters) -> tuple[type[PeakDetector], PeakParameters]:
        """Return what measures the same with the low-pass and the high-pass wide open."""
        return cls, replace(parameters, cutoff_hz=OPEN_CUTOFF_HZ, gravity_hz=OPEN_GRAVITY_HZ)

    def __init__(self, parameters: PeakParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """All before: a swing begins with the last peak; and what is around a peak."""
        return Memory(None, self.parameters.around_s + SHIFTED_S).behind([TRACE])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        stream = context.stream
        p = self.parameters
        self.state = _State(
            WalkingSignal(stream.rate_hz, p.cutoff_hz, p.gravity_hz),
            FrameTrace(stream.rate_hz, 1),
            Activity(round(p.around_s * stream.rate_hz)),
            np.empty(0),
            np.empty(0, np.int64),
            np.inf,
            [],
        )
        return ("norm",)

    def process(self, block: SignalBlock) -> Measured:
        """Find the local maxima; each waits until its surroundings are complete."""
        state = self.state
        norm, y = state.walking(block)
        frames = state.trace.add(block.sample_times(), y, np.abs(y), y * y, norm, norm)
        state.curve = Curve(block.sample_times() - state.walking.delay_ns, y.T)
        first = state.activity.end - len(state.values)
        state.activity.add(y[0])
        values = np.concatenate([state.values, y[0]])
        times = np.concatenate([state.times, block.sample_times()])
        state.values, state.times = values[-2:], times[-2:]
        peaks = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
        peaks = peaks[values[peaks] > self.parameters.floor]
        swings = self._swings(values[1:-1], peaks - 1)
        state.waiting += [
            _Peak(first + int(i), int(times[i]), float(values[i]), float(swing))
            for i, swing in zip(peaks, swings, strict=True)
        ]
        return Measured(self._complete(state.activity.end - state.activity.reach), frames)

    def curve(self) -> Curve | None:
        """Return the filtered norm of the last block, the filter's delay taken out."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run; a maximum at its very end is not one."""
        return Measured(self._complete(self.state.activity.end), self.state.trace.flush())

    def _complete(self, end: int) -> Candidates:
        """Return the maxima before sample ``end`` of the run, and forget what they needed."""
        state = self.state
        ready = [peak for peak in state.waiting if peak.sample < end]
        state.waiting = state.waiting[len(ready) :]
        shift_ns = state.walking.delay_ns + round(self.parameters.lead_s * NS_PER_S)
        rows = [(p.height, p.swing, state.activity.around(p.sample)) for p in ready]
        state.activity.discard_before(state.waiting[0].sample if state.waiting else end)
        return Candidates(
            np.array([peak.time_ns - shift_ns for peak in ready], np.int64),
            np.zeros(len(ready), np.int32),
            np.array(rows, np.float32).reshape(-1, len(self.columns)),
        )

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
