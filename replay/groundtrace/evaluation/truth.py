"""The truth that a result is scored against: not given to its pipeline, and within its reach.

A waypoint that a stage was given is no truth for it any more: it shows how well a track was drawn
through known positions, not how well it was found. A sensor on one foot feels the steps of that
foot. Where truth has impacts only, a detector of steps is scored on them.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.errors import did_you_mean
from groundtrace_codecs.events import LABEL_KINDS, StageSpec, has_vehicles

from .steps import ALONG, FEET, truth_words

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from groundtrace_codecs.events import Label

    from ..pipeline.results import Results


@dataclass(frozen=True, slots=True)
class ScoredTruth:
    """Truth to score against.

    Attributes
    ----------
    labels
        What is left of it.
    given
        How many waypoints were left out because the pipeline was given them.
    foot
        Whose steps alone are left, ``left`` or ``right``; empty: everybody's.
    remarks
        What a person should know of that.
    """

    labels: tuple[Label, ...]
    given: int
    foot: str
    remarks: tuple[str, ...]


def scored_truth(labels: Sequence[Label], result: Results) -> ScoredTruth:
    """Return what of a truth a result is scored against."""
    given_points = {(x.time_ns, x.x_m, x.y_m) for x in result.given}
    scored_labels = [
        x for x in labels if x.kind != "waypoint" or (x.time_ns, x.x_m, x.y_m) not in given_points
    ]
    specs = [event for event in result.events if isinstance(event, StageSpec)]
    truth = own_truth(scored_labels, specs, result.provenance.placements)
    truth = replace(truth, remarks=(*truth.remarks, *_without_meaning(labels)))
    given = len(labels) - len(scored_labels)
    if not given:
        return truth
    waypoints = sum(x.kind == "waypoint" for x in labels)
    remark = f"{given} of {waypoints} waypoints were given to the pipeline: not scored"
    return replace(truth, given=given, remarks=(remark, *truth.remarks))


def _without_meaning(labels: Iterable[Label]) -> list[str]:
    """Return what is to be said of labels whose kinds another program made up."""
    counts = Counter(label.kind for label in labels if label.kind not in LABEL_KINDS)
    return [
        f"labels of kind {kind!r}: {count}, not scored: expected one of "
        f"{', '.join(sorted(LABEL_KINDS))}{did_you_mean(kind, LABEL_KINDS)}"
        for kind, count in counts.items()
    ]


def own_truth(
    labels: Sequence[Label], specs: Sequence[StageSpec], placements: Mapping[str, str]
) -> ScoredTruth:
    """Return what of a truth the sensors can find in which the last stage of steps looks.

    Impacts become steps where truth has no steps of its own and a stage finds some.

    Parameters
    ----------
    labels
        The truth.
    specs
        Of the stages.
    placements
        Of the topics that state one.
    """
    foot, remark = _own_foot(labels, specs, placements)
    scored_labels = [x for x in labels if not foot or (x.kind != "count" and _may_be(x, foot))]
    if impacts := _impacts_alone(scored_labels, specs):
        scored_labels = [
            replace(x, kind="step") if x.kind == "impact" else x for x in scored_labels
        ]
        remark = f"{impacts} impacts and no steps: the impacts are what steps are scored against"
    return ScoredTruth(tuple(scored_labels), 0, foot, (remark,) if remark else ())


def _impacts_alone(labels: Sequence[Label], specs: Sequence[StageSpec]) -> int:
    """Return how many impacts there are to be found as steps: none where truth has steps."""
    if has_vehicles(labels) or any(x.kind in ("step", "count") for x in labels):
        return 0
    if not any(spec.emits in ("step", "impact") for spec in specs):
        return 0
    return sum(x.kind == "impact" for x in labels)


def foot_of(placement: str) -> str:
    """Return the foot that a placement names, ``both`` of none, and nothing where it is no foot."""
    words = set(re.split(r"[^a-z]+", placement.lower()))
    if not words & {"foot", "shoe", "ankle"}:
        return ""
    sides = words & set(FEET)
    return sides.pop() if len(sides) == 1 else "both"


def _own_foot(
    labels: Sequence[Label], specs: Sequence[StageSpec], placements: Mapping[str, str]
) -> tuple[str, str]:
    """Return the foot whose steps a result finds, and what is to be said of it."""
    true = [x for x in labels if x.kind == "step"]
    if any(ALONG & set(truth_words(x.label)[1].split()) for x in true):
        return "", ""  # left and right are types of steps there
    if {truth_words(x.label)[0] for x in true} < set(FEET):
        return "", ""
    stepping = [spec for spec in specs if spec.emits == "step"]
    topics = [spec.topic for spec in stepping if spec.stage == stepping[-1].stage]
    stated = [placements.get(topic, "") for topic in topics]
    worn = set(map(foot_of, stated))
    if len(worn) != 1 or worn == {""}:
        return "", ""
    (foot,) = worn
    if foot != "both":
        text = f"{', '.join(topics)} is on the {foot} foot: the truth of that foot alone is scored"
        return foot, text
    return "", (
        f"truth has both feet, and the placement of {', '.join(topics)} does not state which one "
        f"it is on: expected left foot or right foot, found {', '.join(stated)}; the steps "
        f"of the other foot count as missed"
    )


def _may_be(label: Label, foot: str) -> bool:
    """Return whether a step may be one of a foot."""
    return label.kind != "step" or truth_words(label.label)[0] in ("", foot)


def kinds_of(labels: Iterable[Label]) -> str:
    """Return how many labels of each kind there are, in words."""
    counts = Counter(label.kind for label in labels)
    return ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "none"
