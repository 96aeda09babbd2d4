"""Importer for recordings of phone apps: Sensor Logger and phyphox, as zip, folder or CSV files."""

from __future__ import annotations

import csv
import zipfile
import zlib
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..errors import FormatError, SchemaError
from . import phyphox, sensor_logger
from .phone_app import AppFile, Found
from .sampled import together

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from .api import Imported, ImportMap
    from .delimited import TextFile

#: Files that say more about those beside them, by the folder they are in.
_BESIDE = ("Metadata.csv", "Annotation.csv", "meta/time.csv")
#: How much of a table is looked at to know it [bytes].
_HEAD = 4096


class PhoneImporter:
    """Reads what one phone recorded at one time."""

    name = "phone"
    description = "phone apps: Sensor Logger and phyphox, zip or CSV files"

    def sniff(self, path: Path) -> float:
        """Return 1 where a file is of an app, by the header of its table or of one inside."""
        if path.suffix.lower() not in (".zip", ".csv"):
            return 0.0
        try:
            with _files([path]) as files:
                return 1.0 if _app(files) is not None or _says_more(files) else 0.0
        except FormatError:
            return 0.0

    def read(self, paths: Sequence[Path], map_: ImportMap | None) -> Imported:
        """Read the files of one recording; they need no map.

        Raises
        ------
        FormatError
            Where the files are of no app known here, or damaged.
        SchemaError
            For a map, or tables that do not hold what their app writes.
        """
        if map_ is not None:
            raise SchemaError(f"{map_.file}: expected no map for a phone app, found one")
        with _files(paths) as files:
            read = _app(files)
            if read is None:
                raise FormatError(
                    f"{paths[0].name}: expected CSV tables of Sensor Logger or phyphox, "
                    f"found {len(files)} tables of neither"
                )
            found = read(files)
        if not found.sampled:
            raise FormatError(
                f"{paths[0].name}: expected acceleration, rotation, magnetic field, pressure or "
                f"places, found none"
            )
        return together(found.sampled, labels=found.labels, warnings=found.warnings)


def _app(files: Sequence[AppFile]) -> Callable[[Sequence[AppFile]], Found] | None:
    """Return what reads the files, or None."""
    if any(sensor_logger.is_table(f) for f in files):
        return sensor_logger.read
    if any(phyphox.is_table(f) for f in files):
        return phyphox.read
    return None


def _says_more(files: Sequence[AppFile]) -> bool:
    return any(sensor_logger.is_metadata(f) or phyphox.is_clock(f) for f in files)


@contextmanager
def _files(paths: Sequence[Path]) -> Iterator[list[AppFile]]:
    """Yield the tables meant: those given, inside archives, and what lies beside and says more."""
    opened: list[zipfile.ZipFile] = []
    try:
        found: dict[str, TextFile] = {}
        for path in paths:
            if path.suffix.lower() == ".zip":
                opened.append(zipfile.ZipFile(path))
                found |= _inside(opened[-1])
                continue
            found[path.name] = path
            beside = (path.parent / name for name in _BESIDE)
            found |= {p.name: p for p in beside if p.is_file()}
        yield [_look(file) for file in found.values()]
    except _DAMAGE as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(f"{paths[0].name}: expected a whole archive, found: {text}") from error
    finally:
        for archive in opened:
            archive.close()


#: What :mod:`zipfile` raises for archives that are cut short, damaged, encrypted or unknown.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    UnicodeDecodeError,
)


def _inside(archive: zipfile.ZipFile) -> dict[str, TextFile]:
    """Return the tables of an archive by their names without folder."""
    names = [n for n in archive.namelist() if n.lower().endswith(".csv")]
    return {n.rpartition("/")[2]: zipfile.Path(archive, n) for n in names if "__MACOSX" not in n}


def _look(file: TextFile) -> AppFile:
    """Return a file with the cells of its first line and what separates them."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    line = head.decode("utf-8-sig", "replace").partition("\n")[0].rstrip("\r")
    delimiter = max(",;\t", key=line.count)
    try:
        header = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        header = []
    return AppFile(file, tuple(c.strip() for c in header), delimiter, head)
