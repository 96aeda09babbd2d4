"""Places by arrivals and heights of waves together, on a floor that is learnt meanwhile.

A wave comes later the farther it runs, and lower. Times alone leave a curve of places where sensors
are few, heights another one. Arrival and height of impact i at sensor j are

    t_ij = t_i + k d_ij^p,    log a_ij = s_i + g_j - n log d_ij,

with the pace k and the decay n of the floor and the gain g_j of each sensor shared by all impacts.
Arrivals err by a part of their way besides a constant, heights by a factor, both by Student's law,
whose long tails let some be false; a height that clips is a lower bound. The height is the first
few milliseconds' peak: later ones are those of echoes, and clip.

What is shared is not fitted: each of a grid of paces, decays and errors has a weight, how likely it
makes the impacts so far, and a place is the mean over all of them (Bayesian model averaging; J. A.
Hoeting and others, Statistical Science 14, 1999). So a floor that is not known makes regions wide
by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Fix
from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .. import kernels
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import LEAST_PICKS, LocationEstimate, no_location
from .array_method import ArrayMethod, ArrayParameters, takes_steps
from .base import columns, gates, place_candidate
from .path_errors import PathErrors
from .tdoa import lattice

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..pipeline.gates import Candidates
    from .array_method import Window

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Index = NDArray[np.intp]

#: Paces [s/m], constant errors of arrivals [s], and by what part of their way they err, and decays
#: and errors of logarithms of heights that are tried. Chosen by judgement: 170 to 4000 m/s;
#: arrivals right to a tenth of a ms or, in noise, to 1 ms; a wave on a floor falls with the root of
#: distance to its square.
ERRORS = ((1e-4, 0.05), (1e-4, 0.2), (3e-4, 0.1), (1e-3, 0.2))
BY_TIME = np.array([(pace, *error) for pace in np.geomspace(2.5e-4, 6e-3, 14) for error in ERRORS])
SPREADS = (0.1, 0.2, 0.4, 0.8)
BY_HEIGHT = np.array([(n, spread) for n in (0.5, 1.0, 1.5, 2.0, 2.5) for spread in SPREADS])
#: Expected logarithm of the pace and decay, and their deviations. Chosen by judgement: 1100 m/s to
#: a factor of 2; a wave over a floor.
PACE_PRIOR, DECAY_PRIOR = (np.log(9e-4), 0.7), (1.0, 0.5)
#: Expected deviation of the logarithm of a gain. Chosen by judgement: sensors of one kind.
GAIN_DEVIATION = 0.3
#: Degrees of freedom of Student's law. Bench: onsets of impacts, room_laws.py's seeds 104 to 140 by
#: four, 4 and 9 sensors: 2, 3 and 5 err alike, 3 claims nearest to what it holds.
FREEDOM = 3.0
#: Nodes along the room that weights are found at, and places. Chosen by judgement: half a metre
#: tells floors apart.
COARSE, FINE = 14, 28
#: Passes of reweighting, and the least distance [m]. Chosen by judgement: passes settle in four;
#: beside a sensor the laws have no limit.
PASSES, NEAREST_M = 4, 0.15
#: Floors that count less than this part of the likeliest one are left out of a place; a law is
#: given up for the rest of the recording where no floor with it has a weight whose logarithm is
#: above this. Chosen by judgement: one impact does not bring a floor back from there.
LEAST_WEIGHT, GIVEN_UP = 0.02, -40.0
#: No likelihood is lower, so that each has a logarithm. Source: definition.
LEAST_LIKELIHOOD = 1e-300
#: The peak is looked for from so long before the arrival on [s], where it is so much over the
#: noise. Chosen by judgement: an arrival by correlation may lie behind its onset.
EARLY_S, OVER_NOISE = 5e-4, 2.0
#: A top is flat where so many samples share it and the signal leaves it by so many steps of the
#: digitiser. Chosen by judgement: a rounded top leaves by one.
FLAT, LEAVES = 3, 3.0


@dataclass(frozen=True, slots=True)
class TimesAmplitudesParameters(ArrayParameters):
    """Parameters of :class:`TimesAmplitudes`."""

    peak_s: Annotated[
        float, measured("s", "The peak is that of so long after an arrival.", gt=0, le=0.02)
    ] = 0.004
    exponent: Annotated[
        float, measured("1", "Power of distance that arrivals grow with.", gt=0, le=2)
    ] = 1.0
    min_picks: Annotated[int, gate("1", "Least number of arrivals, one a channel.", ge=3)] = 3
    max_residual_s: Annotated[float, gate("s", "Largest median that arrivals are off.", ge=0)] = (
        0.01
    )


@dataclass(slots=True, eq=False)
class FloorWeights:
    """How likely each floor of the grid makes the impacts so far.

    Attributes
    ----------
    log
        Shape (len(BY_TIME), len(BY_HEIGHT)): logarithm of the weight.
    """

    log: Array

    @classmethod
    def prior(cls) -> FloorWeights:
        """Return the weights before there are impacts."""
        pace = ((np.log(BY_TIME[:, 0]) - PACE_PRIOR[0]) / PACE_PRIOR[1]) ** 2
        decay = ((BY_HEIGHT[:, 0] - DECAY_PRIOR[0]) / DECAY_PRIOR[1]) ** 2
        return cls(-(pace[:, None] + decay) / 2)

    @property
    def weight(self) -> Array:
        """The weights themselves, at most 1."""
        return np.asarray(np.exp(self.log - self.log.max()))

    def above(self, log: float) -> tuple[Index, Index]:
        """Return which laws of time and of height are part of a floor that weighs so much."""
        counted = self.log > log
        return np.flatnonzero(counted.any(axis=1)), np.flatnonzero(counted.any(axis=0))

    def learn(self, times: Array, heights: Array, floors: tuple[Index, Index]) -> None:
        """Take in an impact: log likelihoods by time and by height, (..., q) each, of some floors.

        The others are given up.
        """
        t_most, h_most = times.max(axis=1, keepdims=True), heights.max(axis=1, keepdims=True)
        evidence = np.exp(times - t_most) @ np.exp(heights - h_most).T
        log, some = np.full_like(self.log, -np.inf), np.ix_(*floors)
        log[some] = self.log[some] + t_most + h_most.T
        log[some] += np.log(np.maximum(evidence, LEAST_LIKELIHOOD))
        self.log = log - log.max()


def time_logs(times_s: Array, u: Array, floors: Array) -> Array:
    """Return the log likelihood of arrivals by floor and node, shape (h, q).

    Parameters
    ----------
    times_s
        Shape (n,): finite arrivals [s].
    u
        Shape (n, q): distances to the power of the exponent.
    floors
        Shape (h, 3): pace and constant error of each [s], and the part of their time on the way
        that arrivals err by.
    """
    return _student(times_s, np.zeros(len(times_s), np.bool_), floors, u)


def height_logs(heights: Array, clipped: Flags, log_d: Array, floors: Array) -> Array:
    """Return the log likelihood of heights by floor and node, shape (h, q).

    Parameters
    ----------
    heights
        Shape (n,): logarithms, gains taken off.
    clipped
        Shape (n,): which are lower bounds.
    log_d
        Shape (n, q): logarithms of distances [m].
    floors
        Shape (h, 2): decay and error of each.
    """
    falling = np.column_stack([-floors[:, 0], floors[:, 1], np.zeros(len(floors))])
    return _student(heights, clipped, falling, log_d)


def _student(values: Array, bound: Flags, laws: Array, field: Array) -> Array:
    """Return log likelihoods about the best common level by Student's law, shape (h, q)."""
    logs = np.empty((len(laws), field.shape[1]))
    kernels.locate.student_logs(
        values, bound, np.ascontiguousarray(laws), field, FREEDOM, PASSES, logs
    )
    return logs


