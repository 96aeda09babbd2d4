"""Step score: how much a moment at the trunk looks like a contact, whatever came before and after.

No rhythm is asked for: the first and the last step of a walk, steps in turns and single steps are
looked at one by one, as are those of one who walks very slowly.

1. Two accelerations are looked at, gravity taken out: upward, and forward. Forward is the level
   direction in which the force goes with the rate of the vertical one: a body is pushed off before
   a contact and braked after it, a quarter of a step ahead of its rise and fall (Zijlstra and Hof,
   Gait & Posture 18, 2003, show the order of events). So neither the way the sensor is turned nor a
   gyroscope is asked for.
2. The time scale is followed: how long a step lasts, by the mean frequency of the vertical
   acceleration (that of Rice, Bell System Technical Journal 24, 1945), once smoothed in proportion
   to the step time itself. Everything after is measured in that time, so that a slow walker looks
   like a quick one.
3. A network of one hidden layer looks at both accelerations up to two step times around a moment,
   and gives its likeness to a contact, 0 to 1.
4. Local maxima of the likeness are candidates.
5. A second network looks at each candidate once more, and at what stands around it: how strong the
   accelerations are some seconds before and after it, and the best likeness within some steps. What
   it says is the score. So the last step of a walk, a weak one, is known by the strong one before
   it and the quiet after it.

The weights of both networks stand beside this file; ``bench/train_step_score.py`` makes them from
named recordings.

Method and numbers are ours.
"""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import kernels
from ..dsp.filters import ExponentialMean
from ..dsp.resample import GRID_HZ, CentredFilter, ColumnBuffer, gaussian

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Step time of a usual walk, that of time scale 1 [s]. Source: definition, 1.8 steps a second.
USUAL_STEP_S = 1 / 1.8
#: Time scales that have a signal of their own, smoothed by so much; between them, those are mixed.
#: Chosen by judgement: from 3 steps a second to one in 2.2 s, a factor of 1.31 apart.
SCALES = np.geomspace(0.6, 4.0, 8)
#: Standard deviation of the smoothing Gaussian at time scale 1 [s]. Chosen by trial on back-steps
#: and mobgap, each person left out in turn (bench/step_people.py).
SMOOTH_S = 0.05
#: Points about a moment that the network looks at, at time scale 1 [points of the grid]. Chosen by
#: trial on the same: twice the reach gains nothing, and comes later.
TAPS = np.concatenate([[-44, -36, -30, -24], np.arange(-20, 21, 2), [24, 30, 36, 44]])
#: Standard deviation of the Gaussians that the forward axis is told with [s]. Chosen by judgement:
#: the step stays, its second peak goes.
_AXIS_S = 0.08
#: Memory of the forward axis, and how far ahead it is known by [s]. Chosen by trial on the same: 6
#: to 40 s and 2 to 8 s are alike; the shortest look ahead is taken.
_AXIS_MEMORY_S, AXIS_AHEAD_S = 15.0, 2.0
#: Points of the grid from one time scale to the next. Chosen by judgement: four a second.
_HOP = 10
#: Standard deviation and reach of the Gaussian over which the time scale is told [s]. Chosen by
#: judgement: some steps.
_SCALE_S, _SCALE_REACH = 2.0, 2.0
#: Mean square at time scale 1 that is added, so that of hardly any movement the scale is 1
#: [(m/s2)^2]. Chosen by trial on the same: 0.0002 loses 0.002 of F1.
_LITTLE = 0.005
#: Longest look ahead of a moment [points of the grid]. Source: definition.
_AHEAD = int(np.ceil(TAPS[-1] * SCALES[-2])) + 1
#: How far a higher score is looked for, in step times. Chosen by judgement: farther away it is that
#: of another step.
APART_STEPS = 0.5
#: Longest look for a higher score [points of the grid]. Source: definition.
_NEAR = int(np.ceil(APART_STEPS * USUAL_STEP_S * SCALES[-2] * GRID_HZ)) + 1
#: Lowest likeness of a candidate. Chosen by judgement: below it is most of standing still.
LEAST_LIKENESS = 0.02
#: Where the strength of the movement about a candidate is told [points of the grid]: 3 s before it
#: to 2 s after it. Chosen by trial on the same: without it fewer last steps are found.
_BANDS = ((-120, -40), (-40, -12), (-12, 12), (12, 40), (40, 80))
#: Least strength that is told from another [m/s2]. Chosen by judgement: noise of a phone's sensor.
_QUIET_MPS2 = 0.05
#: Where the best other candidate is looked for [step times]; after a candidate, only the first two.
#: Chosen by judgement: half a step to a step, a stride, two strides.
_NEIGHBOURS = ((0.36, 0.75), (0.75, 1.4), (1.4, 2.2), (2.2, 4.0))
_AFTER = 2
#: How far before and after a candidate its neighbours are kept [points of the grid]. Source:
#: definition: the longest of :data:`_NEIGHBOURS` at the longest step time, and of :data:`_BANDS`.
_REMEMBERED = int(np.ceil(_NEIGHBOURS[-1][1] * USUAL_STEP_S * SCALES[-2] * GRID_HZ)) + 1
_LOOKED_AHEAD = _BANDS[-1][1]
#: What the second network looks at: four of the candidate, its neighbours, both accelerations at
#: all taps, and their strengths. Source: definition.
INPUTS = 4 + len(_NEIGHBOURS) + _AFTER + 2 * len(TAPS) + 2 * len(_BANDS)
#: Logarithm of the odds where there is no other candidate. Chosen by judgement: below any
#: candidate's.
_NOBODY = -5.0
#: Likeness is told within this and as much less than 1. Chosen by judgement: surer is no surer.
_SURE = 1e-3


