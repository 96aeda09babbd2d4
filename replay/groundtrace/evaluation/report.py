"""The score of one result: the parts for which the recording has truth."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from groundtrace_codecs.events import EVENTS, SMOOTHED, StageSpec, has_vehicles

from ..errors import RecordingError
from .headings import DisturbanceScore, HeadingScore, score_disturbances, score_headings
from .matching import STEP_TOLERANCE_S, match_steps
from .picks import PickScore, score_picks
from .positions import PositionScore, score_positions
from .steps import StepScore, compare_words, score_steps
from .tracks import ConsistencyScore, TrackScore, score_consistency, score_tracks
from .vehicles import PassScore, score_passes

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from groundtrace_codecs.events import (
        Disturbance,
        Event,
        Fix,
        Heading,
        Label,
        Pass,
        Pick,
        StepEvent,
        TrackPoint,
    )

E = TypeVar("E")


@dataclass(frozen=True, slots=True)
class Score:
    """Scores by kind of truth; None where there is no truth of that kind, or nothing to score.

    ``others`` are the parts of scorers that have no field here, by name.
    """

    steps: StepScore | None = None
    positions: PositionScore | None = None
    picks: PickScore | None = None
    track: TrackScore | None = None
    heading: HeadingScore | None = None
    disturbance: DisturbanceScore | None = None
    consistency: ConsistencyScore | None = None
    passes: PassScore | None = None
    others: Mapping[str, object] | None = None

    @property
    def parts(self) -> dict[str, object]:
        """The parts for which there is truth, by name."""
        named = {name: getattr(self, name) for name in _NAMED} | dict(self.others or {})
        return {name: part for name, part in named.items() if part is not None}


_NAMED = tuple(each.name for each in fields(Score) if each.name != "others")


@dataclass(frozen=True, slots=True)
class ResultEvents:
    """What a result has to say, by kind of truth, in the order of its stages, then of its events.

    Attributes
    ----------
    steps
        Of the last stage that finds steps.
    picks
        By topic, of the last stage that picks, which is the one reported.
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
    last_stage
        The last stage that would have given them, by what stages say that they give.
    by_kind
        By class all events that are held against truth, of the last stage that gives any.
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
    last_stage: Mapping[str, str] = field(default_factory=dict)
    by_kind: Mapping[type[Any], list[Any]] = field(default_factory=dict)


def answers_of(events: Iterable[Event], stages: Collection[str] = ()) -> ResultEvents:
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
    answers: dict[str, list[Any]] = {kind.name: [] for kind in EVENTS.values() if kind.truth}
    for event in events:
        kind = EVENTS.get(type(event))
        if kind is not None and kind.truth:
            answers[kind.name].append(event)
    specs = [event for event in events if isinstance(event, StageSpec)]
    answers = {name: _in_stage_order(those, specs) for name, those in answers.items()}
    emitted = {spec.emits for spec in specs}
    last = {spec.emits: spec.stage for spec in specs}
    picking = {spec.topic: spec.stage for spec in specs if spec.emits == "pick"}
    stepping, tracking = last.get("step", ""), last.get("track", "")
    points = answers["track"]
    tracks = [point for point in points if point.stage == tracking]
    smoothed = [point for point in points if point.stage == tracking + SMOOTHED]
    return ResultEvents(
        steps=[step for step in answers["step"] if step.stage == (stepping or step.stage)],
        picks=[pick for pick in answers["pick"] if picking.get(pick.topic) == pick.stage],
        fixes=answers["fix"],
        points=smoothed or tracks or last_word(points),
        headings=last_word(answers["heading"]),
        disturbances=last_word(answers["disturbance"]),
        passes=last_word(answers["pass"]),
        filtered=tracks or last_word(points),
        finds_steps=bool(answers["step"]) or not emitted or bool(emitted & {"step", "impact"}),
        last_stage=last,
        by_kind={cls: last_word(answers[k.name]) for cls, k in EVENTS.items() if k.truth},
    )


