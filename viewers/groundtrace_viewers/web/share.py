"""Shares a result as a folder, an archive of it, or one page, with everything it needs to open."""

from __future__ import annotations

import base64
import gzip
import hashlib
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from groundtrace.annotate.agreement import item_of, to_json
from groundtrace.api.files import check_replaceable, derived_from, in_folder, mark_of, unheard
from groundtrace.api.replay import replay_to_files
from groundtrace.evaluation.score_page import score_page
from groundtrace.pipeline.results import atomic_write, provenance_of, read_results
from groundtrace.scratch import scratch_folder
from groundtrace_codecs.events import Fix, Pick, StepEvent, TrackPoint

from ..errors import ViewerError
from ..rerun.blueprint import layout_of
from ..rerun.process import VIEWER_FILES, quiet_environment, viewer_folder, viewer_program
from ..rerun.timeline import stream_of, written_recipe
from ..rerun.wrong_decisions import TOLERANCE_S
from .opening import opening_drawing
from .server import OPENING, POLICY, joined_script, page_file, replay_page
from .summary import sources_of, summary_page

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from groundtrace.api.files import Report
    from groundtrace.pipeline.results import Results

    from .summary import Sources

#: What a folder is known by as one that was shared.
OWN_FILES = ("index.html", "summary.html", "moments.json", "layout.rrd", "replay.rrd")
FORMS = ("folder", "zip", "html")
#: Bytes in which an archive's member is told the same everywhere: the earliest date there is.
EPOCH = (1980, 1, 1, 0, 0, 0)


def share_view(
    results: Path,
    out: Path,
    *,
    form: str = "folder",
    recording: Path | None = None,
    rrd: Path | None = None,
    light: bool = False,
    force: bool = False,
    report: Report = unheard,
) -> None:
    """Write a result for others: replay, summary, score, annotations, pipeline.

    The output appears whole, under its name, or not at all.

    Parameters
    ----------
    results
        The results' file.
    out
        The folder or file to write.
    form
        ``folder``, ``zip`` (of that folder) or ``html``: one page that opens by a double click.
    recording
        The recording of the results; None where it is not there.
    rrd
        Its viewer's file, instead of replaying the recording.
    light
        Leave the samples of fast signals out.
    force
        Replace what was shared there of another recording, too.
    report
        Told what a person should know of it.

    Raises
    ------
    GroundtraceError, CodecError, ViewerError
        Where something cannot be read, or ``out`` must not be written.
    """
    if form not in FORMS:
        raise ViewerError(f"form: expected one of {', '.join(FORMS)}, found {form!r}")
    used = [path for path in (results, recording, rrd) if path is not None]
    _check_target(out, form == "folder", force or _is_shared(out, results), used)
    sources = sources_of(results, recording, report)
    mark = mark_of(sources.results.provenance.sha256)
    with atomic_write(in_folder(out)) as fresh:
        folder = fresh if form == "folder" else fresh.with_name(f"{fresh.name}.d")
        folder.mkdir()
        try:
            _fill(folder, sources, rrd, light, report, alone=form == "html")
            if form == "zip":
                _pack(folder, out.stem, fresh, mark)
            elif form == "html":
                fresh.write_text(f"{_one_page(folder, sources)}<!-- {mark} -->\n", "utf-8")
        finally:
            if folder != fresh:
                shutil.rmtree(folder)


def _is_shared(out: Path, results: Path) -> bool:
    """Whether something is what was shared before, of the same recording."""
    page = out / "summary.html" if out.is_dir() else out
    return page.is_file() and derived_from(page, provenance_of(results))


def _check_target(out: Path, folder: bool, force: bool, used: Sequence[Path]) -> None:
    """Refuse to overwrite what was not asked for, or what nobody shared."""
    for path in used:
        if out.resolve() in (path.resolve(), *path.resolve().parents):
            raise ViewerError(f"{out}: expected a new place, found the one that {path} is read at")
    if not (out.exists() or out.is_symlink()):
        return
    if not force:
        raise ViewerError(f"{out}: expected a new place, found an existing one; see --force")
    wanted = "a folder" if folder else "a file"
    existing = "a folder" if out.is_dir() else "a file" if out.is_file() else "a device or pipe"
    if out.is_symlink():
        existing = "a link"
    if existing != wanted:
        raise ViewerError(f"{out}: expected {wanted}, found {existing}")
    if folder:
        check_replaceable(out)
    if folder and any(out.iterdir()) and not all((out / name).is_file() for name in OWN_FILES):
        raise ViewerError(
            f"{out}: expected a folder that groundtrace share wrote, found another: it stays"
        )


