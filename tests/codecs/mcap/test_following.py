"""Files that grow while they are read: every message once, in order, as of the finished file."""

from __future__ import annotations

import os
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap_files import Row, changed, of_kind, oracle, rows_of, small, write_recording
from sweeps import examples

from groundtrace_codecs.mcap import follow
from groundtrace_codecs.mcap.follow import FollowedFile, GrowingFile, PipeBytes

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path


class Steps:
    """Bytes of which more are there each time one looks."""

    name = "steps"

    def __init__(self, data: bytes, sizes: Iterable[int]) -> None:
        self._data = data
        self._sizes = [*sorted({min(size, len(data)) for size in sizes}), len(data)]
        self._kept_from = 0
        self.size = 0

    @property
    def ended(self) -> bool:
        return self.size == len(self._data)

    def grow(self) -> bool:
        before, self.size = self.size, self._sizes.pop(0) if self._sizes else self.size
        return self.size > before

    def read_at(self, offset: int, length: int) -> bytes:
        assert offset >= self._kept_from
        return self._data[offset : min(offset + length, self.size)]

    def forget(self, before: int) -> None:
        self._kept_from = before

    def sha256(self) -> str:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError


def followed(file: FollowedFile) -> list[Row]:
    return [(*m[:4], bytes(m.data)) for table in file.tables() for m in table]


def of_steps(data: bytes, sizes: Iterable[int]) -> tuple[list[Row], FollowedFile, list[str]]:
    told: list[str] = []
    file = FollowedFile(Steps(data, sizes), threading.Event(), told.append)
    return followed(file), file, told


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follow, "POLL_S", 0.0)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(40))
@given(
    st.sampled_from([CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4, None]),
    st.lists(st.integers(0, 60_000), max_size=12),
)
def test_wherever_a_file_stops_on_its_way_all_its_messages_come(
    compression: CompressionType | None, sizes: list[int]
) -> None:
    chunked = compression is not None
    data = write_recording(compression=compression or CompressionType.NONE, use_chunking=chunked)
    found, file, told = of_steps(data, sizes)
    assert sorted(found) == sorted(oracle(data))
    assert (file.finished, file.damage, told) == (True, (), [])
    times = [row[2] for row in found]
    assert times == sorted(times)


def test_what_is_there_at_a_stop_is_given_to_its_end() -> None:
    data, stop, found = write_recording(blocks=400), threading.Event(), list[Row]()
    file = FollowedFile(Steps(data, ()), stop, lambda _: None)
    for table in file.tables():
        stop.set()
        found += [(*m[:4], bytes(m.data)) for m in table]
    assert sorted(found) == sorted(oracle(data))
    assert file.finished


def test_what_was_given_is_let_go() -> None:
    data = write_recording(blocks=400)
    file = FollowedFile(Steps(data, range(0, len(data), 997)), threading.Event(), lambda _: None)
    assert max(len(table.pieces) for table in file.tables()) <= 3


def test_messages_a_little_out_of_order_come_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    data = write_recording(shuffle=True)
    monkeypatch.setattr(follow, "LATE_NS", 2_000_000_000)
    found, _, _ = of_steps(data, range(0, len(data), 997))
    assert [row[2] for row in found] == [row[2] for row in oracle(data)]


def test_a_damaged_chunk_is_left_out_and_the_rest_comes() -> None:
    data = small(CompressionType.ZSTD)
    chunk = of_kind(data, 6)[1]
    hurt = changed(data, chunk.offset + 80, b"\xff\xff\xff")
    found, file, _ = of_steps(hurt, range(0, len(data), 701))
    lost = len(rows_of(data)) - len(found)
    assert lost > 0
    assert sum(damage.messages or 0 for damage in file.damage) == lost
    assert set(found) < set(rows_of(data))


def test_a_broken_head_is_passed_over_when_the_next_record_is_there() -> None:
    data = small(CompressionType.ZSTD)
    chunk = of_kind(data, 6)[1]
    hurt = changed(data, chunk.offset, b"\x77" + b"\xff" * 40)
    found, file, _ = of_steps(hurt, range(0, len(data), 701))
    assert 0 < len(found) < len(rows_of(data))
    assert set(found) < set(rows_of(data))
    assert len(file.damage) == 1


def test_room_that_is_taken_before_there_is_content_is_waited_for(
    sources: ExitStack, tmp_path: Path
) -> None:
    data = small(CompressionType.ZSTD)
    chunk = of_kind(data, 6)[1].offset
    path = tmp_path / "rec.mcap"
    file, told = growing(sources, path, data[:chunk] + bytes(len(data) - chunk))
    tables = file.tables()
    found = len(next(tables))
    path.write_bytes(data)
    found += sum(len(table) for table in tables)
    assert (found, told, file.damage) == (len(rows_of(data)), [], ())


