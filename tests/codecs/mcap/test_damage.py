"""Reading damaged MCAP files: what is lost is told, what is delivered is right."""

from __future__ import annotations

import random
import struct
import tracemalloc
from collections import Counter
from typing import TYPE_CHECKING

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap_damage_set import recording
from mcap_files import (
    CHUNKED,
    MAGIC,
    Record,
    changed,
    flipped,
    of_kind,
    opened,
    read,
    record,
    resealed,
    rows_of,
    small,
    write_recording,
)

from groundtrace_codecs.errors import FormatError

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.reader import McapFile


def delivered(data: bytes, original: bytes) -> tuple[int, McapFile]:
    """Read ``data``; check that all of it is of ``original``, once and in order."""
    file = opened(data)
    found = read(file)
    assert not Counter(found) - Counter(rows_of(original))
    assert found == sorted(found, key=lambda row: (row[2], row[0], row[1]))
    return len(found), file


@pytest.fixture(params=CHUNKED, ids=lambda compression: compression.name)
def sound(request: pytest.FixtureRequest) -> bytes:
    return recording(request.param)


def middle_chunk(data: bytes) -> tuple[Record, int, int]:
    """The middle chunk, the number of messages in it, and of those before it."""
    chunks = of_kind(data, 6)
    middle = len(chunks) // 2
    counts = [
        sum(
            struct.unpack_from("<I", data, index.offset + 11)[0] // 16
            for index in of_kind(data, 7)
            if chunk.end <= index.offset < following
        )
        for chunk, following in zip(
            chunks, [*(c.offset for c in chunks[1:]), len(data)], strict=True
        )
    ]
    return chunks[middle], counts[middle], sum(counts[:middle])


