"""The writer of MCAP files: byte for byte as mcap's own, and chunks of one kind of content each."""

from __future__ import annotations

import io
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import lz4.frame
import pytest
import zstandard
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer
from mcap_files import Row, opened, oracle, read, records

from groundtrace_codecs.mcap.writer import McapWriter

if TYPE_CHECKING:
    from collections.abc import Sequence

COMPRESSIONS = ("zstd", "lz4", "none")
KINDS = (3, 1, 3)
TIMES = st.one_of(st.integers(0, 1000), st.integers(0, (1 << 64) - 1))


class Channel(NamedTuple):
    topic: str
    schema: tuple[str, str, bytes] | None
    metadata: dict[str, str]
    kind: int


class Said(NamedTuple):
    """A message on one of the channels that are there by then."""

    channel: int
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class Attached(NamedTuple):
    made_ns: int
    log_ns: int
    name: str
    media_type: str
    data: bytes


class Noted(NamedTuple):
    name: str
    values: dict[str, str]


class Flush(NamedTuple):
    pass


Step = Channel | Said | Attached | Noted | Flush

TEXTS = st.text(max_size=5)
MAPS = st.dictionaries(TEXTS, TEXTS, max_size=3)
SCHEMAS = st.sampled_from(
    [None, ("a", "raw", b""), ("b", "ros2msg", b"float64 x"), ("c", "protobuf", bytes(500))]
)
SIZES = st.one_of(st.integers(0, 40), st.integers(0, 3000))
SAID = st.builds(
    Said,
    st.integers(0, 20),
    TIMES,
    TIMES,
    st.integers(0, (1 << 32) - 1),
    st.tuples(st.binary(min_size=1, max_size=9), SIZES).map(lambda x: (x[0] * x[1])[: x[1]]),
)
STEPS = st.lists(
    st.one_of(
        SAID,
        SAID,
        SAID,
        st.builds(Channel, TEXTS, SCHEMAS, MAPS, st.integers(0, len(KINDS) - 1)),
        st.builds(Attached, TIMES, TIMES, TEXTS, TEXTS, st.binary(max_size=50)),
        st.builds(Noted, TEXTS, MAPS),
        st.builds(Flush),
    ),
    max_size=40,
)
LAYOUTS = st.tuples(st.sampled_from(COMPRESSIONS), st.integers(0, 5000))


class Theirs:
    """mcap's writer, called as ours is."""

    def __init__(self, sink: io.BytesIO, compression: str, chunk_bytes: int) -> None:
        self._writer = Writer(
            sink,
            chunk_size=chunk_bytes,
            compression=CompressionType[compression.upper()],
            enable_data_crcs=True,
        )
        self._writer.start("profile", "library")
        self.add_schema = self._writer.register_schema
        self.add_message = self._writer.add_message
        self.add_attachment = self._writer.add_attachment
        self.add_metadata = self._writer.add_metadata
        self.flush = self._writer.flush
        self.finish = self._writer.finish

    def add_channel(
        self, topic: str, encoding: str, schema_id: int, metadata: dict[str, str], _kind: int
    ) -> int:
        return self._writer.register_channel(topic, encoding, schema_id, metadata)


def perform(writer: McapWriter | Theirs, steps: Sequence[Step]) -> list[Row]:
    """Write a file; return its messages in the order of a replay."""
    schemas: dict[tuple[str, str, bytes], int] = {}
    channels, rows = list[int](), list[Row]()
    for step in steps:
        if isinstance(step, Channel):
            if step.schema is not None and step.schema not in schemas:
                schemas[step.schema] = writer.add_schema(*step.schema)
            schema_id = 0 if step.schema is None else schemas[step.schema]
            made = (step.topic, "raw", schema_id, step.metadata, step.kind)
            channels.append(writer.add_channel(*made))
        elif isinstance(step, Said) and channels:
            channel_id = channels[step.channel % len(channels)]
            writer.add_message(channel_id, step.log_ns, step.data, step.publish_ns, step.sequence)
            rows.append((channel_id, step.sequence, step.log_ns, step.publish_ns, step.data))
        elif isinstance(step, Attached):
            writer.add_attachment(*step)
        elif isinstance(step, Noted):
            writer.add_metadata(*step)
        elif isinstance(step, Flush):
            writer.flush()
    writer.finish()
    return sorted(rows, key=in_replay)


