"""Serve one recording to browsers on this machine: ``python -m groundtrace_viewers.web RRD PORT``.

The viewer's own web server would do, but its page reports usage, asks for new versions and loads
fonts from elsewhere, whatever the environment says. So its files are taken from it once and served
here with a content security policy that lets the page talk to this server only.
"""

from __future__ import annotations

import http.client
import shutil
import sys
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode, urlsplit

from .errors import ViewerError
from .serve import LOOPBACK, free_port, start_viewer

if TYPE_CHECKING:
    from collections.abc import Mapping

RECORDING = "/replay.rrd"
#: Files of the viewer's page and their types.
FILES = {
    "/index.html": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self' data: blob:; worker-src 'self' blob:"
)
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


def viewer_files() -> dict[str, bytes]:
    """Return the files of the viewer's page, as the installed viewer serves them.

    Raises
    ------
    ViewerError
        Where the viewer is not installed or does not serve them.
    """
    port = free_port()
    process = start_viewer(["--serve-web", "--web-viewer-port", str(port)], free_port())
    try:
        return {path: fetch(port, path) for path in FILES}
    finally:
        process.terminate()
        process.wait(10)


def page(port: int) -> str:
    """Return the address that shows the recording."""
    root = f"http://{LOOPBACK}:{port}"
    query = urlencode({"url": root + RECORDING, "persist": "0", "theme": "dark"})
    return f"{root}/index.html?{query}&hide_welcome_screen"


def handler(files: Mapping[str, bytes], rrd: Path, port: int) -> type[BaseHTTPRequestHandler]:
    """Return a request handler for the page and the recording."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = urlsplit(self.path).path
            if path == "/":
                self.send_response(HTTPStatus.FOUND)
                self.send_header("Location", page(port))
                self.end_headers()
            elif path == RECORDING:
                self._head("application/octet-stream", rrd.stat().st_size)
                with rrd.open("rb") as file:
                    shutil.copyfileobj(file, self.wfile, 1 << 20)
            elif path in files:
                self._head(FILES[path], len(files[path]))
                self.wfile.write(files[path])
            else:
                self.send_error(HTTPStatus.NOT_FOUND)

        def _head(self, kind: str, length: int) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(length))
            self.send_header("Content-Security-Policy", POLICY)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Stay silent: requests are no news."""

    return Handler


def main(rrd: Path, port: int) -> None:
    """Serve a recording until the process ends."""
    server = ThreadingHTTPServer((LOOPBACK, port), handler(viewer_files(), rrd, port))
    server.serve_forever()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
