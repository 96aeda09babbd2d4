"""Agreement of several annotators of one recording: where they differ, and their joint truth."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import TYPE_CHECKING

import msgspec

from groundtrace_codecs.annotations import Annotation, RecordingKey
from groundtrace_codecs.events import SPAN_KINDS, Label, as_truth
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Within this two people mean the same moment [s]. Chosen by judgement: what hand and eye do with a
#: signal on screen.
TOLERANCE_S = 0.05
#: Within this two steps are one that is timed differently [s]: half the time between the fastest
#: steps of a walk. Chosen by judgement: nobody walks at more than two steps in a second for long.
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


def conflicts(annotations: Iterable[Annotation]) -> tuple[Conflict, ...]:
    """Return where authors contradict each other, by time.

    One says that there is a step and another, within the tolerance, that there is none; or both
    mean one step and differ by more than the tolerance, or say another foot or type of step. Each
    step is compared with the nearest of every other author.

    Parameters
    ----------
    annotations
        Of all authors.
    """
    ordered = sorted(annotations, key=lambda a: (a.label.time_ns, a.id))
    steps = [a for a in ordered if as_truth(a.label).kind == "step"]
    clashes = _step_or_not(steps, [a for a in ordered if a.label.kind == "false"])
    by_author: dict[str, list[Annotation]] = {}
    for step in steps:
        by_author.setdefault(step.label.author, []).append(step)
    authors = sorted(by_author)
    for i, one in enumerate(authors):
        for other in authors[i + 1 :]:
            clashes += _differing(by_author[one], by_author[other])
    return tuple(sorted(clashes, key=lambda c: c.annotations[0].label.time_ns))


def _step_or_not(steps: Sequence[Annotation], false: Sequence[Annotation]) -> list[Conflict]:
    times = _times(steps)
    reach = round(TOLERANCE_S * NS_PER_S)
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


def _differing(ones: Sequence[Annotation], others: Sequence[Annotation]) -> list[Conflict]:
    """Compare the steps of two authors: those that are nearest to each other."""
    clashes = []
    for one in ones:
        other = _nearest(others, one)
        if _nearest(ones, other) is not one:
            continue
        apart_s = abs(one.label.time_ns - other.label.time_ns) / NS_PER_S
        words = {one.label.label, other.label.label} - {""}
        if TOLERANCE_S < apart_s <= ONE_STEP_S:
            clashes.append(Conflict("time", (one, other)))
        elif apart_s <= TOLERANCE_S and len(words) > 1:
            clashes.append(Conflict("foot", (one, other)))
    return clashes


def _times(annotations: Sequence[Annotation]) -> list[int]:
    return [a.label.time_ns for a in annotations]


def _nearest(annotations: Sequence[Annotation], to: Annotation) -> Annotation:
    """Return the annotation nearest in time; ``annotations`` are by time, and not empty."""
    at = bisect_left(annotations, to.label.time_ns, key=lambda a: a.label.time_ns)
    near = annotations[max(at - 1, 0) : at + 1]
    return min(near, key=lambda a: abs(a.label.time_ns - to.label.time_ns))


def truth_of_annotations(
    annotations: Iterable[Annotation], author: str = "", where: str = "annotations"
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
    where
        What errors call them.

    Raises
    ------
    AnnotationError
        Where there are none by ``author``.
    """
    chosen = [a for a in annotations if author in ("", a.label.author)]
    if author and not chosen:
        raise AnnotationError(f"{where}: author: expected annotations by {author!r}, found none")
    labels = _by_time(as_truth(a.label) for a in chosen)
    together = [group for channel_labels in _by_kind(labels) for group in _groups(channel_labels)]
    truth = _by_time(_one(group) for group in together)
    return Truth(truth, len(labels) - len(truth), len(conflicts(chosen)))


def _by_time(labels: Iterable[Label]) -> tuple[Label, ...]:
    return tuple(sorted(labels, key=lambda x: (x.time_ns, x.kind, x.channel, x.author)))


def _by_kind(labels: Iterable[Label]) -> list[list[Label]]:
    """Return labels of one kind on one channel together; every span alone."""
    by_kind: dict[tuple[str, str], list[Label]] = {}
    alone: list[list[Label]] = []
    for label in labels:
        if label.kind in SPAN_KINDS:
            alone.append([label])
        else:
            by_kind.setdefault((label.kind, label.channel), []).append(label)
    return [*by_kind.values(), *alone]


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


FORMAT = "groundtrace-annotations"
VERSION = 1
#: Longest time that has nanoseconds [s]. Source: definition, int64.
_LONGEST_S = 2**63 / 1e9


