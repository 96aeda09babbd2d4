"""Chunks are merged in the order of a replay, at a cost that follows what is due."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from groundtrace_codecs.mcap.chunks import ChunkEntry, Message, MessageTable
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


@given(st.lists(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 3)), min_size=1), max_size=8))
def test_messages_come_by_time_channel_and_place(spans: list[list[tuple[int, int]]]) -> None:
    pairs = chunks_of(spans)
    said = {entry.offset: messages for entry, messages in pairs}
    loaded = []

    def load(entry: ChunkEntry, floor_ns: int) -> MessageTable:
        assert floor_ns <= entry.start_ns
        loaded.append(entry.offset)
        return MessageTable.of(said[entry.offset])

    found = [m for table in merge([entry for entry, _ in pairs], load) for m in table]
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
    tables = merge([entry for entry, _ in pairs], lambda e, _: MessageTable.of(said[e.offset]))
    assert sum(map(len, tables)) == 1200
    assert len(asked) <= 3 * 600
