"""Events: what stages say about the signal. Single events are objects, candidates are columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .estimates import Bearing, Disagreement, Disturbance, Fix, Heading, TrackPoint
from .traffic import LikelihoodSurface, LineCrossing, Pass, Presence

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Gap:
    """An interruption of a stream.

    Attributes
    ----------
    topic
        The stream concerned; empty where damage hides which.
    start_ns, end_ns
        Half-open span without samples; equal where the clock stepped back.
    reason
        ``missing`` (samples never recorded), ``clock step``, ``duplicate`` or ``damage``.
    lost
        How many samples (for damage: messages) are missing.
    bridged
        True where stages keep their state across it.
    """

    topic: str
    start_ns: int
    end_ns: int
    reason: str
    lost: int
    bridged: bool = False


@dataclass(frozen=True, slots=True)
class Note:
    """A line of text at a time: what a stage wants a person to read.

    ``level`` is ``DEBUG``, ``INFO``, ``WARN`` or ``ERROR``.
    """

    time_ns: int
    text: str
    level: str = "INFO"
    source: str = ""


@dataclass(frozen=True, slots=True)
class Pick:
    """The arrival of a wave at one channel.

    Attributes
    ----------
    time_ns
        Onset [ns].
    channel
        Name of the channel.
    topic, stage
        Stream picked and stage that picked.
    uncertainty_s
        One standard deviation of the onset [s]; NaN where unknown.
    value
        Peak of the stage's decision function.
    """

    time_ns: int
    channel: str
    topic: str
    stage: str
    uncertainty_s: float
    value: float


@dataclass(frozen=True, slots=True)
class StepEvent:
    """One step or impact.

    Attributes
    ----------
    time_ns
        Initial contact [ns].
    kind
        ``step`` or ``impact``.
    foot
        ``left``, ``right`` or empty.
    topic, stage
        Stream and stage it comes from.
    value
        Peak of the stage's decision function.
    channels
        How many channels saw it.
    type
        ``forward``, ``backward``, ``left`` or ``right``; empty where unknown.
    """

    time_ns: int
    kind: str
    foot: str
    topic: str
    stage: str
    value: float
    channels: int = 1
    type: str = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Name and unit of a measured column."""

    name: str
    unit: str


@dataclass(frozen=True, slots=True)
class GateSpec:
    """One gate as it stood in a run.

    Attributes
    ----------
    name, unit
        Of the value the gate looks at.
    parameter
        The stage's parameter that holds the threshold.
    threshold
        Its value in this run.
    at_least
        True: passes where value >= threshold; False: where value <= threshold.
    """

    name: str
    unit: str
    parameter: str
    threshold: float
    at_least: bool = True


@dataclass(frozen=True, slots=True)
class StageSpec:
    """What the columns of a stage's candidates and trace mean; stated once per stage and topic.

    Attributes
    ----------
    stage, plugin
        Name of the stage in its pipeline, and what it runs.
    topic
        The stream it runs on.
    channels
        Names of the channels of its candidates and trace.
    columns, gates, trace
        The columns of candidates, the gates that decide them, the quantities of the trace.
    emits
        What an accepted candidate becomes: ``pick``, ``step``, ``impact``, ``fix``, ``track``,
        ``presence``, ``pass``, ...
    """

    stage: str
    plugin: str
    topic: str
    channels: tuple[str, ...]
    columns: tuple[Quantity, ...]
    gates: tuple[GateSpec, ...]
    trace: tuple[Quantity, ...]
    emits: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateBlock:
    """Candidates of one stage on one topic, decided; rejected ones are kept like accepted ones.

    Attributes
    ----------
    spec
        What the columns mean.
    time_ns
        Shape (n,), int64.
    channel
        Shape (n,), int32, index into ``spec.channels``.
    value
        Shape (n, n_columns), float32, as measured.
    gate_value
        Shape (n, n_gates), float32: what each gate looked at.
    margin
        Shape (n, n_gates), float32: signed distance to the threshold, >= 0 passes.
    accepted
        Shape (n,), bool.
    """

    spec: StageSpec
    time_ns: NDArray[np.int64]
    channel: NDArray[np.int32]
    value: NDArray[np.float32]
    gate_value: NDArray[np.float32]
    margin: NDArray[np.float32]
    accepted: NDArray[np.bool_]

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class TraceBlock:
    """Per channel and frame (50 ms): what the decision function and the signal reached.

    It answers "why was there no candidate": the frame's maximum of the decision function, the
    signal's peak and the noise level, whatever the thresholds.

    Attributes
    ----------
    spec
        ``spec.trace`` names the last axis.
    time_ns
        Shape (n,), int64: start of each frame.
    value
        Shape (n, n_channels, n_quantities), float32.
    """

    spec: StageSpec
    time_ns: NDArray[np.int64]
    value: NDArray[np.float32]

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])


#: Events of one time or span, stored as one message each.
SingleEvent = (
    Gap
    | Note
    | Pick
    | StepEvent
    | Fix
    | TrackPoint
    | Heading
    | Disturbance
    | Bearing
    | Disagreement
    | Presence
    | Pass
    | LineCrossing
    | LikelihoodSurface
)
Event = SingleEvent | StageSpec | CandidateBlock | TraceBlock

__all__ = [
    "Bearing",
    "CandidateBlock",
    "Disagreement",
    "Disturbance",
    "Event",
    "Fix",
    "Gap",
    "GateSpec",
    "Heading",
    "LikelihoodSurface",
    "LineCrossing",
    "Note",
    "Pass",
    "Pick",
    "Presence",
    "Quantity",
    "SingleEvent",
    "StageSpec",
    "StepEvent",
    "TraceBlock",
    "TrackPoint",
]
