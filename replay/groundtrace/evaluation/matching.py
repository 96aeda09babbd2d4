"""Matching of event times to true ones, and the F1 that blind detectors reach.

The score's page, ``why``, ``compare``, the timeline and fleets all match here. A step found at the
wrong time is one case: a missed true step and the unmatched detection near it belong together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..dsp.assignment import assign
from ..dsp.robust import medians

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label

#: A detection answers a true step within this [s]. Chosen by what a blind metronome scores at the
#: pace of a walk, 0.55 s: F1 is 0.995 within 0.5 s, 0.56 within 0.15 s and 0.36 within 0.1 s.
STEP_TOLERANCE_S = 0.12
#: Random detectors that give the level of chance. Chosen by judgement: its error is then a
#: fourteenth of what one scatters by.
CHANCE_DRAWS = 200
CHANCE_SEED = 20_170_319


def match(
    truth: NDArray[np.float64], detected: NDArray[np.float64], tolerance_s: float
) -> NDArray[np.intp]:
    """Match two sorted lists of times one to one, each pair at most ``tolerance_s`` apart.

    Two pointers walk through both lists; with one common tolerance this finds as many pairs as the
    best assignment does, in linear time.

    Returns
    -------
    Index pairs (truth, detected), shape (n, 2).
    """
    pairs: tuple[list[int], list[int]] = ([], [])
    steps, answers = truth.tolist(), detected.tolist()  # Python's floats are the faster ones here
    n, m = len(steps), len(answers)
    i = j = 0
    while i < n and j < m:
        late = answers[j] - steps[i]
        if -tolerance_s <= late <= tolerance_s:
            pairs[0].append(i)
            pairs[1].append(j)
            i += 1
            j += 1
        elif late < 0:
            j += 1
        else:
            i += 1
    return np.array(pairs, np.intp).T


def f1_score(truth: int, detected: int, matched: int) -> float:
    """Return the harmonic mean of precision and recall; 0 where nothing is there."""
    return 2 * matched / (truth + detected) if truth + detected else 0.0


def f1_of(truth: NDArray[np.float64], detected: NDArray[np.float64], tolerance_s: float) -> float:
    """Return the F1 of detections at one tolerance."""
    return f1_score(len(truth), len(detected), len(match(truth, detected, tolerance_s)))


def random_f1(
    truth: NDArray[np.float64],
    spans: NDArray[np.float64],
    count: int,
    tolerance_s: float,
) -> float:
    """Return the mean F1 of ``count`` detections thrown at random into the spans.

    Parameters
    ----------
    truth
        Sorted times [s].
    spans
        Disjoint scored spans [s], shape (n, 2).
    count
        How many detections.
    tolerance_s
        Of the match [s].
    """
    rng = np.random.default_rng(CHANCE_SEED)
    lengths = spans[:, 1] - spans[:, 0]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    scores = []
    for _ in range(CHANCE_DRAWS):
        along = np.sort(rng.uniform(0, edges[-1], count))
        span = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(spans) - 1)
        scores.append(f1_of(truth, spans[span, 0] + along - edges[span], tolerance_s))
    return float(np.mean(scores))


def metronome_f1(
    truth: NDArray[np.float64],
    spans: NDArray[np.float64],
    count: int,
    tolerance_s: float,
) -> float:
    """Return the mean F1 over phases of a metronome that ticks ``count`` times in the spans."""
    if count == 0:
        return 0.0
    period = float((spans[:, 1] - spans[:, 0]).sum()) / count
    scores = []
    for phase in (np.arange(20) + 0.5) / 20:
        ticks = [np.arange(a + phase * period, b, period) for a, b in spans]
        scores.append(f1_of(truth, np.concatenate(ticks), tolerance_s))
    return float(np.mean(scores))


#: Half a nanosecond [s]. Source: definition.
HALF_NS_S = 0.5 / NS_PER_S


def seconds(label_ns: int, start_ns: int) -> float:
    """Return a time as seconds since the recording's first sample."""
    return (label_ns - start_ns) / NS_PER_S


