"""The damage set: one recording of 3600 messages, hurt in every way that happens in the field."""

from __future__ import annotations

import random
import struct
from functools import cache

from mcap.writer import CompressionType
from mcap_files import CHUNKED, MAGIC, changed, flipped, of_kind, write_recording

MESSAGES = 3600


@cache
def recording(compression: CompressionType) -> bytes:
    """The recording of the damage table: 3600 messages in chunks of about 85."""
    return write_recording(600, 6000, compression, chunk_bytes=90_000)


def hurt(data: bytes) -> dict[str, bytes]:
    """Every damage to one sound file, by name."""
    chunks = of_kind(data, 6)
    middle = chunks[len(chunks) // 2]
    inside = middle.offset + middle.length // 2
    (end,) = of_kind(data, 15)
    summary = struct.unpack_from("<Q", data, len(data) - 28)[0]
    index = of_kind(data, 8)[5].offset + 25
    return {
        "cut inside a chunk": data[:inside],
        "cut after a chunk, before its index": data[: middle.end],
        "cut before the footer": data[: end.offset],
        "last 8 bytes lost": data[:-8],
        "summary cut": data[:-200],
        "a bit of a chunk flipped": flipped(data, inside),
        "a page of a chunk zeroed": changed(data, inside, bytes(4096)),
        "a chunk's length is 2^50": changed(data, middle.offset + 1, struct.pack("<Q", 1 << 50)),
        "a bit of the summary flipped": flipped(data, summary + 40, 0xFF),
        "a wrong offset in the index": changed(data, index, struct.pack("<Q", 12345)),
        "4096 bytes after the end": data + random.Random(3).randbytes(4096),
        "zeros after a cut": changed(data, inside, bytes(len(data) - inside)),
        "the file twice": data + data,
        "a chunk's first page zeroed, no summary": changed(data, middle.offset, bytes(4096))[
            : end.offset
        ],
        "a chunk's length wrong, no summary": flipped(data, middle.offset + 2)[: end.offset],
    }


def damage_set() -> dict[tuple[str, str], tuple[bytes, bytes]]:
    """Each damaged file and the sound one it was, by damage and compression."""
    found = {}
    for compression in CHUNKED:
        data = recording(compression)
        name = compression.name.lower()
        found |= {(kind, name): (broken, data) for kind, broken in hurt(data).items()}
        found["sound", name] = data, data
    bare = write_recording(600, 6000, use_chunking=False)
    found["without chunks", "none"] = bare, bare
    found["without chunks, cut", "none"] = bare[: len(bare) // 2], bare
    found["only the magic", "none"] = MAGIC, recording(CompressionType.NONE)
    return found
