"""A file of some kB that unpacks to a gigabyte takes no more memory than another, and is said."""

from __future__ import annotations

import struct
import tracemalloc
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
import zstandard
from mcap_files import record

from groundtrace.cli.main import main
from groundtrace_codecs.mcap.chunks import CHANNEL, CHUNK, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: The most that a command may hold for a file of a megabyte [bytes].
MOST_BYTES = 300e6


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def message(payload: bytes) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", 1, 0, 5, 5) + payload)


def chunk(records: bytes) -> bytes:
    packed = zstandard.ZstdCompressor().compress(records)
    head = struct.pack("<QQQI", 5, 5, len(records), 0) + text("zstd")
    return record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def recording(path: Path, chunks: list[bytes]) -> Path:
    channel = record(CHANNEL, struct.pack("<HH", 1, 0) + text("/a") + text("raw") + bytes(4))
    end = record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC
    whole = MAGIC + record(HEADER, text("") + text("")) + channel + b"".join(chunks) + end
    assert len(whole) < 1_000_000
    path.write_bytes(whole)
    return path


def one_large_message(path: Path) -> Path:
    return recording(path, [chunk(message(bytes(500_000_000)))])


def many_empty_messages(path: Path) -> Path:
    return recording(path, [chunk(message(b"") * 5_000_000)])


def many_chunks_of_one_time(path: Path) -> Path:
    return recording(path, 6 * [chunk(message(bytes(30_000_000)))])


def held(command: list[object]) -> int:
    """Run a command; return the most memory that it held at once [bytes]."""
    tracemalloc.start()
    try:
        with suppress(SystemExit):
            main([str(word) for word in command])
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (one_large_message, "expected at most 33554432 uncompressed bytes of"),
        (many_empty_messages, "expected at most 33554432 uncompressed bytes of"),
        (many_chunks_of_one_time, "expected overlapping chunks of at most 134217728 bytes, found"),
    ],
)
@pytest.mark.parametrize("command", ["info", "doctor", "cut"])
def test_a_small_file_takes_little_memory_and_is_told(
    make: Callable[[Path], Path], found: str, command: str, tmp_path: Path, capsys
) -> None:
    small = make(tmp_path / "small.mcap")
    more = ("-o", tmp_path / "cut.mcap", "--from", "0", "--to", "1") if command == "cut" else ()
    assert held([command, small, *more]) < MOST_BYTES
    if command != "info" or make is not many_chunks_of_one_time:  # info reads no messages
        said = capsys.readouterr()
        assert found in " ".join((said.out + said.err).split())
