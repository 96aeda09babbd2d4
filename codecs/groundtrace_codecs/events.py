"""Events: what stages report about the signal. Single events are objects, candidates are columns.

All kinds of single events stand in one table, :data:`EVENTS`. A new kind needs a class and a row
here and a message in ``groundtrace.proto``: it is then written, read, shown in the log, exported
and counted. A view and a scorer make it complete.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from dataclasses import dataclass, replace
from itertools import repeat
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from .signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Fix:
    """A place found for one moment.

    Attributes
    ----------
    time_ns, x_m, y_m
        When and where.
    covariance
        (xx, xy, yy) of the place [m^2]; NaN where unknown.
    residual
        What the method leaves unexplained, in its own unit; NaN where it has none.
    method, picks, stage
        How it was found, from how many arrivals, and the stage that found it.
    doubted
        Whether the residuals of the last places contradict what the method presumes of waves; no
        tracker takes it then.
    """

    time_ns: int
    x_m: float
    y_m: float
    covariance: tuple[float, float, float]
    residual: float
    method: str
    picks: int
    stage: str
    doubted: bool = False


#: What the name of a stage gets appended for its smoothed tracks.
SMOOTHED = ".smoothed"


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """Where a tracked target is at one moment.

    Attributes
    ----------
    time_ns, track
        When, and the number of the track.
    x_m, y_m, vx_mps, vy_mps, covariance
        Place, velocity, and (xx, xy, yy) of the place [m^2]; NaN where unknown.
    stage
        The stage that tracks.
    nis
        Normalised innovation squared of the update (2 degrees of freedom); NaN without an update.
    """

    time_ns: int
    track: int
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    covariance: tuple[float, float, float]
    stage: str
    nis: float = float("nan")


@dataclass(frozen=True, slots=True)
class Heading:
    """A direction [rad] and its standard deviation [rad; NaN where unknown] at one moment."""

    time_ns: int
    heading_rad: float
    sigma_rad: float
    stage: str


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A half-open span [ns] in which a sensor is disturbed; ``value`` says how much."""

    time_ns: int
    end_ns: int
    value: float
    stage: str


