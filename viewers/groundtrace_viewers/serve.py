"""Starts viewer processes: on the loopback interface only, and with reporting switched off.

The viewer's own defaults listen on every interface and report usage; everything here is started
with ``--bind 127.0.0.1`` and ``CI=1``, which switches the reporting off.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import ViewerError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rerun.experimental import ViewerClient

LOOPBACK = "127.0.0.1"


def viewer_program() -> Path:
    """Return the viewer's program, which the package ``rerun-sdk`` brings.

    Raises
    ------
    ViewerError
        Where it is not installed.
    """
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec and spec.origin else Path()
    program = folder / ("rerun.exe" if sys.platform == "win32" else "rerun")
    if spec is None or not program.is_file():
        raise ViewerError("viewer: expected the program rerun of rerun-sdk, found none")
    return program


def quiet_environment() -> dict[str, str]:
    """Return the environment viewers are started in: they neither report nor open a browser."""
    return {**os.environ, "CI": "1", "BROWSER": "true"}


def free_port() -> int:
    """Return a port of the loopback interface that nothing listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def start_viewer(arguments: Sequence[str], port: int) -> subprocess.Popen[bytes]:
    """Start the viewer's program, its data server on a port of the loopback interface.

    Raises
    ------
    ViewerError
        Where it is not installed.
    """
    command = [str(viewer_program()), "--bind", LOOPBACK, "--port", str(port), *arguments]
    return subprocess.Popen(
        command,
        env=quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def data_url(port: int) -> str:
    """Return the address a viewer takes data and commands at."""
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def connect(process: subprocess.Popen[bytes], port: int, timeout_s: float = 20.0) -> ViewerClient:
    """Return a client of a viewer that was just started.

    Raises
    ------
    ViewerError
        Where the viewer ends or does not answer in time.
    """
    from rerun.experimental import ViewerClient

    reason = "no answer"
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline and process.poll() is None:
        try:
            client = ViewerClient.connect(data_url(port))
            client.get_state()
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error)
            time.sleep(0.1)
        else:
            return client
    if process.poll() is not None:
        reason = f"it ended with {process.returncode}"
    raise ViewerError(f"viewer: expected an answer within {timeout_s:g} s, found: {reason}")


def open_viewer(arguments: Sequence[str], port: int) -> subprocess.Popen[bytes]:
    """Start the native viewer and wait until it takes data.

    Raises
    ------
    ViewerError
        Where it is not installed or does not come up, as without a display.
    """
    process = start_viewer(arguments, port)
    try:
        connect(process, port)
    except ViewerError:
        process.kill()
        process.wait()
        raise
    return process
