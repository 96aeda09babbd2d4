"""Reading MCAP recordings: ordered, checked, in constant memory, whatever state the file is in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from zlib_ng import zlib_ng

from groundtrace_codecs.errors import FormatError
from groundtrace_codecs.mcap.chunks import ChunkEntry, ChunkReader
from groundtrace_codecs.mcap.index import FileIndex, load_index
from groundtrace_codecs.mcap.loading import ChunkLoader
from groundtrace_codecs.mcap.merge import merge
from groundtrace_codecs.mcap.message_index import indexed_messages
from groundtrace_codecs.mcap.records import (
    ATTACHMENT,
    U32,
    AttachmentRef,
    ChannelRecord,
    Damage,
    Fields,
    MalformedError,
    Message,
    MetadataRecord,
    Schema,
    parse_attachment,
    read_record,
)
from groundtrace_codecs.mcap.remote import RemoteBytes, open_bytes
from groundtrace_codecs.mcap.scan import ANY_TIME
from groundtrace_codecs.mcap.scanned import stray_reason
from groundtrace_codecs.mcap.set_backs import reading_clock
from groundtrace_codecs.mcap.table import MessageTable

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterator
    from types import TracebackType

    from groundtrace_codecs.mcap.bytesource import ByteSource
    from groundtrace_codecs.mcap.segments import Segment
    from groundtrace_codecs.mcap.set_backs import ReadingClock


class _Part:
    """Reads the chunks of one segment.

    Parameters
    ----------
    source
        The file.
    segment
        Which of the files in it.
    wanted
        Channels to read, ids of the whole.
    """

    def __init__(self, source: ByteSource, segment: Segment, wanted: Container[int]) -> None:
        self.reader = ChunkReader(source, segment.definitions)
        self._ids = segment.ids
        self.wanted = wanted
        if self._ids is not None:
            self.wanted = {own for own, whole in self._ids.items() if whole in wanted}

    def in_whole(self, found: MessageTable) -> MessageTable:
        """Give messages the channel ids of the whole."""
        ids = self._ids
        if ids is None or not len(found):
            return found
        rows = found.rows.copy()
        own, places = np.unique(rows["channel_id"], return_inverse=True)
        rows["channel_id"] = np.array([ids[i] for i in own.tolist()])[places]
        return MessageTable(found.pieces, rows).in_order()


class McapFile:
    """One MCAP file, open for reading.

    Damaged parts are left out and listed in `damage`; a byte that fails its check is never passed
    on. Made by `open`.

    Attributes
    ----------
    name
        What errors call the file.
    profile, library
        Of its Header record.
    schemas, channels
        By id. Every channel's ``schema_id`` is 0 or a key of ``schemas``.
    attachments, metadata
        In the order of the file.
    message_counts
        Messages by channel id: as the statistics state them, or as a front scan found them.
    start_ns, end_ns
        Log times of the first and the last message; both 0 without messages.
    indexed
        True if the file's own summary was used, False after a front scan.
    """

    def __init__(self, source: ByteSource, index: FileIndex, *, strict: bool) -> None:
        self.name: str = source.name
        self.profile: str = index.profile
        self.library: str = index.library
        self.schemas: dict[int, Schema] = index.definitions.schemas
        self.channels: dict[int, ChannelRecord] = index.definitions.channels
        self.attachments: tuple[AttachmentRef, ...] = index.attachments
        self.metadata: tuple[MetadataRecord, ...] = index.metadata
        self.message_counts: dict[int, int] = index.message_counts
        self.start_ns: int = index.start_ns
        self.end_ns: int = index.end_ns
        self.indexed: bool = index.indexed
        self._source = source
        self._segments = index.segments
        self._chunks = index.chunks
        self._strict = strict
        self._damage: dict[tuple[int, str], Damage] = {}
        self._loader = ChunkLoader(source, index.chunks)
        for damage in index.damage:
            self._note(damage)

    @classmethod
    def open(cls, source: str | Path | ByteSource, *, strict: bool = False) -> McapFile:
        """Open a file and find out what it holds.

        Parameters
        ----------
        source
            Path, URL, or bytes from elsewhere; closed with the file.
        strict
            Raise at the first damage instead of listing it.

        Raises
        ------
        FormatError
            If it is no MCAP file, or, with ``strict``, at any damage.
        OSError
            If it cannot be read.
        """
        opened = open_bytes(source) if isinstance(source, str | Path) else source
        try:
            return cls(opened, load_index(opened), strict=strict)
        except BaseException:
            opened.close()
            raise

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self._source.size

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was left out so far; grows while messages are read."""
        return tuple(self._damage.values())

    def messages(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[Message]:
        """Read messages in the order (log time, channel id, sequence, file offset).

        Parameters
        ----------
        channel_ids
            Channels to read; None = all.
        start_ns, stop_ns
            Log times ``[start_ns, stop_ns)``; None = no bound.

        Raises
        ------
        FormatError
            With ``strict``, at the first damage met.
        """
        for table in self.tables(channel_ids, start_ns, stop_ns):
            yield from table

    def as_recorded(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[Message]:
        """Read messages in the order in which they were recorded, for a copy.

        As :meth:`messages`, but where a clock was set back: there the messages of each channel
        come in the order of the file (:mod:`.set_backs`), which a copy has to keep.
        """
        wanted = self.channels.keys() if channel_ids is None else channel_ids
        clock = self.reading_clock(wanted)
        if clock is None:
            yield from self.messages(channel_ids, start_ns, stop_ns)
            return
        low = ANY_TIME[0] if start_ns is None else start_ns
        high = ANY_TIME[1] if stop_ns is None else stop_ns
        latest = None if stop_ns is None else stop_ns + clock.latest_ns
        for table in self.tables(channel_ids, start_ns, latest, clock):
            yield from table.as_logged().between(low, high)

    def tables(
        self,
        channel_ids: Collection[int] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        clock: ReadingClock | None = None,
    ) -> Iterator[MessageTable]:
        """Read messages as :meth:`messages` does, as many at once as lie together.

        With a ``clock``, its times of reading are in the place of log times, also in the messages.
        """
        low = ANY_TIME[0] if start_ns is None else start_ns
        high = ANY_TIME[1] if stop_ns is None else stop_ns
        wanted: Container[int] = self.channels
        chunks = [
            c
            for c in (self._chunks if clock is None else clock.chunks)
            if c.start_ns < high and low <= c.end_ns
        ]
        if channel_ids is not None:
            wanted = chosen = self.channels.keys() & set(channel_ids)
            chunks = [c for c in chunks if c.channel_ids is None or c.channel_ids & chosen]
        parts = [_Part(self._source, segment, wanted) for segment in self._segments]

        def load(entry: ChunkEntry, floor_ns: int) -> MessageTable:
            if clock is None:
                found = self._load(parts[entry.segment], entry, low, high)
            else:
                found = clock.read(entry, self._load(parts[entry.segment], entry, *ANY_TIME))
                found = found.between(low, high).in_order()
            return self._in_time(entry, found, floor_ns)

        return merge(chunks, load)

    def reading_clock(self, channel_ids: Collection[int]) -> ReadingClock | None:
        """Return at what times some channels are to be read if a clock was set back, else None."""
        near = not isinstance(self._source, RemoteBytes)
        return reading_clock(self._source, self._chunks, self._segments, channel_ids, near=near)

    def attachment(self, ref: AttachmentRef) -> bytes:
        """Read the content of an attachment.

        Raises
        ------
        FormatError
            If it is not where ``ref`` says, or its CRC does not match.
        """
        try:
            record = read_record(self._source, ref.offset, ATTACHMENT)
            fields = Fields(record)
            if parse_attachment(ref.offset, ref.length, fields) != ref:
                raise MalformedError("expected the attachment of the index, found another one")
            data = fields.blob(ref.size)
            checked = record[: fields.position]
            (crc,) = fields.unpack(U32)
            # As with chunks, 0 means that the writer kept none.
            if crc and (found := zlib_ng.crc32(checked)) != crc:
                raise MalformedError(f"expected CRC 0x{crc:08x}, found 0x{found:08x}")
        except MalformedError as error:
            raise FormatError(f"{self.name}: attachment {ref.name!r}: {error}") from error
        return bytes(data)

    def close(self) -> None:
        """Close the source."""
        self._loader.forget()
        self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _load(self, part: _Part, entry: ChunkEntry, low: int, high: int) -> MessageTable:
        """Give the wanted messages of one chunk; none, and a note, if it is damaged."""
        try:
            records = self._loader.records(part.reader, entry, self._note)
            found, strays = part.reader.messages(records, part.wanted, low, high)
        except MalformedError as error:
            lost = indexed_messages(self._source, entry.offset + entry.length).messages
            self._lost(entry, lost, f"chunk: {error}")
            return MessageTable.none()
        if strays:
            self._lost(entry, strays, stray_reason(entry))
        return part.in_whole(found)

    def _in_time(self, entry: ChunkEntry, found: MessageTable, floor_ns: int) -> MessageTable:
        """Leave out what would go back in time because the chunk states too late a start."""
        late = found.before(floor_ns)
        if not late:
            return found
        reason = f"chunk: expected log times from {entry.start_ns}, found {found[0].log_time}"
        self._lost(entry, late, reason)
        return found[late:]

    def _lost(self, entry: ChunkEntry, messages: int | None, reason: str) -> None:
        self._note(
            Damage(entry.offset, entry.length, entry.start_ns, entry.end_ns, messages, reason)
        )

    def _note(self, damage: Damage) -> None:
        if self._strict:
            raise FormatError(f"{self.name}: byte {damage.offset}: {damage.reason}")
        self._damage.setdefault((damage.offset, damage.reason), damage)
