"""Steps found at the wrong time: a missed true step and the unmatched detection near it are one.

The one place that says what belongs together; the score's page, ``why``, ``compare``, the timeline
and fleets ask here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .assignment import assign
from .matching import match
from .step_matching import nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .step_matching import StepMatch

#: A detection belongs to a true step up to this part of the step time around it: beyond, it is
#: nearer to another step. By definition, not by measurement.
REACH_STEPS = 0.5
#: And at most this far from it [s]: where people pause, there is no step time.
REACH_S = 0.5
#: The step time around a step is the median of this many times between steps before and after it.
GAPS = 2
NS_PER_MS = 1_000_000
#: Most decimals of a time in milliseconds: nanoseconds.
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
    known = np.pad(np.diff(steps_s), GAPS, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(known, 2 * GAPS)
    step_s = np.nanmedian(around, axis=1)[nearest(steps_s, at_s)]
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
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first = np.searchsorted(alone_s, missed_s - reach_s, side="left")
    after = np.searchsorted(alone_s, missed_s + reach_s, side="right")
    rows = np.repeat(np.arange(len(missed_s)), after - first)
    columns = [np.arange(a, b) for a, b in zip(first, after, strict=True)]
    places = np.concatenate([np.empty(0, np.intp), *columns])
    nodes = len(missed_s) + len(alone_s)
    links = coo_array((np.ones(len(rows)), (rows, len(missed_s) + places)), (nodes, nodes))
    cluster = connected_components(links, directed=False)[1]
    found: list[tuple[int, int]] = []
    for name in np.unique(cluster[rows]):
        here = np.flatnonzero(cluster[: len(missed_s)] == name)
        there = np.flatnonzero(cluster[len(missed_s) :] == name)
        apart = np.abs(missed_s[here, None] - alone_s[there])
        apart[apart > reach_s[here, None]] = np.inf
        found += [(int(here[i]), int(there[j])) for i, j in assign(apart, REACH_S)]
    return found


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
    held = last - np.arange(len(late_s))
    middle = (late_s + late_s[last]) / 2
    most = np.flatnonzero(held == held.max())
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
