"""Audacity's labels: ``start<TAB>end<TAB>text`` a line, as its label tracks import them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.events import Disturbance, Pick, Presence, StepEvent

from .api import Written
from .delimited import seconds_text
from .kinds import EVENTS, LABELS, Miss, events_of_kind, misses

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.labels import Label

    from .api import Material

#: Start and end [ns], and what is said.
Line = tuple[int, int, str]


class AudacityExporter:
    """Writes label tracks; Sonic Visualiser and Praat's importers read them too."""

    name = "audacity"
    description = "labels of Audacity: moments and spans with a text"
    suffixes = (".txt",)
    kinds = ("steps", "picks", "presence", "disturbances", *LABELS, "misses")
    one_kind = False

    def write(self, material: Material, kinds: Sequence[str], path: Path) -> Written:
        """Write a line for each moment or span, in order of time."""
        found = {kind: list(_lines(material, kind)) for kind in kinds}
        lines = sorted(line for several in found.values() for line in several)
        start_ns = material.start_ns
        text = "".join(
            f"{seconds_text(a - start_ns)}\t{seconds_text(b - start_ns)}\t{_one_line(said)}\n"
            for a, b, said in lines
        )
        path.write_text(text, "utf-8")
        return Written({kind: len(several) for kind, several in found.items()})


def _lines(material: Material, kind: str) -> Iterator[Line]:
    if kind in EVENTS:
        yield from map(_event_line, events_of_kind(material, kind))
    elif kind == "misses":
        yield from map(_miss_line, misses(material))
    elif kind == "truth":
        yield from (_label_line(label, "true ") for label in material.labels)
    else:
        yield from (_label_line(a.label, "") for a in material.annotations)


def _event_line(event: object) -> Line:
    match event:
        case StepEvent():
            words = (event.kind, event.type, event.foot)
            return event.time_ns, event.time_ns, " ".join(filter(None, words))
        case Pick():
            return event.time_ns, event.time_ns, f"pick {event.channel}"
        case Presence():
            return event.time_ns, event.end_ns, f"vehicle {event.channel}"
        case Disturbance():
            return event.time_ns, event.end_ns, f"disturbed {event.stage}"
    raise TypeError(f"expected an event of {AudacityExporter.kinds}, found {type(event)}")


def _miss_line(miss: Miss) -> Line:
    words = (miss.verdict, f"({miss.cause})" if miss.cause else "")
    return miss.time_ns, miss.time_ns, " ".join(filter(None, words))


def _label_line(label: Label, before: str) -> Line:
    end_ns = label.time_ns if label.end_ns is None else label.end_ns
    words = (label.kind, label.channel, label.label, label.target, label.note)
    return label.time_ns, end_ns, before + " ".join(filter(None, words))


def _one_line(text: str) -> str:
    """Return a text without what ends a cell or a line."""
    return " ".join(text.split())
