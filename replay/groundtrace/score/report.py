"""The score of one result: the parts for which the recording has truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import Pick, StageSpec, StepEvent

from .picks import PickScore, score_picks
from .steps import StepScore, score_steps

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label


@dataclass(frozen=True, slots=True)
class Score:
    """Scores by kind of truth; None where there is no truth of that kind, or nothing to score."""

    steps: StepScore | None
    picks: PickScore | None


def score_events(
    labels: Sequence[Label],
    events: Iterable[Event],
    start_ns: int,
    end_ns: int,
    tolerance_s: float = 0.12,
) -> Score:
    """Score a result's events against labels.

    Parameters
    ----------
    labels
        The truth.
    events
        All events of the result.
    start_ns, end_ns
        First and last sample of the recording [ns].
    tolerance_s
        Largest distance of a matched step [s].
    """
    steps: list[int] = []
    picks: list[Pick] = []
    picking: dict[str, str] = {}  # by topic, the last stage that picks: it has the last word
    for event in events:
        if isinstance(event, StepEvent):
            steps.append(event.time_ns)
        elif isinstance(event, Pick):
            picks.append(event)
        elif isinstance(event, StageSpec) and event.emits == "pick":
            picking[event.topic] = event.stage
    final = [pick for pick in picks if picking.get(pick.topic) == pick.stage]
    step_score = score_steps(labels, np.array(steps, np.int64), start_ns, end_ns, tolerance_s)
    return Score(step_score, score_picks(labels, final))
