"""Showing a recording in a browser on this machine: starts the page's server."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from .errors import ViewerError
from .serve import quiet_environment
from .web import fetch

if TYPE_CHECKING:
    from pathlib import Path


def serve_web(path: Path, port: int) -> subprocess.Popen[bytes]:
    """Serve a recording to browsers on this machine at ``http://127.0.0.1:PORT``.

    The page talks to this server and to nothing else.

    Parameters
    ----------
    path
        The ``.rrd``.
    port
        Of the page.

    Returns
    -------
    subprocess.Popen
        The server; it serves until it is terminated.

    Raises
    ------
    ViewerError
        Where the page does not come up.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "groundtrace_viewers.web", str(path.resolve()), str(port)],
        env={**quiet_environment(), "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        fetch(port, "/index.html")
    except ViewerError:
        process.kill()
        process.wait()
        raise
    return process
