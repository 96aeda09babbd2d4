"""Coincidence: picks of several channels close in time are one impact.

Source: the association that the thesis on footstep localisation presumes between detection
(section 3.4) and localisation (chapter 5). The order of the gates is coincidence, refractory time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Candidates, Level, Refractory
from ..parameters import gate, measured

if TYPE_CHECKING:
    from groundtrace_codecs.events import Pick, StageSpec

    from ..detector import Emits


@dataclass(frozen=True, slots=True)
class CoincidenceParameters:
    """Parameters of :class:`Coincidence`."""

    window_s: Annotated[float, measured("s", "Longest time between picks of an impact.", gt=0)] = (
        0.05
    )
    min_channels: Annotated[int, gate("1", "Least number of channels that saw it.", ge=1)] = 4
    refractory_s: Annotated[float, gate("s", "Least time between two impacts.", ge=0)] = 0.25


@dataclass(slots=True)
class _State:
    first_ns: int = 0
    last_ns: int = 0
    channels: set[str] = field(default_factory=set)


class Coincidence:
    """An impact begins with a pick and takes in all picks of the window that follows it."""

    Parameters = CoincidenceParameters
    emits: Emits = "step"
    columns = (Quantity("channels", "1"), Quantity("span", "s"))
    gates = (Level("channels", "1", "min_channels"), Refractory())

    def __init__(self, parameters: CoincidenceParameters) -> None:
        self.parameters = parameters
        self.state = _State()

    def start(self, spec: StageSpec) -> tuple[str, ...]:  # noqa: ARG002
        """Begin; an impact is not of one channel."""
        self.state = _State()
        return ("all",)

    def associate(self, pick: Pick) -> Candidates:
        """Take a pick; return the group before it once the window is over."""
        state = self.state
        if state.channels and pick.time_ns - state.first_ns <= self.parameters.window_s * NS_PER_S:
            state.channels.add(pick.channel)
            state.last_ns = pick.time_ns
            return Candidates.empty(len(self.columns))
        group = self.finish()
        self.state = _State(pick.time_ns, pick.time_ns, {pick.channel})
        return group

    def finish(self) -> Candidates:
        """Return the group under way."""
        state, self.state = self.state, _State()
        if not state.channels:
            return Candidates.empty(len(self.columns))
        value = [len(state.channels), (state.last_ns - state.first_ns) / NS_PER_S]
        return Candidates(
            np.array([state.first_ns], np.int64),
            np.zeros(1, np.int32),
            np.array([value], np.float32),
        )
