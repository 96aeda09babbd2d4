"""What a front scan found in one file."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.chunks import ChunkEntry, Definitions
from groundtrace_codecs.mcap.records import RECORD_HEAD, Damage

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.records import AttachmentRef, MetadataRecord


@dataclass(slots=True)
class Scan:
    """What a front scan found, in the order of the file.

    Attributes
    ----------
    start, stop
        Bytes of the file within the source; ``stop`` lies where another file begins, or at the end.
    definitions
        Schemas and channels.
    chunks
        Sound chunks and runs of bare messages.
    counts
        Messages by channel id, one counter for each of ``chunks``.
    attachments, metadata
        As recorded.
    damage
        What was left out.
    """

    start: int
    stop: int
    definitions: Definitions = field(default_factory=Definitions)
    chunks: list[ChunkEntry] = field(default_factory=list)
    counts: list[Counter[int]] = field(default_factory=list)
    attachments: list[AttachmentRef] = field(default_factory=list)
    metadata: list[MetadataRecord] = field(default_factory=list)
    damage: list[Damage] = field(default_factory=list)

    def message_counts(self) -> Counter[int]:
        """Sum the messages by channel id."""
        total: Counter[int] = Counter()
        for counter in self.counts:
            total.update(counter)
        return total

    def note(self, offset: int, length: int, reason: str, messages: int | None = None) -> None:
        """Add damage that has no span of time."""
        self.damage.append(Damage(offset, length, None, None, messages, reason))

    def drop_bare(self, reason: str) -> None:
        """Leave out all messages outside chunks: one of them is wrong, and nobody knows which."""
        pairs = list(zip(self.chunks, self.counts, strict=True))
        bare = [chunk for chunk in self.chunks if chunk.bare]
        lost = sum(counts.total() for chunk, counts in pairs if chunk.bare)
        first, last = min(c.start_ns for c in bare), max(c.end_ns for c in bare)
        length = bare[-1].offset + bare[-1].length - bare[0].offset
        self.damage.append(Damage(bare[0].offset, length, first, last, lost, reason))
        self.chunks = [chunk for chunk, _ in pairs if not chunk.bare]
        self.counts = [counts for chunk, counts in pairs if not chunk.bare]

    def running_on(self) -> ChunkEntry | None:
        """Return the messages outside chunks that come last, if nothing behind them is broken."""
        last = self.chunks[-1] if self.chunks else None
        if last is None or not last.bare:
            return None
        stop = last.offset + last.length
        return None if any(d.offset + d.length > stop for d in self.damage) else last

    def drop_last(self, entry: ChunkEntry, place: int) -> None:
        """Leave out the last entry, of which only the message at a place [bytes] is damage.

        A DataEnd follows messages; where the records run on to the Footer without one, the message
        before has taken it in.
        """
        del self.chunks[-1], self.counts[-1]
        reason = "message: expected a DataEnd record between it and the summary, found none"
        self.note(entry.offset + place, entry.length - place, reason, 1)


def stray_reason(entry: ChunkEntry) -> str:
    """Name the damage of messages whose channel is defined nowhere."""
    place = "messages outside chunks" if entry.bare else "chunk"
    return f"{place}: expected a channel record before each message, found none for some"


def tear_reason(head: memoryview, rest: int) -> str:
    """Say what is wrong where no record can be; ``head`` begins the ``rest`` bytes of the file."""
    if len(head) < RECORD_HEAD.size:
        return f"records: expected a record, found {rest} bytes"
    opcode, length = RECORD_HEAD.unpack_from(head)
    if not opcode:
        return "records: expected an opcode, found 0x00"
    if length > rest - RECORD_HEAD.size:
        return (
            f"records: expected {length} bytes of opcode 0x{opcode:02x}, "
            f"found {rest - RECORD_HEAD.size} before the end of the file"
        )
    return f"records: expected a record, found opcode 0x{opcode:02x} of {length} bytes"
