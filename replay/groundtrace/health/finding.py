"""What is found wrong with a channel, and how it is summed up while the recording goes by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .windows import Window


@dataclass(frozen=True, slots=True)
class Finding:
    """One kind of fault of one channel.

    Attributes
    ----------
    topic, channel
        Where; the channel is empty where the whole stream is meant, and a quantity where its three
        axes are.
    kind
        ``not finite``, ``late``, ``constant``, ``clipped``, ``dropouts``, ``spikes``, ``offset``,
        ``hum``, ``rate``, ``axes``, ``unit`` or ``zero``.
    start_ns, end_ns
        Half-open span from the first to the last time it is so [ns].
    events
        How many times.
    share
        Part of the samples that are concerned, 0 to 1; for hum the part of the quiet power.
    what, effect, remedy
        The same for people: what was found, what it does to results, and what to do.
    """

    topic: str
    channel: str
    kind: str
    start_ns: int
    end_ns: int
    events: int
    share: float
    what: str
    effect: str
    remedy: str


class Watcher(Protocol):
    """Looks for one kind of fault in all channels of a stream."""

    def hear(self, window: Window) -> None:
        """Take the next window of the run."""

    def gap(self) -> None:
        """End the run: what comes next does not follow."""

    def findings(self) -> Iterator[Finding]:
        """Yield what was found; after the last :meth:`gap`."""


@dataclass(slots=True)
class Tally:
    """Spans of one fault of one channel, summed up.

    Attributes
    ----------
    events, samples
        How many spans, of how many samples together.
    start_ns, end_ns
        Half-open span from the beginning of the first to the end of the last [ns].
    """

    events: int = 0
    samples: int = 0
    start_ns: int = 0
    end_ns: int = 0

    def add(self, start_ns: int, end_ns: int, samples: int) -> None:
        """Add a span."""
        if not self.events:
            self.start_ns = start_ns
        self.events += 1
        self.samples += samples
        self.end_ns = max(end_ns, self.end_ns)


def percent(share: float) -> str:
    """Return a part as a percentage for people."""
    return f"{100 * share:.2g} %" if share >= 1e-4 else "under 0.01 %"


def times(count: int) -> str:
    """Return ``once`` or how many times."""
    return "once" if count == 1 else f"{count} times"
