"""ZC: steps by upward zero crossings of the norm of the acceleration without gravity.

Source: Dempster-Shafer thesis, chapter IV, section V (the zero-crossing method compared with):
gravity is removed, values above zero are peaks, values below zero valleys. The documents give no
parameters; the defaults here are ours. The method is sensitive to small variations around zero,
which is why the lobe that follows a crossing must rise high enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Curve, Input, Measured, Memory, Stage
from .body_signals import OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ, SHIFTED_S, WalkingSignal
from .trace import TRACE, FrameTrace, trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class CrossingParameters:
    """Parameters of :class:`ZeroCrossingDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lobe: Annotated[float, gate("m/s2", "Least height of the lobe after it.", ge=0)] = 0.4
    depth: Annotated[float, gate("m/s2", "Least depth of the valley before it.", ge=0)] = 0.2
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3


@dataclass(slots=True)
class _State:
    walking: WalkingSignal
    trace: FrameTrace
    last: float | None  # sample before the block
    crossed_ns: int | None  # crossing whose lobe is still open
    depth: float  # depth of the valley before that crossing
    extreme: float  # largest absolute value of the lobe or valley under way
    curve: Curve | None = None


class ZeroCrossingDetector(Stage):
    """A step is an upward zero crossing between a deep enough valley and a high enough lobe.

    A lobe lasts for a period of the high-pass at most: what is slower is no swing of a step.
    """

    Parameters = CrossingParameters
    takes = (Input(SignalBlock, frozenset({"acceleration"})),)
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    columns = (Quantity("lobe", "m/s2"), Quantity("depth", "m/s2"))
    sought = "an upward zero crossing"
    trace = trace_of(Quantity("lobe", "m/s2"), "m/s2", "m/s2")
    gates = (Level("lobe", "m/s2", "lobe"), Level("depth", "m/s2", "depth"), Refractory())

    @classmethod
    def unfiltered(
        cls, parameters: CrossingParameters
    ) -> tuple[type[ZeroCrossingDetector], CrossingParameters]:
        """Return what measures the same with the low-pass and the high-pass wide open."""
        return cls, replace(parameters, cutoff_hz=OPEN_CUTOFF_HZ, gravity_hz=OPEN_GRAVITY_HZ)

    def __init__(self, parameters: CrossingParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """All before, where a valley begins; and the longest lobe after a crossing."""
        return Memory(None, 1 / self.parameters.gravity_hz + SHIFTED_S).behind([TRACE])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        stream = context.stream
        p = self.parameters
        self.state = _State(
            WalkingSignal(stream.rate_hz, p.cutoff_hz, p.gravity_hz),
            FrameTrace(stream.rate_hz, 1),
            last=None,
            crossed_ns=None,
            depth=0.0,
            extreme=0.0,
        )
        return ("norm",)

    def process(self, block: SignalBlock) -> Measured:
        """Find the crossings; one is complete when its lobe ends."""
        state = self.state
        norm, y = state.walking(block)
        frames = state.trace.add(block.sample_times(), y, np.abs(y), y * y, norm, norm)
        state.curve = Curve(block.sample_times() - state.walking.delay_ns, y.T)
        before = y[0, 0] if state.last is None else state.last
        signal = np.concatenate([[before], y[0]])
        state.last = float(signal[-1])
        turns = np.flatnonzero((signal[:-1] < 0) != (signal[1:] < 0))  # index in the block
        return Measured(self._close(block, signal, turns), frames)

    def curve(self) -> Curve | None:
        """Return the filtered norm of the last block, the filter's delay taken out."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run; a lobe that has not ended is not one."""
        return Measured(Candidates.empty(len(self.columns)), self.state.trace.flush())

    def _close(
        self, block: SignalBlock, signal: NDArray[np.float64], turns: NDArray[np.intp]
    ) -> Candidates:
        """Walk through the changes of sign; every end of a lobe completes its crossing."""
        state, longest_ns = self.state, NS_PER_S / self.parameters.gravity_hz
        rows: list[tuple[int, float, float]] = []
        start = 0
        for turn in turns:
            lobe = np.abs(signal[1 + start : 1 + turn]).max(initial=state.extreme)
            state.extreme, start = 0.0, int(turn)
            if signal[turn + 1] >= 0:
                state.crossed_ns = _crossing_ns(block, signal, int(turn))
                state.depth = lobe
            elif state.crossed_ns is not None:
                if _crossing_ns(block, signal, int(turn)) - state.crossed_ns <= longest_ns:
                    rows.append((state.crossed_ns - state.walking.delay_ns, lobe, state.depth))
                state.crossed_ns = None
        state.extreme = float(np.abs(signal[1 + start :]).max(initial=state.extreme))
        values = np.array([row[1:] for row in rows], np.float32).reshape(-1, 2)
        times = np.array([row[0] for row in rows], np.int64)
        return Candidates(times, np.zeros(len(rows), np.int32), values)


def _crossing_ns(block: SignalBlock, signal: NDArray[np.float64], turn: int) -> int:
    """Return the time of the zero between sample ``turn - 1`` and ``turn`` of the block [ns]."""
    before, after = signal[turn], signal[turn + 1]
    back = float(after / (after - before)) * block.stream.period_ns
    return block.time_of(turn) - round(back)
