"""``groundtrace annotate --serve``: a page that shows a replay and takes annotations.

Annotations are kept beside the recording.
"""

from __future__ import annotations

import threading
import webbrowser
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.routing import Route

from groundtrace.annotate.agreement import Item, item_of, label_of
from groundtrace.annotate.store import Annotations, named
from groundtrace.api.files import unheard
from groundtrace.api.pipelines import fitting_pipeline
from groundtrace.api.replay import replay_to_files
from groundtrace.errors import AnnotationError
from groundtrace.explain.suitability import SIGNALS
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.results import Results, file_sha256, read_results
from groundtrace.scratch import scratch_folder
from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.recording import Recording

from ..errors import ViewerError
from ..rerun.annotations import layer_rrd, states
from ..rerun.blueprint import file_identity
from ..rerun.moments import OPENING_S, LiveMoments, moments_of_results
from ..rerun.timeline import Recipe, stream_of, written_recipe
from .opening import drawn_meanwhile
from .server import address, listen, live_app, new_token, page_app, refusal, run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from starlette.requests import Request
    from starlette.types import ASGIApp

    from groundtrace.api.files import Report
    from groundtrace.pipeline.engine import ReplaySession, Sink
    from groundtrace_codecs.annotations import Annotation
    from groundtrace_codecs.events import Event
    from groundtrace_codecs.signals import SignalBlock, Stream


def serve(
    recording: Path,
    results: Path | None,
    pipeline: str,
    author: str,
    port: int,
    open_browser: bool,
    report: Report = unheard,
) -> None:
    """Serve the page that annotates a recording, until Ctrl-C.

    Where ``groundtrace replay`` left its timeline beside the results, that is shown; else the
    recording is replayed while the page shows it, in a folder that goes when the server ends. Marks
    are saved before the page confirms it.

    Parameters
    ----------
    recording
        The recording; its annotations are kept beside it.
    results
        Results whose pipeline is shown, or None.
    pipeline
        What is shown without results: a pipeline's name or file; empty takes the one that fits the
        recording, or the signals alone where none does.
    author
        Who annotates, unless the page says otherwise.
    port
        Of the page; 0 takes a free one.
    open_browser
        Show the page in the browser.
    report
        Told where the page is, and what a person should know.

    Raises
    ------
    GroundtraceError, CodecError, ViewerError
        Where the recording cannot be replayed, its annotations are open elsewhere, or the viewer is
        not installed.
    """
    with (
        scratch_folder() as folder,
        Annotations.open(recording, author) as store,
    ):
        earlier = there(recording, results)
        running = None
        try:
            if earlier is None:
                running = RunningReplay(recording, results, pipeline, folder, report)
                shown: Shown = running
            else:
                shown = EarlierReplay(recording, *earlier)
            token, listening = new_token(), listen(port)
            drawn = store.items if earlier is None else earlier[1].annotations
            desk = AnnotationSession(store, shown.application, drawn)
            port = listening.getsockname()[1]
            app = shown.app(port, token, api(desk))
            for remark in store.remarks:
                report(remark)
            with suppress(KeyboardInterrupt):
                run(
                    app,
                    listening,
                    lambda: _announce(address(port, token), open_browser, report),
                )
        except KeyboardInterrupt:
            report(f"stopped before the page was ready; {_stored_text(store, recording)}")
            return
        finally:
            if running is not None:
                running.stop()
        report(f"stopped; {_stored_text(store, recording)}")


class Shown(Protocol):
    """What a page shows: a timeline and its moments."""

    application: str

    def app(self, port: int, token: str, more: Sequence[Route]) -> ASGIApp:
        """Return the page's server."""


class EarlierReplay:
    """The timeline that a replay left.

    Parameters
    ----------
    recording
        The recording.
    rrd, results
        The timeline, and the results beside it.
    """

    def __init__(self, recording: Path, rrd: Path, results: Results) -> None:
        self.application = _application(results)
        self._rrd = rrd
        with Recording.open(recording) as opened:
            self._moments = RenewedMoments(results, opened.streams)
        self._opening = drawn_meanwhile(results, recording, self._moments.opens_s)

    def app(self, port: int, token: str, more: Sequence[Route]) -> ASGIApp:
        """Return the page's server."""
        moments = self._moments.json
        return page_app(self._rrd, moments, port, token, "server", more, self._opening)


#: A replay that is stopped has so long to end [s]. Chosen by judgement: it looks at every block.
PATIENCE_S = 10.0


class _StoppedError(Exception):
    """A replay is wanted no more."""