#: A point of the grid is a contact, in training, by a Gaussian of this about each [s]. Chosen by
#: trial on back-steps and mobgap: 0.035 and 0.07 are alike.
CONTACT_S = 0.05
#: Least standard deviation of a step's time [s]. Chosen by trial on the same: what is left
#: where the score is sharpest.
_CERTAIN_S = 0.02
_TAPS, _LOGARITHMS = TAPS.astype(np.float64), np.log(SCALES)


class Network(NamedTuple):
    """A network of one hidden layer.

    Attributes
    ----------
    hidden, bias
        Of the hidden layer, shape (inputs, units) and (units,).
    out, offset
        Of the logarithm of the odds, shape (units,), and one number.
    """

    hidden: Array
    bias: Array
    out: Array
    offset: float


class Weights(NamedTuple):
    """What both networks were trained to.

    Attributes
    ----------
    moment
        Of the likeness; its inputs are accelerations, shape (2 taps,) [m/s2].
    candidate
        Of the score; its inputs are those of :func:`surroundings`.
    mean_step
        The mean step: acceleration upward, then forward, shape (2 taps,) [m/s2].
    """

    moment: Network
    candidate: Network
    mean_step: Array


@cache
def trained() -> Weights:
    """Return the weights that stand beside this file; to read only."""
    text = resources.files(__package__).joinpath("step_score.json").read_text("utf-8")
    weights = json.loads(text)
    return Weights(
        _network(weights["moment"]),
        _network(weights["candidate"]),
        np.array(weights["usual"], np.float64),
    )


def _network(weights: dict[str, object]) -> Network:
    hidden, bias, out = (np.array(weights[name], np.float64) for name in ("hidden", "bias", "out"))
    return Network(hidden, bias, out, float(weights["offset"]))  # type: ignore[arg-type]


class Windows(NamedTuple):
    """What the network looks at, point by point of the grid.

    Attributes
    ----------
    seen
        Accelerations upward, then forward, at :data:`TAPS`, shape (n, 2 taps) [m/s2].
    step_s
        Step time, shape (n,) [s].
    """

    seen: Array
    step_s: Array


