"""Starts viewer processes: on the loopback interface only, and with reporting switched off.

The viewer's own defaults listen on every interface and report usage. Every viewer is started here
with ``--bind 127.0.0.1`` and ``CI=1``, which switches the reporting off.

The page of the viewer's own web server reports usage, asks for new versions and loads fonts from
elsewhere, whatever the environment says. So its script and program are taken from the installed
viewer once and kept in a cache. A page of groundtrace serves them, whose content security policy
lets it connect to its own server only.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.scratch import scratch_folder_until_exit

from ..errors import ViewerError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rerun.experimental import ViewerClient

LOOPBACK = "127.0.0.1"
#: How long a program that was started may take to answer [s]. Chosen by judgement.
START_S = 20.0


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


def connect(process: subprocess.Popen[bytes], port: int) -> ViewerClient:
    """Return a client of a viewer that was just started.

    Raises
    ------
    ViewerError
        Where the viewer ends or does not answer in time.
    """
    from rerun.experimental import ViewerClient

    reason = "no answer"
    deadline = time.monotonic() + START_S
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
    raise ViewerError(f"viewer: expected an answer within {START_S:g} s, found: {reason}")


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


#: What of the viewer a page needs.
VIEWER_FILES = ("re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")


def fetch(port: int, path: str) -> bytes:
    """Return a file of a server on this machine, waiting until the server is up.

    Raises
    ------
    ViewerError
        Where it does not come up in time or has no such file.
    """
    from http import HTTPStatus
    from http.client import HTTPConnection

    deadline = time.monotonic() + START_S
    while True:
        connection = HTTPConnection(LOOPBACK, port, timeout=START_S)
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            body = answer.read()
        except OSError as error:
            if time.monotonic() > deadline:
                raise ViewerError(
                    f"{path}: expected a page within {START_S:g} s: {error}"
                ) from error
            time.sleep(0.1)
        else:
            if answer.status != HTTPStatus.OK:
                raise ViewerError(f"{path}: expected status 200, found {answer.status}")
            return body
        finally:
            connection.close()


def cache_folder() -> Path:
    """Return where files are kept that can be made again: one folder for each viewer's version."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA", "")
    elif sys.platform == "darwin":
        base = str(Path("~/Library/Caches").expanduser())
    else:
        base = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(base) if base else Path("~/.cache").expanduser()
    return root / "groundtrace" / f"viewer-{version('rerun-sdk')}"


def viewer_folder() -> Path:
    """Return a folder with the viewer's page files; makes it where it is not there yet.

    Raises
    ------
    ViewerError
        Where the viewer is not installed or does not serve them.
    """
    folder = cache_folder()
    if all((folder / name).is_file() for name in VIEWER_FILES):
        return folder
    files = _files()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return _write_files(files, folder)
    except (
        OSError
    ):  # a home that cannot be written to: these files last as long as the system likes
        return _write_files(files, scratch_folder_until_exit())


def _write_files(files: dict[str, bytes], folder: Path) -> Path:
    """Write files so that others who look see each of them whole or not at all."""
    for name, content in files.items():
        handle, fresh = tempfile.mkstemp(dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            Path(fresh).replace(folder / name)
        except OSError:
            with suppress(FileNotFoundError):
                Path(fresh).unlink()
            raise
    return folder


def _files() -> dict[str, bytes]:
    """Return the files as the installed viewer serves them."""
    port = free_port()
    process = start_viewer(["--serve-web", "--web-viewer-port", str(port)], free_port())
    try:
        return {name: fetch(port, f"/{name}") for name in VIEWER_FILES}
    finally:
        process.terminate()
        process.wait(10)
