"""Chunks are merged in the order of a replay, at a cost that follows what is due."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from groundtrace_codecs.mcap.chunks import ChunkEntry, MalformedError, Message, MessageTable
from groundtrace_codecs.mcap.reader import merge

if TYPE_CHECKING:
    import pytest


def chunks_of(spans: list[list[tuple[int, int]]]) -> list[tuple[ChunkEntry, list[Message]]]:
    """Chunks of messages of given log times and channels, as they lie in a file."""
    found = []
    for offset, rows in enumerate(spans):
        said = [Message(channel, offset, time, time, b"") for time, channel in sorted(rows)]
        times = [m.log_time for m in said]
        found.append((ChunkEntry(offset, 1, min(times), max(times), None), said))
    return sorted(found, key=lambda pair: (pair[0].start_ns, pair[0].offset))


def never(entry: ChunkEntry, error: MalformedError) -> None:
    raise AssertionError((entry, error))


def test_what_overlaps_beyond_the_room_is_left_out_and_said() -> None:
    pairs = chunks_of(5 * [[(5, 1), (99, 1)]])
    tables = {entry.offset: MessageTable.of(messages) for entry, messages in pairs}
    refused: list[tuple[int, str]] = []
    room_bytes = 3 * tables[0].nbytes
    found = merge(
        [entry for entry, _ in pairs],
        lambda entry, _: tables[entry.offset],
        lambda entry, error: refused.append((entry.offset, str(error))),
        room_bytes,
    )
    assert sum(map(len, found)) == 6
    said = f"expected overlapping chunks of at most {room_bytes} bytes, found {4 * room_bytes // 3}"
    assert refused == [(3, said), (4, said)]


@given(st.lists(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 3)), min_size=1), max_size=8))
def test_messages_come_by_time_channel_and_place(spans: list[list[tuple[int, int]]]) -> None:
    pairs = chunks_of(spans)
    said = {entry.offset: messages for entry, messages in pairs}
    loaded = []

    def load(entry: ChunkEntry, floor_ns: int) -> MessageTable:
        assert floor_ns <= entry.start_ns
        loaded.append(entry.offset)
        return MessageTable.of(said[entry.offset])

    tables = merge([entry for entry, _ in pairs], load, never, 1 << 20)
    found = [m for table in tables for m in table]
    every = [m for _, messages in pairs for m in messages]
    assert found == sorted(every, key=lambda m: (m.log_time, m.channel_id, m.sequence))
    assert loaded == [entry.offset for entry, _ in pairs]


def test_a_chunk_that_waits_is_not_looked_at_again_for_every_other_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pairs = chunks_of([[(i, 1), (10**9, 1)] for i in range(600)])
    said = {entry.offset: messages for entry, messages in pairs}
    asked = []
    before = MessageTable.before
    monkeypatch.setattr(MessageTable, "before", lambda *given: asked.append(1) or before(*given))
    listed = [entry for entry, _ in pairs]
    tables = merge(listed, lambda e, _: MessageTable.of(said[e.offset]), never, 1 << 20)
    assert sum(map(len, tables)) == 1200
    assert len(asked) <= 3 * 600
