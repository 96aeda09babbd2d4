"""The bundled room behind a URL."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, ClassVar

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOM = path_of("room-walk.mcap").read_bytes()


class Ranges(BaseHTTPRequestHandler):
    """Gives ranges of one recording, and counts the bytes."""

    sent = 0
    deaf = False  # answers with the whole file, as some servers do
    failing: ClassVar[list[int]] = []  # what the next requests are answered with; 0 hangs up

    def do_GET(self) -> None:
        if self.fails():
            return
        asked = self.headers.get("Range", "").removeprefix("bytes=")
        first, _, last = asked.partition("-")
        whole = not asked or type(self).deaf
        data = ROOM if whole else ROOM[int(first) : int(last) + 1]
        type(self).sent += len(data)
        self.do_HEAD(200 if whole else 206, len(data))
        self.wfile.write(data)

    def fails(self) -> bool:
        """Answer with the next failure, if there is one."""
        if not self.failing:
            return False
        code = self.failing.pop(0)
        if code:
            self.send_error(code)
        self.close_connection = True
        return True

    def do_HEAD(self, code: int = 200, size: int = len(ROOM)) -> None:
        self.send_response(code)
        self.send_header("Content-Length", str(size))
        self.send_header("Accept-Ranges", "bytes")
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


class Server(ThreadingHTTPServer):
    """Says nothing of clients that break off."""

    def handle_error(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def served_room() -> Iterator[int]:
    """Serve the bundled room, whatever is asked for; yield the port on this computer."""
    with Server(("127.0.0.1", 0), Ranges) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_port
        server.shutdown()
