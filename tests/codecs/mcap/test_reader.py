"""Reading sound MCAP files: order, selection, and every lawful way to lay a file out."""

from __future__ import annotations

import io
import itertools
import tracemalloc
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from mcap_files import ATTACHMENT, MAGIC, START_NS, of_kind, opened, oracle, read, write_recording
from memory_bytes import MemoryBytes
from sweeps import examples

from groundtrace_codecs.errors import FormatError
from groundtrace_codecs.mcap.chunks import AttachmentRef, MetadataRecord, Schema
from groundtrace_codecs.mcap.reader import McapFile

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.mcap.byte_source import ByteSource

COMPRESSIONS = list(CompressionType)


class CountingBytes(MemoryBytes):
    """Counts the bytes asked for in pieces larger than a record's head."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.bytes_read = 0

    def read_at(self, offset: int, length: int) -> bytes:
        self.bytes_read += length
        return super().read_at(offset, length)


@pytest.mark.parametrize("shuffle", [False, True], ids=["in order", "overlapping chunks"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_messages_come_as_the_mcap_package_reads_them(
    compression: CompressionType, shuffle: bool
) -> None:
    data = write_recording(compression=compression, shuffle=shuffle)
    with opened(data, strict=True) as file:
        assert file.indexed
        assert read(file) == oracle(data)
        assert len(of_kind(data, 6)) > 4


def test_what_a_file_says_of_itself_is_told() -> None:
    data = write_recording()
    rows = oracle(data)
    with opened(data) as file:
        assert (file.name, file.profile) == ("test.mcap", "profile")
        assert "library" in file.library
        assert file.schemas == {1: Schema(1, "Block", "raw", b"description")}
        assert {c.topic: (c.schema_id, c.metadata) for c in file.channels.values()} == {
            "/seismic": (1, {"unit": "m/s"}),
            "/imu": (0, {}),
        }
        assert file.message_counts == {1: 40, 2: 200}
        assert (file.start_ns, file.end_ns) == (rows[0][2], rows[-1][2])
        assert file.metadata == (MetadataRecord("session", {"site": "lab", "floor": "2"}),)
        (ref,) = file.attachments
        assert (ref.name, ref.media_type, ref.log_time, ref.create_time, ref.size) == (
            "station.xml",
            "application/xml",
            4,
            5,
            len(ATTACHMENT),
        )
        assert file.attachment(ref) == ATTACHMENT


def test_channels_and_a_half_open_time_span_select_messages() -> None:
    data = write_recording(shuffle=True)
    rows = oracle(data)
    times = sorted({row[2] for row in rows})
    bounds = [None, times[0], times[30], times[31], times[-1], times[-1] + 1]
    with opened(data) as file:
        for start, stop in itertools.product(bounds, bounds):
            expected = [
                row
                for row in rows
                if row[0] == 1
                and (start is None or row[2] >= start)
                and (stop is None or row[2] < stop)
            ]
            assert read(file, channel_ids=[1], start_ns=start, stop_ns=stop) == expected
        assert read(file, channel_ids=[]) == []
        assert read(file, channel_ids=[77]) == []


def test_a_short_span_reads_a_small_part_of_the_file() -> None:
    data = write_recording(blocks=400)
    source = CountingBytes(data)
    with McapFile.open(source) as file:
        source.bytes_read = 0
        start = START_NS + 10**10
        assert len(read(file, start_ns=start, stop_ns=start + 50_000_000)) == 6
        assert source.bytes_read < len(data) / 20


def test_two_readers_of_one_file_do_not_disturb_each_other() -> None:
    data = write_recording()
    with opened(data) as file:
        pairs = list(zip(read(file), file.messages(), strict=True))
        assert all(one[:4] == other[:4] for one, other in pairs)
        assert len(pairs) == 240


@given(
    st.lists(st.tuples(st.integers(1, 3), st.integers(0, 12), st.integers(0, 3)), max_size=60),
    st.integers(1, 400),
)
@settings(max_examples=examples(200), deadline=None)
def test_any_chunks_merge_to_what_sorting_all_messages_gives(
    keys: list[tuple[int, int, int]], chunk_bytes: int
) -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer, chunk_size=chunk_bytes, compression=CompressionType.NONE)
    writer.start()
    for topic in "abc":
        writer.register_channel(topic, "raw", 0)
    for place, (channel, log_time, sequence) in enumerate(keys):
        writer.add_message(channel, log_time, place.to_bytes(2), log_time, sequence)
    writer.finish()
    with opened(buffer.getvalue(), strict=True) as file:
        assert read(file) == oracle(buffer.getvalue())


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    peaks = []
    for blocks in (300, 3000):
        path = tmp_path / f"{blocks}.mcap"
        path.write_bytes(write_recording(blocks=blocks, chunk_bytes=1 << 16))
        with McapFile.open(path) as file:
            tracemalloc.start()
            assert sum(1 for _ in file.messages()) == 6 * blocks
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


def test_a_path_a_string_and_bytes_read_alike(tmp_path: Path) -> None:
    data = write_recording()
    path = tmp_path / "recording.mcap"
    path.write_bytes(data)
    sources: list[str | Path | ByteSource] = [path, str(path), MemoryBytes(data)]
    for source in sources:
        with McapFile.open(source) as file:
            assert read(file) == oracle(data)


def test_a_file_without_messages_is_empty_and_sound() -> None:
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    writer.finish()
    with opened(buffer.getvalue(), strict=True) as file:
        assert read(file) == []
        assert (file.start_ns, file.end_ns, file.message_counts) == (0, 0, {})


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 something else", MAGIC[:7]])
def test_what_is_no_mcap_file_is_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.bin"
    path.write_bytes(content)
    with pytest.raises(
        FormatError, match=r"other\.bin: start of file: expected the MCAP magic 89 4d"
    ) as caught:
        McapFile.open(path)
    assert "\n" not in str(caught.value)


def test_an_attachment_that_is_not_there_is_an_error() -> None:
    data = write_recording()
    with opened(data) as file:
        (ref,) = file.attachments
        wrong = AttachmentRef(8, ref.length, 4, 5, ref.size, ref.name, ref.media_type)
        with pytest.raises(FormatError, match="expected opcode 0x09, found 0x01"):
            file.attachment(wrong)
