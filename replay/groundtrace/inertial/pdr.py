"""Pedestrian dead reckoning: steps and the signal of a worn sensor become a track.

Steps may have magnetic azimuths, each with its uncertainty. Iron in a building turns the field as
often as it makes it stronger or steeper, so that a field whose horizontal and vertical parts are
not the usual ones is doubted by just as much.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.events import Gap, Heading, Label, Note, Quantity, StepEvent, TrackPoint
from groundtrace_codecs.geometry import tangent_plane
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..pipeline.gates import Candidates, Level
from ..pipeline.stage import Context, Input, Memory, Stage
from .body_motion import LevelFrameTracker
from .carried_iron import CarriedIron, IronFit
from .frames import PATIENCE_NS, QUANTITIES, SensorAligner, columns_of_axes
from .pdr_filter import MagneticBearing, ReckoningFilter, ReckoningNoise, Stride, Track, Unheard
from .rotations import mean_matrix, wrap_angle
from .steps import (
    Barometer,
    BodyHeadingOffset,
    ReckoningParameters,
    repeats_of,
    satellite_columns,
    satellite_fixes,
    shape_of,
    stair_length,
    step_length,
    waypoints_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import CandidateBlock, Event
    from groundtrace_codecs.signals import Stream

    from ..pipeline.stage import Output
    from .body_motion import Ahead, LevelFrameMotion
    from .carried_iron import IronWindow
    from .rotations import Array
    from .steps import PositionReference

#: Time of a step that follows none [s]. Chosen by judgement: of a usual walk.
USUAL_STEP_S = 0.55
#: Direction of a step against the way the walker looks, counter-clockwise [rad]. Source:
#: definition.
ASIDE = {"backward": math.pi, "left": math.pi / 2, "right": -math.pi / 2}
#: How fast a walker may have come from where they were seen first [m/s]. Chosen by judgement: a
#: brisk walk.
WALK_MPS = 1.5
#: An azimuth that the compass alone is to tell may have changed by this since the last step [rad].
#: Chosen by judgement: half a right angle and a little, as a deviation.
ANYHOW = 0.9


#: Who is heard for so long without a step stood [ns]. Chosen by judgement: where less is heard
#: between gaps, detectors may miss the steps there.
STOOD_NS = 4 * NS_PER_S
#: Weight of the last step in the pace. Chosen by judgement: that of some steps.
NEWEST_PACE = 0.3
#: Part of what the directions of a field scatter by, by which their mean is off. Chosen by trial on
#: logs of IPIN 2023 of odd trials, where they scatter by 15 to 20 degrees and tracks are off by 10.
SHARED = 0.5


class _Measured(NamedTuple):
    """A step as measured.

    Attributes
    ----------
    stride
        Where it goes.
    begin_ns
        When it began, not before there was a sample.
    look_rad
        Where the walker looks by the gyroscope, but for what the sensor is turned on them [rad].
    interval_s
        How long it took [s].
    """

    stride: Stride
    begin_ns: int
    look_rad: float
    interval_s: float


@dataclass(slots=True)
class Silence:
    """Where a walker was when the signal ended, and how long they stood about it as heard.

    Attributes
    ----------
    step
        The last one before.
    heard_ns
        Since when the signal is heard again, without a step as yet.
    stood_ns
        For how long it was heard without one.
    """

    step: _Measured
    heard_ns: int
    stood_ns: int = 0

    def listen(self, until_ns: int, again_ns: int) -> None:
        """Take it that no step was heard until the signal ended, and that it is back again."""
        heard_ns = until_ns - self.heard_ns
        self.stood_ns += heard_ns if heard_ns > STOOD_NS else 0
        self.heard_ns = max(until_ns, again_ns)


class PedestrianDeadReckoning:
    """Steps times length along their azimuth, a filter's errors with them.

    The candidates are the steps. ``cadence`` and ``speed`` are what a step taken for one would
    mean; one that is no walk is not taken. ``swing``, ``rise`` and ``interval``, from the peak to
    its end, are what the models of length look at, ``azimuth`` is the step's, counter-clockwise
    from x, ``off`` how far its magnetic field is from the usual one, ``height`` that over the start
    and ``riser`` what the step rises by, both by the barometer. On a stair a step is as long as the
    tread that goes with its riser.
    """

    columns = (
        Quantity("cadence", "Hz"),
        Quantity("speed", "m/s"),
        Quantity("length", "m"),
        Quantity("swing", "m/s2"),
        Quantity("rise", "m"),
        Quantity("azimuth", "deg"),
        Quantity("off", "uT"),
        Quantity("height", "m"),
        Quantity("mounting", "deg"),
        Quantity("interval", "s"),
        Quantity("riser", "m"),
    )
    gates = (
        Level("cadence", "Hz", "cadence_hz", at_least=False),
        Level("speed", "m/s", "speed_mps", at_least=False),
    )

    def __init__(self, parameters: ReckoningParameters) -> None:
        self.parameters = parameters
        self.stage = ""
        self.number = 0
        self.origin = (0.0, 0.0)
        self._north = FieldDirection(parameters)
        self._facing = BodyHeadingOffset(parameters.axis or "walk")
        self._track: Track | None = None
        self._places: list[PositionReference] = []
        self._measured: _Measured | None = None
        self._last: _Measured | None = None
        self._pace_mps = 0.0
        self._silence: Silence | None = None

    def start(self, stage: str, number: int, origin: tuple[float, float]) -> None:
        """Begin a track at a place [m]; ``stage`` and ``number`` go into its points."""
        self.stage, self.number, self.origin = stage, number, origin

    def interrupt(self, until_ns: int, again_ns: int) -> None:
        """Take it that a signal is heard until a time, and another one from a later time on."""
        if self._last is not None and self._silence is None:
            self._silence = Silence(self._last, self._last.stride.time_ns)
        if self._silence is not None:
            self._silence.listen(until_ns, again_ns)
        self._north.forget_axes()

    def update(self, places: Sequence[PositionReference]) -> None:
        """Take known places, in order of time; they count with the step after them."""
        self._places += places

    def learn(self, windows: Sequence[IronWindow]) -> None:
        """Take what windows before the next step tell of iron on the sensor."""
        self._north.learn(windows)

    def measure(
        self, step: StepEvent, motion: LevelFrameMotion, height_m: float, climb_mps: float
    ) -> Candidates:
        """Return a step as a candidate, by what the sensor felt; the step is remembered."""
        p = self.parameters
        interval_s = self._interval_s(step.time_ns)
        span = step.time_ns - round(interval_s * NS_PER_S), step.time_ns
        shape = shape_of(motion, *span)
        riser_m = climb_mps * interval_s
        length_m = stair_length(riser_m) or step_length(shape, step.type, interval_s, p)
        self._facing.watch(step, interval_s, motion)
        look = self._facing.heading(motion, *span)
        heading = look + ASIDE.get(step.type, 0.0)
        sight, off = self._north.sight(motion, *span, length_m)
        sight = None if p.azimuth == "gyroscope" else sight
        stride = Stride(step.time_ns, length_m, heading, sight, *motion.by_end(*span))
        # a walk may be under way when a recording begins
        begin_ns = max(span[0], min(int(motion.time_ns[0]), step.time_ns))
        self._measured = _Measured(stride, begin_ns, look, interval_s)
        turn = self._facing.turn_rad
        azimuth = math.degrees(wrap_angle(self._azimuth(stride, turn)))
        row = [1 / interval_s, length_m / interval_s, length_m, shape.swing, shape.rise_m, azimuth]
        row += [off * 1e6, height_m, math.degrees(turn), shape.peak_end_s, riser_m]
        return Candidates(
            np.array([step.time_ns], np.int64),
            np.zeros(1, np.int32),
            np.array([row], np.float32),
        )

    def follow(self, accepted: bool) -> list[TrackPoint | Heading | Note]:
        """Take the verdict on the step just measured; return what is known."""
        step, self._measured = self._measured, None
        if step is None or not accepted:
            return []
        stride, previous = step.stride, self._previous
        outputs: list[TrackPoint | Heading | Note] = []
        if self._track is None:
            outputs += self._begin(step.begin_ns)
        track = self._track
        assert track is not None  # begun by now
        if self._silence is not None:
            outputs += self._heard_again(track, self._silence, step)
        outputs += self._take_places(track, stride.time_ns)
        self._last, pace_mps = step, stride.length_m / step.interval_s
        self._pace_mps += (NEWEST_PACE if self._pace_mps else 1.0) * (pace_mps - self._pace_mps)
        if previous is not None:
            stride = stride._replace(
                rested_s=stride.rested_s - previous.stride.rested_s,
                unseen_rad2=stride.unseen_rad2 - previous.stride.unseen_rad2,
            )
        track.direction_rad = self._direction_rad
        facing, north = self._facing, self._north
        axis_rad = facing.sigma_rad
        track.resight(north.other_sights())
        outputs += track.step(stride, facing.turn_rad, axis_rad, settled=facing.settled)
        azimuth = wrap_angle(track.filter.azimuth(stride.heading_rad + facing.turn_rad))
        sigma = math.hypot(track.filter.azimuth_sigma_rad, axis_rad)
        if self._scattered_rad > math.radians(self.parameters.direction_deg):
            sigma = math.hypot(sigma, self._scattered_rad)
        sigma = min(sigma, math.pi)
        outputs.append(Heading(stride.time_ns, azimuth, sigma, self.stage))
        north.forget(track.begun_ns)
        for news in filter(None, (facing.news, north.news)):
            outputs.append(Note(stride.time_ns, news, source=self.stage))
        north.news = ""
        return outputs

    @property
    def _direction_rad(self) -> float:
        """What all azimuths may be off by together [rad]."""
        return max(math.radians(self.parameters.direction_deg), self._scattered_rad)

    @property
    def _scattered_rad(self) -> float:
        """What the mean of a field that scatters may be off by [rad]; 0 where none is followed."""
        if self.parameters.azimuth == "gyroscope" or not self._north.steps:
            return 0.0
        return SHARED * self._north.scatter_rad

    @property
    def field_told(self) -> str:
        """What a person should know of the field's direction; empty without a field."""
        scatter_deg, direction_deg = map(
            math.degrees, (self._north.scatter_rad, self._direction_rad)
        )
        if math.isnan(scatter_deg) or self.parameters.azimuth == "gyroscope":
            return ""
        return (
            f"the field's direction scatters by {scatter_deg:.0f} degrees over {self._north.steps} "
            f"steps; all directions together may be off by {direction_deg:.0f} "
            "degrees, which nothing here tells but a known direction or a second known place"
            + (self._north.iron_told and f"; {self._north.iron_told}")
        )

    def flush(self) -> list[TrackPoint]:
        """End the track; return what is still to say of it."""
        track, self._track = self._track, None
        return [] if track is None else [*self._take_places(track, 2**63), *track.flush()]

    @property
    def _previous(self) -> _Measured | None:
        """The last step, where the signal was heard since."""
        return self._last if self._silence is None else None

    def _interval_s(self, time_ns: int) -> float:
        """Return the time since the last step of the walk, or that of a first one [s]."""
        if self._previous is None:
            return USUAL_STEP_S
        apart_s = max(time_ns - self._previous.stride.time_ns, 1) / NS_PER_S
        return apart_s if apart_s <= self.parameters.pause_s else USUAL_STEP_S

    def _azimuth(self, stride: Stride, turn_rad: float) -> float:
        heading = stride.heading_rad + turn_rad
        if self._track is not None and self._silence is None and not self._track.filter.lost:
            return self._track.filter.azimuth(heading)
        return heading + (0.0 if stride.sight is None else stride.sight.offset_rad)

    def _begin(self, time_ns: int) -> list[TrackPoint]:
        """Begin where the walker was seen first, or at the origin, which is sure."""
        p = self.parameters
        noise = ReckoningNoise(
            drift=math.radians(p.drift_dps),
            mount=math.radians(p.mount_deg),
            length=p.length_error,
            scale=p.scale_error,
            way=math.radians(p.way_deg),
            wander=ANYHOW if p.azimuth == "compass" else 0.0,
        )
        position, sigma_m = self.origin, 0.0
        if self._places:
            seen = next((k for k in self._places[::-1] if k.time_ns <= time_ns), self._places[0])
            away_m = WALK_MPS * abs(seen.time_ns - time_ns) / NS_PER_S
            position, sigma_m = (seen.x_m, seen.y_m), math.hypot(seen.sigma_m, away_m)
            self._places = [k for k in self._places if k.time_ns > time_ns]
        learns = p.updates in ("waypoints", "gnss")
        walker = ReckoningFilter(noise, np.array(position), sigma_m, learns_scale=learns)
        direction_rad = math.radians(p.direction_deg)
        piece = (p.smooth_s, direction_rad)
        self._track = Track(walker, time_ns, self.stage, self.number, *piece, smooths=p.smooth)
        return self._track.begin()

    def _heard_again(self, track: Track, silence: Silence, step: _Measured) -> list[TrackPoint]:
        """Go on to where a step begins that is heard first after a gap."""
        points = self._take_places(track, step.begin_ns)
        silence.listen(step.begin_ns, step.begin_ns)
        unheard = self._unheard(track, silence, step.begin_ns)
        points += track.resume(unheard, silence.step.look_rad - step.look_rad)
        self._silence = None
        return points

    def _take_places(self, track: Track, until_ns: int) -> list[TrackPoint]:
        """Take in the known places up to a time."""
        points = []
        while self._places and self._places[0].time_ns <= until_ns:
            fix = self._places.pop(0)
            if self._silence is not None:
                track.stray(self._unheard(track, self._silence, fix.time_ns))
            points += track.fix(fix)
        return points

    def _unheard(self, track: Track, silence: Silence, until_ns: int) -> Unheard:
        """Return what is known of a walker who is not heard until a time."""
        last, until_ns = silence.step.stride, max(until_ns, track.time_ns)
        walking = max(0.0, 1 - silence.stood_ns / max(until_ns - last.time_ns, 1))
        return Unheard(last.time_ns, until_ns, self._pace_mps, last.heading_rad, walking)


