"""Audacity's labels: ``start<TAB>end<TAB>text`` a line, as its label tracks import them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .api import Written
from .delimited import seconds_text
from .kinds import LABELS, Miss, events_of_kind, misses

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import StepEvent
    from groundtrace_codecs.labels import Label

    from .api import Material

#: Start and end [ns], and what is said.
Line = tuple[int, int, str]


def _step_words(step: StepEvent) -> str:
    return " ".join(filter(None, (step.kind, step.type, step.foot)))


#: What is said of the events that have a label.
WORDS: dict[str, Callable[[Any], str]] = {
    "steps": _step_words,
    "picks": lambda pick: f"pick {pick.channel}",
    "presence": lambda span: f"vehicle {span.channel}",
    "disturbances": lambda span: f"disturbed {span.stage}",
}


class AudacityExporter:
    """Writes label tracks; Sonic Visualiser and Praat's importers read them too."""

    name = "audacity"
    description = "labels of Audacity: moments and spans with a text"
    suffixes = (".txt",)
    kinds = (*WORDS, *LABELS, "misses")
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
    if kind in WORDS:
        yield from (_event_line(event, WORDS[kind]) for event in events_of_kind(material, kind))
    elif kind == "misses":
        yield from map(_miss_line, misses(material))
    elif kind == "truth":
        yield from (_label_line(label, "true ") for label in material.labels)
    else:
        yield from (_label_line(a.label, "") for a in material.annotations)


def _event_line(event: Any, words: Callable[[Any], str]) -> Line:
    return event.time_ns, getattr(event, "end_ns", event.time_ns), words(event)


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
