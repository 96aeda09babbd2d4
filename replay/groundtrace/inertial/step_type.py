"""Types of steps: forward, backward, left or right, by accelerations in the body's axes.

Source: EPFL, sections on preprocessing, recognition of steps, and corrections, figures 2 and 3.

Body axes. Up is against gravity. Ahead is what a reference axis of the sensor leaves in the
horizontal plane; the angle between it and the walking direction is found by ``.body_motion``.
The reference is the axis that the wearer says looks ahead, or any that is horizontal enough.
Gravity is a low-passed specific force. Where there is a gyroscope, its turns are followed at once
and the specific force only corrects what drifts (a complementary filter, linear in the small turns
within its time constant), so that the nodding and rolling of the trunk within a step do not turn
gravity into acceleration. All is causal, and the same whatever the blocks.

Patterns. On either axis, frontal or lateral, a step is what lies between two minima. The frontal
ones are looked for in windows that the vertical signal gives, from where it rises through its mean
to where it falls through it; the lateral ones lie deep in a window centred on them. The document
leaves open the thresholds, which are ours, and so is that the lateral window follows the signal
instead of having a fixed length, so that cadence does not matter. All is measured on a strip: the
three accelerations around a step on a grid of step times, smoothed so that slow steps show as many
harmonics as fast ones.

Gates. Every step has four candidates, one for each type; a candidate is accepted where it passes
all tests of its chain:

- both chains: the lateral swing against the frontal and vertical ones, which leaves one chain where
  a step has a pattern in both (the document compares amplitudes for the lateral axis alone);
- frontal chain: the vertical window, the area density, the order of the maxima (forward: the
  frontal before the vertical one; backward: after it), and the vertical range, which a careful step
  back does not reach, but one down a stair does: its maxima lie in any order, so that it is not
  asked (ours; the document has level ground alone);
- lateral chain: the lobe, the slopes (left: the rise to the right is the steeper one, which ends
  the push to the left; right: the fall is), and whether the contact ends the push. The second
  contact of a side step, with which the feet are closed, is no step of its own.

Late corrections use two steps before and two after in the same walk. A degenerate pattern begins or
ends with a neighbour's, so that its density is that of the neighbour. Where a step is ordered
otherwise than both steps before it or both after it, its slopes are tested, and where they do not
confirm it, it is ordered as the others. The document corrects the frontal chain alone; that one
step among others of its walk does not go aside by itself is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .. import kernels
from ..detectors.body_signals import NOMINAL_CADENCE_HZ
from ..dsp.filters import StreamingFilter, butterworth, corner, phase_delay_s, planar
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate, measured
from ..pipeline.source import NonFiniteHold
from ..pipeline.stage import CannotStart, Context, Input, Stage

# Ahead is read at run time, where the parameters are described
from .body_motion import STEEP, Ahead, WalkingAxis, level_axis, step_swing
from .frames import columns_of_axes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock
    from groundtrace_codecs.signals import Stream

    from ..pipeline.gates import GateState
    from .body_motion import Axis, Swing

    Array = NDArray[np.float64]

#: Time over which a gyroscope's offset is told from the turns of a body that stays upright [s].
#: Chosen by judgement: many steps, and less than an offset drifts in.
_OFFSET_S = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class BodyPart:
    """Consecutive samples in the body's axes.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    values
        Acceleration ahead, to the right and up, without gravity, shape (3, n) [m/s2].
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]


