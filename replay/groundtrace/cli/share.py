"""``groundtrace share``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..api.files import existing_file, recording_of
from ..errors import UsageError
from ..pipeline.plugins import load
from ..pipeline.results import read_results
from .console import print_json, print_line, print_stderr, print_warnings
from .options import FLAG, OUT, Json, Results


def share(
    results: Results,
    *,
    out: Annotated[Path, OUT],
    zip_: Annotated[bool, Parameter(name="--zip", negative="")] = False,
    single_file: Annotated[bool, FLAG] = False,
    light: Annotated[bool, FLAG] = False,
    recording: Path | None = None,
    rrd: Path | None = None,
    force: Annotated[bool, FLAG] = False,
    json: Json = False,
) -> None:
    """Write a folder that shows a result to others, who need neither groundtrace nor a network.

    It holds the replay with the viewer, a summary with figures, the score, the annotations and the
    pipeline. It names no folder, user or machine.

    Parameters
    ----------
    out
        The folder to write.
    zip_
        Write one .zip of the folder instead.
    single_file
        Write one .html instead, with everything inside, that opens by a double click.
    light
        Leave out the samples of fast signals; envelopes, spectrograms and all events stay.
    recording
        The recording, where it does not lie beside the results.
    rrd
        A timeline that groundtrace replay wrote, instead of replaying the recording.
    force
        Replace what was shared there of another recording, too.
    """
    if zip_ and single_file:
        raise UsageError("--zip: expected it without --single-file, found both")
    form = "zip" if zip_ else "html" if single_file else "folder"
    if form != "folder" and out.suffix.lower() != f".{form}":
        raise UsageError(f"{out}: expected a name that ends in .{form}, found {out.name}")
    existing_file(results, "results")
    timeline = None if rrd is None else existing_file(rrd, "a viewer's file")
    recording_path = recording_of(results, recording, print_stderr)
    write = load("views", "share")
    options = {"light": light, "force": force, "report": print_stderr}
    write(results, out, form=form, recording=recording_path, rrd=timeline, **options)
    files = [path for path in out.rglob("*") if path.is_file()] if form == "folder" else [out]
    size = sum(path.stat().st_size for path in files)
    warnings = read_results(results, blocks=False).warnings
    if json:
        document = {"path": str(out), "form": form, "files": len(files), "size_bytes": size}
        print_json(document, warnings)
        return
    print_warnings(warnings)
    _report(out, form, len(files), size)


def _report(out: Path, form: str, files: int, size: int) -> None:
    """Say what was written, how large it is and how to open it."""
    if form == "folder":
        replay = (out / "replay.rrd").stat().st_size
        print_line(f"shared: {out}, {files} files, {_mb(size)} ({_mb(replay)} of it the replay)")
        print_line(
            f"open it with: python -I -m http.server 8000 --bind 127.0.0.1 --directory {out}"
        )
        print_line(
            f"then http://localhost:8000 in a browser; {out / 'summary.html'} opens by itself"
        )
        return
    print_line(f"shared: {out}, {_mb(size)}")
    if form == "zip":
        print_line(
            "unpack it, run python -I -m http.server 8000 in its folder, open http://localhost:8000"
        )
    else:
        print_line("open it by a double click: it needs no server and no network")


def _mb(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