def _only(events: tuple[Event, ...], stages: Collection[str]) -> tuple[Event, ...]:
    """Return the events without those of kinds that the chosen stages give and they did not."""
    scored = {cls: kind.name for cls, kind in EVENTS.items() if kind.truth}
    given: dict[str, set[str]] = {}
    for event in events:
        if type(event) in scored:
            given.setdefault(getattr(event, "stage", ""), set()).add(scored[type(event)])
    unknown = sorted(set(stages) - set(given))
    if unknown:
        names = ", ".join(given) or "none"
        raise RecordingError(f"--stage: expected one of {names}, found {unknown[0]}")
    chosen: set[str] = set().union(*(given[stage] for stage in stages))
    silent = chosen & {"step", "pick", "track"}
    silent |= {"impact"} if "step" in silent else set()
    return tuple(
        event
        for event in events
        if not (scored.get(type(event)) in chosen and getattr(event, "stage", "") not in stages)
        and not (
            isinstance(event, StageSpec) and event.emits in silent and event.stage not in stages
        )
    )


def _in_stage_order(events: Iterable[E], specs: Iterable[StageSpec]) -> list[E]:
    """Return events by the place of their stage in the pipeline, each stage's as they came.

    Parameters
    ----------
    events
        Some of the events.
    specs
        What stages state, in the order of the pipeline. A stage that states nothing is before all
        others.
    """
    rank = {stage: index for index, stage in enumerate(dict.fromkeys(s.stage for s in specs))}

    def rank_of(event: E) -> int:
        return rank.get(str(getattr(event, "stage", "")).removesuffix(SMOOTHED), -1)

    return sorted(events, key=rank_of)


def last_word(events: Sequence[E]) -> list[E]:
    """Return the events of the last stage, of events as :class:`ResultEvents` has them."""
    by = [str(getattr(event, "stage", "")) for event in events]
    stages = list(dict.fromkeys(by))
    return [event for event, stage in zip(events, by, strict=True) if stage == stages[-1]]


def score_events(
    labels: Sequence[Label],
    events: Iterable[Event],
    start_ns: int,
    end_ns: int,
    tolerance_s: float = STEP_TOLERANCE_S,
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
    answers = answers_of(events, stages)
    truth = Truth(labels, start_ns, end_ns, tolerance_s)
    parts: dict[str, Any] = {}
    for scorer in SCORERS.values():
        parts |= scorer(answers, truth)
    others = {name: parts.pop(name) for name in tuple(parts) if name not in _NAMED}
    return Score(**parts, others=others or None)


@dataclass(frozen=True, slots=True)
class Truth:
    """What is known to be so.

    Attributes
    ----------
    labels
        What happened.
    start_ns, end_ns
        First and last sample of the recording [ns].
    tolerance_s
        Largest distance of a matched step [s].
    """

    labels: Sequence[Label]
    start_ns: int
    end_ns: int
    tolerance_s: float


def _score_steps(answers: ResultEvents, truth: Truth) -> dict[str, Any]:
    if not answers.finds_steps:
        return {"steps": None}
    span = truth.start_ns, truth.end_ns
    return {"steps": _steps(truth.labels, answers.steps, *span, truth.tolerance_s)}


def _score_places(answers: ResultEvents, truth: Truth) -> dict[str, Any]:
    labels, tolerance_s = truth.labels, truth.tolerance_s
    return {
        "positions": score_positions(
            labels, answers.fixes, tolerance_s, told_by=answers.last_stage.get("fix", "")
        ),
        "track": score_tracks(labels, answers.points, tolerance_s),
        "consistency": score_consistency(
            labels, last_word(answers.fixes), answers.points, tolerance_s, answers.filtered
        ),
    }


def _score_disturbances(answers: ResultEvents, truth: Truth) -> dict[str, Any]:
    span, by = (truth.start_ns, truth.end_ns), answers.last_stage.get("heading", "")
    score = score_disturbances(truth.labels, answers.disturbances, *span, told_by=by)
    return {"disturbance": score}


#: What scores the events that are held against a kind of label; it returns parts of :class:`Score`
#: by name, whether that has a field for them or not.
SCORERS: Mapping[str, Callable[[ResultEvents, Truth], dict[str, Any]]] = {
    "step": _score_steps,
    "waypoint": _score_places,
    "pick": lambda answers, truth: {"picks": score_picks(truth.labels, answers.picks)},
    "heading": lambda answers, truth: {
        "heading": score_headings(truth.labels, answers.headings, truth.tolerance_s)
    },
    "disturbed": _score_disturbances,
    "pass": lambda answers, truth: {
        "passes": score_passes(
            truth.labels, answers.passes, told_by=answers.last_stage.get("pass", "")
        )
    },
}


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
