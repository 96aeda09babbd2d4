"""Copies of recordings: cut to the sample, other chunks and blocks, some topics; nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundtrace_codecs.annotations import Annotation
from groundtrace_codecs.copies import CUT, convert, cut, filter_topics
from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Label, StepEvent
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

START_NS = 1_700_000_000_123_456_789
SITE = Geometry((Sensor("g0", "G0", 1.0, 2.0),))
SEISMIC = Stream(
    "/seismic", tuple(Channel(f"G{i}", "seismic", "count") for i in range(2)), 4000 / 3
)
SLOW = Stream("/imu/waist", (Channel("az", "acceleration", "m/s2", "z"),), 100.0, "waist")
PHONE = Stream("/phone", (Channel("m", "acceleration_magnitude", "m/s2"),), 50.0, irregular=True)
PRESSURE = Stream("/baro", (Channel("p", "pressure", "Pa"),), 10.0)
STREAMS = {SEISMIC: "i32le", SLOW: "f64le", PHONE: "f32le", PRESSURE: "f64le"}
MARK = Annotation("a1", Label(START_NS + 2 * NS_PER_S, "note", note="here"), 5, 6)


def at(seconds: float) -> int:
    return START_NS + round(seconds * NS_PER_S)


def block_of(stream: Stream, first: int, count: int, seed: int = 0) -> SignalBlock:
    random = np.random.default_rng(seed)
    shape = (count, len(stream.channels))
    samples: Any = random.integers(-(2**20), 2**20, shape).astype(np.int32)
    times = None
    if stream.irregular:
        steps = random.integers(15_000_000, 25_000_000, count)
        times = START_NS + np.cumsum(steps)
    return SignalBlock(stream, START_NS, first, samples, times)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds with a gap, labels at and over the edges, an event, geometry, attachment."""
    path = tmp_path_factory.mktemp("copies") / "whole.mcap"
    with RecordingWriter(path) as writer:
        writer.set_geometry(SITE)
        for stream, sample_format in STREAMS.items():
            writer.add_stream(stream, sample_format)
        writer.write(block_of(SEISMIC, 0, 2000, 1))
        writer.write(block_of(SEISMIC, 2600, 2733, 2))
        for stream in (SLOW, PHONE, PRESSURE):
            writer.write(block_of(stream, 0, round(4 * stream.rate_hz), 3))
        spans = [Label(at(0.5), "walking", at(3.5)), Label(at(0), "count", at(4), value=8.0)]
        steps = [Label(at(t), "step") for t in (0.5, 1.0, 2.0, 3.0)]
        writer.add_labels([*spans, *steps, Label(at(1.2), "count", at(1.8), value=1.0)])
        writer.add_annotations([MARK])
        for t in (0.9, 1.5, 2.9999):
            writer.add_event(StepEvent(at(t), "step", "", "/imu/waist", "steps", 1.0))
        writer.add_metadata("session", {"site": "lab"})
        writer.add_attachment("station.xml", "application/xml", b"<station/>")
    return path


def samples_of(path: Path) -> dict[str, tuple[NDArray[np.int64], NDArray[Any]]]:
    """Return times and samples as stored of each stream."""
    with Recording.open(path) as recording:
        assert not recording.damage
        found: dict[str, list[SignalBlock]] = {s.topic: [] for s in recording.streams}
        for _, block in recording.blocks():
            found[block.topic].append(block)
    return {
        topic: (
            np.concatenate([b.sample_times() for b in blocks]),
            np.concatenate([b.samples for b in blocks]),
        )
        for topic, blocks in found.items()
        if blocks
    }


def assert_same_samples(one: Path, other: Path) -> None:
    first, second = samples_of(one), samples_of(other)
    assert first.keys() == second.keys()
    for topic, (times, samples) in first.items():
        np.testing.assert_array_equal(second[topic][0], times)
        np.testing.assert_array_equal(second[topic][1], samples)
        assert second[topic][1].dtype == samples.dtype


def messages_of(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    with McapFile.open(path) as file:
        return [
            (file.channels[m.channel_id].topic, *m[1:4], bytes(m.data)) for m in file.messages()
        ]


def cut_of(whole: Path, out: Path, start_ns: int, stop_ns: int) -> Path:
    with Recording.open(whole) as recording:
        cut(recording, out, start_ns, stop_ns, origin={"recording": "whole.mcap"}, force=True)
    return out


def test_a_cut_of_everything_has_every_byte_of_every_message(whole: Path, tmp_path: Path) -> None:
    copy = cut_of(whole, tmp_path / "all.mcap", at(0), at(60))
    assert messages_of(copy) == messages_of(whole)
    with McapFile.open(copy) as file:
        assert [(r.name, file.attachment(r)) for r in file.attachments][1:] == [
            ("station.xml", b"<station/>")
        ]
        assert {r.name: r.values for r in file.metadata} == {
            "session": {"site": "lab"},
            CUT: {"recording": "whole.mcap"},
        }


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 3_900_000_000), st.integers(1, 4_000_000_000))
def test_a_cut_has_the_samples_of_its_span_and_no_other(
    whole: Path, tmp_path: Path, begin: int, length: int
) -> None:
    start_ns, stop_ns = START_NS + begin, START_NS + begin + length
    expected = {}
    for topic, (times, samples) in samples_of(whole).items():
        inside = (times >= start_ns) & (times < stop_ns)
        if inside.any():
            expected[topic] = times[inside], samples[inside]
    found = samples_of(cut_of(whole, tmp_path / "part.mcap", start_ns, stop_ns))
    assert found.keys() == expected.keys()
    for topic, (times, samples) in expected.items():
        np.testing.assert_array_equal(found[topic][0], times)
        np.testing.assert_array_equal(found[topic][1], samples)