def moving(force: Array, gravity: Array) -> Array:
    """Return the acceleration upward, and its rest along the sensor's axes, gravity taken out.

    Parameters
    ----------
    force, gravity
        Shape (3, n) [m/s2].

    Returns
    -------
    Shape (4, n) [m/s2].
    """
    length = np.sqrt(np.einsum("cn,cn->n", gravity, gravity))
    unit = np.divide(gravity, length, out=np.zeros_like(gravity), where=length > 0)
    up = np.einsum("cn,cn->n", force, unit)
    return np.concatenate([(up - length)[None, :], force - up * unit])


class ForwardAxis:
    """Finds the forward acceleration, by the level force that goes with the vertical rate.

    What is known of the axis at a moment is a mean of what was before it, and of ``ahead_s`` after.
    """

    def __init__(self) -> None:
        kernel = gaussian(_AXIS_S)
        self._smooth = CentredFilter(kernel)
        self._rate = CentredFilter(np.gradient(kernel) * GRID_HZ)
        self._mean = ExponentialMean(1.0 - float(np.exp(-1.0 / (_AXIS_MEMORY_S * GRID_HZ))))
        self._moving = ColumnBuffer(4)
        self._axis = ColumnBuffer(3)

    def __call__(self, moving: Array) -> Array:
        """Take accelerations, upward and level, shape (4, n); return upward and forward, (2, m)."""
        self._moving.add(moving)
        self._axis.add(self._mean(self._smooth(moving[1:]) * self._rate(moving[:1])))
        return self._until(self._axis.end - round(AXIS_AHEAD_S * GRID_HZ))

    def flush(self) -> Array:
        """Return those of the points up to the end."""
        if not self._moving.end:
            return np.empty((2, 0))
        self._axis.add(self._mean(self._smooth.flush() * self._rate.flush()))
        padding = np.repeat(self._axis.values[:, -1:], round(AXIS_AHEAD_S * GRID_HZ), axis=1)
        self._axis.add(padding)
        return self._until(self._moving.end)

    def _until(self, end: int) -> Array:
        start = self._moving.first
        end = max(start, end)
        ahead = round(AXIS_AHEAD_S * GRID_HZ)
        moving = self._moving.between(start, end)
        axis = self._axis.between(start + ahead, end + ahead)
        length = np.sqrt(np.einsum("cn,cn->n", axis, axis))
        dot = np.einsum("cn,cn->n", moving[1:], axis)
        forward = np.divide(dot, length, out=np.zeros_like(dot), where=length > 0)
        components = np.stack([moving[0], forward])
        self._moving.discard_before(end)
        self._axis.discard_before(end + ahead)
        return components


class SmoothedScales:
    """Smooths two accelerations for each of :data:`SCALES`: rows of a scale stand together."""

    def __init__(self) -> None:
        self._filters = [CentredFilter(gaussian(SMOOTH_S * scale)) for scale in SCALES]
        self._buffers = [ColumnBuffer(2) for _ in SCALES]

    def __call__(self, pair: Array) -> Array:
        """Take points, shape (2, n); return those that all scales have, shape (2 scales, m)."""
        for smooth, buffer in zip(self._filters, self._buffers, strict=True):
            buffer.add(smooth(pair))
        return self._common()

    def flush(self) -> Array:
        """Return the points up to the end."""
        for smooth, buffer in zip(self._filters, self._buffers, strict=True):
            left = smooth.flush()
            if left.shape[1]:
                buffer.add(left)
        return self._common()

    def _common(self) -> Array:
        start = self._buffers[0].first
        end = min(buffer.end for buffer in self._buffers)
        points = np.concatenate([buffer.between(start, end) for buffer in self._buffers])
        for buffer in self._buffers:
            buffer.discard_before(end)
        return points


