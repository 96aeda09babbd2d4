"""State lanes: marks and spans as coloured bands under the plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .palette import STEP_COLOURS, TYPE_COLOURS
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from .timeline import Timeline

#: How long a moment is drawn: long enough to be seen with half a minute in view.
MARK_NS = 100_000_000
#: Where the lanes of a replay stand among each other: those of truth and score, then of stages by
#: what they emit.
TRUTH, SCORE, GAPS = "/state/1-truth", "/state/2-score", "/state/7-gaps"
ORDER = {
    "step": 3, "impact": 3, "presence": 3, "pick": 4, "pass": 5, "fix": 5, "bearing": 5,
    "disagreement": 5, "track": 6,
}  # fmt: skip
LAST = 6
PLACING = frozenset({"fix", "bearing", "disagreement"})


@dataclass(frozen=True, slots=True, order=True)
class Mark:
    """A state over a half-open span [ns]."""

    start_ns: int
    end_ns: int
    state: str


class Lane:
    """One lane: marks may come in any order; the next mark ends the one before.

    Parameters
    ----------
    timeline
        Where to.
    path
        Entity path, shown at the lane.
    colours
        Of the states that may come.
    """

    def __init__(self, timeline: Timeline, path: str, colours: Mapping[str, int]) -> None:
        self._timeline = timeline
        self._path = path
        self._colours = colours
        self._marks: list[Mark] = []
        self._declared = False

    def allow(self, colours: Mapping[str, int]) -> None:
        """Let more states come."""
        if not colours.keys() <= self._colours.keys():
            self._colours = {**self._colours, **colours}
            if self._declared:
                self._declare()

    def add(self, start_ns: int, state: str, end_ns: int | None = None) -> None:
        """Take a mark; without an end it is a moment."""
        end = start_ns + MARK_NS if end_ns is None else max(end_ns, start_ns + MARK_NS)
        self._marks.append(Mark(start_ns, end, state))

    def flush(self, before_ns: int | None = None) -> None:
        """Log the marks that end before a time, or all.

        Marks added later must not start before that time.
        """
        marks = sorted(self._marks)
        if before_ns is None:
            ready = len(marks)
        else:
            ready = next((i for i, m in enumerate(marks) if m.end_ns > before_ns), len(marks))
        changes: list[tuple[int, str]] = []
        for i, mark in enumerate(marks[:ready]):
            following = marks[i + 1].start_ns if i + 1 < len(marks) else None
            if following is None or following > mark.start_ns:
                changes.append((mark.start_ns, mark.state))
                if following is None or following > mark.end_ns:
                    changes.append((mark.end_ns, ""))
        self._marks = marks[ready:]
        self._send(changes)

    def _send(self, changes: list[tuple[int, str]]) -> None:
        import rerun as rr

        if not changes:
            return
        if not self._declared:
            self._declare()
        times, states = zip(*changes, strict=True)
        self._timeline.send(self._path, times, rr.StateChange.columns(state=list(states)))

    def _declare(self) -> None:
        import rerun as rr

        style = rr.StateConfiguration(
            values=list(self._colours), colors=np.array(list(self._colours.values()), np.uint32)
        )
        self._timeline.declare(Entity(self._path, "lane"), style)
        self._declared = True


class StageLanes:
    """The lanes of stages: one for every stage and topic, by the stage's name alone if it can be.

    Parameters
    ----------
    timeline
        Where to.
    ordered
        Number the lanes in the order in which they are read, as the viewer sorts them by name, and
        let all stages that say where share one.
    """

    def __init__(self, timeline: Timeline, *, ordered: bool = False) -> None:
        self._timeline = timeline
        self._ordered = ordered
        self._lanes: dict[tuple[str, str], Lane] = {}

    def shared(self, emits: str) -> bool:
        """Whether stages that emit this have one lane together."""
        return self._ordered and emits in PLACING

    def of(
        self,
        stage: str,
        topic: str,
        colours: Mapping[str, int] = STEP_COLOURS | TYPE_COLOURS,
        emits: str = "step",
    ) -> Lane:
        """Return the lane of a stage on a topic; whoever asks says which states may come."""
        if self.shared(emits):
            stage, topic = "places", ""
        key = (stage, topic)
        if key not in self._lanes:
            alone = all(other != stage for other, _ in self._lanes)
            where = "" if alone else "/" + topic.strip("/")
            place = f"{ORDER.get(emits, LAST)}-" if self._ordered else ""
            self._lanes[key] = Lane(self._timeline, f"/state/{place}{stage}{where}", colours)
        self._lanes[key].allow(colours)
        return self._lanes[key]

    def flush(self, before_ns: int | None = None) -> None:
        """Log all lanes up to a time."""
        for lane in self._lanes.values():
            lane.flush(before_ns)


def coincident(
    time_ns: NDArray[np.int64], accepted: NDArray[np.bool_], window_ns: int
) -> list[int]:
    """Combine what several channels decided about the same moment.

    Parameters
    ----------
    time_ns
        Shape (n,), ascending [ns].
    accepted
        Shape (n,).
    window_ns
        Decisions within this time of a group's first belong to the group.

    Returns
    -------
    list
        One index per group: its first accepted decision, else its first.
    """
    chosen = []
    start = 0
    while start < len(time_ns):
        stop = int(np.searchsorted(time_ns, time_ns[start] + window_ns, side="left"))
        stop = max(stop, start + 1)
        chosen.append(start + int(np.argmax(accepted[start:stop])))
        start = stop
    return chosen