def axis_vector(axis: Axis) -> NDArray[np.float64]:
    """Return the unit vector of an axis' name, shape (3,)."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
    return vector


class BodyAxes:
    """Turns the samples of one sensor into the body's axes.

    Parameters
    ----------
    stream
        Three axes of acceleration, by their names x, y and z; those of angular velocity are used
        where there are three.
    forward
        The sensor's axis that looks ahead, up to the mounting; ``walk``: the first of x, y, z that
        is level enough at the start. Where it turns out to be vertical, the axis that follows it
        in x, y, z takes its place.
    gravity_s
        Time constant of gravity [s].

    Attributes
    ----------
    forward
        The reference; ``walk`` until the first sample.
    """

    def __init__(self, stream: Stream, forward: Ahead = "x", gravity_s: float = 2.0) -> None:
        self._force = columns_of_axes(stream, "acceleration")
        self._turning = columns_of_axes(stream, "angular_velocity")
        self.forward = forward
        self._gravity_s = gravity_s
        self._keep = math.exp(-1 / (gravity_s * stream.rate_hz))
        self._keep_offset = math.exp(-1 / (_OFFSET_S * stream.rate_hz))
        self._state = np.zeros((4, 3))

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Return whether a stream has three axes of acceleration."""
        return bool(columns_of_axes(stream, "acceleration"))

    def __call__(self, block: SignalBlock) -> BodyPart:
        """Take a block; return its samples in the body's axes."""
        values = planar(block)
        force = np.ascontiguousarray(values[self._force])
        rate = np.ascontiguousarray(values[self._turning])
        keeps = (self._keep, self._keep_offset, self._gravity_s)
        gravity = kernels.axes.directions(force, rate, self._state, keeps)
        if self.forward == "walk":
            self.forward = level_axis(gravity[:, 0] / max(math.hypot(*gravity[:, 0]), 1e-300))
        nominal = axis_vector(self.forward)
        return BodyPart(block.sample_times(), kernels.axes.resolved(force, gravity, nominal, STEEP))


#: Points of the grid per step time; how far it reaches before and after the contact [steps]. With
#: the two steps that follow it, a step is then known within four. Chosen by judgement: 32 points
#: have 16 harmonics of a step; the two steps on either side are what late corrections look at.
POINTS, BEFORE, AFTER = 32, 2.5, 1.5625
#: Phase of the points of the grid, in steps about the contact. Source: definition.
PHASE: Array = np.arange(-BEFORE * POINTS, AFTER * POINTS + 1) / POINTS
#: Place of the contact on the grid.
CONTACT = round(BEFORE * POINTS)
#: Standard deviation of the Gaussian that smooths a strip [steps]. Chosen by judgement: three
#: harmonics of a step are left.
_SMOOTH = 0.1
#: The vertical maximum of a step lies in this span of its contact [steps]. Chosen by judgement: one
#: step long, as the contact comes shortly before the maximum.
_TOP = (-0.35, 0.65)
#: The frontal maximum of a step is looked for this near to its vertical maximum [steps]. Chosen by
#: judgement: farther away it is a neighbour's.
_NEAR = 0.5
#: Lateral minima and maxima lie in this part of the range, from its ends. Chosen by judgement: less
#: deep ones are ripples of a lobe.
_DEEP = 0.3
#: Where ranges are compared, and where the vertical mean is taken. Chosen by judgement: a step and
#: its neighbours' halves.
_NEAR_CONTACT = slice(CONTACT - round(1.5 * POINTS), CONTACT + round(1.5 * POINTS) + 1)
_ABOUT = slice(CONTACT - POINTS, CONTACT + POINTS + 1)
#: Values of a strip that differ by this part of its range are equal but for rounding: a flat top is
#: at its first place on every machine. Source: some thousand roundings of 64-bit numbers.
_FLAT = 1e-12
#: Weights of a point's neighbours. Source: definition: three deviations of the Gaussian.
_HALF = round(3 * _SMOOTH * POINTS)
_WEIGHTS: Array = np.exp(-0.5 * (np.arange(-_HALF, _HALF + 1) / (_SMOOTH * POINTS)) ** 2)
#: Weights of a mean over two steps, one before and one after. Source: definition.
_STRIDE: Array = np.ones(2 * POINTS + 1)


@dataclass(frozen=True, slots=True)
class FrontalShape:
    """The frontal pattern of a step.

    Attributes
    ----------
    window
        Length of the vertical signal's stay above its mean [steps].
    lead
        By how much its maximum comes before the vertical one [steps]; NaN where it has none.
    density
        Area of its triangle per length of its base, as a part of the vertical range.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    vertical
        Range of the vertical acceleration [m/s2].
    """

    window: float
    lead: float
    density: float
    slopes: float
    vertical: float


@dataclass(frozen=True, slots=True)
class LateralShape:
    """The lateral pattern of a step.

    Attributes
    ----------
    share
        Geometric mean of the lateral range over the frontal and over the vertical one.
    lobe
        Distance of its maximum from its middle, as a part of its length.
    slopes
        Logarithm of the fall's mean slope over the rise's: positive where it falls faster.
    inside
        How far on the steep side of the maximum the contact lies, as a part of its length.
    """

    share: float
    lobe: float
    slopes: float
    inside: float


