"""Adaptive: steps as the dominant peaks of a rhythm, at any place on the body and any rate.

1. The specific force is brought to an even grid and taken along gravity (:mod:`.upward`).
2. Its rhythm is followed: how strongly it repeats itself, and after which time (:mod:`.rhythm`).
3. It is filtered by the step time that this gives (:mod:`.adaptive_band`).
4. Local maxima are candidates; a step is one that rises far enough, is the highest within half a
   step time, and stands in a rhythm.

At the trunk the initial contact lies on the rise: the vertical acceleration turns upward before it
and peaks 50 to 100 ms after it (Zijlstra and Hof, Gait & Posture 18, 2003, show the order of
events; the part of the rise is ours). Elsewhere no such relation is known and steps are timed at
the peak.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import SignalBlock

from ..detector import Curve, Measured, joined
from ..gates import Candidates, Level
from ..parameters import gate, measured
from ..stage import Context, Input, Stage
from .adaptive_band import Followed, StepBand
from .adaptive_peaks import Peaks
from .even_grid import GRID_HZ, Kept
from .filters import HIGHEST_CORNER
from .frames import FrameTrace, trace_of
from .rhythm import Scale
from .upward import FORCE, MAGNITUDE, Upward, UpwardPart

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..detector import Frames

#: Placements at which the sensor moves with the body's mass, and hardly ever without steps.
TRUNK = frozenset({"waist", "trunk"})
#: At the trunk a few steps are a walk; a hand or pocket must keep its rhythm for longer.
_TRUNK_SCALES = (Scale(4.0, 2),)
_OTHER_SCALES = (Scale(8.0, 2), Scale(12.0, 3))


@dataclass(frozen=True, slots=True)
class AdaptiveParameters:
    """Parameters of :class:`AdaptiveDetector`."""

    placement: Annotated[
        Literal["", "waist", "trunk", "foot", "wrist", "phone"],
        measured("", "Where the sensor is worn; empty takes the recording's word."),
    ] = ""
    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.5
    ahead_s: Annotated[float, measured("s", "How far ahead the rhythm is looked for.", ge=0)] = 6.0
    rise: Annotated[
        float,
        measured("1", "Part of the rise at which a step at the trunk is timed.", gt=0, le=1),
    ] = 0.8
    floor: Annotated[float, measured("m/s2", "Lowest peak kept as a candidate.", ge=0)] = 0.05
    swing: Annotated[float, gate("m/s2", "Least rise from the valley before.", ge=0)] = 0.2
    share: Annotated[float, gate("1", "Least part of the rhythm's usual swing.", ge=0)] = 0.15
    dominance: Annotated[
        float, gate("1", "Least time to a higher peak, in step times.", ge=0, le=1)
    ] = 0.55
    rhythm: Annotated[float, gate("1", "Least strength of the rhythm around it.", ge=0, le=1)] = (
        0.38
    )


@dataclass(slots=True)
class _State:
    upward: Upward
    band: StepBand
    peaks: Peaks
    trace: FrameTrace
    start_ns: int | None
    waiting: Kept  # time since the start [ns] and recorded norm, until the band is known
    times: Kept  # time since the start [ns], until the peaks are known
    curve: Curve | None = None


class AdaptiveDetector(Stage):
    """A step is a peak that rises far enough, dominates its step time, and keeps the rhythm."""

    Parameters = AdaptiveParameters
    takes = (Input(SignalBlock, FORCE | MAGNITUDE),)
    #: Of a signal in unknown units, see :class:`.upward.Upward`.
    mean_is_gravity = True
    gives = (StepEvent,)
    columns = (
        Quantity("height", "m/s2"),
        Quantity("swing", "m/s2"),
        Quantity("share", "1"),
        Quantity("dominance", "1"),
        Quantity("rhythm", "1"),
        Quantity("step_time", "s"),
    )
    trace = trace_of(Quantity("height", "m/s2"), "m/s2", "m/s2")
    gates = (
        Level("swing", "m/s2", "swing"),
        Level("share", "1", "share"),
        Level("dominance", "1", "dominance"),
        Level("rhythm", "1", "rhythm"),
    )

    #: Whether peaks are looked for in the band of the steps, or in all that is quicker than them.
    in_band = True

    @classmethod
    def unfiltered(
        cls, parameters: AdaptiveParameters
    ) -> tuple[type[AdaptiveDetector], AdaptiveParameters]:
        """Return what measures the same on the signal of the grid, only its slow part taken out."""
        return _UnfilteredDetector, replace(parameters, cutoff_hz=HIGHEST_CORNER * GRID_HZ)

    def __init__(self, parameters: AdaptiveParameters) -> None:
        self.parameters = parameters

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the acceleration upward is one channel."""
        stream = context.stream
        p = self.parameters
        trunk = (p.placement or stream.placement) in TRUNK
        self.state = _State(
            Upward(stream, p.cutoff_hz),
            StepBand(_TRUNK_SCALES if trunk else _OTHER_SCALES, p.ahead_s, fine=self.in_band),
            Peaks(p.floor, p.rise if trunk else 0.0),
            FrameTrace(GRID_HZ, 1),
            None,
            Kept(2),
            Kept(),
        )
        return ("up",)

    def process(self, block: SignalBlock) -> Measured:
        """Follow the rhythm; a maximum waits until its surroundings are complete."""
        state = self.state
        if state.start_ns is None and len(block):
            state.start_ns = block.start_ns
        part = state.upward(block)
        self._wait(part)
        followed = state.band(part.up)
        return self._measured(followed, state.peaks(followed))

    def flush(self) -> Measured:
        """End the run; what waited for more is judged by what there is."""
        state = self.state
        part = state.upward.finish()
        self._wait(part)
        ends = state.band(part.up), state.band.finish()
        followed = Followed(*(np.concatenate(points) for points in zip(*ends, strict=True)))
        found = np.concatenate([state.peaks(followed), state.peaks.finish()])
        whole = self._measured(followed, found)
        return joined(whole, Measured(Candidates.empty(len(self.columns)), state.trace.finish()))

    def curve(self) -> Curve | None:
        """Return the band of the steps over what the last ``process`` or ``flush`` completed."""
        return self.state.curve

    def _wait(self, part: UpwardPart) -> None:
        state = self.state
        since = (part.time_ns - (state.start_ns or 0)).astype(np.float64)[None, :]
        state.times.add(since)
        state.waiting.add(np.concatenate([since, part.recorded]))

    def _measured(self, followed: Followed, found: NDArray[np.float64]) -> Measured:
        return Measured(self._candidates(found), self._frames(followed.band))

    def _frames(self, band: NDArray[np.float64]) -> Frames:
        state = self.state
        start = state.waiting.first
        since, norm = state.waiting.between(start, start + len(band))
        state.waiting.forget_before(start + len(band))
        times = since.astype(np.int64) + (state.start_ns or 0)
        state.curve = Curve(times, band[:, None])
        z, norm = band[None, :], norm[None, :]
        return state.trace.add(times, z, np.abs(z), z * z, norm, norm)

    def _candidates(self, found: NDArray[np.float64]) -> Candidates:
        state = self.state
        if not len(found):
            return Candidates.empty(len(self.columns))
        places = found[:, 0] - state.times.first
        since = state.times.values[0]
        time_ns = np.interp(places, np.arange(len(since)), since)
        state.times.forget_before(int(found[-1, 0]) - 1)
        return Candidates(
            np.rint(time_ns).astype(np.int64) + (state.start_ns or 0),
            np.zeros(len(found), np.int32),
            found[:, 1:].astype(np.float32),
        )


class _UnfilteredDetector(AdaptiveDetector):
    """Finds peaks in all that is quicker than a step."""

    in_band = False
