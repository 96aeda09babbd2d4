"""Gates and ``decide``: the one pure function that turns candidates into decisions.

Replay, explanation, sweep and comparison all call :func:`decide`; nothing else decides. A gate is
a threshold on a value; every gate's value and signed margin is computed for every candidate, also
behind a gate that already failed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from groundtrace_codecs.events import CandidateBlock, GateSpec, readable
from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity, StageSpec


#: Part by which a threshold must lie over what is reached: values are float32, and what they reach
#: may have been sought on a grid. Chosen by judgement: over float32's rounding and a grid's step,
#: under what people set.
_REACHED = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """What a stage measured: columns, in the order of (time, channel).

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    channel
        Shape (n,), int32.
    value
        Shape (n, n_columns), float32; the columns a detector declares.
    """

    time_ns: NDArray[np.int64]
    channel: NDArray[np.int32]
    value: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.time_ns)

    @classmethod
    def empty(cls, columns: int) -> Candidates:
        """Return no candidates, with ``columns`` columns."""
        return cls(np.empty(0, np.int64), np.empty(0, np.int32), np.empty((0, columns), np.float32))

    @classmethod
    def concatenate(cls, parts: Sequence[Candidates]) -> Candidates:
        """Return all rows of ``parts`` (at least one), one after the other."""
        return cls(
            np.concatenate([p.time_ns for p in parts]),
            np.concatenate([p.channel for p in parts]),
            np.concatenate([p.value for p in parts]),
        )

    def rows(self, index: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Candidates:
        """Return some of the rows."""
        return Candidates(self.time_ns[index], self.channel[index], self.value[index])

    def not_before(self, start_ns: int) -> Candidates:
        """Return the same, those of a time before ``start_ns`` at that time."""
        if not (self.time_ns < start_ns).any():
            return self
        time_ns = np.maximum(self.time_ns, start_ns)
        order = np.lexsort((self.channel, time_ns))
        return Candidates(time_ns[order], self.channel[order], self.value[order])


@dataclass(frozen=True, slots=True)
class Reach:
    """The most that a gate's value can be, whatever the signal.

    Attributes
    ----------
    most
        In the gate's unit.
    why
        What bounds it, for people.
    """

    most: float
    why: str


def never_passed(
    topic: str, stage: str, gates: Sequence[GateSpec], reach: Mapping[str, Reach]
) -> list[str]:
    """Return a line for each gate of a stage whose threshold no candidate can reach.

    Parameters
    ----------
    topic, stage
        Where, and which.
    gates
        As they stand.
    reach
        What the values of gates can reach, by the gate's name.
    """
    return [
        f"{topic}: {stage} accepts nothing: {gate.parameter} is {readable(gate.threshold)}, "
        f"but {gate.name} reaches {readable(reach[gate.name].most)} at most "
        f"({reach[gate.name].why})"
        for gate in gates
        if gate.at_least
        and gate.name in reach
        and gate.threshold > reach[gate.name].most + _REACHED * abs(reach[gate.name].most)
    ]


@dataclass(slots=True)
class GateState:
    """What a decision leaves behind for the candidates after it: last accepted time by channel."""

    last_ns: dict[str, dict[int, int]] = field(default_factory=dict)

    def copy(self) -> GateState:
        """Return an independent copy."""
        return GateState({gate: dict(times) for gate, times in self.last_ns.items()})


class Gate(Protocol):
    """A threshold on a value of each candidate."""

    @property
    def name(self) -> str:
        """Unique name among the detector's gates."""

    @property
    def unit(self) -> str:
        """Unit of the value and the threshold."""

    @property
    def parameter(self) -> str:
        """Name of the parameter that holds the threshold."""

    @property
    def at_least(self) -> bool:
        """Whether the value must be at least the threshold, or at most."""

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the value of every candidate, shape (n,); may write to ``carry``."""


@dataclass(frozen=True, slots=True)
class Level:
    """A threshold on a measured column of the same name."""

    name: str
    unit: str
    parameter: str
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],  # noqa: ARG002
        threshold: float,  # noqa: ARG002
        carry: GateState,  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Return the measured column."""
        column = [c.name for c in columns].index(self.name)
        return candidates.value[:, column].astype(np.float64)


