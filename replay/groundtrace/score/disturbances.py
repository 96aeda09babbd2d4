"""Scoring of disturbed spans against true ones, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .matching import f1_score

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Disturbance
    from groundtrace_codecs.labels import Label

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
    found: Sequence[Disturbance],
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
    found
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
    if not labels or not (found or told_by):
        return None
    count = (end_ns - start_ns) // FRAME_NS + 1
    scored = ~_frames(_spans(labels, "ignore"), start_ns, count)
    truth = _frames(true, start_ns, count) & scored
    said = _frames(((x.time_ns, x.end_ns) for x in found), start_ns, count) & scored
    both, n_truth, n_said = (int(x.sum()) for x in (truth & said, truth, said))
    frame_s = FRAME_NS / 1e9
    return DisturbanceScore(
        stage=found[-1].stage if found else told_by,
        precision=both / n_said if n_said else None,
        recall=both / n_truth if n_truth else None,
        f1=f1_score(n_truth, n_said, both) if n_truth else None,
        truth_s=n_truth * frame_s,
        found_s=n_said * frame_s,
        both_s=both * frame_s,
        false_alarm_s=(n_said - both) * frame_s,
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
