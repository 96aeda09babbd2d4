"""Kinds of things that can be exported, and which of them a result has."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, get_type_hints

from groundtrace_codecs.events import EVENTS, CandidateBlock

if TYPE_CHECKING:
    from .api import Material

#: Types of fields that are cells of a table; a field ``covariance`` is three of them.
CELLS = frozenset({int, float, str, bool})
#: What comes from people: the recording's own truth, and annotations.
LABELS = ("truth", "annotations")
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


def tables_of_events() -> dict[str, type[Any]]:
    """Return the events that are rows of tables, by what several of a kind are called."""
    return {kind.plural: cls for cls, kind in EVENTS.items() if _has_cells(cls)}


def _has_cells(cls: type[Any]) -> bool:
    hints = get_type_hints(cls)
    return all(f.name == "covariance" or hints[f.name] in CELLS for f in fields(cls))


def all_kinds() -> tuple[str, ...]:
    """Return every kind; signals are written only where they are asked for by name."""
    return (*tables_of_events(), *LABELS, "misses", "candidates", "signals")


def events_of_kind(material: Material, kind: str) -> list[Any]:
    """Return the events of a kind, in order of time."""
    of = tables_of_events()[kind]
    return sorted((e for e in material.events if isinstance(e, of)), key=time_of)


def time_of(event: Any) -> int:
    """Return when an event is, or begins [ns]."""
    found: int = event.time_ns
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
    types = {type(event) for event in material.events}
    kinds = {kind for kind, of in tables_of_events().items() if of in types}
    if CandidateBlock in types:
        kinds.add("candidates")
    if material.labels:
        kinds.add("truth")
    if material.annotations:
        kinds.add("annotations")
    if misses(material):
        kinds.add("misses")
    return kinds
