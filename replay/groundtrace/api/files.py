"""Input and output files: whether inputs exist, and whether outputs may be replaced.

What was derived from a recording can be made again, and is replaced where it is of the same one:
results by the SHA-256 in their metadata; timelines, pages and figures by a mark at one of their
ends. What people made or recorded stays.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Protocol

from groundtrace_codecs.location import is_url
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


def existing(path: Path, what: str = "a recording") -> Path:
    """Return a path that is a readable file, or a URL, which is known when it is opened.

    Raises
    ------
    RecordingError
        Where there is no such file.
    """
    if not (path.is_file() or is_url(path)):
        raise RecordingError(f"{path}: expected {what}, found no such file")
    if what == "a recording" and not is_url(path):
        _refuse_foreign(path)
    return path


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
    from groundtrace_codecs.importers.run import CERTAIN, importers

    sure = {name: each.sniff(path) for name, each in importers().items()}
    name = max(sure, key=lambda key: sure[key])
    if sure[name] <= 0:
        return
    needs_map = name in _TABLES or sure[name] < CERTAIN
    command = f"groundtrace import {path} -o {path.stem}.mcap" + (
        f" --map MAP.toml (groundtrace import {path} --guess writes a map to start from)"
        if needs_map
        else ""
    )
    found = _TABLES.get(name, f"a file of format {name}")
    raise RecordingError(f"{path}: expected a recording, found {found}; import it: {command}")


#: Importers that need a map, and what they read.
_TABLES = {
    "csv": "a text table",
    "mat": "a MATLAB file",
    "hdf5": "an HDF5 file",
    "npz": "a NumPy archive",
}


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
    """Return a path that may be written while ``sources`` are read.

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
        Where the file exists and may not be replaced, it is a folder, a device or one of
        ``sources``, or its folder does not exist.
    """
    if not path.resolve().parent.is_dir():
        raise RecordingError(f"{path}: expected an existing folder, found none")
    if path.exists() and not path.is_file():  # a new file would take the place of a device
        found = "a folder" if path.is_dir() else "a device or pipe"
        raise RecordingError(f"{path}: expected a file to write, found {found}")
    if path.resolve() in (source.resolve() for source in sources):
        raise RecordingError(f"{path}: expected a new file, found the one that is read")
    if path.exists() and not (force or (of is not None and _derived_from(path, of()))):
        raise RecordingError(f"{path}: expected a new file, found an existing one; see --force")
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


def _derived_from(path: Path, origin: Origin) -> bool:
    """Whether a file is results, a timeline, a page or a figure of a recording."""
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

    It is looked for beside them, in the present folder and among the bundled recordings.

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
        report(f"{there[0]}: not the recording that {results.name} is of: its bytes are others")
    return found


def _same(recording: Path, origin: Provenance) -> bool:
    return file_sha256(recording) == origin.sha256


def _bundled(name: str) -> Path | None:
    from groundtrace_recordings import bundled

    return bundled().get(name)
