"""What several people say of one recording: where they differ, and what is truth of it all."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.labels import SPAN_KINDS, as_truth
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.labels import Label

#: Within this two people mean the same moment [s].
TOLERANCE_S = 0.05
#: Within this two steps are one that is timed differently [s]: half the time between the fastest
#: steps of a walk.
ONE_STEP_S = 0.25


@dataclass(frozen=True, slots=True)
class Conflict:
    """Annotations that contradict each other.

    Attributes
    ----------
    reason
        ``step or not``, ``time``, ``foot`` or type, ``edited`` (two forms of one annotation) or
        ``deleted here``.
    annotations
        The one or two concerned.
    """

    reason: str
    annotations: tuple[Annotation, ...]


@dataclass(frozen=True, slots=True)
class Truth:
    """Annotations as truth.

    Attributes
    ----------
    labels
        By time.
    merged
        How many were left out because another author says the same.
    conflicts
        How often authors contradict each other.
    """

    labels: tuple[Label, ...]
    merged: int
    conflicts: int


def conflicts(
    annotations: Iterable[Annotation], tolerance_s: float = TOLERANCE_S
) -> tuple[Conflict, ...]:
    """Return where authors contradict each other, by time.

    One says that there is a step and another, within the tolerance, that there is none; or both
    mean one step and differ by more than the tolerance, or say another foot or type of step. Each
    step is compared with the nearest of every other author.

    Parameters
    ----------
    annotations
        Of all authors.
    tolerance_s
        Within this two people mean the same moment [s].
    """
    known = sorted(annotations, key=lambda a: (a.label.time_ns, a.id))
    steps = [a for a in known if as_truth(a.label).kind == "step"]
    found = _step_or_not(steps, [a for a in known if a.label.kind == "false"], tolerance_s)
    by_author: dict[str, list[Annotation]] = {}
    for step in steps:
        by_author.setdefault(step.label.author, []).append(step)
    authors = sorted(by_author)
    for i, one in enumerate(authors):
        for other in authors[i + 1 :]:
            found += _differing(by_author[one], by_author[other], tolerance_s)
    return tuple(sorted(found, key=lambda c: c.annotations[0].label.time_ns))


def _step_or_not(
    steps: Sequence[Annotation], false: Sequence[Annotation], tolerance_s: float
) -> list[Conflict]:
    times = _times(steps)
    reach = round(tolerance_s * NS_PER_S)
    return [
        Conflict("step or not", (step, no))
        for no in false
        for step in steps[
            bisect_left(times, no.label.time_ns - reach) : bisect_right(
                times, no.label.time_ns + reach
            )
        ]
        if step.label.author != no.label.author
    ]


def _differing(
    ones: Sequence[Annotation], others: Sequence[Annotation], tolerance_s: float
) -> list[Conflict]:
    """Compare the steps of two authors: those that are nearest to each other."""
    found = []
    for one in ones:
        other = _nearest(others, one)
        if _nearest(ones, other) is not one:
            continue
        apart_s = abs(one.label.time_ns - other.label.time_ns) / NS_PER_S
        words = {one.label.label, other.label.label} - {""}
        if tolerance_s < apart_s <= ONE_STEP_S:
            found.append(Conflict("time", (one, other)))
        elif apart_s <= tolerance_s and len(words) > 1:
            found.append(Conflict("foot", (one, other)))
    return found


def _times(annotations: Sequence[Annotation]) -> list[int]:
    return [a.label.time_ns for a in annotations]


def _nearest(annotations: Sequence[Annotation], to: Annotation) -> Annotation:
    """Return the annotation nearest in time; ``annotations`` are by time, and not empty."""
    at = bisect_left(annotations, to.label.time_ns, key=lambda a: a.label.time_ns)
    near = annotations[max(at - 1, 0) : at + 1]
    return min(near, key=lambda a: abs(a.label.time_ns - to.label.time_ns))


def truth_of_annotations(
    annotations: Iterable[Annotation], author: str = "", place: str = "annotations"
) -> Truth:
    """Return what annotations say as truth.

    ``missed`` and ``step`` are steps. Moments that two authors give within the tolerance, of one
    kind and on one channel, are one: at the mean of their times, with the words of the first that
    has any. Spans stay as they are. ``false``, ``note`` and ``span`` stay too, and count for
    nothing.

    Parameters
    ----------
    annotations
        Of one recording.
    author
        Whose are truth; empty for everybody's.
    place
        What errors call them.

    Raises
    ------
    AnnotationError
        Where there are none by ``author``.
    """
    chosen = [a for a in annotations if author in ("", a.label.author)]
    if author and not chosen:
        raise AnnotationError(f"{place}: author: expected annotations by {author!r}, found none")
    labels = _by_time(as_truth(a.label) for a in chosen)
    together = [group for alike in _alike(labels) for group in _groups(alike)]
    truth = _by_time(_one(group) for group in together)
    return Truth(truth, len(labels) - len(truth), len(conflicts(chosen)))


def _by_time(labels: Iterable[Label]) -> tuple[Label, ...]:
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel, x.author)))


def _alike(labels: Iterable[Label]) -> list[list[Label]]:
    """Return labels of one kind on one channel together; every span alone."""
    alike: dict[tuple[str, str], list[Label]] = {}
    alone: list[list[Label]] = []
    for label in labels:
        if label.kind in SPAN_KINDS:
            alone.append([label])
        else:
            alike.setdefault((label.kind, label.channel), []).append(label)
    return [*alike.values(), *alone]


def _groups(labels: Sequence[Label]) -> list[list[Label]]:
    """Return what different authors say within the tolerance together; ``labels`` are by time."""
    groups: list[list[Label]] = []
    for label in labels:
        last = groups[-1] if groups else []
        near = last and (label.time_ns - last[0].time_ns) / NS_PER_S <= TOLERANCE_S
        if near and label.author not in (x.author for x in last):
            last.append(label)
        else:
            groups.append([label])
    return groups


def _one(group: Sequence[Label]) -> Label:
    """Return what a group says, at the mean of its times."""
    first = group[0]
    return replace(
        first,
        time_ns=first.time_ns + sum(x.time_ns - first.time_ns for x in group) // len(group),
        label=next((x.label for x in group if x.label), ""),
        author=", ".join(x.author for x in group),
        note="; ".join(x.note for x in group if x.note),
    )
