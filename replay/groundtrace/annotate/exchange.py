"""Annotations as JSON: what the page in a browser speaks, and files it gives to be merged."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING

import msgspec

from groundtrace_codecs.annotations import Annotation, RecordingKey
from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError

if TYPE_CHECKING:
    from collections.abc import Iterable

FORMAT = "groundtrace-annotations"
VERSION = 1
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


def label_of(item: Item, start_ns: int, place: str = "annotation") -> Label:
    """Return the label that an item says; its kind and times are not checked.

    Raises
    ------
    AnnotationError
        Where a time is not one; names ``place``.
    """
    time_ns = _time(item.time_ns, item.time_s, start_ns, f"{place}: time")
    end_ns = None
    if item.end_s is not None or item.end_ns:
        end_ns = _time(item.end_ns or "", item.end_s or 0.0, start_ns, f"{place}: end")
    return Label(
        time_ns,
        item.kind,
        end_ns,
        channel=item.channel,
        label=item.label,
        author=item.author,
        note=item.note,
    )


def _time(exact: str, since_s: float, start_ns: int, place: str) -> int:
    """Return a time [ns]: the exact one, or the seconds since the start."""
    if exact:
        if not (exact.isascii() and exact.isdecimal() and len(exact) < 20):
            raise AnnotationError(f"{place}: expected nanoseconds, found {exact[:40]!r}")
        return int(exact)
    if not abs(since_s) < _LONGEST_S:
        raise AnnotationError(f"{place}: expected seconds, found {since_s:g}")
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
