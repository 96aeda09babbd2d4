"""A chunk's records, where the index says or elsewhere: what a file's reader asks for."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.chunks import ChunkEntry, ChunkReader, MisplacedError
from groundtrace_codecs.mcap.records import RECORD_HEAD, Damage, MalformedError
from groundtrace_codecs.mcap.scan import front_scan

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from groundtrace_codecs.mcap.bytesource import ByteSource


class ChunkLoader:
    """Gives the records of a file's chunks, and those of the last one again without reading it.

    Whoever opens a recording asks for the first messages of one channel after the other.

    Parameters
    ----------
    source
        The file.
    chunks
        Its chunks as the index has them.
    """

    def __init__(self, source: ByteSource, chunks: Sequence[ChunkEntry]) -> None:
        self._source = source
        self._chunks = chunks
        self._scanned: tuple[ChunkEntry, ...] | None = None
        self._last: tuple[int, memoryview] | None = None

    def records(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        """Give the records of a chunk.

        By its own fields if only its opcode or length is wrong, of which ``note`` is told; if it is
        not where the index says, a front scan looks for it.

        Raises
        ------
        MalformedError
            Where that does not help.
        """
        if self._last is not None and self._last[0] == entry.offset:
            return self._last[1]
        self._last = None  # its memory is wanted for the next one
        records = self._found(reader, entry, note)
        self._last = (entry.offset, records)
        return records

    def forget(self) -> None:
        """Let go of the last chunk."""
        self._last = None

    def _found(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        try:
            return reader.records(entry)
        except MisplacedError:
            with suppress(MalformedError):
                return self._mended(reader, entry, note)
            for other in self._unindexed_chunks():
                if (other.start_ns, other.end_ns) == (entry.start_ns, entry.end_ns):
                    return reader.records(other)
            raise

    def _mended(
        self, reader: ChunkReader, entry: ChunkEntry, note: Callable[[Damage], None]
    ) -> memoryview:
        records = reader.mended(entry)
        reason = reader.head_fault(entry)
        note(Damage(entry.offset, RECORD_HEAD.size, None, None, 0, reason))
        return records

    def _unindexed_chunks(self) -> tuple[ChunkEntry, ...]:
        if self._scanned is None:
            known = {chunk.offset for chunk in self._chunks}
            found = front_scan(self._source)[0].chunks
            self._scanned = tuple(c for c in found if not c.bare and c.offset not in known)
        return self._scanned