class TimeScale:
    """Follows how long a step lasts, by the mean frequency of the vertical acceleration.

    Of each scale the mean frequency over some seconds is told, smoothed in proportion to it. Where
    that frequency is the scale's own, the scale is that of the steps.
    """

    def __init__(self) -> None:
        reach = round(_SCALE_REACH * _SCALE_S * GRID_HZ / _HOP)
        near = np.arange(-reach, reach + 1) * _HOP / GRID_HZ
        weights = np.exp(-0.5 * (near / _SCALE_S) ** 2)
        self._mean = CentredFilter(weights / weights.sum())
        self._even = CentredFilter(np.array([0.25, 0.5, 0.25]))
        self._up = ColumnBuffer(len(SCALES))
        self._before: Array | None = None

    def __call__(self, up: Array) -> Array:
        """Take the vertical acceleration of each scale, (scales, n); return logarithms, (1, m)."""
        self._up.add(up)
        sample_count = self._up.values.shape[1] // _HOP * _HOP
        return self._even(_own_scale(self._mean(self._squares(sample_count, _HOP))))

    def flush(self) -> Array:
        """Return those of the hops up to the end, of which the last may be short."""
        left = self._up.values.shape[1]
        if not self._up.end:
            return np.empty((1, 0))
        short = self._squares(left, left) if left else np.empty((2 * len(SCALES), 0))
        mean_squares = np.concatenate([self._mean(short), self._mean.flush()], axis=1)
        return np.concatenate([self._even(_own_scale(mean_squares)), self._even.flush()], axis=1)

    def _squares(self, count: int, hop: int) -> Array:
        """Return mean squares of the next points and of their rates, hop by hop."""
        start = self._up.first
        points = self._up.between(start, start + count)
        if not count:
            return np.empty((2 * len(SCALES), 0))
        before = points[:, :1] if self._before is None else self._before
        rate = np.diff(points, axis=1, prepend=before) * GRID_HZ
        self._before = points[:, -1:].copy()
        self._up.discard_before(start + count)
        both = np.concatenate([points, rate])
        return np.asarray((both * both).reshape(len(both), -1, hop).mean(axis=2))


def _own_scale(squares: Array) -> Array:
    """Return the logarithm of the time scale of each hop, shape (1, n), by mean squares."""
    count = len(SCALES)
    if not squares.shape[1]:
        return np.empty((1, 0))
    omega_squared = (2 * np.pi / USUAL_STEP_S) ** 2
    # what a scale's frequency is told by is smoothed as the next scale is
    power, rates = squares[1:count], squares[count + 1 :]
    scales = np.log(SCALES[:-1])
    ratio = (rates + _LITTLE * omega_squared) / ((power + _LITTLE) * omega_squared)
    above = 0.5 * np.log(ratio) + scales[:, None]
    last = len(scales) - 1
    passed = above >= 0
    index = np.clip(np.argmax(passed, axis=0), 1, last)
    at = np.arange(above.shape[1])
    low, high = above[index - 1, at], above[index, at]
    part = np.clip(np.divide(-low, high - low, out=np.ones_like(low), where=high != low), 0, 1)
    log_scale = scales[index - 1] + part * (scales[index] - scales[index - 1])
    return np.asarray(np.where(passed.any(axis=0), log_scale, scales[last])[None, :])


