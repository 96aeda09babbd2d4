"""How events go along the stages of a pipeline: each stage takes many of them at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock


class Taking(Protocol):
    """What takes items along the line; many at once where it has a method ``process_all``."""

    name: str

    def process(self, item: SignalBlock | Event) -> Iterable[Event]:
        """Take one item; return the events it brings about."""

    def flush(self) -> Iterable[Event]:
        """End of the recording: return what was held back."""


@dataclass(slots=True)
class Made:
    """An item, what stages made of it, one after the other, and what the last one did of it."""

    item: Any
    born: list[Made] = field(default_factory=list)
    last: Sequence[Event] = ()

    def events(self) -> list[Event]:
        """Return what was made of the item, each event before what was made of that."""
        found: list[Event] = []
        for made in self.born:
            found.append(made.item)
            if made.born or made.last:
                found += made.events()
        found += self.last
        return found


def pass_on(line: list[Made], stages: Sequence[Taking]) -> None:
    """Let every stage take what comes along the line; what it makes of an item goes before it.

    So later stages see items in the order in which they would if each went through all stages
    before the next one came, while a stage that can takes many of them at once.
    """
    for stage in stages[:-1]:
        items = [made.item for made in line]
        longer: list[Made] = []
        for made, events in zip(line, _made_by(stage, items), strict=True):
            if events:
                born = [Made(event) for event in events]
                made.born += born
                longer += born
            longer.append(made)
        line = longer
    for stage in stages[-1:]:
        made_by = _made_by(stage, [made.item for made in line])
        for made, events in zip(line, made_by, strict=True):
            made.last = events


def _made_by(stage: Taking, items: Sequence[SignalBlock | Event]) -> list[list[Event]]:
    """Return what a stage makes of each of items that come one after the other."""
    at_once: Callable[..., list[list[Event]]] | None = getattr(stage, "process_all", None)
    if at_once is not None:
        return at_once(items)
    return [list(stage.process(item)) for item in items]
