"""Adaptive: steps by score or by rhythm, at any place on the body and any rate.

The specific force is brought to an even grid and taken along gravity (``.body_signals``). At
waist and trunk a step is then told by its score (``.step_score``); elsewhere, and where nobody
knows the place, by its rhythm:

1. The rhythm is tracked: how strongly the signal repeats itself, and after which time
   (``.dsp.periodicity``).
2. It is filtered by the step time that this gives (``StepBand``).
3. Local maxima are candidates; a step is one that rises far enough, is the highest within half a
   step time, stands in a rhythm, and is not of a sensor that somebody turns about: a sensor on a
   walker is turned against gravity as before after each stride.

Where the rhythm is asked for at the trunk, the initial contact lies on the rise: the vertical
acceleration turns upward before it and peaks 50 to 100 ms after it (Zijlstra and Hof, Gait &
Posture 18, 2003, show the order of events; the part of the rise is ours). Elsewhere no such
relation is known and steps are timed at the peak.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import SignalBlock

from .. import kernels
from ..dsp.filters import HIGHEST_CORNER
from ..dsp.periodicity import HOP, PERIODS_S, Rhythm, Scale
from ..dsp.resample import GRID_HZ, CentredFilter, ColumnBuffer, gaussian, lowpass
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import CannotStart, Context, Curve, Input, Measured, Memory, Stage, joined
from .body_signals import FORCE, MAGNITUDE, Upward, UpwardPart
from .step_score import (
    APART_STEPS,
    LEAST_LIKENESS,
    TAPS,
    Scores,
    StepWindows,
    Surroundings,
    Windows,
    judged,
    moving,
    probability,
    scores,
    trained,
)
from .trace import TRACE, FrameTrace, trace_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from ..pipeline.gates import Gate
    from ..pipeline.stage import Frames

#: Placements at which the sensor moves with the body's mass, and hardly ever without steps.
TRUNK = frozenset({"waist", "trunk"})
#: At the trunk a few steps are a walk; a hand or pocket must keep its rhythm for longer. Chosen by
#: judgement: weak on purpose, no short walk is lost (docs/limits.md).
_TRUNK_SCALES = (Scale(4.0, 2),)
#: Windows [s] and how many of them must agree: a hand or a pocket must keep its rhythm for longer
#: than a trunk. Chosen by trial on rieck-stepcounter (docs/accuracy/steps.md).
_OTHER_SCALES = (Scale(8.0, 2), Scale(12.0, 3))
#: What averages, bands and looks ahead at a step reach beyond the rhythm together [s]. Source:
#: definitions: 2.5 for gravity, 0.5 to 1.4 for the grid, 1.6 for the band; 2.0 more of the score,
#: whose surroundings are looked at.
AVERAGED_S = 8.0
#: Axes of acceleration among which forward is looked for. Source: definition.
_AXES = 3


@dataclass(frozen=True, slots=True)
class AdaptiveParameters:
    """Parameters of :class:`AdaptiveDetector`."""

    placement: Annotated[
        Literal["", "waist", "trunk", "foot", "wrist", "phone"],
        measured("", "Where the sensor is worn; empty takes the recording's word."),
    ] = ""
    method: Annotated[
        Literal["", "rhythm", "score"],
        measured(
            "", "What tells steps; empty takes the score at waist and trunk, else the rhythm."
        ),
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
    tilt: Annotated[
        float,
        gate("deg", "Most turn against gravity in 2 s, the median of 8 s around it.", ge=0, le=180),
    ] = 25.0
    score: Annotated[float, gate("1", "Least score, where steps are told by it.", ge=0, le=1)] = 0.4
    apart: Annotated[
        float, gate("1", "Least time to a higher likeness, in step times.", ge=0, le=APART_STEPS)
    ] = 0.36


class Detection(NamedTuple):
    """What consecutive points of the grid show.

    Attributes
    ----------
    decision
        The decision function, shape (n,).
    filtered
        Acceleration upward as it is looked at, shape (n,) [m/s2].
    rows
        A row for each candidate, shape (k, 1 + columns): its place [points of the grid since the
        start of the run], and what is measured of it.
    """

    decision: NDArray[np.float64]
    filtered: NDArray[np.float64]
    rows: NDArray[np.float64]


class Method(Protocol):
    """One of the ways in which steps are told."""

    columns: tuple[Quantity, ...]
    gates: tuple[Gate, ...]

    def __call__(self, part: UpwardPart) -> Detection:
        """Take points of the grid; return what is known by now."""

    def flush(self, part: UpwardPart) -> Detection:
        """Take the last points; return all that is not known yet."""


#: A rhythm as strong as this is rather of a walk, and turns count for this part. Chosen by trial on
#: 18 recordings of step-detector, where 14 of 16 steps of who turns a phone come back, and logs of
#: IPIN 2023, where a twentieth of the false steps of who waves one does.
STEADY, STEADY_PART = 0.8, 0.5
#: Column of the rhythm behind the place of a peak. Source: definition.
_RHYTHM = 5


class ByRhythm:
    """A step is a peak that rises far enough, dominates its step time, and keeps the rhythm.

    It is none where the sensor is being handled. Who walks on while turning it keeps a steady
    rhythm, where ``tilt`` is half of what the sensor turns by.
    """

    columns: tuple[Quantity, ...] = (
        Quantity("height", "m/s2"),
        Quantity("swing", "m/s2"),
        Quantity("share", "1"),
        Quantity("dominance", "1"),
        Quantity("rhythm", "1"),
        Quantity("step_time", "s"),
        Quantity("tilt", "deg"),
    )
    gates: tuple[Gate, ...] = (
        Level("swing", "m/s2", "swing"),
        Level("share", "1", "share"),
        Level("dominance", "1", "dominance"),
        Level("rhythm", "1", "rhythm"),
        Level("tilt", "deg", "tilt", at_least=False),
    )

    def __init__(self, parameters: AdaptiveParameters, *, trunk: bool, fine: bool) -> None:
        scales = _TRUNK_SCALES if trunk else _OTHER_SCALES
        self._band = StepBand(scales, parameters.ahead_s, fine=fine)
        self._peaks = Peaks(parameters.floor, parameters.rise if trunk else 0.0)
        self._tilt = Tilting(parameters.ahead_s)

    def __call__(self, part: UpwardPart) -> Detection:
        """Follow the rhythm; a maximum waits until its surroundings are complete."""
        self._tilt.add(part.gravity)
        followed = self._band(part.up)
        return self._detection(followed, self._peaks(followed))

    def flush(self, part: UpwardPart) -> Detection:
        """Judge what waited for more by what there is."""
        self._tilt.add(part.gravity)
        ends = self._band(part.up), self._band.flush()
        followed = Followed(*(np.concatenate(points) for points in zip(*ends, strict=True)))
        return self._detection(
            followed, np.concatenate([self._peaks(followed), self._peaks.flush()])
        )

    def _detection(self, followed: Followed, peaks: NDArray[np.float64]) -> Detection:
        tilts = [
            self._tilt.around(round(point)) * (STEADY_PART if rhythm >= STEADY else 1.0)
            for point, rhythm in peaks[:, [0, _RHYTHM]].tolist()
        ]
        rows = np.column_stack([peaks, np.array(tilts, np.float64)])
        self._tilt.discard_before(self._peaks.next - _BACK)
        return Detection(followed.band, followed.band, rows)


class ByScore:
    """A step is a moment that looks like one, more than all within a part of a step time."""

    columns: tuple[Quantity, ...] = (
        Quantity("likeness", "1"),
        Quantity("score", "1"),
        Quantity("apart", "1"),
        Quantity("vertical", "1"),
        Quantity("forward", "1"),
        Quantity("uncertainty", "s"),
        Quantity("step_time", "s"),
    )
    gates: tuple[Gate, ...] = (Level("score", "1", "score"), Level("apart", "1", "apart"))

    def __init__(self) -> None:
        self._windows = StepWindows()
        self._surroundings = Surroundings()

    def __call__(self, part: UpwardPart) -> Detection:
        """Score the points that are known; a maximum waits for those after it."""
        windows = self._windows(moving(part.force, part.gravity))
        point_scores = scores(windows.seen, trained())
        return self._scored(
            windows, point_scores, [self._surroundings(windows.seen, point_scores, windows.step_s)]
        )

    def flush(self, part: UpwardPart) -> Detection:
        """Judge what waited for more by what there is."""
        ends = self._windows(moving(part.force, part.gravity)), self._windows.flush()
        windows = Windows(*(np.concatenate(points) for points in zip(*ends, strict=True)))
        point_scores = scores(windows.seen, trained())
        last = self._surroundings(windows.seen, point_scores, windows.step_s)
        return self._scored(windows, point_scores, [last, self._surroundings.flush()])

    def _scored(
        self,
        windows: Windows,
        point_scores: Scores,
        candidates: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
    ) -> Detection:
        rows = np.concatenate([judged(*each, trained().candidate) for each in candidates])
        return Detection(probability(point_scores.odds), windows.seen[:, len(TAPS) // 2], rows)


@dataclass(slots=True)
class _State:
    upward: Upward
    method: Method
    trace: FrameTrace
    start_ns: int | None
    waiting: ColumnBuffer  # time since the start [ns] and recorded norm, until points are known
    times: ColumnBuffer  # time since the start [ns], until the peaks are known
    curve: Curve | None = None


class AdaptiveDetector(Stage):
    """A step is told by its score where the placement allows it, and elsewhere by its rhythm."""

    Parameters = AdaptiveParameters
    takes = (Input(SignalBlock, FORCE | MAGNITUDE),)
    #: Of a signal in unknown units, see :class:`.body_signals.Upward`.
    mean_is_gravity = True
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    columns = ByRhythm.columns
    trace = trace_of(Quantity("height", "m/s2"), "m/s2", "m/s2")
    gates = ByRhythm.gates + ByScore.gates
    #: Least that makes a candidate, where that is no parameter.
    floors: ClassVar = {"likeness": LEAST_LIKENESS}
    #: Columns that say what there is of a usual step.
    of_usual = ("vertical", "forward")
    #: How long the signal must be at least that tells a gate's value [s].
    told_by_s: ClassVar = dict.fromkeys(("share", "rhythm"), _TRUNK_SCALES[0].window_s)

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

    @property
    def memory(self) -> Memory:
        """All before, by which a step is judged; and the rhythm and the averages after a point."""
        return Memory(None, self.parameters.ahead_s + AVERAGED_S).behind([TRACE])

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the acceleration upward is one channel.

        Raises
        ------
        CannotStart
            Where steps are to be told by their score, and there are no three axes.
        """
        stream, p = context.stream, self.parameters
        self.state = _State(
            Upward(stream, p.cutoff_hz),
            self._method(stream),
            FrameTrace(GRID_HZ, 1),
            None,
            ColumnBuffer(2),
            ColumnBuffer(),
        )
        self.columns, self.gates = self.state.method.columns, self.state.method.gates
        self.trace = trace_of(self.columns[0], "m/s2", "m/s2")
        return ("up",)

    def _method(self, stream: Stream) -> Method:
        p, axes = self.parameters, len(stream.columns_of(FORCE))
        trunk = (p.placement or stream.placement) in TRUNK
        if p.method == "rhythm" or (not p.method and not (trunk and axes == _AXES)):
            return ByRhythm(p, trunk=trunk, fine=self.in_band)
        if axes != _AXES:
            raise CannotStart(f"method score: expected 3 axes of acceleration, found {axes}")
        return ByScore()

    def process(self, block: SignalBlock) -> Measured:
        """Look at what the block completes."""
        state = self.state
        if state.start_ns is None and len(block):
            state.start_ns = block.start_ns
        part = state.upward(block)
        self._wait(part)
        return self._measured(state.method(part))

    def flush(self) -> Measured:
        """End the run; what waited for more is judged by what there is."""
        state = self.state
        part = state.upward.flush()
        self._wait(part)
        remainder = self._measured(state.method.flush(part))
        return joined(remainder, Measured(Candidates.empty(len(self.columns)), state.trace.flush()))

    def curve(self) -> Curve | None:
        """Return the decision function over what the last ``process`` or ``flush`` completed."""
        return self.state.curve

    def _wait(self, part: UpwardPart) -> None:
        state = self.state
        since = (part.time_ns - (state.start_ns or 0)).astype(np.float64)[None, :]
        state.times.add(since)
        state.waiting.add(np.concatenate([since, part.recorded]))

    def _measured(self, detection: Detection) -> Measured:
        return Measured(self._candidates(detection.rows), self._frames(detection))

    def _frames(self, detection: Detection) -> Frames:
        state, count = self.state, len(detection.decision)
        start = state.waiting.first
        since, norm = state.waiting.between(start, start + count)
        state.waiting.discard_before(start + count)
        times = since.astype(np.int64) + (state.start_ns or 0)
        state.curve = Curve(times, detection.decision[:, None])
        z, norm = detection.filtered[None, :], norm[None, :]
        return state.trace.add(times, detection.decision[None, :], np.abs(z), z * z, norm, norm)

    def _candidates(self, rows: NDArray[np.float64]) -> Candidates:
        state = self.state
        if not len(rows):
            return Candidates.empty(len(self.columns))
        places = rows[:, 0] - state.times.first
        since = state.times.values[0]
        time_ns = np.interp(places, np.arange(len(since)), since)
        state.times.discard_before(int(rows[-1, 0]) - 1)
        return Candidates(
            np.rint(time_ns).astype(np.int64) + (state.start_ns or 0),
            np.zeros(len(rows), np.int32),
            rows[:, 1:].astype(np.float32),
        )


