"""The viewer's own page files: taken once from the installed viewer, then out of a cache.

The viewer's web server would do, but its page reports usage, asks for new versions and loads fonts
from elsewhere, whatever the environment says. So its script and program are taken from it and
served by a page of ours, whose content security policy lets it talk to its own server only.
"""

from __future__ import annotations

import http.client
import os
import sys
import tempfile
import time
from contextlib import suppress
from http import HTTPStatus
from importlib.metadata import version
from pathlib import Path

from .errors import ViewerError
from .serve import LOOPBACK, free_port, start_viewer

#: What of the viewer a page needs.
VIEWER_FILES = ("re_viewer.js", "re_viewer_bg.wasm", "favicon.ico")
START_S = 20.0


def fetch(port: int, path: str, timeout_s: float = START_S) -> bytes:
    """Return a file of a server on this machine, waiting until the server is up.

    Raises
    ------
    ViewerError
        Where it does not come up in time or has no such file.
    """
    deadline = time.monotonic() + timeout_s
    while True:
        connection = http.client.HTTPConnection(LOOPBACK, port, timeout=timeout_s)
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            body = answer.read()
        except OSError as error:
            if time.monotonic() > deadline:
                raise ViewerError(
                    f"{path}: expected a page within {timeout_s:g} s: {error}"
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
        return _kept(files, folder)
    except (
        OSError
    ):  # a home that cannot be written to: these files last as long as the system likes
        return _kept(files, Path(tempfile.mkdtemp(prefix="groundtrace-")))


def _kept(files: dict[str, bytes], folder: Path) -> Path:
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
