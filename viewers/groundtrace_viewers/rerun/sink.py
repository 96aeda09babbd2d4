"""The sink that turns a replay into a recording of the viewer, with its layout inside.

Steps, and steps that were missed or are false, are shown with every sample. They are found during
the replay, from the truth and the detections some seconds behind the signal, so that memory does
not grow with the recording.
"""

from __future__ import annotations

import os
import tempfile
import threading
from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from groundtrace.errors import OutputError
from groundtrace.localizers.base import LocalizerParameters
from groundtrace.pipeline.results import room_for
from groundtrace_codecs.events import (
    Bearing,
    CandidateBlock,
    Gap,
    Note,
    Pick,
    StageSpec,
    StepEvent,
    TraceBlock,
)
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..errors import ViewerError
from .annotations import log_annotations
from .blueprint import blueprint
from .decisions import (
    DetectorView,
    LogLines,
    LossView,
    PickerCurve,
    PickView,
    PlainView,
    StepView,
    lane_labels,
    log_note,
    log_truth,
    log_verdicts,
    step_like,
    verdicts,
)
from .places import Places
from .process import connect, data_url, free_port, open_viewer
from .signals import REACH_NS, FullRate, SignalView, Traces, planned
from .site import ApplicationViews, Section
from .spectrogram import LEAST_RATE_HZ, SpectrumViews, spectrograms
from .stations import StationViews
from .timeline import (
    PAGE,
    SPAN,
    TIMELINE,
    TRUTH_LANES,
    Lane,
    SensorColours,
    StageLanes,
    Timeline,
    about,
    stream_of,
    used,
)
from .vehicles import TOLD, Vehicles
from .walk import Walk

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterable, Mapping, Sequence
    from io import FileIO

    import rerun as rr

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import Stream

    from .moments import PageMoments as moments_Moments
    from .places import RegionView
    from .signals import Plan
    from .site import Bounds, SensorMap, Views

#: What is taken from the viewer's pipe at once, at most.
PIECE_BYTES = 1 << 20


