"""What an annotation must be before it is kept."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.labels import ANNOTATION_KINDS, SPAN_KINDS
from groundtrace_codecs.signals import NS_PER_S

from ..errors import AnnotationError

if TYPE_CHECKING:
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.labels import Label

#: Who annotates where nobody says so; the name of the system's user is nobody's business.
AUTHOR = "annotator"
#: Times may be rounded this far beyond the recording, as printed ones are [ns].
_ROUNDING_NS = 1_000_000
_LONGEST_NAME, _LONGEST_NOTE = 100, 10_000
_INT64_LIMIT = 1 << 63


@dataclass(frozen=True, slots=True)
class Extent:
    """What there is of a recording to be annotated.

    Attributes
    ----------
    start_ns, end_ns
        First and last sample [ns].
    channels
        Names of all channels.
    """

    start_ns: int
    end_ns: int
    channels: frozenset[str]

    def seconds(self, time_ns: int) -> float:
        """Return a time as seconds since the first sample."""
        return (time_ns - self.start_ns) / NS_PER_S


def named(author: str, place: str = "author") -> str:
    """Return the name of an annotator.

    Raises
    ------
    AnnotationError
        Where it is empty, long, or more than a line.
    """
    if not author.strip():
        raise AnnotationError(f"{place}: expected a name, found nothing")
    return _text(author.strip(), place, _LONGEST_NAME, one_line=True)


def checked(label: Label, extent: Extent, place: str = "annotation") -> Label:
    """Return a label that may be kept as an annotation.

    Raises
    ------
    AnnotationError
        Where the kind is not one of those a person may mark, a time lies outside the recording, or
        a kind lacks what it needs; names ``place`` and the field.
    """
    if label.kind not in ANNOTATION_KINDS:
        kinds = ", ".join(sorted(ANNOTATION_KINDS))
        raise AnnotationError(f"{place}: kind: expected one of {kinds}, found {label.kind[:40]!r}")
    _check_times(label, extent, place)
    if label.channel not in extent.channels and (label.channel or label.kind == "pick"):
        names = ", ".join(sorted(extent.channels))
        found = repr(label.channel[:40]) if label.channel else "none"
        raise AnnotationError(f"{place}: channel: expected one of {names}, found {found}")
    for name in ("x_m", "y_m", "value"):
        number = getattr(label, name)
        if number is not None and not math.isfinite(number):
            raise AnnotationError(f"{place}: {name}: expected a finite number, found {number}")
    for name in ("channel", "label", "target"):
        _text(getattr(label, name), f"{place}: {name}", _LONGEST_NAME, one_line=True)
    _text(label.note, f"{place}: note", _LONGEST_NOTE)
    return replace(label, author=named(label.author, f"{place}: author"))


def checked_annotation(annotation: Annotation, extent: Extent, place: str) -> Annotation:
    """Return an annotation made elsewhere that may be kept here.

    Raises
    ------
    AnnotationError
        As :func:`checked`, or where its id or wall clock cannot be kept.
    """
    at = f"{place}: {annotation.id[:40]!r}"
    if not annotation.id:
        raise AnnotationError(f"{place}: id: expected one, found nothing")
    _text(annotation.id, f"{at}: id", _LONGEST_NAME, one_line=True)
    for name in ("created_ns", "edited_ns"):
        if not 0 <= getattr(annotation, name) < _INT64_LIMIT:
            found = getattr(annotation, name)
            raise AnnotationError(f"{at}: {name}: expected an int64 from 0 on, found {found}")
    return replace(annotation, label=checked(annotation.label, extent, at))


def _check_times(label: Label, extent: Extent, place: str) -> None:
    times = [("time", label.time_ns)]
    if label.end_ns is not None:
        times.append(("end", label.end_ns))
    for name, time_ns in times:
        early = time_ns < extent.start_ns - _ROUNDING_NS
        if early or time_ns < 0 or time_ns > extent.end_ns + _ROUNDING_NS:
            last = extent.seconds(extent.end_ns)
            raise AnnotationError(
                f"{place}: {name}: expected 0 to {last:.3f} s, as long as the recording is, "
                f"found {extent.seconds(time_ns):.3f} s"
            )
    if label.kind in SPAN_KINDS:
        if label.end_ns is None or label.end_ns <= label.time_ns:
            found = "none" if label.end_ns is None else "one before it"
            raise AnnotationError(
                f"{place}: end: expected one after the start, as {label.kind} is a span, "
                f"found {found}"
            )
    elif label.end_ns is not None:
        raise AnnotationError(
            f"{place}: end: expected none, as {label.kind} is a moment, found one"
        )


def _text(text: str, place: str, longest: int, *, one_line: bool = False) -> str:
    if len(text) > longest:
        raise AnnotationError(f"{place}: expected at most {longest} characters, found {len(text)}")
    if one_line and not text.isprintable():
        raise AnnotationError(f"{place}: expected printable text in one line, found {text!r}")
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise AnnotationError(f"{place}: expected Unicode text, found {error.reason}") from error
    return text
