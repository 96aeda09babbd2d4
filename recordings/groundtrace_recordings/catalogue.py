"""Recordings that others published, fetched by their hashes when asked for, and converted.

``catalogue.toml`` names the files of each with their SHA-256. They are fetched with ``pooch``, kept
in its cache folder for ``groundtrace`` (``GROUNDTRACE_RECORDINGS`` names another one), and become
one recording there. ``GROUNDTRACE_OFFLINE=1`` refuses to fetch.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from groundtrace_codecs.errors import CodecError

from . import folder, map_path

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CataloguedRecording", "FetchError", "RemoteFile", "cache_folder", "catalogue", "fetch"]

#: Environment variables: where recordings are kept; whether fetching is refused.
FOLDER, OFFLINE = "GROUNDTRACE_RECORDINGS", "GROUNDTRACE_OFFLINE"
#: Longest silence of a server [s]. Chosen by judgement: a slow line is heard of sooner.
TIMEOUT_S = 30.0


class FetchError(CodecError):
    """A recording of the catalogue cannot be fetched, or is not what the catalogue says."""


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """One file of a recording: its address, SHA-256 and size."""

    url: str
    sha256: str
    bytes: int

    @property
    def name(self) -> str:
        """Its file name."""
        return unquote(urlsplit(self.url).path).rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class CataloguedRecording:
    """A recording of the catalogue: where it is from, and how it becomes one.

    Attributes
    ----------
    name
        By which commands take it.
    files
        What is fetched.
    tuned_on
        Whether a setting was chosen on it, or it was seen while a method was made.
    truth
        Number of labels of each kind.
    map
        Name of the import map, empty where the files need none.
    truth_file
        Which of the files holds the truth, empty where none does.
    excerpt
        The bundled recording that is an excerpt of it, under the same licence; empty where none is.
    """

    name: str
    title: str
    licence: str
    authors: str
    citation: str
    tuned_on: bool
    files: tuple[RemoteFile, ...]
    truth: dict[str, int]
    map: str
    truth_file: str
    excerpt: str

    @property
    def bytes(self) -> int:
        """How much is fetched [byte]."""
        return sum(each.bytes for each in self.files)

    @property
    def path(self) -> Path:
        """Where the recording is, once it was fetched."""
        return cache_folder() / f"{self.name}.mcap"


def catalogue() -> dict[str, CataloguedRecording]:
    """Return the recordings that can be fetched, by their names."""
    document = tomllib.loads((folder() / "catalogue.toml").read_text("utf-8"))
    return {name: _entry(name, dict(given)) for name, given in document.items()}


def _entry(name: str, given: dict[str, object]) -> CataloguedRecording:
    files: list[dict[str, object]] = given.pop("files")  # type: ignore[assignment]
    optional = {"truth": {}, "map": "", "truth_file": "", "excerpt": ""}
    each = tuple(RemoteFile(**file) for file in files)  # type: ignore[arg-type]
    return CataloguedRecording(name, files=each, **(optional | given))  # type: ignore[arg-type]


def cache_folder() -> Path:
    """Return where fetched recordings are kept."""
    named = os.environ.get(FOLDER)
    if named:
        return Path(named)
    import platformdirs  # what pooch.os_cache asks, without what fetches

    return Path(platformdirs.user_cache_dir("groundtrace"))


def fetch(
    wanted: CataloguedRecording,
    *,
    offline: bool = False,
    report: Callable[[str], None] | None = None,
) -> Path:
    """Return the file of a recording; fetch and convert it where it is not there yet.

    Parameters
    ----------
    wanted
        Of :func:`catalogue`.
    offline
        Refuse to fetch, as ``GROUNDTRACE_OFFLINE=1`` does.
    report
        Told how much is fetched and from where, before it is.

    Raises
    ------
    FetchError
        Where a file cannot be had, or its SHA-256 is another one; nothing is left of it.
    CodecError
        Where it cannot be converted, e.g. as a package is missing.
    """
    if wanted.path.is_file():
        return wanted.path
    if offline or os.environ.get(OFFLINE, "0") not in ("", "0"):
        why = "--offline" if offline else f"{OFFLINE}={os.environ[OFFLINE]}"
        raise FetchError(f"{wanted.name}: expected to fetch {wanted.files[0].url}, found {why}")
    from filelock import FileLock

    if report is not None:
        host, size = urlsplit(wanted.files[0].url).hostname, wanted.bytes / 1e6
        report(f"fetching {wanted.name} from {host}: {size:.1f} MB")
    folder = wanted.path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock"):  # who comes second finds it done
        if not wanted.path.is_file():
            _convert(wanted, [_fetched(each, folder) for each in wanted.files])
    return wanted.path


def _fetched(file: RemoteFile, folder: Path) -> Path:
    """Return a file whose bytes are those that the catalogue says."""
    import pooch
    import requests

    pooch.get_logger().setLevel("ERROR")
    try:
        return Path(
            pooch.retrieve(
                file.url,
                f"sha256:{file.sha256}",
                fname=file.name,
                path=folder,
                downloader=pooch.HTTPDownloader(timeout=TIMEOUT_S),
            )
        )
    except ValueError as error:  # of another hash; pooch says both
        reason = str(error).partition(" but got ")[2].partition(".")[0] or str(error)
        raise FetchError(f"{file.url}: expected SHA-256 {file.sha256}, found {reason}") from None
    except requests.HTTPError as error:
        reason = f"HTTP status {getattr(error.response, 'status_code', 'unknown')}"
    except requests.ConnectionError:
        reason = "no connection, or one that broke"
    except requests.RequestException as error:
        reason = str(error)
    raise FetchError(f"{file.url}: expected {file.bytes} bytes, found {reason}")


def _convert(wanted: CataloguedRecording, files: list[Path]) -> None:
    from groundtrace_codecs.importers.run import import_recording

    import_recording(
        [path for path in files if path.name != wanted.truth_file],
        wanted.path,
        truth=next((path for path in files if path.name == wanted.truth_file), None),
        map_path=map_path(f"{wanted.map}.toml") if wanted.map else None,
    )