def in_replay(row: Row) -> tuple[Any, ...]:
    """What orders messages; equal ones may come in any order."""
    return (row[2], row[0], row[1], row[3:])


def written(steps: Sequence[Step], layout: tuple[str, int]) -> tuple[bytes, list[Row]]:
    sink = io.BytesIO()
    compression, chunk_bytes = layout
    writer = McapWriter(sink, compression, KINDS, chunk_bytes, "profile", "library")
    rows = perform(writer, steps)
    return sink.getvalue(), rows


def chunks_of(data: bytes) -> list[tuple[int, Chunk]]:
    """The chunks of a whole file and where each of them ends, as the mcap package reads them."""
    summary = make_reader(io.BytesIO(data)).get_summary()
    ends = [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]
    found = StreamReader(io.BytesIO(data), emit_chunks=True).records
    return list(zip(ends, (r for r in found if isinstance(r, Chunk)), strict=True))


@given(steps=STEPS, layout=LAYOUTS)
@example([], ("zstd", 100))
@example(  # the schema makes the chunk too long, before the channel
    [
        Channel("", None, {}, 0),
        Said(0, 0, 0, 0, b""),
        Channel("", ("c", "protobuf", bytes(500)), {}, 0),
    ],
    ("zstd", 118),
)
@example([Channel("a", None, {}, 0), Said(0, 5, 4, 3, b"data")], ("none", 0))
def test_one_kind_of_content_is_written_byte_for_byte_as_mcap_writes_it(
    steps: list[Step], layout: tuple[str, int]
) -> None:
    ours, theirs = io.BytesIO(), io.BytesIO()
    one = [s._replace(kind=0) if isinstance(s, Channel) else s for s in steps]
    perform(McapWriter(ours, layout[0], KINDS[:1], layout[1], "profile", "library"), one)
    perform(Theirs(theirs, *layout), one)
    assert ours.getvalue() == theirs.getvalue()


@given(steps=STEPS, layout=LAYOUTS)
def test_any_mix_of_kinds_reads_back_as_it_was(steps: list[Step], layout: tuple[str, int]) -> None:
    data, rows = written(steps, layout)
    seeking = make_reader(io.BytesIO(data), validate_crcs=True).iter_messages()
    assert sorted(((*key(m), m.data) for _, _, m in seeking), key=in_replay) == rows
    front = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    assert len(list(front.iter_messages())) == len(rows)
    with opened(data, strict=True) as file:
        assert file.indexed
        assert sorted(read(file), key=in_replay) == rows
        made = [s for s in steps if isinstance(s, Channel)]
        assert [(c.topic, c.metadata) for _, c in sorted(file.channels.items())] == [
            (s.topic, s.metadata) for s in made
        ]
        for step, (_, channel) in zip(made, sorted(file.channels.items()), strict=True):
            schema = file.schemas.get(channel.schema_id)
            found = schema and (schema.name, schema.encoding, schema.data)
            assert found == step.schema
        attached = [s for s in steps if isinstance(s, Attached)]
        assert [file.attachment(ref) for ref in file.attachments] == [a.data for a in attached]
        noted = [s for s in steps if isinstance(s, Noted)]
        assert [(m.name, m.values) for m in file.metadata] == noted


def key(message: Message) -> tuple[int, int, int, int]:
    return (message.channel_id, message.sequence, message.log_time, message.publish_time)


