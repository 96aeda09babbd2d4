"""DSTP: steps by belief functions on peaks and valleys of accelerometer and gyroscope.

Source: Dempster-Shafer thesis, chapter III. The magnitude of each sensor is low-passed; the height
of a peak, and the depth of the valley after it, become masses on peak, no peak and either (III.4);
the masses of both sensors are combined (III.6) and a validated peak that a validated valley follows
is a step.

The thesis gives no cut-off, no corners of the trapezoids, no threshold of the masses and no limits
of time: all are parameters here, with defaults of ours. It compares heights with their mean over
the recording; here they are compared with the level of the signal around them, which needs no
recording that is complete. It finds the peaks of both sensors; here the accelerometer's are the
candidates, and the gyroscope is asked for the highest value near each. Its decision by the largest
belief and its test of ``m(peak)`` against ``m(Theta)`` are two gates, since the second does not
follow from the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..belief import Criterion, Rule  # noqa: TC001 (annotations are read at run time)
from ..detector import Curve, Measured
from ..gates import Candidates, Level, Reach, Refractory
from ..parameters import gate, measured
from ..stage import Context, Input, Stage
from .frames import FrameTrace, trace_of
from .lookaround import Lookaround, level
from .pairing import Pairing
from .sensor_evidence import Evidence, Heights
from .walking import OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ, WalkingSignal

if TYPE_CHECKING:
    from numpy.typing import NDArray


#: Corners of the trapezoids that must not fall.
RISING = (
    ("certain_from", "certain_at"),
    ("true_from", "true_at"),
    ("true_at", "shock_from"),
    ("shock_from", "shock_at"),
)


@dataclass(frozen=True, slots=True)
class BeliefParameters:
    """Parameters of :class:`BeliefDetector`."""

    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 3.0
    gravity_hz: Annotated[float, measured("Hz", "Corner of the high-pass.", gt=0)] = 0.25
    lead_s: Annotated[float, measured("s", "Initial contact precedes its peak by this.", ge=0)] = (
        0.05
    )
    around_s: Annotated[float, measured("s", "Time before and after that is around.", gt=0)] = 2.0
    match_s: Annotated[
        float, measured("s", "The gyroscope's peak is this near the accelerometer's.", ge=0)
    ] = 0.15
    valley_s: Annotated[float, measured("s", "Its valley is looked for so long.", gt=0)] = 0.6
    floor: Annotated[float, measured("m/s2", "Lowest peak kept as a candidate.", ge=0)] = 0.05
    least_acceleration: Annotated[
        float, measured("m/s2", "Heights are compared with at least this.", gt=0)
    ] = 0.4
    least_rotation: Annotated[
        float, measured("rad/s", "Heights are compared with at least this.", gt=0)
    ] = 0.1
    certain_from: Annotated[
        float, measured("1", "Height over level below which nothing can be told.", ge=0)
    ] = 0.0
    certain_at: Annotated[
        float, measured("1", "Height over level from which it surely can be told.", ge=0)
    ] = 1.0
    true_from: Annotated[
        float, measured("1", "Height over level below which it is none.", ge=0)
    ] = 0.0
    true_at: Annotated[float, measured("1", "Height over level from which it is one.", ge=0)] = 0.5
    shock_from: Annotated[
        float, measured("1", "Height over level from which it is too high for one.", ge=0)
    ] = 4.0
    shock_at: Annotated[
        float, measured("1", "Height over level from which it surely is none.", ge=0)
    ] = 6.0
    accelerometer: Annotated[
        float, measured("1", "Reliability of the accelerometer.", ge=0, le=1)
    ] = 0.95
    gyroscope: Annotated[float, measured("1", "Reliability of the gyroscope.", ge=0, le=1)] = 0.5
    rule: Annotated[Rule, measured("", "Rule that combines the sensors.")] = "dempster"
    criterion: Annotated[Criterion, measured("", "What a decision takes the largest of.")] = (
        "belief"
    )
    peak_lead: Annotated[float, gate("1", "Least score of a peak over none.", ge=0)] = 0.0
    peak_mass: Annotated[float, gate("1", "Least mass of a peak.", ge=0, le=1)] = 0.5
    peak_certainty: Annotated[float, gate("1", "Least mass of a peak over Theta.", ge=0)] = 0.0
    valley_lead: Annotated[float, gate("1", "Least score of a valley over none.", ge=0)] = 0.0
    valley_mass: Annotated[float, gate("1", "Least mass of a valley.", ge=0, le=1)] = 0.5
    valley_certainty: Annotated[float, gate("1", "Least mass of a valley over Theta.", ge=0)] = 0.0
    fall_s: Annotated[float, gate("s", "Longest time from a peak to its valley.", ge=0)] = 0.6
    pause_s: Annotated[float, gate("s", "Least time from a valley to the next peak.", ge=0)] = 0.0
    refractory_s: Annotated[float, gate("s", "Least time between two steps.", ge=0)] = 0.3

    def __post_init__(self) -> None:
        """Refuse a trapezoid whose corners fall."""
        for lower, upper in RISING:
            low, high = getattr(self, lower), getattr(self, upper)
            if low > high:
                raise ValueError(f"{lower}: expected at most {upper} ({high:g}), found {low:g}")


class _Pair(NamedTuple):
    """A peak and its valley: heights over zero and levels around, accelerometer and gyroscope."""

    time_ns: int
    fall_s: float
    peak: tuple[float, float]
    valley: tuple[float, float]
    level: tuple[float, float]


@dataclass(slots=True)
class _State:
    acceleration: WalkingSignal
    rotation: WalkingSignal
    columns: tuple[list[int], list[int]]  # of the accelerometer and of the gyroscope
    trace: FrameTrace
    signal: Lookaround
    evidence: Evidence
    rate_hz: float
    curve: Curve | None = None


class BeliefDetector(Stage):
    """A step is a peak that both sensors believe in, followed by a valley they believe in.

    The candidates are the peaks of the acceleration's magnitude, each with the lowest valley before
    the signal is higher again. The gyroscope says what it reached near both. Without a gyroscope
    the second source is vacuous: every rule but the disjunctive then says what the accelerometer
    says, and the disjunctive one knows nothing. Where Dempster's rule or the pignistic probability
    is not defined (total conflict), masses are not a number and the candidate is rejected.
    """

    Parameters = BeliefParameters
    takes = (Input(SignalBlock, frozenset({"acceleration", "angular_velocity"})),)
    gives = (StepEvent,)
    columns = (
        Quantity("height", "m/s2"),
        Quantity("depth", "m/s2"),
        Quantity("fall", "s"),
        *Evidence.columns("peak"),
        *Evidence.columns("valley"),
    )
    trace = trace_of(Quantity("height", "m/s2"), "m/s2", "m/s2")
    gates = (
        Level("peak_lead", "1", "peak_lead"),
        Level("peak_mass", "1", "peak_mass"),
        Level("peak_certainty", "1", "peak_certainty"),
        Level("valley_lead", "1", "valley_lead"),
        Level("valley_mass", "1", "valley_mass"),
        Level("valley_certainty", "1", "valley_certainty"),
        Level("fall", "s", "fall_s", at_least=False),
        Pairing(),
        Refractory(),
    )

    @classmethod
    def unfiltered(
        cls, parameters: BeliefParameters
    ) -> tuple[type[BeliefDetector], BeliefParameters]:
        """Return what measures the same with the low-pass and the high-pass wide open."""
        return cls, replace(parameters, cutoff_hz=OPEN_CUTOFF_HZ, gravity_hz=OPEN_GRAVITY_HZ)

    def __init__(self, parameters: BeliefParameters) -> None:
        self.parameters = parameters

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; the norm of all acceleration axes is one channel."""
        stream = context.stream
        p, rate = self.parameters, stream.rate_hz
        around, match = round(p.around_s * rate), round(p.match_s * rate)
        after = max(around, self._valley_samples(rate) + match) + 1
        columns = (stream.columns_of({"acceleration"}), stream.columns_of({"angular_velocity"}))
        self.state = _State(
            WalkingSignal(rate, p.cutoff_hz, p.gravity_hz),
            WalkingSignal(rate, p.cutoff_hz, p.gravity_hz),
            columns,
            FrameTrace(rate, 1),
            Lookaround(2, max(around, match, 1), after),
            _evidence(p, has_gyroscope=bool(columns[1])),
            rate,
        )
        return ("norm",)

    def reach(self) -> dict[str, Reach]:
        """Return what the combined masses can reach, whatever the heights of both sensors."""
        evidence, p = self.state.evidence, self.parameters
        told = " and ".join(f"{reliability:g}" for reliability in evidence.reliability)
        why = f"rule {p.rule}, reliabilities {told}"
        most = zip(("lead", "mass", "certainty"), evidence.most(), strict=True)
        return {
            f"{what}_{name}": Reach(value, why)
            for name, value in most
            for what in ("peak", "valley")
        }

    def process(self, block: SignalBlock) -> Measured:
        """Find the peaks; each waits until its valley and its surroundings are complete."""
        state = self.state
        norm, y = state.acceleration(block.select(state.columns[0]))
        _, turning = state.rotation(block.select(state.columns[1]))
        times = block.sample_times()
        state.curve = Curve(times - state.acceleration.delay_ns, y.T)
        frames = state.trace.add(times, y, np.abs(y), y * y, norm, norm)
        return Measured(self._look(state.signal.add(times, np.concatenate([y, turning]))), frames)

    def curve(self) -> Curve | None:
        """Return the accelerometer's filtered norm of the last block, without the delay."""
        return self.state.curve

    def flush(self) -> Measured:
        """End the run; a peak at its very end is not one."""
        return Measured(self._look(self.state.signal.finish()), self.state.trace.finish())

    def _look(self, columns: range) -> Candidates:
        """Return the peaks among some samples of the signal."""
        signal = self.state.signal
        peaks = signal.maxima(columns)
        peaks = peaks[signal.values[0, peaks] > self.parameters.floor]
        return self._candidates([self._pair(int(peak)) for peak in peaks])

    def _pair(self, peak: int) -> _Pair:
        """Measure a peak and the lowest point before the signal is higher again."""
        p, signal, rate = self.parameters, self.state.signal, self.state.rate_hz
        x, turning = signal.values
        following = x[peak + 1 : peak + 1 + self._valley_samples(rate)]
        higher = np.flatnonzero(following > x[peak])
        valley = peak + 1 + int(np.argmin(following[: higher[0]] if len(higher) else following))
        match, around = round(p.match_s * rate), signal.around(peak, round(p.around_s * rate))
        shift_s = vertex(x[peak - 1 : peak + 2]) / rate
        return _Pair(
            time_ns=int(signal.times[peak]) + round(shift_s * NS_PER_S),
            fall_s=(valley - peak) / rate - shift_s,
            peak=(x[peak], turning[signal.around(peak, match)].max()),
            valley=(-x[valley], -turning[signal.around(valley, match)].min()),
            level=(level(x[around]), level(turning[around])),
        )

    def _candidates(self, pairs: list[_Pair]) -> Candidates:
        """Let the evidence speak about all pairs at once."""
        p, state = self.parameters, self.state
        if not pairs:
            return Candidates.empty(len(self.columns))
        least = (p.least_acceleration, p.least_rotation)
        levels = np.maximum([pair.level for pair in pairs], least)
        peaks, valleys = (np.array([getattr(q, w) for q in pairs]) for w in ("peak", "valley"))
        shift_ns = state.acceleration.delay_ns + round(p.lead_s * NS_PER_S)
        values = np.column_stack(
            [
                peaks[:, 0],
                valleys[:, 0],
                [pair.fall_s for pair in pairs],
                state.evidence.of(peaks / levels),
                state.evidence.of(valleys / levels),
            ]
        )
        times = np.array([q.time_ns for q in pairs], np.int64) - shift_ns
        return Candidates(times, np.zeros(len(pairs), np.int32), values.astype(np.float32))

    def _valley_samples(self, rate_hz: float) -> int:
        return max(1, round(self.parameters.valley_s * rate_hz))


def vertex(three: NDArray[np.float64]) -> float:
    """Return where the parabola through three samples is highest, from the middle [samples].

    At 6 samples per second a peak would else be up to 83 ms off.
    """
    before, middle, after = three.tolist()
    bend = before - 2 * middle + after
    return 0.5 * (before - after) / bend if bend else 0.0


def _evidence(p: BeliefParameters, *, has_gyroscope: bool) -> Evidence:
    return Evidence(
        certainty=Heights(p.certain_from, p.certain_at),
        truth=Heights(p.true_from, p.true_at, p.shock_from, p.shock_at),
        reliability=(p.accelerometer, p.gyroscope if has_gyroscope else 0.0),
        rule=p.rule,
        criterion=p.criterion,
    )
