"""Samples that are not numbers: NaN and infinities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .finding import Finding, Tally, percent, times

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.signals import Stream

    from .windows import Window


class NonFinite:
    """Counts samples that are not finite, in every channel of a stream."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._found = [Tally() for _ in stream.channels]
        self._open = np.zeros(len(stream.channels), np.bool_)
        self._heard = 0

    def hear(self, window: Window) -> None:
        """Take the next window."""
        self._heard += len(window)
        bad = np.isnan(window.core)
        for c in np.flatnonzero(bad.any(axis=1) | self._open):
            edges = np.flatnonzero(np.diff(bad[c], prepend=False, append=False))
            for first, end in edges.reshape(-1, 2).tolist():
                goes_on = first == 0 and self._open[c]
                span = window.time_ns(first), window.time_ns(end)
                self._found[c].add(*span, end - first)
                self._found[c].events -= int(goes_on)
        self._open = bad[:, -1].copy()

    def gap(self) -> None:
        """Forget that a span was open."""
        self._open[:] = False

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel that has such samples."""
        for channel, found in zip(self.stream.channels, self._found, strict=True):
            if not found.events:
                continue
            share = found.samples / self._heard
            yield Finding(
                self.stream.topic,
                channel.name,
                "not finite",
                found.start_ns,
                found.end_ns,
                found.events,
                share,
                f"NaN or infinite {times(found.events)}, {found.samples} samples "
                f"({percent(share)})",
                "the last finite value is held there, no onset is seen",
                "look for overflows in what wrote the file",
            )