def test_two_cuts_that_meet_hold_what_the_whole_holds(whole: Path, tmp_path: Path) -> None:
    middle_ns = at(1.23456)
    first = samples_of(cut_of(whole, tmp_path / "1.mcap", at(0), middle_ns))
    second = samples_of(cut_of(whole, tmp_path / "2.mcap", middle_ns, at(9)))
    for topic, parts in samples_of(whole).items():
        for column, part in enumerate(parts):
            joined = np.concatenate([first[topic][column], second[topic][column]])
            np.testing.assert_array_equal(joined, part)


def test_labels_events_and_site_are_those_of_the_span(whole: Path, tmp_path: Path) -> None:
    copy = cut_of(whole, tmp_path / "part.mcap", at(1), at(3))
    with Recording.open(copy) as recording:
        assert recording.geometry == SITE
        assert recording.annotations == (MARK,)
        assert set(recording.labels) == {
            Label(at(1), "walking", at(3)),
            Label(at(1), "step"),
            Label(at(2), "step"),
            Label(at(1.2), "count", at(1.8), value=1.0),
        }
        counts = recording.topic_counts
    assert (counts["/groundtrace/steps"], counts["/tf_static"]) == (2, 1)


def test_a_span_without_samples_is_refused(whole: Path, tmp_path: Path) -> None:
    for start_ns, stop_ns in ((at(5), at(6)), (at(2), at(2)), (at(-2), at(-1))):
        with pytest.raises(CodecError, match="expected a span with samples"):
            cut_of(whole, tmp_path / "none.mcap", start_ns, stop_ns)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_converting_chunks_keeps_every_byte_of_every_message(
    whole: Path, tmp_path: Path, compression: str
) -> None:
    copy = tmp_path / "copy.mcap"
    convert(whole, copy, compression=compression, chunk_bytes=4096)
    assert messages_of(copy) == messages_of(whole)


@pytest.mark.parametrize("block_ms", [0.1, 7.0, 100.0, 333.0, 60_000.0])
def test_converting_blocks_keeps_every_sample_and_time(
    whole: Path, tmp_path: Path, block_ms: float
) -> None:
    copy, back = tmp_path / "copy.mcap", tmp_path / "back.mcap"
    convert(whole, copy, block_ns=round(block_ms * 1e6))
    assert_same_samples(whole, copy)
    convert(copy, back, block_ns=100_000_000)
    there = [m for m in messages_of(whole) if m[0] in ("/seismic", "/phone")]
    again = [m for m in messages_of(back) if m[0] in ("/seismic", "/phone")]
    assert sorted(again) == sorted(there)


def test_filtering_keeps_some_topics_byte_by_byte(whole: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copied = filter_topics(whole, copy, ["/seismic*", "/truth"], ["*/envelope"])
    assert messages_of(copy) == [m for m in messages_of(whole) if m[0] in ("/seismic", "/truth")]
    assert set(copied.messages) == {"/seismic", "/truth"}
    assert copied.left["/imu/waist"] == 40
    with Recording.open(copy) as recording:
        assert recording.geometry == SITE
        assert [s.topic for s in recording.streams] == ["/seismic"]


def test_a_pattern_that_fits_no_topic_is_refused(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(CodecError, match=r"expected a topic like 'imu'.*found /annotations, /baro"):
        filter_topics(whole, tmp_path / "copy.mcap", ["imu"])
    with pytest.raises(CodecError, match="found all dropped"):
        filter_topics(whole, tmp_path / "copy.mcap", (), ["*"])
    assert not list(tmp_path.iterdir())


def test_a_damaged_attachment_is_left_out_and_told(whole: Path, tmp_path: Path) -> None:
    hurt = tmp_path / "hurt.mcap"
    hurt.write_bytes(whole.read_bytes().replace(b"<station/>", b"<stetion/>"))
    copied = convert(hurt, tmp_path / "copy.mcap")
    (fault,) = copied.faults
    assert "hurt.mcap: attachment 'station.xml': expected CRC" in fault
    with McapFile.open(tmp_path / "copy.mcap", strict=True) as file:
        assert [r.name for r in file.attachments] == ["site.json"]
    assert messages_of(tmp_path / "copy.mcap") == messages_of(whole)


def test_a_torn_recording_is_copied_as_far_as_it_goes(whole: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[:-4000])
    copied = convert(torn, tmp_path / "copy.mcap")
    assert copied.damage
    with McapFile.open(torn) as file:
        readable = sum(1 for _ in file.messages())
    assert sum(copied.messages.values()) == readable > 0
    with McapFile.open(tmp_path / "copy.mcap", strict=True) as file:
        assert sum(1 for _ in file.messages()) == readable
