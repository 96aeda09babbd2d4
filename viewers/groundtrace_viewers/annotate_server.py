"""``groundtrace annotate --serve``: the page with a replay, its marks kept beside the recording."""

from __future__ import annotations

import io
import secrets
import tempfile
import threading
import webbrowser
from contextlib import redirect_stdout, suppress
from pathlib import Path

from groundtrace.annotate import Annotations
from groundtrace.commands.fitting import fitting_pipeline
from groundtrace.commands.output import say
from groundtrace.commands.replay_run import terminable
from groundtrace.commands.replaying import replay
from groundtrace.pipeline import parse_pipeline
from groundtrace.results import Results, file_sha256, read_results
from groundtrace.suitability import SIGNALS
from groundtrace_codecs.annotations import sidecar_path
from groundtrace_codecs.recording import Recording

from .errors import ViewerError
from .moments import moments_of_results
from .page_api import Desk, api
from .recipe import Recipe, written_recipe
from .serve import LOOPBACK
from .web import listen, page_app, run


def serve(
    recording: Path,
    results: Path | None,
    pipeline: str,
    author: str,
    port: int,
    open_browser: bool,
) -> None:
    """Serve the page that annotates a recording, until Ctrl-C.

    The recording is replayed first, in a folder that goes when the server ends. Marks are on the
    disk before a page hears that they are kept.

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

    Raises
    ------
    GroundtraceError, CodecError, ViewerError
        Where the recording cannot be replayed, its annotations are open elsewhere, or the viewer is
        not installed.
    """
    with (
        tempfile.TemporaryDirectory(prefix="groundtrace-") as folder,
        Annotations.open(recording, author) as store,
    ):
        drawn = store.items
        try:
            rrd, shown = replayed(recording, results, pipeline, Path(folder))
            with Recording.open(recording) as opened:
                moments = moments_of_results(shown, opened.streams)
        except KeyboardInterrupt:
            say(f"stopped before the page was ready; {_kept(store, recording)}")
            return
        token, listening = secrets.token_urlsafe(24), listen(port)
        desk = Desk(store, _application(shown), drawn)
        port = listening.getsockname()[1]
        app = page_app(rrd, moments.json(), port, "server", api(desk, token))
        for remark in store.remarks:
            say(remark)
        with terminable(), suppress(KeyboardInterrupt):
            run(
                app,
                listening,
                lambda: _announce(f"http://{LOOPBACK}:{port}/#token={token}", open_browser),
            )
        say(f"stopped; {_kept(store, recording)}")


def _kept(store: Annotations, recording: Path) -> str:
    """Return in words what is on the disk when the server ends."""
    count, kept = len(store.items), sidecar_path(recording).name
    if count == 0:
        return f"{recording.name} has no annotations"
    return f"{count} annotation{' is' if count == 1 else 's are'} kept in {kept}"


def replayed(
    recording: Path, results: Path | None, pipeline: str, folder: Path
) -> tuple[Path, Results]:
    """Replay a recording into a folder: return the viewer's file, and the results.

    Parameters
    ----------
    recording, results, pipeline
        As :func:`serve`.
    folder
        Where to.
    """
    rrd, fresh = folder / "replay.rrd", folder / "results.mcap"
    if results is not None:
        earlier = read_results(results)
        _check(earlier, recording)
        recipe = written_recipe(earlier, folder)
    else:
        recipe = Recipe(Path(pipeline or _fitting(recording)), None, None, None)
    with redirect_stdout(io.StringIO()):  # it would name files that nobody is to see
        replay(
            recording,
            pipeline=str(recipe.pipeline),
            geometry=recipe.geometry,
            from_=recipe.from_,
            to=recipe.to,
            rrd=rrd,
            out=fresh,
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


def _announce(url: str, open_browser: bool) -> None:
    say(f"annotating at {url} (Ctrl-C ends it)")
    if open_browser:
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
