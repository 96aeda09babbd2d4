"""Showing a recording in a browser on this machine: starts the page's server."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from groundtrace.pipeline.results import atomic_write
from groundtrace.scratch import scratch_folder_until_exit

from ..errors import ViewerError
from ..rerun.moments import OPENING_S, LiveMoments
from ..rerun.process import fetch, free_port, quiet_environment
from .opening import drawn_meanwhile
from .server import address, new_token

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock

    from ..rerun.moments import PageMoments
    from ..rerun.sink import RerunSink

#: How often a page is told what is new [s]. Chosen by judgement: its list, not its picture.
TELL_S = 0.5


def serve_replay(shown: RerunSink, recording: Path) -> tuple[str, subprocess.Popen[bytes]]:
    """Serve a replay that has ended, taken for the web, to browsers on this machine.

    Parameters
    ----------
    shown
        The replay.
    recording
        What was replayed.

    Returns
    -------
    The address of its page, and the server, which serves until it is terminated.

    Raises
    ------
    ViewerError
        Where there is no such replay, or the page does not come up.
    """
    if shown.path is None:
        raise ViewerError("page: expected a replay with a file, found none")
    port, token = free_port(), new_token()
    first = shown.moments_within(OPENING_S)
    options = {"opening": drawn_meanwhile(shown.decided, recording, first.opens_s)}
    if first.pending:
        moments_file = MomentsFile()
        moments_file.ended(first, shown)
        options["moments"] = moments_file.path
    return address(port, token), _served(shown.path, port, token, first.json(), **options)


class MomentsFile:
    """The moments that a page asks for again while there may be more of them.

    Attributes
    ----------
    path
        Whole at any moment.
    """

    def __init__(self) -> None:
        self.path = scratch_folder_until_exit() / "moments.json"

    def tell(self, moments: PageMoments) -> None:
        """Replace what the page asks for."""
        with atomic_write(self.path) as fresh:
            fresh.write_bytes(moments.json())

    def ended(self, first: PageMoments, shown: RerunSink) -> None:
        """Tell those of a replay that has ended: the first, and all when they are there."""
        self.tell(first)
        if first.pending:
            threading.Thread(target=lambda: self.tell(shown.moments), daemon=True).start()


class LivePage:
    """A sink that shows a replay in browsers on this machine while it runs.

    Parameters
    ----------
    shown
        Taken for the web; its file is what the page shows.
    report
        Told the page's address when it is up.

    Attributes
    ----------
    server
        Serves the page until it is terminated; None before the replay.
    """

    def __init__(self, shown: RerunSink, report: Callable[[str], None]) -> None:
        self.server: subprocess.Popen[bytes] | None = None
        self._shown, self._report = shown, report
        self._moments_file = MomentsFile()
        self._moments: LiveMoments | None = None
        self._updated_s = 0.0

    def open(self, session: ReplaySession) -> None:
        """Begin, and serve the page.

        Raises
        ------
        ViewerError
            Where the replay has no file, or the page does not come up.
        """
        self._shown.open(session)
        if self._shown.path is None:
            raise ViewerError("page: expected a replay with a file, found none")
        self._moments = LiveMoments(session)
        self._moments_file.tell(self._moments.so_far())
        port, token = free_port(), new_token()
        self.server = _served(self._shown.path, port, token, b"", moments=self._moments_file.path)
        self._report(f"serving {address(port, token)}")

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        self._shown.write(item)
        if self._moments is None:
            return
        self._moments.add(item)
        now = time.monotonic()
        if now - self._updated_s >= TELL_S:
            self._updated_s = now
            self._moments_file.tell(self._moments.so_far())

    def abandon(self) -> None:
        """End without a result, and serve no more."""
        self._shown.abandon()
        self.end()

    def close(self) -> None:
        """End the replay; the page stays."""
        self._shown.close()
        self._moments_file.ended(self._shown.moments_within(OPENING_S), self._shown)

    def end(self) -> None:
        """Serve no more."""
        if self.server is not None:
            self.server.terminate()
            self.server.communicate()  # it closes the pipe, too


def serve_web(path: Path, port: int, token: str, moments: PageMoments) -> subprocess.Popen[bytes]:
    """Serve a recording to browsers on this machine, at the :func:`address` of port and token.

    The page talks to this server and to nothing else.

    Parameters
    ----------
    path
        The ``.rrd``.
    port
        Of the page.
    token
        What its addresses begin with.
    moments
        What the page can jump to.

    Returns
    -------
    subprocess.Popen
        The server; it serves until it is terminated.

    Raises
    ------
    ViewerError
        Where the page does not come up.
    """
    return _served(path, port, token, moments.json())


def _served(
    path: Path, port: int, token: str, first: bytes, **places: Path
) -> subprocess.Popen[bytes]:
    """Start a page's server: its moments, and where files of its options are or will be."""
    server = ["-P", "-m", "groundtrace_viewers.web.server"]
    options = (f"{name}={file}" for name, file in places.items())
    modules = os.pathsep.join(folder for folder in sys.path if folder)  # empty: the working folder
    process = subprocess.Popen(
        [sys.executable, *server, str(path.resolve()), str(port), *options],
        env={**quiet_environment(), "PYTHONPATH": modules},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        if process.stdin is not None:
            # it stays open: where it ends we have, and the server does
            process.stdin.write(f"{token} {len(first)}\n".encode() + first)
            process.stdin.flush()
        fetch(port, f"/{token}/index.html")
    except (ViewerError, OSError) as error:
        with suppress(OSError), process:  # what it never took
            process.kill()
        if isinstance(error, ViewerError):
            raise
        raise ViewerError(f"page: expected its server to start, found: {error}") from error
    return process
