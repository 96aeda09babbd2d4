"""Every step against the truth: found, missed or false, as a lane and as lines to jump to."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace.score import match_steps, timing_pairs
from groundtrace.score.step_timing import answers_text, found_text

from .lanes import SCORE, Lane
from .palette import ACCEPTED, FALSE, MISSED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.sinks import Session

    from .events import LogLines
    from .timeline import Timeline

#: Largest distance between a step and its detection, as the score has it.
TOLERANCE_S = 0.12
COLOURS = {"hit": ACCEPTED, "missed": MISSED, "false": FALSE}


class Verdict(NamedTuple):
    """What became of a step: when it was [ns], and in a word; of a wrong time, what it is.

    ``text`` is ``found 126 ms late, tolerance 120 ms`` of a missed step that has a false one near
    it, and ``answers step 12, 126 ms late`` of that one; else empty.
    """

    time_ns: int
    verdict: str
    text: str = ""


def verdicts(
    session: Session, steps_ns: Sequence[int], replayed_ns: tuple[int, int]
) -> list[Verdict]:
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
        ``hit``, ``missed`` (at times of true steps) or ``false`` (of detections), in the spans
        that the score looks at.
    """
    first, last = replayed_ns
    labels = [x for x in session.labels if x.kind != "step" or first <= x.time_ns <= last]
    detected = np.array(steps_ns, np.int64)
    found = match_steps(labels, detected, session.start_ns, session.end_ns, TOLERANCE_S)
    named = (
        ("hit", found.truth_ns[found.pairs[:, 0]]),
        ("missed", found.truth_ns[found.missed]),
        ("false", found.found_ns[found.false]),
    )
    pairs = timing_pairs(found)
    texts = {p.truth_ns: found_text(p, TOLERANCE_S) for p in pairs}
    texts |= {p.found_ns: answers_text(p, TOLERANCE_S) for p in pairs}
    return sorted(
        Verdict(int(t), verdict, "" if verdict == "hit" else texts.get(int(t), ""))
        for verdict, times in named
        for t in times
    )


def log_verdicts(timeline: Timeline, lines: LogLines, found: Sequence[Verdict]) -> None:
    """Log the lane, and a line for every step that was missed or is false."""
    lane = Lane(timeline, SCORE, COLOURS)
    for time_ns, verdict, why in found:
        lane.add(time_ns, verdict)
        if verdict != "hit":
            text = f"{verdict} step at {timeline.seconds(time_ns)}{f': {why}' if why else ''}"
            lines.add("score", time_ns, text, "ERROR" if verdict == "missed" else "WARN")
    lane.flush()
