"""Chunks read and decompressed in another thread before they are asked for."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from groundtrace_codecs.cores import cores, meanwhile
from groundtrace_codecs.mcap.bytesource import FileBytes
from groundtrace_codecs.mcap.chunks import ChunkEntry, ChunkReader, Definitions
from groundtrace_codecs.mcap.records import MalformedError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from concurrent.futures import Future

    from groundtrace_codecs.mcap.bytesource import ByteSource


class Ahead:
    """Reads one chunk ahead, from the second one that is asked for on.

    Whoever looks at the first message alone so costs nothing more. Of files that are not local, and
    on one core, nothing is read ahead.

    Parameters
    ----------
    source
        The file.
    chunks
        In the order in which they will be asked for.
    """

    def __init__(self, source: ByteSource, chunks: Sequence[ChunkEntry]) -> None:
        self._reader = ChunkReader(source, Definitions())
        self._chunks = chunks
        self._wanted = isinstance(source, FileBytes) and len(chunks) > 2 and cores() > 1
        self._after: dict[int, ChunkEntry] | None = None
        self._pending: dict[int, Future[memoryview]] = {}

    def records(self, entry: ChunkEntry) -> memoryview | None:
        """Return the checked records of a chunk and begin the next one.

        None where they were not read, or not as they should be: whoever asks finds out why.
        """
        if not self._wanted:
            return None
        if self._after is None:
            self._after = {}
            return None
        if not self._after:
            pairs = zip(self._chunks, self._chunks[1:], strict=False)
            self._after = {one.offset: other for one, other in pairs}
        found = self._pending.pop(entry.offset, None)
        after = self._after.get(entry.offset)
        if after is not None:
            self._pending[after.offset] = meanwhile(partial(self._reader.records, after))
        try:
            return None if found is None else found.result()
        except (MalformedError, OSError):
            return None
