"""What a file holds and where: from its summary, or from a front scan where that will not do.

A summary is used only if its CRC matches and its Statistics record proves that it lists everything;
a summary may lawfully leave out channels, schemas or indexes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from groundtrace_codecs.errors import FormatError
from groundtrace_codecs.mcap.records import (
    HEADER,
    MAGIC,
    METADATA,
    AttachmentRef,
    Damage,
    Fields,
    MalformedError,
    MetadataRecord,
    parse_metadata,
    read_record,
)
from groundtrace_codecs.mcap.scan import front_scan
from groundtrace_codecs.mcap.summary import read_summary

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.bytesource import ByteSource
    from groundtrace_codecs.mcap.chunks import ChunkEntry, Definitions


@dataclass(frozen=True, slots=True)
class FileIndex:
    """All that is known of a file before its messages are read.

    Attributes
    ----------
    profile, library
        Of the Header record.
    definitions
        Schemas and channels.
    chunks
        Where the messages are, in the order (start time, offset).
    attachments, metadata
        In the order of the file.
    message_counts
        Messages by channel id.
    start_ns, end_ns
        First and last log time; 0 without messages.
    indexed
        True if the summary was used.
    damage
        What was found wrong so far.
    """

    profile: str
    library: str
    definitions: Definitions
    chunks: tuple[ChunkEntry, ...]
    attachments: tuple[AttachmentRef, ...]
    metadata: tuple[MetadataRecord, ...]
    message_counts: dict[int, int]
    start_ns: int
    end_ns: int
    indexed: bool
    damage: tuple[Damage, ...]


def load_index(source: ByteSource) -> FileIndex:
    """Find out what ``source`` holds.

    Raises
    ------
    FormatError
        If the source does not begin as an MCAP file. Every other fault is a `Damage`.
    """
    start = source.read_at(0, len(MAGIC))
    if start != MAGIC:
        raise FormatError(
            f"{source.name}: start of file: expected the MCAP magic {MAGIC.hex(' ')}, "
            f"found {start.hex(' ') or 'an empty file'}"
        )
    damage: list[Damage] = []
    index = _from_summary(source, damage) or _from_scan(source)
    return replace(index, damage=(*damage, *index.damage))


def _from_summary(source: ByteSource, damage: list[Damage]) -> FileIndex | None:
    try:
        summary = read_summary(source)
    except MalformedError as error:
        reason = f"summary: {error}; recovered by a front scan"
        damage.append(Damage(source.size, 0, None, None, None, reason))
        return None
    if summary is None or summary.statistics is None:
        return None
    profile, library = _header(source, damage)
    stated = summary.statistics
    # Messages outside chunks stay unread here: with chunk indexes present they are invisible to
    # every indexed reader (MCAP specification, "Chunk Index").
    return FileIndex(
        profile,
        library,
        summary.definitions,
        _in_order(summary.chunks),
        tuple(summary.attachments),
        tuple(_metadata(source, summary.metadata, damage)),
        stated.message_counts,
        stated.start_ns,
        stated.end_ns,
        indexed=True,
        damage=(),
    )


def _from_scan(source: ByteSource) -> FileIndex:
    damage: list[Damage] = []
    profile, library = _header(source, damage)
    found = front_scan(source)
    return FileIndex(
        profile,
        library,
        found.definitions,
        _in_order(found.chunks),
        tuple(found.attachments),
        tuple(found.metadata),
        found.message_counts(),
        min((chunk.start_ns for chunk in found.chunks), default=0),
        max((chunk.end_ns for chunk in found.chunks), default=0),
        indexed=False,
        damage=(*damage, *found.damage),
    )


def _header(source: ByteSource, damage: list[Damage]) -> tuple[str, str]:
    try:
        fields = Fields(read_record(source, len(MAGIC), HEADER))
        return fields.text(), fields.text()
    except MalformedError as error:
        damage.append(Damage(len(MAGIC), 0, None, None, None, f"header: {error}"))
        return "", ""


def _metadata(
    source: ByteSource, spans: list[tuple[int, int]], damage: list[Damage]
) -> list[MetadataRecord]:
    found = []
    for offset, length in spans:
        try:
            found.append(parse_metadata(read_record(source, offset, METADATA)))
        except MalformedError as error:
            damage.append(Damage(offset, length, None, None, None, f"metadata: {error}"))
    return found


def _in_order(chunks: list[ChunkEntry]) -> tuple[ChunkEntry, ...]:
    return tuple(sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset)))
