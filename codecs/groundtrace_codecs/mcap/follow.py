"""Follows an MCAP file while somebody writes it, or one that comes through a pipe.

The records of a growing file are taken as they become whole, in the order of the file; what is not
whole yet is waited for. Messages are held back for a tenth of a second, so that those that a writer
put down a little out of order come in that of their log times. The file ends where its own end is,
or the pipe's.
"""

from __future__ import annotations

import hashlib
import os
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

from ..errors import CodecError
from ..signals import NS_PER_S
from .byte_source import FileBytes, sha256_of
from .chunks import RECORD_HEAD, Damage, MessageTable
from .recover import Scanner, truncation_reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .chunks import ChannelRecord, Schema

#: How often a file is looked at [s]. Chosen by judgement: what a person does not notice.
POLL_S = 0.05
#: Messages that come later than others by this much still come in order [ns], and what is held back
#: for that is let go when so much time passes without any. Chosen by judgement: threads of a
#: recorder overtake each other by milliseconds.
LATE_NS = 100_000_000
#: A writer that writes nothing for so long is said to have stalled [s]. Chosen by judgement: chunks
#: of slow sensors take seconds.
STALL_S = 5.0
#: Of a pipe so many bytes are read before they are asked for.
AHEAD_BYTES = 1 << 26
_PIECE_BYTES = 1 << 18


class Growing(Protocol):
    """Bytes that become more.

    Attributes
    ----------
    name
        What errors call the source.
    size
        Number of bytes that are there, as of the last `grow`.
    ended
        True where nothing can come any more.
    """

    @property
    def name(self) -> str:
        """What errors call the source."""

    @property
    def size(self) -> int:
        """Number of bytes that are there."""

    @property
    def ended(self) -> bool:
        """True where nothing can come any more."""

    def grow(self) -> bool:
        """Take notice of what came; return whether anything did."""

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end of what is there."""

    def forget(self, before: int) -> None:
        """Say that bytes before an offset are not read again."""

    def sha256(self) -> str:
        """Return the SHA-256 of all bytes that are there."""

    def close(self) -> None:
        """Release what the source holds."""


class GrowingFile(FileBytes):
    """A local file that somebody writes.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    OSError
        If the file cannot be opened.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        self._path = Path(path)
        self._named = self._same()

    @property
    def ended(self) -> bool:
        """False: a file may always be appended to."""
        return False

    def grow(self) -> bool:
        """Take notice of what was written.

        Raises
        ------
        CodecError
            Where the file was cut short, or another one has its name now.
        """
        size = os.fstat(self._file.fileno()).st_size
        if size < self.size:
            raise CodecError(
                f"{self.name}: expected a file that grows, found it cut to {size} bytes of "
                f"{self.size}"
            )
        if size == self.size and self._named and not self._same():
            self._named = False
            if self._path.exists():
                raise CodecError(f"{self.name}: expected the file that was begun, found another")
        grown, self.size = size > self.size, size
        return grown

    def _same(self) -> bool:
        """Return whether the file has its name still: a writer renames one that it has finished."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        except OSError:
            return False

    def forget(self, before: int) -> None:
        """Do nothing: a file keeps what it has."""

    def sha256(self) -> str:
        """Return the SHA-256 of all bytes that are there."""
        return sha256_of(self)


class PipeBytes:
    """What comes through a pipe, kept from where it may still be read.

    Parameters
    ----------
    pipe
        Read by a thread, as far ahead as there is room.
    name
        What errors call it.
    """

    def __init__(self, pipe: BinaryIO, name: str) -> None:
        self.name = name
        self.size = 0
        self._buffer = bytearray()
        self._start = 0
        self._digest = hashlib.sha256()
        self._refused: OSError | None = None
        self._closed = False
        self._changed = threading.Condition()
        self._at_end = False
        threading.Thread(target=self._take, args=(pipe,), daemon=True).start()

    @property
    def ended(self) -> bool:
        """True where the other side has closed the pipe and everything is in `size`."""
        with self._changed:
            return self._at_end and self.size == self._start + len(self._buffer)

    def grow(self) -> bool:
        """Take notice of what came.

        Raises
        ------
        CodecError
            Where the pipe broke.
        """
        with self._changed:
            if self._refused is not None:
                reason = self._refused.strerror
                raise CodecError(f"{self.name}: expected bytes to read, found: {reason}")
            size = self._start + len(self._buffer)
        grown, self.size = size > self.size, size
        return grown

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``, which were not forgotten."""
        with self._changed:
            if offset < self._start:
                raise CodecError(
                    f"{self.name}: expected to be read once, found byte {offset} asked for again"
                )
            first = offset - self._start
            return bytes(self._buffer[first : first + max(0, min(length, self.size - offset))])

    def forget(self, before: int) -> None:
        """Let go of what lies before an offset."""
        with self._changed:
            del self._buffer[: max(0, before - self._start)]
            self._start = max(self._start, before)
            self._changed.notify_all()

    def sha256(self) -> str:
        """Return the SHA-256 of what came so far."""
        with self._changed:
            return self._digest.hexdigest()

    def close(self) -> None:
        """Read no more."""
        with self._changed:
            self._closed = True
            self._buffer.clear()
            self._changed.notify_all()

    def _take(self, pipe: BinaryIO) -> None:
        read = getattr(pipe, "read1", pipe.read)
        while True:
            try:
                piece = read(_PIECE_BYTES)
            except OSError as error:
                self._refused, piece = error, b""
            with self._changed:
                self._buffer += piece
                self._digest.update(piece)
                self._at_end = not piece
                self._changed.wait_for(lambda: self._closed or len(self._buffer) < AHEAD_BYTES)
                if self._closed or not piece:
                    return