def _fill(
    folder: Path,
    sources: Sources,
    rrd: Path | None,
    light: bool,
    report: Report,
    *,
    alone: bool,
) -> None:
    """Write everything into a folder; ``alone`` leaves out what one page has inside."""
    shown = timeline_file(sources, rrd, light, folder / "replay.rrd", report)
    (folder / "layout.rrd").write_bytes(layout_of(folder / "replay.rrd"))
    (folder / "moments.json").write_bytes(sources.moments.json())
    (folder / "page.json").write_bytes(_config(sources))
    opens_s = sources.moments.opens_s
    if drawing := opening_drawing(sources.results, sources.recording, opens_s):
        (folder / OPENING).write_bytes(drawing)
    if sources.scored:
        page = score_page(sources.results, sources.labels, sources.score, TOLERANCE_S)
        (folder / "report.html").write_text(page, "utf-8")
    links = [] if alone else _links(sources)
    (folder / "summary.html").write_text(summary_page(sources, shown, links), "utf-8")
    for download in _downloads(sources):
        (folder / download.name).write_bytes(download.content)
    if alone:
        return
    if sources.sidecar is not None:
        shutil.copyfile(sources.sidecar, folder / f"{sources.stem}.annotations.mcap")
    viewer = viewer_folder()
    for name in VIEWER_FILES:
        shutil.copyfile(viewer / name, folder / name)
    (folder / "page").mkdir()
    (folder / "page" / "style.css").write_bytes(folder_style())
    index = folder_page(_papers(folder), _downloads(sources), OPENING if drawing else "")
    (folder / "index.html").write_text(index, "utf-8")
    (folder / "README.txt").write_text(_readme(sources), "utf-8")


def _config(sources: Sources) -> bytes:
    """Return what a page must know of marks: it keeps them itself, and begins with these."""
    start_ns = sources.results.provenance.start_ns
    marks = [item_of(annotation, start_ns) for annotation in sources.annotations]
    return msgspec.json.encode({"annotations": "browser", "marks": marks})


def _links(sources: Sources) -> list[tuple[str, str]]:
    links = [("Replay", "index.html")]
    links += [("Score in full", "report.html")] if sources.scored else []
    return [*links, *((d.name, d.name) for d in _downloads(sources))]


def _papers(folder: Path) -> list[ShareDocument]:
    """Return the documents beside a replay."""
    titles = {"summary.html": "Summary", "report.html": "Score"}
    there = ((title, folder / name) for name, title in titles.items())
    return [
        ShareDocument(t, path.name, path.read_text("utf-8")) for t, path in there if path.is_file()
    ]


def _downloads(sources: Sources) -> list[Download]:
    recipe = sources.results.provenance.pipeline.encode()
    downloads = [Download("pipeline.toml", "text/plain", recipe)]
    if sources.annotations:
        marks = to_json(sources.key, sources.annotations)
        downloads.append(Download(f"{sources.stem}.annotations.json", "application/json", marks))
    return downloads


def _readme(sources: Sources) -> str:
    return (
        f"A replay of {sources.name}, shared by groundtrace.\n\n"
        "summary.html opens by a double click, report.html (where there is truth) too.\n"
        "The replay: open a terminal in this folder, run\n\n"
        "    python -I -m http.server 8000\n\n"
        "and open http://localhost:8000 in a browser (Chrome, Edge or Firefox of 2024 or later).\n"
        "Nothing is asked of the internet. Marks made there are kept in that browser; its button\n"
        "'download' gives them as a file, which whoever shared this takes in with\n\n"
        f"    groundtrace annotate {sources.name} --merge FILE\n\n"
        "With rerun-sdk installed, rerun replay.rrd shows the same without a browser.\n"
    )


