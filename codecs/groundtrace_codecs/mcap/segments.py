"""Several files written one after the other into one, read as one recording.

A logger that appends to an existing file, or two files put together, leave a second beginning after
the first end. Ids mean something else in each, so they are made distinct; a second copy of the same
bytes is left out.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING

from groundtrace_codecs.mcap.bytesource import crc32_of
from groundtrace_codecs.mcap.chunks import ChunkEntry, Definitions
from groundtrace_codecs.mcap.records import Damage

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from groundtrace_codecs.mcap.bytesource import ByteSource
    from groundtrace_codecs.mcap.scanned import Scan


@dataclass(frozen=True, slots=True)
class Segment:
    """One of the files in a source.

    Attributes
    ----------
    definitions
        Its own schemas and channels.
    ids
        Id of each of its channels in the whole; None where they are the same.
    """

    definitions: Definitions
    ids: Mapping[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Joined:
    """Several scans as one.

    Attributes
    ----------
    segments
        The files.
    definitions
        Of the whole.
    chunks
        With the ids of the whole.
    counts
        Messages by channel id of the whole.
    """

    segments: tuple[Segment, ...]
    definitions: Definitions
    chunks: list[ChunkEntry]
    counts: dict[int, int]


def distinct(source: ByteSource, scans: Sequence[Scan]) -> tuple[list[Scan], list[Damage]]:
    """Leave out scans of the same bytes as an earlier one; say where each file begins."""
    seen: dict[tuple[int, int], int] = {}
    kept, damage = [], []
    for scan in scans:
        length = scan.stop - scan.start
        # one file alone has nothing to be compared with
        key = (length, crc32_of(source, scan.start, scan.stop) if len(scans) > 1 else 0)
        first = seen.setdefault(key, scan.start)
        if first == scan.start:
            kept.append(scan)
        if scan.start:
            found = "another begins; both are read" if first == scan.start else "a copy of it"
            reason = f"files: expected the end of the file, found {found}"
            damage.append(Damage(scan.start, length, None, None, 0, reason))
    return kept, damage


def join(scans: Sequence[Scan]) -> Joined:
    """Put scans together; the first keeps its ids."""
    whole = Definitions()
    segments, chunks, counts = [], [], Counter[int]()
    for number, scan in enumerate(scans):
        ids = _added(whole, scan.definitions)
        same = all(old == new for old, new in ids.items())
        segments.append(Segment(scan.definitions, None if same else ids))
        for chunk in scan.chunks:
            channels = frozenset(ids[i] for i in chunk.channel_ids or ())
            chunks.append(replace(chunk, channel_ids=channels, segment=number))
        for channel, messages in scan.message_counts().items():
            counts[ids[channel]] += messages
    return Joined(tuple(segments), whole, chunks, dict(counts))


def _added(whole: Definitions, part: Definitions) -> dict[int, int]:
    """Add the definitions of one file; give the new id of each of its channels."""
    schemas, earlier = {0: 0}, dict(whole.schemas)
    for schema in part.schemas.values():
        alike = (s.id for s in earlier.values() if replace(s, id=schema.id) == schema)
        schemas[schema.id] = new = _new_id(whole.schemas, schema.id, alike)
        whole.schemas[new] = replace(schema, id=new)
    ids, before = dict[int, int](), dict(whole.channels)
    for channel in part.channels.values():
        moved = replace(channel, schema_id=schemas[channel.schema_id])
        # two channels of one file stay two, even where they say the same
        alike = (c.id for c in before.values() if replace(c, id=channel.id) == moved)
        ids[channel.id] = new = _new_id(
            whole.channels, channel.id, (i for i in alike if i not in ids.values())
        )
        whole.channels[new] = replace(moved, id=new)
    return ids


def _new_id(known: Mapping[int, object], wanted: int, alike: Iterable[int]) -> int:
    """Give the id of the same thing, the wanted one if it is free, or the next free one."""
    found = next(iter(alike), None)
    if found is not None:
        return found
    return wanted if wanted not in known else next(i for i in count(1) if i not in known)
