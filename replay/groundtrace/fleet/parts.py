"""Parts: a file for each recording and pipeline, whole or not there."""

from __future__ import annotations

import os
import secrets
from typing import TYPE_CHECKING

from ..appearing import room_for
from ..errors import RecordingError
from .rows import Part, decoded

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

#: Of what went well, and of what did not and is tried again when a fleet is resumed.
_DONE, _FAILED = ".part", ".failed"


class Parts:
    """The folder of a fleet's parts; several computers may write to it at once.

    Parameters
    ----------
    folder
        Made where it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, key: str, data: bytes, *, failed: bool = False) -> None:
        """Keep a part: written beside, then renamed, so that a kill leaves it whole or not there.

        Raises
        ------
        OutputError
            Where it cannot be written.
        """
        fresh = self.folder / f".{key}.{secrets.token_hex(4)}"
        with room_for(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                with fresh.open("wb") as stream:
                    stream.write(data)
                    stream.flush()
                    os.fsync(stream.fileno())
                fresh.replace(self.folder / f"{key}{_FAILED if failed else _DONE}")
            finally:
                fresh.unlink(missing_ok=True)
            (self.folder / f"{key}{_DONE if failed else _FAILED}").unlink(missing_ok=True)

    def done(self) -> Iterator[str]:
        """Yield the keys of parts that need not be made again: those without an error."""
        for path in self.folder.glob(f"*{_DONE}"):
            yield path.name.removesuffix(_DONE)

    def has(self, key: str) -> bool:
        """Tell whether there is a part."""
        return self._path(key) is not None

    def read(self, key: str) -> Part:
        """Return a part.

        Raises
        ------
        RecordingError
            Where it is not there, or not whole.
        """
        path = self._path(key)
        part = None if path is None else decoded(path.read_bytes())
        if part is None:
            found = "none" if path is None else "a broken one"
            raise RecordingError(f"{self.folder}: {key}: expected a part, found {found}")
        return part

    def _path(self, key: str) -> Path | None:
        paths = (self.folder / f"{key}{suffix}" for suffix in (_DONE, _FAILED))
        return next((path for path in paths if path.is_file()), None)