class RerunSink:
    """Shows a replay on a Rerun timeline: in a file, in the native viewer, or for a browser's page.

    Parameters
    ----------
    path
        The ``.rrd`` to write; the layout is inside. May be None with ``spawn`` or ``web``.
    spawn
        Start the native viewer and show the replay while it runs.
    web
        Keep what a page needs that shows the replay when it has ended: its file and its
        :attr:`moments`, which :func:`~.web.browse.serve_replay` serves.
    port
        Of the viewer's data server (``spawn``); 0 chooses a free one.
    channels
        Whose spectrograms are shown; empty takes the first seismic channel's.
    full_rate
        What is shown at full rate of fast streams: ``none``, ``misses``, ``events``, ``all`` or
        FROM-TO in seconds; empty is ``all`` with ``spawn``, else ``misses``.
    map_tiles
        Show positions on a street map too, whose tiles the viewer loads from the internet.

    Attributes
    ----------
    viewer
        The process started by ``spawn``, else None.
    path
        The ``.rrd``, a temporary one with ``web`` where none was given; else None.

    Raises
    ------
    ViewerError
        Where neither a path nor a viewer is given, or ``full_rate`` is something else.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        spawn: bool = False,
        web: bool = False,
        port: int = 0,
        channels: Sequence[str] = (),
        full_rate: str = "",
        map_tiles: bool = False,
    ) -> None:
        if path is None and not spawn and not web:
            raise ViewerError("viewer: expected a file, spawn or web, found none of them")
        if path is None and web:
            path = Path(tempfile.mkdtemp(prefix="groundtrace-")) / "replay.rrd"
        self.viewer: subprocess.Popen[bytes] | None = None
        self.path = path
        self._spawn = spawn
        self._web = web
        self._port = port or free_port()
        self._channels = tuple(channels)
        self._full_rate = FullRate.parse(full_rate or ("all" if spawn else "misses"))
        self._map_tiles = map_tiles
        self._session: ReplaySession | None = None
        self._recording: rr.RecordingStream | None = None
        self._outlet: Outlet | None = None
        self._replay: TimelineReplay | None = None
        self._events: list[Event] = []

    def expected(self, session: ReplaySession) -> str:
        """Return what the timeline of a session will weigh, one line for people."""
        return planned(self._full_rate, session).words()

    @property
    def summary(self) -> str:
        """What is shown at full rate, for people; empty before anything is."""
        return self._replay.close_ups.words() if self._replay is not None else ""

    def open(self, session: ReplaySession) -> None:
        """Begin a replay.

        Raises
        ------
        ViewerError
            Where the viewer does not start.
        """
        import rerun as rr

        recording = stream_of(session.name, session.application)
        viewers = []
        if self._spawn:
            self.viewer = open_viewer(["--expect-data-soon"], self._port)
            viewers.append(rr.GrpcSink(data_url(self._port)))
        growing = _growing(self.path) if self.path is not None else None
        self._outlet = Outlet(recording, growing, *viewers, name=self.path)
        self._session, self._recording = session, recording
        plan = planned(self._full_rate, session)
        self._replay = TimelineReplay(
            recording,
            session,
            plan,
            live=self._spawn,
            map_tiles=self._map_tiles,
            channels=self._channels,
        )
        if self._spawn:
            self._send_layout(follow=True)

    def _send_layout(self, *, follow: bool) -> None:
        if self._recording is not None and self._session is not None and self._replay is not None:
            entities = self._replay.timeline.entities
            layout = blueprint(self._session, entities, self._replay.shown, follow=follow)
            self._recording.send_blueprint(layout)

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event, in time order."""
        if self._replay is None:
            raise ViewerError("viewer: expected open() before write(), found none")
        self._replay.write(item)
        if self._web and not isinstance(item, SignalBlock):
            self._events.append(item)
        if self._spawn and isinstance(item, StageSpec):
            self._send_layout(follow=True)

    def abandon(self) -> None:
        """End without giving the file its name: what was written stays in NAME.partial."""
        outlet, self._outlet = self._outlet, None
        if outlet is not None:
            outlet.end()

    def close(self) -> None:
        """End the replay: write what is pending and the layout."""
        outlet, self._outlet = self._outlet, None
        if outlet is None or self._replay is None:
            return
        self._replay.close()
        self._send_layout(follow=False)
        outlet.finish()
        if self.path is not None:
            _growing(self.path).replace(self.path)
        if self._spawn:
            self._go_to_first_event()

    @property
    def moments(self) -> moments_Moments:
        """What a page of the replay can jump to; with ``web``, once it has ended.

        Raises
        ------
        ViewerError
            Before a replay, or without ``web``.
        """
        from .moments import moments_of_session

        if self._session is None or not self._web:
            raise ViewerError("viewer: expected a replay for the web, found none")
        return moments_of_session(self._session, self._events, self._opens_ns)

    @property
    def _opens_ns(self) -> int | None:
        """Where a page opens [ns]; None stands for the first event."""
        return None

    def _go_to_first_event(self) -> None:
        """Pause at the first event; a file's layout cannot hold a cursor, a viewer's can be set."""
        first_ns = self._replay.first_event_ns if self._replay is not None else None
        if self.viewer is None or self._session is None or first_ns is None:
            return
        client = connect(self.viewer, self._port)
        since_s = (first_ns - self._session.start_ns) / NS_PER_S
        client.set_time(TIMELINE, duration=since_s, play_state="paused")


class Outlet:
    """Where a stream of the viewer goes: into a file, to a viewer, or both.

    Where the disk is full, the thread by which the viewer writes files ends, and what waits for it
    waits for ever (rerun 0.41). So the viewer writes into a pipe that takes all there is, and a
    thread of ours writes the file.

    Parameters
    ----------
    recording
        The stream.
    path
        The file; None where there is none.
    viewers
        Where else it goes.
    name
        How the user knows the file; None is ``path``.

    Raises
    ------
    OutputError
        Where the file cannot be begun.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        path: Path | None,
        *viewers: rr.GrpcSink,
        name: Path | None = None,
    ) -> None:
        import rerun as rr

        self._recording = recording
        self._path, self._name = path, name or path
        self._refused: OSError | None = None
        self._writer: threading.Thread | None = None
        if path is None:
            recording.set_sinks(*viewers)
            return
        with room_for(name or path, path):
            file = path.open("wb", buffering=0)
        with tempfile.TemporaryDirectory(prefix="groundtrace-") as folder:
            pipe = Path(folder) / "recording.rrd"
            os.mkfifo(pipe)
            end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # before anybody writes
            recording.set_sinks(rr.FileSink(pipe), *viewers)
        os.set_blocking(end, True)
        copied = (os.fdopen(end, "rb", buffering=0), file)
        self._writer = threading.Thread(target=self._copy, args=copied, daemon=True)
        self._writer.start()

    def _copy(self, pipe: FileIO, file: FileIO) -> None:
        with pipe, file:
            while piece := pipe.read(PIECE_BYTES):
                rest = memoryview(piece if self._refused is None else b"")
                try:
                    while rest:
                        rest = rest[file.write(rest) :]
                except OSError as error:
                    self._refused = error

    def end(self) -> None:
        """End the stream; a file stays as far as it came."""
        self._recording.disconnect()
        if self._writer is not None:
            self._writer.join()

    def finish(self) -> None:
        """End the stream when all of it has arrived.

        Raises
        ------
        OutputError
            Where a file could not be written whole, as on a full disk; it is removed.
        """
        self._recording.flush()
        self.end()
        if self._refused is not None and self._path is not None and self._name is not None:
            self._path.unlink(missing_ok=True)
            raise OutputError(self._name, self._refused.strerror) from self._refused


def _growing(path: Path) -> Path:
    """Return what a viewer's file is called while it is written."""
    return path.with_name(f"{path.name}.partial")


