"""First breaks: of all picks of a shot, the one per channel that a travel-time curve goes through.

Along a line of geophones the arrival time changes little from channel to channel. Picks of noise,
of the air wave or of later phases do not keep to that. Each pick brings the evidence of its ratio,
each jump in time between successive channels costs; the best path through the picks, in the order
of the channels, is found by dynamic programming forwards and backwards, which gives for every pick
how much worse the best path through it is: its deficit. Source: ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import NS_PER_S

from ..pipeline.gates import Candidates, Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Input, Stage

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class FirstBreakParameters:
    """Parameters of :class:`FirstBreaks`."""

    window_s: Annotated[float, measured("s", "Time in which a shot shows itself.", gt=0)] = 0.06
    quorum: Annotated[int, measured("1", "Channels with a pick in it that are a shot.", ge=1)] = 8
    event_s: Annotated[float, measured("s", "Longest travel-time difference.", gt=0)] = 0.15
    evidence: Annotated[float, measured("1", "Largest evidence of one pick.", gt=0)] = 6.0
    lateness: Annotated[float, measured("1/s", "Cost of coming later in the shot.", ge=0)] = 6.0
    jump: Annotated[float, measured("1/s", "Cost of a jump between channels.", ge=0)] = 125.0
    jump_s: Annotated[float, measured("s", "Jump from which the cost stays the same.", gt=0)] = 0.04
    deficit: Annotated[float, gate("1", "Largest loss against the best path.", ge=0)] = 0.001
    refractory_s: Annotated[float, gate("s", "Least time between two shots.", ge=0)] = 0.5


@dataclass(slots=True)
class _State:
    channels: dict[str, int] = field(default_factory=dict)
    threshold: float = 1.0
    pending: list[Pick] = field(default_factory=list)


class FirstBreaks(Stage):
    """A shot is a quorum of channels with picks close in time; one path runs through its picks."""

    Parameters = FirstBreakParameters
    takes = (Input(Pick),)
    gives = (Pick,)
    ends_at = "clock step"
    columns = (
        Quantity("ratio", "1"),
        Quantity("deficit", "1"),
        Quantity("channels", "1"),
        Quantity("uncertainty", "s"),
    )
    gates = (Level("deficit", "1", "deficit", at_least=False), Refractory())

    def __init__(self, parameters: FirstBreakParameters) -> None:
        self.parameters = parameters
        self.state = _State()

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with the channels of the picking stage, in the order of the line."""
        spec = context.source
        self.state = _State({name: i for i, name in enumerate(spec.channels)})
        level = next((g for g in spec.gates if g.name == spec.columns[0].name), None)
        self.state.threshold = level.threshold if level is not None and level.threshold > 0 else 1.0
        return spec.channels

    def process(self, pick: Pick) -> list[Candidates]:
        """Take a pick; give those whose shot is complete by now."""
        state, event_ns = self.state, self.parameters.event_s * NS_PER_S
        found = []
        while state.pending and pick.time_ns > state.pending[0].time_ns + event_ns:
            found.append(self._resolve())
        state.pending.append(pick)
        return [Candidates.concatenate(found)] if found else []

    def flush(self) -> list[Candidates]:
        """Give the picks under way."""
        found = []
        while self.state.pending:
            found.append(self._resolve())
        return [Candidates.concatenate(found)] if found else []

    def _resolve(self) -> Candidates:
        """Take the shot that begins with the first pending pick, or that pick alone."""
        pending = self.state.pending
        times = np.array([p.time_ns for p in pending], np.int64)
        since = (times - times[0]) / NS_PER_S
        close = {
            p.channel for p, s in zip(pending, since, strict=True) if s <= self.parameters.window_s
        }
        quorum = min(self.parameters.quorum, len(self.state.channels))
        count = int((since <= self.parameters.event_s).sum()) if len(close) >= quorum else 1
        picks, self.state.pending = pending[:count], pending[count:]
        channel = np.array([self.state.channels[p.channel] for p in picks], np.int32)
        ratio = np.array([p.value for p in picks])
        if len(close) >= quorum:
            deficit = self._deficits(since[:count], channel, ratio)
        else:
            deficit = np.full(count, np.inf)
        spread = [p.uncertainty_s for p in picks]
        value = np.column_stack([ratio, deficit, np.full(count, len(close)), spread])
        return Candidates(times[:count], channel, value.astype(np.float32))

    def _deficits(
        self, since_s: NDArray[np.float64], channel: NDArray[np.int32], ratio: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how much worse the best path through each pick is than the best path of all."""
        p = self.parameters
        own = np.minimum(np.log(np.maximum(ratio / self.state.threshold, 1e-6)), p.evidence)
        own = own - p.lateness * since_s
        cost = p.jump * np.minimum(np.abs(since_s[:, None] - since_s[None, :]), p.jump_s)
        forward = _best_paths(own, cost, channel)
        backward = _best_paths(own, cost, -channel)
        through = forward + backward - own
        return np.asarray(through.max() - through)


def _best_paths(
    own: NDArray[np.float64], cost: NDArray[np.float64], rank: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Return the score of the best path that ends at each node and rises in rank."""
    score = own.copy()
    for node in np.argsort(rank, kind="stable"):
        lower = rank < rank[node]
        if lower.any():
            score[node] += max(0.0, float((score[lower] - cost[node, lower]).max()))
    return score
