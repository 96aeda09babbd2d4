"""``groundtrace share``."""

from __future__ import annotations

from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..errors import RecordingError
from ..plugins import load
from ..results import file_sha256, read_results
from .output import existing, print_warnings, say

if TYPE_CHECKING:
    from ..results import Provenance

FLAG = Parameter(negative="")


def share(
    results: Path,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"])],
    zip_: Annotated[bool, Parameter(name="--zip", negative="")] = False,
    single_file: Annotated[bool, FLAG] = False,
    light: Annotated[bool, FLAG] = False,
    recording: Path | None = None,
    rrd: Path | None = None,
    force: Annotated[bool, FLAG] = False,
) -> None:
    """Write a folder that shows a result to others, who need neither groundtrace nor a network.

    It holds the replay with the viewer, a summary with figures, the score, the annotations and the
    pipeline. It names no folder, user or machine.

    Parameters
    ----------
    results
        Results MCAP that groundtrace replay wrote.
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
        Replace what was shared there before.
    """
    if zip_ and single_file:
        raise RecordingError("--zip: expected it without --single-file, found both")
    form = "zip" if zip_ else "html" if single_file else "folder"
    if form != "folder" and out.suffix.lower() != f".{form}":
        raise RecordingError(f"{out}: expected a name that ends in .{form}, found {out.name}")
    existing(results, "results")
    timeline = None if rrd is None else existing(rrd, "a viewer's file")
    found = recording_of(results, recording)
    write = load("views", "share")
    write(results, out, form=form, recording=found, rrd=timeline, light=light, force=force)
    print_warnings(read_results(results, blocks=False).warnings)
    _report(out, form)


def recording_of(results: Path, given: Path | None = None) -> Path | None:
    """Return the recording of results: the one given, or one of their name and their bytes.

    It is looked for beside them, in the present folder and among the bundled recordings.

    Raises
    ------
    RecordingError
        Where the one given has other bytes, or ``results`` are none.
    """
    result = read_results(results)
    if given is not None:
        if not _same(existing(given), result.provenance):
            raise RecordingError(
                f"{given}: expected the recording that {results.name} is of, found other bytes"
            )
        return given
    name = PureWindowsPath(result.provenance.recording).name
    places = (results.parent / name, Path(name), _bundled(name))
    there = list(dict.fromkeys(p for p in places if p is not None and p.is_file()))
    found = next((p for p in there if _same(p, result.provenance)), None)
    if there and found is None:
        say(f"{there[0]}: not the recording that {results.name} is of: its bytes are others")
    return found


def _same(recording: Path, origin: Provenance) -> bool:
    return file_sha256(recording) == origin.sha256


def _bundled(name: str) -> Path | None:
    from groundtrace_recordings import bundled

    return bundled().get(name)


def _report(out: Path, form: str) -> None:
    """Say what was written, how large it is and how to open it."""
    if form == "folder":
        files = [path for path in out.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        replay = (out / "replay.rrd").stat().st_size
        print(f"shared: {out}, {len(files)} files, {_mb(size)} ({_mb(replay)} of it the replay)")
        print(f"open it with: python -m http.server 8000 --bind 127.0.0.1 --directory {out}")
        print(f"then http://localhost:8000 in a browser; {out / 'summary.html'} opens by itself")
        return
    print(f"shared: {out}, {_mb(out.stat().st_size)}")
    if form == "zip":
        print("unpack it, run python -m http.server 8000 in its folder, open http://localhost:8000")
    else:
        print("open it by a double click: it needs no server and no network")


def _mb(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