class Prefix:
    """The first bytes of a growing source, which do not change any more.

    Parameters
    ----------
    source
        The source; closing the prefix leaves it open.
    size
        Number of bytes.
    """

    def __init__(self, source: Growing, size: int) -> None:
        self._source = source
        self.name, self.size = source.name, size

    def read_at(self, offset: int, length: int) -> bytes:
        """Give the ``length`` bytes at ``offset``; fewer at the end."""
        return self._source.read_at(offset, max(0, min(length, self.size - offset)))

    def close(self) -> None:
        """Leave the source open: who follows it reads on."""


class FollowedFile:
    """The messages of a growing file, in the order in which they become whole.

    Parameters
    ----------
    source
        The file or pipe, from its beginning.
    stop
        Set by whoever wants no more.
    tell
        Told in one line that the writer has stalled, that it goes on, and what ended it.

    Attributes
    ----------
    name
        What errors call the file.
    channels, schemas
        Those that were met so far, by id.
    finished
        True where the file's own end was reached.
    """

    def __init__(self, source: Growing, stop: threading.Event, tell: Callable[[str], None]) -> None:
        self.name = source.name
        self._source, self._stop, self._tell = source, stop, tell
        self._arrived: list[MessageTable] = []
        self._scanner = Scanner(source, 0, self._arrived.append)
        self._unsettled = MessageTable.none()
        self._waits_since = time.monotonic()
        self._stalled = False
        self._broke: list[Damage] = []

    @property
    def channels(self) -> dict[int, ChannelRecord]:
        """Channels that were met so far, by id."""
        return self._scanner.scan.definitions.channels

    @property
    def schemas(self) -> dict[int, Schema]:
        """Schemas that were met so far, by id."""
        return self._scanner.scan.definitions.schemas

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far."""
        return (*self._scanner.scan.damage, *self._broke)

    @property
    def finished(self) -> bool:
        """True where the file's own end was reached."""
        return self._scanner.ended

    def tables(self) -> Iterator[MessageTable]:
        """Yield messages by log time, as far as their order is settled, until the end or the stop.

        What is there at the stop is given to its end: a stop in the moment in which the file ends
        leaves nothing out. Where the file is cut short, or another one takes its name, what came
        before is given, and the reason is told and in `damage`.
        """
        while True:
            stopped = self._stop.is_set()  # before it is looked at for the last time
            try:
                grown = self._source.grow()
            except CodecError as error:
                self._broken_off(self._source.size, 0, str(error))
                break
            self._scanner.refresh()
            while self._scanner.step(growing=True):
                self._went_on()
                self._source.forget(self._scanner.offset)
                if self._arrived:
                    yield from self._settled()
            if self.finished or stopped:
                break
            if not grown and self._source.ended:
                self._torn()
                break
            yield from self._waited()
        if self._unsettled:
            yield self._unsettled

    def _settled(self) -> Iterator[MessageTable]:
        """Yield what arrived, but for the newest, which others may still come before."""
        buffered = MessageTable.joined([self._unsettled, *self._arrived]).in_order()
        self._arrived.clear()
        settled = buffered.before(int(buffered.rows["log_time"][-1]) - LATE_NS)
        # a slice would keep all chunks before it
        self._unsettled = MessageTable.of(buffered[settled:])
        if settled:
            yield buffered[:settled]

    def _went_on(self) -> None:
        """Take notice that the writer has written."""
        if self._stalled:
            waited_s = time.monotonic() - self._waits_since
            self._tell(f"{self._source.name}: goes on after {waited_s:.0f} s")
        self._waits_since, self._stalled = time.monotonic(), False

    def _waited(self) -> Iterator[MessageTable]:
        """Wait a moment for the writer; yield what was held back for long enough."""
        waited_s = time.monotonic() - self._waits_since
        if not self._stalled and waited_s >= STALL_S:
            self._stalled = True
            self._tell(f"{self._source.name}: {self._pending()} for {STALL_S:g} s; still waiting")
        if self._unsettled and waited_s >= LATE_NS / NS_PER_S:
            buffered, self._unsettled = self._unsettled, MessageTable.none()
            yield buffered
        self._stop.wait(POLL_S)

    def _pending(self) -> str:
        """Return what is missing of the next record, in words."""
        there = self._source.size - self._scanner.offset
        return f"{there} bytes of a record and no more" if there else "nothing was written"

    def _torn(self) -> None:
        """Note that a pipe ended before the file did."""
        offset, size = self._scanner.offset, self._source.size
        if offset < size:
            head = memoryview(self._source.read_at(offset, RECORD_HEAD.size))
            reason = truncation_reason(head, size - offset)
        else:
            reason = "end of file: expected the closing magic, found the end of the pipe"
        self._broken_off(offset, size - offset, f"{self._source.name}: {reason}")

    def _broken_off(self, offset: int, length: int, reason: str) -> None:
        self._broke.append(Damage(offset, length, None, None, None, reason))
        self._tell(reason)
