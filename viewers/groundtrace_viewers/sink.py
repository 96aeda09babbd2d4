"""The sink that turns a replay into a recording of the viewer, with its layout inside."""

from __future__ import annotations

import os
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.appearing import room_for
from groundtrace.errors import OutputError
from groundtrace_codecs.events import StageSpec
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .blueprint import blueprint
from .errors import ViewerError
from .full_rate import FullRate, planned
from .identity import stream_of
from .replay import Replay
from .serve import connect, data_url, free_port, open_viewer
from .timeline import TIMELINE

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Sequence
    from io import FileIO

    import rerun as rr

    from groundtrace.sinks import Session
    from groundtrace_codecs.events import Event

    from .moments import Moments


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
        :attr:`moments`, which :func:`~.browse.serve_replay` serves.
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
        self._session: Session | None = None
        self._recording: rr.RecordingStream | None = None
        self._outlet: Outlet | None = None
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
    def moments(self) -> Moments:
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
