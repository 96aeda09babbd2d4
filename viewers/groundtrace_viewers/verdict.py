"""Every step against the truth: found, missed or false, as a lane and as lines to jump to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.score import match
from groundtrace.score.steps import inside, scored_spans, seconds
from groundtrace_codecs.signals import NS_PER_S

from .lanes import Lane
from .palette import ACCEPTED, FALSE, MISSED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace.sinks import Session

    from .events import LogLines
    from .timeline import Timeline

#: Largest distance between a step and its detection, as the score has it.
TOLERANCE_S = 0.12
PATH = "/state/score"
COLOURS = {"hit": ACCEPTED, "missed": MISSED, "false": FALSE}


def verdicts(
    session: Session, steps_ns: Sequence[int], replayed_ns: tuple[int, int]
) -> list[tuple[int, str]]:
    """Return what became of every true step, and which detections answer none.

    Parameters
    ----------
    session
        Its labels are the truth.
    steps_ns
        Detected steps [ns], any order.
    replayed_ns
        First and last sample that was replayed [ns]: what lies outside was never looked at.

    Returns
    -------
    list
        Times [ns] with ``hit``, ``missed`` (times of true steps) or ``false`` (of detections), in
        the spans that the score looks at.
    """
    start = session.start_ns
    labels = [x for x in session.labels if x.kind == "step"]
    truth = np.array(sorted(seconds(x.time_ns, start) for x in labels), np.float64)
    found = np.array(sorted(seconds(t, start) for t in steps_ns), np.float64)
    spans = scored_spans(session.labels, start, session.end_ns, TOLERANCE_S)
    first, last = (seconds(t, start) for t in replayed_ns)
    truth = truth[inside(truth, spans) & (truth >= first) & (truth <= last)]
    counted = inside(found, spans)
    counted[match(truth, found, TOLERANCE_S)[:, 1]] = True
    found = found[counted]
    pairs = match(truth, found, TOLERANCE_S)
    hits = np.isin(np.arange(len(truth)), pairs[:, 0])
    answers = np.isin(np.arange(len(found)), pairs[:, 1])
    result = [
        *_named(truth[hits], "hit", start),
        *_named(truth[~hits], "missed", start),
        *_named(found[~answers], "false", start),
    ]
    return sorted(result)


def _named(times_s: NDArray[np.float64], verdict: str, start_ns: int) -> list[tuple[int, str]]:
    return [(start_ns + round(t * NS_PER_S), verdict) for t in times_s.tolist()]


def log_verdicts(timeline: Timeline, lines: LogLines, found: Sequence[tuple[int, str]]) -> None:
    """Log the lane, and a line for every step that was missed or is false."""
    lane = Lane(timeline, PATH, COLOURS)
    for time_ns, verdict in found:
        lane.add(time_ns, verdict)
        if verdict != "hit":
            text = f"{verdict} step at {timeline.seconds(time_ns)}"
            lines.add("score", time_ns, text, "ERROR" if verdict == "missed" else "WARN")
    lane.flush()
