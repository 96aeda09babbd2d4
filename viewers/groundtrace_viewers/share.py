"""A result as others get it: a folder, an archive of it, or one page, with all that it shows."""

from __future__ import annotations

import shutil
import zipfile
from typing import TYPE_CHECKING

import msgspec

from groundtrace.annotate import to_json
from groundtrace.annotate.exchange import item_of
from groundtrace.api.reports import unheard
from groundtrace.appearing import appearing
from groundtrace.score.html import score_page

from .errors import ViewerError
from .layout_file import layout_of
from .share_page import Download, Paper, folder_page, folder_style, whole_page
from .share_replay import timeline_file
from .share_sources import sources_of
from .summary import summary_page
from .verdict import TOLERANCE_S
from .viewer_files import VIEWER_FILES, viewer_folder

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace.api.reports import Report

    from .share_sources import Sources

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
        Replace what was shared there before.
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
    _check_target(out, form == "folder", force, used)
    sources = sources_of(results, recording, report)
    with appearing(out) as fresh:
        folder = fresh if form == "folder" else fresh.with_name(f"{fresh.name}.d")
        folder.mkdir()
        try:
            _fill(folder, sources, rrd, light, report, alone=form == "html")
            if form == "zip":
                _pack(folder, out.stem, fresh)
            elif form == "html":
                fresh.write_text(_one_page(folder, sources), "utf-8")
        finally:
            if folder != fresh:
                shutil.rmtree(folder)


def _check_target(out: Path, folder: bool, force: bool, used: Sequence[Path]) -> None:
    """Refuse to overwrite what was not asked for, or what nobody shared."""
    if not out.resolve().parent.is_dir():
        raise ViewerError(f"{out}: expected an existing folder to write it in, found none")
    for path in used:
        if out.resolve() in (path.resolve(), *path.resolve().parents):
            raise ViewerError(f"{out}: expected a new place, found the one that {path} is read at")
    if not (out.exists() or out.is_symlink()):
        return
    if not force:
        raise ViewerError(f"{out}: expected a new place, found an existing one; see --force")
    if out.is_symlink() or out.is_dir() != folder:
        found = "a link" if out.is_symlink() else "a folder" if out.is_dir() else "a file"
        raise ViewerError(f"{out}: expected {'a folder' if folder else 'a file'}, found {found}")
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
    index = folder_page(_papers(folder), _downloads(sources))
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


def _papers(folder: Path) -> list[Paper]:
    """Return the documents beside a replay."""
    titles = {"summary.html": "Summary", "report.html": "Score"}
    there = ((title, folder / name) for name, title in titles.items())
    return [Paper(t, path.name, path.read_text("utf-8")) for t, path in there if path.is_file()]


def _downloads(sources: Sources) -> list[Download]:
    recipe = sources.results.provenance.pipeline.encode()
    found = [Download("pipeline.toml", "text/plain", recipe)]
    if sources.annotations:
        marks = to_json(sources.key, sources.annotations)
        found.append(Download(f"{sources.stem}.annotations.json", "application/json", marks))
    return found


def _readme(sources: Sources) -> str:
    return (
        f"A replay of {sources.name}, shared by groundtrace.\n\n"
        "summary.html opens by a double click, report.html (where there is truth) too.\n"
        "The replay: open a terminal in this folder, run\n\n"
        "    python -m http.server 8000\n\n"
        "and open http://localhost:8000 in a browser (Chrome, Edge or Firefox of 2024 or later).\n"
        "Nothing is asked of the internet. Marks made there are kept in that browser; its button\n"
        "'download' gives them as a file, which whoever shared this takes in with\n\n"
        f"    groundtrace annotate {sources.name} --merge FILE\n\n"
        "With rerun-sdk installed, rerun replay.rrd shows the same without a browser.\n"
    )


def _pack(folder: Path, name: str, target: Path) -> None:
    """Write a folder as an archive; members have no date, so that it says nothing of a clock."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            inside = f"{name}/{path.relative_to(folder).as_posix()}"
            entry = zipfile.ZipInfo(inside, EPOCH)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            with path.open("rb") as source, archive.open(entry, "w", force_zip64=True) as member:
                shutil.copyfileobj(source, member, 1 << 20)


def _one_page(folder: Path, sources: Sources) -> str:
    names = ("page.json", "moments.json", "layout.rrd", "replay.rrd")
    assets = {name: (folder / name).read_bytes() for name in names}
    return whole_page(assets, _papers(folder), _downloads(sources))
