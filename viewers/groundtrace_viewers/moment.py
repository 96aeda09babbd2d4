"""Recordings of the viewer that are about one moment: it opens there, its cursor on it.

A file cannot hold a cursor (rerun 0.41), a running viewer's can be set.
"""

from __future__ import annotations

import hashlib
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from groundtrace.appearing import appearing
from groundtrace_codecs.signals import NS_PER_S

from .errors import ViewerError
from .serve import connect, data_url, free_port, open_viewer
from .sink import Outlet, RerunSink
from .timeline import TIMELINE

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterator
    from pathlib import Path

    import rerun as rr

    from groundtrace.sinks import Session


@contextmanager
def recording_at(
    application: str, name: str, path: Path | None, *, spawn: bool, at_s: float | None
) -> Iterator[rr.RecordingStream]:
    """Open a recording that goes to a file, to a viewer started for it, or to both.

    Parameters
    ----------
    application
        Application id.
    name
        What it is about; the same name gives the same recording id.
    path
        The ``.rrd`` to write, or None.
    spawn
        Start the native viewer.
    at_s
        Where the started viewer's cursor is put in the end, since the first sample [s].

    Raises
    ------
    ViewerError
        Where neither a path nor a viewer is given, or the viewer does not start.
    """
    import rerun as rr

    if path is None and not spawn:
        raise ViewerError("viewer: expected a file or spawn, found none of them")
    identity = hashlib.sha256(name.encode()).hexdigest()[:16]
    recording = rr.RecordingStream(application, recording_id=identity, send_properties=False)
    port = free_port()
    viewer = open_viewer(["--expect-data-soon"], port) if spawn else None
    shown = [rr.GrpcSink(data_url(port))] if spawn else []
    with nullcontext() if path is None else appearing(path) as fresh:
        outlet = Outlet(recording, fresh, *shown, name=path)
        try:
            yield recording
            outlet.finish()
        except BaseException:
            outlet.end()
            if viewer is not None:
                viewer.terminate()
            raise
    if viewer is not None and at_s is not None:
        put_cursor(viewer, port, at_s)


def put_cursor(viewer: subprocess.Popen[bytes], port: int, at_s: float) -> None:
    """Pause a running viewer at a time since the first sample [s]."""
    connect(viewer, port).set_time(TIMELINE, duration=at_s, play_state="paused")


class MomentSink(RerunSink):
    """Shows a replay as :class:`RerunSink` does; a started viewer ends up at a given moment.

    Parameters
    ----------
    path, spawn, web
        As of :class:`RerunSink`.
    at_ns
        The moment [ns].
    """

    def __init__(
        self, path: Path | None = None, *, at_ns: int, spawn: bool = False, web: bool = False
    ) -> None:
        port = free_port()
        super().__init__(path, spawn=spawn, web=web, port=port, full_rate="all")
        self._data_port = port
        self._at_ns = at_ns
        self._start_ns = 0

    def open(self, session: Session) -> None:
        """Begin a replay."""
        self._start_ns = session.start_ns
        super().open(session)

    @property
    def _opens_ns(self) -> int | None:
        return self._at_ns

    def close(self) -> None:
        """End the replay, and go to the moment."""
        super().close()
        if self._spawn and self.viewer is not None:
            put_cursor(self.viewer, self._data_port, (self._at_ns - self._start_ns) / NS_PER_S)
