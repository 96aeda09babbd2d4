"""Damage at every place of a small file, and bytes that never were a file."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap_files import (
    CHUNKED,
    MAGIC,
    Record,
    Row,
    changed,
    flipped,
    of_kind,
    opened,
    read,
    record,
    rows_of,
    small,
)
from memory_bytes import MemoryBytes
from sweeps import examples, swept

from groundtrace_codecs.errors import FormatError
from groundtrace_codecs.mcap.reader import McapFile


def chunk_rows(data: bytes) -> list[tuple[Record, set[Row]]]:
    """Every chunk with its messages, each read alone as a torn file that ends after it."""
    found, before = [], set[Row]()
    for chunk in of_kind(data, 6):
        with opened(data[: chunk.end]) as file:
            now = set(read(file))
        found.append((chunk, now - before))
        before = now
    return found


#: Damage is at every third place every day: bits of every number within their bytes are among them.
steps = pytest.mark.parametrize("step", swept([1, 3], 3))


@steps
@pytest.mark.parametrize("compression", CHUNKED)
def test_a_cut_anywhere_leaves_all_chunks_before_it(
    compression: CompressionType, step: int
) -> None:
    data = small(compression)
    chunks = chunk_rows(data)
    assert len(chunks) > 3
    for cut in range(8, len(data), step):
        with opened(data[:cut]) as file:
            found = read(file)
            assert file.damage
        expected = set().union(*(rows for chunk, rows in chunks if chunk.end <= cut))
        assert len(found) == len(expected)
        assert set(found) == expected


@steps
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_flip_anywhere_costs_at_most_its_chunk(compression: CompressionType, step: int) -> None:
    data = small(compression)
    chunks = chunk_rows(data)
    original = set(rows_of(data))
    for place in range(8, len(data) - 8, step):
        hit = set().union(*(rows for chunk, rows in chunks if chunk.offset <= place < chunk.end))
        with opened(flipped(data, place, 1 << place % 8)) as file:
            found = read(file)
        assert len(found) == len(set(found))
        assert original - hit <= set(found) <= original


@steps
def test_a_flip_in_a_file_without_summary_never_makes_a_message(step: int) -> None:
    data = small(CompressionType.NONE)
    (end,) = of_kind(data, 15)
    original = set(rows_of(data))
    for place in range(8, end.offset, step):
        with opened(flipped(data[: end.offset], place, 1 << place % 8)) as file:
            assert set(read(file)) <= original


def check_any(data: bytes) -> None:
    """Read all that can be read; anything but a FormatError fails the test."""
    with suppress(FormatError), McapFile.open(MemoryBytes(data)) as file:
        for _ in file.messages():
            pass
        for ref in file.attachments:
            with suppress(FormatError):
                file.attachment(ref)


@given(st.binary(max_size=200), st.booleans())
@settings(max_examples=examples(300), deadline=None)
def test_any_bytes_open_or_are_refused(content: bytes, magic: bool) -> None:
    check_any(MAGIC * magic + content)


@given(
    st.lists(
        st.tuples(st.integers(0, 16), st.binary(max_size=80)),
        max_size=8,
    ),
    st.binary(max_size=40),
)
@settings(max_examples=examples(300), deadline=None)
def test_any_records_open(parts: list[tuple[int, bytes]], tail: bytes) -> None:
    check_any(MAGIC + b"".join(record(opcode, content) for opcode, content in parts) + tail)


@given(st.data())
@settings(max_examples=examples(300), deadline=None)
def test_many_changes_at_once_never_make_a_message(draw: st.DataObject) -> None:
    data = original = small(draw.draw(st.sampled_from(CHUNKED)))
    for _ in range(draw.draw(st.integers(1, 4))):
        place = draw.draw(st.integers(8, len(data) - 1))
        data = changed(data, place, draw.draw(st.binary(min_size=1, max_size=12)))[: len(original)]
    check_any(data)
    assert set(read(opened(data))) <= set(rows_of(original))


@given(st.data())
@settings(max_examples=examples(300), deadline=None)
def test_bytes_lost_zeroed_and_put_in_between_never_make_a_message(draw: st.DataObject) -> None:
    original = small(draw.draw(st.sampled_from(CHUNKED)))
    (end,) = of_kind(original, 15)
    data = original[: end.offset] if draw.draw(st.booleans()) else original
    for _ in range(draw.draw(st.integers(1, 3))):
        place = draw.draw(st.integers(8, max(8, len(data) - 1)))
        gone = draw.draw(st.sampled_from([0, 1, 40, 300]))
        new = draw.draw(st.sampled_from([b"", bytes(gone), bytes(range(1, 60))]))
        data = data[:place] + new + data[place + gone :]
    check_any(data)
    assert set(read(opened(data))) <= set(rows_of(original))
