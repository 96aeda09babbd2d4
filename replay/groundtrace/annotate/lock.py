"""One writer at a time."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from ..errors import AnnotationError

if TYPE_CHECKING:
    from pathlib import Path


class WriterLock:
    """Holds a lock file until it is released or the process ends, however it ends.

    The system's own lock on the file decides, not that the file is there: that of a process that
    died is free.

    Parameters
    ----------
    path
        The lock file.

    Raises
    ------
    AnnotationError
        Where another holds it.
    OSError
        Where it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = self._taken()
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def _taken(self) -> int:
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # who held it may have removed it between our two calls: then it is not the lock
                if os.fstat(file).st_ino == self._path.stat().st_ino:
                    return file
            except BlockingIOError as error:
                holder = os.pread(file, 20, 0).decode("ascii", "replace").strip() or "?"
                os.close(file)
                raise AnnotationError(
                    f"{self._path.name}: expected nobody else annotating this recording, "
                    f"found process {holder}"
                ) from error
            except FileNotFoundError:
                pass
            os.close(file)

    def release(self) -> None:
        """Let others write."""
        with suppress(FileNotFoundError):
            self._path.unlink()
        os.close(self._file)