def _pack(folder: Path, name: str, target: Path, mark: str) -> None:
    """Write a folder as an archive; members have no date, so that it says nothing of a clock."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            inside = f"{name}/{path.relative_to(folder).as_posix()}"
            entry = zipfile.ZipInfo(inside, EPOCH)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            with path.open("rb") as source, archive.open(entry, "w", force_zip64=True) as member:
                shutil.copyfileobj(source, member, 1 << 20)
        archive.comment = mark.encode()


def _one_page(folder: Path, sources: Sources) -> str:
    names = ("page.json", "moments.json", "layout.rrd", "replay.rrd")
    assets = {name: (folder / name).read_bytes() for name in names}
    opening = folder / OPENING
    drawn = Download(OPENING, "image/png", opening.read_bytes()) if opening.is_file() else None
    address = "" if drawn is None else drawn.address
    return whole_page(assets, _papers(folder), _downloads(sources), address)


#: Tells a page that a browser lets no page that was opened as a file read those beside it.
FROM_FILE_SCRIPT = (
    'if (location.protocol === "file:") document.documentElement.dataset.fromFile = "";'
)


class ShareDocument(NamedTuple):
    """A document that lies beside the replay: its title, file name, and HTML."""

    title: str
    name: str
    html: str


class Download(NamedTuple):
    """A file to be taken from the page: its name, its type, its bytes."""

    name: str
    kind: str
    content: bytes

    @property
    def address(self) -> str:
        """It, whole, as an address."""
        return f"data:{self.kind};base64,{base64.b64encode(self.content).decode()}"


def folder_page(
    papers: Sequence[ShareDocument], downloads: Sequence[Download], opening: str = ""
) -> str:
    """Return ``index.html`` of a folder that any web server of files can serve.

    Its script stands in it: some servers call script files text, and then they do not run.

    Parameters
    ----------
    papers, downloads
        What lies beside it.
    opening
        Address of a drawing of the moment that it opens at; empty without one.
    """
    script = joined_script()
    hashes = f"script-src {_hash(FROM_FILE_SCRIPT)} {_hash(script)} "
    return replay_page(
        policy=POLICY.replace("script-src ", hashes, 1),
        from_file=FROM_FILE_SCRIPT,
        script=script,
        papers=papers,
        downloads=downloads,
        opening=opening,
    )


def folder_style() -> bytes:
    """Return ``page/style.css`` of such a folder."""
    return page_file("style.css") + page_file("shared.css")


def whole_page(
    assets: Mapping[str, bytes],
    papers: Sequence[ShareDocument] = (),
    downloads: Sequence[Download] = (),
    opening: str = "",
) -> str:
    """Return a page with everything inside, which opens by a double click and asks nobody.

    Parameters
    ----------
    assets
        Contents of :data:`ASSETS`: ``page.json`` is ``{"annotations": "browser"}`` or ``"off"``,
        with ``"marks"`` those that the page begins with, as items of the exchange format,
        ``moments.json`` as of :class:`~.rerun.moments.PageMoments`, ``layout.rrd`` as of
        :func:`~.rerun.blueprint.layout_of`, and the viewer's file.
    papers
        Shown above the replay when asked for.
    downloads
        Files that it gives away.
    opening
        As of :func:`folder_page`.

    Raises
    ------
    ViewerError
        Where the viewer is not installed.
    """
    folder = viewer_folder()
    embedded = {name: assets[name] for name in ASSETS}
    embedded["re_viewer_bg.wasm"] = (folder / "re_viewer_bg.wasm").read_bytes()
    style = folder_style().decode()
    viewer = _inside((folder / "re_viewer.js").read_text("utf-8"))
    script = _inside(joined_script())
    # a document inside a page obeys the page's policy too
    styles = [style, *(s for p in papers for s in re.findall("<style>(.*?)</style>", p.html, re.S))]
    return replay_page(
        policy=_policy((viewer, script), styles),
        style=style,
        viewer=viewer,
        script=script,
        embedded={name: _packed(content) for name, content in embedded.items()},
        papers=papers,
        downloads=downloads,
        opening=opening,
    )


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"


#: What of the signals a file shows, for people.
LIGHT = "envelopes of fast signals, without their samples"
FULL = "all that groundtrace replay shows"


def timeline_file(
    sources: Sources, given: Path | None, light: bool, target: Path, report: Report = unheard
) -> str:
    """Write the viewer's file of a result, and return what of the signals it shows.

    A file that is ``given`` is taken as it is; else the recording is replayed; where the recording
    is not there, the file that ``groundtrace replay`` left beside the results is taken.

    Parameters
    ----------
    sources
        What is shared.
    given
        A viewer's file of the same recording, or None.
    light
        Leave the samples of fast signals out.
    target
        The file to write.
    report
        Told what a person should know of it.

    Raises
    ------
    ViewerError
        Where there is neither recording nor file, or the file is of another recording.
    """
    if given is None and sources.recording is not None:
        _replayed(sources, sources.recording, light, target, report)
        return LIGHT if light else FULL
    there = given if given is not None else _beside(sources)
    if there is None:
        raise ViewerError(
            f"{sources.path.name}: expected its recording {sources.name} beside it, --recording "
            f"FILE or --rrd FILE, found none of them"
        )
    if given is None:
        report(f"{sources.name} is not there: its timeline {there.name} is taken as it is")
    _check(sources, there)
    if light:
        _without_samples(there, target)
        return LIGHT
    target.write_bytes(there.read_bytes())
    return f"what {there.name} has"


def _replayed(sources: Sources, recording: Path, light: bool, target: Path, report: Report) -> None:
    """Replay a recording as the results say that it was."""
    with scratch_folder() as folder:
        fresh = Path(folder, "fresh.mcap")
        recipe = written_recipe(sources.results, Path(folder))
        lines: list[str] = []
        replay_to_files(
            recording,
            recipe.pipeline,
            fresh,
            target,
            geometry=recipe.geometry,
            from_s=recipe.from_,
            to_s=recipe.to,
            full_rate="none" if light else "",
            report=lines.append,
        )
        for line in lines:
            if "annotations are left out" not in line:  # said already
                report(line)
        if _decided(read_results(fresh)) != _decided(sources.results):
            report(
                f"{sources.path.name}: this version decides otherwise than when it was made: the "
                f"timeline shows what it decides now; replay and share again to have both the same"
            )


def _decided(results: Results) -> list[str]:
    kinds = (StepEvent, Pick, Fix, TrackPoint)
    return sorted(repr(event) for event in results.events if isinstance(event, kinds))


def _beside(sources: Sources) -> Path | None:
    """Return the viewer's file that a replay left with the results."""
    stem = sources.path.name.removesuffix(".mcap").removesuffix(".results")
    names = dict.fromkeys((f"{stem}.rrd", f"{sources.stem}.rrd"))
    return next((p for p in map(sources.path.with_name, names) if p.is_file()), None)


