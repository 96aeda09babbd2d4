"""The server of the page: ``python -m groundtrace_viewers.web.server RRD PORT [OPTION=PATH ...]``.

It listens on this machine only and answers only its own pages: it checks host and origin, so that
no other site can reach it through a browser, and a token in the path of each address, so that no
other user of this machine can. Its page connects to no other server. Token and moments come from
standard input, a line each: others see the arguments of a process. Moments that may be replaced are
in a file, ``moments=PATH``, a drawing of the first of them will be in ``opening=PATH``; of a replay
that is running the viewer's file is sent as it grows.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import os
import re
import secrets
import signal
import socket
import sys
import threading
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, BinaryIO

import uvicorn
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from groundtrace.evaluation.page import rendered

from ..errors import ViewerError
from ..rerun.blueprint import layout_of
from ..rerun.process import LOOPBACK, VIEWER_FILES, viewer_folder
from ..rerun.sink import partial_of

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping, Sequence

    from starlette.requests import Request
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

FOLDER = Path(__file__).parent / "page"
#: A drawing of the moment that a page opens at, beside it.
OPENING = "opening.png"
#: Order in which the script modules may stand in one script: each after what it imports.
MODULES = (
    "dom.js",
    "assets.js",
    "exchange.js",
    "jumps.js",
    "decision.js",
    "keys.js",
    "link.js",
    "marks.js",
    "player.js",
    "stores.js",
    "strip.js",
    "viewer.js",
    "main.js",
)
#: What a page may do whose files lie beside it: run them, make a program of bytes (the viewer) but
#: not of text, and talk to where it came from.
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "img-src 'self' data: blob:; connect-src 'self' data: blob:; worker-src 'self' blob:; "
    "base-uri 'none'; form-action 'none'"
)
_IMPORT = re.compile(r"^import \{[^}]*\} from \"\./[a-z]+\.js\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(async )?(function|class|const) )", re.MULTILINE)


def page_file(name: str) -> bytes:
    """Return one file of the page: a style sheet, or one of :data:`MODULES`."""
    return (FOLDER / name).read_bytes()


def replay_page(
    *,
    policy: str = "",
    style: str = "",
    viewer: str = "",
    script: str = "",
    from_file: str = "",
    opening: str = "",
    embedded: Mapping[str, str] = MappingProxyType({}),
    papers: Sequence[object] = (),
    downloads: Sequence[object] = (),
) -> str:
    """Return the page of a replay.

    Parameters
    ----------
    policy
        Its content security policy, for who sends no headers.
    style, viewer, script
        What stands in it rather than beside it: style sheet, viewer, all modules as one.
    from_file
        A script that tells the page whether it was opened as a file, which it then explains.
    opening
        Address of a drawing that is shown until the viewer is there.
    embedded
        Files that stand in it, packed as its script reads them, by name.
    papers, downloads
        Documents and files beside the replay, or in it where anything is held in it.
    """
    trusted = {"policy": policy, "style": style, "viewer": viewer, "script": script}
    return rendered(
        "replay.html.jinja",
        Path(__file__).parent,
        **{name: Markup(text) for name, text in trusted.items()},
        from_file=Markup(from_file),
        opening=opening,
        embedded=embedded,
        papers=papers,
        downloads=downloads,
    )


def joined_script() -> str:
    """Return all modules as one: the body of one ``<script type="module">``.

    A page opened from a file cannot import modules from beside it.
    """
    parts = (page_file(name).decode() for name in MODULES)
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", part)) for part in parts)


HEADERS = {
    "content-security-policy": f"{POLICY}; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-cache",
}
KINDS = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "wasm": "application/wasm",
    "ico": "image/x-icon",
    "json": "application/json",
    "png": "image/png",
    "rrd": "application/octet-stream",
}


def refusal(status: int, text: str) -> JSONResponse:
    """Return an error: one line of text in a JSON document."""
    return JSONResponse({"error": " ".join(text.split())}, status)


#: What a client keeps waiting for longer is broken off [s]: the head of a request, and its body.
#: Chosen by judgement: a page here takes milliseconds.
STALL_S = 10.0
#: The same of taking the next part of an answer [s]: a browser that compiles the viewer, or draws
#: it without a graphics card on a busy machine, takes nothing for so long. Chosen by trial: at a
#: load of 15 on two cores 10 s broke an answer off.
TAKEN_S = 120.0


class Gate:
    """Lets in requests that name this server and know its token, from its pages or from none.

    A browser tells which page asks and which name it looked up; a foreign page that points its own
    name at this machine thus stays out.

    Parameters
    ----------
    app
        What answers.
    port
        Where it listens.
    token
        What each path begins with.
    """

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app = app
        self._token = token
        self._hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            async with asyncio.timeout(TAKEN_S):
                await send(message)

        is_complete = False

        async def prompt() -> Message:
            nonlocal is_complete
            async with asyncio.timeout(None if is_complete else STALL_S):
                message = await receive()
            # behind the request comes nothing but that its client has gone
            is_complete = message["type"] == "http.request" and not message.get("more_body", False)
            return message

        headers = Headers(scope=scope)
        first = scope["path"].split("/")[1]
        origin = headers.get("origin")
        if headers.get("host") not in self._hosts:
            answer: ASGIApp = refusal(403, "host: expected this machine's, found another")
        elif origin is not None and origin.removeprefix("http://") not in self._hosts:
            answer = refusal(403, "origin: expected this page, found another")
        elif headers.get("sec-fetch-site") in ("cross-site", "same-site"):
            answer = refusal(403, "request: expected one of this page, found another site's")
        elif not hmac.compare_digest(first.encode(), self._token.encode()):
            answer = refusal(403, "address: expected the whole one that was printed, found another")
        else:
            answer = self._app
            scope = {**scope, "root_path": f"/{self._token}"}
        with suppress(TimeoutError):  # without an answer's end the connection is closed
            await answer(scope, prompt, guarded)


#: How often a file that grows is looked at [s], what is sent of it at once. Chosen by judgement.
POLL_S, _PIECE_BYTES = 0.05, 1 << 18


def _fixed(path: str, content: bytes | Callable[[], bytes]) -> Route:
    kind = KINDS[path.rpartition(".")[2]] if "." in path else KINDS["html"]

    async def answer(_: Request) -> Response:
        return Response(content if isinstance(content, bytes) else content(), media_type=kind)

    return Route(path, answer)


def _on_disk(path: str, file: Path, kind: str) -> Route:
    async def answer(_: Request) -> Response:
        return FileResponse(file, media_type=kind)

    return Route(path, answer)


def _awaited(path: str, file: Path) -> Route:
    """Return a route to a file that will be there; an empty one is none."""

    async def answer(_: Request) -> Response:
        while not file.exists():
            await asyncio.sleep(POLL_S)
        content = file.read_bytes()
        if not content:
            raise HTTPException(404)
        return Response(content, media_type=KINDS[path.rpartition(".")[2]])

    return Route(path, answer)


def _growing(path: str, rrd: Path) -> Route:
    """Return a route that sends a file as it grows, until it has its name."""

    async def pieces() -> AsyncIterator[bytes]:
        partial = partial_of(rrd)
        with (partial if partial.exists() else rrd).open("rb") as file:
            while True:
                finished = not partial.exists()  # asked before the end is read
                while piece := file.read(_PIECE_BYTES):
                    yield piece
                if finished:
                    return
                await asyncio.sleep(POLL_S)

    async def answer(_: Request) -> Response:
        if not partial_of(rrd).exists():
            return FileResponse(rrd, media_type=KINDS["rrd"])
        return StreamingResponse(pieces(), media_type=KINDS["rrd"])

    return Route(path, answer)


def live_app(
    rrd: Path,
    moments: Callable[[], bytes],
    port: int,
    token: str,
    annotations: str = "off",
    more: Sequence[Route] = (),
) -> ASGIApp:
    """Return the server of a page whose replay is still running.

    Parameters
    ----------
    rrd
        The viewer's file, which grows under another name until it is finished.
    moments
        Returns those that there are as JSON, see :class:`~.rerun.moments.PageMoments`.
    port, token, annotations, more
        As of :func:`page_app`.

    Raises
    ------
    ViewerError
        Where the viewer is not installed.
    """

    def layout() -> bytes:
        """Return the layout: of a replay that runs it comes with it, and again as more is known."""
        return b"" if partial_of(rrd).exists() else layout_of(rrd)

    replay = [
        _growing("/replay.rrd", rrd),
        _fixed("/layout.rrd", layout),
        _fixed("/moments.json", moments),
        *more,
    ]
    return _page(replay_page(), replay, {"annotations": annotations, "live": True}, port, token)


def page_app(
    rrd: Path,
    moments: bytes | Callable[[], bytes],
    port: int,
    token: str,
    annotations: str,
    more: Sequence[Route] = (),
    opening: Path | None = None,
) -> ASGIApp:
    """Return the page's server: an ASGI application.

    Parameters
    ----------
    rrd
        The viewer's file.
    moments
        As JSON, see :class:`~.rerun.moments.PageMoments`; where there may be more of them, what
        returns those that there are.
    port
        Where it will listen.
    token
        What each of its addresses begins with; see :func:`address`.
    annotations
        Where marks are kept: ``server``, ``browser`` or ``off``.
    more
        Routes beside the page's.
    opening
        Where a drawing of the moment that it opens at will be, see
        :func:`~.opening.drawn_meanwhile`.

    Raises
    ------
    ViewerError
        Where the viewer is not installed, or the file is not one of its replays.
    """
    replay = [
        _on_disk("/replay.rrd", rrd, KINDS["rrd"]),
        _fixed("/layout.rrd", layout_of(rrd)),
        _fixed("/moments.json", moments),
        *more,
    ]
    if opening is not None:
        replay.append(_awaited(f"/{OPENING}", opening))
    page = replay_page(opening="" if opening is None else OPENING)
    return _page(page, replay, {"annotations": annotations}, port, token)


def _page(
    page: str, replay: Sequence[Route], config: Mapping[str, object], port: int, token: str
) -> ASGIApp:
    """Return a page's server: what all pages have, and what belongs to its replay."""
    folder = viewer_folder()
    index = page.encode()
    routes = [
        _fixed("/", index),
        _fixed("/index.html", index),
        *(_fixed(f"/page/{name}", page_file(name)) for name in (*MODULES, "style.css")),
        *(
            _on_disk(f"/{name}", folder / name, KINDS[name.rpartition(".")[2]])
            for name in VIEWER_FILES
        ),
        _fixed("/page.json", json.dumps(config).encode()),
        *replay,
    ]
    app = Starlette(routes=routes, exception_handlers={404: _absent, 405: _absent})
    return Gate(app, port, token)


