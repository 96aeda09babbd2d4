"""A source that begins in the middle gives what one that reads all before gives, by the index."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from replay_blocks import START_NS, stream_of

import groundtrace.pipeline.source as sources
from groundtrace.pipeline.source import BRIDGE_S, Source, run_before, runs_before
from groundtrace_codecs.events import Gap
from groundtrace_codecs.mcap.chunks import ChunkReader
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock
from groundtrace_codecs.writer import RecordingWriter, write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

RATE, LENGTH, SECONDS = 2000.0, 100, 60.0
#: A rate whose period is no whole number of nanoseconds.
ODD = stream_of(1, 75.0, topic="/odd")
FAST = stream_of(2, RATE, topic="/fast")


def messages(
    stream, missing: Sequence[tuple[float, float]] = (), *, length: int = LENGTH, drift: float = 0.0
) -> Iterator[SignalBlock]:
    """Messages of one length, without those that overlap spans that are missing [s]."""
    rng = np.random.default_rng(1)
    for first in range(0, round(SECONDS * stream.rate_hz), length):
        at = first / stream.rate_hz
        if any(a < at + length / stream.rate_hz and at < b for a, b in missing):
            continue
        values = rng.integers(-9999, 9999, (length, len(stream.channels))).astype(np.int32)
        yield SignalBlock(stream, START_NS + round(at * drift * NS_PER_S), first, values)


def written(path: Path, *found: tuple[object, Iterator[SignalBlock]]) -> Path:
    """Write messages in chunks of half a second or so."""
    pieces = sorted((b for _, blocks in found for b in blocks), key=lambda b: b.last_ns)
    with RecordingWriter(path, chunk_bytes=4096) as writer:
        for stream, _ in found:
            writer.add_stream(stream, "i32le")
        for piece in pieces:
            writer.write(piece)
    return path


def given(path: Path, start_s: float, monkeypatch: pytest.MonkeyPatch, *, reading: bool) -> list:
    with Recording.open(path) as recording, monkeypatch.context() as patch:
        if reading:
            patch.setattr(sources, "runs_before", lambda *_: None)
        start_ns = START_NS + round(start_s * NS_PER_S)
        stop_ns = start_ns + 3 * NS_PER_S
        return list(Source(recording, start_ns=start_ns, stop_ns=stop_ns, in_whole=True))


def assert_same(one: list, other: list) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        if isinstance(a, Gap):
            assert a == b
        else:
            assert (a.topic, a.anchor_ns, a.first) == (b.topic, b.anchor_ns, b.first)
            assert np.array_equal(a.samples, b.samples)


STARTS = (3.0, 12.345, 20.4, 20.7, 21.0, 29.98, 30.02, 33.3331, 41.2, 55.0)
#: What is missing [s]: nothing, what is bridged, long gaps, and all of these.
MISSING: dict[str, tuple[tuple[float, float], ...]] = {
    "nothing": (),
    "bridged": ((10.02, 10.04), (30.0, 30.01)),
    "gaps": ((5.0, 5.5), (20.5, 20.9), (40.0, 49.0)),
    "both": ((5.0, 5.5), (7.0, 7.04), (20.5, 20.9), (28.0, 28.04), (29.99, 30.01)),
}


@pytest.mark.parametrize("missing", MISSING.values(), ids=MISSING)
def test_a_begin_by_the_index_gives_what_reading_all_before_gives(
    missing: Sequence[tuple[float, float]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = messages(ODD, missing, length=15)
    path = written(tmp_path / "a.mcap", (FAST, messages(FAST, missing)), (ODD, slow))
    known = 0
    for start_s in STARTS:
        read = given(path, start_s, monkeypatch, reading=True)
        assert_same(given(path, start_s, monkeypatch, reading=False), read)
        with Recording.open(path) as recording:
            topics = [s.topic for s in recording.streams]
            known += (
                runs_before(recording, topics, START_NS + round(start_s * NS_PER_S)) is not None
            )
    assert known >= len(STARTS) - 1


def test_few_chunks_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.mcap", (FAST, messages(FAST, MISSING["gaps"])))
    read: Counter[int] = Counter()
    records = ChunkReader.records

    def counted(self, entry):
        read[entry.offset] += 1
        return records(self, entry)

    monkeypatch.setattr(ChunkReader, "records", counted)
    given(path, 39.0, monkeypatch, reading=False)
    by_index = len(read)
    read.clear()
    given(path, 39.0, monkeypatch, reading=True)
    assert by_index < len(read)


@pytest.mark.parametrize("case", ["drift", "step"])
def test_what_the_index_does_not_tell_is_read(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = list(messages(FAST, drift=1e-3))
    if case == "step":
        blocks = [
            b if b.first < 40000 else SignalBlock(FAST, START_NS + NS_PER_S, b.first, b.samples)
            for b in messages(FAST)
        ]
    path = written(tmp_path / "a.mcap", (FAST, iter(blocks)))
    for start_s in (15.0, 31.7, 50.0):
        with Recording.open(path) as recording:
            start_ns = START_NS + round(start_s * NS_PER_S)
            known = runs_before(recording, ["/fast"], start_ns)
            assert (known is None) == (case == "drift" or start_s > 20)
        read = given(path, start_s, monkeypatch, reading=True)
        assert_same(given(path, start_s, monkeypatch, reading=False), read)


def test_a_stream_of_times_is_read_from_its_begin(tmp_path: Path) -> None:
    stream = stream_of(1, 50.0, topic="/i", irregular=True)
    times = START_NS + np.arange(0, 30_000_000_000, 20_000_000, np.int64)
    blocks = [
        SignalBlock(stream, int(t[0]), 0, np.ones((len(t), 1)), t) for t in np.split(times, 300)
    ]
    path = tmp_path / "i.mcap"
    write_recording(path, [(stream, "f64le", blocks)])
    with Recording.open(path) as recording:
        assert runs_before(recording, ["/i"], START_NS + 20 * NS_PER_S) is None


def test_messages_of_other_lengths_tell_nothing(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", (FAST, messages(FAST)))
    with Recording.open(path) as recording:
        counted = recording.counted("/fast")
        assert counted is not None
        start_ns = START_NS + 30 * NS_PER_S
        assert run_before(counted, start_ns, BRIDGE_S) is not None
        longer = replace(counted, before=counted.before - counted.before // 100)
        assert run_before(longer, start_ns, BRIDGE_S) is None