class StepWindows:
    """Brings the surroundings of every point of the grid to the time scale of its steps."""

    def __init__(self) -> None:
        self._axis = ForwardAxis()
        self._smoothed = SmoothedScales()
        self._scale = TimeScale()
        self._points = ColumnBuffer(2 * len(SCALES))
        self._hops = ColumnBuffer(1)
        self._next = 0

    def __call__(self, moving: Array) -> Windows:
        """Take accelerations, upward and level, shape (4, n); return the points known by now."""
        self._take(self._smoothed(self._axis(moving)))
        complete_end = (self._hops.end - 1) * _HOP + _HOP // 2
        return self._until(min(complete_end, self._points.end - _AHEAD))

    def flush(self) -> Windows:
        """Return the points up to the end."""
        last = self._smoothed(self._axis.flush())
        self._take(np.concatenate([last, self._smoothed.flush()], axis=1))
        self._hops.add(self._scale.flush())
        return self._until(self._points.end)

    def _take(self, points: Array) -> None:
        self._points.add(points)
        self._hops.add(self._scale(points[::2]))

    def _until(self, end: int) -> Windows:
        start, self._next = self._next, max(self._next, end)
        if self._next == start:
            return Windows(np.empty((0, 2 * len(TAPS))), np.empty(0))
        seen, scale = kernels.steps.scaled_windows(
            self._points.contiguous(),
            self._points.first,
            (start, self._next),
            self._hops.contiguous()[0],
            self._hops.first,
            _HOP,
            _LOGARITHMS,
            _TAPS,
        )
        self._points.discard_before(self._next - _AHEAD)
        self._hops.discard_before(self._next // _HOP - 1)
        return Windows(seen, USUAL_STEP_S * np.exp(scale))


class Scores(NamedTuple):
    """What the network says of consecutive points of the grid, shape (n,) each.

    Attributes
    ----------
    odds
        Logarithm of the odds that the score is.
    vertical, forward
        What there is of the usual step's acceleration upward and forward, 1 of a usual one.
    """

    odds: Array
    vertical: Array
    forward: Array


def scores(seen: Array, weights: Weights) -> Scores:
    """Return what the network says of windows, shape (n, 2 taps)."""
    return Scores(
        *kernels.steps.scores(seen, *weights.moment[:3], weights.mean_step, weights.moment[3])
    )


def probability(odds: Array) -> Array:
    """Return the score that logarithms of odds stand for, 0 to 1."""
    return np.asarray(1.0 / (1.0 + np.exp(-odds)))


#: Columns of what is measured of a candidate: where it is [points of the grid since the start of
#: the run]; its likeness; time to the nearest higher one, in step times, at most
#: :data:`APART_STEPS`; what there is of the usual step's accelerations; standard deviation of the
#: time [s]; step time [s].
PEAKS = ("place", "likeness", "apart", "vertical", "forward", "uncertainty", "step_s")
#: Columns of what is judged of it: the same, the score after the likeness.
COLUMNS = (*PEAKS[:2], "score", *PEAKS[2:])


class ScorePeaks:
    """Finds the local maxima of the likeness."""

    def __init__(self) -> None:
        self._points = ColumnBuffer(4)
        self._next = 1  # a maximum has a neighbour on either side

    def __call__(self, point_scores: Scores, step_s: Array) -> Array:
        """Take points; return the candidates whose surroundings are complete, (n, PEAKS)."""
        self._points.add(np.stack([*point_scores, step_s]))
        peaks = self._until(self._points.end - _NEAR)
        self._points.discard_before(self._next - _NEAR)
        return peaks

    def flush(self) -> Array:
        """Return the candidates that waited; a maximum at the very end is not one."""
        return self._until(self._points.end - 1)

    def _until(self, end: int) -> Array:
        if end <= self._next:
            return np.empty((0, len(PEAKS)))
        span, self._next = (self._next, end), end
        peaks: Array = kernels.steps.score_peaks(
            self._points.contiguous(),
            self._points.first,
            span,
            LEAST_LIKENESS,
            APART_STEPS,
            GRID_HZ,
            (CONTACT_S, _CERTAIN_S),
        )
        return peaks


class Surroundings:
    """Brings what stands around each candidate together: what the second network looks at."""

    def __init__(self) -> None:
        self._peaks = ScorePeaks()
        self._seen = ColumnBuffer(2 * len(TAPS))
        self._rows = np.empty((0, len(PEAKS)))
        self._looked = 0  # rows before this one were given already

    def __call__(self, seen: Array, point_scores: Scores, step_s: Array) -> tuple[Array, Array]:
        """Take points; return candidates whose surroundings are complete, and these.

        Returns
        -------
        Candidates, shape (k, PEAKS), and their surroundings, shape (k, inputs).
        """
        self._seen.add(seen.T)
        self._rows = np.concatenate([self._rows, self._peaks(point_scores, step_s)])
        return self._until(self._seen.end - _NEAR - _LOOKED_AHEAD)

    def flush(self) -> tuple[Array, Array]:
        """Return those that waited."""
        self._rows = np.concatenate([self._rows, self._peaks.flush()])
        return self._until(self._seen.end)

    def _until(self, end: int) -> tuple[Array, Array]:
        places, start = np.rint(self._rows[:, 0]), self._looked
        self._looked = max(start, int(np.searchsorted(places, end)))
        ready = slice(start, self._looked)
        rows, inputs = self._rows[ready], np.empty((0, INPUTS))
        if len(rows):
            inputs = surroundings(self._rows, _odds(self._rows[:, 1]), ready, self._seen)
            first_row = int(np.searchsorted(places, places[self._looked - 1] - _REMEMBERED))
            self._rows, self._looked = self._rows[first_row:], self._looked - first_row
        self._seen.discard_before(max(end, 0) + _BANDS[0][0] - 1)
        return rows, inputs


def surroundings(rows: Array, odds: Array, chosen: slice, seen: ColumnBuffer) -> Array:
    """Return what stands around some of the candidates.

    Parameters
    ----------
    rows
        Candidates in the order of time, shape (k, PEAKS).
    odds
        Logarithms of their odds, shape (k,).
    chosen
        Which ones: m of them.
    seen
        What the first network looked at, by the place.

    Returns
    -------
    Shape (m, inputs): logarithm of the candidate's odds, time to a higher one, standard deviation
    of the time, step time; the best odds of neighbours; accelerations at :data:`TAPS`; logarithms
    of their strength.
    """
    candidates = rows[chosen]
    index, step_s = np.rint(candidates[:, 0]).astype(np.intp), candidates[:, 6]
    apart = rows[:, 0] - candidates[:, :1]
    away, ahead = apart / (GRID_HZ * step_s[:, None]), apart <= _LOOKED_AHEAD
    best = [_best(odds, (-away > low) & (-away <= high)) for low, high in _NEIGHBOURS]
    best += [
        _best(odds, (away > low) & (away <= high) & ahead) for low, high in _NEIGHBOURS[:_AFTER]
    ]
    at = index.clip(seen.first, seen.end - 1) - seen.first
    middle = seen.values[[len(TAPS) // 2, len(TAPS) + len(TAPS) // 2]]
    strength = [_strength(middle, index - seen.first, *band) for band in _BANDS]
    measured = [odds[chosen], candidates[:, 2], candidates[:, 5], step_s]
    return np.column_stack([*measured, *best, seen.values[:, at].T, *strength])


def _odds(likeness: Array) -> Array:
    """Return the logarithm of odds, within what is told apart."""
    clipped = likeness.clip(_SURE, 1 - _SURE)
    return np.asarray(np.log(clipped / (1 - clipped)))


def _best(odds: Array, near: NDArray[np.bool_]) -> Array:
    """Return the best odds of those near each of m candidates, shapes (k,) and (m, k).

    No candidate's odds are as low as those of nobody.
    """
    best: Array = np.broadcast_to(odds, near.shape).max(axis=1, where=near, initial=_NOBODY)
    return best


def _strength(values: Array, index: NDArray[np.intp], low: int, high: int) -> Array:
    """Return the logarithms of the strength of two accelerations around places, shape (m, 2)."""
    points = index[:, None] + np.arange(low, high)
    inside = (points >= 0) & (points < values.shape[1])
    around = values.take(points, axis=1, mode="clip")  # sums are the same whatever the blocks
    square = (around * around * inside).sum(axis=2) / np.maximum(inside.sum(axis=1), 1)
    return np.asarray(np.log(_QUIET_MPS2 + np.sqrt(square.T)))


def judged(rows: Array, inputs: Array, network: Network) -> Array:
    """Return candidates with their score, shape (k, COLUMNS), by what stands around them."""
    if not len(rows):
        return np.empty((0, len(COLUMNS)))
    nothing = np.zeros(inputs.shape[1])  # no usual share of surroundings is asked for
    odds = kernels.steps.scores(np.ascontiguousarray(inputs), *network[:3], nothing, network[3])[0]
    return np.insert(rows, 2, probability(odds), axis=1)