def strip_of(times_s: Array, values: Array, step_s: float) -> Array:
    """Return accelerations on the grid, smoothed, shape (3, n).

    Parameters
    ----------
    times_s
        Of the samples, about the contact [s], shape (m,).
    values
        Accelerations ahead, to the right and up, shape (3, m).
    step_s
        Time of a step [s].
    """
    return _averaged(np.array([np.interp(PHASE * step_s, times_s, x) for x in values]), _WEIGHTS)


def _averaged(rows: Array, weights: Array) -> Array:
    """Return means of neighbours under weights; at the ends fewer count. Shapes (c, n)."""
    half = len(weights) // 2
    # nothing stands beyond the ends, and weighs nothing
    padded = np.zeros((len(rows) + 1, rows.shape[1] + 2 * half))
    padded[:-1, half:-half], padded[-1, half:-half] = rows, 1.0
    sums: Array = kernels.grid.weighted_sums(padded, weights)
    return np.asarray(sums[:-1] / sums[-1])


def frontal(strip: Array, swing: Swing | None) -> FrontalShape:
    """Measure the frontal pattern of a strip.

    Parameters
    ----------
    strip
        Shape (3, n).
    swing
        Of the step (:func:`.body_motion.step_swing`); its phase is the lead of
        a step without a frontal maximum of its own.
    """
    ahead, _, up = strip
    patterns = kernels.patterns
    top = patterns.highest_top(up, PHASE, *_TOP)
    top = CONTACT if top < 0 else top
    stays = patterns.stays_about(up, float(up[_ABOUT].mean()), top)
    before, middle, after = stays[:2], stays[2:4], stays[4:]
    window, vertical = (middle[1] - middle[0]) / POINTS, _range(up)
    peak = patterns.highest_top(ahead, PHASE, PHASE[top] - _NEAR, PHASE[top] + _NEAR)
    if peak < 0:
        lead = 0.0 if swing is None else float(np.angle(swing.ahead)) / (2 * np.pi)
        return FrontalShape(window, lead, 0.0, 0.0, vertical)
    rising, falling = (before, middle) if peak <= top else (middle, after)
    equal = _FLAT * patterns.extent(ahead, 0, len(ahead) - 1)
    first = patterns.lowest(ahead, min(rising[0], peak), min(rising[1], peak), equal)
    last = patterns.lowest(ahead, max(falling[0], peak), max(falling[1], peak), equal)
    height = float(ahead[peak] - 0.5 * (ahead[first] + ahead[last]))
    # a triangle of base n and this height has an area of height n / 2
    density = 0.5 * height / vertical
    slopes = _slopes(ahead, first, peak, last)
    return FrontalShape(window, (top - peak) / POINTS, density, slopes, vertical)


def lateral(strip: Array) -> LateralShape:
    """Measure the lateral pattern of a strip, shape (3, n)."""
    ahead, right, up = strip
    # over two steps the mean is what a turn adds to the lateral acceleration
    turn = _averaged(right[None], _STRIDE)[0]
    share = _extent(right - turn) / math.sqrt(_range(ahead) * _range(up))
    low, high = float(right.min()), float(right.max())
    equal = _FLAT * (high - low)
    patterns, deep = kernels.patterns, low + _DEEP * (high - low)
    first, last, earliest, latest = patterns.minima_about(right, CONTACT, deep, equal)
    peak = patterns.lowest(-right, first, last, equal)
    if first < earliest:
        first = patterns.lowest(right, first, peak, equal)
    if last > latest:
        last = patterns.lowest(right, peak, last, equal)
    length = max(last - first, 1)
    slopes = _slopes(right, first, peak, last)
    inside = (CONTACT - peak) / length
    lobe = abs((peak - first) / length - 0.5)
    return LateralShape(share, lobe, slopes, inside if slopes > 0 else -inside)


def _extent(x: Array) -> float:
    """Return the range of a signal around the contact."""
    return kernels.patterns.extent(x, _NEAR_CONTACT.start, _NEAR_CONTACT.stop - 1)


def _range(x: Array) -> float:
    """Return the range of a signal around the contact, more than 0."""
    return max(_extent(x), 1e-9)


def _slopes(x: Array, first: int, peak: int, last: int) -> float:
    """Return the logarithm of the mean slope after a maximum over that before it; 0 for none."""
    rise = float(x[peak] - x[first]) / max(peak - first, 1)
    fall = float(x[peak] - x[last]) / max(last - peak, 1)
    return math.log(fall / rise) if rise > 0 and fall > 0 else 0.0


