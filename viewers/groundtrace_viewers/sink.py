"""The sink that turns a replay into a recording of the viewer, with its layout inside."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

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
from .blueprint import blueprint
from .detector import DetectorLog
from .errors import ViewerError
from .events import LogLines, LossLog, PickLog, StepLog, log_note, log_truth
from .palette import SensorColours
from .sensor_map import SensorMap, bounds
from .serve import LOOPBACK, connect, data_url, free_port, open_viewer, serve_web
from .signals import SignalLog
from .spectrogram import Spectrogram
from .timeline import TIMELINE, Timeline

if TYPE_CHECKING:
    import subprocess

    import rerun as rr

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Event

#: How much of the recording is collected before events are logged.
FLUSH_NS = 10 * NS_PER_S
LIVE_FLUSH_NS = NS_PER_S
#: Events may lag this far behind the signal.
LAG_NS = 5 * NS_PER_S
LIVE_CHUNK_S = 0.5


class Replay:
    """Logs one replay: hands every item to the part that knows it.

    Parameters
    ----------
    recording
        Where to.
    session
        What is replayed.
    live
        True where somebody watches: smaller chunks.
    """

    def __init__(self, recording: rr.RecordingStream, session: Session, *, live: bool) -> None:
        import rerun as rr

        duration_s = (session.end_ns - session.start_ns) / NS_PER_S
        self.timeline = Timeline(recording, session.start_ns)
        self.first_event_ns: int | None = None
        self._session = session
        self._colours = SensorColours(session)
        self._flush_every_ns = LIVE_FLUSH_NS if live else FLUSH_NS
        self._flushed_ns = session.start_ns
        self._chunk_s = LIVE_CHUNK_S if live else None
        self._signals = {
            s.topic: SignalLog(self.timeline, s, self._colours, self._chunk_s)
            for s in session.streams
        }
        tonal = next((s for s in session.streams if Spectrogram.fits(s)), None)
        self._spectrogram_topic = tonal.topic if tonal else ""
        self._spectrogram = Spectrogram(self.timeline, tonal, duration_s) if tonal else None
        self._detectors: dict[tuple[str, str], DetectorLog] = {}
        lines = LogLines(self.timeline)
        self._lines = lines
        self._picks = PickLog(self.timeline, self._colours, lines)
        self._steps = StepLog(self.timeline, lines)
        self._losses = LossLog(self.timeline, lines)
        mapped = bounds(session) is not None
        self._map = SensorMap(self.timeline, session, self._colours) if mapped else None
        log_truth(self.timeline, session.labels)
        self.timeline.static(PAGE, rr.TextDocument(about(session), media_type="text/markdown"))

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        match item:
            case SignalBlock():
                self._signal(item)
            case StageSpec():
                self._detector(item)
            case TraceBlock():
                self._detector(item.spec).trace(item)
            case CandidateBlock():
                self._detector(item.spec).candidates(item)
            case Pick() | StepEvent():
                self._single(item)
            case Gap():
                self._gap(item)
            case Note():
                log_note(self._lines, item, self.timeline.seconds(item.time_ns))

    def _signal(self, block: SignalBlock) -> None:
        if not len(block):
            return
        if block.topic not in self._signals:
            log = SignalLog(self.timeline, block.stream, self._colours, self._chunk_s)
            self._signals[block.topic] = log
        self._signals[block.topic].write(block)
        if self._spectrogram is not None and block.topic == self._spectrogram_topic:
            self._spectrogram.write(block)
        if block.last_ns - self._flushed_ns >= self._flush_every_ns:
            self._flushed_ns = block.last_ns
            self._flush(block.start_ns - LAG_NS)

    def _detector(self, spec: StageSpec) -> DetectorLog:
        key = (spec.stage, spec.topic)
        if key not in self._detectors:
            span_ns = (self._session.start_ns, self._session.end_ns)
            self._detectors[key] = DetectorLog(self.timeline, spec, self._colours, span_ns)
        return self._detectors[key]

    def _gap(self, gap: Gap) -> None:
        self._losses.add(gap)
        for (_, topic), detector in self._detectors.items():
            if topic == gap.topic and not gap.bridged:
                detector.interrupt(gap.start_ns)

    def _single(self, event: Pick | StepEvent) -> None:
        if self.first_event_ns is None or event.time_ns < self.first_event_ns:
            self.first_event_ns = event.time_ns
        if isinstance(event, StepEvent):
            self._steps.add(event)
            return
        self._picks.add(event)
        if self._map is not None:
            self._map.arrival(event.time_ns, event.channel)

    def _flush(self, before_ns: int | None) -> None:
        for detector in self._detectors.values():
            detector.flush(before_ns)
        self._picks.flush()
        self._steps.flush(before_ns)
        self._losses.flush(before_ns)
        self._lines.flush()
        if self._map is not None:
            self._map.flush()

    def close(self) -> None:
        """Log everything pending."""
        for signal in self._signals.values():
            signal.close()
        if self._spectrogram is not None:
            self._spectrogram.close()
        self._flush(None)


class RerunSink:
    """Shows a replay on a Rerun timeline: in a file, in the native viewer or in a browser.

    Parameters
    ----------
    path
        The ``.rrd`` to write; the layout is inside. May be None with ``spawn`` or ``web``.
    spawn
        Start the native viewer and show the replay while it runs.
    web
        When the replay ends, serve it to browsers on this machine; :attr:`url` says where.
    port
        Of the viewer's data server (``spawn``) or of the page (``web``); 0 chooses a free one.

    Attributes
    ----------
    viewer
        The process started by ``spawn`` or ``web``, else None.
    url
        Address of the page with ``web``, else empty.

    Raises
    ------
    ViewerError
        Where neither a path nor a viewer is given.
    """

    def __init__(
        self, path: Path | None = None, *, spawn: bool = False, web: bool = False, port: int = 0
    ) -> None:
        if path is None and not spawn and not web:
            raise ViewerError("viewer: expected a file, spawn or web, found none of them")
        if path is None and web:
            path = Path(tempfile.mkdtemp(prefix="groundtrace-")) / "replay.rrd"
        self.viewer: subprocess.Popen[bytes] | None = None
        self.url = ""
        self._path = path
        self._spawn = spawn
        self._web = web
        self._port = port or free_port()
        self._session: Session | None = None
        self._recording: rr.RecordingStream | None = None
        self._replay: Replay | None = None

    def open(self, session: Session) -> None:
        """Begin a replay.

        Raises
        ------
        ViewerError
            Where the viewer does not start.
        """
        import rerun as rr

        name = hashlib.sha256(session.name.encode()).hexdigest()[:16]
        recording = rr.RecordingStream(
            f"groundtrace-{session.application}", recording_id=name, send_properties=False
        )
        recording.set_sinks(*self._sinks())
        self._session, self._recording = session, recording
        self._replay = Replay(recording, session, live=self._spawn)
        if self._spawn:
            self._send_layout(follow=True)

    def _sinks(self) -> list[rr.FileSink | rr.GrpcSink]:
        import rerun as rr

        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if self._path is not None:
            sinks.append(rr.FileSink(self._path))
        if self._spawn:
            self.viewer = open_viewer(["--expect-data-soon"], self._port)
            sinks.append(rr.GrpcSink(data_url(self._port)))
        return sinks

    def _send_layout(self, *, follow: bool) -> None:
        if self._recording is not None and self._session is not None and self._replay is not None:
            entities = self._replay.timeline.entities
            self._recording.send_blueprint(blueprint(self._session, entities, follow=follow))

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event, in time order."""
        if self._replay is None:
            raise ViewerError("viewer: expected open() before write(), found none")
        self._replay.write(item)
        if self._spawn and isinstance(item, StageSpec):
            self._send_layout(follow=True)

    def close(self) -> None:
        """End the replay: write what is pending and the layout."""
        if self._recording is None or self._replay is None:
            return
        self._replay.close()
        self._send_layout(follow=False)
        self._recording.flush()
        self._recording.disconnect()
        self._recording = None
        if self._spawn:
            self._go_to_first_event()
        if self._web and self._path is not None:
            self.viewer = serve_web(self._path, self._port)
            self.url = f"http://{LOOPBACK}:{self._port}"

    def _go_to_first_event(self) -> None:
        """Pause at the first event; a file's layout cannot hold a cursor, a viewer's can be set."""
        first_ns = self._replay.first_event_ns if self._replay is not None else None
        if self.viewer is None or self._session is None or first_ns is None:
            return
        client = connect(self.viewer, self._port)
        since_s = (first_ns - self._session.start_ns) / NS_PER_S
        client.set_time(TIMELINE, duration=since_s, play_state="paused")
