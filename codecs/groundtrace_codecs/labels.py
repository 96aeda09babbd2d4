"""Labels: what a person or a reference system says happened. Truth and annotations are labels."""

from __future__ import annotations

from dataclasses import dataclass

#: Kinds a truth table may hold; ``walking``, ``ignore`` and ``count`` are spans.
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
    }
)


@dataclass(frozen=True, slots=True, order=True)
class Label:
    """One labelled moment or span.

    Attributes
    ----------
    time_ns
        Moment, or start of the span [ns, on the recording's clock].
    kind
        One of :data:`TRUTH_KINDS`, or an annotator's own word.
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
