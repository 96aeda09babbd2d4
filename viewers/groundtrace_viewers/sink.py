"""The sink that turns a replay into a recording of the viewer, with its layout inside."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.errors import OutputError
from groundtrace_codecs.events import StageSpec
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .blueprint import blueprint
from .browse import serve_web
from .errors import ViewerError
from .full_rate import FullRate, planned
from .identity import stream_of
from .replay import Replay
from .serve import LOOPBACK, connect, data_url, free_port, open_viewer
from .timeline import TIMELINE

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Sequence

    import rerun as rr

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Event


#: What a viewer's file ends in (rerun 0.41), within so many bytes.
FOOTER, FOOTER_BYTES = b"RRF2FOOT", 64


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
        The process started by ``spawn`` or ``web``, else None.
    url
        Address of the page with ``web``, else empty.

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
        self.url = ""
        self._path = path
        self._spawn = spawn
        self._web = web
        self._port = port or free_port()
        self._channels = tuple(channels)
        self._full_rate = FullRate.parse(full_rate or ("all" if spawn else "misses"))
        self._map_tiles = map_tiles
        self._session: Session | None = None
        self._recording: rr.RecordingStream | None = None
        self._replay: Replay | None = None
        self._events: list[Event] = []

    def expected(self, session: Session) -> str:
        """Return what the timeline of a session will weigh, one line for people."""
        return planned(self._full_rate, session).words()

    @property
    def summary(self) -> str:
        """What is shown at full rate, for people; empty before anything is."""
        return self._replay.close_ups.words() if self._replay is not None else ""

    def open(self, session: Session) -> None:
        """Begin a replay.

        Raises
        ------
        ViewerError
            Where the viewer does not start.
        """
        recording = stream_of(session.name, session.application)
        recording.set_sinks(*self._sinks())
        self._session, self._recording = session, recording
        plan = planned(self._full_rate, session)
        self._replay = Replay(
            recording,
            session,
            plan,
            live=self._spawn,
            map_tiles=self._map_tiles,
            channels=self._channels,
        )
        if self._spawn:
            self._send_layout(follow=True)

    def _sinks(self) -> list[rr.FileSink | rr.GrpcSink]:
        import rerun as rr

        sinks: list[rr.FileSink | rr.GrpcSink] = []
        if self._path is not None:
            sinks.append(rr.FileSink(_growing(self._path)))
        if self._spawn:
            self.viewer = open_viewer(["--expect-data-soon"], self._port)
            sinks.append(rr.GrpcSink(data_url(self._port)))
        return sinks

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
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.disconnect()

    def close(self) -> None:
        """End the replay: write what is pending and the layout."""
        if self._recording is None or self._replay is None:
            return
        self._replay.close()
        self._send_layout(follow=False)
        recording, self._recording = self._recording, None
        if self._path is None:
            ended(recording, None)
        else:
            ended(recording, _growing(self._path), self._path)
            _growing(self._path).replace(self._path)
        if self._spawn:
            self._go_to_first_event()
        if self._web and self._path is not None and self._session is not None:
            from .moments import moments_of_session

            moments = moments_of_session(self._session, self._events, self._opens_ns)
            self.viewer = serve_web(self._path, self._port, moments)
            self.url = f"http://{LOOPBACK}:{self._port}"

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


def ended(recording: rr.RecordingStream, file: Path | None, path: Path | None = None) -> None:
    """End a stream, and see that its file is whole: a writer that fails does not always say so.

    Parameters
    ----------
    recording
        The stream.
    file
        What it writes; None where it only goes to a viewer.
    path
        How the user knows the file.

    Raises
    ------
    OutputError
        Where the file ends early, as on a full disk; it is removed.
    """
    trouble = None
    try:
        recording.flush()
    except RuntimeError as error:  # the thread that writes the file has died
        trouble = error
    recording.disconnect()
    if file is not None and not _is_whole(file):
        reason = _refusal(file)
        file.unlink(missing_ok=True)
        raise OutputError(path or file, reason) from trouble
    if trouble is not None:
        raise trouble


def _is_whole(file: Path) -> bool:
    """Tell whether a viewer's file has its footer, which is written last."""
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - FOOTER_BYTES))
        return FOOTER in stream.read()


def _refusal(file: Path) -> str:
    """Return why a file could not grow, as the system says when it is tried again."""
    try:
        with file.open("ab") as stream:
            stream.write(bytes(1 << 16))
    except OSError as error:
        return error.strerror or str(error)
    return "a file that ends early"


def _growing(path: Path) -> Path:
    """Return what a viewer's file is called while it is written."""
    return path.with_name(f"{path.name}.partial")
