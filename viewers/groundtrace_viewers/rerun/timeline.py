"""The one timeline every signal and event is logged on, and what all logs share.

That is colours, lanes, lines that grow, and the record of how the replay was made.

Each sensor has one colour everywhere. Colours can be told apart by colour-blind people, on a dark
background; they are ``0xRRGGBBAA`` integers, as the viewer stores them.

The viewer draws all rows of a line's past in every frame, so that a line with one row a segment
makes a long walk slow. Of a line on a map, the last seconds have a row a segment and older parts a
row every twenty seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace.errors import PipelineError, PluginError
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.parameters import build
from groundtrace.pipeline.plugins import stage_named
from groundtrace.pipeline.results import timeline_id
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from .legible import legible, log, send_columns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    import rerun as rr
    from numpy.typing import ArrayLike, NDArray
    from rerun import AsComponents

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace.pipeline.results import Results
    from groundtrace_codecs.events import StageSpec
    from groundtrace_codecs.signals import Channel, Stream

    #: A time [ns], and a place [m].
    Passed = tuple[int, tuple[float, float]]
    #: Points, shape (k, 2) [m].
    Line = NDArray[np.floating] | Sequence[tuple[float, float]]

#: Name of the timeline: time since the recording's first sample.
TIMELINE = "t"


@dataclass(frozen=True, slots=True)
class Entity:
    """Something logged that a layout may show.

    Attributes
    ----------
    path
        Entity path, e.g. ``/envelope/seismic``.
    role
        What it is, which chooses its view: ``envelope``, ``overview``, ``whole``, ``signal``,
        ``norm``, ``spectrogram``, ``tones``, ``section``, ``travel``, ``shot``, ``shots``,
        ``detector``, ``decision``, ``masses``, ``heading``, ``ratio``, ``road``, ``spectrum``,
        ``hodogram``, ``mark``, ``lane``, ``log``, ``wrong``, ``table``, ``page``, ``map``,
        ``card``, ``bars``, ``margins``, ``heading-error``, ``heading-gates``, ``dial``,
        ``rows``, ``waves``.
    title
        Heading of its view.
    series
        How many curves it has.
    rate_hz
        Sampling rate of a signal, else 0.
    quantity
        Quantity of a signal, else empty.
    top, bottom
        Ends of the value axis where the upper one is known, else 0.
    visible_s
        On a map, how long it is seen after its time [s]; 0 until the next takes its place, and
        infinite for ever.
    component
        Where its curves are; empty stands for the scalars that a plot looks for by itself.
    """

    path: str
    role: str
    title: str = ""
    series: int = 1
    rate_hz: float = 0.0
    quantity: str = ""
    top: float = 0.0
    bottom: float = 0.0
    visible_s: float = 0.0
    component: str = ""


#: Component of samples at full rate, in single precision: it holds 24 bits of a converter, and the
#: viewer's scalars, which are double, take three times as long to compress. A view must name it.
SINGLES = "samples"
#: Around a site, as parts of its extent: at the sides, and above and below; of a room, whose key of
#: localizers has two rows.
SIDE, MARGIN, ROOM_MARGIN = 0.1, 0.17, 0.32
#: The key of a site goes this much beyond its sides.
WIDER = 1.4
#: So many names have room beside each other; where there are more, every other one stands lower by
#: this part of the margin.
ROW, LOWER = 4, 0.46


@dataclass(frozen=True, slots=True)
class Bounds:
    """What of the site to show [m], y upwards; above and below is room for the map's key.

    Attributes
    ----------
    x, y
        From where to where.
    margin
        What is above and below the site, as a part of its extent.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    margin: float = MARGIN

    def key(self, count: int, height: float) -> NDArray[np.float64]:
        """Return places in a row beside the site, shape (count, 2) [m]; of many, in two rows.

        Parameters
        ----------
        count
            How many.
        height
            How far up the margin above the site; below it where negative.
        """
        (left, right), (low, high) = self.x, self.y
        extent = max((right - left) / (1 + 2 * SIDE), (high - low) / (1 + 2 * self.margin))
        margin = self.margin * extent
        # a view is wider than a site that is not: there is room for names beside it
        spread = WIDER if right - left < WIDER * (high - low) else 1.0
        part = (np.arange(count) + 0.5) / count - 0.5
        across = (left + right) / 2 + spread * (right - left) * part
        up = np.full(count, (high if height > 0 else low) + (height - np.sign(height)) * margin)
        if count > ROW:
            up[1::2] -= LOWER * margin
        return np.stack([across, up], axis=1)


