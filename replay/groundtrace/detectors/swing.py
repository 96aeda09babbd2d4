"""Rest and swing: steps by a machine that follows the acceleration through four thresholds.

Source: Dempster-Shafer thesis, chapter I (detection of rest and swing periods): a step is found
where the acceleration passes four thresholds one after the other, the first and the third rising,
the second and the fourth falling, with a rule on the difference of maximum and minimum and a limit
of the time between them (Pratama et al. 2012). The documents give no values; the defaults here are
ours. The third and the fourth threshold count from the extreme before, since a walk that ends
swings back to rest and not beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..dsp.filters import CentredWindow
from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import CHAINED, Context, Curve, Input, Measured, Memory, Stage
from .body_signals import (
    OPEN_CUTOFF_HZ,
    OPEN_GRAVITY_HZ,
    SHIFTED_S,
    WalkingSignal,
    walking_forgotten_s,
)
from .trace import TRACE, FrameTrace, WholeFrames, trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SwingParameters:
    """Parameters of :class:`SwingDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lead_s: Annotated[float, measured("s", "Initial contact precedes its peak by this.", ge=0)] = (
        0.05
    )
    turn: Annotated[
        float, measured("m/s2", "Way back that ends a rise or a fall; less is no swing.", gt=0)
    ] = 0.3
    rest_s: Annotated[
        float, measured("s", "The machine rests this long after a peak, wherever it is.", gt=0)
    ] = 2.0
    peak: Annotated[float, gate("m/s2", "First threshold, rising: the peak.", ge=0)] = 0.3
    valley: Annotated[float, gate("m/s2", "Second, falling: depth of the valley.", ge=0)] = 0.1
    rebound: Annotated[float, gate("m/s2", "Third, rising: way up out of it.", ge=0)] = 0.3
    settle: Annotated[float, gate("m/s2", "Fourth, falling: way down after that.", ge=0)] = 0.1
    swing: Annotated[float, gate("m/s2", "Least difference of peak and valley.", ge=0)] = 0.6
    delay_s: Annotated[float, gate("s", "Longest time from peak to valley.", ge=0)] = 0.6
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3


@dataclass(slots=True)
class _State:
    whole_frames: WholeFrames
    walking: WalkingSignal
    trace: FrameTrace
    signal: CentredWindow
    rate_hz: float
    reach: int  # samples the machine follows a swing, and looks back for its rise
    curve: Curve | None = None


class SwingDetector(Stage):
    """A step is a swing up, down, up and down again, wide enough, quick enough and in time."""

    Parameters = SwingParameters
    takes = (Input(SignalBlock, frozenset({"acceleration"})),)
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    columns = (
        Quantity("peak", "m/s2"),
        Quantity("valley", "m/s2"),
        Quantity("rebound", "m/s2"),
        Quantity("settle", "m/s2"),
        Quantity("swing", "m/s2"),
        Quantity("delay", "s"),
    )
    sought = "a maximum between two turns"
    trace = trace_of(Quantity("peak", "m/s2"), "m/s2", "m/s2")
    gates = (
        Level("peak", "m/s2", "peak"),
        Level("valley", "m/s2", "valley"),
        Level("rebound", "m/s2", "rebound"),
        Level("settle", "m/s2", "settle"),
        Level("swing", "m/s2", "swing"),
        Level("delay", "s", "delay_s", at_least=False),
        Refractory(),
    )

    @classmethod
    def unfiltered(cls, parameters: SwingParameters) -> tuple[type[SwingDetector], SwingParameters]:
        """Return what measures the same with the low-pass and the high-pass wide open."""
        return cls, replace(parameters, cutoff_hz=OPEN_CUTOFF_HZ, gravity_hz=OPEN_GRAVITY_HZ)

    def __init__(self, parameters: SwingParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """That of the filters, the machine, and the refractory time; and the swing that follows."""
        p = self.parameters
        held_s = walking_forgotten_s(p.cutoff_hz, p.gravity_hz) + CHAINED * p.refractory_s
        return Memory(held_s + 2 * p.rest_s, p.rest_s + SHIFTED_S).behind([TRACE])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        stream = context.stream
        p, rate = self.parameters, stream.rate_hz
        reach = max(1, round(p.rest_s * rate))
        trace = FrameTrace(rate, 1)
        self.state = _State(
            WholeFrames(trace.length),
            WalkingSignal(rate, p.cutoff_hz, p.gravity_hz),
            trace,
            CentredWindow(1, reach, reach),
            rate,
            reach,
        )
        return ("norm",)

    def process(self, block: SignalBlock) -> Measured:
        """Find the swings; each waits until the machine would be at rest again."""
        state = self.state
        block = state.whole_frames.of(block)
        if not len(block):
            return Measured(Candidates.empty(len(self.columns)), state.trace.nothing())
        norm, y = state.walking(block)
        times = block.sample_times()
        frames = state.trace.add(times, y, np.abs(y), y * y, norm, norm)
        state.curve = Curve(times - state.walking.delay_ns, y.T)
        return Measured(self._look(state.signal.add(times, y)), frames)

    def curve(self) -> Curve | None:
        """Return the filtered norm of the last block, the filter's delay taken out."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run; the machine stops wherever it is."""
        return Measured(self._look(self.state.signal.flush()), self.state.trace.flush())

    def _look(self, columns: range) -> Candidates:
        p, state = self.parameters, self.state
        x = state.signal.values[0]
        peaks = [int(i) for i in state.signal.maxima(columns) if self._is_swing(x, int(i))]
        shift_ns = state.walking.delay_ns + round(p.lead_s * NS_PER_S)
        return Candidates(
            state.signal.times[peaks] - shift_ns,
            np.zeros(len(peaks), np.int32),
            np.array([self._followed(x, i) for i in peaks], np.float32).reshape(
                -1, len(self.columns)
            ),
        )

    def _is_swing(self, x: NDArray[np.float64], peak: int) -> bool:
        """Whether the signal comes up to a maximum, and leaves it, by more than a turn."""
        turn, reach = self.parameters.turn, self.state.reach
        before = x[max(0, peak - reach) : peak][::-1]
        after = x[peak + 1 : peak + 1 + reach]
        return all(_falls_first(side - x[peak], turn) for side in (before, after))

    def _followed(self, x: NDArray[np.float64], peak: int) -> tuple[float, ...]:
        """Follow the swing from its peak; return the columns."""
        turn = self.parameters.turn
        way = x[peak : peak + 1 + self.state.reach]
        valley = extreme(-way, turn)
        rebound = valley + extreme(way[valley:], turn)
        settle = rebound + extreme(-way[rebound:], turn)
        return (
            way[0],
            -way[valley],
            way[rebound] - way[valley],
            way[rebound] - way[settle],
            way[0] - way[valley],
            valley / self.state.rate_hz,
        )


def _falls_first(relative: NDArray[np.float64], turn: float) -> bool:
    """Whether a stretch falls by ``turn`` before it rises above where it began."""
    leaves = np.flatnonzero((relative <= -turn) | (relative > 0))
    return bool(len(leaves)) and bool(relative[leaves[0]] < 0)


def extreme(way: NDArray[np.float64], turn: float) -> int:
    """Return the index of the highest value before the signal has come back by ``turn``."""
    reversals = np.flatnonzero(np.maximum.accumulate(way) - way >= turn)
    return int(np.argmax(way[: reversals[0]] if len(reversals) else way))
