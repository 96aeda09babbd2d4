"""Outputs that appear whole, under their name, or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace_codecs.errors import NoRoomError

from .errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator


#: What the system says where no more bytes go into a file, whichever it is.
NO_ROOM = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))


@contextmanager
def room_for(path: Path, *written: Path) -> Iterator[None]:
    """Say that ``path`` cannot be written where the system refuses it in the block.

    Parameters
    ----------
    path
        The output, as the user knows it.
    written
        Files or folders that stand for it while they are written.

    Raises
    ------
    OutputError
        In place of an OSError of a full disk, or of one of those places.
    """
    try:
        yield
    except (NoRoomError, OutputError) as error:  # of a place that goes with the block
        raise OutputError(path, error.reason) from error
    except OSError as error:
        places = {str(place) for place in (path, *written)}
        of = {str(error.filename), *map(str, Path(str(error.filename)).parents)}
        if error.errno not in NO_ROOM and not places & of:
            raise
        raise OutputError(path, os.strerror(error.errno) if error.errno else str(error)) from error


@contextmanager
def appearing(path: Path) -> Iterator[Path]:
    """Give a place beside ``path``; the file or folder written there then takes its name.

    What had the name before is there until then, and stays where an exception ends the block.

    Raises
    ------
    OutputError
        Where the disk is full, or nothing may be written there.
    """
    mark = secrets.token_hex(4)
    fresh, old = (path.with_name(f".{path.stem}.{mark}.{what}{path.suffix}") for what in "no")
    try:
        with room_for(path, fresh):
            yield fresh
            if path.is_dir():  # a folder that is not empty cannot be renamed over
                path.rename(old)
            fresh.replace(path)
    except BaseException:
        if old.exists() and not path.exists():
            old.rename(path)
        raise
    finally:
        for left in _beginning(fresh, old):
            if left.is_dir():
                shutil.rmtree(left)
            else:
                left.unlink()


def _beginning(*places: Path) -> list[Path]:
    """Return what is there of some places, and what their writers began beside them."""
    folder, names = places[0].parent, tuple(place.name for place in places)
    return [p for p in folder.iterdir() if p.name.startswith(names)] if folder.is_dir() else []


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8 so that it appears whole or not at all."""
    with appearing(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