@given(steps=STEPS, layout=LAYOUTS, cut=st.floats(0, 1))
def test_a_file_cut_at_any_byte_gives_the_messages_of_every_whole_chunk(
    steps: list[Step], layout: tuple[str, int], cut: float
) -> None:
    data, _ = written(steps, layout)
    header = next(records(data)).end
    stop = header + round(cut * (len(data) - header))
    whole = [
        (*key(r), r.data)
        for end, chunk in chunks_of(data)
        if end <= stop
        for r in breakup_chunk(chunk, validate_crc=True)
        if isinstance(r, Message)
    ]
    assert sorted(read(opened(data[:stop])), key=in_replay) == sorted(whole, key=in_replay)


@given(steps=STEPS, layout=LAYOUTS)
def test_a_chunk_holds_one_kind_at_its_level_and_ends_where_it_is_too_long(
    steps: list[Step], layout: tuple[str, int]
) -> None:
    data, _ = written(steps, layout)
    kinds = [s.kind for s in steps if isinstance(s, Channel)]
    for _, chunk in chunks_of(data):
        inside = breakup_chunk(chunk)
        said = [r for r in inside if isinstance(r, Message)]
        (kind,) = {kinds[m.channel_id - 1] for m in said}
        assert chunk.data == packed(unpacked(chunk), layout[0], KINDS[kind])
        if len(said) > 1 and inside[-1] is said[-1]:
            assert chunk.uncompressed_size - 31 - len(said[-1].data) <= layout[1]


def unpacked(chunk: Chunk) -> bytes:
    if chunk.compression == "zstd":
        return zstandard.decompress(chunk.data)
    return lz4.frame.decompress(chunk.data) if chunk.compression == "lz4" else chunk.data


def packed(data: bytes, compression: str, level: int) -> bytes:
    if compression == "zstd":
        return zstandard.compress(data, level)
    return lz4.frame.compress(data) if compression == "lz4" else data


def test_chunks_of_one_span_end_together_in_the_order_of_their_kinds() -> None:
    channels = [Channel(f"/{kind}", None, {}, kind) for kind in (2, 0, 1)]
    said = [Said(i % 3, i, i, i, bytes(400 if i % 3 else 10)) for i in range(30)]
    data, _ = written([*channels, *said], ("zstd", 2000))
    spans = [
        (sorted(i.message_index_offsets), i.message_start_time, i.message_end_time)
        for i in make_reader(io.BytesIO(data)).get_summary().chunk_indexes
    ]
    rounds = [spans[i : i + 3] for i in range(0, len(spans), 3)]
    assert len(rounds) > 1
    for found in rounds:
        assert [ids for ids, _, _ in found] == [[2], [3], [1]]
    ends = [max(end for _, _, end in found) for found in rounds]
    starts = [min(start for _, start, _ in found) for found in rounds]
    assert starts == [0, *(end + 1 for end in ends[:-1])]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_what_is_defined_and_never_used_is_in_the_summary(compression: str) -> None:
    sink = io.BytesIO()
    writer = McapWriter(sink, compression, KINDS, 1000, "", "")
    schema_id = writer.add_schema("unused", "raw", b"text")
    writer.add_channel("/silent", "raw", writer.add_schema("used", "raw", b""), {"a": "b"}, 1)
    writer.finish()
    with opened(sink.getvalue(), strict=True) as file:
        assert file.indexed
        assert file.schemas[schema_id].data == b"text"
        assert [c.topic for c in file.channels.values()] == ["/silent"]
        assert list(file.messages()) == []


def test_a_message_that_cannot_be_written_leaves_no_trace() -> None:
    sink = io.BytesIO()
    writer = McapWriter(sink, "zstd", KINDS, 1000, "", "")
    channel_id = writer.add_channel("/a", "raw", 0, {}, 0)
    writer.add_message(channel_id, 1, b"good", 1, 0)
    with pytest.raises(struct.error):
        writer.add_message(channel_id, -1, b"bad", 1, 0)
    writer.finish()
    assert oracle(sink.getvalue()) == [(channel_id, 0, 1, 1, b"good")]
