"""The score of one result: the parts for which the recording has truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
from groundtrace_codecs.labels import has_vehicles

from ..errors import RecordingError
from ..trackers.api import SMOOTHED
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

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

#: Events that answer truth.
ANSWERS = (StepEvent, Pick, Fix, TrackPoint, Heading, Disturbance, Pass)
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
        Of the last stage that tracks: its smoothed track where there is one.
    headings, disturbances, passes
        Of the last stage that gives any.
    filtered
        Points of the same stage as they came, whose innovations tell whether it is consistent.
    finds_steps
        Whether a stage is there that would have given steps, or none is known at all.
    disturbances_by
        The last stage that would have given disturbances; empty where there is none.
    """

    steps: list[StepEvent]
    picks: list[Pick]
    fixes: list[Fix]
    points: list[TrackPoint]
    headings: list[Heading]
    disturbances: list[Disturbance]
    passes: list[Pass]
    filtered: list[TrackPoint] = field(default_factory=list)
    finds_steps: bool = False
    disturbances_by: str = ""


def answers_of(events: Iterable[Event], stages: Collection[str] = ()) -> Answers:
    """Sort a result's events by the truth they answer.

    Parameters
    ----------
    events
        All events of the result.
    stages
        Stages whose answers count in the place of others' of their kind.

    Raises
    ------
    RecordingError
        Where one of the stages answers nothing; it says which do.
    """
    events = tuple(events)
    if stages:
        events = _only(events, stages)
    found = Answers([], [], [], [], [], [], [])
    picking: dict[str, str] = {}
    stepping = tracking = telling = ""
    emitted = {event.emits for event in events if isinstance(event, StageSpec)}
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
            case StageSpec(emits="heading"):
                telling = event.stage
    tracks = [point for point in found.points if point.stage == tracking]
    smoothed = [point for point in found.points if point.stage == tracking + SMOOTHED]
    return replace(
        found,
        steps=[step for step in found.steps if step.stage == (stepping or step.stage)],
        picks=[pick for pick in found.picks if picking.get(pick.topic) == pick.stage],
        points=smoothed or tracks or last_word(found.points),
        filtered=tracks or last_word(found.points),
        finds_steps=bool(found.steps) or not emitted or bool(emitted & {"step", "impact"}),
        disturbances_by=telling,
        headings=last_word(found.headings),
        disturbances=last_word(found.disturbances),
        passes=last_word(found.passes),
    )


def _only(events: tuple[Event, ...], stages: Collection[str]) -> tuple[Event, ...]:
    """Return the events without those of kinds that the chosen stages give and they did not."""
    given: dict[str, set[type]] = {}
    for event in events:
        if isinstance(event, ANSWERS):
            given.setdefault(event.stage, set()).add(type(event))
    unknown = sorted(set(stages) - set(given))
    if unknown:
        known = ", ".join(given) or "none"
        raise RecordingError(f"--stage: expected one of {known}, found {unknown[0]}")
    chosen: set[type] = set().union(*(given[stage] for stage in stages))
    emitted = {StepEvent: {"step", "impact"}, Pick: {"pick"}, TrackPoint: {"track"}}
    silent = set().union(*(emitted.get(kind, set()) for kind in chosen))
    return tuple(
        event
        for event in events
        if not (type(event) in chosen and getattr(event, "stage", "") not in stages)
        and not (
            isinstance(event, StageSpec) and event.emits in silent and event.stage not in stages
        )
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
    stages: Collection[str] = (),
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
    stages
        As of :func:`answers_of`.
    """
    said = answers_of(events, stages)
    steps = _steps(labels, said.steps, start_ns, end_ns, tolerance_s) if said.finds_steps else None
    return Score(
        steps=steps,
        positions=score_positions(labels, said.fixes, tolerance_s),
        picks=score_picks(labels, said.picks),
        track=score_tracks(labels, said.points, tolerance_s),
        heading=score_headings(labels, said.headings, tolerance_s),
        disturbance=score_disturbances(
            labels, said.disturbances, start_ns, end_ns, told_by=said.disturbances_by
        ),
        consistency=score_consistency(
            labels, last_word(said.fixes), said.points, tolerance_s, said.filtered
        ),
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
