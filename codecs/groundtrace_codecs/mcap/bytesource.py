"""Where the bytes of a recording come from: a file, memory, or anything that reads at an offset.

Reading at an offset keeps the memory of a long recording constant; a memory map of a 2 GB file
counts as 2 GB of resident memory.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from zlib_ng import zlib_ng

_BLOCK_BYTES = 1 << 18


class ByteSource(Protocol):
    """Random access to bytes that do not change while they are read.

    Attributes
    ----------
    name
        What errors call the source.
    size
        Number of bytes.
    """

    @property
    def name(self) -> str:
        """What errors call the source."""

    @property
    def size(self) -> int:
        """Number of bytes."""

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of the source."""

    def close(self) -> None:
        """Release what the source holds; a second call does nothing."""


class FileBytes:
    """A local file, opened for reading only.

    Parameters
    ----------
    path
        File to read.

    Raises
    ------
    OSError
        If the file cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        self.name = str(path)
        self._file = Path(path).open("rb", buffering=0)  # noqa: SIM115 - closed by close()
        self.size = os.fstat(self._file.fileno()).st_size

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of the file.

        The length is cut to the size of the file first, since pread allocates what it is asked for.
        """
        wanted = min(length, self.size - offset)
        return os.pread(self._file.fileno(), wanted, offset) if wanted > 0 else b""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Window:
    """Small reads that run forward, served from one block of the source.

    Parameters
    ----------
    source
        What is read.
    """

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self._start = 0
        self._block = memoryview(b"")

    def view(self, offset: int, length: int) -> memoryview:
        """Give the ``length`` bytes at ``offset`` without a copy; fewer at the end."""
        inside = offset - self._start
        if inside < 0 or inside + length > len(self._block):
            self._block = memoryview(self._source.read_at(offset, max(length, _BLOCK_BYTES)))
            self._start, inside = offset, 0
        return self._block[inside : inside + length]


def crc32_of(source: ByteSource, start: int, stop: int) -> int:
    """Compute the CRC-32 of the bytes ``[start, stop)``, a block at a time."""
    crc = 0
    for offset in range(start, stop, _BLOCK_BYTES):
        crc = zlib_ng.crc32(source.read_at(offset, min(_BLOCK_BYTES, stop - offset)), crc)
    return crc