class _UnfilteredDetector(AdaptiveDetector):
    """Finds peaks in all that is quicker than a step."""

    in_band = False


#: Step times that have a filter of their own; between them, the filtered signals are mixed. Chosen
#: by judgement: eight are a factor of 1.25 apart, finer than the band is wide.
_NODES_S = np.geomspace(*PERIODS_S, 8)
#: Standard deviations of the band's two Gaussians as parts of the step time: the first takes out
#: the second peak of a step, the second what is slower than a step. Chosen by trial on oxford-step
#: validation and rieck-stepcounter: a coarser band of 0.3 or 0.25 instead of 0.4 loses F1 and steps
#: (docs/notebook/steps.md).
_FINE, _COARSE = 0.16, 0.4
#: Standard deviation of the Gaussian whose average is taken away before the rhythm is told [s].
#: Chosen by judgement: longer than half a step, so that sway and turning go and the step stays.
_TREND_S = 0.4
#: Low-pass in which a rise is timed: corner [Hz] and half length [s]. Chosen by judgement: it keeps
#: the rise of a step and takes out the shaking of its impact.
_TIMED_HZ, _TIMED_S = 3.0, 0.5


class Followed(NamedTuple):
    """Consecutive points whose step time is known, shape (n,) each.

    Attributes
    ----------
    band
        Acceleration upward in the band of the steps [m/s2].
    rise
        Acceleration upward as rises are timed in [m/s2].
    rhythm
        Strength of the rhythm.
    step_s
        Step time [s].
    typical_swing
        Swing that is usual in that rhythm [m/s2].
    """

    band: NDArray[np.float64]
    rise: NDArray[np.float64]
    rhythm: NDArray[np.float64]
    step_s: NDArray[np.float64]
    typical_swing: NDArray[np.float64]


