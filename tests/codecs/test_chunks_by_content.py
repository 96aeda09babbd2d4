"""Waveforms, previews and everything else lie in chunks of their own, in copies too."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from groundtrace_codecs.annotations import Annotation
from groundtrace_codecs.copies import (
    convert,
    copy_readable,
    copy_with_annotations,
    cut,
    filter_topics,
)
from groundtrace_codecs.events import Label
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.merge import Part, merge
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
ACC = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz")
GYRO = tuple(Channel(f"gyro_{a}", "angular_velocity", "rad/s", a) for a in "xyz")
SEISMIC = Stream("/seismic", (Channel("G0", "seismic", "count"),), 20_000.0)
STREAMS = (SEISMIC, Stream("/foot", ACC + GYRO, 1000.0), Stream("/imu", ACC + GYRO, 100.0))
OTHERS = frozenset({"/imu", "/truth", "/annotations"})
WAVEFORMS = frozenset({"/seismic", "/foot"})
PREVIEWS = frozenset({"/seismic/envelope", "/foot/preview"})
LEVELS = {WAVEFORMS: 1, PREVIEWS: 3, OTHERS: 3}


def block_of(stream: Stream, seconds: int) -> SignalBlock:
    shape = (seconds * round(stream.rate_hz), len(stream.channels))
    samples = np.random.default_rng(1).normal(size=shape) * 300
    return SignalBlock(stream, START_NS, 0, samples.astype(np.float32))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("content") / "whole.mcap"
    labels = [Label(START_NS + i * NS_PER_S, "step") for i in range(12)]
    sources = [(stream, "f32le", [block_of(stream, 12)]) for stream in STREAMS]
    write_recording(path, sources, labels=labels)
    return path


def contents(path: Path) -> list[frozenset[str]]:
    """The topics of every chunk."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    topics = {i: channel.topic for i, channel in summary.channels.items()}
    return [
        frozenset(topics[i] for i in index.message_index_offsets) for index in summary.chunk_indexes
    ]


def kind_of(topics: frozenset[str]) -> frozenset[str]:
    """The kind of content that all topics of a chunk are of."""
    (kind,) = (kind for kind in (OTHERS, WAVEFORMS, PREVIEWS) if topics <= kind)
    return kind


def cut_short(source: Path, path: Path) -> None:
    with Recording.open(source) as recording:
        cut(recording, path, START_NS, START_NS + 8 * NS_PER_S, origin={})


def merged(source: Path, path: Path) -> None:
    with Recording.open(source) as recording:
        merge([Part(recording, "a")], path, [])


def mended(source: Path, path: Path) -> None:
    with McapFile.open(source) as file:
        copy_readable(file, path)


def annotated(source: Path, path: Path) -> None:
    copy_with_annotations(source, path, [Annotation("a", Label(START_NS, "note"), 1, 1)])


def test_chunks_of_a_recording_hold_one_kind_of_content_each(whole: Path) -> None:
    found = contents(whole)
    assert found[0] == {"/truth"}
    rounds = [found[i : i + 3] for i in range(1, len(found), 3)]
    assert len(rounds) > 1
    assert all(kinds == [{"/imu"}, WAVEFORMS, PREVIEWS] for kinds in rounds)


def test_each_kind_is_compressed_at_its_level(whole: Path) -> None:
    with whole.open("rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    for topics, chunk in zip(contents(whole), chunks, strict=True):
        level = LEVELS[kind_of(topics)]
        assert chunk.data == zstandard.compress(zstandard.decompress(chunk.data), level)


@pytest.mark.parametrize("copier", [convert, filter_topics, cut_short, merged, mended, annotated])
def test_copies_keep_the_kinds_apart(
    whole: Path, tmp_path: Path, copier: Callable[[Path, Path], object]
) -> None:
    copy = tmp_path / "copy.mcap"
    copier(whole, copy)
    found = contents(copy)
    assert [kind_of(topics) for topics in found[:3]] == [OTHERS, WAVEFORMS, PREVIEWS]
    assert {kind_of(topics) for topics in found} == {OTHERS, WAVEFORMS, PREVIEWS}
