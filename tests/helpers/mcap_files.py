"""Recordings for the tests of the MCAP reader, and ways to hurt them."""

from __future__ import annotations

import io
import random
import struct
import zlib
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer
from memory_bytes import MemoryBytes

from groundtrace_codecs.mcap.reader import McapFile

if TYPE_CHECKING:
    from collections.abc import Iterator

START_NS = 10**18
ATTACHMENT = b"<FDSNStationXML/>" * 4

CHUNKED = [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4]
MAGIC = b"\x89MCAP0\r\n"

Row = tuple[int, int, int, int, bytes]


def write_recording(
    blocks: int = 40,
    block_bytes: int = 600,
    compression: CompressionType = CompressionType.ZSTD,
    chunk_bytes: int = 4096,
    shuffle: bool = False,
    **options: bool,
) -> bytes:
    """Two interleaved streams, as a session records them, with an attachment and metadata.

    With ``shuffle`` the messages are written out of order by up to two chunks.
    """
    random_bytes = random.Random(1).randbytes
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=compression, chunk_size=chunk_bytes, **options)
    writer.start("profile", "library")
    schema = writer.register_schema("Block", "raw", b"description")
    seismic = writer.register_channel("/seismic", "raw", schema, {"unit": "m/s"})
    imu = writer.register_channel("/imu", "raw", 0)
    writer.add_attachment(5, 4, "station.xml", "application/xml", ATTACHMENT)
    writer.add_metadata("session", {"site": "lab", "floor": "2"})
    rows = []
    for block in range(blocks):
        start = START_NS + block * 50_000_000
        rows += [
            (imu, start + k * 10_000_000, start, 5 * block + k, random_bytes(40)) for k in range(5)
        ]
        rows.append((seismic, start + 50_000_000, start, block, random_bytes(block_bytes)))
    if shuffle:
        jitter = random.Random(2)
        rows.sort(key=lambda row: row[1] + jitter.randrange(0, 800_000_000))
    for channel, log_time, publish_time, sequence, data in rows:
        writer.add_message(channel, log_time, data, publish_time, sequence)
    writer.finish()
    return buffer.getvalue()


def oracle(data: bytes) -> list[Row]:
    """Messages of a sound file in replay order, as the mcap package reads them."""
    reader = NonSeekingReader(io.BytesIO(data))
    rows = [
        (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
        for _, _, m in reader.iter_messages(log_time_order=False)
    ]
    return sorted(rows, key=lambda row: (row[2], row[0], row[1]))


def read(file: McapFile, **selection: object) -> list[Row]:
    """Messages of ``file`` with their data as bytes."""
    return [(*m[:4], bytes(m.data)) for m in file.messages(**selection)]  # type: ignore[arg-type]


def opened(data: bytes, strict: bool = False) -> McapFile:
    return McapFile.open(MemoryBytes(data, "test.mcap"), strict=strict)


@dataclass(frozen=True, slots=True)
class Record:
    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        return self.offset + 9 + self.length


def records(data: bytes) -> Iterator[Record]:
    offset = 8
    while offset < len(data) - 8:
        record = Record(
            *struct.unpack_from("<B", data, offset),
            offset,
            *struct.unpack_from("<Q", data, offset + 1),
        )
        yield record
        offset = record.end


def of_kind(data: bytes, opcode: int) -> list[Record]:
    return [record for record in records(data) if record.opcode == opcode]


def record(opcode: int, content: bytes) -> bytes:
    """Bytes of one record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def resealed(data: bytes) -> bytes:
    """The file with the summary's CRC made right again after a change."""
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    return data[:-12] + struct.pack("<I", zlib.crc32(data[start:-12])) + data[-8:]


def changed(data: bytes, offset: int, new: bytes) -> bytes:
    return data[:offset] + new + data[offset + len(new) :]


def flipped(data: bytes, offset: int, mask: int = 0x10) -> bytes:
    return changed(data, offset, bytes([data[offset] ^ mask]))


@cache
def small(compression: CompressionType) -> bytes:
    return write_recording(4, 60, compression, chunk_bytes=400)


@cache
def rows_of(data: bytes) -> tuple[Row, ...]:
    return tuple(oracle(data))
