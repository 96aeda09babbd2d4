"""Checks the tracks of a replay: one must exist where it was asked for, and be physically possible.

The assumption that is checked: nobody on foot, and no road vehicle, covers ground faster than the
fastest that was ever measured. Over a second or more that holds of a foot as of the body above it.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.events import SMOOTHED, Fix, Note, StepEvent, TrackPoint
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from groundtrace_codecs.events import Event

#: Fastest over a second or more, by application, and of whom [m/s]. Source: on foot, the fastest
#: sprint that was measured reached 12.3 m/s (the 100 m of Berlin, 2009); on the road, the fastest
#: car 136 m/s (2019).
FASTEST_MPS = {
    "room": (12.5, "any person runs"),
    "walker": (12.5, "any person runs"),
    "vehicle": (140.0, "any car drives"),
}
#: Speeds are looked at over so long or more [ns]: over less, the error of a place counts.
SPAN_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class Tracking:
    """A stage that tracks.

    Attributes
    ----------
    stage
        Its name.
    takes
        What it takes: ``steps``, ``fixes`` or another word.
    source
        The stage that gives it these; empty for signals.
    """

    stage: str
    takes: str
    source: str = ""


@dataclass(slots=True)
class _Worst:
    """What is impossible of the tracks of one stage: how often, and where it is worst."""

    points: int = 0
    impossible: int = 0
    speed_mps: float = 0.0
    apart_m: float = 0.0
    span_s: float = 0.0
    time_ns: int = 0


@dataclass(slots=True)
class _State:
    recent: dict[tuple[str, int], deque[TrackPoint]] = field(default_factory=dict)
    worst: dict[str, _Worst] = field(default_factory=dict)
    given: Counter[tuple[str, str]] = field(default_factory=Counter)
    last_ns: int = 0
    fed_ns: int = 0


class TrackCheck:
    """Looks at the events of a pipeline; what it has to say, it says at their end.

    Parameters
    ----------
    application
        Kind of recording: who moves.
    tracking
        The stages that track; none where no track was asked for.
    metric
        Whether places are in metres: else no speed is known.
    """

    def __init__(self, application: str, tracking: Sequence[Tracking], *, metric: bool) -> None:
        self._tracking = tuple(tracking)
        self._fastest = FASTEST_MPS.get(application) if metric else None
        self._state = _State()

    def update(self, events: Iterable[Event], time_ns: int = 0) -> None:
        """Take the events that came of an item, in their order, and when the item was [ns]."""
        if not self._tracking:
            return
        state = self._state
        state.fed_ns = max(state.fed_ns, time_ns)
        for event in events:
            if isinstance(event, TrackPoint):
                state.last_ns = event.time_ns
                self._moved(event)
            elif isinstance(event, StepEvent):
                state.given["steps", event.stage] += 1
                state.last_ns = event.time_ns
            elif isinstance(event, Fix):
                state.given["fixes", event.stage] += 1

    def flush(self) -> Iterator[Note]:
        """Say what is wrong with the tracks."""
        state = self._state
        if self._tracking and not state.worst:
            time_ns = state.last_ns or state.fed_ns
            yield Note(time_ns, self._none_text(), "WARN", self._tracking[-1].stage)
        for stage, worst in state.worst.items():
            # a track that is gone again as more is known leaps as it goes, and not in the end
            is_last_word = stage + SMOOTHED not in state.worst
            if is_last_word and worst.impossible and self._fastest is not None:
                limit_mps, who = self._fastest
                far = f"{worst.apart_m:.1f} m in {worst.span_s:.1f} s"
                text = (
                    f"{stage}: a track that cannot be: {far} is {worst.speed_mps:.1f} m/s, faster "
                    f"than {who} ({limit_mps:g} m/s); so are {worst.impossible} of {worst.points} "
                    f"points"
                )
                yield Note(worst.time_ns, text, "WARN", stage)

    def _none_text(self) -> str:
        reasons = []
        for tracking in self._tracking:
            if not tracking.source:
                reasons.append(f"{tracking.stage} takes {tracking.takes}")
                continue
            count = self._state.given[tracking.takes, tracking.source]
            of = f"the {tracking.takes} of {tracking.source}"
            reasons.append(f"{tracking.stage} takes {of}, which found {count}")
        return f"no track, though one was asked for: {'; '.join(dict.fromkeys(reasons))}"

    def _moved(self, point: TrackPoint) -> None:
        worst = self._state.worst.setdefault(point.stage, _Worst())
        worst.points += 1
        if self._fastest is None or not math.isfinite(point.x_m + point.y_m):
            return
        recent = self._state.recent.setdefault((point.stage, point.track), deque())
        if recent and point.time_ns < recent[-1].time_ns:
            recent.clear()
        recent.append(point)
        while len(recent) > 1 and point.time_ns - recent[1].time_ns >= SPAN_NS:
            recent.popleft()
        span_ns = point.time_ns - recent[0].time_ns
        if span_ns < SPAN_NS:
            return
        apart_m = math.hypot(point.x_m - recent[0].x_m, point.y_m - recent[0].y_m)
        speed_mps = apart_m * NS_PER_S / span_ns
        worst.impossible += speed_mps > self._fastest[0]
        if speed_mps > worst.speed_mps:
            worst.speed_mps, worst.apart_m, worst.span_s = speed_mps, apart_m, span_ns / NS_PER_S
            worst.time_ns = point.time_ns
