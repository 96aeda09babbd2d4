"""What is true of a simulated walk: steps, spans, headings, places, disturbed spans."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S

from .gait import LATERAL
from .magnetic import DISTURBED_T
from .simulation import AUTHOR, START_NS
from .walk_sensors import grid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from .gait import Bout
    from .walk_sensors import Walker

    Array = NDArray[np.float64]

_RATE_HZ = 200.0
_HEADING_S = 0.1


def walk_labels(walker: Walker) -> tuple[Label, ...]:
    """Return the truth in order of time, nothing of it after the end."""
    truth = _Truth(walker)
    labels = [*truth.bouts(), *truth.turns(), *truth.disturbed(), *truth.headings()]
    labels += [
        Label(_ns(i.start_s), "idle", _ns(i.end_s), label=i.activity, author=AUTHOR)
        for i in walker.plan.idles
    ]
    end_ns = _ns(float(truth.time_s[-1]))
    kept = [_until(end_ns, x) for x in labels if x.time_ns <= end_ns]
    return tuple(sorted(kept, key=lambda x: (x.time_ns, x.kind, x.channel)))


class _Truth:
    """Where the body is and faces, on a fine grid."""

    def __init__(self, walker: Walker) -> None:
        self.walker = walker
        self.time_s = grid(walker.duration_s, _RATE_HZ)
        self.heading = walker.plan.heading(self.time_s)
        self.track = np.ascontiguousarray(walker.plan.track(self.time_s).T)

    def at(self, moment_s: float, kind: str, label: str = "", note: str = "") -> Label:
        """Return a label with the body's place."""
        x, y = (round(float(np.interp(moment_s, self.time_s, p)), 4) for p in self.track)
        return Label(_ns(moment_s), kind, None, x, y, label=label, author=AUTHOR, note=note)

    def heading_at(self, moment_s: float) -> Label:
        """Return where the body faces."""
        value = round(float(np.interp(moment_s, self.time_s, self.heading)), 4)
        x, y = (round(float(np.interp(moment_s, self.time_s, p)), 4) for p in self.track)
        return Label(_ns(moment_s), "heading", None, x, y, value, author=AUTHOR)

    def bouts(self) -> Iterator[Label]:
        """Yield walking spans, where they start and stop, and their steps."""
        for bout in self.walker.plan.bouts:
            start_s, end_s = bout.span_s
            yield self.at(start_s, "waypoint", "start")
            yield self.at(end_s, "waypoint", "stop")
            yield Label(_ns(start_s), "walking", _ns(end_s), author=AUTHOR)
            yield from self.steps(bout)

    def steps(self, bout: Bout) -> Iterator[Label]:
        """Yield a walk's steps; the second contact of a side step is not one of its own."""
        for index, contact_s in enumerate(bout.contact_s.tolist()):
            foot = bout.foot(index)
            if not self.walker.options.types:
                yield self.at(contact_s, "step", foot)
            elif bout.kind in LATERAL and index % 2:
                yield self.at(contact_s, "trailing", bout.kind, f"{foot} foot")
            else:
                yield self.at(contact_s, "step", bout.kind, f"{foot} foot")

    def headings(self) -> Iterator[Label]:
        """Yield headings: with each step of the bundled walk, else ten times a second."""
        moments = np.arange(0.0, self.walker.duration_s, _HEADING_S)
        if self.walker.options.standard:
            moments = np.concatenate([np.empty(0), *(b.contact_s for b in self.walker.plan.bouts)])
        yield from (self.heading_at(moment_s) for moment_s in moments.tolist())

    def turns(self) -> Iterator[Label]:
        """Yield the corners: where the body is in the middle of each turn."""
        for turn in self.walker.plan.turns:
            yield self.at(turn.start_s + turn.length_s / 2, "waypoint", "turn")

    def disturbed(self) -> Iterator[Label]:
        """Yield the spans in which the field differs from the earth's by 2 uT or more."""
        extra_t = np.linalg.norm(self.walker.disturbing_field(self.time_s), axis=1)
        inside = np.concatenate(([False], extra_t >= DISTURBED_T, [False]))
        edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():
            most_t = round(float(extra_t[first:last].max()), 8)
            span_s = float(self.time_s[first]), last / _RATE_HZ
            yield Label(_ns(span_s[0]), "disturbed", _ns(span_s[1]), value=most_t, author=AUTHOR)


def _until(end_ns: int, label: Label) -> Label:
    """Return the label with a span that ends within the recording."""
    if label.end_ns is None or label.end_ns <= end_ns:
        return label
    return replace(label, end_ns=end_ns)


def _ns(moment_s: float) -> int:
    return START_NS + round(moment_s * NS_PER_S)
