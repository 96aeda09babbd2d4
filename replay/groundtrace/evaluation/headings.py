"""Scoring of headings against true directions, and of disturbances of the magnetic field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .matching import STEP_TOLERANCE_S, f1_score
from .positions import ignored

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Disturbance, Heading, Label

#: Between two headings no further apart the shorter way round is taken [s]. Chosen by judgement: in
#: a second nobody turns by more than half a turn.
HOLD_S = 1.0


@dataclass(frozen=True, slots=True)
class HeadingScore:
    """How well directions were found, heading minus truth, the shorter way round.

    Attributes
    ----------
    stage
        The stage scored: the last one that gives headings.
    truth, n
        True headings, and those of them at which the stage has one.
    rmse_deg, bias_deg, p95_deg
        Root mean square, circular mean, and 95th percentile of the absolute error [deg]; None
        where ``n`` is 0.
    """

    stage: str
    truth: int
    n: int
    rmse_deg: float | None
    bias_deg: float | None
    p95_deg: float | None


def wrap_angles(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles within [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi, np.float64)


def score_headings(
    labels: Sequence[Label], headings: Sequence[Heading], tolerance_s: float = STEP_TOLERANCE_S
) -> HeadingScore | None:
    """Score the headings of one stage against ``heading`` labels.

    Parameters
    ----------
    labels
        The truth; their values are headings [rad].
    headings
        Of one stage.
    tolerance_s
        How far the nearest heading may lie where none lie close on both sides [s].

    Returns
    -------
    The score, or None where there are no true headings or none were found.
    """
    times, errors = heading_errors(labels, headings, tolerance_s)
    if not len(times) or not headings:
        return None
    valid_errors = errors[~np.isnan(errors)]
    if not len(valid_errors):
        return HeadingScore(headings[-1].stage, len(times), 0, None, None, None)
    bias = float(np.angle(np.exp(1j * valid_errors).mean()))
    return HeadingScore(
        stage=headings[-1].stage,
        truth=len(times),
        n=len(valid_errors),
        rmse_deg=float(np.degrees(np.sqrt(np.mean(valid_errors**2)))),
        bias_deg=float(np.degrees(bias)),
        p95_deg=float(np.degrees(np.percentile(np.abs(valid_errors), 95))),
    )


def heading_errors(
    labels: Sequence[Label], headings: Sequence[Heading], tolerance_s: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the times of the true headings outside ``ignore`` spans, and the errors there [rad].

    An error is NaN where there is no heading.
    """
    rows = sorted(
        (x.time_ns, x.value) for x in labels if x.kind == "heading" and x.value is not None
    )
    times = np.array([time for time, _ in rows], np.int64)
    true = np.array([value for _, value in rows], np.float64)
    scored = ~ignored(labels, times)
    times, true = times[scored], true[scored]
    if not headings:
        return times, np.full(len(times), np.nan)
    ordered = sorted(headings, key=lambda heading: heading.time_ns)
    headings_ns = np.array([heading.time_ns for heading in ordered], np.int64)
    headings_rad = np.array([heading.heading_rad for heading in ordered], np.float64)
    return times, wrap_angles(_at(headings_ns, headings_rad, times, tolerance_s) - true)


def _at(
    headings_ns: NDArray[np.int64],
    headings_rad: NDArray[np.float64],
    times: NDArray[np.int64],
    tolerance_s: float,
) -> NDArray[np.float64]:
    """Return headings at times [rad]: between two close ones, else the nearest, else NaN."""
    after = np.clip(np.searchsorted(headings_ns, times), 0, len(headings_rad) - 1)
    before = np.maximum(after - 1, 0)
    gap = headings_ns[after] - headings_ns[before]
    between = (headings_ns[before] <= times) & (times <= headings_ns[after])
    between &= (gap > 0) & (gap <= HOLD_S * NS_PER_S)
    part = (times - headings_ns[before]) / np.maximum(gap, 1)
    interpolated = headings_rad[before] + part * wrap_angles(
        headings_rad[after] - headings_rad[before]
    )
    earlier = np.abs(times - headings_ns[before]) <= np.abs(headings_ns[after] - times)
    nearest = np.where(earlier, before, after)
    near = np.abs(headings_ns[nearest] - times) <= tolerance_s * NS_PER_S
    return np.where(between, interpolated, np.where(near, headings_rad[nearest], np.nan))


#: Time between two of the moments at which disturbances are compared [ns]. Chosen by judgement:
#: 0.01 s, the rate of usual sensors.
FRAME_NS = 10_000_000


@dataclass(frozen=True, slots=True)
class DisturbanceScore:
    """How well disturbed spans were found, by overlap in time.

    Attributes
    ----------
    stage
        The stage scored: the last one that finds disturbances.
    precision, recall, f1
        Of frames of 10 ms; precision is None where nothing was found, recall and F1 where truth has
        no disturbed span.
    truth_s, found_s, both_s
        Disturbed by truth, by the stage, and by both [s].
    false_alarm_s, scored_s
        Disturbed by the stage alone, and all that is scored [s].
    """

    stage: str
    precision: float | None
    recall: float | None
    f1: float | None
    truth_s: float
    found_s: float
    both_s: float
    false_alarm_s: float
    scored_s: float


def score_disturbances(
    labels: Sequence[Label],
    disturbances: Sequence[Disturbance],
    start_ns: int,
    end_ns: int,
    *,
    told_by: str = "",
) -> DisturbanceScore | None:
    """Score the disturbances of one stage against ``disturbed`` labels.

    Parameters
    ----------
    labels
        The truth; nothing is scored inside ``ignore`` spans.
    disturbances
        Of one stage.
    start_ns, end_ns
        First and last sample of the recording [ns].
    told_by
        The stage that would have found some; empty where there is none.

    Returns
    -------
    The score, or None where there is no truth of any kind, or no stage. Where truth has no
    disturbed span, all that was found is a false alarm.
    """
    true = _spans(labels, "disturbed")
    if not labels or not (disturbances or told_by):
        return None
    count = (end_ns - start_ns) // FRAME_NS + 1
    scored = ~_frames(_spans(labels, "ignore"), start_ns, count)
    truth = _frames(true, start_ns, count) & scored
    detected = _frames(((x.time_ns, x.end_ns) for x in disturbances), start_ns, count) & scored
    both, n_truth, n_detected = (int(x.sum()) for x in (truth & detected, truth, detected))
    frame_s = FRAME_NS / 1e9
    return DisturbanceScore(
        stage=disturbances[-1].stage if disturbances else told_by,
        precision=both / n_detected if n_detected else None,
        recall=both / n_truth if n_truth else None,
        f1=f1_score(n_truth, n_detected, both) if n_truth else None,
        truth_s=n_truth * frame_s,
        found_s=n_detected * frame_s,
        both_s=both * frame_s,
        false_alarm_s=(n_detected - both) * frame_s,
        scored_s=int(scored.sum()) * frame_s,
    )


def _spans(labels: Sequence[Label], kind: str) -> list[tuple[int, int]]:
    return [(x.time_ns, x.end_ns) for x in labels if x.kind == kind and x.end_ns is not None]


def _frames(spans: Iterable[tuple[int, int]], start_ns: int, count: int) -> NDArray[np.bool_]:
    """Return which frames have their middle in one of the half-open spans."""
    out = np.zeros(count, np.bool_)
    half = FRAME_NS // 2
    for begin, end in spans:
        first, last = (max(0, -((start_ns + half - t) // FRAME_NS)) for t in (begin, end))
        out[first:last] = True
    return out
