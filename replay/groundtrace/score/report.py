"""The score of one result: the parts for which the recording has truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from groundtrace_codecs.events import (
    Disturbance,
    Fix,
    Heading,
    Pass,
    Pick,
    StageSpec,
    StepEvent,
    TrackPoint,
)

from .consistency import ConsistencyScore, score_consistency
from .disturbances import DisturbanceScore, score_disturbances
from .headings import HeadingScore, score_headings
from .passes import PassScore, score_passes
from .picks import PickScore, score_picks
from .positions import PositionScore, score_positions
from .step_matching import match_steps
from .step_words import compare_words
from .steps import StepScore, score_steps
from .tracks import TrackScore, score_tracks
from .ways import has_vehicles

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

E = TypeVar("E", Fix, TrackPoint, Heading, Disturbance, Pass)


@dataclass(frozen=True, slots=True)
class Score:
    """Scores by kind of truth; None where there is no truth of that kind, or nothing to score."""

    steps: StepScore | None
    positions: PositionScore | None
    picks: PickScore | None
    track: TrackScore | None
    heading: HeadingScore | None
    disturbance: DisturbanceScore | None
    consistency: ConsistencyScore | None
    passes: PassScore | None = None


@dataclass(frozen=True, slots=True)
class Answers:
    """What a result has to say, by kind of truth, in the order of its events.

    Attributes
    ----------
    steps
        Of the last stage that finds steps.
    picks
        By topic, of the last stage that picks: it has the last word.
    fixes
        Of all stages, so that localisers side by side can be compared.
    points
        Of the last stage that tracks.
    headings, disturbances, passes
        Of the last stage that gives any.
    """

    steps: list[StepEvent]
    picks: list[Pick]
    fixes: list[Fix]
    points: list[TrackPoint]
    headings: list[Heading]
    disturbances: list[Disturbance]
    passes: list[Pass]


def answers_of(events: Iterable[Event]) -> Answers:
    """Sort a result's events by the truth they answer."""
    found = Answers([], [], [], [], [], [], [])
    picking: dict[str, str] = {}
    stepping = tracking = ""
    for event in events:
        match event:
            case StepEvent():
                found.steps.append(event)
            case Pick():
                found.picks.append(event)
            case Fix():
                found.fixes.append(event)
            case TrackPoint():
                found.points.append(event)
            case Heading():
                found.headings.append(event)
            case Disturbance():
                found.disturbances.append(event)
            case Pass():
                found.passes.append(event)
            case StageSpec(emits="pick"):
                picking[event.topic] = event.stage
            case StageSpec(emits="step"):
                stepping = event.stage
            case StageSpec(emits="track"):
                tracking = event.stage
    tracks = [point for point in found.points if point.stage == tracking]
    return replace(
        found,
        steps=[step for step in found.steps if step.stage == (stepping or step.stage)],
        picks=[pick for pick in found.picks if picking.get(pick.topic) == pick.stage],
        points=tracks or last_word(found.points),
        headings=last_word(found.headings),
        disturbances=last_word(found.disturbances),
        passes=last_word(found.passes),
    )


def last_word(events: list[E]) -> list[E]:
    """Return the events of the stage that was the last to give its first one."""
    stages = list(dict.fromkeys(event.stage for event in events))
    return [event for event in events if event.stage == stages[-1]]


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
    said = answers_of(events)
    return Score(
        steps=_steps(labels, said.steps, start_ns, end_ns, tolerance_s),
        positions=score_positions(labels, said.fixes, tolerance_s),
        picks=score_picks(labels, said.picks),
        track=score_tracks(labels, said.points, tolerance_s),
        heading=score_headings(labels, said.headings, tolerance_s),
        disturbance=score_disturbances(labels, said.disturbances, start_ns, end_ns),
        consistency=score_consistency(labels, last_word(said.fixes), said.points, tolerance_s),
        passes=score_passes(labels, said.passes),
    )


def _steps(
    labels: Sequence[Label],
    steps: Sequence[StepEvent],
    start_ns: int,
    end_ns: int,
    tolerance_s: float,
) -> StepScore | None:
    if not steps and has_vehicles(labels):
        return None  # who walks beside a road is there to be told from vehicles
    detected_ns = np.array([step.time_ns for step in steps], np.int64)
    score = score_steps(labels, detected_ns, start_ns, end_ns, tolerance_s)
    if score is None:
        return None
    matching = match_steps(labels, detected_ns, start_ns, end_ns, tolerance_s)
    feet, kinds = compare_words(labels, steps, matching)
    return replace(score, feet=feet, kinds=kinds)
