"""The stage of dead reckoning: the steps of one stage, and a sensor's signal, become a track."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.events import Gap, Note, StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..gates import Carry, decided_block, gate_specs
from ..heading.aligned import PATIENCE_NS, QUANTITIES, columns_of_axes
from ..rounds import Rounds
from ..stage import PluginStage
from .barometer import Barometer
from .places import TangentPlane, satellite_columns, satellite_fixes, waypoints_of
from .worn_sensor import TURNING, WornSensor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    from ..heading.walking_axis import Ahead
    from .places import KnownPlace
    from .reckoner import DeadReckoner

#: A step counts satellite fixes up to so long after it.
LATE_NS = NS_PER_S
#: It waits until the signal is so far beyond it: streams come in portions, and late.
WAIT_NS = 3 * NS_PER_S // 2
#: Fixes from so long before a walker is heard of are remembered.
KEPT_NS = 60 * NS_PER_S
#: The one channel of a reckoner's candidates.
WALKER = ("walker",)
#: Axis that looks ahead where none is named, by placement; elsewhere the walk tells it.
AXES: dict[str, Ahead] = {"phone": "y", "foot": "x", "wrist": "x"}


@dataclass(slots=True)
class _Run:
    """A reckoner at work on the steps of one topic; the last of its sensors is heard now.

    ``heard_ns`` is how far the topic was heard of, ``known_ns`` until when the worker knows fixes.
    """

    worker: DeadReckoner
    spec: StageSpec
    placement: str
    sensors: list[WornSensor]
    steps: list[StepEvent]
    barometer: Barometer = field(default_factory=Barometer)
    carry: Carry = field(default_factory=Carry)
    heard_ns: int = -(2**62)
    known_ns: int = -(2**62)


class ReckoningStage(PluginStage["DeadReckoner"]):
    """Runs one reckoner on the steps that one stage finds with a sensor that has a gyroscope.

    Parameters
    ----------
    name, plugin, kind, parameters, topics
        As those of :class:`groundtrace.stage.DetectorStage`.
    stepping
        The stage whose steps it takes.
    start
        Where the walk begins [m], where nothing else says so.
    labels
        Of the recording; only waypoints are looked at, and only as ``updates`` says.

    Notes
    -----
    Streams of the placement of the steps' topic are one sensor. A gap of that topic, or of its
    gyroscope, that is not bridged ends the track; the next begins where it ended, in a direction
    that is to be found anew.
    """

    def __init__(
        self,
        name: str,
        plugin: str,
        kind: type[DeadReckoner],
        parameters: Any,
        topics: Sequence[str] = (),
        *,
        stepping: str,
        start: tuple[float, float] = (0.0, 0.0),
        labels: Sequence[Label] = (),
    ) -> None:
        super().__init__(name, plugin, kind, parameters, topics)
        self.stepping = stepping
        self.start = start
        self.waypoints = waypoints_of(labels, parameters.updates, parameters.waypoint_m)
        self._plane = TangentPlane(start)
        self._topics: set[str] = set()
        self._runs: dict[str, _Run] = {}
        self._rounds = Rounds(TURNING)
        self._early: list[SignalBlock] = []
        self._early_steps: dict[str, list[StepEvent]] = {}  # of a topic not heard of yet
        self._fixes: list[KnownPlace] = []  # in order of time, back to those of the last minute
        self._tracks = 0

    def process(self, item: SignalBlock | Event) -> Iterator[Event]:
        """Take signal and steps; give the track as far as it is known."""
        match item:
            case StageSpec(stage=stage, topic=topic) if stage == self.stepping:
                if self.allowed(topic):
                    self._topics.add(topic)
            case StepEvent(stage=stage, topic=topic) if stage == self.stepping:
                if topic in self._runs:
                    self._runs[topic].steps.append(item)
                elif topic in self._topics:
                    self._early_steps.setdefault(topic, []).append(item)
            case SignalBlock() if len(item):
                yield from self._take(self._rounds.add(item))
            case Gap():
                yield from self._take(self._rounds.add(item))

    def flush(self) -> Iterator[Event]:
        """End all tracks."""
        yield from self._take(self._rounds.finish())
        for run in self._runs.values():
            run.sensors[-1].finish()
            yield from self._reckon(run, final=True)
            self._know(run, 2**62)
            yield from run.worker.finish()
            yield from self._notes(run)

    def _take(self, items: Sequence[SignalBlock | Gap]) -> Iterator[Event]:
        """Take a round of all streams: places first, then each sensor's signal."""
        blocks = [item for item in items if isinstance(item, SignalBlock)]
        self._see(blocks)
        for block in blocks:
            if block.topic in self._topics and block.topic not in self._runs:
                run = self._runs[block.topic] = self._begin(block)
                yield run.spec
                for early in self._early:
                    self._feed(run, early)
        for item in items:
            if isinstance(item, SignalBlock):
                yield from self._hear(item)
            elif not item.bridged:
                self._interrupted(item)
        if blocks:
            oldest_ns = blocks[-1].start_ns - PATIENCE_NS
            self._early = [x for x in [*self._early, *blocks] if x.last_ns >= oldest_ns]
            for run in self._runs.values():
                run.sensors[-1].forget()

    def _see(self, blocks: Sequence[SignalBlock]) -> None:
        """Remember the satellite fixes of a round."""
        if self.parameters.updates != "gnss":
            return
        seen = [block for block in blocks if satellite_columns(block.stream) is not None]
        if not seen:
            return
        seen.sort(key=lambda block: block.start_ns)
        oldest_ns = seen[0].start_ns - KEPT_NS
        oldest_ns = min([oldest_ns, *(run.known_ns for run in self._runs.values())])
        for block in seen:
            self._fixes += satellite_fixes(block, self._plane, self.parameters.gnss_m)
        self._fixes.sort(key=lambda fix: fix.time_ns)
        past = sum(fix.time_ns <= oldest_ns for fix in self._fixes)
        del self._fixes[: max(past - 1, 0)]

    def _know(self, run: _Run, until_ns: int) -> None:
        """Give a reckoner the fixes up to a time."""
        known_ns, run.known_ns = run.known_ns, max(until_ns, run.known_ns)
        run.worker.know([fix for fix in self._fixes if known_ns < fix.time_ns <= until_ns])

    def _hear(self, block: SignalBlock) -> Iterator[Event]:
        for run in self._runs.values():
            self._feed(run, block)
            yield from self._reckon(run)

    def _interrupted(self, gap: Gap) -> None:
        """Begin with a new sensor after a gap."""
        for run in self._runs.values():
            sensor = run.sensors[-1]
            if gap.topic in (run.spec.topic, sensor.topic):
                sensor.finish()
                run.sensors.append(WornSensor())

    def _feed(self, run: _Run, block: SignalBlock) -> None:
        if block.topic == run.spec.topic:
            run.heard_ns = block.last_ns
        if block.stream.placement != run.placement:
            return
        if any(c.quantity == "pressure" and c.unit == "Pa" for c in block.stream.channels):
            run.barometer.hear(block)
        if any(columns_of_axes(block.stream, quantity) for quantity in QUANTITIES):
            run.sensors[-1].hear(block)

    def _begin(self, block: SignalBlock) -> _Run:
        placement = block.stream.placement
        worn = next((axis for word, axis in AXES.items() if word in placement), None)  # left foot
        axis: Ahead = self.parameters.axis or worn or "walk"
        worker = self.kind(replace(self.parameters, axis=axis))
        gates = gate_specs(worker.gates, self.parameters)
        spec = StageSpec(
            self.name,
            self.plugin,
            block.topic,
            ("walker",),
            worker.columns,
            gates,
            (),
            worker.emits,
        )
        self._tracks += 1
        worker.start(self.name, self._tracks, self.start)
        worker.know(self.waypoints)
        early = self._early_steps.pop(block.topic, [])
        return _Run(worker, spec, placement, [WornSensor()], early)

    def _reckon(self, run: _Run, *, final: bool = False) -> Iterator[Event]:
        """Take the steps around which everything is known."""
        while run.steps:
            step = run.steps[0]
            while len(run.sensors) > 1 and step.time_ns > run.sensors[0].end_ns:
                yield from self._interrupt(run, step.time_ns)
            sensor = run.sensors[0]
            known = final or self._complete(run, step.time_ns)
            if sensor.motion is None or not known or sensor.end_ns < 0:
                return
            run.steps.pop(0)
            self._know(run, step.time_ns + LATE_NS)
            height_m = run.barometer.height_m(step.time_ns)
            found = run.worker.measure(step, sensor.motion.felt, height_m)
            block, run.carry = decided_block(
                run.spec, found, run.worker, self.parameters, run.carry
            )
            yield block
            yield from run.worker.follow(bool(block.accepted[0]))

    def _complete(self, run: _Run, time_ns: int) -> bool:
        """Return whether no stream can bring more of what counts for a step."""
        over = len(run.sensors) > 1
        went_back = over and run.heard_ns < run.sensors[0].end_ns
        if run.heard_ns < time_ns + WAIT_NS and not went_back:
            return False
        return over or run.sensors[0].end_ns >= time_ns + LATE_NS

    def _interrupt(self, run: _Run, time_ns: int) -> Iterator[Event]:
        """Go on with the next sensor: the end of a track, and the beginning of another."""
        run.sensors.pop(0)
        self._know(run, time_ns)
        yield from run.worker.finish(time_ns)
        self._tracks += 1
        run.worker.start(self.name, self._tracks, run.worker.origin)

    def _notes(self, run: _Run) -> Iterator[Note]:
        """Say what a person should know."""
        if run.steps:
            expected = "expected a gyroscope and an accelerometer of three axes"
            text = f"{run.spec.topic}: {len(run.steps)} steps lead nowhere: {expected}, found none"
            yield Note(run.steps[0].time_ns, text, "WARN", self.name)
        for remark in dict.fromkeys(sensor.remark for sensor in run.sensors if sensor.remark):
            yield Note(run.sensors[-1].end_ns, remark, "WARN", self.name)
        if held := sum(sensor.held for sensor in run.sensors):
            text = f"{run.spec.topic}: {held} samples not finite, last value held"
            yield Note(run.sensors[-1].end_ns, text, "WARN", self.name)