class Timeline:
    """Sends columns of data to a recording; through :mod:`.legible`.

    Parameters
    ----------
    recording
        Where to.
    start_ns
        Time that becomes zero [ns].
    """

    def __init__(self, recording: rr.RecordingStream, start_ns: int) -> None:
        self._recording = recording
        self._start_ns = start_ns
        self._entities: dict[str, Entity] = {}
        self._roles: frozenset[str] = frozenset()
        self._rows: dict[int, list[str]] = {}
        self._levels: dict[str, NDArray[np.floating]] = {}

    @property
    def start_ns(self) -> int:
        """Time that is zero [ns]."""
        return self._start_ns

    @property
    def entities(self) -> tuple[Entity, ...]:
        """What was declared, in order."""
        return tuple(self._entities.values())

    @property
    def roles(self) -> frozenset[str]:
        """The roles of what was declared."""
        return self._roles

    def declare(self, entity: Entity, *static: AsComponents) -> None:
        """Announce an entity to the layout and log what does not change about it, once."""
        if entity.path not in self._entities:
            self._entities[entity.path] = entity
            self._roles |= {entity.role}
            self.static(entity.path, *static)

    def static(self, path: str, *archetypes: AsComponents) -> None:
        """Log what holds at all times."""
        if archetypes:
            log(self._recording, path, *archetypes, static=True)

    def send(self, path: str, times_ns: ArrayLike, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log columns at times on the recording's clock.

        Parameters
        ----------
        path
            Entity path.
        times_ns
            Shape (n,), int64 [ns].
        columns
            One row a time.
        """
        import rerun as rr

        since = np.asarray(times_ns, np.int64) - self._start_ns
        index = rr.TimeColumn(TIMELINE, duration=since.astype("timedelta64[ns]"))
        send_columns(self._recording, path, [index], columns)

    def scalars(self, path: str, times_ns: ArrayLike, values: NDArray[np.floating]) -> None:
        """Log curves: ``values`` has shape (n, n_curves)."""
        self.send(path, times_ns, [scalar_column(values)])

    def level(self, path: str, span_ns: tuple[int, int], values: ArrayLike) -> None:
        """Log lines across a plot: a threshold, or what keeps its axis to the recording.

        Parameters
        ----------
        path
            Entity path.
        span_ns
            What is shown of the recording: start and end [ns].
        values
            A number, or those of shape (n_curves,).
        """
        level = self._levels[path] = np.atleast_1d(np.asarray(values, np.float64))
        self.scalars(path, span_ns, np.tile(level, (2, 1)))

    def extend(self, time_ns: int) -> None:
        """Draw the lines across plots on up to a time: the recording has grown."""
        for path, level in self._levels.items():
            self.scalars(path, [time_ns], level[np.newaxis])

    def singles(self, path: str, times_ns: ArrayLike, values: NDArray[np.float32]) -> None:
        """Log curves in single precision, as :data:`SINGLES`: shape (n, n_curves)."""
        self.send(path, times_ns, [single_column(values)])

    def row_of(self, path: str, number: int) -> float:
        """Return the height at which a lane is drawn: by its number, the first one is highest.

        Lanes of one number stand close below each other, in the order in which they came.
        """
        paths = self._rows.setdefault(number, [])
        if path not in paths:
            paths.append(path)
        return FIRST_ROW - number - APART * paths.index(path)

    def seconds(self, time_ns: int) -> str:
        """Return a time as text: seconds since the start."""
        since = time_ns - self._start_ns
        return f"{since / 1e9:.3f} s"


def scalar_column(values: NDArray[np.floating]) -> rr.ComponentColumn:
    """Return the column of curves, shape (n, n_curves), without a copy where they are float64.

    The library's own ``Scalars.columns`` copies twice, and divides into single values first.
    """
    import pyarrow as pa
    import rerun as rr

    flat = pa.array(np.ascontiguousarray(values, np.float64).ravel())
    batch, kind = rr.components.ScalarBatch(flat), rr.Scalars.descriptor_scalars()
    return rr.ComponentColumn(kind, batch, offsets=_row_offsets(values))


def colour_column(colours: NDArray[np.uint32]) -> rr.ComponentColumn:
    """Return the column of the colours of points of curves, shape (n, n_curves)."""
    import pyarrow as pa
    import rerun as rr

    batch = rr.components.ColorBatch(pa.array(colours.ravel()))
    kind = rr.SeriesPoints.descriptor_colors()
    return rr.ComponentColumn(kind, batch, offsets=_row_offsets(colours))


def single_column(values: NDArray[np.float32]) -> rr.ComponentColumn:
    """Return the column of curves in single precision, shape (n, n_curves), without a copy."""
    import pyarrow as pa
    import rerun as rr

    batch = rr.AnyBatchValue(SINGLES, pa.array(values.ravel()))
    return rr.ComponentColumn(SINGLES, batch, offsets=_row_offsets(values))


def _row_offsets(values: NDArray[Any]) -> NDArray[np.int32]:
    rows, curves = values.shape
    return np.arange(rows + 1, dtype=np.int32) * np.int32(curves)


def strips_of(lines: Sequence[Line]) -> Any:
    """Return lines, each of shape (k, 2), as the library stores them: it converts one by one."""
    import pyarrow as pa
    import rerun as rr

    counts = [len(line) for line in lines]
    offsets = np.concatenate([np.zeros(1, np.int32), np.cumsum(counts, dtype=np.int32)])
    points = np.concatenate(lines, dtype=np.float32, casting="same_kind")
    kind = rr.components.LineStrip2DBatch([]).as_arrow_array().type
    flat = pa.FixedSizeListArray.from_arrays(pa.array(points.ravel()), type=kind.value_type)
    return pa.ListArray.from_arrays(offsets, flat, type=kind)


def stream_of(name: str, application: str) -> rr.RecordingStream:
    """Return a stream to the viewer's recording of a replay.

    Parameters
    ----------
    name
        File name of the replayed recording.
    application
        Kind of recording, as the pipeline has it.
    """
    import rerun as rr

    return rr.RecordingStream(
        legible(f"groundtrace-{application}"),
        recording_id=timeline_id(name),
        send_properties=False,
    )


#: Okabe and Ito (2008) without black, its blue lightened, then colours between them.
SENSOR_COLOURS = (
    0xE69F00FF,
    0x56B4E9FF,
    0x00B283FF,
    0xF0E442FF,
    0x4C8FE0FF,
    0xE8702AFF,
    0xDB8FBBFF,
    0xB8C4CCFF,
    0xA6D854FF,
    0x9E7BD6FF,
    0xFFC9A3FF,
    0x2FD0D6FF,
    0xC7A35CFF,
    0xFF8FA3FF,
    0x8CB369FF,
    0x8EA4F5FF,
)
#: What these are called where a plot says which curve is which.
SENSOR_COLOUR_NAMES = (
    "orange",
    "sky",
    "green",
    "yellow",
    "blue",
    "vermilion",
    "pink",
    "grey",
    "lime",
    "purple",
    "peach",
    "cyan",
    "tan",
    "rose",
    "olive",
    "lavender",
)
#: Of the axes of worn sensors: paler than what is right, wrong, left or right.
AXIS_COLOURS = {"x": 0xD2A679FF, "y": 0x7FB8A4FF, "z": 0x8FA8D8FF}
AXIS_COLOUR_NAMES = {"x": "sand", "y": "teal", "z": "steel"}

ACCEPTED = 0x4CE08AFF
REJECTED = 0xB4B4BCA0
THRESHOLD = 0xFF5D5DFF
LEFT = 0x56B4E9FF
RIGHT = 0xE69F00FF
STEP = 0x4CE08AFF
IMPACT = 0xF0E442FF
SPAN = 0x5B6B7AFF
IGNORED = 0x8A7050FF
LOSS = 0xC0392BFF
OUTLINE = 0x8A94A0FF
TRUTH = 0xB7A6FFFF
TRACE = 0xB4BCC6FF
NORM = 0xF2F2F2FF
#: Of places found, by the order of their stages: none is that of a verdict, a foot or the truth.
FIX_COLOURS = (0xFFC9A3FF, 0x2FE6D6FF, 0xFFFFFFFF, 0xC7A35CFF, 0x5C7CFAFF, 0xF7A8C4FF)
#: Of courses, the last word first; of vehicles, by number; of estimators of a ratio.
COURSE_COLOURS = (0xB6F23CFF, 0xFF7A6BFF, 0x3DDCA0FF, 0xFFE45CFF)
VEHICLE_COLOURS = (0xB6F23CFF, 0x35C9F0FF, 0xFFE45CFF, 0xFF7A6BFF)
ESTIMATOR_COLOURS = {
    "blue": 0x56B4E9FF,
    "yellow": 0xF0E442FF,
    "green": 0x00B283FF,
    "orange": 0xE8702AFF,
}
#: A road, and the signs of its forward direction; paths that people walk along.
ROAD, ROAD_SIGN, WALKED = 0x2C333CFF, 0x66707CFF, 0x4A535FFF
#: Of borders between regions, and of sensors without an arrival.
FAINT = 0x424A55FF
SILENT = 0x6A727CFF
FILTERED_TRACK = 0xB6F23CFF
SMOOTHED_TRACK = 0xFFA733FF
#: Filtered and smoothed tracks, by the number of the track.
TRACK_COLOURS = (
    (FILTERED_TRACK, SMOOTHED_TRACK),
    (0x35C9F0FF, 0x7F8CFFFF),
    (0xFFE45CFF, 0xFF7A6BFF),
    (0x3DDCA0FF, 0xC68CF0FF),
)
#: True paths of several walkers, by the order of their names.
WALKER_COLOURS = (TRUTH, 0xE8C9A0FF, 0x9FD8C8FF, 0xF0A6C6FF)
MISSED = 0xFF4D4DFF
#: Of a true arrival that nothing answers.
NOT_PICKED = 0xF2A33AFF
FALSE = 0xE85AD8FF
DISAGREEMENT = 0xFFD23FFF
STEP_COLOURS = {"left": LEFT, "right": RIGHT, "step": STEP, "impact": IMPACT}
#: Types of steps, besides left and right; the second contact of a side step.
TYPE_COLOURS = {"forward": STEP, "backward": 0x2FE6D6FF, "trailing": 0x7A8794FF}
#: Of what people marked; steps by foot and type are as everywhere.
ANNOTATION_COLOURS = {
    "missed": 0xE8702AFF,
    "false": 0xDB8FBBFF,
    "step": 0x00B283FF,
    "pick": 0xF2F2F2FF,
    "note": 0xF0E442FF,
    "walking": SPAN,
    "ignore": IGNORED,
    "disturbed": 0x9E7BD6FF,
    "pass": 0x4C8FE0FF,
    "span": 0x8EA4F5FF,
}
#: A step detector's signal, the valleys of its candidates, and those refused.
CURVE, VALLEY, REFUSED = 0xC9D2DBFF, 0x56B4E9FF, 0xFF7A6BFF
#: Masses on a peak, none, and either, and the conflict.
PEAK, NO_PEAK, EITHER, CONFLICT = 0x4CE08AFF, 0xFF7A6BFF, 0x8A94A0FF, 0xFFD23FFF
#: Headings by the order of their stages; spans in which they are disturbed.
HEADING_COLOURS = {
    "green": 0xB6F23CFF,
    "blue": 0x35A9F0FF,
    "peach": 0xFFC9A3FF,
    "white": 0xF2F2F2FF,
}
DISTURBED, DISTURBED_SHADE = 0xC8862AFF, 0xE0A04AFF
WAYPOINT, SATELLITE = 0xFFFFFFFF, 0x35C9F0FF

#: Colours of rejections, by the place of the failing gate in the detector.
REJECTION_COLOURS = (0xA85A5AFF, 0xA67C4AFF, 0x7F66A8FF, 0x4F7EA8FF, 0x5F927AFF, 0x92925FFF)

#: Dark violet over red and orange to pale yellow, of evenly rising lightness.
_HEAT = np.array(
    [
        (10, 8, 26),
        (38, 14, 74),
        (84, 18, 106),
        (132, 32, 104),
        (180, 50, 84),
        (218, 78, 54),
        (242, 122, 26),
        (248, 180, 48),
        (250, 246, 176),
    ],
    np.float64,
)


#: A title that names more curves than this is cut in a small window.
MOST_IN_KEY = 4


class SensorColours:
    """Assigns colours to channels: by place in the geometry, else by order of appearance."""

    def __init__(self, session: ReplaySession) -> None:
        names = [s.channel for s in session.geometry.sensors] if session.geometry else []
        for stream in session.streams:
            names += [stream.channels[i].name for i in stream.columns_of(SEISMIC_QUANTITIES)]
        self._indices = {name: i for i, name in enumerate(dict.fromkeys(names))}

    def of(self, name: str) -> int:
        """Return the colour of the channel called ``name``."""
        index = self._indices.setdefault(name, len(self._indices))
        return SENSOR_COLOURS[index % len(SENSOR_COLOURS)]

    def of_channel(self, channel: Channel) -> int:
        """Return the axis' colour for a worn sensor's axis, else the sensor's."""
        if channel.quantity not in SEISMIC_QUANTITIES and channel.axis in AXIS_COLOURS:
            return AXIS_COLOURS[channel.axis]
        return self.of(channel.name)

    def key(self, channels: Sequence[Channel]) -> str:
        """Return which curve is which, for the title of a plot; empty for one, or too many."""
        if not 1 < len(channels) <= MOST_IN_KEY:
            return ""
        entries = []
        for channel in channels:
            if self.of_channel(channel) == AXIS_COLOURS.get(channel.axis):
                entries.append(f"{channel.axis} {AXIS_COLOUR_NAMES[channel.axis]}")
            else:
                index = self._indices[channel.name] % len(SENSOR_COLOURS)
                entries.append(f"{channel.name} {SENSOR_COLOUR_NAMES[index]}")
        return ", ".join(entries)


def vehicle_colour(number: int) -> int:
    """Return the colour of a vehicle, numbered from 1."""
    return VEHICLE_COLOURS[(number - 1) % len(VEHICLE_COLOURS)]


def dimmed(colour: int, part: float) -> int:
    """Return a colour that is only so bright: ``part`` of each of its components."""
    parts = [round(((colour >> shift) & 0xFF) * part) << shift for shift in (24, 16, 8)]
    return sum(parts) | (colour & 0xFF)


def heat(level: NDArray[np.floating]) -> NDArray[np.uint32]:
    """Return the colours of levels within [0, 1], of the same shape; others are clipped."""
    stops = np.linspace(0.0, 1.0, len(_HEAT))
    packed = np.full(np.shape(level), 0xFF, np.uint32)
    for shift, component in zip((24, 16, 8), _HEAT.T, strict=True):
        packed |= np.rint(np.interp(level, stops, component)).astype(np.uint32) << np.uint32(shift)
    return packed


#: How long a moment is drawn: long enough to be seen with half a minute in view.
MARK_NS = 100_000_000
#: Where the lanes of a replay stand among each other: those of truth and score, then of stages by
#: what they emit.
TRUTH_LANES, SCORE, GAPS = "/state/1-truth", "/state/2-score", "/state/7-gaps"
ORDER = {
    "step": 3, "impact": 3, "presence": 3, "pick": 4, "pass": 5, "fix": 5, "bearing": 5,
    "disagreement": 5, "track": 6,
}  # fmt: skip
LAST = 6
#: Lanes beyond this number have no row among the plots: gaps, and what is at full rate.
MOST_ROWS = 6
#: The height of a lane of number 0, the distance between lanes of one number, and the width of all
#: in screen points.
FIRST_ROW, APART, ROW_WIDTH = 8.0, 0.34, 6.0
LANES = "/lanes"
#: A curve without values, from the first sample to the last: it keeps the axes of plots to what is
#: shown, so that they line up.
AXIS, AXIS_NS, MOST_ON_AXIS = "/time-axis", NS_PER_S // 20, 20_000
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
        bars: list[Mark] = []
        for i, mark in enumerate(marks[:ready]):
            following = marks[i + 1].start_ns if i + 1 < len(marks) else None
            if following is None or following > mark.start_ns:
                changes.append((mark.start_ns, mark.state))
                if following is None or following > mark.end_ns:
                    changes.append((mark.end_ns, ""))
                end_ns = mark.end_ns if following is None else min(mark.end_ns, following)
                bars.append(Mark(mark.start_ns, end_ns, mark.state))
        self._marks = marks[ready:]
        self._send(changes)
        self._draw(bars)

    def _send(self, changes: list[tuple[int, str]]) -> None:
        import rerun as rr

        if not changes:
            return
        if not self._declared:
            self._declare()
        times, states = zip(*changes, strict=True)
        self._timeline.send(self._path, times, rr.StateChange.columns(state=list(states)))

    def _draw(self, bars: Sequence[Mark]) -> None:
        """Log the marks as thick lines, which line up with plots, at the lane's height."""
        import rerun as rr

        number = lane_number(self._path)
        if number > MOST_ROWS or not bars:
            return
        height = self._timeline.row_of(self._path, number)
        for state in dict.fromkeys(bar.state for bar in bars):
            state_bars = [bar for bar in bars if bar.state == state]
            part = rr.escape_entity_path_part(state)
            path = f"{LANES}/{self._path.removeprefix('/state/')}/{part}"
            style = rr.SeriesLines(
                names=state,
                colors=np.array([self._colours.get(state, SPAN)], np.uint32),
                widths=ROW_WIDTH,
                aggregation_policy=rr.components.AggregationPolicy.Off,
            )
            self._timeline.declare(Entity(path, "row", state), style)
            times = np.array(
                [(bar.start_ns, bar.end_ns, bar.end_ns + 1) for bar in state_bars]
            ).ravel()
            heights = np.tile([height, height, np.nan], len(state_bars))
            self._timeline.scalars(path, times, heights[:, np.newaxis])

    def _declare(self) -> None:
        import rerun as rr

        style = rr.StateConfiguration(
            values=list(self._colours), colors=np.array(list(self._colours.values()), np.uint32)
        )
        self._timeline.declare(Entity(self._path, "lane"))
        self._timeline.static(self._path, style)
        self._declared = True


def lane_number(path: str) -> int:
    """Return the number that a lane's name begins with; one beyond all rows where there is none."""
    begin = path.removeprefix("/state/").partition("-")[0]
    return int(begin) if begin.isdecimal() else MOST_ROWS + 1


def log_axis(timeline: Timeline, span_ns: tuple[int, int]) -> None:
    """Log :data:`AXIS` over a span [ns]."""
    import rerun as rr

    start_ns, end_ns = span_ns
    step_ns = max(AXIS_NS, (end_ns - start_ns) // MOST_ON_AXIS)
    times = np.append(np.arange(start_ns, end_ns, step_ns), end_ns)
    timeline.static(AXIS, rr.SeriesLines(names="-", colors=[0]))
    timeline.scalars(AXIS, times, np.full((len(times), 1), np.nan))


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
            prefix = f"{ORDER.get(emits, LAST)}-" if self._ordered else ""
            self._lanes[key] = Lane(self._timeline, f"/state/{prefix}{stage}{where}", colours)
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
    chosen: list[int] = []
    open_ns, taken = None, True
    for row, (time, good) in enumerate(zip(time_ns.tolist(), accepted.tolist(), strict=True)):
        if open_ns is None or time >= open_ns + max(window_ns, 1):
            chosen.append(row)
            open_ns, taken = time, good
        elif good and not taken:
            chosen[-1], taken = row, True
    return chosen


class Strips:
    """Lines of one entity: those of a time hold until the next time.

    Parameters
    ----------
    timeline
        Where to.
    path
        Entity path.
    order
        What is drawn over what: larger numbers over smaller ones, points are at 30.
    role
        Of the entity.
    """

    def __init__(
        self, timeline: Timeline, path: str, order: float = 20.0, role: str = "map"
    ) -> None:
        self._timeline = timeline
        self._path = path
        self._order = order
        self._role = role
        self._times: list[int] = []
        self._counts: list[int] = []
        self._lines: list[NDArray[np.floating]] = []
        self._colours: list[int] = []
        self._radii: list[float] = []

    def add(
        self,
        time_ns: int,
        lines: Sequence[NDArray[np.floating]],
        colours: Sequence[int],
        radii: Sequence[float],
    ) -> None:
        """Take the lines of a time: each of shape (k, 2), with its colour and radius."""
        self._times.append(time_ns)
        self._counts.append(len(lines))
        self._lines += lines
        self._colours += colours
        self._radii += radii

    def clear(self, time_ns: int) -> None:
        """Show no lines from a time on."""
        self.add(time_ns, [], [], [])

    def flush(self) -> None:
        """Log what is pending."""
        import rerun as rr

        if not self._times:
            return
        style = rr.LineStrips2D.from_fields(draw_order=self._order)
        self._timeline.declare(Entity(self._path, self._role), style)
        # columns cannot be made of nothing: a line that no time shows stands for it
        columns = rr.LineStrips2D.columns(
            strips=strips_of(self._lines or [np.zeros((2, 2))]),
            colors=np.array(self._colours or [0], np.uint32),
            radii=np.array(self._radii or [0.0], np.float32),
        )
        self._timeline.send(self._path, self._times, columns.partition(self._counts))
        self._times, self._counts = [], []
        self._lines, self._colours, self._radii = [], [], []


#: Segments are joined into a run of this length, or where nothing follows for so long [ns].
RUN_NS, PAUSE_NS = 20 * NS_PER_S, 20 * NS_PER_S
#: Single segments are shown for so long [s]: until their run is.
SEGMENTS_S = (RUN_NS + PAUSE_NS) / NS_PER_S
#: Where runs are, below the entity of the segments.
RUNS = "runs"


class GrowingLine:
    """Logs one line, from place to place.

    Parameters
    ----------
    timeline
        Where to.
    path
        Entity of its segments.
    colour
        Of the line.
    radius
        Half its width, in the viewer's measure.
    """

    def __init__(self, timeline: Timeline, path: str, colour: int, radius: float) -> None:
        self._timeline = timeline
        self._path = path
        self._colour = colour
        self._radius = radius
        self._run: list[Passed] = []

    def add(self, passed: Sequence[Passed]) -> None:
        """Take places in the order of their times."""
        points = [*self._run[-1:], *passed]
        if len(points) > 1:
            segments = [[a[1], b[1]] for a, b in pairwise(points)]
            self._log(self._path, [time_ns for time_ns, _ in points[1:]], segments, SEGMENTS_S)
        runs: list[list[Passed]] = []
        for time_ns, position in passed:
            run = self._run
            long = len(run) > 1 and run[-1][0] - run[0][0] >= RUN_NS
            if len(run) > 1 and (long or time_ns - run[-1][0] >= PAUSE_NS):
                runs.append(run)
                self._run = run[-1:]
            self._run.append((time_ns, position))
        self._log_runs(runs)

    def close(self) -> None:
        """End the line."""
        if len(self._run) > 1:
            self._log_runs([self._run])
        self._run = self._run[-1:]

    def _log_runs(self, runs: list[list[Passed]]) -> None:
        if runs:
            lines = [[position for _, position in run] for run in runs]
            self._log(f"{self._path}/{RUNS}", [run[-1][0] for run in runs], lines, np.inf)

    def _log(
        self,
        path: str,
        times_ns: list[int],
        lines: list[list[tuple[float, float]]],
        visible_s: float,
    ) -> None:
        import rerun as rr

        columns = rr.LineStrips2D.columns(
            strips=strips_of(lines),
            colors=np.full(len(lines), self._colour, np.uint32),
            radii=np.full(len(lines), self._radius),
        )
        self._timeline.declare(Entity(path, "map", visible_s=visible_s))
        self._timeline.send(path, times_ns, columns)


@dataclass(frozen=True, slots=True)
class Used:
    """A plugin as a stage uses it: its class, its parameters and its topics."""

    kind: type[Any]
    parameters: Any
    topics: tuple[str, ...]


def used(session: ReplaySession, spec: StageSpec) -> Used | None:
    """Return what a stage runs; None where the session does not say, or it is not installed."""
    try:
        config = parse_pipeline(session.pipeline.encode(), session.name)
        stage = next(s for s in config.stage if (s.key, s.use) == (spec.stage, spec.plugin))
        kind = stage_named(stage.use)
        return Used(kind, build(kind.Parameters, stage.parameters, stage.key), stage.topics)
    except (PipelineError, PluginError, StopIteration):
        return None


@dataclass(frozen=True, slots=True)
class Recipe:
    """What a replay is made with: the names of ``groundtrace replay``'s options.

    Attributes
    ----------
    pipeline
        The pipeline's file.
    geometry
        The geometry's file; None without one.
    from_, to
        The span, in seconds after the first sample; None where it is the recording's end.
    """

    pipeline: Path
    geometry: Path | None
    from_: float | None
    to: float | None


def written_recipe(results: Results, folder: Path) -> Recipe:
    """Write what results were made with, for another replay.

    Parameters
    ----------
    results
        Of an earlier replay.
    folder
        Where to.
    """
    origin = results.provenance
    pipeline, geometry = folder / "pipeline.toml", folder / "geometry.toml"
    pipeline.write_text(origin.pipeline, "utf-8")
    if results.geometry is not None:
        geometry.write_text(results.geometry.to_toml(), "utf-8")
    return Recipe(
        pipeline,
        None if results.geometry is None else geometry,
        _since(origin.from_ns, origin.start_ns),
        _since(origin.to_ns, origin.start_ns),
    )


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S


PAGE = "/about"

_READING = """\
## How to read it

* Time runs from the recording's first sample. Plots share one time axis: drag to pan, scroll to \
zoom, double-click to see everything. Click in a plot or on a line of the log to move the cursor; \
the waveform at the cursor follows it.
* Envelopes are the largest |x| of each bucket, so that no impact is lost: per 10 ms; in \
recordings longer than a minute per 50 ms, with 10 ms and the whole recording in the tabs beside. \
Spectrograms: time to the right, frequency upwards, lighter is louder.
* Where a step is missed or false, the upper left says what was decided at the cursor, why, and \
what mends it; bars show how far each gate was from its threshold. Missed steps are red bands, \
false ones pink.
* Waves of the step at the cursor: all channels scaled alike and cut. A green dot is a pick, a red \
cross the best candidate of a channel that did not pick, a violet one the true arrival; at the \
right is the value that the gate looks at.
* Samples of fast signals that are not everywhere are where the lane `full-rate` says; there the \
decision functions and the spectrogram of 3 ms are too. Elsewhere those plots are empty: \
everything is in the recording, and `groundtrace replay --full-rate FROM-TO` shows another part.
* One colour per sensor, in every plot but those of shots, and on the map. A sensor lights up when \
a wave arrives; at a step its name says how long after the first arrival, and is grey where it has \
none. Triangles on the map are shot points.
* Lines across the room part regions with the same order of distances to the sensors. At a step \
those are lit whose signs differ least from the measured ones; the page Signs says which signs do.
* At stations of three axes: rays on the map point where a step's wave came from, with one sigma \
to either side. Hodograms: motion from the station's arrival on, from above (x–y, with the bearing \
in white) and from the side (r–z: away from the source, and up), one scale for both.
* A yellow line joins two places of one step that localizers disagree about.
* Places found are points on the map, of the last three seconds, a colour for each stage; the key \
is above the site. The line about the newest is its one-sigma ellipse.
* Tracks are lines that grow: filtered as the fixes came (light green, with the walker now and its \
one-sigma ellipse), and smoothed by what came later (orange); of several tracks each has its own \
colours, and of several walkers each true path. Grey lines are paths that the geometry states.
* Detector: the decision function of every channel, the threshold in red, accepted candidates as \
green triangles, rejected ones as grey crosses. The plot of a ratio is cut at four thresholds, \
since its peaks reach thousands; candidates beyond lie at its upper edge. Below the samples around \
the cursor is the same at every sample, 0.1 s before to 0.1 s after each step, found or missed. \
Rejected candidates below half the threshold are in the results alone.
* Walkers: the detector's plot has its filtered signal at every sample, with accepted peaks as \
green dots, their valleys as blue triangles, and rejected ones as red crosses; over raw samples a \
step is an upright. Masses: what each \
sensor, and both combined, believe of each candidate; the three add up to one.
* Headings go from -180 to 180 degrees, counter-clockwise from east, and are interrupted where \
they pass them. The shade is where a stage finds the field disturbed; the truth's own spans are a \
lane. Errors are taken where truth has a direction, outside spans to ignore; the blue band is \
twice the claimed deviation. The dial is at the cursor.
* The way of a walker: truth, waypoints, satellite fixes in metres from the first, tracks. Up is \
north where the arrow says so; elsewhere a track's direction is free, and the truth is turned and \
shifted onto the last track, as the key then says: distances between the two are then no errors.
* Spectrogram at steps: 0.5 s before to 0.5 s after each, down to 45 dB below the loudest.
* Shots: the section is of the shot at the cursor, time downwards, geophones along the line with \
their distance from the shot. Every trace is scaled to itself and cut, so that its onset is seen. \
Green crosses are picks, red ones off by more than 2 ms, with a line to the truth (violet); the \
thin green line is what a pick claims; an orange dot is an arrival without a pick. Travel times: \
this shot bold, the others grey; what leaves the bundle is a wrong pick, or other ground. Tabs \
below have true amplitudes, detectors and lanes.
* Picks come from the last stage that picks; those of stages before it are its candidates.
* Lanes: thick lines under the plots, by the numbers in their title; the tab beside has their \
names. What each stage decided, and for a rejected candidate the first gate that failed; \
`places` has what stages that say where rejected, and where they disagree. \
`truth` lanes come from the recording's labels. `score`: a step that was hit, missed or false, \
within 0.12 s; the log has a line for every missed (ERROR) and false (WARN) one.
* A curve that ends abruptly ends at a gap.
"""

_VEHICLES = """\
## How to read it

* Time runs from the recording's first sample. Plots share one time axis: drag to pan, scroll to \
zoom, double-click to see everything. Click in a plot or on a line of the log to move the cursor.
* One colour per sensor, in every plot and on the map. Truth is violet everywhere.
* Map: the road is grey, its signs point forward. The image is the log-likelihood of the vehicle's \
place in the cycle: the lightest is likeliest, clear what is less likely by 9 or more. Crosses are \
places of single cycles in the last 12 s, a colour for each stage (key above), the lines about the \
newest one-sigma ellipses. Dashed: courses through all cycles of a vehicle (key below); they are \
known when it has gone, and drawn at the times they are of. The last stage's is green and broader, \
with the vehicle now and its ellipse. Green dots: lines crossed, at the map's side when and how \
fast.
* Power: over the noise floor, one value a cycle and channel, the threshold in red.
* θ of A2 / A1 is (r of A2 / r of A1)ⁿ by the ratio of powers, in dB, 0 where both distances are \
alike; a colour for each estimator, the bar is one theoretical standard deviation to either side. \
Estimators of a cycle stand 0.06 s beside each other. Violet: what true distances give by the law.
* Way along the road: dots are passes of stations in the sensors' colours, grey crosses those that \
no vehicle has, red ones those that were missed. A line is a vehicle; its steepness is its speed.
* Lanes: `truth` and `passes` by direction along the road, each vehicle from its first station to \
its last, with its speed; `presence`: when any channel hears a vehicle, or which gate says that \
what is loud is none; `places`: the cycles that gave no place, and why; one lane for each stage of \
courses; `score`: passes that were hit, missed or false, within a second.
* Spectrograms: time to the right, frequency upwards, lighter is louder.
* A curve that ends abruptly ends at a gap.
"""


def _names(stream: Stream) -> str:
    names = [c.name for c in stream.channels]
    return ", ".join(names) if len(names) <= 10 else f"{names[0]} … {names[-1]} ({len(names)})"


def about(session: ReplaySession) -> str:
    """Return the page as markdown."""
    rows = "\n".join(
        f"| `{s.topic}` | {_names(s)} | {s.rate_hz:g} Hz"
        f"{' (irregular)' if s.irregular else ''} "
        f"| {', '.join(dict.fromkeys(c.unit for c in s.channels))} |"
        for s in session.streams
    )
    reading = _VEHICLES if session.application == "vehicle" else _READING
    duration_s = (session.end_ns - session.start_ns) / 1e9
    lasts = (
        "Being recorded" if session.live else f"{duration_s:.1f} s, {len(session.labels)} labels"
    )
    return (
        f"# {session.name}\n\n{lasts}.\n\n"
        f"| stream | channels | rate | unit |\n|---|---|---|---|\n{rows}\n\n"
        f"{reading}\n## Pipeline\n\n```toml\n{session.pipeline.strip()}\n```\n"
    )
