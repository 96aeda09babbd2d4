"""From verdicts on frames to disturbances with a start and an end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundtrace_codecs.events import Disturbance

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(slots=True)
class DisturbedSpans:
    """Joins disturbed frames; an undisturbed time shorter than ``join_ns`` between them is part.

    Attributes
    ----------
    stage
        Name of the stage that finds them.
    join_ns
        How far apart two disturbances are at least [ns].
    """

    stage: str
    join_ns: int
    _open: Disturbance | None = None

    @property
    def under_way(self) -> bool:
        """Whether a disturbance may go on."""
        return self._open is not None

    def add(
        self, start_ns: int, end_ns: int, value: float, *, disturbed: bool
    ) -> Iterator[Disturbance]:
        """Take a frame [start, end) and how much it is off; yield a disturbance that is over."""
        span = self._open
        if span is not None and start_ns - span.end_ns > self.join_ns:
            self._open = None
            yield span
            span = None
        if not disturbed:
            return
        if span is None:
            self._open = Disturbance(start_ns, end_ns, value, self.stage)
        else:
            self._open = Disturbance(span.time_ns, end_ns, max(span.value, value), self.stage)

    def finish(self) -> Iterator[Disturbance]:
        """End: yield the disturbance that is still open."""
        span, self._open = self._open, None
        if span is not None:
            yield span