#: How much of the recording is collected before events are logged.
FLUSH_NS = 10 * NS_PER_S
LIVE_FLUSH_NS = NS_PER_S
#: Events may lag this far behind the signal.
LAG_NS = 5 * NS_PER_S
LIVE_LAG_NS = REACH_NS + NS_PER_S // 20
LIVE_CHUNK_S = 0.5


class TimelineReplay:
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
        session: ReplaySession,
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
        self._signals: dict[str, SignalView] = {}
        self._sections: dict[str, Section] = {}
        self._traces = Traces()
        for stream in session.streams:
            self._begin(stream)
        self._spectrogram_topic, self._spectrograms = spectrograms(
            self.timeline, session, plan, channels
        )
        self._detectors: dict[tuple[str, str], DetectorView] = {}
        self._picking: dict[str, str] = {}
        self._stepping: dict[str, str] = {}
        self._steps_ns: list[int] = []
        lines = LogLines(self.timeline)
        self._lines = lines
        self._lanes = StageLanes(self.timeline, ordered=True)
        self._picks = PickView(self.timeline, self._colours, lines)
        self._steps = StepView(self.timeline, lines)
        self._losses = LossView(self.timeline, lines)
        self._plain = PlainView(self.timeline, lines)
        self._places = Places(self.timeline, session, self._colours, lines)
        self._details = application_views(
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
        log_truth(self.timeline, lane_labels(session), TRUTH_LANES)
        log_annotations(self.timeline, lines, session.annotations)
        self.timeline.static(PAGE, rr.TextDocument(about(session), media_type="text/markdown"))

    @property
    def shown(self) -> Bounds | None:
        """What the map must show, as far as is known by now; None without a map."""
        return self._details.bounds or self._places.shown

    def _begin(self, stream: Stream) -> None:
        """Prepare for a stream."""
        topic = stream.topic
        self._signals[topic] = SignalView(
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

    def _detector(self, spec: StageSpec) -> DetectorView:
        key = (spec.stage, spec.topic)
        if key not in self._detectors:
            session = self._session
            span_ns = session.shown_ns or (session.start_ns, session.end_ns)
            drawn = replace(spec, trace=()) if self._details.draws(spec) else spec
            lanes = None if self._details.tells(spec) else self._lanes
            self._detectors[key] = DetectorView(self.timeline, drawn, self._colours, lanes, span_ns)
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


#: What is lit at a step goes out after this, or with the next step [ns].
LIT_NS = NS_PER_S // 2
#: Signal that must have come before what lies around a step is complete [ns].
COMPLETE_NS = NS_PER_S * 7 // 20
#: So many arrivals are remembered: a step is announced when a later arrival closes its window.
MOST_PICKS = 1024
#: The plugin that locates by regions.
BY_SIGNS = "so-tdoa"


@dataclass(frozen=True, slots=True)
class PendingStep:
    """A step that waits for its signal, and for arrivals that are refined after it is found."""

    time_ns: int
    topic: str


class StepDetailLog(ApplicationViews):
    """Logs everything that belongs to single steps.

    Parameters
    ----------
    timeline
        Where to.
    session
        What is replayed.
    colours
        Of the sensors.
    site
        The map, or None.
    channels
        Whose spectrograms are wanted; empty takes the first seismic channel's.
    close
        Whether anything is shown at every sample.
    """

    def __init__(
        self,
        timeline: Timeline,
        session: ReplaySession,
        colours: SensorColours,
        site: SensorMap | None,
        channels: Sequence[str] = (),
        *,
        close: bool = True,
    ) -> None:
        self._timeline = timeline
        self._session = session
        self._colours = colours
        self._close = close
        self._window_s = LocalizerParameters().window_s
        self._picks: deque[Pick] = deque(maxlen=MOST_PICKS)
        self._due: deque[PendingStep] = deque()
        self._lit_ns: int | None = None
        self._curves: list[PickerCurve] = []
        self._regions: RegionView | None = None
        self._picking: StageSpec | None = None
        self._signs = site.names if site is not None else None
        self._stations: dict[str, StationViews] = {}
        self._spectra: dict[str, SpectrumViews] = {}
        for stream in session.streams:
            self._begin(stream, channels)

    def _begin(self, stream: Stream, channels: Sequence[str]) -> None:
        if stream.irregular or not stream.columns_of(SEISMIC_QUANTITIES):
            return
        site = self._session.geometry
        if site is not None and StationViews.fits(stream, site):
            views = StationViews(self._timeline, stream, site, self._colours)
            self._stations[stream.topic] = views
        fine = self._close and stream.rate_hz >= LEAST_RATE_HZ
        if fine and (channels or not self._spectra):
            self._spectra[stream.topic] = SpectrumViews(self._timeline, stream, channels)

    def stage(self, spec: StageSpec, colour: int) -> None:
        """Take a stage; ``colour`` is that of its places."""
        if spec.emits == "pick":
            self._picking = spec
            if spec.trace and self._close:
                curve = PickerCurve(self._timeline, self._session, spec, self._colours)
                self._curves.append(curve)
        elif spec.plugin == BY_SIGNS and self._regions is None:
            self._begin_regions(spec, colour)

    def _begin_regions(self, spec: StageSpec, colour: int) -> None:
        # shapely takes a while to load, and only regions need it
        from .places import RegionView

        geometry, picking = self._session.geometry, self._picking
        if geometry is None or picking is None or not RegionView.fits(geometry, picking):
            return
        found = used(self._session, spec)
        window_s = found.parameters.window_s if found is not None else self._window_s
        self._regions = RegionView(self._timeline, geometry, picking, window_s, colour)

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        for curve in self._curves:
            curve.feed(block)
        if block.topic in self._stations:
            self._stations[block.topic].signal(block)
        if block.topic in self._spectra:
            self._spectra[block.topic].signal(block)
        while self._due and self._due[0].time_ns + COMPLETE_NS <= block.last_ns:
            self._show(self._due.popleft())

    def gap(self, gap: Gap) -> None:
        """Take a gap."""
        for curve in self._curves:
            curve.feed(gap)

    def pick(self, pick: Pick) -> None:
        """Take an arrival."""
        self._picks.append(pick)
        for curve in self._curves:
            curve.expect(pick.time_ns)
        for views in (self._stations, self._spectra):
            if pick.topic in views:
                views[pick.topic].expect(pick.time_ns)

    def expect(self, time_ns: int) -> None:
        """Take a true step, which may be missed."""
        for curve in self._curves:
            curve.expect(time_ns)
        for spectra in self._spectra.values():
            spectra.expect(time_ns)

    def near(self, time_ns: int) -> None:
        """Show decision functions and spectra at every sample around a moment."""
        for curve in self._curves:
            curve.show(time_ns)
        for spectra in self._spectra.values():
            spectra.show(time_ns)

    def step(self, step: StepEvent) -> None:
        """Take a step: what there is to say of it is shown when its signal is complete."""
        self._due.append(PendingStep(step.time_ns, step.topic))

    def bearing(self, bearing: Bearing) -> None:
        """Take a bearing; it comes with its step."""
        for views in self._stations.values():
            views.bearing(bearing)

    def close(self) -> None:
        """Show the last steps."""
        while self._due:
            self._show(self._due.popleft())
        if self._lit_ns is not None:
            self._put_out(self._lit_ns + LIT_NS)
        self.flush()

    def flush(self, before_ns: int | None = None) -> None:  # noqa: ARG002
        """Log what is pending."""
        if self._regions is not None:
            self._regions.flush()
        for views in self._stations.values():
            views.flush()

    def _show(self, due: PendingStep) -> None:
        if self._lit_ns is not None and self._lit_ns + LIT_NS < due.time_ns:
            self._put_out(self._lit_ns + LIT_NS)
        self._lit_ns = due.time_ns
        picks = self._picks_of(due)
        if self._signs is not None:
            self._signs.step(due.time_ns, picks)
        if self._regions is not None:
            self._regions.step(due.time_ns, picks)
        if due.topic in self._stations:
            self._stations[due.topic].step(due.time_ns, picks)

    def _picks_of(self, due: PendingStep) -> list[Pick]:
        """Return the arrivals of a step, of the stage that has the last word on them."""
        end_ns = due.time_ns + round(self._window_s * NS_PER_S)
        stage = self._picking.stage if self._picking is not None else ""
        return [
            p
            for p in self._picks
            if due.time_ns <= p.time_ns <= end_ns and (p.topic, p.stage) == (due.topic, stage)
        ]

    def _put_out(self, time_ns: int) -> None:
        if self._signs is not None:
            self._signs.clear(time_ns)
        if self._regions is not None:
            self._regions.clear(time_ns)
        for views in self._stations.values():
            views.clear(time_ns)

    views: ClassVar[Views] = {Bearing: bearing}


#: The parts that show events, each in its application or in all.
PARTS = (Places, StepDetailLog, Vehicles, Walk)


def viewed(kind: type[Any]) -> bool:
    """Whether some part has a view of a kind of event."""
    return any(kind in part.views for part in PARTS)


def application_views(
    timeline: Timeline,
    session: ReplaySession,
    colours: SensorColours,
    sensors: SensorMap | None,
    lanes: StageLanes,
    lines: LogLines,
    channels: Sequence[str],
    *,
    close: bool,
    tiles: bool,
) -> ApplicationViews:
    """Return the part of a session's application.

    Parameters
    ----------
    timeline, session, colours
        As everywhere.
    sensors
        The map, or None.
    lanes, lines
        Of the stages, and of the log.
    channels
        Whose spectrograms are wanted; empty takes the first seismic channel's.
    close
        Whether anything is shown at every sample.
    tiles
        Whether a street map is asked for.
    """
    match session.application:
        case "room":
            return StepDetailLog(timeline, session, colours, sensors, channels, close=close)
        case "vehicle":
            return Vehicles(timeline, session, colours, lanes, lines)
    return Walk(timeline, session, tiles=tiles)


#: Steps are matched to the truth with so much of both around them [ns].
MARGIN_NS = NS_PER_S
#: How often moments are looked for [ns], while nobody watches.
EVERY_NS = 2 * NS_PER_S
#: Moments this close to each other are one [ns].
SAME_NS = NS_PER_S // 20
#: Close-ups at the beginning may take this part of what all may: the rest is spread over time.
AT_ONCE = 0.25
LANE = "/state/8-full-rate"


class CloseUpTimes:
    """Finds the moments of a session as its steps come.

    Parameters
    ----------
    plan
        What is shown at full rate.
    session
        Gives the truth.
    lag_ns
        Steps may come this long after their signal [ns].
    """

    def __init__(self, plan: Plan, session: ReplaySession, lag_ns: int) -> None:
        self._plan = plan
        self._lag_ns = lag_ns
        self._every_ns = min(EVERY_NS, lag_ns)
        steps = sorted(x for x in session.labels if x.kind == "step")
        self._true, self._true_ns = steps, [x.time_ns for x in steps]
        spans = tuple(x for x in session.labels if x.kind in ("walking", "ignore"))
        self._session = replace(session, labels=spans)
        self._steps: list[int] = []
        self._late: list[int] = []
        self._reached_ns = (session.shown_ns or (session.start_ns, 0))[0]
        self._passed = 0
        self._judged = False

    def judge(self) -> None:
        """Say that a stage detects steps, which can be missed."""
        self._judged = bool(self._true)

    def step(self, time_ns: int) -> None:
        """Take a detected step."""
        if time_ns < self._reached_ns:
            self._late.append(time_ns)
        else:
            self._steps.append(time_ns)

    def passed(self, last_ns: int) -> list[int]:
        """Return the true steps that the signal has come past since this was asked before."""
        first, self._passed = self._passed, bisect_right(self._true_ns, last_ns)
        return self._true_ns[first : self._passed]

    def ready(self, last_ns: int | None) -> list[int]:
        """Return the moments that can be told now that the signal came so far; None is the end."""
        if last_ns is None:
            until = max([self._reached_ns, *self._steps, *self._true_ns[: self._passed][-1:]]) + 1
        else:
            until = last_ns - self._lag_ns
            if until - self._reached_ns < self._every_ns:
                return []
        found = self._between(self._reached_ns, until)
        late = self._late if self._chosen("step") else []
        self._reached_ns, self._late = until, []
        self._steps = [t for t in self._steps if t >= until - MARGIN_NS]
        return _apart(sorted([*late, *found]))

    def _between(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the moments of a half-open span."""
        if not self._judged:
            steps = self._steps if self._chosen("step") else []
            return [t for t in steps if start_ns <= t < end_ns]
        reach = start_ns - MARGIN_NS, end_ns + MARGIN_NS
        first, last = bisect_left(self._true_ns, reach[0]), bisect_left(self._true_ns, reach[1])
        labels = (*self._session.labels, *self._true[first:last])
        near = [t for t in self._steps if reach[0] <= t < reach[1]]
        found = verdicts(replace(self._session, labels=labels), near, reach)
        judged = [one.time_ns for one in found if self._chosen(one.verdict)]
        steps = near if self._chosen("step") else []
        return [t for t in (*judged, *steps) if start_ns <= t < end_ns]

    def _chosen(self, what: str) -> bool:
        """Whether something is a moment; without a judgement events stand for misses."""
        mode = self._plan.mode
        if what == "step":
            return mode in ("all", "span", "events") or (mode == "misses" and not self._judged)
        return what == "missed" or (what == "false" and mode == "misses")


def _apart(moments: Iterable[int]) -> list[int]:
    """Return moments without those that follow another at once."""
    kept: list[int] = []
    for time_ns in moments:
        if not kept or time_ns - kept[-1] >= SAME_NS:
            kept.append(time_ns)
    return kept


class CloseUps:
    """Shows every sample around moments.

    Parameters
    ----------
    timeline
        Where to.
    plan
        What is shown at full rate.
    session
        What is replayed.
    lag_ns
        Steps may come this long after their signal [ns].

    Attributes
    ----------
    shown, left_out
        Number of moments that have their samples, and that would have taken too much.
    """

    def __init__(self, timeline: Timeline, plan: Plan, session: ReplaySession, lag_ns: int) -> None:
        self.moments = CloseUpTimes(plan, session, lag_ns)
        self.shown = self.left_out = 0
        self._plan = plan
        self._lane = Lane(timeline, LANE, {"every sample": SPAN})
        self._span_ns = session.shown_ns or (session.start_ns, session.end_ns + 1)
        self._shown_to_ns = self._span_ns[0]
        self._spent_bytes = 0.0

    def show(
        self,
        last_ns: int | None,
        signals: Mapping[str, SignalView],
        traces: Traces,
        details: ApplicationViews,
    ) -> None:
        """Show what can be told now that the signal came so far; None is the end."""
        if self._plan.mode == "none":
            return
        if last_ns is not None:
            for time_ns in self.moments.passed(last_ns):
                details.expect(time_ns)
        for time_ns in self.moments.ready(last_ns):
            if not self._plan.close_ups or self._show_around(time_ns, signals, traces):
                details.near(time_ns)
        self._lane.flush(None if last_ns is None else self._shown_to_ns - 2 * REACH_NS)

    def words(self) -> str:
        """Return what is shown at full rate."""
        plan = self._plan
        if not plan.close_ups:
            return plan.shown
        count = f"{self.shown} of {self.shown + self.left_out}" if self.left_out else self.shown
        return f"every sample around {count} {plan.subject}"

    def _show_around(self, time_ns: int, signals: Mapping[str, SignalView], traces: Traces) -> bool:
        """Show the samples around a moment, unless they would take too much."""
        start_ns = max(time_ns - REACH_NS, self._shown_to_ns)
        end_ns = min(time_ns + REACH_NS, self._span_ns[1])
        cost = max(0, end_ns - start_ns) / NS_PER_S * self._plan.second_bytes
        if self._spent_bytes + cost > self._allowed(time_ns):
            self.left_out += 1
            return False
        self.shown += 1
        if start_ns < end_ns:
            self._spent_bytes += cost
            self._shown_to_ns = end_ns
            self._lane.add(start_ns, "every sample", end_ns)
            for topic, log in signals.items():
                log.close_up(traces.between(topic, start_ns, end_ns))
        return True

    def _allowed(self, time_ns: int) -> float:
        """Return what close-ups up to a time may take: the recording's end gets its part."""
        if self._plan.mode == "events":
            return np.inf
        start_ns, end_ns = self._span_ns
        elapsed = (time_ns - start_ns) / max(1, end_ns - start_ns)
        return self._plan.budget_bytes * max(AT_ONCE, min(1.0, elapsed))