@cache
def _kernels(*, fine: bool) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the weights of each node's band, and last of the signal rises are timed in.

    Without ``fine`` the band has no upper end: a point itself in place of its first Gaussian.

    Shape (nodes + 1, taps), from the oldest neighbour on; and the first and last that counts. Both
    are to read only.
    """
    reach = len(gaussian(_COARSE * _NODES_S[-1])) // 2
    timed = lowpass(_TIMED_HZ, _TIMED_S, np.arange(-reach, reach + 1) / GRID_HZ)
    point = np.zeros(2 * reach + 1)
    point[reach] = 1.0
    tops = [_padded(_FINE * t, reach) if fine else point for t in _NODES_S]
    bands = [top - _padded(_COARSE * t, reach) for top, t in zip(tops, _NODES_S, strict=True)]
    kernels = np.array([*bands, timed / timed.sum()])
    spans = [(k[0], k[-1] + 1) for k in (np.flatnonzero(kernel) for kernel in kernels)]
    return np.ascontiguousarray(kernels[:, ::-1]), np.array(spans, np.int64)


def _padded(sigma_s: float, reach: int, centre: float = 0.0) -> NDArray[np.float64]:
    """Return a Gaussian of a given half length, ``centre`` added to its middle."""
    kernel = gaussian(sigma_s)
    padded = np.pad(kernel, reach - len(kernel) // 2)
    padded[reach] += centre
    return padded


class StepBand:
    """Follows the rhythm of the acceleration upward, and filters it by the step time.

    Parameters
    ----------
    scales, ahead_s
        Of the :class:`~.dsp.periodicity.Rhythm`.
    fine
        Whether what is quicker than a step is taken out; False leaves it in.
    """

    def __init__(self, scales: Sequence[Scale], ahead_s: float, *, fine: bool = True) -> None:
        self._kernels, self._spans = _kernels(fine=fine)
        trend = _padded(_TREND_S, len(gaussian(_TREND_S)) // 2, centre=-1.0)
        self._trend = CentredFilter(-trend)
        self._rhythm = Rhythm(scales, ahead_s)
        self._reach = len(self._kernels[0]) // 2
        self._up = (
            ColumnBuffer()
        )  # held before and after its ends; its places are those of the first tap
        self._hops = ColumnBuffer(3)  # strength of the rhythm, step time, swing

    def __call__(self, up: NDArray[np.float64]) -> Followed:
        """Take the acceleration upward, shape (1, n); return the points known by now."""
        if up.shape[1] and not self._up.end:
            self._up.add(np.repeat(up[:, :1], self._reach, axis=1))
        self._up.add(up)
        self._hops.add(self._rhythm(self._trend(up)))
        return self._until(min(self._filtered, (self._hops.end - 1) * HOP))

    def flush(self) -> Followed:
        """Return the points up to the end of the signal."""
        self._up.add(np.repeat(self._up.values[:, -1:], self._reach, axis=1))
        self._hops.add(self._rhythm(self._trend.flush()))
        self._hops.add(self._rhythm.flush())
        return self._until(self._filtered)

    @property
    def _filtered(self) -> int:
        """Place after the last point whose neighbours are there."""
        return self._up.end - 2 * self._reach

    def _until(self, end: int) -> Followed:
        start = self._up.first
        end = max(start, end)
        bands = np.empty((len(Followed._fields), 0))
        if end > start:
            hop = start // HOP
            bands = kernels.steps.step_bands(
                self._up.between(start, end + 2 * self._reach)[0],
                self._kernels,
                self._spans,
                _NODES_S,
                np.ascontiguousarray(self._hops.between(hop, -(-end // HOP) + 1)),
                start,
                HOP,
            )
        self._up.discard_before(end)
        self._hops.discard_before(end // HOP)
        return Followed(*bands)


#: A turn against gravity is looked at over so long [s]. Chosen by judgement: as long as a slow
#: stride, after which a sensor on a walker is turned as before.
_TURN_S = 2.0
#: Its median is taken over so long before and after a peak, together as long as the rhythm's first
#: window [s]. Chosen by judgement: who puts a phone away while walking turns it for a moment.
_TURNS_BEFORE_S, _TURNS_AFTER_S = 3.0, 5.0
#: Points of the grid between two turns. Source: definition: ten a second of gravity, which an
#: average of a second has smoothed.
_TURN_HOP = 5


class Tilting:
    """Measures how far a sensor turns against gravity.

    Parameters
    ----------
    ahead_s
        How far ahead of a peak gravity is known [s].
    """

    def __init__(self, ahead_s: float) -> None:
        self._after = round(min(_TURNS_AFTER_S, ahead_s) * GRID_HZ)
        self._before = round(_TURNS_BEFORE_S * GRID_HZ)
        self._turns = ColumnBuffer()
        self._points = 0
        self._past = np.empty((0, 0))  # gravity of the last two seconds, a column each hop

    def add(self, gravity: NDArray[np.float64]) -> None:
        """Take gravity, shape (n_axes, n) [m/s2]; a magnitude has no axes, and turns nowhere."""
        first = -self._points % _TURN_HOP
        self._points += gravity.shape[1]
        directions = gravity[:, first::_TURN_HOP]
        length = np.sqrt((directions * directions).sum(axis=0))
        directions = directions / np.maximum(length, np.finfo(np.float64).tiny)
        back = round(_TURN_S * GRID_HZ) // _TURN_HOP
        if not self._past.shape[1]:
            self._past = np.repeat(directions[:, :1], back, axis=1)
        directions_since = np.concatenate([self._past, directions], axis=1)
        count = directions.shape[1]
        cosine = (
            (directions_since[:, back:] * directions_since[:, :count]).sum(axis=0)
            if len(directions_since)
            else np.ones(count)
        )
        self._turns.add(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))[None, :])
        self._past = directions_since[:, -back:]

    def around(self, point: int) -> float:
        """Return the median turn around a point of the grid [deg]."""
        first = max(point - self._before, 0) // _TURN_HOP
        turns = self._turns.between(first, (point + self._after) // _TURN_HOP + 1)
        return float(np.median(turns)) if turns.size else 0.0

    def discard_before(self, point: int) -> None:
        """Forget what no peak from a point of the grid on is measured by."""
        self._turns.discard_before((point - self._before) // _TURN_HOP)


#: A valley belongs to the peak that follows it within this many step times. Chosen by judgement: a
#: fifth more than a step, so that an uneven one has its valley.
_VALLEY_STEPS = 1.2
#: How far a higher peak is looked for, in step times. Chosen by judgement: farther away a peak is
#: of another step.
REACH_STEPS = 1.0
#: Longest look ahead, a reach at the longest step time [points of the grid]. Source: definition.
_AHEAD = round(REACH_STEPS * PERIODS_S[1] * GRID_HZ)
#: Longest look back [points of the grid]. Source: definition.
_BACK = round(_VALLEY_STEPS * PERIODS_S[1] * GRID_HZ) + 1
#: A rise is looked for this long before and after the peak of the band [s], its valley within this
#: part of a step. Chosen by judgement: low-passed at 3 Hz the rise ends within 0.1 s of the band's
#: peak, and begins after the valley of the step.
_RISE_NEAR_S, _RISE_STEPS = 0.1, 0.6


#: Columns of what is measured of a peak: where its step is timed [points of the grid since the
#: start of the run]; the band's value and its rise from the valley before [m/s2]; the same as a
#: part of the swing that is usual in the rhythm around it, 0 without a rhythm; time to the nearest
#: higher value, in step times, at most 1; strength of the rhythm and step time [s] around it.
COLUMNS = ("place", "height", "swing", "share", "dominance", "rhythm", "step_s")


class Peaks:
    """Finds the local maxima of the band of a :class:`StepBand`.

    Parameters
    ----------
    floor
        Lowest peak [m/s2].
    rise
        Part of the rise from valley to peak at which a step is timed; 0 times it at the peak.

    Attributes
    ----------
    next
        The first point that may be a peak yet.
    """

    def __init__(self, floor: float, rise: float) -> None:
        self.floor = floor
        self.rise = rise
        self._points = ColumnBuffer(5)
        self.next = 1  # a maximum has a neighbour on either side
        self._last = 0.0  # place of the peak before

    def __call__(self, followed: Followed) -> NDArray[np.float64]:
        """Take points; return the peaks whose surroundings are complete, as :data:`COLUMNS`."""
        self._points.add(np.stack(followed))
        peaks = self._until(self._points.end - _AHEAD)
        self._points.discard_before(self.next - _BACK)
        return peaks

    def flush(self) -> NDArray[np.float64]:
        """Return the peaks that waited; a maximum at the very end is not one."""
        return self._until(self._points.end - 1)

    def _until(self, end: int) -> NDArray[np.float64]:
        if end <= self.next:
            return np.empty((0, len(COLUMNS)))
        span, self.next = (self.next, end), end
        peaks = kernels.steps.peaks(
            self._points.contiguous(),
            self._points.first,
            span,
            self._last,
            self.floor,
            self.rise,
            GRID_HZ,
            round(_RISE_NEAR_S * GRID_HZ),
            (_VALLEY_STEPS, _RISE_STEPS, REACH_STEPS),
        )
        self._last = float(peaks[-1, 0]) if len(peaks) else self._last
        return peaks
