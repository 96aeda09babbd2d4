"""Labels: what a person or a reference system says happened. Truth and annotations are labels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

#: Kinds a truth table may hold; ``walking``, ``ignore``, ``count`` and ``idle`` (movement that is
#: no walking) are spans; ``trailing`` is the second contact of a side step, no step of its own.
TRUTH_KINDS = frozenset(
    {
        "step",
        "count",
        "walking",
        "ignore",
        "waypoint",
        "impact",
        "pick",
        "heading",
        "disturbed",
        "pass",
        "trailing",
        "idle",
    }
)
#: Kinds a person may mark. ``missed`` is a step that a detector missed, ``false`` a detection where
#: there was none, ``span`` a span with a word of its own.
MOMENT_KINDS = frozenset({"missed", "false", "step", "pick", "note"})
SPAN_KINDS = frozenset({"walking", "ignore", "disturbed", "pass", "span"})
ANNOTATION_KINDS = MOMENT_KINDS | SPAN_KINDS

#: Author of labels that were computed from what was simulated, not read off a recording.
SIMULATOR = "simulator"


@dataclass(frozen=True, slots=True, order=True)
class Label:
    """One labelled moment or span.

    Attributes
    ----------
    time_ns
        Moment, or start of the span [ns, on the recording's clock].
    kind
        One of :data:`TRUTH_KINDS` or of :data:`ANNOTATION_KINDS`.
    end_ns
        End of a half-open span [ns], or None for a moment.
    x_m, y_m
        Place [m], or None.
    value
        Count, heading [rad], speed, ... as the kind has it, or None.
    channel
        Channel concerned, for picks.
    label
        Detail: ``left``, ``right``, ``forward``, ...
    author
        Who or what labelled.
    note
        Free text.
    target
        Which of several targets, e.g. which of two walkers; empty where there is one.
    """

    time_ns: int
    kind: str
    end_ns: int | None = None
    x_m: float | None = None
    y_m: float | None = None
    value: float | None = None
    channel: str = ""
    label: str = ""
    author: str = ""
    note: str = ""
    target: str = ""

    def within(self, start_ns: int, stop_ns: int) -> Label | None:
        """Return the label as it holds in a half-open span; None where nothing of it does.

        A span is cut. A count is not told of a part of its span, so one that would be cut is left
        out.
        """
        if self.end_ns is None:
            return self if start_ns <= self.time_ns < stop_ns else None
        first_ns, end_ns = max(self.time_ns, start_ns), min(self.end_ns, stop_ns)
        if (first_ns, end_ns) == (self.time_ns, self.end_ns):
            return self
        if first_ns >= end_ns or self.kind == "count":
            return None
        return replace(self, time_ns=first_ns, end_ns=end_ns)


def has_vehicles(labels: Iterable[Label]) -> bool:
    """Return whether truth has vehicles: they pass stations, and steps have no places."""
    return any(x.kind == "pass" for x in labels)


def as_truth(label: Label) -> Label:
    """Return what an annotation says as truth: ``missed`` is a step, others are what they are.

    ``false``, ``note`` and ``span`` are no truth of anything; whoever scores leaves them out.
    """
    return replace(label, kind="step") if label.kind == "missed" else label
