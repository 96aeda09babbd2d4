"""Input and output files: whether inputs exist, and whether outputs may be replaced.

What was derived from a recording can be made again, and is replaced where it is of the same one:
results by the SHA-256 in their metadata; timelines, pages and figures by a mark at one of their
ends. What people made or recorded stays.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Protocol

from groundtrace_codecs.location import as_url, is_url
from groundtrace_codecs.mcap.chunks import MAGIC

from ..errors import RecordingError
from ..pipeline.results import (
    file_sha256,
    is_result_of,
    previous_results,
    read_results,
    timeline_id,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..pipeline.results import Provenance

    #: Takes a line that a person should read.
    Report = Callable[[str], None]


def unheard(_line: str) -> None:
    """Take a line that nobody reads."""


def existing_file(path: Path, what: str) -> Path:
    """Return a path that is a readable file, or a URL, which is known when it is opened.

    Raises
    ------
    RecordingError
        Where there is no such file; it says that ``what`` was expected.
    """
    if not (path.is_file() or is_url(path)):
        raise RecordingError(f"{path}: expected {what}, found no such file")
    return path


def existing_recording(path: Path) -> Path:
    """Return a path that may be a recording: a URL, or a file of no other tool.

    Raises
    ------
    RecordingError
        Where there is no such file, or it is of another tool; it names the command that takes it.
    """
    if not is_url(existing_file(path, "a recording")):
        _refuse_foreign(path)
    return path


def named_recording(path: Path) -> Path:
    """Return the recording that is meant: a file, a URL, or else one by its name.

    Raises
    ------
    RecordingError
        As :func:`existing_recording` does; of one of the catalogue that was not fetched yet.
    """
    if path.is_file() or is_url(path) or path.name != str(path):
        return existing_recording(path)
    name = path.name.removesuffix(".mcap")
    return _bundled(f"{name}.mcap") or _fetched(name) or existing_recording(path)


#: What a timeline begins with. Source: the rerun file format, version 2.
_TIMELINE = b"RRF2"
#: Files that are recordings whatever they begin with: torn ones, which the reader judges.
_RECORDINGS = frozenset({".mcap", ".partial"})


def _refuse_foreign(path: Path) -> None:
    """Refuse a file of another tool by name of the command that takes it."""
    if path.suffix in _RECORDINGS:
        return
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
    if head == MAGIC:
        return
    if head.startswith(_TIMELINE):
        raise RecordingError(
            f"{path}: expected a recording, found a timeline; open it with: rerun {path}"
        )
    # importers are not loaded before there is something to import
    from groundtrace_codecs.importers.run import CERTAIN, MAPPED, importers

    sure = {name: each.sniff(path) for name, each in importers().items()}
    name = max(sure, key=lambda key: sure[key])
    if sure[name] <= 0:
        return
    command = f"groundtrace import {path} -o {path.stem}.mcap"
    if name in MAPPED or sure[name] < CERTAIN:
        command += " --map MAP.toml"
    if name == "csv":
        command += f" (groundtrace import {path} --guess writes a map to start from)"
    kind = MAPPED.get(name, f"a file of format {name}")
    raise RecordingError(f"{path}: expected a recording, found {kind}; import it: {command}")


class Origin(Protocol):
    """The recording that outputs are derived from."""

    @property
    def recording(self) -> str:
        """Its file name."""

    @property
    def sha256(self) -> str:
        """Of its bytes."""


class OriginFile:
    """A recording that outputs are derived from; its bytes are looked at when asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recording = path.name

    @cached_property
    def sha256(self) -> str:
        """Of its bytes."""
        return file_sha256(self.path)


#: Bytes at both ends of a file in which a mark is looked for. Chosen by judgement: a timeline has
#: it in the first 100 (rerun 0.41), a page in the first 500, a PDF in the last 2000.
_ENDS = 4096


def writable(
    path: Path,
    *,
    force: bool,
    sources: Sequence[Path] = (),
    of: Callable[[], Origin] | None = None,
) -> Path:
    """Return a path that may be written while ``sources`` are read; its folder is made.

    Parameters
    ----------
    path
        The output.
    force
        Whether any existing file may be replaced.
    sources
        What is read, and never replaced.
    of
        Where it is derived from, asked where the file exists: what was derived from the same
        recording may be replaced.

    Raises
    ------
    RecordingError
        Where the file exists and may not be replaced, or it is a folder, a device or one of
        ``sources``.
    """
    if path.exists() and not path.is_file():  # a new file would take the place of a device
        kind = "a folder" if path.is_dir() else "a device or pipe"
        raise RecordingError(f"{path}: expected a file to write, found {kind}")
    if path.resolve() in (source.resolve() for source in sources):
        raise RecordingError(f"{path}: expected a new file, found the one that is read")
    if path.exists() and not (force or (of is not None and derived_from(path, of()))):
        raise RecordingError(f"{path}: expected a new file, found an existing one; see --force")
    return in_folder(path)