def _merged(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    out: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if out and start <= out[-1][1]:
            out[-1] = (out[-1][0], max(end, out[-1][1]))
        else:
            out.append((start, end))
    return out


def _cut(
    spans: list[tuple[float, float]], holes: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    for low, high in holes:
        pieces = [((a, min(b, low)), (max(a, high), b)) for a, b in spans]
        spans = [(a, b) for pair in pieces for a, b in pair if b > a]
    return spans


def scored_spans(
    labels: Sequence[Label], start_ns: int, end_ns: int, tolerance_s: float
) -> NDArray[np.float64]:
    """Return the disjoint spans [s] in which steps are scored, shape (n, 2).

    These are the ``walking`` spans widened by the tolerance (the whole recording where there are
    none), without the ``ignore`` spans.
    """
    walking = [
        (seconds(x.time_ns, start_ns) - tolerance_s, seconds(x.end_ns, start_ns) + tolerance_s)
        for x in labels
        if x.kind == "walking" and x.end_ns is not None
    ]
    ignored = [
        (seconds(x.time_ns, start_ns), seconds(x.end_ns, start_ns))
        for x in labels
        if x.kind == "ignore" and x.end_ns is not None
    ]
    recording_span = [(-tolerance_s, seconds(end_ns, start_ns) + tolerance_s)]
    spans = _cut(_merged(walking) or recording_span, ignored)
    return np.array(sorted(spans), np.float64).reshape(-1, 2)


def inside(times: NDArray[np.float64], spans: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of the sorted times lie in one of the sorted, disjoint spans."""
    before = np.searchsorted(spans[:, 0], times, side="right") - 1
    within = before >= 0
    within[within] = times[within] <= spans[before[within], 1]
    return within


@dataclass(frozen=True, slots=True, eq=False)
class StepMatch:
    """Which detected steps answer which true ones, inside the scored spans.

    Attributes
    ----------
    truth_ns
        True steps that are scored, sorted, shape (n,).
    found_ns
        Detections that are scored, sorted, shape (m,).
    pairs
        Index pairs (truth, found), shape (k, 2).
    spans
        Scored spans [s since the first sample], shape (s, 2).
    outside_ns
        Detections that are not scored and answer no true step that is not scored either, sorted,
        shape (k,).
    tolerance_s
        Of the match [s].
    """

    truth_ns: NDArray[np.int64]
    found_ns: NDArray[np.int64]
    pairs: NDArray[np.intp]
    spans: NDArray[np.float64]
    outside_ns: NDArray[np.int64]
    tolerance_s: float

    @property
    def missed(self) -> NDArray[np.intp]:
        """Indices of the true steps that no detection answers."""
        return np.setdiff1d(np.arange(len(self.truth_ns)), self.pairs[:, 0])

    @property
    def false(self) -> NDArray[np.intp]:
        """Indices of the detections that answer no true step."""
        return np.setdiff1d(np.arange(len(self.found_ns)), self.pairs[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class TrueSteps:
    """The truth of a recording, made ready once to be matched with many sets of detections.

    Attributes
    ----------
    truth_ns
        True steps that are scored, sorted, shape (n,).
    truth_s
        The same [s since the first sample].
    spans
        Scored spans [s since the first sample], shape (s, 2).
    start_ns
        First sample of the recording [ns].
    tolerance_s
        Of the match [s].
    unscored_s
        True steps that are not scored, sorted [s since the first sample].
    """

    truth_ns: NDArray[np.int64]
    truth_s: NDArray[np.float64]
    spans: NDArray[np.float64]
    start_ns: int
    tolerance_s: float
    unscored_s: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        labels: Sequence[Label],
        start_ns: int,
        end_ns: int,
        tolerance_s: float = STEP_TOLERANCE_S,
    ) -> TrueSteps:
        """Return the ``step`` labels inside the scored spans; as :func:`~.steps.score_steps`."""
        truth_ns = np.array(sorted(x.time_ns for x in labels if x.kind == "step"), np.int64)
        spans = scored_spans(labels, start_ns, end_ns, tolerance_s)
        truth_s = (truth_ns - start_ns) / NS_PER_S
        scored = inside(truth_s, spans)
        scored_steps = (truth_ns[scored], truth_s[scored])
        return cls(*scored_steps, spans, start_ns, tolerance_s, truth_s[~scored])

    def match(self, detected_ns: NDArray[np.int64]) -> StepMatch:
        """Match detected steps to the true ones inside the scored spans."""
        found_ns = np.sort(detected_ns)
        found_s = (found_ns - self.start_ns) / NS_PER_S
        counted = self._counted(found_s)
        pairs = match(self.truth_s, found_s[counted], self._within_s)
        outside = np.flatnonzero(~counted)
        others = match(self.unscored_s, found_s[outside], self._within_s)[:, 1]
        outside_ns = found_ns[np.delete(outside, others)]
        return StepMatch(
            self.truth_ns, found_ns[counted], pairs, self.spans, outside_ns, self.tolerance_s
        )

    @property
    def _within_s(self) -> float:
        """The tolerance [s], so that seconds which are rounded compare as nanoseconds do."""
        return self.tolerance_s + HALF_NS_S

    def _counted(self, detected: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which detections are scored.

        Those inside the spans, and of those outside the ones that answer a true step inside which
        no other detection answers.
        """
        truth, tolerance_s = self.truth_s, self._within_s
        counted = inside(detected, self.spans)
        if counted.all():
            return counted
        matched = len(match(truth, detected[counted], tolerance_s))
        for index in np.flatnonzero(~counted & _near(truth, detected, tolerance_s)):
            counted[index] = True
            if len(match(truth, detected[counted], tolerance_s)) == matched:
                counted[index] = False
            else:
                matched += 1
        return counted


class StepTimes(NamedTuple):
    """Times of steps [s since the first sample], by what became of them."""

    detected: tuple[float, ...] = ()
    missed: tuple[float, ...] = ()
    false: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, matching: StepMatch | None, found_ns: NDArray[np.int64], start_ns: int
    ) -> StepTimes:
        """Return those of a match; without one, all that were detected."""

        def seconds(times_ns: NDArray[np.int64]) -> tuple[float, ...]:
            return tuple(((times_ns - start_ns) / NS_PER_S).tolist())

        if matching is None:
            return cls(seconds(found_ns))
        right, missed = matching.found_ns[matching.pairs[:, 1]], matching.truth_ns[matching.missed]
        return cls(seconds(right), seconds(missed), seconds(matching.found_ns[matching.false]))


def match_steps(
    labels: Sequence[Label],
    detected_ns: NDArray[np.int64],
    start_ns: int,
    end_ns: int,
    tolerance_s: float = STEP_TOLERANCE_S,
) -> StepMatch:
    """Match detected steps to ``step`` labels inside the scored spans.

    The parameters are those of :func:`~.steps.score_steps`.
    """
    return TrueSteps.of(labels, start_ns, end_ns, tolerance_s).match(detected_ns)


def _near(
    truth: NDArray[np.float64], detected: NDArray[np.float64], tolerance_s: float
) -> NDArray[np.bool_]:
    """Return which detections have a true step within the tolerance."""
    if not len(truth):
        return np.zeros(len(detected), np.bool_)
    return np.abs(truth[nearest(truth, detected)] - detected) <= tolerance_s


def nearest(sorted_times: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index of the sorted time (there is at least one) nearest to each time."""
    after = np.minimum(np.searchsorted(sorted_times, times), len(sorted_times) - 1)
    before = np.maximum(after - 1, 0)
    earlier = times - sorted_times[before] <= sorted_times[after] - times
    return np.where(earlier, before, after)


#: A detection belongs to a true step up to this part of the step time around it: beyond, it is
#: nearer to another step. By definition, not by measurement. Source: definition.
REACH_STEPS = 0.5
#: And at most this far from it [s]: where people pause, there is no step time. Chosen by judgement:
#: half of a slow step.
REACH_S = 0.5
#: The step time around a step is the median of this many times between steps before and after it.
#: Chosen by judgement: one long or short step does not move it.
GAPS = 2
#: Source: SI.
NS_PER_MS = 1_000_000
#: Most decimals of a time in milliseconds: nanoseconds. Source: definition.
DECIMALS = 6


def step_reach_s(
    steps_s: NDArray[np.float64], at_s: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Return how far from each moment a detection still belongs to it.

    Half of the step time around the moment, at most :data:`REACH_S`. The step time around it is
    the median of the times between successive true steps, of the two before and the two after the
    true step nearest to it, as far as there are any: of a steady walk its step time, of a limp the
    mean of its long and its short step, and at the end of a walk not the pause that follows. With
    one true step, or none, the reach is :data:`REACH_S`.

    Parameters
    ----------
    steps_s
        True steps, sorted, shape (n,) [s].
    at_s
        Moments, shape (m,) [s]; the steps themselves where not given.

    Returns
    -------
    Shape (m,) [s].
    """
    at_s = steps_s if at_s is None else at_s
    if len(steps_s) < 2:
        return np.full(len(at_s), REACH_S)
    intervals_s = np.pad(np.diff(steps_s), GAPS, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(intervals_s, 2 * GAPS)
    step_s = medians(around)[nearest(steps_s, at_s)]
    return np.minimum(REACH_STEPS * step_s, REACH_S)


@dataclass(frozen=True, slots=True)
class TimingPair:
    """A missed true step and the unmatched detection that is it, at the wrong time.

    Attributes
    ----------
    step
        Number of the true step among the scored ones, from 1.
    truth_ns, found_ns
        Times of the true step and of the detection [ns].
    """

    step: int
    truth_ns: int
    found_ns: int

    @property
    def late_ns(self) -> int:
        """By how much it was found late (> 0) or early [ns]."""
        return self.found_ns - self.truth_ns


@dataclass(frozen=True, slots=True)
class TimeShift:
    """One shift of all detections, and what it would mend.

    Attributes
    ----------
    late_ms
        By how much detections come late (> 0) or early; taken out of their times [ms].
    right
        Steps that would be right then.
    mends
        Of the missed steps that were found at the wrong time, those that would be.
    pairs
        How many of those there are.
    """

    late_ms: float
    right: int
    mends: int
    pairs: int


def timing_pairs(matching: StepMatch) -> tuple[TimingPair, ...]:
    """Pair missed true steps with detections that answer none, one to one, in the order of time.

    A pair is at most the :func:`step_reach_s` of its true step apart, and necessarily further than
    the tolerance of the match, which would have matched it. As many are paired as can be, and of
    those pairings the one with the least sum of distances. Detections outside the scored spans,
    which count neither as right nor as false, are paired too.

    Parameters
    ----------
    matching
        Which detections answer which true steps.
    """
    missed_ns = matching.truth_ns[matching.missed]
    alone_ns = np.sort(np.concatenate([matching.found_ns[matching.false], matching.outside_ns]))
    if not len(missed_ns) or not len(alone_ns):
        return ()
    start_ns = matching.truth_ns[0]
    truth_s, missed_s, alone_s = (
        (t - start_ns) / NS_PER_S for t in (matching.truth_ns, missed_ns, alone_ns)
    )
    reach_s = step_reach_s(truth_s)[matching.missed]
    return tuple(
        TimingPair(int(matching.missed[i]) + 1, int(missed_ns[i]), int(alone_ns[j]))
        for i, j in sorted(_assigned(missed_s, alone_s, reach_s))
    )


def _assigned(
    missed_s: NDArray[np.float64], alone_s: NDArray[np.float64], reach_s: NDArray[np.float64]
) -> list[tuple[int, int]]:
    """Return index pairs (missed, alone), cluster by cluster of those that reach each other."""
    first = np.searchsorted(alone_s, missed_s - reach_s, side="left")
    after = np.searchsorted(alone_s, missed_s + reach_s, side="right")
    pairs: list[tuple[int, int]] = []
    for here in _overlapping(first, after):
        there = np.arange(first[here].min(), after[here].max())
        apart = np.abs(missed_s[here, None] - alone_s[there])
        apart[apart > reach_s[here, None]] = np.inf
        pairs += [(int(here[i]), int(there[j])) for i, j in assign(apart, REACH_S)]
    return pairs


def _overlapping(first: NDArray[np.intp], after: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the indices of ranges that overlap, one through the other; empty ranges are none."""
    some = np.flatnonzero(after > first)
    order = some[np.argsort(first[some], kind="stable")]
    reached = np.maximum.accumulate(after[order])
    begins = 1 + np.flatnonzero(first[order][1:] >= reached[:-1])
    return np.split(order, begins) if len(order) else []


def best_shift(matching: StepMatch, pairs: Sequence[TimingPair]) -> TimeShift | None:
    """Return the shift of all detections that makes most steps right.

    Parameters
    ----------
    matching
        Which detections answer which true steps.
    pairs
        Its :func:`timing_pairs`.

    Returns
    -------
    None where no shift mends more than half of the pairs, or where it would make fewer steps
    right than there are.
    """
    if not pairs:
        return None
    start_ns = matching.truth_ns[0]
    detected_ns = np.sort(np.concatenate([matching.found_ns, matching.outside_ns]))
    truth_s, found_s = ((t - start_ns) / NS_PER_S for t in (matching.truth_ns, detected_ns))
    late_s = _most_within(found_s[nearest(found_s, truth_s)] - truth_s, matching.tolerance_s)
    late_s = round(late_s, 3)  # as it is told
    right = match(truth_s, found_s - late_s, matching.tolerance_s)[:, 0]
    mends = int(np.isin([pair.step - 1 for pair in pairs], right).sum())
    if 2 * mends <= len(pairs) or len(right) <= len(matching.pairs):
        return None
    return TimeShift(late_s * 1e3, len(right), mends, len(pairs))


def _most_within(late_s: NDArray[np.float64], tolerance_s: float) -> float:
    """Return the shift [s] that brings most of these times within a tolerance of 0.

    Of a window of twice the tolerance that holds most of them, the middle of those it holds; of
    several such windows, the one that shifts least.
    """
    late_s = np.sort(late_s[np.abs(late_s) <= REACH_S])
    if not len(late_s):
        return 0.0
    last = np.searchsorted(late_s, late_s + 2 * tolerance_s, side="right") - 1
    counts = last - np.arange(len(late_s))
    middle = (late_s + late_s[last]) / 2
    most = np.flatnonzero(counts == counts.max())
    return float(middle[most[np.argmin(np.abs(middle[most]))]])


def off_text(late_ns: int, tolerance_s: float) -> tuple[str, str]:
    """Return how late or early something is, and a tolerance it exceeds: ``126 ms late``, ``120``.

    With as many decimals as tell the two apart, so that what is printed says what is so.
    """
    off_ms, tolerance_ms = abs(late_ns) / NS_PER_MS, tolerance_s * 1e3
    decimals = 0
    while decimals < DECIMALS and not round(off_ms, decimals) > round(tolerance_ms, 3):
        decimals += 1
    return f"{off_ms:.{decimals}f} ms {'late' if late_ns > 0 else 'early'}", f"{tolerance_ms:.6g}"


def later_text(late_ns: int) -> str:
    """Return how late or early something within the tolerance is: ``20 ms late``."""
    off_ms = abs(late_ns) / NS_PER_MS
    return f"{off_ms:.0f} ms {'late' if late_ns > 0 else 'early'}"


def found_text(pair: TimingPair, tolerance_s: float) -> str:
    """Say how the true step of a pair was found: ``found 126 ms late, tolerance 120 ms``."""
    off, tolerance = off_text(pair.late_ns, tolerance_s)
    return f"found {off}, tolerance {tolerance} ms"


def answers_text(pair: TimingPair, tolerance_s: float) -> str:
    """Say what the detection of a pair is: ``answers step 12, 126 ms late``."""
    return f"answers step {pair.step}, {off_text(pair.late_ns, tolerance_s)[0]}"