#: Steps further apart than this many step times are of two walks. Chosen by judgement: a missed
#: step is two step times apart.
LINKED = 1.8
#: Slopes confirm an order where they differ by at least this logarithm; not that of a maximum about
#: half a step away, which may be a neighbour's [steps]. Chosen by judgement: a third steeper is
#: seen, less is noise.
_CONFIRMS, _FAR = 0.3, 0.4


class Shape(NamedTuple):
    """What one step looks like by itself.

    Attributes
    ----------
    time_ns
        Contact [ns].
    step_s
        Step time around it [s].
    frontal, lateral
        Its patterns.
    mounting_rad
        How far the sensor is turned, as known then [rad].
    """

    time_ns: int
    step_s: float
    frontal: FrontalShape
    lateral: LateralShape
    mounting_rad: float


def linked(step: Shape, others: Sequence[Shape]) -> list[Shape]:
    """Return those of the next steps that belong to the same walk as ``step``."""
    linked_steps: list[Shape] = []
    last = step
    for other in others:
        apart_s = abs(other.time_ns - last.time_ns) / NS_PER_S
        if apart_s > LINKED * min(last.step_s, other.step_s):
            break
        linked_steps.append(other)
        last = other
    return linked_steps


def common_share(
    before: Sequence[LateralShape], pattern: LateralShape, after: Sequence[LateralShape]
) -> float:
    """Return the median lateral share of three neighbouring steps, the own one in the middle.

    At the ends of a walk it is the first or last of them; with fewer than three steps the share
    is its own.

    Parameters
    ----------
    before, after
        The nearest first, up to two.
    pattern
        The step's own pattern.
    """
    three = [*before[:1], pattern, *after[:1]]
    if len(three) < 3:
        three = [pattern, *(before or after)]
    return median(x.share for x in three) if len(three) == 3 else pattern.share


def corrected_lead(
    before: Sequence[FrontalShape], pattern: FrontalShape, after: Sequence[FrontalShape]
) -> float:
    """Return by how much a step's frontal maximum leads, put right by its neighbours [steps].

    Parameters
    ----------
    before, after
        The nearest first, up to two.
    pattern
        The step's own pattern.
    """
    against = [pair for pair in (before, after) if _agree_against(pair, pattern.lead)]
    confirmed = pattern.lead * pattern.slopes > 0 and abs(pattern.slopes) >= _CONFIRMS
    if not against or (confirmed and abs(pattern.lead) <= _FAR):
        return pattern.lead
    return median(x.lead for pair in against for x in pair)


def back_support(window: Sequence[Shape]) -> float:
    """Return which part of neighbouring steps were each made backward, by their own patterns.

    A step counts whose own frontal maximum comes clearly after the vertical one, and that takes as
    long as the others: of irregular steps the order says nothing. Of a single step or two nothing
    is known, so that three are counted at least.

    Parameters
    ----------
    window
        The step and those linked to it, up to two before and two after.
    """
    usual_s = median(x.step_s for x in window)
    regular = [x for x in window if 1 / REGULAR <= x.step_s / usual_s <= REGULAR]
    back = sum(-_FAR <= x.frontal.lead <= -CLEAR for x in regular)
    return back / max(len(window), LEAST_WINDOW)


def _agree_against(pair: Sequence[FrontalShape], lead: float) -> bool:
    """Return whether two neighbours agree on an order that is not that of ``lead``."""
    signs = {_sign(x.lead) for x in pair}
    return len(pair) == 2 and len(signs) == 1 and _sign(lead) not in signs


#: Steps are regular whose times differ from the usual one by this factor at most, an order is clear
#: from so many steps on, and so many steps tell something together. Chosen by trial on simulated
#: people, seeds 501 to 506 (backward steps: order 0.17 to 0.26), and mobgap
#: (docs/accuracy/step-types.md).
REGULAR, CLEAR, LEAST_WINDOW = 1.25, 0.08, 3


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


#: Order of the low-pass. Source: EPFL, section on preprocessing.
ORDER = 3
#: Steps nearer or further apart say nothing of the step time [s]. Chosen by judgement: nobody runs
#: faster or walks slower without a pause.
SHORTEST_STEP_S, LONGEST_STEP_S = 0.2, 2.0
#: Step time before anything tells it [s]. Chosen by judgement: of side steps, back steps and a
#: walk.
USUAL_STEP_S = 0.6