@dataclass(slots=True, eq=False)
class JointPlaces:
    """Places of impacts in a room, and the floor by those so far.

    Attributes
    ----------
    positions, outline
        Shapes (n, 2) and (k, 2), or None [m].
    parameters
        Of the localizer.
    """

    positions: Array
    outline: Array | None
    parameters: TimesAmplitudesParameters
    weights: FloorWeights = field(default_factory=FloorWeights.prior)
    gains: Array = field(init=False)
    _sums: Array = field(init=False)
    _errors: PathErrors = field(init=False)

    def __post_init__(self) -> None:
        self.gains = np.zeros(len(self.positions))
        self._sums = np.zeros((2, len(self.positions)))
        self._errors = PathErrors(self.positions, self.parameters.exponent)

    def locate(self, times_s: Array, heights: Array, clipped: Flags) -> LocationEstimate:
        """Return the place of an impact, and learn from it.

        Parameters
        ----------
        times_s
            Shape (n,): arrivals [s]; NaN where a sensor has none.
        heights
            Shape (n,): logarithms of peaks; NaN likewise.
        clipped
            Shape (n,): which peaks are lower bounds.
        """
        picks = int(np.isfinite(times_s).sum())
        if picks < LEAST_PICKS:
            return no_location(picks)
        likely = self.weights.above(GIVEN_UP)
        self.weights.learn(*self._logs(times_s, heights, clipped, COARSE, likely), likely)
        counted = self.weights.above(np.log(LEAST_WEIGHT))
        area = lattice(self.positions, self.outline, 1.0, FINE)
        by_time, by_height = (
            np.exp(logs - logs.max(axis=1, keepdims=True))
            for logs in self._logs(times_s, heights, clipped, FINE, counted)
        )
        # a floor's weight has this impact in it: within it the nodes share
        weight = self.weights.weight
        floors = np.where(weight >= LEAST_WEIGHT, weight, 0.0)[np.ix_(*counted)]
        floors /= np.maximum(by_time @ by_height.T, LEAST_LIKELIHOOD)
        share = (by_time * (floors @ by_height)).sum(axis=0)
        share /= share.sum()
        mean = share @ area.nodes
        off = area.nodes - mean
        covariance = (off.T * share) @ off + area.spacing**2 / 12 * np.eye(2)
        best = np.unravel_index(int(weight.argmax()), weight.shape)
        self._learn_gains(share, heights, clipped, int(best[1]))
        residual = self._residual_s(mean, times_s, int(best[0]))
        estimate = LocationEstimate(float(mean[0]), float(mean[1]), covariance, residual, picks)
        return self._errors.widened(estimate, times_s)

    def _logs(
        self,
        times_s: Array,
        heights: Array,
        clipped: Flags,
        nodes: int,
        floors: tuple[Index, Index],
    ) -> tuple[Array, Array]:
        """Return the log likelihoods by some floors at the nodes of a lattice."""
        p = self.parameters
        distance = np.maximum(lattice(self.positions, self.outline, 1.0, nodes).u, NEAREST_M)
        arrived, high = np.isfinite(times_s), np.isfinite(heights)
        times, u = times_s[arrived] - times_s[arrived].min(), distance[arrived] ** p.exponent
        by_time = time_logs(times, u, BY_TIME[floors[0]])
        if high.sum() < LEAST_PICKS:
            return by_time, np.zeros((len(floors[1]), distance.shape[1]))
        level, log_d = (heights - self.gains)[high], np.log(distance[high])
        return by_time, height_logs(level, clipped[high], log_d, BY_HEIGHT[floors[1]])

    def _learn_gains(self, share: Array, heights: Array, clipped: Flags, floor: int) -> None:
        """Take in what heights are off at a place, by the likeliest decay."""
        measured = np.isfinite(heights) & ~clipped
        if measured.sum() < LEAST_PICKS:
            return
        decay, spread = BY_HEIGHT[floor]
        distance = np.maximum(lattice(self.positions, self.outline, 1.0, FINE).u, NEAREST_M)
        level = heights + decay * (np.log(distance) @ share)
        off = level - np.median(level[measured])
        near = measured & (np.abs(off) < 3 * spread + GAIN_DEVIATION)
        self._sums[0, near] += off[near]
        self._sums[1, near] += 1
        gains = self._sums[0] / (self._sums[1] + (spread / GAIN_DEVIATION) ** 2)
        self.gains = gains - gains.mean()

    def _residual_s(self, position: Array, times_s: Array, floor: int) -> float:
        """Return the median that arrivals are off at a place, by the likeliest pace [s]."""
        distance = np.hypot(*(self.positions - position).T) ** self.parameters.exponent
        late = times_s - BY_TIME[floor, 0] * distance
        late = late[np.isfinite(late)]
        return float(np.median(np.abs(late - np.median(late))))


