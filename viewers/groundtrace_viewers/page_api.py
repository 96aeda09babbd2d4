"""What the page asks of the server that keeps marks: an open set of annotations, over HTTP."""

from __future__ import annotations

import hmac
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.routing import Route

from groundtrace.annotate.checks import named
from groundtrace.annotate.exchange import Item, item_of, label_of
from groundtrace.errors import AnnotationError
from groundtrace_codecs.errors import CodecError

from .annotation_layer import layer_rrd, states
from .web import refusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.requests import Request

    from groundtrace.annotate import Annotations
    from groundtrace_codecs.annotations import Annotation

TOKEN = "x-groundtrace-token"  # the name of a header
#: A mark is a few lines of text [bytes].
LARGEST_BODY = 64 * 1024
#: What is wrong with a request rather than with the server.
REFUSED = (AnnotationError, CodecError, msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class Mark(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a page says of a mark; the fields are those of the exchange format's items."""

    kind: str
    time_s: float
    end_s: float | None = None
    label: str = ""
    channel: str = ""
    note: str = ""
    time_ns: str = ""
    end_ns: str | None = None


class Asked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The body of a request that changes something."""

    author: str = ""
    mark: Mark | None = None


class Listing(msgspec.Struct, frozen=True):
    """The answer: all marks, and which one was made or changed.

    ``revision`` numbers what the layer is drawn from; ``undo`` says whether there may be something
    to take back.
    """

    author: str
    marks: tuple[Item, ...]
    undo: bool
    revision: int
    id: str | None = None


class Desk:
    """An open set of annotations that pages change, one after the other.

    Parameters
    ----------
    store
        The annotations.
    application
        Kind of the recording, as its replay was made.
    drawn
        The annotations that the replay's file shows.
    """

    def __init__(
        self, store: Annotations, application: str, drawn: tuple[Annotation, ...] = ()
    ) -> None:
        self._store = store
        self._application = application
        self._author = store.author
        self._undo = bool(store.items)
        self._revisions = [drawn]
        self._one_at_a_time = threading.Lock()

    def listing(self, id_: str | None = None) -> Listing:
        """Return everything as it is now."""
        items, start_ns = self._store.items, self._store.key.start_ns
        if items != self._revisions[-1]:
            self._revisions.append(items)
        marks = tuple(item_of(item, start_ns) for item in items)
        return Listing(self._author, marks, self._undo, len(self._revisions) - 1, id_)

    def current(self) -> Listing:
        """Return everything as it is now, between two changes."""
        with self._one_at_a_time:
            return self.listing()

    def add(self, asked: Asked) -> Listing:
        """Keep a new mark."""
        label = label_of(_item(asked), self._store.key.start_ns)
        with self._one_at_a_time:
            self._known(asked)
            added = self._store.add(replace(label, author=self._author))
            self._undo = True
            return self.listing(added.id)

    def edit(self, id_: str, asked: Asked) -> Listing:
        """Change a mark; what a page does not show of it stays."""
        said = label_of(_item(asked), self._store.key.start_ns)
        with self._one_at_a_time:
            self._known(asked)
            before = next((item.label for item in self._store.items if item.id == id_), said)
            label = replace(
                before,
                time_ns=said.time_ns,
                end_ns=said.end_ns,
                kind=said.kind,
                channel=said.channel,
                label=said.label,
                note=said.note,
            )
            self._store.edit(id_, label)
            self._undo = True
            return self.listing(id_)

    def delete(self, id_: str, asked: Asked) -> Listing:
        """Take a mark away."""
        with self._one_at_a_time:
            self._known(asked)
            self._store.delete(id_)
            self._undo = True
            return self.listing()

    def undo(self, asked: Asked) -> Listing:
        """Take the author's last change back."""
        with self._one_at_a_time:
            self._known(asked)
            self._undo = self._store.undo() is not None
            return self.listing()

    def layer(self, drawn: int) -> bytes:
        """Return the layer that shows what is now to a page that shows revision ``drawn``.

        Raises
        ------
        AnnotationError
            Where there is no such revision.
        """
        with self._one_at_a_time:
            newest = len(self._revisions) - 1
            if not 0 <= drawn <= newest:
                raise AnnotationError(f"drawn: expected 0 to {newest}, found {drawn}")
            earlier, current = self._revisions[: drawn + 1], self._revisions[-1]
        changed_ns = {time_ns for items in earlier for time_ns, _ in states(items)}
        key = self._store.key
        return layer_rrd(
            key.name, self._application, key.start_ns, current, earlier[-1], changed_ns
        )

    def _known(self, asked: Asked) -> None:
        """Take over the name of whoever changes something."""
        if asked.author:
            self._author = self._store.author = named(asked.author)


def _item(asked: Asked) -> Item:
    if asked.mark is None:
        raise AnnotationError("mark: expected one, found none")
    return Item(id="", **msgspec.structs.asdict(asked.mark))


def api(desk: Desk, token: str) -> list[Route]:
    """Return the routes of the marks; each asks for the token.

    Parameters
    ----------
    desk
        What answers.
    token
        What the page got with its address.
    """

    def route(path: str, method: str, act: Callable[[Request, Asked], Any]) -> Route:
        async def answer(request: Request) -> Response:
            # As bytes, since only ASCII text can be compared in constant time.
            given = request.headers.get(TOKEN, "").encode()
            if not hmac.compare_digest(given, token.encode()):
                return refusal(403, "token: expected that of the address, found another")
            try:
                asked = await _asked(request)
                found = await run_in_threadpool(act, request, asked)
            except _TooLargeError:
                return refusal(413, f"body: expected at most {LARGEST_BODY} bytes, found more")
            except REFUSED as error:
                return refusal(400, str(error))
            if isinstance(found, bytes):
                return Response(found, media_type="application/octet-stream")
            return Response(msgspec.json.encode(found), media_type="application/json")

        return Route(f"/api{path}", answer, methods=[method])

    def id_(request: Request) -> str:
        return str(request.path_params["id"])

    return [
        route("/annotations", "GET", lambda _, __: desk.current()),
        route("/annotations", "POST", lambda _, asked: desk.add(asked)),
        route("/annotations/{id}", "PUT", lambda request, asked: desk.edit(id_(request), asked)),
        route(
            "/annotations/{id}", "DELETE", lambda request, asked: desk.delete(id_(request), asked)
        ),
        route("/undo", "POST", lambda _, asked: desk.undo(asked)),
        route("/layer.rrd", "GET", lambda request, _: desk.layer(_drawn(request))),
    ]


def _drawn(request: Request) -> int:
    text = request.query_params.get("drawn", "0")
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise AnnotationError(f"drawn: expected a revision's number, found {text[:40]!r}")
    return int(text)


class _TooLargeError(Exception):
    """A body is larger than any mark."""


async def _asked(request: Request) -> Asked:
    """Read the body of a request; nothing is an empty one."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_BODY:
            raise _TooLargeError
    return msgspec.json.decode(bytes(body), type=Asked) if body else Asked()