@dataclass(frozen=True, slots=True)
class Item:
    """One annotation in JSON.

    Attributes
    ----------
    id, kind
        Of the annotation and of its label.
    time_s, end_s
        Since the recording's first sample [s].
    channel, label, author, note
        Of the label.
    created_ns, edited_ns
        Wall clock [ns since 1970].
    time_ns, end_ns
        On the recording's clock, exactly, as text: a browser's numbers are too short for them.
        Empty where they follow from the seconds.
    """

    id: str
    kind: str
    time_s: float
    end_s: float | None = None
    channel: str = ""
    label: str = ""
    author: str = ""
    note: str = ""
    created_ns: int = 0
    edited_ns: int = 0
    time_ns: str = ""
    end_ns: str | None = None


@dataclass(frozen=True, slots=True)
class Named:
    """The recording, by file name and SHA-256; its first sample [ns] as text."""

    name: str
    sha256: str
    start_ns: str = ""


@dataclass(frozen=True, slots=True)
class Document:
    """Annotations of a recording, as JSON.

    Attributes
    ----------
    format, version
        Of the document.
    recording
        What is annotated.
    annotations
        By time.
    """

    format: str
    version: int
    recording: Named
    annotations: tuple[Item, ...]


def item_of(annotation: Annotation, start_ns: int) -> Item:
    """Return an annotation as it is in JSON; times count from ``start_ns``."""
    label = annotation.label
    end_ns = label.end_ns
    return Item(
        annotation.id,
        label.kind,
        (label.time_ns - start_ns) / NS_PER_S,
        None if end_ns is None else (end_ns - start_ns) / NS_PER_S,
        label.channel,
        label.label,
        label.author,
        label.note,
        annotation.created_ns,
        annotation.edited_ns,
        str(label.time_ns),
        None if end_ns is None else str(end_ns),
    )


def label_of(item: Item, start_ns: int, where: str = "annotation") -> Label:
    """Return the label that an item says; its kind and times are not checked.

    Raises
    ------
    AnnotationError
        Where a time is not one; names ``where``.
    """
    time_ns = _time(item.time_ns, item.time_s, start_ns, f"{where}: time")
    end_ns = None
    if item.end_s is not None or item.end_ns:
        end_ns = _time(item.end_ns or "", item.end_s or 0.0, start_ns, f"{where}: end")
    return Label(
        time_ns,
        item.kind,
        end_ns,
        channel=item.channel,
        label=item.label,
        author=item.author,
        note=item.note,
    )


def _time(exact: str, since_s: float, start_ns: int, where: str) -> int:
    """Return a time [ns]: the exact one, or the seconds since the start."""
    if exact:
        if not (exact.isascii() and exact.isdecimal() and len(exact) < 20):
            raise AnnotationError(f"{where}: expected nanoseconds, found {exact[:40]!r}")
        return int(exact)
    if not abs(since_s) < _LONGEST_S:
        raise AnnotationError(f"{where}: expected seconds, found {since_s:g}")
    return start_ns + round(Decimal(repr(float(since_s))) * NS_PER_S)


def document_of(key: RecordingKey, annotations: Iterable[Annotation]) -> Document:
    """Return annotations of a recording as a document."""
    items = tuple(item_of(a, key.start_ns) for a in annotations)
    return Document(FORMAT, VERSION, Named(key.name, key.sha256, str(key.start_ns)), items)


def to_json(key: RecordingKey, annotations: Iterable[Annotation]) -> bytes:
    """Return annotations of a recording as JSON, UTF-8."""
    return msgspec.json.encode(document_of(key, annotations))


def from_json(
    content: bytes, start_ns: int, name: str = "annotations"
) -> tuple[RecordingKey, tuple[Annotation, ...]]:
    """Read annotations out of JSON.

    Parameters
    ----------
    content
        Any bytes.
    start_ns
        First sample of the recording [ns], from which seconds count.
    name
        What errors call the document.

    Returns
    -------
    tuple
        Which recording they are said to be of, and the annotations, in their order. Kinds and
        times are not checked.

    Raises
    ------
    AnnotationError
        Where the bytes are not such a document.
    """
    try:
        document = msgspec.json.decode(content, type=Document)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise AnnotationError(f"{name}: expected {FORMAT}, found: {error}") from error
    if (document.format, document.version) != (FORMAT, VERSION):
        raise AnnotationError(
            f"{name}: expected {FORMAT} {VERSION}, "
            f"found {document.format[:40]!r} {document.version}"
        )
    key = RecordingKey(document.recording.name, document.recording.sha256, start_ns)
    return key, tuple(
        Annotation(x.id, label_of(x, start_ns, f"{name}: {x.id[:40]!r}"), x.created_ns, x.edited_ns)
        for x in document.annotations
    )