TURNING = "angular_velocity"


@dataclass(slots=True)
class BodyWornSensor:
    """Follows the motion of one sensor.

    Attributes
    ----------
    motion
        What it felt; None before the gyroscope is heard of.
    start_ns
        When the gap before it ended; long ago where there was none.
    topic
        Of the gyroscope.
    before
        What the sensor felt before a gap; None once that is known.
    """

    motion: LevelFrameTracker | None = None
    start_ns: int = -(2**62)
    topic: str = ""
    before: LevelFrameTracker | None = None
    _aligner: SensorAligner = field(default_factory=SensorAligner)
    _early: list[SignalBlock] = field(default_factory=list)

    @property
    def end_ns(self) -> int:
        """Time until which the motion is known; long ago where nothing is [ns]."""
        return -(2**62) if self.motion is None else self.motion.end_ns

    @property
    def held_count(self) -> int:
        """How many samples were not finite."""
        return self._aligner.held_count

    @property
    def remark(self) -> str:
        """What was assumed of the field's unit; empty where it is known."""
        return self._aligner.remark

    def update(self, block: SignalBlock) -> None:
        """Take a block of one of the sensor's streams."""
        if self.motion is None and not columns_of_axes(block.stream, TURNING):
            self._early.append(block)
            return
        if self.motion is None:
            self.topic = block.topic
            self.motion = LevelFrameTracker(block.stream.rate_hz)
            if self.before is not None:
                self.motion.resume(self.before)
                self.before = None
            for early in self._early:
                self._aligner.update(early)
            self._early = []
        self._aligner.update(block)
        self.motion.add(self._aligner.take())

    def lose(self, gap: Gap) -> None:
        """Take it that samples of the gyroscope are straight lines over a gap."""
        self._aligner.lose(gap)

    def forget(self) -> None:
        """Forget what lies too long before a gyroscope that is yet to be heard of."""
        if self._early:
            oldest_ns = self._early[-1].start_ns - PATIENCE_NS
            self._early = [block for block in self._early if block.last_ns >= oldest_ns]

    def flush(self) -> None:
        """Take in what waited for more."""
        if self.motion is not None:
            self.motion.add(self._aligner.flush())
            self.motion.flush()