@dataclass(frozen=True, slots=True, eq=False)
class StepPeaks:
    """Arrivals and first peaks of a step at the sensors.

    Attributes
    ----------
    step_ns
        The step's first arrival.
    times_s
        Shape (n,): arrivals [s]; NaN where a sensor has none.
    heights
        Shape (n,): logarithms of peaks; NaN likewise.
    clipped
        Shape (n,): which peaks are lower bounds.
    """

    step_ns: int
    times_s: Array
    heights: Array
    clipped: Flags


def peaks(window: Window, arrivals_s: Array, peak_s: float) -> tuple[Array, Flags]:
    """Return the logarithm of each channel's first peak, NaN where there is none, and if it clips.

    Parameters
    ----------
    window
        Around a step.
    arrivals_s
        Shape (n_channels,): after the window's start [s].
    peak_s
        How long after an arrival its peak comes at most [s].
    """
    rate_hz, values = window.rate_hz, window.values
    heights, clipped = np.full(len(arrivals_s), np.nan), np.zeros(len(arrivals_s), np.bool_)
    arrived = np.isfinite(arrivals_s)
    if not arrived.any():
        return heights, clipped
    quiet = values[: max(2, round((float(arrivals_s[arrived].min()) - 8 * EARLY_S) * rate_hz))]
    still, noise = quiet.mean(axis=0), quiet.std(axis=0)
    steps = np.abs(np.diff(values, axis=0))
    unit = np.where(steps > 0, steps, np.inf).min(axis=0, initial=np.inf)
    for channel in np.flatnonzero(arrived):
        start = max(0, round((arrivals_s[channel] - EARLY_S) * rate_hz))
        part = values[start : start + max(2, round((EARLY_S + peak_s) * rate_hz)), channel]
        if len(part) < 2:
            continue
        size = np.abs(part - still[channel])
        if size.max() > OVER_NOISE * noise[channel]:
            heights[channel] = np.log(size.max())
            clipped[channel] = _is_flat(part, int(size.argmax()), float(unit[channel]))
    return heights, clipped