class RunningReplay:
    """A replay that is shown while it runs, by a thread beside the page's server.

    Parameters
    ----------
    recording, results, pipeline, report
        As :func:`serve`.
    folder
        Where its files are.

    Raises
    ------
    GroundtraceError, CodecError, ViewerError
        Where the recording cannot be replayed.
    """

    def __init__(
        self, recording: Path, results: Path | None, pipeline: str, folder: Path, report: Report
    ) -> None:
        self.application = ""
        self._rrd, self._report = folder / "replay.rrd", report
        self._moments_json: Callable[[], bytes] = bytes
        self._live: LiveMoments | None = None
        self._one_at_a_time = threading.Lock()
        self._failed: Exception | None = None
        self._streams: tuple[Stream, ...] = ()
        self._begun, self._stopped = threading.Event(), threading.Event()
        self._asked = recording, results, pipeline, folder
        self._thread = threading.Thread(target=self._replay, daemon=True)
        self._thread.start()
        self._begun.wait()
        if self._failed is not None:
            raise self._failed

    def app(self, port: int, token: str, more: Sequence[Route]) -> ASGIApp:
        """Return the page's server."""
        return live_app(self._rrd, self.moments, port, token, "server", more)

    def moments(self) -> bytes:
        """Return those that there are by now as JSON."""
        return self._moments_json()

    def stop(self) -> None:
        """End the replay, if it is not at its end."""
        self._stopped.set()
        self._thread.join(PATIENCE_S)

    def open(self, session: ReplaySession) -> None:
        """Begin: the page can be served."""
        self.application, self._streams = session.application, session.streams
        self._live = LiveMoments(session)
        self._moments_json = self._so_far
        self._begun.set()

    def write(self, item: SignalBlock | Event) -> None:
        """Take one block or event."""
        if self._stopped.is_set():
            raise _StoppedError
        if self._live is not None:
            with self._one_at_a_time:
                self._live.add(item)

    def _so_far(self) -> bytes:
        if self._live is None:
            return b""
        with self._one_at_a_time:
            return self._live.so_far().json()

    def close(self) -> None:
        """End: what is told of the whole comes when its files are there."""

    def _replay(self) -> None:
        recording, results, pipeline, folder = self._asked
        try:
            _, replay_results = replayed(
                recording, results, pipeline, folder, self._report, beside=[self]
            )
            self._moments_json = RenewedMoments(replay_results, self._streams).json
        except _StoppedError:
            pass
        except Exception as error:  # told by who waits for the begin, else here
            self._failed = error
            if self._begun.is_set():
                self._report(str(error))
        finally:
            self._begun.set()


class RenewedMoments:
    """The moments of results: at once what is found soon, and all of them when they are there.

    Parameters
    ----------
    results
        What is shown.
    streams
        Of the recording.

    Attributes
    ----------
    opens_s
        Where a page opens [s since the first sample].
    """

    def __init__(self, results: Results, streams: Sequence[Stream]) -> None:
        first = moments_of_results(results, streams, within_s=OPENING_S)
        self._json, self.opens_s = first.json(), first.opens_s
        self._results, self._streams = results, streams
        if first.pending:
            threading.Thread(target=self._complete, daemon=True).start()

    def json(self) -> bytes:
        """Return those that are there as one JSON document."""
        return self._json

    def _complete(self) -> None:
        self._json = moments_of_results(self._results, self._streams).json()


def _stored_text(store: Annotations, recording: Path) -> str:
    """Return in words what is on the disk when the server ends."""
    count, sidecar = len(store.items), sidecar_path(recording).name
    if count == 0:
        return f"{recording.name} has no annotations"
    return f"{count} annotation{' is' if count == 1 else 's are'} kept in {sidecar}"


def there(recording: Path, results: Path | None) -> tuple[Path, Results] | None:
    """Return the timeline that a replay left with its results, and these; None where it did not.

    It must lie beside them, be no older, and say that it shows a recording of this name by their
    pipeline.

    Parameters
    ----------
    recording, results
        As :func:`serve`.

    Raises
    ------
    ViewerError
        Where the results are of another recording.
    """
    if results is None:
        return None
    shown = read_results(results)
    _check(shown, recording)
    rrd = results.with_name(f"{results.stem.removesuffix('.results')}.rrd")
    if not rrd.is_file() or rrd.stat().st_mtime_ns < results.stat().st_mtime_ns:
        return None
    rrd_info = file_identity(rrd)
    expected = stream_of(recording.name, _application(shown)).get_recording_id()
    if rrd_info is None or rrd_info.recording_id != expected:
        return None
    return (rrd, shown) if shown.provenance.pipeline.strip() in rrd_info.page else None