#: A step counts signal and satellite fixes up to so long after it. Chosen by judgement: the slowest
#: step that tells the walking axis.
LATE_NS = 3 * NS_PER_S // 2
#: It waits until the signal is so far beyond it: streams come in portions, and late. Chosen by
#: judgement: twice a slow step, and half a second more than a climb is measured over.
WAIT_NS = 3 * NS_PER_S
#: Fixes from so long ago are remembered. Chosen by judgement: it bounds memory; a receiver's fix
#: comes later by less.
KEPT_NS = 60 * NS_PER_S
#: Axis that looks ahead where none is named, by placement; elsewhere the walk tells it.
AXES: dict[str, Ahead] = {"phone": "y", "foot": "x", "wrist": "x"}


class DeadReckoning(Stage):
    """Steps times length along their azimuth, a filter's errors with them.

    The steps are those of one stage, with a sensor that has a gyroscope.
    Streams of the placement of the steps' topic are one sensor; the last of the sensors is heard
    now. Over a gap of that topic, or of its gyroscope, that is not bridged the walker is taken to
    have gone on as before but for random turns: for some seconds ahead, then anywhere. Of the
    labels only waypoints are looked at, and only as ``updates`` says.
    """

    Parameters = ReckoningParameters
    takes = (
        Input(StepEvent),
        Input(SignalBlock, frozenset({"angular_velocity"}), anywhere=True, hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), anywhere=True, hold=False),
        # a field, pressure and positions, and what tells how far the steps' topic was heard of
        Input(SignalBlock, anywhere=True, hold=False, required=False),
        Input(Gap, anywhere=True),
        Input(Label, required=False),
    )
    gives = (TrackPoint, Heading)
    compiles = ("attitude", "reckoning", "strides")
    columns = PedestrianDeadReckoning.columns
    gates = PedestrianDeadReckoning.gates
    ends_at = "clock step"
    rounds = ("latitude", TURNING)
    feedback = True

    def __init__(self, parameters: ReckoningParameters) -> None:
        self.parameters = parameters
        self._steps: list[StepEvent] = []
        self._sensors = [BodyWornSensor()]
        self._barometer = Barometer()
        self._fixes: list[PositionReference] = []  # in order of time
        self._received_ns = -(2**62)  # how far the topic of the steps was heard of
        self._known_ns = -(2**62)  # until when the reckoner knows fixes

    @property
    def memory(self) -> Memory:
        """All before; and what is waited for after a step."""
        return Memory(None, (LATE_NS + WAIT_NS) / NS_PER_S)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a track where the geometry says that walks begin."""
        p, self._context = self.parameters, context
        self._placement = context.stream.placement
        worn = next((axis for word, axis in AXES.items() if word in self._placement), None)
        axis: Ahead = p.axis or worn or "walk"  # a left foot is a foot
        length = p.step_length or ("weinberg" if "phone" in self._placement else "fused")
        origin = context.geometry.start or (0.0, 0.0)
        self._plane = tangent_plane(context.geometry)
        self._reckoner = PedestrianDeadReckoning(replace(p, axis=axis, step_length=length))
        self._reckoner.start(context.stage, context.tracks.next(), origin)
        self._reckoner.update(waypoints_of(context.labels, p.waypoint_m))
        return ("walker",)

    def process(self, item: StepEvent | SignalBlock | Gap) -> Iterator[Output]:
        """Take signal and steps; give the track as far as it is known."""
        if isinstance(item, StepEvent):
            self._steps.append(item)
        elif isinstance(item, Gap):
            self._interrupted(item)
        else:
            self._take_fixes(item)
            self._take_motion(item)
            yield from self._reckon()
            self._sensors[-1].forget()

    def flush(self) -> Iterator[Output]:
        """End the track."""
        self._sensors[-1].flush()
        yield from self._reckon(final=True)
        self._know(2**62)
        yield from self._reckoner.flush()
        yield from self._notes()

    def decided(self, block: CandidateBlock) -> list[Event]:
        """Go on by the step just decided."""
        return [*self._reckoner.follow(bool(block.accepted[0]))]

    def _take_fixes(self, block: SignalBlock) -> None:
        """Remember the satellite fixes of a block, back to those of the last minute."""
        if self.parameters.updates != "gnss" or satellite_columns(block.stream) is None:
            return
        self._fixes += satellite_fixes(block, self._plane, self.parameters.gnss_m)
        self._fixes.sort(key=lambda fix: fix.time_ns)
        oldest_ns = min(block.start_ns - KEPT_NS, self._known_ns)
        past = sum(fix.time_ns <= oldest_ns for fix in self._fixes)
        del self._fixes[: max(past - 1, 0)]

    def _know(self, until_ns: int) -> None:
        """Give the reckoner the fixes up to a time."""
        known_ns, self._known_ns = self._known_ns, max(until_ns, self._known_ns)
        for before, fix in pairwise([None, *self._fixes]):
            if fix is None or not known_ns < fix.time_ns <= until_ns:
                continue
            apart_s = math.inf if before is None else (fix.time_ns - before.time_ns) / NS_PER_S
            repeats = repeats_of(apart_s, self.parameters.gnss_s)
            self._reckoner.update([replace(fix, repeats=repeats)])

    def _interrupted(self, gap: Gap) -> None:
        """Begin with a new sensor after a gap; know less of this one's turns after a filled one."""
        sensor = self._sensors[-1]
        if gap.filled and gap.topic == sensor.topic:
            sensor.lose(gap)
        if not gap.bridged and gap.topic in (self._context.topic, sensor.topic):
            sensor.flush()
            before = sensor.motion or sensor.before
            self._sensors.append(BodyWornSensor(start_ns=gap.end_ns, before=before))

    def _take_motion(self, block: SignalBlock) -> None:
        """Take what a stream of the sensor measures."""
        if block.topic == self._context.topic:
            self._received_ns = block.last_ns
        if block.stream.placement != self._placement:
            return
        if _has_pressure(block.stream):
            self._barometer.update(block)
        if any(columns_of_axes(block.stream, quantity) for quantity in QUANTITIES):
            self._sensors[-1].update(block)

    def _reckon(self, *, final: bool = False) -> Iterator[Output]:
        """Take the steps around which everything is known."""
        while self._steps:
            step = self._steps[0]
            while len(self._sensors) > 1 and step.time_ns > self._sensors[0].end_ns:
                self._interrupt(step.time_ns)
            sensor = self._sensors[0]
            is_complete = final or self._complete(step.time_ns)
            if sensor.motion is None or not is_complete or sensor.end_ns < 0:
                return
            self._steps.pop(0)
            self._know(step.time_ns + LATE_NS)
            height_m = self._barometer.height_m(step.time_ns)
            climb_mps = self._barometer.climb_mps(step.time_ns)
            self._reckoner.learn(sensor.motion.field_windows.until(step.time_ns))
            yield self._reckoner.measure(step, sensor.motion.history, height_m, climb_mps)

    def _complete(self, time_ns: int) -> bool:
        """Return whether no stream can bring more of what counts for a step."""
        over = len(self._sensors) > 1
        went_back = over and self._received_ns < self._sensors[0].end_ns
        if self._received_ns < time_ns + WAIT_NS and not went_back:
            return False
        return over or self._sensors[0].end_ns >= time_ns + LATE_NS

    def _interrupt(self, time_ns: int) -> None:
        """Go on with the next sensor."""
        sensor = self._sensors.pop(0)
        if sensor.motion is not None:
            self._reckoner.learn(sensor.motion.field_windows.until(time_ns))
        heard_until_ns = max(sensor.start_ns, sensor.end_ns)
        self._reckoner.interrupt(heard_until_ns, self._sensors[0].start_ns)

    def _notes(self) -> Iterator[Note]:
        """Say what a person should know."""
        topic, stage = self._context.topic, self._context.stage
        if self._steps:
            expected = "expected a gyroscope and an accelerometer of three axes"
            text = f"{topic}: {len(self._steps)} steps lead nowhere: {expected}, found none"
            yield Note(self._steps[0].time_ns, text, "WARN", stage)
        if field_note := self._reckoner.field_told:
            yield Note(self._sensors[-1].end_ns, f"{topic}: {field_note}", "INFO", stage)
        for remark in dict.fromkeys(sensor.remark for sensor in self._sensors if sensor.remark):
            yield Note(self._sensors[-1].end_ns, remark, "WARN", stage)
        if held_count := sum(sensor.held_count for sensor in self._sensors):
            text = f"{topic}: {held_count} samples not finite, last value held"
            yield Note(self._sensors[-1].end_ns, text, "WARN", stage)


