"""Warnings of a replay: its notes of level WARN and ERROR, each listed once, with a count."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.events import Note
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from groundtrace_codecs.events import Event

#: Levels of notes that warn.
LOUD = frozenset({"WARN", "ERROR"})
#: A number by itself; the 2 of a channel G2 is part of a name.
_NUMBER = re.compile(r"(?<![\w/.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w/])")


@dataclass(frozen=True, slots=True)
class Warned:
    """What a replay warned of.

    Attributes
    ----------
    text
        As the first note says it.
    count
        Notes that say the same, whatever their numbers.
    source
        The stage that said it, or what else did; several with commas between.
    time_s
        Of the first note [s since the first sample of the recording].
    same
        Whether all of them say the same numbers.
    """

    text: str
    count: int
    source: str
    time_s: float
    same: bool = True

    @property
    def line(self) -> str:
        """The warning in one line, how often it was said included."""
        if self.count == 1:
            return self.text
        by = f", by {self.source}" if "," in self.source else ""
        return f"{self.text} ({self.count} times{'' if self.same else ', other numbers'}{by})"

    @property
    def document(self) -> dict[str, str | int | float]:
        """The warning as the JSON of commands gives it."""
        return {
            "text": self.text,
            "count": self.count,
            "source": self.source,
            "time_s": self.time_s,
        }


@dataclass(slots=True)
class WarningCounter:
    """Counts the notes that warn while a replay goes on."""

    _first: dict[str, Note] = field(default_factory=dict)
    _texts: dict[str, set[str]] = field(default_factory=dict)
    _sources: dict[str, dict[str, None]] = field(default_factory=dict)
    _counts: Counter[str] = field(default_factory=Counter)

    def add(self, note: Note) -> None:
        """Take a note of any level."""
        if note.level not in LOUD:
            return
        key = _NUMBER.sub("#", note.text)
        self._first.setdefault(key, note)
        self._counts[key] += 1
        self._sources.setdefault(key, {})[note.source] = None
        if len(texts := self._texts.setdefault(key, set())) < 2:
            texts.add(note.text)

    def summary(self, start_ns: int) -> tuple[Warned, ...]:
        """Return what was warned of, in the order in which it was first said.

        Parameters
        ----------
        start_ns
            First sample of the recording [ns].
        """
        return tuple(
            Warned(
                note.text,
                self._counts[key],
                ", ".join(self._sources[key]),
                (note.time_ns - start_ns) / NS_PER_S,
                len(self._texts[key]) == 1,
            )
            for key, note in self._first.items()
        )


def warnings_of(events: Iterable[Event], start_ns: int) -> tuple[Warned, ...]:
    """Return what the notes among events warn of; ``start_ns`` is the recording's first sample."""
    counter = WarningCounter()
    for event in events:
        if isinstance(event, Note):
            counter.add(event)
    return counter.summary(start_ns)