def check_replaceable(folder: Path) -> None:
    """Refuse a folder that cannot be put away for another of its name.

    Raises
    ------
    RecordingError
        Where the command runs in it, or a file system is mounted there.
    """
    here = Path.cwd()
    if folder.resolve() in (here, *here.parents):
        reason = "the one that the command runs in"
    elif os.path.ismount(folder):
        reason = "one where a file system is mounted"
    else:
        return
    raise RecordingError(f"{folder}: expected a folder that can be replaced, found {reason}")


def in_folder(path: Path) -> Path:
    """Return a path whose folder there is: made, where there was none.

    Raises
    ------
    RecordingError
        Where something else has the name of a folder, or it is a URL.
    """
    if is_url(path):
        raise RecordingError(f"{as_url(path)}: expected a path to write to, found a URL")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise RecordingError(f"{path}: expected a folder to write in, found a file") from None
    return path


def results_writable(path: Path, source: OriginFile, *, force: bool) -> Path:
    """Return a path where results of a recording may be written, and those there be kept.

    Raises
    ------
    RecordingError
        As :func:`writable` does; of the place where those are kept, too.
    """
    writable(path, force=force, sources=[source.path], of=lambda: source)
    if path.exists():
        writable(previous_results(path), force=force, sources=[source.path], of=lambda: source)
    return path


def mark_of(origin: str) -> str:
    """Return what a figure, page or archive says of what it is derived from.

    Parameters
    ----------
    origin
        The SHA-256 of a recording, or the timeline's id of a file that people edit.
    """
    return f"groundtrace recording {origin}"


def derived_from(path: Path, origin: Origin) -> bool:
    """Whether a file is results, a timeline, a page, an archive or a figure of a recording."""
    with path.open("rb") as file:
        ends = file.read(_ENDS)
        file.seek(max(0, path.stat().st_size - _ENDS))
        ends += file.read(_ENDS)
    marks = (timeline_id(origin.recording), origin.sha256)
    if b"groundtrace" in ends and any(mark and mark.encode() in ends for mark in marks):
        return True
    return is_result_of(path, origin.sha256)


def recording_of(results: Path, given: Path | None = None, report: Report = unheard) -> Path | None:
    """Return the recording of results: the one given, or one of their name and their bytes.

    It is looked for beside them, in the present folder and among the recordings known by name.

    Parameters
    ----------
    results
        Their file.
    given
        The recording, where it is known.
    report
        Told where one of that name is there, and has other bytes.

    Raises
    ------
    RecordingError
        Where the one given has other bytes, or ``results`` are none.
    """
    result = read_results(results, blocks=False)
    if given is not None:
        existing_recording(given)
        hashed = result.provenance.sha256  # not of a span of a URL: the rest was not fetched
        if hashed and not _same(given, result.provenance):
            raise RecordingError(
                f"{given}: expected the recording that {results.name} is of, found other bytes"
            )
        return given
    name = PureWindowsPath(result.provenance.recording).name
    places = (results.parent / name, Path(name), _bundled(name) or _catalogued(name))
    there = list(dict.fromkeys(p for p in places if p is not None and p.is_file()))
    recording = next((p for p in there if _same(p, result.provenance)), None)
    if there and recording is None:
        report(f"{there[0]}: not the recording that {results.name} is of: its bytes are others")
    return recording


def _same(recording: Path, origin: Provenance) -> bool:
    return file_sha256(recording) == origin.sha256


def _fetched(name: str) -> Path | None:
    """Return a recording of the catalogue; nothing is fetched by a command that does not say so."""
    path = _catalogued(f"{name}.mcap")
    if path is not None and not path.is_file():
        raise RecordingError(
            f"{name}: expected a recording, found one to fetch: groundtrace recordings get {name}"
        )
    return path


def _catalogued(name: str) -> Path | None:
    """Return where a recording of the catalogue is once it was fetched, by its file name."""
    from groundtrace_recordings.catalogue import catalogue

    entry = catalogue().get(name.removesuffix(".mcap"))
    return entry.path if entry else None


def _bundled(name: str) -> Path | None:
    from groundtrace_recordings import bundled

    return bundled().get(name)
