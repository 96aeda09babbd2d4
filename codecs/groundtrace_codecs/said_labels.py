"""What is labelled already, where the labels of several files come together."""

from __future__ import annotations

from bisect import bisect_left, insort
from typing import TYPE_CHECKING

from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .labels import Label

#: Labels of two files that say the same within this time are said once [ns].
SAME_NS = NS_PER_S // 10


class Said:
    """The labels of earlier files, by what they are about."""

    def __init__(self) -> None:
        self._moments: dict[tuple[str, str, str], list[int]] = {}
        self._spans: dict[tuple[str, str, str], list[tuple[int, int]]] = {}

    def add(self, labels: Sequence[Label]) -> None:
        """Take the labels of a file."""
        for label in labels:
            about = (label.kind, label.target, label.channel)
            if label.end_ns is None:
                insort(self._moments.setdefault(about, []), label.time_ns)
            else:
                self._spans.setdefault(about, []).append((label.time_ns, label.end_ns))

    def holds(self, label: Label) -> bool:
        """Whether an earlier file says what a label says."""
        about = (label.kind, label.target, label.channel)
        if label.end_ns is not None:
            spans = self._spans.get(about, ())
            return any(label.time_ns < end and start < label.end_ns for start, end in spans)
        times = self._moments.get(about, [])
        first = bisect_left(times, label.time_ns - SAME_NS)
        return first < len(times) and times[first] <= label.time_ns + SAME_NS
