"""Which recordings a fleet is: files, folders, patterns and URLs, in one order."""

from __future__ import annotations

import glob
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.remote import as_url, file_system, is_url, public_url

from ..errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Files that lie beside recordings and are none, though they are MCAP too.
_BESIDE = (".annotations.mcap", ".results.mcap")
_PATTERN = re.compile(r"[*?\[]")
TRUTH_SUFFIXES = (".csv", ".truth.csv", ".sgt", ".annotations.mcap", ".mcap")


def recordings_of(arguments: Sequence[str]) -> list[str]:
    """Return every recording that the arguments mean, sorted, each once.

    Parameters
    ----------
    arguments
        Files, folders (with all below them), patterns as the shell knows them, URLs of those.

    Raises
    ------
    RecordingError
        Where an argument means none.
    CodecError
        Where a URL cannot be listed.
    """
    found: set[str] = set()
    for argument in arguments:
        places = _remote(argument) if is_url(argument) else _local(argument)
        if not places:
            raise RecordingError(
                f"{argument}: expected a recording, a folder of recordings or a pattern, found none"
            )
        found.update(places)
    if not found:
        raise RecordingError("fleet: expected recordings, found none")
    return sorted(found)


def name_of(location: str) -> str:
    """Return the file name of a recording, without the query of its URL."""
    return PurePosixPath(public_url(location)).name if is_url(location) else Path(location).name


def shard_of(text: str) -> tuple[int, int]:
    """Read ``I/N``: the shard I of N, from 1.

    Raises
    ------
    RecordingError
        Where it is not that.
    """
    index, slash, count = text.partition("/")
    if slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count):
        return int(index), int(count)
    raise RecordingError(f"--shard: expected I/N with I from 1 to N, found {text!r}")


def truth_beside(truth: Path | None, locations: Sequence[str]) -> dict[str, Path]:
    """Return the file of truth of each recording that has one.

    Parameters
    ----------
    truth
        A file, for one recording, or a folder with files named as the recordings are: ``walk.csv``
        or ``walk.truth.csv`` for ``walk.mcap``.
    locations
        The recordings.

    Raises
    ------
    RecordingError
        Where it is neither, or one file is given for several recordings.
    """
    if truth is None:
        return {}
    if truth.is_dir():
        named = {place: _named(truth, PurePosixPath(name_of(place)).stem) for place in locations}
        return {place: path for place, path in named.items() if path is not None}
    if not truth.is_file():
        raise RecordingError(f"{truth}: expected a truth file or folder, found none")
    if len(locations) > 1:
        raise RecordingError(
            f"--truth: expected a folder for {len(locations)} recordings, found the file {truth}"
        )
    return {locations[0]: truth}


def _named(folder: Path, stem: str) -> Path | None:
    files = (folder / f"{stem}{suffix}" for suffix in TRUTH_SUFFIXES)
    return next((path for path in files if path.is_file()), None)


def _local(argument: str) -> list[str]:
    path = Path(argument)
    if path.is_dir():
        below = (p for p in path.rglob("*.mcap") if p.is_file())
        return [str(p) for p in below if _is_recording(p.name)]
    if path.is_file() or not _PATTERN.search(argument):
        return [str(path)] if path.is_file() else []
    matched = (Path(p) for p in glob.glob(argument, recursive=True))  # noqa: PTH207  # absolute too
    return [str(p) for p in matched if p.is_file() and _is_recording(p.name)]


def _remote(argument: str) -> list[str]:
    url = as_url(argument)
    pattern = _PATTERN.search(public_url(url).partition("://")[2])
    if not pattern and (url.startswith("http") or public_url(url).endswith(".mcap")):
        return [url]
    system, path = file_system(url)
    listed = system.glob(path) if pattern else system.find(path)
    return [system.unstrip_protocol(p) for p in listed if _is_recording(p)]


def _is_recording(name: str) -> bool:
    return name.endswith(".mcap") and not name.endswith(_BESIDE)