@dataclass(frozen=True, slots=True)
class Refractory:
    """A minimum time since the last candidate that passed this gate, per channel."""

    parameter: str = "refractory_s"
    name: str = "refractory"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],  # noqa: ARG002
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the time since the last one that passed [s]; inf where there was none."""
        last = carry.last_ns.setdefault(self.name, {})
        if not len(candidates):
            return np.empty(0)
        since_s = []
        rows = (candidates.time_ns.tolist(), candidates.channel.tolist(), alive.tolist())
        for time_ns, channel, is_alive in zip(*rows, strict=True):
            over_s = (time_ns - last[channel]) / NS_PER_S if channel in last else np.inf
            since_s.append(over_s)
            if is_alive and over_s >= threshold:
                last[channel] = time_ns
        return np.array(since_s)


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """Verdicts on candidates.

    Attributes
    ----------
    gate_value
        Shape (n, n_gates), float32: what each gate looked at.
    margin
        Shape (n, n_gates), float32: signed distance to the threshold; >= 0 passes, NaN fails.
    accepted
        Shape (n,), bool: passed every gate.
    """

    gate_value: NDArray[np.float32]
    margin: NDArray[np.float32]
    accepted: NDArray[np.bool_]


def decide(
    candidates: Candidates,
    columns: Sequence[Quantity],
    gates: Sequence[Gate],
    parameters: object,
    carry: GateState | None = None,
) -> tuple[Decisions, GateState]:
    """Apply all gates in order.

    Parameters
    ----------
    candidates
        In the order of (time, channel); later calls continue where earlier ones ended.
    columns
        What the candidates' columns are.
    gates
        In order; a stateful gate looks only at candidates that passed all gates before it.
    parameters
        Object whose attributes hold the thresholds.
    carry
        What the decision before this one left behind, or None at the start of a run.

    Returns
    -------
    Decisions and what to carry on. Deciding in parts equals deciding at once.
    """
    carry = GateState() if carry is None else carry.copy()
    n = len(candidates)
    alive = np.empty(n, np.bool_)
    alive.fill(True)
    value = np.empty((n, len(gates)), np.float32)
    margin = np.empty((n, len(gates)), np.float32)
    for column, gate in enumerate(gates):
        threshold = float(getattr(parameters, gate.parameter))
        seen = gate.values(candidates, columns, alive, threshold, carry)
        distance = seen - threshold if gate.at_least else threshold - seen
        value[:, column], margin[:, column] = seen, distance
        alive = alive & (distance >= 0.0)
    return Decisions(value, margin, alive), carry


def decided_block(
    spec: StageSpec,
    candidates: Candidates,
    kind: Any,
    parameters: object,
    carry: GateState | None = None,
) -> tuple[CandidateBlock, GateState]:
    """Decide the candidates of one stage and topic, and put the verdicts beside them.

    Parameters
    ----------
    spec
        Of the stage, for the block.
    kind
        A plugin, or its class: what has ``gates``.
    candidates, parameters, carry
        As :func:`decide` takes them.
    """
    gates = stated(kind.gates, spec)
    decisions, carry = decide(candidates, spec.columns, gates, parameters, carry)
    block = CandidateBlock(
        spec,
        candidates.time_ns,
        candidates.channel,
        candidates.value,
        decisions.gate_value,
        decisions.margin,
        decisions.accepted,
    )
    return block, carry


def stated(gates: Sequence[Gate], spec: StageSpec) -> tuple[Gate, ...]:
    """Return those of a stage's gates that decide where a spec is stated.

    A stage that decides in one of several ways, by what it finds, has the gates of all of them.
    """
    names = {gate.name for gate in spec.gates}
    return tuple(gate for gate in gates if gate.name in names)


def gate_specs(gates: Sequence[Gate], parameters: object) -> tuple[GateSpec, ...]:
    """Return the gates with their thresholds as they stand in a run."""
    return tuple(
        GateSpec(g.name, g.unit, g.parameter, float(getattr(parameters, g.parameter)), g.at_least)
        for g in gates
    )