def smoothing(cutoff_hz: float, rate_hz: float) -> NDArray[np.float64]:
    """Design the low-pass of all three axes, a Butterworth filter of order 3.

    Source: EPFL, 4 Hz at 30 Hz. It delays by 2.3 to 3.4 samples there, not by "its 4 coefficients"
    as printed; here the delay at the usual cadence is taken out of the times.

    Returns
    -------
    Second-order sections, shape (2, 6).
    """
    return butterworth(ORDER, (corner(cutoff_hz, rate_hz),), rate_hz)


@dataclass(slots=True)
class _Signal:
    """The body's accelerations, low-passed, as far back as steps may ask."""

    axes: BodyAxes
    filter: StreamingFilter
    delay_ns: int
    holder: NonFiniteHold = field(default_factory=NonFiniteHold)
    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    values: NDArray[np.float64] = field(default_factory=lambda: np.empty((3, 0)))

    @property
    def end_ns(self) -> int:
        """Time of the last sample [ns]."""
        return int(self.time_ns[-1])

    def add(self, block: SignalBlock) -> None:
        """Take a block."""
        part = self.axes(self.holder.fill(block))
        self.time_ns = np.concatenate([self.time_ns, part.time_ns - self.delay_ns])
        self.values = np.concatenate([self.values, self.filter(part.values)], axis=1)

    def discard_before(self, time_ns: int) -> None:
        """Drop the samples before a time."""
        first = int(np.searchsorted(self.time_ns, time_ns))
        self.time_ns, self.values = self.time_ns[first:], self.values[:, first:]


class StepWindowCollector:
    """Takes signal and steps of one stream in any order; gives each step's candidates in time.

    A step's candidates need the two steps after it, measured, or to be sure that none follow.

    Parameters
    ----------
    worker
        Measures steps.
    """

    def __init__(self, worker: StepTypes) -> None:
        self.worker = worker
        self._forward = worker.parameters.forward
        self._signal: _Signal | None = None
        self._steps: list[StepEvent] = []  # not measured
        self._waiting: list[StepEvent] = []  # measured, not told
        self._shapes: list[Shape] = []  # of up to two that were told, and of those that wait

    def update(self, block: SignalBlock) -> None:
        """Take the next block of the run."""
        if self._signal is None:
            self._signal = self._begin(block.stream)
        self._signal.add(block)
        self._forward = self._signal.axes.forward

    def step(self, step: StepEvent) -> None:
        """Take the next step."""
        self._steps.append(step)

    def complete_steps(
        self, *, final: bool = False
    ) -> Iterator[tuple[StepEvent, list[tuple[float, ...]]]]:
        """Yield the steps whose candidates are known by now, and these row by row.

        That is all steps where the run ends.
        """
        run = self._signal
        if run is None or not len(run.time_ns):
            return
        while (step_s := self._measurable(run, final=final)) is not None:
            self._measure(run, step_s)
        while self._waiting and (final or self._surrounded(run)):
            index = len(self._shapes) - len(self._waiting)
            shapes = self._shapes
            rows = self.worker.rows(shapes[:index], shapes[index], shapes[index + 1 :])
            del shapes[: max(0, index - 1)]
            yield self._waiting.pop(0), rows
        self._forget(run)

    def end(self) -> None:
        """Forget the signal and the steps; what is known of the mounting stays."""
        self._signal = None
        self._steps, self._waiting, self._shapes = [], [], []

    def _begin(self, stream: Stream) -> _Signal:
        p = self.worker.parameters
        sos = smoothing(p.cutoff_hz, stream.rate_hz)
        delay_s = phase_delay_s(sos, NOMINAL_CADENCE_HZ, stream.rate_hz)
        axes = BodyAxes(stream, self._forward, p.gravity_s)
        return _Signal(axes, StreamingFilter(sos), round(delay_s * NS_PER_S))

    def _measurable(self, run: _Signal, *, final: bool) -> float | None:
        """Return the step time around the next step [s]; None while it must wait."""
        if not self._steps:
            return None
        time_ns = self._steps[0].time_ns
        if not (final or len(self._steps) > 1 or run.end_ns >= time_ns + self._late_ns):
            return None
        near = [shape.time_ns for shape in self._shapes[-1:]]
        near += [step.time_ns for step in self._steps[1:2]]
        apart = [abs(other_ns - time_ns) / NS_PER_S for other_ns in near]
        step_s = min((s for s in apart if SHORTEST_STEP_S <= s <= LONGEST_STEP_S), default=None)
        if step_s is None:
            step_s = self._shapes[-1].step_s if self._shapes else USUAL_STEP_S
        needed_ns = time_ns + round(AFTER * step_s * NS_PER_S)
        return step_s if final or run.end_ns >= needed_ns else None

    def _measure(self, run: _Signal, step_s: float) -> None:
        step = self._steps.pop(0)
        reach_ns = round((BEFORE + 0.5) * step_s * NS_PER_S)
        low = run.time_ns.searchsorted(step.time_ns - reach_ns)
        high = run.time_ns.searchsorted(step.time_ns + reach_ns)
        near = slice(max(0, min(int(low), len(run.time_ns) - 1)), max(int(high), 1))
        times_s = (run.time_ns[near] - step.time_ns) / NS_PER_S
        shape = self.worker.shape(step.time_ns, step_s, times_s, run.values[:, near])
        self._shapes.append(shape)
        self._waiting.append(step)

    def _surrounded(self, run: _Signal) -> bool:
        """Return whether all steps that count after the first that waits are measured."""
        index = len(self._shapes) - len(self._waiting)
        step, after = self._shapes[index], self._shapes[index + 1 :]
        if len(after) >= 2 or len(linked(step, after)) < len(after):
            return True
        last = self._shapes[-1]
        if self._steps:
            return self._steps[0].time_ns - last.time_ns > LINKED * last.step_s * NS_PER_S
        return run.end_ns >= last.time_ns + self._late_ns

    @property
    def _late_ns(self) -> int:
        return round(self.worker.parameters.late_s * NS_PER_S)

    def _forget(self, run: _Signal) -> None:
        """Drop signal that no step can ask for any more."""
        oldest_ns = run.end_ns - self._late_ns
        if self._steps:
            oldest_ns = min(oldest_ns, self._steps[0].time_ns)
        run.discard_before(oldest_ns - round((BEFORE + 0.5) * LONGEST_STEP_S * NS_PER_S))


