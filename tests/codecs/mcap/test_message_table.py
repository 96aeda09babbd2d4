"""Messages by column are the messages one by one, and their samples those of the plain decoder."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Label
from groundtrace_codecs.mcap.chunks import Message, MessageTable
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.waveform import decode_waveform, encode_waveform
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_700_000_000 * 10**9
STREAM = Stream("/s", (Channel("a", "seismic", "count"), Channel("b", "seismic", "count")), 2000.0)

messages = st.lists(
    st.builds(
        Message,
        channel_id=st.integers(0, 4),
        sequence=st.integers(0, 3),
        log_time=st.one_of(st.integers(0, 5), st.integers(0, 2**64 - 1)),
        publish_time=st.integers(0, 2**64 - 1),
        data=st.binary(max_size=6),
    ),
    max_size=12,
)


@settings(max_examples=examples(150), deadline=None)
@given(given=messages, time_ns=st.one_of(st.integers(-1, 6), st.integers(0, 2**64)))
def test_a_table_is_its_messages(given: list[Message], time_ns: int) -> None:
    table = MessageTable.of(given)
    assert list(table) == given
    assert [table[i] for i in range(len(table))] == given
    assert list(table[1:3]) == given[1:3]
    order = sorted(given, key=lambda m: (m.log_time, m.channel_id, m.sequence))
    assert list(table.in_order()) == order
    assert table.in_order().before(time_ns) == sum(m.log_time < time_ns for m in given)
    assert list(table.between(2, time_ns)) == [m for m in given if 2 <= m.log_time < time_ns]
    assert table.counts() == Counter(m.channel_id for m in given)
    assert list(table.of_channels([1, 3])) == [m for m in given if m.channel_id in (1, 3)]
    both = MessageTable.joined([table[:2], MessageTable.of(given[2:])])
    assert list(both) == given
    for whole in (table, both):
        sized = {
            i: data.tobytes()
            for rows, part in whole.by_size()
            for i, data in zip(rows, part, strict=True)
        }
        assert sized == {i: m.data for i, m in enumerate(given)}


def outcome(data: bytes | memoryview, count: int) -> str:
    """What a message decodes to, or why it does not."""
    try:
        start_ns, rate_hz, first, samples, times, stored = decode_waveform(data, count=count)
    except CodecError as error:
        return str(error)
    stamps = None if times is None else times.tolist()
    return f"{start_ns} {rate_hz} {first} {samples.tolist()} {stamps} {stored}"


@settings(max_examples=examples(200), deadline=None)
@given(
    count=st.integers(1, 40),
    place=st.integers(0, 10_000),
    value=st.integers(0, 255),
    step=st.sampled_from([1, 9]),
    irregular=st.booleans(),
)
def test_samples_left_where_they_lie_are_those_of_the_parser(
    count: int, place: int, value: int, step: int, irregular: bool
) -> None:
    samples = step * np.arange(2 * count, dtype="<i2").reshape(count, 2)
    times = START_NS + np.arange(count) * 500_000 if irregular else None
    sound = encode_waveform(SignalBlock(STREAM, START_NS, 7, samples, times))
    spoilt = bytearray(sound)
    spoilt[place % len(spoilt)] = value
    for data in (sound, bytes(spoilt), bytes(spoilt) + sound):
        assert outcome(memoryview(data), 2 * count) == outcome(data, 0)


def test_joined_blocks_are_those_of_the_messages_and_end_where_a_run_does(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    samples = np.random.default_rng(1).integers(-900, 900, (9000, 2)).astype("<i2")
    parts = [
        SignalBlock(STREAM, START_NS, first, samples[first:stop])
        for first, stop in ((0, 3200), (3600, 9000))
    ]
    write_recording(path, [(STREAM, "i16le", parts)])
    with Recording.open(path) as recording:
        single = [b for _, b in recording.blocks()]
        joined = [b for _, b in recording.blocks(joined_ns=10**9)]
    assert len(single) > 40
    assert len(joined) == 6  # five windows of 1 s, one of which has the gap
    for found in (single, joined):
        kept = np.concatenate([b.samples for b in found])
        assert np.array_equal(kept, np.concatenate([p.samples for p in parts]))
    assert [b.first for b in joined if b.first == 3600] == [3600]


def test_labels_lie_in_a_chunk_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "truth.mcap"
    samples = np.random.default_rng(1).integers(-900, 900, (400_000, 2)).astype("<i2")
    labels = [Label(START_NS + i * 10**9, "step") for i in (3, 1, 2)]
    block = SignalBlock(STREAM, START_NS, 0, samples)
    write_recording(path, [(STREAM, "i16le", [block])], labels=labels)
    with McapFile.open(path) as file:
        ids = {c.topic: c.id for c in file.channels.values()}
        held = [chunk.channel_ids for chunk in file._chunks]
        offsets = [chunk.offset for chunk in file._chunks]
    (truth,) = (i for topic, i in ids.items() if "truth" in topic)
    assert len(held) > 2
    assert held.count(frozenset({truth})) == 1
    assert offsets[held.index(frozenset({truth}))] == min(offsets)
    assert sum(truth in (found or ()) for found in held) == 1
    with Recording.open(path) as recording:
        assert [label.time_ns for label in recording.labels] == sorted(x.time_ns for x in labels)
