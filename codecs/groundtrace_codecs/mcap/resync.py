"""Which record heads are believed, and where the next record is found after one that is not.

Nothing protects the opcode and the length of a record. One flipped bit in a length would send a
scan into the middle of something, and cost the rest of the file or make messages of other bytes.
So a head is believed only if the record's own fields have that length, or if a record can follow
where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from groundtrace_codecs.mcap.bytesource import Window
from groundtrace_codecs.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MAX_RECORD_BYTES,
    MESSAGE,
    MESSAGE_FIELDS,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    U16,
    U32,
    U64,
)

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from groundtrace_codecs.mcap.bytesource import ByteSource

# Of each kind: bytes before its texts, texts (u32 length each), whether a blob (u64 length)
# follows, bytes after it (MCAP specification, "Records").
_LAYOUTS: Final = {
    HEADER: (0, 2, False, 0),
    FOOTER: (20, 0, False, 0),
    SCHEMA: (2, 3, False, 0),
    CHANNEL: (4, 3, False, 0),
    CHUNK: (28, 1, True, 0),
    MESSAGE_INDEX: (2, 1, False, 0),
    ATTACHMENT: (16, 2, True, 4),
    METADATA: (0, 2, False, 0),
    DATA_END: (4, 0, False, 0),
}
# These may not grow fields after the known ones (MCAP specification, "Records").
_FIXED: Final = (DATA_END, FOOTER)
# What a search may stop at. Schemas, channels and messages count only where there are no chunks:
# inside a chunk that lost its head they look the same, and no CRC vouches for them.
_IN_CHUNKED: Final = (CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END)
_IN_BARE: Final = (*_IN_CHUNKED, SCHEMA, CHANNEL, MESSAGE)
# Records in a row that make a message believable where a search found it.
_CHAIN: Final = 4
# Longest fields before the data of a message or a chunk, and some more.
_FIELDS_BYTES: Final = 64
# Unknown records in a row that are passed over to find a known one.
_UNKNOWN_RECORDS: Final = 64
_SEARCH_BYTES: Final = 1 << 20


@dataclass(slots=True)
class Heads:
    """The record heads of one file within a source.

    Attributes
    ----------
    source
        What is read.
    channels
        Ids a message may have; grows while the file is read.
    stop
        Where the source ends.
    window
        Serves small reads.
    """

    source: ByteSource
    channels: Container[int]
    stop: int = field(init=False)
    window: Window = field(init=False)

    def __post_init__(self) -> None:
        self.stop = self.source.size
        self.window = Window(self.source)

    def head(self, offset: int) -> tuple[int, int] | None:
        """Give opcode and content length; None where no whole record can be."""
        raw = self.window.view(offset, RECORD_HEAD.size)
        if len(raw) < RECORD_HEAD.size:
            return None
        opcode, length = RECORD_HEAD.unpack(raw)
        fits = opcode and offset + RECORD_HEAD.size + length <= self.stop
        return (opcode, length) if fits else None

    def believed(self, offset: int) -> tuple[int, int] | None:
        """Give opcode and content length; None where they contradict what is there."""
        head = self.head(offset)
        if head is None:
            return None
        opcode, length = head
        if self.own_length(opcode, offset) == length:
            return head
        if opcode in _FIXED or self.own_length(CHUNK, offset) == length:
            return None
        # A record may have grown fields that are not known here.
        return head if self.can_follow(offset + RECORD_HEAD.size + length) else None

    def measured(self, offset: int) -> int:
        """Give the content length by the record's own fields, where a record follows; else 0.

        A chunk has a better witness, its CRC.
        """
        opcode = self.window.view(offset, 1)[0]
        own = None if opcode == CHUNK else self.own_length(opcode, offset)
        stop = offset + RECORD_HEAD.size + (own or 0)
        return own if own and stop <= self.stop and self.can_follow(stop) else 0

    def own_length(self, opcode: int, offset: int) -> int | None:
        """Give the content length that the fields of a record of that kind add up to.

        Returns
        -------
        int or None
            None where the kind's fields do not tell, or reach past the end of the source.
        """
        if opcode not in _LAYOUTS:
            return None
        lead, texts, blob, tail = _LAYOUTS[opcode]
        start = offset + RECORD_HEAD.size
        position = start + lead
        for _ in range(texts):
            raw = self.window.view(position, U32.size)
            if len(raw) < U32.size:
                return None
            position += U32.size + U32.unpack(raw)[0]
        if blob:
            raw = self.window.view(position, U64.size)
            if len(raw) < U64.size:
                return None
            position += U64.size + U64.unpack(raw)[0]
        return position + tail - start

    def can_follow(self, offset: int) -> bool:
        """Tell whether a record, another file or the end can begin at ``offset``."""
        for _ in range(_UNKNOWN_RECORDS):
            raw = self.window.view(offset, RECORD_HEAD.size)
            if len(raw) < RECORD_HEAD.size or bytes(raw[: len(MAGIC)]) == MAGIC:
                return True
            opcode, length = RECORD_HEAD.unpack(raw)
            if opcode == 0:
                return self._only_zeros(offset)
            if opcode <= DATA_END:
                shortest = MESSAGE_FIELDS if opcode == MESSAGE else _LAYOUTS.get(opcode, (0,))[0]
                fits = offset + RECORD_HEAD.size + length <= self.stop
                return bool(length >= shortest and (fits or self._is_cut(offset, opcode, length)))
            # An unknown opcode says little: what comes after it must say more.
            offset += RECORD_HEAD.size + length
            if offset > self.stop:
                return False
        return False

    def _is_cut(self, offset: int, opcode: int, length: int) -> bool:
        """Tell whether the end of the source cuts a record, and not a wrong length leads past it.

        Of a record that is cut in its fields nothing can be told, and it is believed.
        """
        if length > MAX_RECORD_BYTES or self.stop - offset < _FIELDS_BYTES:
            return length <= MAX_RECORD_BYTES
        if opcode == MESSAGE:
            (channel,) = U16.unpack(self.window.view(offset + RECORD_HEAD.size, U16.size))
            return channel in self.channels
        return self.own_length(opcode, offset) == length

    def begins_file(self, offset: int) -> bool:
        """Tell whether an MCAP file begins at ``offset``: magic and a whole Header record."""
        if bytes(self.window.view(offset, len(MAGIC))) != MAGIC:
            return False
        head = self.head(offset + len(MAGIC))
        return (
            head is not None
            and head[0] == HEADER
            and self.own_length(HEADER, offset + len(MAGIC)) == head[1]
        )

    def next_file(self, start: int) -> int | None:
        """Search for the beginning of another file from ``start`` on."""
        for offset, raw in self._blocks(start):
            place = raw.find(MAGIC)
            while place >= 0:
                if self.begins_file(offset + place):
                    return offset + place
                place = raw.find(MAGIC, place + 1)
        return None

    def next_record(self, start: int, *, chunked: bool) -> int | None:
        """Search for the next record, or the beginning of another file, from ``start`` on.

        Every byte is looked at once. An Attachment or Metadata record that was longer than 4 GiB
        is not found.

        Parameters
        ----------
        start
            First byte looked at.
        chunked
            True where messages are in chunks only.
        """
        kinds = _IN_CHUNKED if chunked else _IN_BARE
        for base, raw in self._blocks(start):
            for place in _places(raw, kinds):
                if self._is_record(base + place):
                    return base + place
        return None

    def has_chunks(self, start: int) -> bool:
        """Tell whether there is a chunk, or the index of one, from ``start`` on."""
        return any(
            self._is_record(base + place)
            for base, raw in self._blocks(start)
            for place in _places(raw, (CHUNK, MESSAGE_INDEX))
        )

    def _is_record(self, offset: int) -> bool:
        """Tell whether what looks like a head is one: the record's fields must agree."""
        if self.begins_file(offset):
            return True
        head = self.head(offset)
        if head is None:
            return False
        opcode, length = head
        if opcode == MESSAGE:
            return self._is_message(offset)
        if self.own_length(opcode, offset) != length:
            return False
        # The lengths of a chunk, 64 bits each, do not agree by chance; those of others may.
        return opcode == CHUNK or self.can_follow(offset + RECORD_HEAD.size + length)

    def _is_message(self, offset: int) -> bool:
        raw = self.window.view(offset + RECORD_HEAD.size, U16.size)
        if len(raw) < U16.size or U16.unpack(raw)[0] not in self.channels:
            return False
        for _ in range(_CHAIN):
            head = self.head(offset)
            if head is None or not self.can_follow(offset):
                return False
            offset += RECORD_HEAD.size + head[1]
            if offset == self.stop:
                break
        return True

    def _only_zeros(self, start: int) -> bool:
        return not any(raw.strip(b"\0") for _, raw in self._blocks(start))

    def _blocks(self, start: int) -> Iterator[tuple[int, bytes]]:
        """Yield the source from ``start`` on in blocks that overlap by a head, with their place."""
        for base in range(start, self.stop, _SEARCH_BYTES):
            length = min(_SEARCH_BYTES + RECORD_HEAD.size, self.stop - base)
            yield base, self.source.read_at(base, length)


def _places(raw: bytes, kinds: tuple[int, ...]) -> list[int]:
    """Give where in a block heads of ``kinds``, or a file's magic, may be, in order."""
    if len(raw) < RECORD_HEAD.size:
        return []
    values = np.frombuffer(raw, np.uint8)
    count = len(values) - RECORD_HEAD.size + 1
    sought = np.zeros(256, bool)
    sought[list(kinds)] = True
    fitting = sought[values[:count]]
    for high in range(5, RECORD_HEAD.size):
        fitting &= values[high : high + count] == 0
    places: list[int] = np.flatnonzero(fitting).tolist()
    magic = raw.find(MAGIC)
    while magic >= 0:
        places.append(magic)
        magic = raw.find(MAGIC, magic + 1)
    return sorted(places)
