"""Input and output files: whether inputs exist, and whether outputs may be replaced."""

from __future__ import annotations

from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

from groundtrace_codecs.location import is_url

from ..errors import RecordingError
from ..pipeline.results import file_sha256, read_results

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
    return path


def writable(path: Path, *, force: bool, sources: Sequence[Path] = ()) -> Path:
    """Return a path that may be written while ``sources`` are read.

    Raises
    ------
    RecordingError
        Where the file exists and ``force`` is not given, it is a folder or one of ``sources``, or
        its folder does not exist.
    """
    if not path.resolve().parent.is_dir():
        raise RecordingError(f"{path}: expected an existing folder, found none")
    if path.is_dir():
        raise RecordingError(f"{path}: expected a file to write, found a folder")
    if path.resolve() in (source.resolve() for source in sources):
        raise RecordingError(f"{path}: expected a new file, found the one that is read")
    if path.exists() and not force:
        raise RecordingError(f"{path}: expected a new file, found an existing one; see --force")
    return path


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
