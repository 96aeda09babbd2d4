"""Finding importers: by the entry points of installed packages, best by what they sniff."""

from __future__ import annotations

import re
import warnings
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, cast

from ..errors import FormatError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from .api import Importer

#: Entry points that name importer classes.
GROUP = "groundtrace.importers"


def importers() -> dict[str, Importer]:
    """Return the installed importers by name; one that fails to load warns and is left out."""
    found: dict[str, Importer] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        try:
            importer = cast("Importer", point.load()())
        except Exception as error:  # a foreign package may fail in any way
            warnings.warn(f"importer {point.name}: not loaded: {error}", stacklevel=2)
            continue
        found[importer.name] = importer
    return found


def files_of(paths: Sequence[Path]) -> list[Path]:
    """Return the files meant: a folder stands for the files in it, in natural order.

    Raises
    ------
    FormatError
        Where a path does not exist, or there is no file.
    """
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = (p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
            files += sorted(inside, key=_natural)
        elif path.is_file():
            files.append(path)
        else:
            raise FormatError(f"{path.name}: expected a file or folder, found none")
    if not files:
        raise FormatError(f"{paths[0].name if paths else 'import'}: expected files, found none")
    return files


def choose(
    paths: Sequence[Path], format_name: str | None = None, place: str = "--format"
) -> Importer:
    """Return the importer for some files: the one named, or the surest.

    Parameters
    ----------
    paths
        Files of one recording.
    format_name
        Name of an importer, or None to look at the files.
    place
        Where the name stands, for the message.

    Raises
    ------
    FormatError
        Where no importer has the name, or none knows the files; names the formats known.
    """
    known = importers()
    names = ", ".join(sorted(known)) or "none installed"
    if format_name is not None:
        if format_name not in known:
            raise FormatError(
                f"{place}: expected one of {names}, found {format_name!r}"
                f"{did_you_mean(format_name, known)}"
            )
        return known[format_name]
    scores = {name: max(i.sniff(p) for p in paths) for name, i in known.items()}
    best = max(scores, key=lambda name: scores[name], default="")
    if not best or scores[best] <= 0:
        raise FormatError(
            f"{paths[0].name}: expected a format of {names}, found none of them "
            f"(name one with --format)"
        )
    return known[best]


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key that puts ``10.dat`` after ``9.dat``."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in parts]
