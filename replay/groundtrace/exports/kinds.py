"""Kinds of things that can be exported, and which of them a result has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.events import (
    Bearing,
    CandidateBlock,
    Disagreement,
    Disturbance,
    Fix,
    Gap,
    Heading,
    LineCrossing,
    Note,
    Pass,
    Pick,
    Presence,
    StepEvent,
    TrackPoint,
)

if TYPE_CHECKING:
    from .api import Material

#: Event of each kind that is a table of single events.
EVENTS: dict[str, type] = {
    "steps": StepEvent,
    "picks": Pick,
    "fixes": Fix,
    "tracks": TrackPoint,
    "bearings": Bearing,
    "headings": Heading,
    "disturbances": Disturbance,
    "disagreements": Disagreement,
    "presence": Presence,
    "passes": Pass,
    "crossings": LineCrossing,
    "gaps": Gap,
    "notes": Note,
}
#: What comes from people: the recording's own truth, and annotations.
LABELS = ("truth", "annotations")
#: Every kind; signals are written only where they are asked for by name.
KINDS = (*EVENTS, *LABELS, "misses", "candidates", "signals")
TOLERANCE_S = 0.12


@dataclass(frozen=True, slots=True)
class Miss:
    """A wrong decision about a step.

    Attributes
    ----------
    time_ns
        Of the true step that no detection answers, or of the false detection.
    verdict
        ``missed`` or ``false``.
    cause, text
        Why a step was missed, as ``groundtrace why`` says it; empty for false ones.
    """

    time_ns: int
    verdict: str
    cause: str
    text: str


def events_of_kind(material: Material, kind: str) -> list[object]:
    """Return the events of a kind, in order of time."""
    found = [e for e in material.events if isinstance(e, EVENTS[kind])]
    return sorted(found, key=time_of)


def time_of(event: object) -> int:
    """Return when an event is, or begins [ns]."""
    named = "start_ns" if isinstance(event, Gap) else "time_ns"
    found: int = getattr(event, named)
    return found


def stage_of(event: object) -> str:
    """Return the stage an event comes from, or nothing."""
    return str(getattr(getattr(event, "spec", event), "stage", ""))


def has_step_truth(material: Material) -> bool:
    """Whether these are results, and it is known which steps are true."""
    if material.evidence is None:
        return False
    return any(label.kind == "step" for label in material.evidence().labels)


def misses(material: Material) -> list[Miss]:
    """Return missed and false steps by time; none where there is no truth of steps."""
    if material.evidence is None or not has_step_truth(material):
        return []
    from ..explain.reasons import StepReasons

    reasons = StepReasons(material.evidence(), TOLERANCE_S)
    matching = reasons.matching
    found = []
    for time_ns in matching.found_ns[matching.false].tolist():
        pair = reasons.wrong_time(time_ns)
        found.append(Miss(time_ns, "false", "", "" if pair is None else pair.text))
    for time_ns in matching.truth_ns[matching.missed].tolist():
        reason = reasons.at(time_ns)
        found.append(Miss(time_ns, "missed", reason.cause, reason.text))
    return sorted(found, key=time_of)


def there(material: Material) -> set[str]:
    """Return the kinds that a result has something of, but for signals."""
    kinds = {kind for kind, of in EVENTS.items() if any(isinstance(e, of) for e in material.events)}
    if any(isinstance(e, CandidateBlock) for e in material.events):
        kinds.add("candidates")
    if material.labels:
        kinds.add("truth")
    if material.annotations:
        kinds.add("annotations")
    if misses(material):
        kinds.add("misses")
    return kinds
