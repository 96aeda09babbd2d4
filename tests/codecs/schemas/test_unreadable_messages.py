"""A message that is not what its schema says costs itself, not the recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from sweeps import examples

from groundtrace_codecs import Channel, CodecError, SignalBlock, Stream
from groundtrace_codecs.errors import SchemaError
from groundtrace_codecs.mcap.chunks import Message, MessageTable
from groundtrace_codecs.recording import LoggedBlock, Recording, readable
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

STREAM = Stream("/seismic", (Channel("G1", "seismic", "count"),), 1000.0)


def broken_copy(source: Path, target: Path, which: int) -> None:
    """Copy a recording, replacing the payload of one waveform message by junk."""
    with source.open("rb") as read, target.open("wb") as written:
        writer = Writer(written)
        writer.start()
        ids: dict[int, int] = {}
        count = 0
        for schema, channel, message in make_reader(read).iter_messages():
            assert schema is not None
            if channel.id not in ids:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, made, channel.metadata
                )
            data = message.data
            if schema.name == "groundtrace.WaveformBlock":
                data = b"junk" if count == which else data
                count += 1
            writer.add_message(
                ids[channel.id],
                message.log_time,
                data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()


@pytest.mark.parametrize("which", [0, 7])
def test_one_unreadable_message_is_left_out_and_said(which: int, tmp_path: Path) -> None:
    samples = np.arange(1000, dtype=np.int16)[:, None]
    block = SignalBlock(STREAM, 0, 0, samples)
    write_recording(tmp_path / "whole.mcap", [(STREAM, "i16le", [block])])
    broken_copy(tmp_path / "whole.mcap", tmp_path / "broken.mcap", which)

    with Recording.open(tmp_path / "broken.mcap") as recording:
        found = np.concatenate([b.samples for _, b in recording.blocks()])[:, 0]
        damage = recording.damage

    expected = np.delete(np.arange(1000), np.arange(which * 100, which * 100 + 100))
    assert np.array_equal(found, expected)
    assert [d.messages for d in damage] == [1]
    assert "/seismic" in damage[0].reason


def test_a_strict_reader_stops_at_an_unreadable_message(tmp_path: Path) -> None:
    samples = np.arange(1000, dtype=np.int16)[:, None]
    write_recording(
        tmp_path / "whole.mcap", [(STREAM, "i16le", [SignalBlock(STREAM, 0, 0, samples)])]
    )
    broken_copy(tmp_path / "whole.mcap", tmp_path / "broken.mcap", 3)

    with (
        Recording.open(tmp_path / "broken.mcap", strict=True) as recording,
        pytest.raises(CodecError, match="/seismic"),
    ):
        list(recording.blocks())


FOREIGN = [
    ("protobuf", "protobuf", "groundtrace.WaveformBlock"),
    ("protobuf", "protobuf", "foxglove.LocationFix"),
    ("protobuf", "protobuf", "foxglove.LocationFixes"),
    ("protobuf", "protobuf", "some.Thing"),
    ("ros2msg", "cdr", "sensor_msgs/msg/Imu"),
    ("ros2msg", "cdr", "std_msgs/msg/Float64"),
    ("ros2idl", "cdr", "some/Thing"),
    ("jsonschema", "json", "Thing"),
    ("", "json", ""),
]
SCHEMAS = [
    b"",
    b"\xff\xfe\x00",
    b"float64 data",
    b"float64[",
    b"\x0a\x7fjunk",
    b"Thing thing\n" * 3,
]


@pytest.mark.parametrize("schema", SCHEMAS)
def test_a_foreign_channel_nobody_can_read_is_listed_beside_what_can_be(
    schema: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for i, (encoding, message_encoding, name) in enumerate(FOREIGN):
            schema_id = writer.register_schema(name, encoding, schema)
            channel = writer.register_channel(f"/t{i}", message_encoding, schema_id)
            for k in range(4):
                writer.add_message(channel, k, b"\xff\xff junk", k)
        writer.finish()
    with Recording.open(path) as recording:
        list(recording.blocks())
        seen = {s.topic for s in recording.streams} | {o.topic for o in recording.others}
        # ours by name, though nothing of it can be decoded
        assert seen >= {f"/t{i}" for i in range(1, len(FOREIGN))}


class Refusing:
    """A reader to which messages that begin with x are unreadable; it counts how often it tries."""

    streams = (STREAM,)

    def __init__(self) -> None:
        self.tries = 0

    def blocks(self, messages: MessageTable, *, joined: bool = True) -> Iterator[LoggedBlock]:  # noqa: ARG002
        self.tries += 1
        if any(bytes(m.data[:1]) in {b"", b"x"} for m in messages):
            raise SchemaError("expected a message, found junk")
        block = SignalBlock(STREAM, 0, 0, np.zeros((len(messages), 1)))
        yield LoggedBlock(messages[-1].log_time, block)


@pytest.mark.parametrize("payload", [b"", b"x", b"xyz"])
def test_the_same_unreadable_message_is_tried_a_few_times_however_often_it_comes(
    payload: bytes,
) -> None:
    payloads = [b"good"] * 3 + [payload] * 100_000 + [b"good"] * 2
    table = MessageTable.of(Message(1, k, k, k, memoryview(p)) for k, p in enumerate(payloads))
    reader, left_out = Refusing(), list[int]()
    found = readable(reader, table, lambda m, _: left_out.append(m.sequence))
    assert sum(len(block) for _, block in found) == 5
    assert left_out == list(range(3, 100_003))
    assert reader.tries < 100


@settings(max_examples=examples(50))
@given(st.lists(st.sampled_from([b"", b"a", b"b", b"aa", b"c" * 300]), min_size=1, max_size=40))
def test_messages_alike_are_those_with_the_payload_of_the_first(payloads: list[bytes]) -> None:
    table = MessageTable.of(Message(1, 0, 0, 0, memoryview(p)) for p in payloads)
    run = next((k for k, p in enumerate(payloads) if p != payloads[0]), len(payloads))
    assert table.same_payload_count() == (run if len(payloads[0]) <= 256 else 1)