async def _absent(request: Request, _: Exception) -> Response:
    return refusal(404, f"{request.url.path[:200]}: expected a file of the page, found none")


def listen(port: int) -> socket.socket:
    """Return a socket that listens on this machine only; port 0 takes a free one.

    Raises
    ------
    ViewerError
        Where somebody else listens there.
    """
    try:
        return socket.create_server((LOOPBACK, port))
    except OSError as error:
        raise ViewerError(f"port {port}: expected a free one, found: {error.strerror}") from error


def address(port: int, token: str) -> str:
    """Return where the page is."""
    return f"http://{LOOPBACK}:{port}/{token}/"


def new_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(24)


class _Prompt(H11Protocol):
    """Closes a connection whose request does not come whole in time."""

    _stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._stop()

    def _watch(self) -> None:
        """Begin to wait for the head of a request, or stop where it is there."""
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop()
        elif self._stalled is None:
            self._stalled = self.loop.call_later(STALL_S, self.transport.close)

    def _stop(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None


class _Server(uvicorn.Server):
    """Says when it answers."""

    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()


def run(app: ASGIApp, listening: socket.socket, ready: Callable[[], None] = lambda: None) -> None:
    """Serve an application until Ctrl-C.

    Parameters
    ----------
    app
        See :func:`page_app`.
    listening
        See :func:`listen`.
    ready
        Called when requests are answered.
    """
    config = uvicorn.Config(
        app,
        http=_Prompt,
        log_level="error",
        access_log=False,
        lifespan="off",
        ws="none",
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    _Server(config, ready).run([listening])


def main(
    rrd: Path, port: int, token: str, moments: bytes | Path, opening: Path | None = None
) -> None:
    """Serve a recording until the process ends; marks are kept in the browser.

    Parameters
    ----------
    rrd, port, token
        As of :func:`page_app`.
    moments
        Those of a replay that has ended, or where those are that may be replaced.
    opening
        As of :func:`page_app`.
    """
    listening = listen(port)
    if isinstance(moments, Path) and partial_of(rrd).exists():
        run(live_app(rrd, moments.read_bytes, port, token), listening)
        return
    now = moments.read_bytes if isinstance(moments, Path) else moments
    run(page_app(rrd, now, port, token, "browser", opening=opening), listening)


def end_with(starter: BinaryIO) -> None:
    """End this process when the one that started it does, in whatever way: its pipe ends then."""
    starter.read()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    given = sys.stdin.buffer
    asked, size = given.readline().decode().split()
    sent = given.read(int(size))
    threading.Thread(target=end_with, args=(given,), daemon=True).start()
    places = {name: Path(path) for name, _, path in (a.partition("=") for a in sys.argv[3:])}
    renewed = places.get("moments", sent)
    main(Path(sys.argv[1]), int(sys.argv[2]), asked, renewed, places.get("opening"))
