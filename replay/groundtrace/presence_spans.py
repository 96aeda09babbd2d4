"""Spans in which a channel hears a vehicle, from cycles that passed all gates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.events import Presence
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import CandidateBlock, StageSpec

#: Accepted cycles no further apart are of one span [ns].
_BRIDGE_NS = NS_PER_S


@dataclass(slots=True)
class _Open:
    """A span that may go on: its first and last accepted cycle, and the greatest value."""

    first_ns: int
    last_ns: int
    value: float


@dataclass(slots=True)
class Spans:
    """The spans of one stage on one topic, while they grow.

    Attributes
    ----------
    open
        By channel.
    last_ns, cycle_ns
        Of each channel the last candidate, and how far candidates are apart [ns].
    spec
        What the candidates so far are; None before any.
    """

    open: dict[int, _Open] = field(default_factory=dict)
    last_ns: dict[int, int] = field(default_factory=dict)
    cycle_ns: int = 0
    spec: StageSpec | None = None

    def take(self, block: CandidateBlock) -> Iterator[Presence]:
        """Take decided candidates; yield the spans that have ended."""
        self.spec = block.spec
        rows = zip(
            block.time_ns.tolist(),
            block.channel.tolist(),
            block.value[:, 0].tolist(),
            block.accepted.tolist(),
            strict=True,
        )
        for time_ns, channel, value, accepted in rows:
            self._space(channel, time_ns)
            known = self.open.get(channel)
            if known is not None and time_ns - known.last_ns > _BRIDGE_NS:
                yield self._ended(block.spec, channel)
                known = None
            if accepted and known is None:
                self.open[channel] = _Open(time_ns, time_ns, value)
            elif accepted and known is not None:
                known.last_ns, known.value = time_ns, max(known.value, value)

    def finish(self) -> Iterator[Presence]:
        """End all spans."""
        if self.spec is not None:
            for channel in sorted(self.open):
                yield self._ended(self.spec, channel)
        self.last_ns.clear()

    def _space(self, channel: int, time_ns: int) -> None:
        if channel in self.last_ns:
            apart = time_ns - self.last_ns[channel]
            self.cycle_ns = apart if self.cycle_ns == 0 else min(apart, self.cycle_ns)
        self.last_ns[channel] = time_ns

    def _ended(self, spec: StageSpec, channel: int) -> Presence:
        one = self.open.pop(channel)
        half = self.cycle_ns // 2
        name = spec.channels[channel]
        start_ns, end_ns = one.first_ns - half, one.last_ns + half
        return Presence(start_ns, end_ns, name, spec.topic, spec.stage, one.value)