TYPES = ("forward", "backward", "left", "right")
#: Source: definition.
FRONTAL, BACKWARD, LATERAL = frozenset({0, 1}), frozenset({1}), frozenset({2, 3})
#: Type of a step whose evidence is too weak for one of the four, and the place of the gate that the
#: contact fails which closes the feet of a side step. Source: definition.
UNKNOWN, LEADING = "unknown", 7


def _which(types: frozenset[int]) -> NDArray[np.bool_]:
    """Return of each type whether it is one of some."""
    return np.array([index in types for index in range(len(TYPES))])


@dataclass(frozen=True, slots=True)
class Applies:
    """A level that only some types must reach; the others pass whatever it is.

    Attributes
    ----------
    level
        What must be reached.
    types
        By which types.
    against
        Types that it tells them from: where the gates before left a step none of these, it need not
        be reached.
    """

    level: Level
    types: frozenset[int]
    against: frozenset[int] = frozenset()

    @property
    def name(self) -> str:
        """Name of the level."""
        return self.level.name

    @property
    def unit(self) -> str:
        """Unit of the level."""
        return self.level.unit

    @property
    def parameter(self) -> str:
        """Parameter of the level."""
        return self.level.parameter

    @property
    def at_least(self) -> bool:
        """Whether the level must be reached, or not exceeded."""
        return self.level.at_least

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the measured column; infinitely good where the level does not apply."""
        seen = self.level.values(candidates, columns, alive, threshold, carry)
        applies = _which(self.types)[candidates.channel]
        if self.against:
            left = _which(self.against)[candidates.channel] & alive
            applies &= ~alive | _with_step_of(candidates, left)
        return np.where(applies, seen, np.inf if self.at_least else -np.inf)


def _with_step_of(candidates: Candidates, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return of each candidate whether one of some candidates is of the same step."""
    # a step's candidates have one time, and come in order
    times = np.append(candidates.time_ns[some], -1)
    return np.asarray(times[np.searchsorted(times[:-1], candidates.time_ns)] == candidates.time_ns)


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Where a step has a pattern in both chains, the lateral one is its own."""

    parameter: str = "share"
    name: str = "duplicate"
    unit: str = "1"
    at_least: bool = False

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: GateState,  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Return the lateral share of frontal candidates whose step passed the lateral tests."""
        share = candidates.value[:, [c.name for c in columns].index("share")]
        aside = _which(LATERAL)[candidates.channel]
        twice = _with_step_of(candidates, aside & alive)
        # just the threshold would pass
        return np.where(twice & ~aside, np.nextafter(share, np.float32(np.inf)), -np.inf)


