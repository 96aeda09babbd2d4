"""Every pass of a vehicle against the truth: found, missed or false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace.score.passes import match_passes
from groundtrace.score.places import ignored
from groundtrace_codecs.events import Pass

from .lanes import SCORE, Lane
from .pass_log import pass_text
from .verdict import COLOURS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace.explain import Evidence
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    from .events import LogLines
    from .timeline import Timeline


@dataclass(frozen=True, slots=True, order=True)
class PassVerdict:
    """What became of a pass.

    Attributes
    ----------
    time_ns
        Of the true pass that was hit or missed, of the found one that is false.
    verdict
        ``hit``, ``missed`` or ``false``.
    station, text
        Where, and what there is to say of it.
    """

    time_ns: int
    verdict: str
    station: str
    text: str


def pass_verdicts(
    labels: Sequence[Label], passes: Sequence[Pass], span_ns: tuple[int, int]
) -> list[PassVerdict]:
    """Return what became of every true pass, and which found ones answer none, as scored.

    Parameters
    ----------
    labels
        Truth.
    passes
        Of one stage.
    span_ns
        First and last sample that was replayed [ns].
    """
    first, last = span_ns
    kept = [x for x in labels if x.kind == "pass" and first <= x.time_ns <= last]
    known = ignored(labels, np.array([x.time_ns for x in kept], np.int64))
    truth = sorted(x for x, no in zip(kept, known, strict=True) if not no)
    away = ignored(labels, np.array([p.time_ns for p in passes], np.int64))
    found = [p for p, no in zip(passes, away, strict=True) if not no]
    if not truth:
        return []
    pairs = match_passes(truth, found)
    hit, told = [x for x, _ in pairs], [p for _, p in pairs]
    true = [(x, "hit" if x in hit else "missed") for x in truth]
    return sorted(
        [
            *(PassVerdict(x.time_ns, what, x.channel, _said(x)) for x, what in true),
            *(PassVerdict(p.time_ns, "false", p.station, pass_text(p)) for p in found
              if p not in told),
        ]
    )  # fmt: skip


def wrong_passes(evidence: Evidence, events: Sequence[Event]) -> tuple[str, list[PassVerdict]]:
    """Return the last stage that finds passes, and the passes that are missed or false by it."""
    stages = [part.spec.stage for part in evidence.stages if part.spec.emits == "pass"]
    if not stages:
        return "", []
    found = [e for e in events if isinstance(e, Pass) and e.stage == stages[-1]]
    verdicts = pass_verdicts(evidence.labels, found, (evidence.start_ns, evidence.end_ns))
    return stages[-1], [one for one in verdicts if one.verdict != "hit"]


def _said(label: Label) -> str:
    """Return what the truth says of a pass."""
    speed = f"{label.value:.1f} m/s" if label.value is not None else ""
    return " ".join(filter(None, (label.target, label.label, speed, "at", label.channel)))


def log_pass_verdicts(timeline: Timeline, lines: LogLines, verdicts: Sequence[PassVerdict]) -> None:
    """Log the lane of the score, and a line for every pass that was missed or is false."""
    lane = Lane(timeline, SCORE, COLOURS)
    for one in verdicts:
        lane.add(one.time_ns, one.verdict)
        if one.verdict != "hit":
            text = f"{timeline.seconds(one.time_ns)}  {one.verdict} pass: {one.text}"
            lines.add("score", one.time_ns, text, "ERROR" if one.verdict == "missed" else "WARN")
    lane.flush()