@dataclass(frozen=True, slots=True)
class Bearing:
    """The direction that a wave came from, at one station.

    Attributes
    ----------
    time_ns, station
        When, and the name of the station of three axes.
    azimuth_rad
        From the station towards the source, counter-clockwise from x [rad].
    sigma_rad
        One standard deviation [rad]; NaN where unknown.
    value
        What the method's decision rests on, e.g. the degree of polarisation.
    ambiguous
        True where the direction is an axis: the source may as well lie at ``azimuth_rad + pi``.
    stage
        The stage that found it.
    """

    time_ns: int
    station: str
    azimuth_rad: float
    sigma_rad: float
    value: float
    ambiguous: bool
    stage: str


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Localizers that place one step apart.

    Attributes
    ----------
    time_ns
        The step's.
    distance_m
        Between the two places that are farthest apart for their uncertainty [m].
    value
        That distance in standard deviations.
    methods
        The two stages, as ``one, other``.
    stage
        The stage that compares.
    """

    time_ns: int
    distance_m: float
    value: float
    methods: str
    stage: str


#: The moment that a recorder took for a shot's: recorded, so stages that ask for it are told.
TRIGGER = "trigger"
#: Kinds a truth table may hold; ``walking``, ``ignore``, ``count`` and ``idle`` (movement that is
#: no walking) are spans; ``trailing`` is the second contact of a side step, no step of its own;
#: ``trigger`` is no truth: see :data:`TRIGGER`.
TRUTH_KINDS = frozenset(
    {
        "step",
        "count",
        "walking",
        "ignore",
        "waypoint",
        "impact",
        "pick",
        "heading",
        "disturbed",
        "pass",
        "trailing",
        "idle",
        TRIGGER,
    }
)
#: Kinds a person may mark. ``missed`` is a step that a detector missed, ``false`` a detection where
#: there was none, ``span`` a span with a word of its own.
MOMENT_KINDS = frozenset({"missed", "false", "step", "pick", "note"})
SPAN_KINDS = frozenset({"walking", "ignore", "disturbed", "pass", "span"})
ANNOTATION_KINDS = MOMENT_KINDS | SPAN_KINDS
LABEL_KINDS = TRUTH_KINDS | ANNOTATION_KINDS

#: Author of labels that were computed from what was simulated, not read off a recording.
SIMULATOR = "simulator"


@dataclass(frozen=True, slots=True, order=True)
class Label:
    """One labelled moment or span.

    Attributes
    ----------
    time_ns
        Moment, or start of the span [ns, on the recording's clock].
    kind
        One of :data:`TRUTH_KINDS` or of :data:`ANNOTATION_KINDS`.
    end_ns
        End of a half-open span [ns], or None for a moment.
    x_m, y_m
        Place [m], or None.
    value
        Count, heading [rad], speed, ... as the kind has it, or None.
    channel
        Channel concerned, for picks.
    label
        Detail: ``left``, ``right``, ``forward``, ...
    author
        Who or what labelled.
    note
        Free text.
    target
        Which of several targets, e.g. which of two walkers; empty where there is one.
    """

    time_ns: int
    kind: str
    end_ns: int | None = None
    x_m: float | None = None
    y_m: float | None = None
    value: float | None = None
    channel: str = ""
    label: str = ""
    author: str = ""
    note: str = ""
    target: str = ""

    def within(self, start_ns: int, stop_ns: int) -> Label | None:
        """Return the label as it holds in a half-open span; None where nothing of it does.

        A span is cut. A count is not told of a part of its span, so one that would be cut is left
        out.
        """
        if self.end_ns is None:
            return self if start_ns <= self.time_ns < stop_ns else None
        first_ns, end_ns = max(self.time_ns, start_ns), min(self.end_ns, stop_ns)
        if (first_ns, end_ns) == (self.time_ns, self.end_ns):
            return self
        if first_ns >= end_ns or self.kind == "count":
            return None
        return replace(self, time_ns=first_ns, end_ns=end_ns)

    def later(self, by_ns: int) -> Label:
        """Return the same label ``by_ns`` later."""
        end_ns = None if self.end_ns is None else self.end_ns + by_ns
        return replace(self, time_ns=self.time_ns + by_ns, end_ns=end_ns)


def has_vehicles(labels: Iterable[Label]) -> bool:
    """Return whether truth has vehicles: they pass stations, and steps have no places."""
    return any(x.kind == "pass" for x in labels)


def as_truth(label: Label) -> Label:
    """Return what an annotation says as truth: ``missed`` is a step, others are what they are.

    ``false``, ``note`` and ``span`` are no truth of anything; whoever scores leaves them out.
    """
    return replace(label, kind="step") if label.kind == "missed" else label


#: Labels of two files that say the same within this time are said once [ns].
SAME_NS = NS_PER_S // 10


class PreviousLabels:
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


#: A quantised surface has this many levels above its lowest.
LEVELS = 255


@dataclass(frozen=True, slots=True)
class Presence:
    """A half-open span [ns] in which a channel hears a vehicle; told when the span has ended.

    Attributes
    ----------
    time_ns, end_ns
        From the first cycle that passed all gates to the end of the last.
    channel, topic, stage
        Where it is heard, and the stage that says so.
    value
        Greatest peak of the stage's decision function in the span.
    """

    time_ns: int
    end_ns: int
    channel: str
    topic: str
    stage: str
    value: float


@dataclass(frozen=True, slots=True)
class Pass:
    """A vehicle passes a station: the moment at which it is nearest, by the power.

    Attributes
    ----------
    time_ns, sigma_s
        When, and its standard deviation [s].
    station
        Name of the station.
    vehicle
        Number of the vehicle, the same at all stations; 0 where it was heard at one alone.
    direction
        ``forward`` or ``backward`` along the road; empty where unknown.
    speed_mps, speed_sigma_mps
        Speed along the road and its standard deviation [m/s]; NaN where unknown.
    half_width_s
        Distance of the lane over speed [s].
    value
        Peak of the power over the noise [dB].
    stage
        The stage that found it.
    """

    time_ns: int
    sigma_s: float
    station: str
    vehicle: int
    direction: str
    speed_mps: float
    speed_sigma_mps: float
    half_width_s: float
    value: float
    stage: str


@dataclass(frozen=True, slots=True)
class LineCrossing:
    """A tracked vehicle crosses a line.

    Attributes
    ----------
    time_ns, sigma_s
        When, and its standard deviation [s].
    track
        Number of the track.
    line
        What the line is: ``road``, ``line``, or the sensors at its ends, as ``A1-A3``.
    x_m, y_m
        Where [m].
    along_sigma_m
        Standard deviation of the place along the line [m].
    speed_mps, speed_sigma_mps
        Of the vehicle and its standard deviation [m/s].
    heading_rad
        Direction of its motion, counter-clockwise from x [rad].
    stage
        The stage that found it.
    """

    time_ns: int
    sigma_s: float
    track: int
    line: str
    x_m: float
    y_m: float
    along_sigma_m: float
    speed_mps: float
    speed_sigma_mps: float
    heading_rad: float
    stage: str


@dataclass(frozen=True, slots=True)
class LikelihoodSurface:
    """The log-likelihood of a place over a lattice, in one cycle, as an image.

    Attributes
    ----------
    time_ns
        Middle of the cycle.
    x_m, y_m
        Node of the first column and first row [m].
    step_m
        Between nodes [m].
    columns, rows
        Numbers of nodes along x and along y.
    lowest, highest
        Log-likelihood of the levels 0, which stands for all below as well, and 255.
    levels
        One byte per node, row after row from the least y.
    stage
        The stage that located.

    Raises
    ------
    ValueError
        Where there is not one level for each node.
    """

    time_ns: int
    x_m: float
    y_m: float
    step_m: float
    columns: int
    rows: int
    lowest: float
    highest: float
    levels: bytes
    stage: str

    def __post_init__(self) -> None:
        if len(self.levels) != self.columns * self.rows:
            raise ValueError(
                f"levels: expected {self.columns * self.rows} bytes, found {len(self.levels)}"
            )

    def values(self) -> NDArray[np.float64]:
        """Return the log-likelihood at the nodes, shape (rows, columns)."""
        levels = np.frombuffer(self.levels, np.uint8).reshape(self.rows, self.columns)
        values = self.lowest + (self.highest - self.lowest) / LEVELS * levels
        return np.asarray(values, np.float64)


def quantised(
    time_ns: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    values: NDArray[np.float64],
    stage: str,
    depth: float = 20.0,
) -> LikelihoodSurface:
    """Return a surface in 256 levels.

    Parameters
    ----------
    time_ns, stage
        As of the event.
    x, y
        Shapes (nx,) and (ny,): even coordinates [m].
    values
        Shape (ny, nx): log-likelihood.
    depth
        How far below the highest the lowest level is, at most.
    """
    highest = float(values.max())
    lowest = max(float(values.min()), highest - depth)
    scale = LEVELS / max(highest - lowest, 1e-300)
    levels = np.clip(np.round((values - lowest) * scale), 0, LEVELS).astype(np.uint8)
    return LikelihoodSurface(
        time_ns, float(x[0]), float(y[0]), float(x[1] - x[0]), len(x), len(y),
        lowest, highest, levels.tobytes(), stage,
    )  # fmt: skip


#: What is said of vehicles.
Traffic = Presence | Pass | LineCrossing | LikelihoodSurface


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

    @property
    def filled(self) -> bool:
        """Whether straight lines stand in the place of its samples."""
        return self.bridged and self.reason == "missing"

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
        Peak of the stage's decision function; the evidence of the type where there is one.
    channels
        How many channels saw it.
    type
        ``forward``, ``backward``, ``left``, ``right`` or ``unknown``; empty where nobody typed it.
    """

    time_ns: int
    kind: str
    foot: str
    topic: str
    stage: str
    value: float
    channels: int = 1
    type: str = ""

    @property
    def value_text(self) -> str:
        """What the value is, and the value; empty where it is none, or evidence of no type."""
        if not math.isfinite(self.value) or self.type == "unknown":
            return ""
        return f"{'evidence' if self.type else 'peak'} {readable(self.value, 3)}"


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


def readable(value: float, digits: int = 4, sign: str = "") -> str:
    """Return a number as people read it: without an exponent from a billionth to a billion.

    Parameters
    ----------
    value
        The number.
    digits
        How many of its digits are told; all of them before the point.
    sign
        ``+`` for a sign before numbers over zero, too.
    """
    text = f"{value:{sign}.{digits}g}"
    mantissa, separator, exponent = text.partition("e")
    if not separator:
        return text
    power = int(exponent)
    if not -9 <= power < 9:
        return f"{mantissa} × 10^{power}"
    if power > 0:
        return f"{value:{sign}.0f}"
    return f"{float(text):{sign}.{len(mantissa.partition('.')[2]) - power}f}"


def unit_after(unit: str) -> str:
    """Return a unit as it stands after a number: with a space; nothing for ``1`` and none."""
    return "" if unit in ("", "1") else f" {unit}"


def _no_text(event: object) -> str:  # noqa: ARG001
    return ""


def _step_text(step: StepEvent) -> str:
    kind = " ".join(filter(None, (step.kind, step.type, step.foot)))
    return f"{kind} value={readable(step.value)} channels={step.channels}"


def _pick_text(pick: Pick) -> str:
    return f"pick {pick.channel} value={readable(pick.value)}"


def _fix_text(fix: Fix) -> str:
    return f"fix x={fix.x_m:.3f} m y={fix.y_m:.3f} m {fix.method} picks={fix.picks}"


def _bearing_text(bearing: Bearing) -> str:
    return f"bearing {bearing.station} {math.degrees(bearing.azimuth_rad):.1f} degrees"


def _disturbance_text(span: Disturbance) -> str:
    return f"disturbed for {_seconds(span.time_ns, span.end_ns)} value={readable(span.value)}"


def _disagreement_text(disagreement: Disagreement) -> str:
    apart = f"{disagreement.distance_m:.3g} m apart, {readable(disagreement.value, 3)} sigma"
    return f"{disagreement.methods} are {apart}"


def _presence_text(span: Presence) -> str:
    seconds = _seconds(span.time_ns, span.end_ns)
    return f"vehicle heard at {span.channel} for {seconds} value={readable(span.value)}"


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
    has_sigma = "uncertainty" in names
    sigma = columns[names.index("uncertainty")] if has_sigma else repeat(math.nan)
    origin = repeat(spec.topic), repeat(spec.stage)
    return list(map(Pick, times, channels, *origin, sigma, columns[0]))


def _bearings(block: CandidateBlock) -> list[Event]:
    """Return a direction for each accepted candidate; its channel is the station."""
    spec, names = block.spec, [c.name for c in block.spec.columns]
    azimuth, sigma, ambiguous = map(names.index, ("azimuth", "sigma", "ambiguous"))
    bearings: list[Event] = []
    for row in block.accepted.nonzero()[0].tolist():
        value, station = block.value[row].tolist(), spec.channels[int(block.channel[row])]
        angle = (value[azimuth], value[sigma], value[0], bool(value[ambiguous]))
        bearings.append(Bearing(int(block.time_ns[row]), station, *angle, spec.stage))
    return bearings


def _disagreements(block: CandidateBlock) -> list[Event]:
    """Return two stages that disagree for each accepted candidate; its channel is the pair."""
    spec = block.spec
    disagreements: list[Event] = []
    for row in block.accepted.nonzero()[0].tolist():
        distance_m, value = block.value[row, :2].tolist()
        pair = spec.channels[int(block.channel[row])]
        disagreements.append(
            Disagreement(int(block.time_ns[row]), distance_m, value, pair, spec.stage)
        )
    return disagreements


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