@dataclass(frozen=True, slots=True)
class StepTypeParameters:
    """Parameters of :class:`StepTypes`."""

    forward: Annotated[
        Ahead,
        measured("", "Sensor axis that looks ahead to 35 degrees; walk: the walk tells."),
    ] = "walk"
    gravity_s: Annotated[float, measured("s", "Time constant of gravity.", gt=0)] = 2.0
    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 4.0
    late_s: Annotated[
        float, measured("s", "Longest time by which steps are announced late.", ge=2)
    ] = 20.0
    share: Annotated[
        float,
        gate(
            "1", "Lateral range over the frontal and vertical from which on steps go aside.", ge=0
        ),
    ] = 2.6
    window: Annotated[
        float, gate("steps", "Least time that the vertical signal is above its mean.", ge=0)
    ] = 0.15
    density: Annotated[float, gate("1", "Least area density of the frontal pattern.", ge=0)] = 0.01
    vertical: Annotated[
        float, gate("m/s2", "Greatest range of the vertical acceleration of a step back.", gt=0)
    ] = 6.0
    order: Annotated[float, gate("steps", "Least distance of the two maxima.", ge=0)] = 0.0
    lobe: Annotated[
        float, gate("1", "Least distance of the lateral maximum from the middle.", ge=0)
    ] = 0.02
    slope: Annotated[float, gate("1", "Least logarithm of the steeper slope's excess.", ge=0)] = 0.0
    leading: Annotated[
        float, gate("1", "Least distance of the contact into the lateral pattern's steep side.")
    ] = -0.05
    support: Annotated[
        float, gate("1", "Least part of the steps around that are backward, too.", ge=0, le=1)
    ] = 0.7


