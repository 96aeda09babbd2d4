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
from groundtrace_codecs.mcap.segments import Segment, distinct, join
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
    segments
        The files it consists of: one, unless some were put together.
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
    segments: tuple[Segment, ...]
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
        If the source neither begins as an MCAP file nor has a sound summary. Every other fault is
        a `Damage`.
    """
    start = source.read_at(0, len(MAGIC))
    damage: list[Damage] = []
    index = _from_summary(source, damage)
    if start != MAGIC:
        fault = (
            f"start of file: expected the MCAP magic {MAGIC.hex(' ')}, "
            f"found {start.hex(' ') or 'an empty file'}"
        )
        # a summary that passes its checks proves that this was an MCAP file
        if index is None:
            raise FormatError(f"{source.name}: {fault}")
        damage.insert(0, Damage(0, len(MAGIC), None, None, 0, fault))
    index = index or _from_scan(source)
    return replace(index, damage=(*damage, *index.damage))


def _from_summary(source: ByteSource, damage: list[Damage]) -> FileIndex | None:
    try:
        summary = read_summary(source)
    except MalformedError as error:
        reason = f"summary: {error}; recovered by a front scan"
        damage.append(Damage(source.size, 0, None, None, 0, reason))
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
        (Segment(summary.definitions),),
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
    scans, several = distinct(source, front_scan(source))
    whole = join(scans)
    return FileIndex(
        profile,
        library,
        whole.definitions,
        whole.segments,
        _in_order(whole.chunks),
        tuple(ref for scan in scans for ref in scan.attachments),
        tuple(record for scan in scans for record in scan.metadata),
        whole.counts,
        min((chunk.start_ns for chunk in whole.chunks), default=0),
        max((chunk.end_ns for chunk in whole.chunks), default=0),
        indexed=False,
        damage=(*damage, *(d for scan in scans for d in scan.damage), *several),
    )


def _header(source: ByteSource, damage: list[Damage]) -> tuple[str, str]:
    try:
        fields = Fields(read_record(source, len(MAGIC), HEADER))
        return fields.text(), fields.text()
    except MalformedError as error:
        damage.append(Damage(len(MAGIC), 0, None, None, 0, f"header: {error}"))
        return "", ""


def _metadata(
    source: ByteSource, spans: list[tuple[int, int]], damage: list[Damage]
) -> list[MetadataRecord]:
    found = []
    for offset, length in spans:
        try:
            found.append(parse_metadata(read_record(source, offset, METADATA)))
        except MalformedError as error:
            damage.append(Damage(offset, length, None, None, 0, f"metadata: {error}"))
    return found


def _in_order(chunks: list[ChunkEntry]) -> tuple[ChunkEntry, ...]:
    return tuple(sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset)))
