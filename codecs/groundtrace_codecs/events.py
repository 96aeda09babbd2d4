"""Events: what stages say about the signal. Single events are objects, candidates are columns.

All kinds of single events stand in one table, :data:`EVENTS`. A new kind is a class and a row here
and a message in ``groundtrace.proto``: it is then written, read, told in the log, exported and
counted. A view and a scorer make it complete.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from .estimates import Bearing, Disagreement, Disturbance, Fix, Heading, TrackPoint
from .signals import NS_PER_S
from .traffic import LikelihoodSurface, LineCrossing, Pass, Presence

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

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

    #: How loud its line in the log is, and whom it names.
    level: ClassVar[str] = "WARN"
    source: ClassVar[str] = "source"

    @property
    def time_ns(self) -> int:
        """Where it begins, as the time of every other event."""
        return self.start_ns


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


def no_events(block: CandidateBlock) -> Iterable[Event]:  # noqa: ARG001
    """Return nothing: what the accepted candidates stand for is told by the stage itself."""
    return ()


class EventKind(NamedTuple):
    """A row of the table of events; message, JSON and export columns follow from the dataclass.

    ``time_ns`` (of a gap ``start_ns``) and ``end_ns`` are the message's ``timestamp`` and ``end``;
    every other field bears its name in ``groundtrace.proto``. The message has the class's name.

    Attributes
    ----------
    cls
        The class of its events, a frozen dataclass.
    name
        What it is called in :class:`StageSpec`, in JSON and in lists.
    topic
        Where it is stored; the topic's last part is its name in exports, and of its counts.
    text
        One line for people, in the log of other viewers and in that of our own; "" of kinds that
        are curves and images, whose lines would bury what there is to read.
    truth
        Kind of label that it is scored against, ``waypoint`` for places of all kinds; empty where
        none is.
    from_candidates
        What the accepted candidates of a block stand for.
    """

    cls: type[Any]
    name: str
    topic: str
    text: Callable[[Any], str]
    truth: str = ""
    from_candidates: Callable[[CandidateBlock], Iterable[Event]] = no_events

    @property
    def plural(self) -> str:
        """What several are called: the name of a table, and of a count."""
        return self.topic.rpartition("/")[2]


def _no_text(event: object) -> str:  # noqa: ARG001
    return ""


def _step_text(step: StepEvent) -> str:
    kind = " ".join(filter(None, (step.kind, step.type, step.foot)))
    return f"{kind} value={step.value:.4g} channels={step.channels}"


def _pick_text(pick: Pick) -> str:
    return f"pick {pick.channel} value={pick.value:.4g}"


def _fix_text(fix: Fix) -> str:
    return f"fix x={fix.x_m:.3f} m y={fix.y_m:.3f} m {fix.method} picks={fix.picks}"


def _bearing_text(bearing: Bearing) -> str:
    return f"bearing {bearing.station} {math.degrees(bearing.azimuth_rad):.1f} degrees"


def _disturbance_text(span: Disturbance) -> str:
    return f"disturbed for {_seconds(span.time_ns, span.end_ns)} value={span.value:.4g}"


def _disagreement_text(found: Disagreement) -> str:
    return f"{found.methods} are {found.distance_m:.3g} m apart, {found.value:.3g} sigma"


def _presence_text(span: Presence) -> str:
    seconds = _seconds(span.time_ns, span.end_ns)
    return f"vehicle heard at {span.channel} for {seconds} value={span.value:.4g}"


def _pass_text(one: Pass) -> str:
    which = f"vehicle {one.vehicle} {one.direction} " if one.vehicle else ""
    return f"{which}passes {one.station} speed={one.speed_mps:.3g} m/s"


def _crossing_text(one: LineCrossing) -> str:
    return f"vehicle {one.track} crosses {one.line} at {one.x_m:.2f}, {one.y_m:.2f}"


def _gap_text(gap: Gap) -> str:
    seconds = _seconds(gap.start_ns, gap.end_ns)
    return f"gap {gap.topic} {gap.reason}: {gap.lost} lost in {seconds}"


def _note_text(note: Note) -> str:
    return note.text


def _seconds(start_ns: int, end_ns: int) -> str:
    return f"{(end_ns - start_ns) / NS_PER_S:.6g} s"


def _steps(block: CandidateBlock) -> list[Event]:
    """Return a step, or an impact where the stage gives those, for each accepted candidate."""
    rows = block.accepted.nonzero()[0]
    if not len(rows):
        return []
    spec, times = block.spec, block.time_ns[rows].tolist()
    names, columns = [c.name for c in spec.columns], block.value[rows].T.tolist()
    count = map(int, columns[names.index("channels")]) if "channels" in names else repeat(1)
    origin = repeat(spec.emits), repeat(""), repeat(spec.topic), repeat(spec.stage)
    return list(map(StepEvent, times, *origin, columns[0], count))


def _picks(block: CandidateBlock) -> list[Event]:
    """Return an arrival for each accepted candidate."""
    rows = block.accepted.nonzero()[0]
    if not len(rows):
        return []
    spec, times = block.spec, block.time_ns[rows].tolist()
    names, columns = [c.name for c in spec.columns], block.value[rows].T.tolist()
    channels = [spec.channels[channel] for channel in block.channel[rows].tolist()]
    known = "uncertainty" in names
    sigma = columns[names.index("uncertainty")] if known else repeat(math.nan)
    origin = repeat(spec.topic), repeat(spec.stage)
    return list(map(Pick, times, channels, *origin, sigma, columns[0]))


def _bearings(block: CandidateBlock) -> list[Event]:
    """Return a direction for each accepted candidate; its channel is the station."""
    spec, names = block.spec, [c.name for c in block.spec.columns]
    azimuth, sigma, ambiguous = map(names.index, ("azimuth", "sigma", "ambiguous"))
    found: list[Event] = []
    for row in block.accepted.nonzero()[0].tolist():
        value, station = block.value[row].tolist(), spec.channels[int(block.channel[row])]
        angle = (value[azimuth], value[sigma], value[0], bool(value[ambiguous]))
        found.append(Bearing(int(block.time_ns[row]), station, *angle, spec.stage))
    return found


def _disagreements(block: CandidateBlock) -> list[Event]:
    """Return two stages that disagree for each accepted candidate; its channel is the pair."""
    spec = block.spec
    found: list[Event] = []
    for row in block.accepted.nonzero()[0].tolist():
        distance_m, value = block.value[row, :2].tolist()
        pair = spec.channels[int(block.channel[row])]
        found.append(Disagreement(int(block.time_ns[row]), distance_m, value, pair, spec.stage))
    return found


def _row(
    cls: type[Any],
    name: str,
    plural: str,
    text: Callable[[Any], str],
    truth: str = "",
    from_candidates: Callable[[CandidateBlock], Iterable[Event]] = no_events,
) -> EventKind:
    return EventKind(cls, name, f"/groundtrace/{plural}", text, truth, from_candidates)


_ROWS = (
    _row(StepEvent, "step", "steps", _step_text, "step", _steps),
    _row(Pick, "pick", "picks", _pick_text, "pick", _picks),
    _row(Fix, "fix", "fixes", _fix_text, "waypoint"),
    _row(TrackPoint, "track", "tracks", _no_text, "waypoint"),
    _row(Bearing, "bearing", "bearings", _bearing_text, "", _bearings),
    _row(Heading, "heading", "headings", _no_text, "heading"),
    _row(Disturbance, "disturbance", "disturbances", _disturbance_text, "disturbed"),
    _row(Disagreement, "disagreement", "disagreements", _disagreement_text, "", _disagreements),
    _row(Presence, "presence", "presence", _presence_text),
    _row(Pass, "pass", "passes", _pass_text, "pass"),
    _row(LineCrossing, "crossing", "crossings", _crossing_text),
    _row(LikelihoodSurface, "surface", "surfaces", _no_text),
    _row(Gap, "gap", "gaps", _gap_text),
    _row(Note, "note", "notes", _note_text),
)
#: The table of events, in the order in which they are listed.
EVENTS: Mapping[type[Any], EventKind] = {row.cls: row for row in _ROWS}


def kind_of_message(name: str) -> EventKind | None:
    """Return the kind whose message has a name, as ``Pick``; None where none has."""
    return next((kind for cls, kind in EVENTS.items() if cls.__name__ == name), None)


def kind_emitted(emits: str) -> EventKind | None:
    """Return the kind that a stage says it emits; an ``impact`` is a step by another name."""
    name = "step" if emits == "impact" else emits
    return next((kind for kind in EVENTS.values() if kind.name == name), None)


__all__ = [
    "EVENTS",
    "Bearing",
    "CandidateBlock",
    "Disagreement",
    "Disturbance",
    "Event",
    "EventKind",
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
    "kind_emitted",
    "kind_of_message",
    "no_events",
]
