"""Showing a recording in a browser on this machine: starts the page's server."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from ..errors import ViewerError
from ..rerun.process import fetch, free_port, quiet_environment
from .server import address, new_token

if TYPE_CHECKING:
    from pathlib import Path

    from ..rerun.moments import PageMoments
    from ..rerun.sink import RerunSink


def serve_replay(shown: RerunSink) -> tuple[str, subprocess.Popen[bytes]]:
    """Serve a replay that has ended, taken for the web, to browsers on this machine.

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
    return address(port, token), serve_web(shown.path, port, token, shown.moments)


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
    server = ["-P", "-m", "groundtrace_viewers.web.server"]
    places = os.pathsep.join(place for place in sys.path if place)  # empty: the working folder
    process = subprocess.Popen(
        [sys.executable, *server, str(path.resolve()), str(port)],
        env={**quiet_environment(), "PYTHONPATH": places},
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        if process.stdin is not None:
            process.stdin.write(f"{token}\n".encode() + moments.json())
            process.stdin.close()
        fetch(port, f"/{token}/index.html")
    except (ViewerError, OSError) as error:
        process.kill()
        process.wait()
        if isinstance(error, ViewerError):
            raise
        raise ViewerError(f"page: expected its server to start, found: {error}") from error
    return process
