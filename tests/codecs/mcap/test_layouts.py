"""Every lawful way to lay an MCAP file out, beyond what one writer makes."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import pytest
from mcap.writer import IndexType
from mcap_files import (
    ATTACHMENT,
    MAGIC,
    START_NS,
    changed,
    of_kind,
    opened,
    oracle,
    read,
    record,
    records,
    resealed,
    write_recording,
)

if TYPE_CHECKING:
    from groundtrace_codecs.mcap.chunks import Message


def message_record(channel: int, sequence: int, log_time: int, data: bytes = b"x") -> bytes:
    return record(5, struct.pack("<HIQQ", channel, sequence, log_time, log_time) + data)


def channel_record(channel: int, topic: bytes = b"/t") -> bytes:
    return record(4, struct.pack("<HHI", channel, 0, len(topic)) + topic + bytes(8))


def chunk_record(content: bytes, start_ns: int, end_ns: int, crc: int | None = None) -> bytes:
    head = struct.pack(
        "<QQQI", start_ns, end_ns, len(content), zlib.crc32(content) if crc is None else crc
    )
    return record(6, head + struct.pack("<IQ", 0, len(content)) + content)


def bare_file(*body: bytes) -> bytes:
    """A file without summary around ``body``."""
    end = record(15, bytes(4)) + record(2, bytes(20))
    return MAGIC + record(1, bytes(8)) + b"".join(body) + end + MAGIC


def key(message: Message) -> tuple[int, int, int]:
    return message.log_time, message.channel_id, message.sequence


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_summary_offsets": False},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.CHUNK},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
    ],
    ids=str,
)
def test_parts_a_writer_may_leave_out_change_nothing_that_is_read(options: dict[str, bool]) -> None:
    whole, data = write_recording(), write_recording(**options)
    with opened(whole) as expected, opened(data, strict=True) as file:
        assert read(file) == read(expected)
        assert file.schemas == expected.schemas
        assert file.channels == expected.channels
        assert file.metadata == expected.metadata
        assert file.message_counts == expected.message_counts
        assert (file.start_ns, file.end_ns) == (expected.start_ns, expected.end_ns)
        assert [file.attachment(ref) for ref in file.attachments] == [ATTACHMENT]


def test_equal_log_times_go_by_channel_then_sequence_then_place_in_the_file() -> None:
    body = [
        channel_record(1),
        channel_record(2),
        chunk_record(message_record(2, 0, 7) + message_record(1, 5, 7, b"a"), 7, 7),
        chunk_record(message_record(1, 5, 7, b"b") + message_record(1, 4, 7), 7, 7),
        message_record(1, 5, 7, b"c"),
    ]
    with opened(bare_file(*body), strict=True) as file:
        assert [(*key(m), bytes(m.data)) for m in file.messages()] == [
            (7, 1, 4, b"x"),
            (7, 1, 5, b"a"),
            (7, 1, 5, b"b"),
            (7, 1, 5, b"c"),
            (7, 2, 0, b"x"),
        ]


def test_messages_before_and_between_chunks_are_read_where_no_index_hides_them() -> None:
    body = [
        channel_record(1),
        message_record(1, 0, 10),
        chunk_record(message_record(1, 1, 5) + message_record(1, 2, 20), 5, 20),
        message_record(1, 3, 15),
        record(0x90, b"private"),
        message_record(1, 4, 30),
    ]
    with opened(bare_file(*body), strict=True) as file:
        assert [m.sequence for m in file.messages()] == [1, 0, 3, 2, 4]
        assert file.message_counts == {1: 5}
        assert not file.indexed


def test_unknown_records_and_repeated_definitions_inside_a_chunk_are_skipped() -> None:
    content = (
        channel_record(1)
        + record(0x42, b"from the future")
        + message_record(1, 0, 1)
        + channel_record(1)
        + message_record(1, 1, 2)
    )
    with opened(bare_file(chunk_record(content, 1, 2)), strict=True) as file:
        assert [m.sequence for m in file.messages()] == [0, 1]


def test_a_chunk_without_crc_is_read() -> None:
    content = channel_record(1) + message_record(1, 0, 1)
    with opened(bare_file(chunk_record(content, 1, 1, crc=0)), strict=True) as file:
        assert len(read(file)) == 1


def test_a_chunk_that_states_a_wrong_span_is_still_read_in_order() -> None:
    body = [
        channel_record(1),
        chunk_record(message_record(1, 0, 10) + message_record(1, 1, 30), 0, 0),
        chunk_record(message_record(1, 2, 20), 90, 90),
    ]
    with opened(bare_file(*body), strict=True) as file:
        assert [m.log_time for m in file.messages()] == [10, 20, 30]
        assert (file.start_ns, file.end_ns) == (10, 30)


def test_no_message_goes_back_in_time_where_the_index_states_too_late_a_start() -> None:
    data = write_recording()
    index = of_kind(data, 8)[3]
    late = START_NS + 10**12
    wrong = resealed(changed(data, index.offset + 9, struct.pack("<QQ", late, late)))
    with opened(wrong) as file:
        found = read(file)
        assert [row[2] for row in found] == sorted(row[2] for row in found)
        (damage,) = file.damage
        assert len(found) + (damage.messages or 0) == 240


def test_records_may_carry_more_bytes_than_are_known() -> None:
    data = write_recording(use_chunking=False)
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    grown = b"".join(
        record(
            r.opcode, data[r.offset + 9 : r.end] + b"\x01\xff\xff" * (r.opcode not in (2, 5, 15))
        )
        for r in records(data)
        if r.offset < start and r.opcode not in (2, 15)
    )
    body = bare_file().replace(record(1, bytes(8)), grown)
    with opened(body, strict=True) as file:
        assert read(file) == oracle(data)
        assert [file.attachment(ref) for ref in file.attachments] == [ATTACHMENT]
