"""The stage of dead reckoning: the steps of one stage, and a sensor's signal, become a track."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from groundtrace_codecs.events import Gap, Heading, Note, StepEvent, TrackPoint
from groundtrace_codecs.labels import Label
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..heading.aligned import QUANTITIES, columns_of_axes
from ..stage import Context, Input, Stage
from .barometer import Barometer
from .parameters import ReckoningParameters
from .places import TangentPlane, satellite_columns, satellite_fixes, waypoints_of
from .reckoner import DeadReckoner
from .worn_sensor import TURNING, WornSensor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.events import CandidateBlock, Event
    from groundtrace_codecs.signals import Stream

    from ..heading.walking_axis import Ahead
    from ..stage import Output
    from .places import KnownPlace

#: A step counts satellite fixes up to so long after it.
LATE_NS = NS_PER_S
#: It waits until the signal is so far beyond it: streams come in portions, and late.
WAIT_NS = 3 * NS_PER_S // 2
#: Fixes from so long ago are remembered.
KEPT_NS = 60 * NS_PER_S
#: Axis that looks ahead where none is named, by placement; elsewhere the walk tells it.
AXES: dict[str, Ahead] = {"phone": "y", "foot": "x", "wrist": "x"}


class DeadReckoning(Stage):
    """Steps times length along their azimuth, a filter's errors with them.

    The steps are those of one stage, with a sensor that has a gyroscope, see :mod:`.reckoner`.
    Streams of the placement of the steps' topic are one sensor; the last of the sensors is heard
    now. A gap of that topic, or of its gyroscope, that is not bridged ends the track; the next
    begins where it ended, in a direction that is to be found anew. Of the labels only waypoints are
    looked at, and only as ``updates`` says.
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
    columns = DeadReckoner.columns
    gates = DeadReckoner.gates
    ends_at = "clock step"
    rounds = ("latitude", TURNING)
    feedback = True

    def __init__(self, parameters: ReckoningParameters) -> None:
        self.parameters = parameters
        self._steps: list[StepEvent] = []
        self._sensors = [WornSensor()]
        self._barometer = Barometer()
        self._fixes: list[KnownPlace] = []  # in order of time
        self._received_ns = -(2**62)  # how far the topic of the steps was heard of
        self._known_ns = -(2**62)  # until when the reckoner knows fixes

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a track where the geometry says that walks begin."""
        p, self._context = self.parameters, context
        self._placement = context.stream.placement
        worn = next((axis for word, axis in AXES.items() if word in self._placement), None)
        axis: Ahead = p.axis or worn or "walk"  # a left foot is a foot
        origin = context.geometry.start or (0.0, 0.0)
        self._plane = TangentPlane(origin)
        self._reckoner = DeadReckoner(replace(p, axis=axis))
        self._reckoner.start(context.stage, context.tracks.next(), origin)
        self._reckoner.know(waypoints_of(context.labels, p.waypoint_m))
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
        self._sensors[-1].finish()
        yield from self._reckon(final=True)
        self._know(2**62)
        yield from self._reckoner.finish()
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
        self._reckoner.know([fix for fix in self._fixes if known_ns < fix.time_ns <= until_ns])

    def _interrupted(self, gap: Gap) -> None:
        """Begin with a new sensor after a gap."""
        sensor = self._sensors[-1]
        if not gap.bridged and gap.topic in (self._context.topic, sensor.topic):
            sensor.finish()
            self._sensors.append(WornSensor())

    def _take_motion(self, block: SignalBlock) -> None:
        """Take what a stream of the sensor measures."""
        if block.topic == self._context.topic:
            self._received_ns = block.last_ns
        if block.stream.placement != self._placement:
            return
        if _has_pressure(block.stream):
            self._barometer.hear(block)
        if any(columns_of_axes(block.stream, quantity) for quantity in QUANTITIES):
            self._sensors[-1].hear(block)

    def _reckon(self, *, final: bool = False) -> Iterator[Output]:
        """Take the steps around which everything is known."""
        while self._steps:
            step = self._steps[0]
            while len(self._sensors) > 1 and step.time_ns > self._sensors[0].end_ns:
                yield from self._interrupt(step.time_ns)
            sensor = self._sensors[0]
            known = final or self._complete(step.time_ns)
            if sensor.motion is None or not known or sensor.end_ns < 0:
                return
            self._steps.pop(0)
            self._know(step.time_ns + LATE_NS)
            height_m = self._barometer.height_m(step.time_ns)
            yield self._reckoner.measure(step, sensor.motion.felt, height_m)

    def _complete(self, time_ns: int) -> bool:
        """Return whether no stream can bring more of what counts for a step."""
        over = len(self._sensors) > 1
        went_back = over and self._received_ns < self._sensors[0].end_ns
        if self._received_ns < time_ns + WAIT_NS and not went_back:
            return False
        return over or self._sensors[0].end_ns >= time_ns + LATE_NS

    def _interrupt(self, time_ns: int) -> Iterator[Output]:
        """Go on with the next sensor: the end of a track, and the beginning of another."""
        self._sensors.pop(0)
        self._know(time_ns)
        yield from self._reckoner.finish(time_ns)
        number = self._context.tracks.next()
        self._reckoner.start(self._context.stage, number, self._reckoner.origin)

    def _notes(self) -> Iterator[Note]:
        """Say what a person should know."""
        topic, stage = self._context.topic, self._context.stage
        if self._steps:
            expected = "expected a gyroscope and an accelerometer of three axes"
            text = f"{topic}: {len(self._steps)} steps lead nowhere: {expected}, found none"
            yield Note(self._steps[0].time_ns, text, "WARN", stage)
        for remark in dict.fromkeys(sensor.remark for sensor in self._sensors if sensor.remark):
            yield Note(self._sensors[-1].end_ns, remark, "WARN", stage)
        if held := sum(sensor.held for sensor in self._sensors):
            text = f"{topic}: {held} samples not finite, last value held"
            yield Note(self._sensors[-1].end_ns, text, "WARN", stage)


def _has_pressure(stream: Stream) -> bool:
    return any(c.quantity == "pressure" and c.unit == "Pa" for c in stream.channels)