class StepTypes(Stage):
    """A step is forward, backward, to the left or to the right by the order of its movements.

    Each step has one candidate for each type. That of the accepted one is given as a step again,
    with its type and of this stage; a step without one is given again as ``unknown``, but for the
    contact that closes the feet of a side step. Steps come out in the order of time. A gap that is
    not bridged ends all walks.
    """

    Parameters = StepTypeParameters
    takes = (Input(SignalBlock, hold=False), Input(StepEvent))
    gives = (StepEvent,)
    compiles = ("axes", "filters", "grid", "patterns", "strides")
    columns = (
        Quantity("evidence", "1"),
        Quantity("share", "1"),
        Quantity("window", "steps"),
        Quantity("density", "1"),
        Quantity("order", "steps"),
        Quantity("lobe", "1"),
        Quantity("slope", "1"),
        Quantity("leading", "1"),
        Quantity("own_share", "1"),
        Quantity("own_lead", "steps"),
        Quantity("step_time", "s"),
        Quantity("mounting", "rad"),
        Quantity("support", "1"),
        Quantity("vertical", "m/s2"),
    )
    gates = (
        Applies(Level("window", "steps", "window"), FRONTAL),
        Applies(Level("density", "1", "density"), FRONTAL),
        Applies(Level("vertical", "m/s2", "vertical", at_least=False), BACKWARD),
        Applies(Level("order", "steps", "order"), FRONTAL, against=BACKWARD),
        Applies(Level("share", "1", "share"), LATERAL),
        Applies(Level("lobe", "1", "lobe"), LATERAL),
        Applies(Level("slope", "1", "slope"), LATERAL),
        Duplicate(),
        Applies(Level("leading", "1", "leading"), LATERAL),
        Applies(Level("support", "1", "support"), BACKWARD),
    )

    def __init__(self, parameters: StepTypeParameters) -> None:
        self.parameters = parameters
        self.axis = WalkingAxis(parameters.forward != "walk")
        self._follower: StepWindowCollector | None = None
        self._decided: list[StepEvent] = []  # those whose candidates were yielded last

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin; what is known of the mounting stays."""
        if not BodyAxes.fits(context.stream):
            text = "no types of steps: expected accelerations along x, y and z"
            raise CannotStart(text)
        self._stage = context.stage
        if self._follower is None:
            self._follower = StepWindowCollector(self)
        return TYPES

    def process(self, item: SignalBlock | StepEvent) -> Iterator[Candidates]:
        """Take signal and steps; yield the candidates of steps whose types are known."""
        assert self._follower is not None  # it was started
        if isinstance(item, SignalBlock):
            self._follower.update(item)
            yield from self._complete(self._follower)
        else:
            self._follower.step(item)

    def flush(self) -> Iterator[Candidates]:
        """Yield those of the steps that waited for others; forget signal and steps."""
        if self._follower is not None:
            yield from self._complete(self._follower, final=True)
            self._follower.end()

    def decided(self, block: CandidateBlock) -> Iterator[StepEvent]:
        """Yield the steps just decided again, with the first type that was accepted of each."""
        accepted = block.accepted.reshape(-1, len(TYPES))
        failed = block.margin.reshape(*accepted.shape, -1) < 0
        evidence = block.value[:, 0].reshape(accepted.shape)
        for step, kinds, gates, type_evidence in zip(
            self._decided, accepted, failed, evidence, strict=True
        ):
            index = int(kinds.argmax())
            if kinds[index]:
                yield self._typed(step, TYPES[index], float(type_evidence[index]))
            elif not (gates.sum(axis=1) == gates[:, LEADING]).any():
                yield self._typed(step, UNKNOWN, 0.0)

    def _complete(
        self, follower: StepWindowCollector, *, final: bool = False
    ) -> Iterator[Candidates]:
        """Yield the candidates of the steps around which all is known."""
        complete_steps = list(follower.complete_steps(final=final))
        self._decided = [step for step, _ in complete_steps]
        if complete_steps:
            yield Candidates(
                np.repeat([step.time_ns for step in self._decided], len(TYPES)),
                np.tile(np.arange(len(TYPES), dtype=np.int32), len(complete_steps)),
                np.array([row for _, rows in complete_steps for row in rows], np.float32),
            )

    def _typed(self, step: StepEvent, kind: str, value: float) -> StepEvent:
        """Return a step again, with its type."""
        return replace(step, stage=self._stage, value=value, type=kind)

    def shape(
        self,
        time_ns: int,
        step_s: float,
        times_s: NDArray[np.float64],
        values: NDArray[np.float64],
    ) -> Shape:
        """Measure the next step; steps come in the order of time.

        Parameters
        ----------
        time_ns, step_s
            Its contact [ns] and the step time around it [s].
        times_s, values
            Times about the contact, shape (n,) [s], and accelerations ahead, to the right and up,
            shape (3, n) [m/s2].
        """
        strip = strip_of(times_s, values, step_s)
        swing = step_swing(strip, PHASE)
        if swing is not None:
            self.axis.add(swing)
        strip = self.axis.rotated(strip)
        angle = self.axis.angle_rad
        return Shape(time_ns, step_s, frontal(strip, swing), lateral(strip), angle)

    def rows(
        self, before: Sequence[Shape], step: Shape, after: Sequence[Shape]
    ) -> list[tuple[float, ...]]:
        """Return the columns of a step's four candidates, among those before and after it."""
        earlier, later = linked(step, before[:-3:-1]), linked(step, after[:2])
        lead = corrected_lead(
            [x.frontal for x in earlier], step.frontal, [x.frontal for x in later]
        )
        near = [step.frontal, *(x.frontal for x in (*earlier[:1], *later[:1]))]
        share = common_share([x.lateral for x in earlier], step.lateral, [x.lateral for x in later])
        window, density = max(x.window for x in near), max(x.density for x in near)
        lobe, inside = step.lateral.lobe, step.lateral.inside
        support = back_support([*earlier, step, *later])
        step_columns = (
            step.lateral.share,
            step.frontal.lead,
            step.step_s,
            step.mounting_rad,
            support,
            step.frontal.vertical,
        )
        candidates: list[tuple[float, ...]] = []
        for sign, index in ((1, 0), (-1, 1), (-1, 2), (1, 3)):
            order, slope = _signed(lead, sign), _signed(step.lateral.slopes, sign)
            evidence = order if index in FRONTAL else slope
            patterns = (share, window, density, order, lobe, slope, inside)
            candidates.append((evidence, *patterns, *step_columns))
        return candidates


def _signed(value: float, sign: int) -> float:
    """Return a value for one of two opposite types; 0 is for the first alone."""
    return value if sign > 0 else -value if value else -1e-6
