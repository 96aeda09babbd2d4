"""The source: order, joining of contiguous blocks, spans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from replay_blocks import START_NS, block_of, blocks_in, gaps_in, samples_in, stream_of, times_in

from groundtrace.pipeline.source import Source, joined
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Gap
from groundtrace_codecs.recording import LoggedBlock, Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator

MS = NS_PER_S // 1000
FAST, SLOW = stream_of(2, 1000.0, topic="/fast"), stream_of(1, 100.0, topic="/slow")


def pieces(stream, count: int, size: int, start: int = 0) -> list[SignalBlock]:
    return [
        block_of(stream, first, range(first, first + size)) for first in range(start, count, size)
    ]


class Blocks:
    """A recording in memory, its blocks logged at the time of their last sample."""

    def __init__(self, *blocks: SignalBlock) -> None:
        self.stamped = sorted(
            (LoggedBlock(b.last_ns, b) for b in blocks), key=lambda stamped: stamped.log_ns
        )
        self.streams = tuple(dict.fromkeys(b.stream for b in blocks))

    def blocks(self, *_: object) -> Iterator[LoggedBlock]:
        yield from self.stamped


def test_blocks_are_joined_to_windows_stream_by_stream():
    recording = Blocks(*pieces(FAST, 2000, 50), *pieces(SLOW, 200, 5))
    items = list(Source(recording, block_s=0.5))
    assert [item.topic for item in items] == ["/fast", "/slow"] * 4
    assert all(len(b) <= 500 for b in blocks_in(items))
    for stream, count in ((FAST, 2000), (SLOW, 200)):
        own = [i for i in items if i.topic == stream.topic]
        assert samples_in(own)[:, 0].tolist() == list(range(count))
        assert (np.diff(times_in(own)) == round(stream.period_ns)).all()


def test_without_a_block_length_blocks_come_as_recorded():
    recording = Blocks(*pieces(FAST, 200, 50), *pieces(SLOW, 20, 5))
    items = list(Source(recording, block_s=0))
    assert [(i.topic, i.first, len(i)) for i in items] == [
        (b.topic, b.first, len(b)) for _, b in recording.stamped
    ]


def test_windows_change_nothing_but_the_blocks():
    blocks = [*pieces(FAST, 1000, 50), *pieces(FAST, 3000, 50, start=2000)]
    results = [list(Source(Blocks(*blocks), block_s=s)) for s in (0, 0.07, 0.5, 100.0)]
    for items in results:
        assert gaps_in(items) == gaps_in(results[0])
        assert np.array_equal(times_in(items), times_in(results[0]))
        assert np.array_equal(samples_in(items), samples_in(results[0]))


def test_a_gap_stays_between_the_blocks_it_parts():
    blocks = [*pieces(FAST, 100, 50), *pieces(FAST, 500, 50, start=400)]
    items = list(Source(Blocks(*blocks), block_s=100.0))
    assert [type(i) for i in items] == [SignalBlock, Gap, SignalBlock]
    assert items[1] == Gap("/fast", START_NS + 100 * MS, START_NS + 400 * MS, "missing", 300)
    assert (items[2].anchor_ns, items[2].first) == (START_NS + 400 * MS, 0)


def test_only_what_continues_is_joined():
    first, after, other = block_of(FAST, 0, [1.0]), block_of(FAST, 1, [2.0]), block_of(FAST, 3, [4])
    moved = block_of(FAST, 4, [5.0], START_NS + 1)
    items = list(joined([first, after, other, moved]))
    assert [(i.first, i.samples[:, 0].tolist()) for i in items] == [
        (0, [1.0, 2.0]),
        (3, [4.0]),
        (4, [5.0]),
    ]
    assert items[1] is other


def test_joined_samples_keep_their_type_and_lie_channel_by_channel():
    planar = np.array([[1, 3], [2, 4]], np.int16)
    parts = [SignalBlock(FAST, START_NS, 2 * i, planar.T) for i in range(3)]
    (one,) = joined(parts)
    assert one.samples.dtype == np.int16
    assert one.samples.T.flags.c_contiguous
    assert one.samples.tolist() == [[1, 2], [3, 4]] * 3


def test_nothing_recorded_gives_nothing():
    assert list(Source(Blocks())) == []
    assert list(joined([])) == []


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "two.mcap"
    sources = [(FAST, "f32le", pieces(FAST, 3000, 50)), (SLOW, "f32le", pieces(SLOW, 300, 5))]
    write_recording(path, sources)
    with Recording.open(path) as opened:
        yield opened


def test_a_recording_comes_back_as_it_was_written(recording):
    items = list(Source(recording))
    for stream, count in ((FAST, 3000), (SLOW, 300)):
        own = [i for i in items if i.topic == stream.topic]
        assert samples_in(own)[:, 0].tolist() == list(range(count))
        assert np.array_equal(times_in(own), START_NS + np.arange(count) * round(stream.period_ns))
    assert [s.topic for s in Source(recording).streams] == ["/fast", "/slow"]


@pytest.mark.parametrize(("start", "stop"), [(0.5, 1.25), (None, 0.333), (2.995, None), (1.0, 1.0)])
def test_from_and_to_are_a_half_open_span_of_sample_times(recording, start, stop):
    start_ns = None if start is None else START_NS + round(start * NS_PER_S)
    stop_ns = None if stop is None else START_NS + round(stop * NS_PER_S)
    items = list(Source(recording, start_ns=start_ns, stop_ns=stop_ns))
    assert not gaps_in(items)
    for stream, count in ((FAST, 3000), (SLOW, 300)):
        times = START_NS + np.arange(count) * round(stream.period_ns)
        inside = (times >= (start_ns or 0)) & (times < (stop_ns or times[-1] + 1))
        own = [i for i in items if i.topic == stream.topic]
        assert np.array_equal(times_in(own), times[inside])


def test_topics_choose_streams(recording):
    source = Source(recording, topics={"/slow"})
    assert [s.topic for s in source.streams] == ["/slow"]
    assert {i.topic for i in source} == {"/slow"}
    with pytest.raises(CodecError, match=r"two\.mcap: expected a stream /none, found none"):
        list(Source(recording, topics={"/none"}))


def test_irregular_streams_are_announced_and_come_uniform():
    stream = stream_of(rate_hz=100.0, topic="/i", irregular=True)
    times = START_NS + np.arange(0, 500, 9) * MS
    block = SignalBlock(stream, START_NS, 0, np.ones((len(times), 1)), times)
    source = Source(Blocks(block))
    assert not source.streams[0].irregular
    (item,) = source
    assert item.stream == source.streams[0]
    assert item.times_ns is None