def test_a_flipped_bit_costs_its_chunk_and_is_told_with_span_and_count(sound: bytes) -> None:
    chunk, inside, _ = middle_chunk(sound)
    count, file = delivered(flipped(sound, chunk.offset + chunk.length // 2), sound)
    assert count == 3600 - inside
    (damage,) = file.damage
    assert (damage.offset, damage.length, damage.messages) == (
        chunk.offset,
        chunk.length + 9,
        inside,
    )
    first, last = struct.unpack_from("<QQ", sound, chunk.offset + 9)
    assert (damage.start_ns, damage.end_ns) == (first, last)
    assert damage.reason.startswith("chunk: expected ")
    read(file)
    assert len(file.damage) == 1


def test_a_zeroed_page_costs_its_chunk(sound: bytes) -> None:
    chunk, inside, _ = middle_chunk(sound)
    data = changed(sound, chunk.offset + chunk.length // 2, bytes(4096))
    count, file = delivered(data, sound)
    assert count == 3600 - inside
    assert [damage.messages for damage in file.damage] == [inside]


def test_a_cut_inside_a_chunk_leaves_every_whole_chunk(sound: bytes) -> None:
    chunk, _, before = middle_chunk(sound)
    count, file = delivered(sound[: chunk.offset + chunk.length // 2], sound)
    assert count == before
    assert not file.indexed
    torn = file.damage[-1]
    assert torn.offset == chunk.offset
    assert (torn.start_ns, torn.end_ns) == struct.unpack_from("<QQ", sound, chunk.offset + 9)


def test_a_cut_before_the_message_index_keeps_the_chunk(sound: bytes) -> None:
    chunk, inside, before = middle_chunk(sound)
    assert delivered(sound[: chunk.end], sound)[0] == before + inside


def test_a_zero_filled_tail_leaves_every_whole_chunk(sound: bytes) -> None:
    chunk, _, before = middle_chunk(sound)
    tear = chunk.offset + chunk.length // 2
    count, file = delivered(changed(sound, tear, bytes(len(sound) - tear)), sound)
    assert count == before
    assert [damage.offset for damage in file.damage[1:]] == [chunk.offset, chunk.end]
    assert "found 0x00" in file.damage[-1].reason


def spoiled_ends(data: bytes) -> dict[str, bytes]:
    """Damage to the end of the file that costs no message."""
    (end,) = of_kind(data, 15)
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    wrong_offset = of_kind(data, 8)[5].offset + 25
    return {
        "no footer": data[: end.offset],
        "last 8 bytes lost": data[:-8],
        "summary cut": data[:-200],
        "bit flip in summary": flipped(data, start + 40),
        "bit flip in footer": flipped(data, len(data) - 30),
        "wrong chunk offset": changed(data, wrong_offset, struct.pack("<Q", 12345)),
        "trailing garbage": data + random.Random(3).randbytes(4096),
        "two files": data + data,
    }


@pytest.mark.parametrize("kind", spoiled_ends(recording(CompressionType.ZSTD)))
def test_damage_to_the_end_of_the_file_costs_no_message(sound: bytes, kind: str) -> None:
    data = spoiled_ends(sound)[kind]
    count, file = delivered(data, sound)
    assert count == 3600
    assert file.message_counts == {1: 600, 2: 3000}
    if kind != "two files":
        assert file.damage[0].reason.startswith("summary: expected ")
        with pytest.raises(FormatError, match=r"^test\.mcap: byte \d+: summary: expected "):
            opened(data, strict=True)


def test_an_index_with_a_wrong_offset_and_a_right_crc_is_put_right_by_a_scan(sound: bytes) -> None:
    offset = of_kind(sound, 8)[5].offset + 25
    count, file = delivered(resealed(changed(sound, offset, struct.pack("<Q", 12345))), sound)
    assert (count, file.damage, file.indexed) == (3600, (), True)


@pytest.mark.parametrize("whole", [True, False], ids=["with summary", "without"])
def test_a_spoiled_chunk_head_costs_nothing_and_is_told(sound: bytes, whole: bool) -> None:
    chunk, _, _ = middle_chunk(sound)
    (end,) = of_kind(sound, 15)
    heads = [
        flipped(sound, chunk.offset),
        *(flipped(sound, chunk.offset + place) for place in range(1, 9)),
        changed(sound, chunk.offset, b"\x04"),
        changed(sound, chunk.offset, b"\x0f"),
        changed(sound, chunk.offset, bytes(9)),
        changed(sound, chunk.offset + 1, struct.pack("<Q", 1 << 50)),
    ]
    for data in heads:
        count, file = delivered(data if whole else data[: end.offset], sound)
        assert count == 3600
        damage = file.damage[-1]
        assert (damage.offset, damage.length, damage.messages) == (chunk.offset, 9, 0)
        assert "read by the chunk's own fields" in damage.reason


def test_a_chunk_that_lost_its_first_page_is_passed_over_where_no_summary_tells(
    sound: bytes,
) -> None:
    chunk, inside, _ = middle_chunk(sound)
    (end,) = of_kind(sound, 15)
    data = changed(sound, chunk.offset, bytes(4096))[: end.offset]
    count, file = delivered(data, sound)
    assert count == 3600 - inside
    (damage,) = [d for d in file.damage if d.messages]
    first, last = struct.unpack_from("<QQ", sound, chunk.offset + 9)
    assert (damage.offset, damage.length, damage.messages) == (
        chunk.offset,
        chunk.length + 9,
        inside,
    )
    assert (damage.start_ns, damage.end_ns) == (first, last)
    assert f"found again at byte {chunk.end}" in damage.reason


def test_a_file_without_chunks_is_read_whole() -> None:
    data = write_recording(600, 600, use_chunking=False)
    assert delivered(data, data)[0] == 3600


def test_messages_outside_chunks_are_dropped_where_the_data_crc_is_wrong() -> None:
    data = write_recording(use_chunking=False, enable_data_crcs=True)
    message = of_kind(data, 5)[50]
    count, file = delivered(flipped(data, message.end - 3), data)
    assert count == 0
    (damage,) = file.damage
    assert damage.messages == 240
    assert "expected data section CRC" in damage.reason


@pytest.mark.parametrize("messages", [1, 3])
def test_a_message_that_took_in_the_end_of_the_data_is_dropped(messages: int) -> None:
    data = write_recording(4, 60, use_chunking=False, enable_data_crcs=True)
    first = of_kind(data, 5)[-messages]
    (end,) = of_kind(data, 15)
    # what is lost: from within a message up to as many bytes before the end of DataEnd
    hurt = data[: first.end - 8] + data[end.end - 8 :]
    count, file = delivered(hurt, data)
    assert count == len(of_kind(data, 5)) - messages
    assert any("expected a DataEnd record" in damage.reason for damage in file.damage)


def test_a_damaged_chunk_raises_where_strictness_is_asked_for(sound: bytes) -> None:
    chunk, _, _ = middle_chunk(sound)
    with (
        opened(flipped(sound, chunk.offset + chunk.length // 2), strict=True) as file,
        pytest.raises(
            FormatError, match=rf"^test\.mcap: byte {chunk.offset}: chunk: expected .*found"
        ),
    ):
        read(file)


def test_a_damaged_attachment_is_refused() -> None:
    data = small(CompressionType.ZSTD)
    (attachment,) = of_kind(data, 9)
    for place in (attachment.end - 30, attachment.offset + 9, attachment.offset + 3):
        with (
            opened(flipped(data, place)) as file,
            pytest.raises(FormatError, match="attachment 'st"),
        ):
            file.attachment(file.attachments[0])


def lying_chunk(compression: bytes, size: int, packed: bytes) -> bytes:
    """A file of one chunk that states ``size`` uncompressed bytes."""
    name = struct.pack("<I", len(compression)) + compression
    content = struct.pack("<QQQI", 1, 2, size, 0) + name + struct.pack("<Q", len(packed)) + packed
    return MAGIC + record(1, bytes(8)) + record(6, content)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (lying_chunk(b"zstd", 1 << 60, bytes(50)), "expected at most 1638400 uncompressed"),
        (lying_chunk(b"", 1 << 60, bytes(50)), "expected at most 50 uncompressed"),
        (lying_chunk(b"brotli", 50, bytes(50)), "expected compression zstd, lz4 or none"),
        (lying_chunk(b"zstd", 99, zstandard.compress(bytes(1 << 20))), "found 1048576"),
        (lying_chunk(b"lz4", 99, lz4.frame.compress(bytes(1 << 20))), "expected 99 uncomp"),
        (lying_chunk(b"zstd", 99, bytes(50)), "expected zstd data, found"),
        (lying_chunk(b"lz4", 99, bytes(50)), "expected lz4 data, found"),
        (lying_chunk(b"", 5, b"\x05abcd"), "expected whole records"),
        (lying_chunk(b"", 31, record(5, bytes(5)) + bytes(17)), "expected 22 bytes of message"),
        (
            lying_chunk(b"", 40, b"\x05" + struct.pack("<Q", 1 << 60) + bytes(31)),
            "expected records",
        ),
        (MAGIC + b"\x06" + struct.pack("<Q", 1 << 60) + bytes(50), "expected 1152921504606846976"),
        (MAGIC + b"\x03" + struct.pack("<Q", 1 << 60), "expected 1152921504606846976 bytes"),
        (MAGIC + record(1, b"\xff\xff\xff\xff"), "header: expected 4294967299 bytes of fields"),
        (MAGIC + record(3, struct.pack("<HI", 1, 1) + b"\xff"), "expected UTF-8 text"),
        (MAGIC + record(3, bytes(14)), "expected a schema id"),
        (MAGIC + record(4, struct.pack("<HHI", 1, 9, 0) + bytes(8)), "expected schema 9 before"),
        (MAGIC + record(5, bytes(22)), "expected a channel record before each message"),
        (MAGIC, "expected the closing magic"),
    ],
)
def test_a_lie_is_told_and_allocates_nothing(data: bytes, reason: str) -> None:
    tracemalloc.start()
    with opened(data) as file:
        assert read(file) == []
        assert any(reason in damage.reason for damage in file.damage), file.damage
    assert tracemalloc.get_traced_memory()[1] < 4 << 20
    tracemalloc.stop()


def test_a_second_meaning_of_a_channel_is_damage() -> None:
    channel = record(4, struct.pack("<HHI", 1, 0, 2) + b"/a" + bytes(8))
    other = record(4, struct.pack("<HHI", 1, 0, 2) + b"/b" + bytes(8))
    with opened(MAGIC + channel + other) as file:
        assert file.channels[1].topic == "/a"
        assert "expected one channel 1, found a second" in file.damage[-1].reason