def _check(sources: Sources, rrd: Path) -> None:
    """Refuse a file that shows another recording; the viewer's id of one is made of its name."""
    import rerun as rr

    try:
        shown = rr.chunk.RrdReader(str(rrd)).recordings()
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ViewerError(f"{rrd.name}: expected a viewer's file, found: {reason}") from error
    expected = stream_of(sources.name, sources.config.application).get_recording_id()
    if expected not in {each.recording_id for each in shown}:
        raise ViewerError(
            f"{rrd.name}: expected the timeline of {sources.name}, found that of another recording"
        )


def _without_samples(rrd: Path, target: Path) -> None:
    """Copy a viewer's file without the samples of signals that have an envelope."""
    import rerun as rr

    paths = {chunk.entity_path for chunk in rr.chunk.RrdReader(str(rrd)).stream()}
    tails = [path.removeprefix("/envelope") for path in paths if path.startswith("/envelope/")]
    drop = sorted(f"/signals{tail}" for tail in tails if f"/signals{tail}" in paths)
    command = [str(viewer_program()), "rrd", "filter", str(rrd), "-o", str(target)]
    if drop:
        command += ["--drop-entity", *drop]
    done = subprocess.run(command, env=quiet_environment(), capture_output=True, text=True)
    if done.returncode or not target.is_file():
        reason = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
        raise ViewerError(f"{rrd.name}: expected it to be filtered, found: {reason}")


#: What a page shows beside the viewer's program, by the names that its script asks for.
ASSETS = ("page.json", "moments.json", "layout.rrd", "replay.rrd")


def _inside(script: str) -> str:
    """Return a script that an HTML element may hold."""
    return script.replace("</script", "<\\/script")


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 6, mtime=0)).decode()


def _policy(scripts: Sequence[str], styles: Sequence[str]) -> str:
    """Return a policy that lets these scripts run, no others, and nothing leave the page."""
    allowed, drawn = (" ".join(dict.fromkeys(map(_hash, each))) for each in (scripts, styles))
    return (
        f"default-src 'none'; script-src {allowed} 'wasm-unsafe-eval'; style-src {drawn}; "
        "img-src data: blob:; connect-src data: blob:; worker-src blob:; base-uri 'none'; "
        "form-action 'none'"
    )