def _is_flat(part: Array, top: int, unit: float) -> bool:
    """Whether samples about the top share its value and leave it steeply.

    ``unit`` is the digitiser's step; infinite where no sample differs from the next.
    """
    if np.isinf(unit):
        return False
    off = np.abs(part - part[top]) / unit
    first, last = top - 1, top + 1
    while first >= 0 and off[first] < 0.5:
        first -= 1
    while last < len(part) and off[last] < 0.5:
        last += 1
    left = [off[i] for i in (first, last) if 0 <= i < len(part)]
    return last - first - 1 >= FLAT and bool(left) and min(left) >= LEAVES


class TimesAmplitudes(ArrayMethod):
    """Arrivals and heights of waves together: for few sensors, and onsets that are rough."""

    Parameters = TimesAmplitudesParameters
    takes = takes_steps(SEISMIC_QUANTITIES)
    needs = "places of three or more sensors"
    gives = (Fix,)
    compiles = ("locate",)
    site_lengths = True
    columns = columns("s")
    gates = gates("s", "max_residual_s")

    def __init__(self, parameters: TimesAmplitudesParameters) -> None:
        self.parameters = parameters

    def prepare(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Begin with the places of the channels."""
        names = tuple(c.name for c in stream.channels)
        rows, positions = geometry.placed(names)
        if len(np.unique(positions, axis=0)) < LEAST_PICKS or geometry.length_unit != "m":
            return ()
        self._columns = [names.index(name) for name in rows]
        outline = np.array(geometry.outline, np.float64)
        self._places = JointPlaces(positions, outline if len(outline) else None, self.parameters)
        return ("all",)

    def measure(self, window: Window, *, beforehand: bool = False) -> StepPeaks:  # noqa: ARG002
        """Return the arrivals and heights of a step."""
        heights, clipped = peaks(window, window.arrivals_s, self.parameters.peak_s)
        chosen = self._columns
        return StepPeaks(
            window.step_ns, window.arrivals_s[chosen], heights[chosen], clipped[chosen]
        )

    def examine(self, measured: StepPeaks) -> Candidates:
        """Return the place of a step."""
        estimate = self._places.locate(measured.times_s, measured.heights, measured.clipped)
        self._latest_estimate = measured.step_ns, estimate
        return place_candidate(*self._latest_estimate)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts."""
        if block.accepted[0]:
            time_ns, estimate = self._latest_estimate
            yield estimate.fix(time_ns, "times-amplitudes", self._stage)