def test_a_pipe_that_ends_inside_a_record_is_told() -> None:
    data = small(CompressionType.ZSTD)
    cut = of_kind(data, 6)[2].offset + 100
    found, file, told = of_steps(data[:cut], [])
    assert set(found) < set(rows_of(data))
    assert told == [damage.reason for damage in file.damage]
    assert "of opcode 0x06, found 91 before the end of the file" in told[0]


def test_a_pipe_that_ends_between_records_lacks_its_end() -> None:
    data = small(CompressionType.ZSTD)
    _, file, told = of_steps(data[: of_kind(data, 15)[0].offset], [])
    reason = "steps: end of file: expected the closing magic, found the end of the pipe"
    assert [damage.reason for damage in file.damage] == told == [reason]


def test_a_pipe_is_kept_from_where_it_may_be_read_again() -> None:
    data = small(CompressionType.ZSTD)
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        source = PipeBytes(pipe, "pipe")
        writer = threading.Thread(target=lambda: (os.write(writing, data), os.close(writing)))
        writer.start()
        file = FollowedFile(source, threading.Event(), lambda _: None)
        assert sorted(followed(file)) == sorted(rows_of(data))
        writer.join()
        with pytest.raises(follow.CodecError, match="expected to be read once, found byte 0"):
            source.read_at(0, 8)


@pytest.fixture
def sources() -> Iterator[ExitStack]:
    with ExitStack() as held:
        yield held


def growing(sources: ExitStack, path: Path, data: bytes) -> tuple[FollowedFile, list[str]]:
    path.write_bytes(data)
    told: list[str] = []
    source = GrowingFile(path)
    sources.callback(source.close)
    return FollowedFile(source, threading.Event(), told.append), told


def test_a_writer_that_stalls_and_goes_on_is_told(
    sources: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = small(CompressionType.ZSTD)
    cut = of_kind(data, 6)[2].offset + 100
    path = tmp_path / "rec.mcap"
    path.write_bytes(data[:cut])
    source = GrowingFile(path)
    sources.callback(source.close)
    told: list[str] = []

    def write_on(line: str) -> None:
        if not told:
            path.write_bytes(data)
        told.append(line)

    monkeypatch.setattr(follow, "STALL_S", 0.02)
    file = FollowedFile(source, threading.Event(), write_on)
    assert len(followed(file)) == len(rows_of(data))
    assert told[0].endswith("rec.mcap: 100 bytes of a record and no more for 0.02 s; still waiting")
    assert "rec.mcap: goes on after 0" in told[1]
    assert len(told) == 2


def test_a_file_that_is_replaced_ends_there_and_is_told(sources: ExitStack, tmp_path: Path) -> None:
    data = small(CompressionType.ZSTD)
    path = tmp_path / "rec.mcap"
    file, told = growing(sources, path, data[: of_kind(data, 6)[2].offset])
    tables = file.tables()
    found = len(next(tables))
    other = tmp_path / "other.mcap"
    other.write_bytes(data)
    other.replace(path)
    found += sum(len(table) for table in tables)
    assert 0 < found < len(rows_of(data))
    assert told[0].endswith("rec.mcap: expected the file that was begun, found another")
    assert [damage.reason for damage in file.damage] == told


def test_a_file_that_is_cut_short_ends_there_and_is_told(
    sources: ExitStack, tmp_path: Path
) -> None:
    data = small(CompressionType.ZSTD)
    path = tmp_path / "rec.mcap"
    cut = of_kind(data, 6)[2].offset
    file, told = growing(sources, path, data[:cut])
    tables = file.tables()
    found = len(next(tables))
    os.truncate(path, 100)
    found += sum(len(table) for table in tables)
    assert 0 < found < len(rows_of(data))
    reason = f"expected a file that grows, found it cut to 100 bytes of {cut}"
    assert told[0].endswith(f"rec.mcap: {reason}")


def test_a_file_that_gets_its_name_when_it_is_finished_is_the_same(
    sources: ExitStack, tmp_path: Path
) -> None:
    data = small(CompressionType.ZSTD)
    path = tmp_path / "rec.mcap.partial"
    file, told = growing(sources, path, data[:-20])
    tables = file.tables()
    found = len(next(tables))
    path.replace(tmp_path / "rec.mcap")
    with (tmp_path / "rec.mcap").open("ab") as rest:
        rest.write(data[-20:])
    found += sum(len(table) for table in tables)
    assert (found, told, file.finished) == (len(rows_of(data)), [], True)


def test_a_stop_waits_for_no_more_than_is_there(sources: ExitStack, tmp_path: Path) -> None:
    whole = small(CompressionType.ZSTD)
    data = whole[: of_kind(whole, 6)[-1].offset]
    path = tmp_path / "rec.mcap"
    path.write_bytes(data)
    source = GrowingFile(path)
    sources.callback(source.close)
    stop = threading.Event()
    file = FollowedFile(source, stop, lambda _: None)
    tables = file.tables()
    first = len(next(tables))
    stop.set()
    there = len(of_steps(data, ())[0])
    assert first + sum(len(table) for table in tables) == there
    assert first < there < len(rows_of(whole))
    assert (file.finished, file.damage) == (False, ())
