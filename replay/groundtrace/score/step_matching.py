"""Which detected steps answer which true ones, inside the spans that are scored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .matching import match

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label


#: Half a nanosecond [s].
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
    whole = [(-tolerance_s, seconds(end_ns, start_ns) + tolerance_s)]
    spans = _cut(_merged(walking) or whole, ignored)
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
        cls, labels: Sequence[Label], start_ns: int, end_ns: int, tolerance_s: float = 0.12
    ) -> TrueSteps:
        """Return the ``step`` labels inside the scored spans; as :func:`score_steps`."""
        truth_ns = np.array(sorted(x.time_ns for x in labels if x.kind == "step"), np.int64)
        spans = scored_spans(labels, start_ns, end_ns, tolerance_s)
        truth_s = (truth_ns - start_ns) / NS_PER_S
        scored = inside(truth_s, spans)
        own = (truth_ns[scored], truth_s[scored])
        return cls(*own, spans, start_ns, tolerance_s, truth_s[~scored])

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

    def _counted(self, found: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which detections are scored.

        Those inside the spans, and of those outside the ones that answer a true step inside which
        no other detection answers.
        """
        truth, tolerance_s = self.truth_s, self._within_s
        counted = inside(found, self.spans)
        if counted.all():
            return counted
        matched = len(match(truth, found[counted], tolerance_s))
        for index in np.flatnonzero(~counted & _near(truth, found, tolerance_s)):
            counted[index] = True
            if len(match(truth, found[counted], tolerance_s)) == matched:
                counted[index] = False
            else:
                matched += 1
        return counted


def match_steps(
    labels: Sequence[Label],
    detected_ns: NDArray[np.int64],
    start_ns: int,
    end_ns: int,
    tolerance_s: float = 0.12,
) -> StepMatch:
    """Match detected steps to ``step`` labels inside the scored spans.

    The parameters are those of :func:`score_steps`.
    """
    return TrueSteps.of(labels, start_ns, end_ns, tolerance_s).match(detected_ns)


def _near(
    truth: NDArray[np.float64], found: NDArray[np.float64], tolerance_s: float
) -> NDArray[np.bool_]:
    """Return which detections have a true step within the tolerance."""
    if not len(truth):
        return np.zeros(len(found), np.bool_)
    return np.abs(truth[nearest(truth, found)] - found) <= tolerance_s


def nearest(sorted_times: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index of the sorted time (there is at least one) nearest to each time."""
    after = np.minimum(np.searchsorted(sorted_times, times), len(sorted_times) - 1)
    before = np.maximum(after - 1, 0)
    earlier = times - sorted_times[before] <= sorted_times[after] - times
    return np.where(earlier, before, after)
