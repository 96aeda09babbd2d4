"""ZUPT: steps of a foot by the intervals in which it stands still on the ground.

Source: Dempster-Shafer thesis, chapter I (detection of zero-velocity intervals, for a sensor on the
foot). The documents give no formula; the statistic is the stance hypothesis optimal one (SHOE) of
Skog, Haendel, Nilsson and Rantakokko, IEEE Transactions on Biomedical Engineering 57(11), 2010. A
large ``acceleration_sigma`` leaves the angular rate energy detector (ARE) of the same paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..dsp.filters import WeightedSums, planar
from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.source import BRIDGE_S
from ..pipeline.stage import Context, Curve, Input, Measured, Stage
from .trace import FrameTrace, trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ZeroVelocityParameters:
    """Parameters of :class:`ZeroVelocityDetector`."""

    window_s: Annotated[float, measured("s", "Length of the statistic's window.", gt=0)] = 0.05
    acceleration_sigma: Annotated[
        float, measured("m/s2", "Off gravity by this, the statistic is 1.", gt=0)
    ] = 1.7
    rotation_sigma: Annotated[
        float, measured("rad/s", "Turning by this, the statistic is 1.", gt=0)
    ] = 0.3
    gravity: Annotated[float, measured("m/s2", "Of a sensor that stands still.", gt=0)] = 9.80665
    share: Annotated[
        float, measured("1", "Or while at most this part of the last stride's motion.", ge=0, lt=1)
    ] = 0.03
    stride_s: Annotated[float, measured("s", "A stride takes at most so long.", gt=0)] = 1.5
    lead_s: Annotated[
        float, measured("s", "Initial contact precedes the interval by this.", ge=0)
    ] = 0.15
    floor: Annotated[
        float, measured("1", "An interval lasts while its stillness is at least this.", gt=0, lt=1)
    ] = 0.33
    stillness: Annotated[float, gate("1", "Least stillness reached in it.", ge=0, le=1)] = 0.4
    duration_s: Annotated[float, gate("s", "Shortest interval that is a stance.", ge=0)] = 0.05
    motion: Annotated[float, gate("1", "Least motion before it that is a step.", ge=0)] = 10.0
    refractory_s: Annotated[float, gate("s", "Least time between two steps of a foot.", ge=0)] = 0.4


class _Interval(NamedTuple):
    start_ns: int
    stillness: float
    motion: float  # largest statistic since the interval before


@dataclass(slots=True)
class _State:
    columns: tuple[list[int], list[int]]  # of the accelerometer and of the gyroscope
    statistic: ZeroVelocityStatistic
    peak: RecentPeak
    trace: FrameTrace
    under_way: _Interval | None
    motion: float  # largest statistic since the last interval
    start_ns: int | None  # of the first sample
    end_ns: int  # of the last sample
    curve: Curve | None = None


class ZeroVelocityDetector(Stage):
    """A step of a foot is an interval of standing still, long enough, after a swing wide enough.

    Meant for a sensor on the foot; it finds the steps of that foot only. The candidates are all
    intervals, also those that are no steps (standing from the beginning, say), for navigation that
    wants to know when the velocity is zero: one begins ``lead_s`` after its candidate's time and
    lasts ``duration``.
    ``stillness`` is ``1 / (1 + T / s)`` of the statistic T, and ``motion`` the largest T before
    it. The scale s is 1 for slow feet; a fast foot may roll on while it stands, so that there an
    interval lasts while T is at most ``share`` of the largest T in the last ``stride_s``.
    Without a gyroscope the statistic is that of the accelerometer alone. An interval comes out
    when it has ended.
    """

    Parameters = ZeroVelocityParameters
    takes = (Input(SignalBlock, frozenset({"acceleration", "angular_velocity"})),)
    gives = (StepEvent,)
    compiles = ("filters", "frames", "grid", "steps")
    bridges_s = BRIDGE_S
    columns = (Quantity("stillness", "1"), Quantity("duration", "s"), Quantity("motion", "1"))
    sought = "the begin of a stance"
    trace = trace_of(Quantity("stillness", "1"), "1", "m/s2")
    gates = (
        Level("stillness", "1", "stillness"),
        Level("duration", "s", "duration_s"),
        Level("motion", "1", "motion"),
        Refractory(),
    )

    def __init__(self, parameters: ZeroVelocityParameters) -> None:
        self.parameters = parameters

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; all axes together are one channel."""
        stream = context.stream
        columns = (stream.columns_of({"acceleration"}), stream.columns_of({"angular_velocity"}))
        self.state = _State(
            columns,
            ZeroVelocityStatistic(stream.rate_hz, self.parameters),
            RecentPeak(stream.rate_hz, self.parameters.stride_s),
            FrameTrace(stream.rate_hz, 1),
            under_way=None,
            motion=0.0,
            start_ns=None,
            end_ns=0,
        )
        return ("foot",)

    def process(self, block: SignalBlock) -> Measured:
        """Find the intervals; one is complete when it ends."""
        state = self.state
        acceleration, rotation = (planar(block.select(c)) for c in state.columns)
        t = state.statistic(acceleration, rotation)
        still = 1 / (1 + t / self._scale(t))
        norm = np.sqrt(np.einsum("cn,cn->n", acceleration, acceleration))[None, :]
        times = block.sample_times()
        frames = state.trace.add(times, still[None, :], t[None, :], (t * t)[None, :], norm, norm)
        state.start_ns = int(times[0]) if state.start_ns is None else state.start_ns
        # nothing lies before the run, and a recording's times begin with 0
        centres = np.maximum(times - state.statistic.delay_ns, state.start_ns)
        state.end_ns = int(centres[-1])
        inside = times - state.statistic.delay_ns >= state.start_ns
        state.curve = Curve(centres[inside], still[inside, None])
        return Measured(self._candidates(self._intervals(centres, t, still)), frames)

    def curve(self) -> Curve | None:
        """Return the stillness of the last block, each value at the centre of its window."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run, and with it the interval under way."""
        state = self.state
        ended = [] if state.under_way is None else [(state.under_way, state.end_ns)]
        state.under_way = None
        return Measured(self._candidates(ended), state.trace.flush())

    def _scale(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what the statistic is divided by: 1 unless the foot swings so fast."""
        p = self.parameters
        return np.maximum(1.0, p.share * self.state.peak(t) / (1 / p.floor - 1))

    def _intervals(
        self, times: NDArray[np.int64], t: NDArray[np.float64], still: NDArray[np.float64]
    ) -> list[tuple[_Interval, int]]:
        """Cut where the foot begins or ceases to stand; return intervals that ended, and when."""
        state = self.state
        standing = still >= self.parameters.floor
        cuts = np.flatnonzero(standing[1:] != standing[:-1]) + 1
        ended: list[tuple[_Interval, int]] = []
        for first, last in pairwise([0, *cuts.tolist(), len(t)]):
            if standing[first]:
                before = state.under_way or _Interval(int(times[first]), 0.0, state.motion)
                best = max(before.stillness, float(still[first:last].max()))
                state.under_way, state.motion = before._replace(stillness=best), 0.0
                continue
            if state.under_way is not None:
                ended.append((state.under_way, int(times[first])))
                state.under_way = None
            state.motion = max(state.motion, float(t[first:last].max()))
        return ended

    def _candidates(self, ended: list[tuple[_Interval, int]]) -> Candidates:
        lead_ns = round(self.parameters.lead_s * NS_PER_S)
        rows = [(i.stillness, (end - i.start_ns) / NS_PER_S, i.motion) for i, end in ended]
        return Candidates(
            np.array([i.start_ns - lead_ns for i, _ in ended], np.int64),
            np.zeros(len(ended), np.int32),
            np.array(rows, np.float32).reshape(-1, len(self.columns)),
        )


class RecentPeak:
    """The largest value of the last stride, up to each sample, over blocks.

    A fast foot rolls on while it stands, about in proportion to how wildly it swings: what is
    still for a runner is a swing for a patient. So limits go by this peak.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    stride_s
        How far it looks back [s].
    """

    def __init__(self, rate_hz: float, stride_s: float) -> None:
        self._past = np.full(max(1, round(stride_s * rate_hz)) - 1, -np.inf)

    def __call__(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take the next values, shape (n,); return the peaks, shape (n,)."""
        reach = len(self._past) + 1
        joined = np.concatenate([self._past, values])
        self._past = joined[len(joined) - reach + 1 :]
        windows = np.lib.stride_tricks.sliding_window_view(joined, reach)
        return np.asarray(windows.max(axis=1))


class ZeroVelocityStatistic:
    """The statistic T over blocks: how badly a window of the signal fits a foot that stands.

    ``T = mean |a - g u|^2 / sigma_a^2 + mean |w|^2 / sigma_w^2`` with ``u`` the direction of the
    mean acceleration of the window, so that no orientation is needed. Before a run the signal is
    taken to have been constant.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    parameters
        Window, sigmas and gravity.
    """

    def __init__(self, rate_hz: float, parameters: ZeroVelocityParameters) -> None:
        self.parameters = parameters
        window = max(1, round(parameters.window_s * rate_hz))
        self._means = WeightedSums(np.full(window, 1 / window), at_rest=True)
        #: A window is centred this much before its last sample [ns].
        self.delay_ns = round((window - 1) / 2 / rate_hz * NS_PER_S)

    def __call__(
        self, acceleration: NDArray[np.float64], rotation: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Take blocks of (n_axes, n) in m/s2 and rad/s; return the statistic, shape (n,)."""
        p = self.parameters
        powers = [np.einsum("cn,cn->n", x, x) for x in (acceleration, rotation)]
        means = self._means(np.concatenate([acceleration, powers]))
        axes = len(acceleration)
        direction = np.sqrt(np.einsum("cn,cn->n", means[:axes], means[:axes]))
        # |a - g u|^2 on average; differences of large numbers may come out a little below 0
        off = np.maximum(means[axes] - 2 * p.gravity * direction + p.gravity**2, 0.0)
        turning = np.maximum(means[axes + 1], 0.0)
        return np.asarray(off / p.acceleration_sigma**2 + turning / p.rotation_sigma**2)
