"""Scoring of steps and their types, within walking spans and outside ``ignore`` spans."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .matching import (
    STEP_TOLERANCE_S,
    f1_of,
    f1_score,
    match_steps,
    metronome_f1,
    nearest,
    random_f1,
    seconds,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, StepEvent

    from .matching import StepMatch

#: Tolerances at which F1 is told [s]. Chosen by judgement: from a picker's error to that of
#: mobgap's scorer, 0.5 s, about evenly by ratio.
CURVE_S = (0.02, 0.03, 0.05, 0.075, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
#: How far a detection may lie from its step for the latency that the de-biased F1 takes out [s].
#: Chosen by judgement: a step time; that of mobgap's scorer.
LATENCY_REACH_S = 0.5


@dataclass(frozen=True, slots=True)
class MedianIqr:
    """Median and interquartile range [ms]."""

    median: float
    iqr: float


@dataclass(frozen=True, slots=True)
class StepScore:
    """How well steps were found.

    Attributes
    ----------
    truth, detected, matched
        Counts inside the scored spans.
    precision, recall, f1
        At ``tolerance_s``.
    chance_f1
        Mean F1 of as many detections thrown at random into the scored spans.
    chance_f1_metronome
        Mean F1 of a blind metronome of the same rate.
    f1_debiased
        F1 after the median latency is taken out.
    count_truth
        Steps that a counter should give: the counts where truth has them, else the steps.
    count_error
        Sum over the spans of the absolute difference between counted and true steps.
    count_error_signed
        Counted minus true steps in all.
    latency_ms
        Of the matched detections, or None where nothing matched.
    tolerance_s
        Of the match [s].
    curve
        Pairs (tolerance [s], F1).
    feet, kinds
        What truth and detections say of the matched steps: left or right, and the kind of step;
        None where one side says nothing.
    """

    truth: int
    detected: int
    matched: int
    precision: float
    recall: float
    f1: float
    chance_f1: float
    chance_f1_metronome: float
    f1_debiased: float
    count_truth: int
    count_error: int
    count_error_signed: int
    latency_ms: MedianIqr | None
    tolerance_s: float
    curve: list[tuple[float, float]]
    feet: Confusion | None = None
    kinds: Confusion | None = None


def score_steps(
    labels: Sequence[Label],
    detected_ns: NDArray[np.int64],
    start_ns: int,
    end_ns: int,
    tolerance_s: float = STEP_TOLERANCE_S,
) -> StepScore | None:
    """Score detected steps against ``step`` and ``count`` labels.

    Parameters
    ----------
    labels
        The truth.
    detected_ns
        Times of the detected steps [ns], any order.
    start_ns, end_ns
        First and last sample of the recording [ns].
    tolerance_s
        Largest distance of a match [s].

    Returns
    -------
    The score, or None where the truth has neither steps nor counts.
    """
    counts = [x for x in labels if x.kind == "count" and x.end_ns is not None]
    if not counts and not any(x.kind == "step" for x in labels):
        return None
    matching = match_steps(labels, detected_ns, start_ns, end_ns, tolerance_s)
    spans, pairs = matching.spans, matching.pairs
    truth, scored = ((t - start_ns) / NS_PER_S for t in (matching.truth_ns, matching.found_ns))
    detected = np.sort((detected_ns - start_ns) / NS_PER_S)
    late = scored[pairs[:, 1]] - truth[pairs[:, 0]]
    matched = len(pairs)
    error, signed, count_truth = _count_error(truth, detected, scored, spans, counts, start_ns)
    return StepScore(
        truth=len(truth),
        detected=len(scored),
        matched=matched,
        precision=matched / len(scored) if len(scored) else 0.0,
        recall=matched / len(truth) if len(truth) else 0.0,
        f1=f1_score(len(truth), len(scored), matched),
        chance_f1=random_f1(truth, spans, len(scored), tolerance_s),
        chance_f1_metronome=metronome_f1(truth, spans, len(scored), tolerance_s),
        f1_debiased=_debiased_f1(truth, scored, tolerance_s),
        count_truth=count_truth,
        count_error=error,
        count_error_signed=signed,
        latency_ms=spread_ms(late),
        tolerance_s=tolerance_s,
        curve=[(t, f1_of(truth, scored, t)) for t in CURVE_S],
    )


def spread_ms(values_s: NDArray[np.float64]) -> MedianIqr | None:
    """Return median and interquartile range [ms], or None of nothing."""
    if not len(values_s):
        return None
    low, middle, high = np.percentile(values_s, [25, 50, 75]) * 1e3
    return MedianIqr(float(middle), float(high - low))


def _debiased_f1(
    truth: NDArray[np.float64], detected: NDArray[np.float64], tolerance_s: float
) -> float:
    return f1_of(truth, detected - usual_latency_s(truth, detected), tolerance_s)


def usual_latency_s(truth: NDArray[np.float64], detected: NDArray[np.float64]) -> float:
    """Return the median of what the nearest detection comes after each true step [s].

    Both are sorted; detections further than 0.5 s away do not count; 0 where none is left.
    """
    if not len(truth) or not len(detected):
        return 0.0
    late = detected[nearest(detected, truth)] - truth
    late = late[np.abs(late) <= LATENCY_REACH_S]
    return float(np.median(late)) if len(late) else 0.0


def _count_error(
    truth: NDArray[np.float64],
    detected: NDArray[np.float64],
    scored: NDArray[np.float64],
    spans: NDArray[np.float64],
    counts: Sequence[Label],
    start_ns: int,
) -> tuple[int, int, int]:
    """Return absolute error summed over the spans, signed error, and the true count."""
    if counts:
        errors = []
        for label in counts:
            a, b = seconds(label.time_ns, start_ns), seconds(label.end_ns or 0, start_ns)
            errors.append(int(((detected >= a) & (detected < b)).sum()) - round(label.value or 0))
        total = sum(round(label.value or 0) for label in counts)
        return sum(map(abs, errors)), sum(errors), total
    errors = [
        int(((scored >= a) & (scored <= b)).sum() - ((truth >= a) & (truth <= b)).sum())
        for a, b in spans
    ]
    return sum(map(abs, errors)), sum(errors), len(truth)


FEET = ("left", "right")
#: Types of steps that are no foot's name: truth that uses one of them names types, not feet.
ALONG = frozenset({"forward", "backward"})
#: Kinds of a detected step that say nothing of how it was made.
PLAIN = frozenset({"", "step", "impact"})


@dataclass(frozen=True, slots=True)
class Confusion:
    """What truth and detections say of the same steps.

    Attributes
    ----------
    words
        Names of the rows and columns.
    counts
        Matched steps; rows are what truth says, columns what the detection says.
    compared
        Matched steps of which both say something.
    agreed, accuracy
        Those of which both say the same, and their part.
    """

    words: list[str]
    counts: list[list[int]]
    compared: int
    agreed: int
    accuracy: float


def confusion(pairs: Sequence[tuple[str, str]], words: Sequence[str] = ()) -> Confusion | None:
    """Count pairs (truth, detection) of words.

    Parameters
    ----------
    pairs
        Pairs with an empty word are left out.
    words
        Names of rows and columns; those that occur, sorted, where empty.

    Returns
    -------
    The matrix, or None where there is nothing to compare.
    """
    complete_pairs = [(a, b) for a, b in pairs if a and b]
    if not complete_pairs:
        return None
    names = list(words) or sorted({word for pair in complete_pairs for word in pair})
    counts = np.zeros((len(names), len(names)), np.int64)
    for a, b in complete_pairs:
        counts[names.index(a), names.index(b)] += 1
    agreed = int(np.trace(counts))
    return Confusion(
        names, counts.tolist(), len(complete_pairs), agreed, agreed / len(complete_pairs)
    )


def truth_words(label: str, *, typed: bool = False) -> tuple[str, str]:
    """Return foot and kind of step that a label's text names, each perhaps empty.

    Parameters
    ----------
    label
        The text.
    typed
        Whether the truth names types of steps: left and right are types too then, and a foot only
        where they come before another type.
    """
    words = [word for word in re.split(r"[\s,;/]+", label.strip().lower()) if word]
    sides = [word for word in words if word in FEET]
    others = [word for word in words if word not in FEET]
    if typed and sides and not others:
        others, sides = sides[-1:], sides[:-1]
    return (sides[0] if sides else ""), " ".join(others)


def compare_words(
    labels: Sequence[Label], steps: Sequence[StepEvent], matching: StepMatch
) -> tuple[Confusion | None, Confusion | None]:
    """Compare what truth and detections say of the matched steps.

    Parameters
    ----------
    labels
        The truth.
    steps, matching
        The detections, any order, and how they were matched.

    Returns
    -------
    Confusion of feet and of kinds, each None where one side says nothing. The kind of a detected
    step is its type where it has one.
    """
    true = sorted((x for x in labels if x.kind == "step"), key=lambda x: x.time_ns)
    detected = sorted(steps, key=lambda x: x.time_ns)
    rows = np.searchsorted([x.time_ns for x in true], matching.truth_ns[matching.pairs[:, 0]])
    columns = np.searchsorted(
        [x.time_ns for x in detected], matching.found_ns[matching.pairs[:, 1]]
    )
    typed = any(ALONG & set(truth_words(x.label)[1].split()) for x in true)
    feet, kinds = [], []
    for i, j in zip(rows, columns, strict=True):
        foot, kind = truth_words(true[i].label, typed=typed)
        feet.append((foot, detected[j].foot if detected[j].foot in FEET else ""))
        kinds.append(
            (kind, detected[j].type or ("" if detected[j].kind in PLAIN else detected[j].kind))
        )
    return confusion(feet, FEET), confusion(kinds)