def replayed(
    recording: Path,
    results: Path | None,
    pipeline: str,
    folder: Path,
    report: Report = unheard,
    beside: Sequence[Sink] = (),
) -> tuple[Path, Results]:
    """Replay a recording into a folder: return the viewer's file, and the results.

    Parameters
    ----------
    recording, results, pipeline, report
        As :func:`serve`.
    folder
        Where to.
    beside
        Who looks on while it is replayed.
    """
    rrd, fresh = folder / "replay.rrd", folder / "results.mcap"
    if results is not None:
        earlier = read_results(results)
        _check(earlier, recording)
        recipe = written_recipe(earlier, folder)
    else:
        recipe = Recipe(Path(pipeline or _fitting(recording)), None, None, None)
    replay_to_files(
        recording,
        recipe.pipeline,
        fresh,
        rrd,
        geometry=recipe.geometry,
        from_s=recipe.from_,
        to_s=recipe.to,
        report=report,
        beside=beside,
    )
    return rrd, read_results(fresh)


def _fitting(recording: Path) -> str:
    with Recording.open(recording) as opened:
        return fitting_pipeline(opened) or SIGNALS


def _check(results: Results, recording: Path) -> None:
    origin = results.provenance
    if origin.sha256 != file_sha256(recording):
        raise ViewerError(
            f"{results.name}: recording: expected results of {recording.name} as it is, "
            f"found those of {origin.recording} with another SHA-256"
        )


def _application(results: Results) -> str:
    """Return the kind of recording, which is part of the name that layers join a replay by."""
    recipe = results.provenance.pipeline.encode()
    return parse_pipeline(recipe, f"{results.name}: pipeline").application


def _announce(url: str, open_browser: bool, report: Report) -> None:
    report(f"annotating at {url} (Ctrl-C ends it)")
    if open_browser:
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


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


class MarkRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
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


class AnnotationSession:
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

    def add(self, asked: MarkRequest) -> Listing:
        """Keep a new mark."""
        label = label_of(_item(asked), self._store.key.start_ns)
        with self._one_at_a_time:
            self._set_author(asked)
            added = self._store.add(replace(label, author=self._author))
            self._undo = True
            return self.listing(added.id)

    def edit(self, id_: str, asked: MarkRequest) -> Listing:
        """Change a mark; what a page does not show of it stays."""
        requested = label_of(_item(asked), self._store.key.start_ns)
        with self._one_at_a_time:
            self._set_author(asked)
            before = next((item.label for item in self._store.items if item.id == id_), requested)
            label = replace(
                before,
                time_ns=requested.time_ns,
                end_ns=requested.end_ns,
                kind=requested.kind,
                channel=requested.channel,
                label=requested.label,
                note=requested.note,
            )
            self._store.edit(id_, label)
            self._undo = True
            return self.listing(id_)

    def delete(self, id_: str, asked: MarkRequest) -> Listing:
        """Take a mark away."""
        with self._one_at_a_time:
            self._set_author(asked)
            self._store.delete(id_)
            self._undo = True
            return self.listing()

    def undo(self, asked: MarkRequest) -> Listing:
        """Take the author's last change back."""
        with self._one_at_a_time:
            self._set_author(asked)
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

    def _set_author(self, asked: MarkRequest) -> None:
        """Take over the name of whoever changes something."""
        if asked.author:
            self._author = self._store.author = named(asked.author)


def _item(asked: MarkRequest) -> Item:
    if asked.mark is None:
        raise AnnotationError("mark: expected one, found none")
    return Item(id="", **msgspec.structs.asdict(asked.mark))


def api(desk: AnnotationSession) -> list[Route]:
    """Return the routes of the marks.

    Parameters
    ----------
    desk
        What answers.
    """

    def route(path: str, method: str, act: Callable[[Request, MarkRequest], Any]) -> Route:
        async def answer(request: Request) -> Response:
            try:
                asked = await _asked(request)
                reply = await run_in_threadpool(act, request, asked)
            except _TooLargeError:
                return refusal(413, f"body: expected at most {LARGEST_BODY} bytes, found more")
            except REFUSED as error:
                return refusal(400, str(error))
            if isinstance(reply, bytes):
                return Response(reply, media_type="application/octet-stream")
            return Response(msgspec.json.encode(reply), media_type="application/json")

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


async def _asked(request: Request) -> MarkRequest:
    """Read the body of a request; nothing is an empty one."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > LARGEST_BODY:
            raise _TooLargeError
    return msgspec.json.decode(bytes(body), type=MarkRequest) if body else MarkRequest()
