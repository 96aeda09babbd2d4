"""Temporary folders that go with their process, however it ends."""

from __future__ import annotations

import atexit
import shutil
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock, Timeout

if TYPE_CHECKING:
    from collections.abc import Iterator

_PREFIX, _IN_USE = "groundtrace-", "in-use"
#: A folder that nobody has locked yet may be one that is just made; after this time [s] it is not.
#: Chosen by judgement: making and locking take milliseconds.
_ABANDONED_S = 3600.0
_UNTIL_EXIT = ExitStack()
atexit.register(_UNTIL_EXIT.close)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder among the system's temporary ones, which goes when the block ends.

    What processes left that were killed is removed first: theirs are the folders that nobody holds
    a lock in.
    """
    _sweep(Path(tempfile.gettempdir()))
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
    try:
        with FileLock(folder / _IN_USE):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def scratch_folder_until_exit() -> Path:
    """Make a :func:`scratch_folder` that goes when the process ends."""
    return _UNTIL_EXIT.enter_context(scratch_folder())


def _sweep(temporary: Path) -> None:
    for folder in temporary.glob(f"{_PREFIX}*/"):
        lock = folder / _IN_USE
        with suppress(OSError, Timeout):  # another user's, or removed meanwhile, or in use
            if lock.exists():
                with FileLock(lock, timeout=0):
                    shutil.rmtree(folder, ignore_errors=True)
            elif time.time() - folder.stat().st_mtime > _ABANDONED_S:
                shutil.rmtree(folder, ignore_errors=True)
