"""Finding the way again after a broken record head, and several files in one."""

from __future__ import annotations

import io
import random
import struct

import pytest
from mcap.writer import CompressionType, Writer
from mcap_files import (
    CHUNKED,
    changed,
    flipped,
    of_kind,
    opened,
    oracle,
    read,
    rows_of,
    small,
    write_recording,
)


def without_end(data: bytes) -> bytes:
    """The file as a killed writer leaves it: no DataEnd, no summary."""
    (end,) = of_kind(data, 15)
    return data[: end.offset]


@pytest.mark.parametrize("compression", CHUNKED)
def test_any_length_in_any_record_costs_at_most_that_chunk(compression: CompressionType) -> None:
    data = without_end(small(compression))
    rows = set(rows_of(small(compression)))
    wrong = random.Random(4)
    for record in of_kind(small(compression), 6) + of_kind(small(compression), 7):
        for length in (0, 1, record.length + 1, wrong.randrange(len(data)), 1 << 40, 1 << 63):
            broken = changed(data, record.offset + 1, struct.pack("<Q", length))
            with opened(broken) as file:
                assert set(read(file)) == rows, (record, length)
                assert len(file.damage) == 1 + (length != record.length)


def test_definitions_attachments_and_metadata_with_a_wrong_length_cost_no_message() -> None:
    data = without_end(small(CompressionType.ZSTD))
    rows = set(rows_of(small(CompressionType.ZSTD)))
    for record in (*of_kind(data, 9), *of_kind(data, 12), *of_kind(data, 1)):
        for length in (3, record.length + 5, 1 << 40):
            broken = changed(data, record.offset + 1, struct.pack("<Q", length))
            with opened(broken) as file:
                assert set(read(file)) == rows
                assert any(d.offset == record.offset for d in file.damage)


def test_a_wrong_length_among_messages_outside_chunks_costs_few_and_makes_none() -> None:
    data = without_end(write_recording(use_chunking=False))
    rows = oracle(write_recording(use_chunking=False))
    messages = of_kind(data, 5)
    for record in messages[20:-6:31]:
        for length in (0, 21, record.length - 3, record.length + 3, 1 << 40):
            broken = changed(data, record.offset + 1, struct.pack("<Q", length))
            with opened(broken) as file:
                found = read(file)
                assert set(found) <= set(rows)
                # which of two neighbours is wrong cannot always be told
                assert len(rows) - len(found) in (1, 2)
                (_, damage) = file.damage
                assert damage.offset <= record.offset < damage.offset + damage.length


def test_messages_inside_a_chunk_without_head_are_not_taken_for_messages_outside() -> None:
    data = without_end(small(CompressionType.NONE))
    first = of_kind(data, 6)[0]
    broken = changed(data, first.offset, bytes(60))
    with opened(broken) as file:
        found = read(file)
        # the definitions were in that chunk: what follows has no channel, and is told so
        assert found == []
        assert sum(d.messages or 0 for d in file.damage) == len(
            rows_of(small(CompressionType.NONE))
        )


def other_recording() -> bytes:
    """A file whose channel 1 is another one than in `write_recording`."""
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=CompressionType.ZSTD, chunk_size=300)
    writer.start()
    writer.register_channel("/imu", "raw", 0)
    writer.register_channel("/extra", "raw", writer.register_schema("Other", "raw", b"text"))
    for i in range(30):
        writer.add_message(1 + i % 2, 10**18 + i * 10**6, bytes([i]) * 40, 10**18, i)
    writer.finish()
    return buffer.getvalue()


@pytest.mark.parametrize("cut", [0, 8, 300, 1000])
def test_two_files_put_together_are_both_read_with_their_own_channels(cut: int) -> None:
    one, other = small(CompressionType.ZSTD), other_recording()
    torn = one[: len(one) - cut]
    with opened(torn) as first, opened(torn + other) as file:
        topics = {i: c.topic for i, c in file.channels.items()}
        assert sorted(topics.values()) == ["/extra", "/imu", "/seismic"]
        found = [(topics[m.channel_id], m.sequence, bytes(m.data)) for m in file.messages()]
        expected = {(first.channels[r[0]].topic, r[1], r[4]) for r in read(first)}
        expected |= {("/imu" if r[0] == 1 else "/extra", r[1], r[4]) for r in oracle(other)}
        assert len(found) == len(read(first)) + 30
        assert set(found) == expected
        assert {
            i: c.schema_id for i, c in file.channels.items()
        }.keys() == file.message_counts.keys()
        (told,) = [d for d in file.damage if d.reason.startswith("files: ")]
        assert (told.offset, told.messages) == (len(torn), 0)
        assert [m.log_time for m in file.messages()] == sorted(m.log_time for m in file.messages())
        only = [i for i, topic in topics.items() if topic == "/imu"]
        assert {m.channel_id for m in file.messages(only)} == set(only)


def test_a_second_copy_of_the_same_file_is_told_and_left_out() -> None:
    data = small(CompressionType.LZ4)
    with opened(data + data + data) as file:
        assert read(file) == list(rows_of(data))
        copies = [d for d in file.damage if "a copy of it" in d.reason]
        assert [(d.offset, d.length) for d in copies] == [
            (len(data), len(data)),
            (2 * len(data), len(data)),
        ]


def test_bytes_after_the_end_are_told_with_their_number() -> None:
    data = small(CompressionType.ZSTD)
    with opened(data + b"\xff" * 77) as file:
        assert read(file) == list(rows_of(data))
        assert file.damage[-1].reason.endswith("after the closing magic, found 77 bytes")
        assert (file.damage[-1].offset, file.damage[-1].length) == (len(data), 77)


def test_a_recording_inside_an_attachment_stays_inside() -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=CompressionType.NONE)
    writer.start()
    writer.register_channel("/a", "raw", 0)
    writer.add_attachment(0, 0, "inner.mcap", "application/mcap", small(CompressionType.NONE))
    writer.add_message(1, 5, b"x", 5)
    writer.finish()
    data = buffer.getvalue()
    (attachment,) = of_kind(data, 9)
    for broken in (data[:-1], flipped(data, len(data) - 30)):
        with opened(broken) as file:
            assert [bytes(m.data) for m in file.messages()] == [b"x"]
            assert file.attachment(file.attachments[0]) == small(CompressionType.NONE)
    for cut in range(attachment.offset + 9, attachment.end, 97):
        with opened(data[:cut]) as file:
            assert read(file) == []


def test_a_long_search_reads_every_byte_about_once() -> None:
    data = without_end(write_recording(40, 600, CompressionType.NONE))
    junk = (b"\x07" + bytes(8)) * 200_000
    with opened(data + junk + data[8:]) as file:
        assert len(read(file)) == 480
