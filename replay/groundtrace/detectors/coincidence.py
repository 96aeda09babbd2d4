"""Coincidence: picks of several channels close in time are one impact.

Source: the association that the thesis on footstep localisation presumes between detection (section
3.4) and localisation (chapter 5). The order of the gates is coincidence, refractory time.

The thesis has one walker; the feet of two come down at any times. A refractory time that keeps the
toe of a step from counting (0.1 s after its heel) would reject the other walker's heel as well.
Their picks differ. A heel is so sharp that all sensors pick the same front, within the time that a
wave takes across the room; onsets of a toe, soft and in the coda of its heel, scatter over several
times that. So a sharp front may stand alone, whatever picks come shortly before, and is spared the
refractory time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S

from ..pipeline.gates import Candidates, Level, Reach
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import CHAINED, Context, Input, Memory, Stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..pipeline.gates import GateState

NOTHING = Candidates.empty(3)
#: Part of the channels that a sharp front reaches: of the onsets of a toe, some are sharp as well.
#: Chosen by judgement.
MOST = 0.8


@dataclass(frozen=True, slots=True)
class CoincidenceParameters:
    """Parameters of :class:`Coincidence`."""

    window_s: Annotated[float, measured("s", "Longest time between picks of an impact.", gt=0)] = (
        0.05
    )
    min_channels: Annotated[int, gate("1", "Least number of channels that saw it.", ge=1)] = 4
    refractory_s: Annotated[float, gate("s", "Least time between two impacts.", ge=0)] = 0.25
    sharp_s: Annotated[
        float, measured("s", "Longest span of a front that stands alone; 0: none does.", ge=0)
    ] = 0.0


@dataclass(frozen=True, slots=True)
class RefractoryExceptSharp:
    """A minimum time since the last impact that passed, from which sharp ones are spared."""

    parameter: str = "refractory_s"
    name: str = "refractory"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the time since the last one that passed [s]; inf where sharp or the first."""
        last = carry.last_ns.setdefault(self.name, {})
        sharp = candidates.value[:, [c.name for c in columns].index("sharp")] > 0
        out = np.full(len(candidates), np.inf)
        for row, time_ns in enumerate(candidates.time_ns.tolist()):
            channel = int(candidates.channel[row])
            if channel in last and not sharp[row]:
                out[row] = (time_ns - last[channel]) / NS_PER_S
            if alive[row] and out[row] >= threshold:
                last[channel] = time_ns
        return out


@dataclass(slots=True)
class _Group:
    """Picks that belong together; ``sharp`` ones take in no others."""

    first_ns: int
    last_ns: int
    channels: set[str]
    sharp: bool = False

    def row(self) -> tuple[float, ...]:
        """Return the columns."""
        return len(self.channels), (self.last_ns - self.first_ns) / NS_PER_S, self.sharp


@dataclass(slots=True)
class _State:
    """The front under way, and the groups before it that wait for their window to be over."""

    front: _Group | None = None
    groups: list[_Group] = field(default_factory=list)


class Coincidence(Stage):
    """An impact begins with a pick and takes in all picks of the window that follows it."""

    Parameters = CoincidenceParameters
    takes = (Input(Pick),)
    gives = (StepEvent,)
    ends_at = "clock step"
    columns = (Quantity("channels", "1"), Quantity("span", "s"), Quantity("sharp", "1"))
    gates = (Level("channels", "1", "min_channels"), RefractoryExceptSharp())

    def __init__(self, parameters: CoincidenceParameters) -> None:
        self.parameters = parameters
        self.state = _State()
        self._channels = 0
        self._most = 0
        self._window_ns = parameters.window_s * NS_PER_S
        self._sharp_ns = parameters.sharp_s * NS_PER_S

    @property
    def memory(self) -> Memory:
        """Of groups and of impacts that follow each other without a rest; and the window."""
        p = self.parameters
        return Memory(CHAINED * (p.window_s + p.refractory_s), p.window_s + p.sharp_s)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin; an impact is not of one channel."""
        self.state = _State()
        self._channels = len(context.source.channels)
        self._most = ceil(MOST * self._channels)
        return ("all",)

    def reach(self) -> dict[str, Reach]:
        """Return how many channels can see an impact: those that are picked."""
        return {"channels": Reach(self._channels, "the channels that are picked")}

    def process(self, pick: Pick) -> tuple[Candidates, ...]:
        """Take a pick; give the groups before it whose window is over."""
        state, time_ns = self.state, pick.time_ns
        front, groups = state.front, state.groups
        if front is not None:
            if time_ns - front.last_ns <= self._sharp_ns:
                front.last_ns = time_ns
                front.channels.add(pick.channel)
                return ()
            self._close(front)
        state.front = _Group(time_ns, time_ns, {pick.channel})
        if not groups or time_ns - groups[0].first_ns <= self._window_ns:
            return ()
        over = [group for group in groups if time_ns - group.first_ns > self._window_ns]
        state.groups = groups[len(over) :]
        return (self._candidates(over),)

    def flush(self) -> tuple[Candidates]:
        """Give the groups under way."""
        if self.state.front:
            self._close(self.state.front)
        state, self.state = self.state, _State()
        return (self._candidates(state.groups),)

    def _close(self, front: _Group) -> None:
        """Let a sharp front that nearly all channels saw stand alone, and join the others."""
        groups = self.state.groups
        short = self._sharp_ns > 0 and front.last_ns - front.first_ns <= self._sharp_ns
        front.sharp = short and len(front.channels) >= self._most
        last = groups[-1] if groups and not front.sharp else None
        if last is None or last.sharp or front.first_ns - last.first_ns > self._window_ns:
            groups.append(front)
        else:
            last.last_ns = front.last_ns
            last.channels |= front.channels

    def _candidates(self, groups: Sequence[_Group]) -> Candidates:
        if not groups:
            return NOTHING
        return Candidates(
            np.array([group.first_ns for group in groups], np.int64),
            np.zeros(len(groups), np.int32),
            np.array([group.row() for group in groups], np.float32).reshape(-1, len(self.columns)),
        )