def _has_pressure(stream: Stream) -> bool:
    return any(c.quantity == "pressure" and c.unit == "Pa" for c in stream.channels)


#: Weight of a step's field in the reference, once there were some. Chosen by judgement: fifty
#: steps.
NEWEST = 0.02
#: The earth's field has a horizontal part of at least about this, where a compass works [T]. Chosen
#: by judgement: below 6 uT the World Magnetic Model cautions against compasses.
LEAST_T = 5e-6
#: Sights are taken anew where other iron is believed in that is apart by more than this [T]. Chosen
#: by judgement: five degrees of a field of 20 uT.
OTHER_T = 2e-6
#: The iron is told anew after so many windows. Chosen by judgement: six seconds; it bounds the
#: cost.
TOLD_EVERY = 4
#: Said where iron is no longer believed in.
NO_IRON = "the magnetic field no longer turns with the sensor: no iron is taken away"


class SeenField(NamedTuple):
    """The field of a step.

    Attributes
    ----------
    time_ns
        When the step ends.
    field
        Its mean in level axes, shape (3,) [T].
    turn
        The mean rotation from the sensor's axes to these, shape (3, 3).
    repeats
        How many steps in a row err alike.
    """

    time_ns: int
    field: Array
    turn: Array
    repeats: float


class FieldDirection:
    """Compares the field of each step with the reference of the steps before.

    Parameters
    ----------
    parameters
        Of the reckoning.

    Attributes
    ----------
    iron
        What the sensor carries; None while none is believed in. It is taken away from fields.
    steps
        How many steps the reference rests on.
    news
        What a person should know of iron since the step before; empty mostly.
    """

    def __init__(self, parameters: ReckoningParameters) -> None:
        self.parameters = parameters
        self.iron: IronFit | None = None
        self._carried = CarriedIron()
        self._seen: deque[SeenField] = deque()
        self._others: dict[int, MagneticBearing] = {}
        self.news = ""
        self._begin()

    def _begin(self) -> None:
        self._reference: tuple[float, float] | None = None  # horizontal and vertical part [T]
        self._directions = 0j  # sum of unit vectors along the field in the level axes
        self._before = 0.0  # lengths of such sums in axes that are forgotten
        self.steps = 0

    def forget_axes(self) -> None:
        """Take it that the level axes are others from now on; iron and field are the same."""
        self._seen, self._others = deque(), {}
        self._before, self._directions = self._before + abs(self._directions), 0j

    @property
    def scatter_rad(self) -> float:
        """Circular standard deviation of the field's direction over the steps [rad]; NaN of none.

        The gyroscope follows the turns; what it drifts by counts as well.
        """
        if not self.steps:
            return math.nan
        resultant = min((self._before + abs(self._directions)) / self.steps, 1.0)
        return math.sqrt(-2 * math.log(max(resultant, 1e-9)))

    @property
    def iron_told(self) -> str:
        """What a person should know of the iron; empty where there is none."""
        if self.iron is None:
            return ""
        return (
            f"{self.iron.words} of the magnetic field turn with the sensor, as iron in it or a "
            "missing calibration makes it, and are taken away"
        )

    def learn(self, windows: Sequence[IronWindow]) -> None:
        """Take what windows tell of the iron; take sights anew where it is another one."""
        before = self._carried.windows
        for window in windows:
            self._carried.add(window)
        is_due = self._carried.windows // TOLD_EVERY > before // TOLD_EVERY
        fit = self._carried.fit() if is_due else None
        if fit is None:
            return
        last, self.iron = self.iron, fit if fit.believed else None
        now_t, last_t = (np.zeros(3) if x is None else x.field for x in (self.iron, last))
        if float(np.linalg.norm(now_t - last_t)) <= OTHER_T:
            self.iron = last
            return
        if (last is None) != (self.iron is None):
            self.news = self.iron_told or NO_IRON
        self._begin()
        looked = {seen.time_ns: self._look(seen)[0] for seen in self._seen}
        self._others = {time_ns: sight for time_ns, sight in looked.items() if sight}

    def sight(
        self, motion: LevelFrameMotion, start_ns: int, stop_ns: int, length_m: float
    ) -> tuple[MagneticBearing | None, float]:
        """Return the azimuth that a step's field tells, and how far that field is off [T].

        Without a field that is None and NaN. The step lies in ``[start_ns, stop_ns)``.
        """
        rows = motion.rows(start_ns, stop_ns)
        field_ = motion.field[rows].mean(axis=0)
        if not math.isfinite(float(field_.sum())):
            return None, math.nan
        repeats = 2 * self.parameters.compass_memory_m / max(length_m, 0.1)
        seen = SeenField(stop_ns, field_, mean_matrix(motion.orientation[rows]), repeats)
        self._seen.append(seen)
        return self._look(seen)

    def other_sights(self) -> dict[int, MagneticBearing]:
        """Return, once, what sights of the steps before have become by other iron, by time."""
        others, self._others = self._others, {}
        return others

    def forget(self, until_ns: int) -> None:
        """Forget fields that are never looked at again, in order of time."""
        while self._seen and self._seen[0].time_ns <= until_ns:
            self._seen.popleft()

    def _look(self, seen: SeenField) -> tuple[MagneticBearing | None, float]:
        field_ = seen.field if self.iron is None else seen.field - seen.turn @ self.iron.field
        east, north, up = field_.tolist()
        flat = math.hypot(east, north)
        if flat == 0:
            return None, math.nan
        before = (flat, up) if self._reference is None else self._reference
        off = math.hypot(flat - before[0], up - before[1])
        self.steps += 1
        weight = max(NEWEST, 1 / self.steps)
        self._reference = (
            before[0] + weight * (flat - before[0]),
            before[1] + weight * (up - before[1]),
        )
        self._directions += complex(east, north) / flat
        p = self.parameters
        sigma = math.hypot(math.radians(p.compass_deg), off / max(before[0], LEAST_T))
        # the level frame's magnetic north, against the map's
        offset = math.pi / 2 - math.radians(p.declination_deg) - math.atan2(north, east)
        return MagneticBearing(offset, sigma, seen.repeats), off
