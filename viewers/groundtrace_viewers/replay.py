"""One replay on the timeline: every item goes to the parts that know it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from groundtrace_codecs.events import (
    CandidateBlock,
    Gap,
    Note,
    Pick,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .about import PAGE, about
from .annotation_layer import log_annotations
from .close_ups import CloseUps
from .detector import DetectorLog, step_like
from .events import LogLines, LossLog, PickLog, PlainLog, StepLog, lane_labels, log_note, log_truth
from .full_rate import REACH_NS
from .lanes import TRUTH, StageLanes
from .palette import SensorColours
from .particulars import particulars, viewed
from .places import Places
from .section import Section
from .signals import SignalLog
from .spectrograms import spectrograms
from .timeline import Timeline
from .traces import Traces
from .vehicles import TOLD
from .verdict import log_verdicts, verdicts

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rerun as rr

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .details import Views
    from .full_rate import Plan
    from .sensor_map import Bounds

#: How much of the recording is collected before events are logged.
FLUSH_NS = 10 * NS_PER_S
LIVE_FLUSH_NS = NS_PER_S
#: Events may lag this far behind the signal.
LAG_NS = 5 * NS_PER_S
LIVE_LAG_NS = REACH_NS + NS_PER_S // 20
LIVE_CHUNK_S = 0.5


class Replay:
    """Logs one replay: hands every item to the part that knows it.

    Parameters
    ----------
    recording
        Where to.
    session
        What is replayed.
    plan
        What is shown at full rate.
    live
        True where somebody watches: smaller chunks.
    map_tiles
        Show a street map.
    channels
        Whose spectrograms are shown; empty takes the first seismic channel's.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        session: Session,
        plan: Plan,
        *,
        live: bool,
        map_tiles: bool = False,
        channels: Sequence[str] = (),
    ) -> None:
        import rerun as rr

        self.timeline = Timeline(recording, session.start_ns)
        self.first_event_ns: int | None = None
        self._session = session
        self._colours = SensorColours(session)
        self._flush_every_ns = LIVE_FLUSH_NS if live else FLUSH_NS
        self._flushed_ns = session.start_ns
        self._chunk_s = LIVE_CHUNK_S if live else None
        self._replayed_ns: tuple[int, int] | None = None
        self._plan = plan
        lag_ns = LIVE_LAG_NS if live else LAG_NS
        self.close_ups = CloseUps(self.timeline, plan, session, lag_ns)
        self._signals: dict[str, SignalLog] = {}
        self._sections: dict[str, Section] = {}
        self._traces = Traces()
        for stream in session.streams:
            self._begin(stream)
        self._spectrogram_topic, self._spectrograms = spectrograms(
            self.timeline, session, plan, channels
        )
        self._detectors: dict[tuple[str, str], DetectorLog] = {}
        self._picking: dict[str, str] = {}
        self._stepping: dict[str, str] = {}
        self._steps_ns: list[int] = []
        lines = LogLines(self.timeline)
        self._lines = lines
        self._lanes = StageLanes(self.timeline, ordered=True)
        self._picks = PickLog(self.timeline, self._colours, lines)
        self._steps = StepLog(self.timeline, lines)
        self._losses = LossLog(self.timeline, lines)
        self._plain = PlainLog(self.timeline, lines)
        self._places = Places(self.timeline, session, self._colours, lines)
        self._details = particulars(
            self.timeline,
            session,
            self._colours,
            self._places.sensors,
            self._lanes,
            lines,
            channels,
            close=plan.mode != "none",
            tiles=map_tiles,
        )
        log_truth(self.timeline, lane_labels(session), TRUTH)
        log_annotations(self.timeline, lines, session.annotations)
        self.timeline.static(PAGE, rr.TextDocument(about(session), media_type="text/markdown"))

    @property
    def shown(self) -> Bounds | None:
        """What the map must show, as far as is known by now; None without a map."""
        return self._details.bounds or self._places.shown

    def _begin(self, stream: Stream) -> None:
        """Prepare for a stream."""
        topic = stream.topic
        self._signals[topic] = SignalLog(
            self.timeline, stream, self._colours, self._plan, self._chunk_s
        )
        recent = self._traces.begin(stream)
        if self._session.application == "shots" and Section.fits(stream):
            self._sections[topic] = Section(self.timeline, stream, self._session.labels, recent)

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        own = self.views.get(type(item))
        if own is not None:
            own(self, item)
        elif not isinstance(item, SignalBlock):
            self._event(item)

    def _event(self, event: Event) -> None:
        """Take an event that the parts show, or none of them."""
        if isinstance(event, TOLD):
            self._answered(event.time_ns)
        self._details.event(event)
        self._places.event(event)
        if not viewed(type(event)):
            self._plain.add(event)

    def _trace(self, block: TraceBlock) -> None:
        self._detector(block.spec).trace(block)
        self._details.trace(block)

    def _candidates(self, block: CandidateBlock) -> None:
        self._detector(block.spec).candidates(block)
        self._details.candidates(block)

    def _note(self, note: Note) -> None:
        log_note(self._lines, note, self.timeline.seconds(note.time_ns))

    def _signal(self, block: SignalBlock) -> None:
        if not len(block):
            return
        if block.topic not in self._signals:
            self._begin(block.stream)
        first_ns, _ = self._replayed_ns or (block.start_ns, 0)
        self._replayed_ns = (first_ns, block.last_ns)
        self._signals[block.topic].write(block)
        self._traces.push(block)
        if block.topic in self._sections:
            self._sections[block.topic].advance(block.end_ns)
        if block.topic == self._spectrogram_topic:
            for spectrogram in self._spectrograms:
                spectrogram.write(block)
        self._details.signal(block)
        self._show_close_ups(block.last_ns)
        if block.last_ns - self._flushed_ns >= self._flush_every_ns:
            self._flushed_ns = block.last_ns
            self._flush(block.start_ns - LAG_NS)

    def _stage(self, spec: StageSpec) -> None:
        """Take a stage; the last one of a kind has the last word on its topic."""
        if spec.emits == "pick":
            self._picking[spec.topic] = spec.stage
        elif step_like(spec):
            self._stepping[spec.topic] = spec.stage
            self.close_ups.moments.judge()
        self._details.stage(spec, self._places.stage(spec))
        self._detector(spec)

    def _detector(self, spec: StageSpec) -> DetectorLog:
        key = (spec.stage, spec.topic)
        if key not in self._detectors:
            session = self._session
            span_ns = session.shown_ns or (session.start_ns, session.end_ns)
            drawn = replace(spec, trace=()) if self._details.draws(spec) else spec
            lanes = None if self._details.tells(spec) else self._lanes
            self._detectors[key] = DetectorLog(self.timeline, drawn, self._colours, lanes, span_ns)
        return self._detectors[key]

    def _gap(self, gap: Gap) -> None:
        self._losses.add(gap)
        self._details.gap(gap)
        for (_, topic), detector in self._detectors.items():
            if topic == gap.topic and not gap.bridged:
                detector.interrupt(gap.start_ns)

    def _answered(self, time_ns: int) -> None:
        """Remember the first event, where a viewer opens."""
        if self.first_event_ns is None or time_ns < self.first_event_ns:
            self.first_event_ns = time_ns

    def _pick(self, pick: Pick) -> None:
        self._details.pick(pick)
        if self._picking.get(pick.topic, pick.stage) != pick.stage:
            return
        self._answered(pick.time_ns)
        if not self._stepping:
            self.close_ups.moments.step(pick.time_ns)
        self._picks.add(pick, self._traces.of_pick(pick), told=not self._stepping)
        if pick.topic in self._sections:
            self._sections[pick.topic].add(pick)
        self._places.pick(pick)

    def _step(self, step: StepEvent) -> None:
        self._lanes.of(step.stage, step.topic).add(
            step.time_ns, step.type or step.foot or step.kind
        )
        if self._stepping.get(step.topic, step.stage) != step.stage:
            return
        self._answered(step.time_ns)
        self._steps_ns.append(step.time_ns)
        self.close_ups.moments.step(step.time_ns)
        self._steps.add(step, self._traces.of_step(step))
        self._details.step(step)

    def _flush(self, before_ns: int | None) -> None:
        for detector in self._detectors.values():
            detector.flush(before_ns)
        self._details.flush(before_ns)
        self._lanes.flush(before_ns)
        self._picks.flush()
        self._steps.flush()
        self._losses.flush(before_ns)
        self._plain.flush(before_ns)
        self._lines.flush()
        for section in self._sections.values():
            section.flush()
        self._places.flush()

    def _show_close_ups(self, last_ns: int | None) -> None:
        self.close_ups.show(last_ns, self._signals, self._traces, self._details)

    def close(self) -> None:
        """Log everything pending."""
        for signal in self._signals.values():
            signal.close()
        for section in self._sections.values():
            section.advance()
        for spectrogram in self._spectrograms:
            spectrogram.close()
        self._show_close_ups(None)
        self._details.close()
        truth = any(x.kind == "step" for x in self._session.labels)
        if truth and self._stepping and self._replayed_ns is not None:
            found = verdicts(self._session, self._steps_ns, self._replayed_ns)
            log_verdicts(self.timeline, self._lines, found)
        self._flush(None)
        self._places.close()

    #: What is shown of every application alike; the parts show the other kinds.
    views: ClassVar[Views] = {
        SignalBlock: _signal,
        StageSpec: _stage,
        TraceBlock: _trace,
        CandidateBlock: _candidates,
        Pick: _pick,
        StepEvent: _step,
        Gap: _gap,
        Note: _note,
    }
