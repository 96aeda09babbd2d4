"""What the writer writes the recording reads: streams, gaps, windows, geometry, labels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Label
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.mcap.reader import McapFile
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.ros2 import CdrDecoder, parse_ros2msg
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter, write_recording

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

START_NS = 1_700_000_000_123_456_789
SEISMIC = Stream(
    "/seismic",
    tuple(Channel(f"G{i}", "ground_velocity", "m/s", "z", 1e-9 * (i + 1)) for i in range(3)),
    20000.0,
)
ACC = tuple(Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz")
GYRO = tuple(Channel(f"gyro_{a}", "angular_velocity", "rad/s", a) for a in "xyz")
MAG = tuple(Channel(f"mag_{a}", "magnetic_field", "T", a) for a in "xyz")
IMU = Stream("/imu/waist", (*GYRO, *ACC), 100.0, "waist")
FAST = Stream("/imu/foot", (*ACC, *GYRO), 1000.0, "foot")
PHONE = Stream("/phone/acc", ACC, 49.7, "phone", irregular=True)
STREAMS = {
    "seismic": (SEISMIC, "i32le", "<i4"),
    "short": (replace(SEISMIC, topic="/short", rate_hz=333.3), "i16le", "<i2"),
    "slow": (replace(SEISMIC, topic="/slow", rate_hz=7.0), "f64le", "<f8"),
    "imu": (IMU, "f32le", "<f8"),
    "fast": (FAST, "f32le", "<f4"),
    "acc": (Stream("/acc", ACC, 97.0, "trunk"), "f32le", "<f4"),
    "mag": (Stream("/mag", MAG, 285.714, "foot"), "f32le", "<f8"),
    "phone": (PHONE, "f32le", "<f4"),
    "phone imu": (replace(IMU, topic="/phone/imu", irregular=True), "f32le", "<f8"),
    "pressure": (Stream("/p", (Channel("p", "pressure", "Pa"),), 10.0), "f32le", "<f8"),
    "air": (Stream("/t", (Channel("t", "temperature", "degC"),), 1.0), "f32le", "<f8"),
    "fix": (
        Stream(
            "/fix",
            (
                Channel("lat", "latitude", "deg"),
                Channel("lon", "longitude", "deg"),
                Channel("alt", "altitude", "m"),
            ),
            1.0,
            irregular=True,
        ),
        "f32le",
        "<f8",
    ),
}


def blocks(stream: Stream, count: int, size: int, dtype: str, first: int = 0) -> list[SignalBlock]:
    """Samples that depend on their index alone, cut into blocks of ``size``."""
    index = np.arange(first, first + count)[:, None] * len(stream.channels)
    samples = ((index + np.arange(len(stream.channels))) % 30000 - 15000).astype(dtype)
    times = None
    if stream.irregular:
        jitter = np.arange(count) * 7919 % 1_000_003
        times = START_NS + (np.arange(count) * stream.period_ns).astype(np.int64) + jitter
    whole = SignalBlock(stream, START_NS, first, samples, times)
    return [whole.slice(i, min(i + size, count)) for i in range(0, count, size)]


def samples_of(found: list[SignalBlock]) -> tuple[np.ndarray, np.ndarray]:
    times = np.concatenate([b.sample_times() for b in found])
    return times, np.concatenate([b.samples for b in found])


def read(path: Path, topic: str, **bounds: int) -> list[SignalBlock]:
    with Recording.open(path) as recording:
        return [b for _, b in recording.blocks({topic}, **bounds)]


def content(path: Path) -> list[Any]:
    with McapFile.open(path) as file:
        topics = {i: c.topic for i, c in file.channels.items()}
        return [(topics[m.channel_id], *m[1:4], bytes(m.data)) for m in file.messages()]


@pytest.mark.parametrize("name", list(STREAMS))
@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(size=st.integers(1, 1300), seconds=st.floats(0.02, 1.2))
def test_a_stream_comes_back_as_it_was_whatever_its_blocks(
    tmp_path: Path, name: str, size: int, seconds: float
) -> None:
    stream, sample_format, dtype = STREAMS[name]
    given_blocks = blocks(stream, max(1, round(seconds * stream.rate_hz)), size, dtype)
    path = tmp_path / "rec.mcap"
    write_recording(path, [(stream, sample_format, given_blocks)], force=True)
    with Recording.open(path) as recording:
        assert recording.streams == (stream,)
        assert recording.others == ()
        found = [b for _, b in recording.blocks()]
        assert recording.start_ns == given_blocks[0].start_ns
        assert recording.end_ns == given_blocks[-1].last_ns
        assert recording.damage == ()
    times, samples = samples_of(found)
    expected_times, expected = samples_of(given_blocks)
    assert np.array_equal(times, expected_times)
    assert np.array_equal(samples, expected)
    if not stream.irregular:
        assert {b.anchor_ns for b in found} == {START_NS}
        assert [b.first for b in found] == np.cumsum([0, *map(len, found[:-1])]).tolist()


@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(size=st.integers(1, 3000), first=st.integers(0, 5000))
def test_the_file_does_not_depend_on_how_the_samples_came(
    tmp_path: Path, size: int, first: int
) -> None:
    paths = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    for path, length in zip(paths, (10**6, size), strict=True):
        with RecordingWriter(path, force=True) as writer:
            for name in ("seismic", "fast", "imu"):
                stream, sample_format, dtype = STREAMS[name]
                writer.add_stream(stream, sample_format)
                count = round(0.21 * stream.rate_hz)
                for block in blocks(stream, count, length, dtype, first):
                    writer.write(block)
    assert content(paths[0]) == content(paths[1])


def test_messages_hold_a_tenth_of_a_second_and_are_logged_at_their_last_sample(
    tmp_path: Path,
) -> None:
    path = tmp_path / "rec.mcap"
    write_recording(path, [(SEISMIC, "i32le", blocks(SEISMIC, 5000, 170, "<i4"))])
    with Recording.open(path) as recording:
        stamped = list(recording.blocks())
    assert [len(b) for _, b in stamped] == [2000, 2000, 1000]
    assert [t for t, _ in stamped] == [b.last_ns for _, b in stamped]
    raw = [m for m in content(path) if m[0] == "/seismic"]
    assert [m[3] for m in raw] == [b.start_ns for _, b in stamped]


def test_messages_of_many_channels_are_shorter_than_a_tenth_of_a_second(tmp_path: Path) -> None:
    path = tmp_path / "wide.mcap"
    channels = tuple(Channel(f"G{i}", "seismic", "count") for i in range(5000))
    wide = Stream("/wide", channels, 20000.0)
    samples = np.arange(500 * 5000, dtype="<i4").reshape(500, 5000)
    write_recording(path, [(wide, "i32le", [SignalBlock(wide, START_NS, 0, samples)])])
    with Recording.open(path) as recording:
        found = [block for _, block in recording.blocks()]
    assert max(block.samples.nbytes for block in found) <= 4 << 20
    np.testing.assert_array_equal(np.concatenate([block.samples for block in found]), samples)


def test_a_gap_stays_exact(tmp_path: Path) -> None:
    path = tmp_path / "gap.mcap"
    for stream, dtype in ((SEISMIC, "<i4"), (IMU, "<f8")):
        parts = [*blocks(stream, 70, 33, dtype), *blocks(stream, 50, 50, dtype, first=1234)]
        write_recording(path, [(stream, "i32le", parts)], force=True)
        found = read(path, stream.topic)
        indices = np.concatenate([np.arange(b.first, b.first + len(b)) for b in found])
        assert indices.tolist() == [*range(70), *range(1234, 1284)]
        assert {b.anchor_ns for b in found} == {START_NS}
        assert np.array_equal(samples_of(found)[1], samples_of(parts)[1])


def test_streams_come_in_one_order_of_log_time(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    sources = [(s, f, blocks(s, round(2 * s.rate_hz), 211, d)) for s, f, d in STREAMS.values()]
    write_recording(path, sources)
    with Recording.open(path) as recording:
        assert [s.topic for s in recording.streams] == [s.topic for s, _, _ in sources]
        logs = [log_ns for log_ns, _ in recording.blocks()]
        assert recording.topic_counts["/seismic"] == 20
        assert recording.topic_counts["/seismic/envelope"] == 200
        assert recording.topic_counts["/imu/foot/preview"] == 200
        assert recording.metadata["recording"]["start_ns"] == str(START_NS)
    assert logs == sorted(logs)


@settings(max_examples=25, deadline=None)
@given(low=st.integers(-100, 2100), length=st.integers(1, 900))
def test_a_window_holds_the_samples_in_it(
    whole: tuple[Path, dict[str, tuple[np.ndarray, np.ndarray]]], low: int, length: int
) -> None:
    path, expected = whole
    start_ns, stop_ns = START_NS + low * 10**6 + 17, START_NS + (low + length) * 10**6
    with Recording.open(path) as recording:
        found: dict[str, list[SignalBlock]] = {}
        for _, block in recording.blocks(None, start_ns, stop_ns):
            found.setdefault(block.topic, []).append(block)
    for topic, (times, samples) in expected.items():
        inside = (times >= start_ns) & (times < stop_ns)
        if not inside.any():
            assert topic not in found
            continue
        got_times, got = samples_of(found[topic])
        assert np.array_equal(got_times, times[inside])
        assert np.array_equal(got, samples[inside])


@pytest.fixture(scope="module")
def whole(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, dict[str, tuple[np.ndarray, np.ndarray]]]:
    path = tmp_path_factory.mktemp("whole") / "rec.mcap"
    made = [(s, f, blocks(s, round(2 * s.rate_hz), 500, d)) for s, f, d in STREAMS.values()]
    write_recording(path, made)
    return path, {s.topic: samples_of(b) for s, _, b in made}


def test_geometry_truth_metadata_and_attachments_come_back(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    sensors = tuple(Sensor(f"geophone {i}", f"G{i}", float(i), 2.0, 0.5) for i in range(3))
    site = Geometry(sensors, ((0, 0), (4, 0), (4, 4)), (1.0, 1.0), (), Medium(0.2, 1500.0))
    labels = (
        Label(START_NS + 5, "step", label="left", author="me", note="ü"),
        Label(START_NS + 5, "walking", end_ns=START_NS + 10**9),
        Label(START_NS + 7, "waypoint", x_m=1.0, y_m=0.0),
        Label(START_NS + 9, "pick", channel="G1", value=0.0),
    )
    with RecordingWriter(path, compression="lz4") as writer:
        writer.set_geometry(site)
        writer.add_stream(SEISMIC, "i32le")
        writer.add_metadata("session", {"site": "lab"})
        writer.add_attachment("station.xml", "application/xml", b"<a/>")
        for block in blocks(SEISMIC, 2000, 400, "<i4"):
            writer.write(block)
        writer.add_labels(labels)
        writer.add_labels((Label(START_NS, "missed"),), "/annotations")
    with Recording.open(path) as recording:
        assert recording.geometry == site
        assert recording.labels == labels
        assert recording.metadata == {"session": {"site": "lab"}}
        assert [ref.name for ref in recording.file.attachments] == ["station.xml", "site.json"]
        assert recording.others == ()
        assert recording.file.start_ns >= START_NS
        positions = [c.position_m for c in recording.streams[0].channels]
        (block, *_) = (b for _, b in recording.blocks())
    assert positions == [(float(i), 2.0, 0.5) for i in range(3)]
    assert [c.position_m for c in block.stream.channels] == positions


def test_previews_hold_extremes_and_means_of_10_ms(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    sources = [
        (s, f, blocks(s, round(0.1 * s.rate_hz), 77, d))
        for s, f, d in (STREAMS["seismic"], STREAMS["fast"])
    ]
    write_recording(path, sources)
    with McapFile.open(path) as file:
        decoded: dict[str, list[dict[str, list[Any]]]] = {}
        for message in file.messages():
            channel = file.channels[message.channel_id]
            schema = file.schemas[channel.schema_id]
            if schema.encoding == "ros2msg":
                definition = parse_ros2msg(schema.name, schema.data.decode())
                fields = CdrDecoder(definition).decode(message.data)
                decoded.setdefault(channel.topic, []).append(fields)
    values = np.concatenate([b.values for b in sources[0][2]]).reshape(10, 200, 3)
    envelope = [m["data"] for m in decoded["/seismic/envelope"]]
    assert envelope == np.stack([values.min(1), values.max(1)], 2).reshape(10, -1).tolist()
    assert decoded["/seismic/envelope"][0]["layout.dim[].size"] == [3, 2]
    means = np.concatenate([b.values for b in sources[1][2]]).reshape(10, 10, 6).mean(1)
    preview = decoded["/imu/foot/preview"]
    assert [m["linear_acceleration.y"][0] for m in preview] == means[:, 1].tolist()
    assert preview[0]["orientation_covariance"][0] == -1.0


def test_a_buffer_may_be_used_again_after_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    parts = blocks(SEISMIC, 1700, 300, "<i4")
    buffer = np.empty((300, 3), "<i4")
    with RecordingWriter(path) as writer:
        writer.add_stream(SEISMIC, "i32le")
        for block in parts:
            buffer[: len(block)] = block.samples
            writer.write(replace(block, samples=buffer[: len(block)]))
    assert np.array_equal(samples_of(read(path, "/seismic"))[1], samples_of(parts)[1])


def failing(stream: Stream) -> Iterator[SignalBlock]:
    yield from blocks(stream, 1234, 100, "<i4")
    raise RuntimeError("the source broke")


def test_after_an_exception_the_partial_file_stays_and_reads(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    with pytest.raises(RuntimeError, match="the source broke"):
        write_recording(path, [(SEISMIC, "i32le", failing(SEISMIC))])
    assert [p.name for p in tmp_path.iterdir()] == ["rec.mcap.partial"]
    found = read(tmp_path / "rec.mcap.partial", "/seismic")
    assert sum(map(len, found)) == 1234


def test_an_existing_file_is_replaced_only_by_force(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(CodecError, match="expected a new file, found an existing one"):
        RecordingWriter(path)
    assert path.read_bytes() == b"precious"
    write_recording(path, [(SEISMIC, "i32le", blocks(SEISMIC, 10, 10, "<i4"))], force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["rec.mcap"]
    assert len(read(path, "/seismic")) == 1


def test_numpy_numbers_describe_a_stream_as_well(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    channels = (Channel("a", "voltage", "V", scale=np.float32(0.5)),)
    stream = Stream("/v", channels, np.float64(33.3))
    write_recording(path, [(stream, "f32le", blocks(stream, 9, 2, "<f4"))])
    with Recording.open(path) as recording:
        assert recording.streams == (stream,)


def write_one(path: Path, block: SignalBlock) -> None:
    with RecordingWriter(path) as writer:
        writer.add_stream(SEISMIC, "i32le")
        writer.write(block)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"stream": replace(SEISMIC, topic="/x")}, "/x: expected an added stream, found none"),
        ({"samples": np.zeros((3, 2), "<i4")}, "expected samples of shape (n, 3), found (3, 2)"),
        ({"samples": np.full((3, 3), 0.5)}, "expected samples that fit i32le, found 0.5"),
        ({"times_ns": np.arange(3)}, "/seismic: expected no sample times, found own"),
        ({"first": -1}, "/seismic: expected a first index >= 0, found -1"),
        ({"anchor_ns": -(10**9)}, "expected times >= 0, found -1000000000 ns"),
    ],
)
def test_what_cannot_be_stored_is_refused(
    tmp_path: Path, change: dict[str, Any], expected: str
) -> None:
    path = tmp_path / "rec.mcap"
    block = replace(blocks(SEISMIC, 1000, 1000, "<i4")[0], **change)
    with pytest.raises(CodecError) as raised:
        write_one(path, block)
    assert expected in str(raised.value)
    assert not path.exists()


def test_a_recording_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CodecError, match=r"nothing\.mcap: expected a recording, found: No such"):
        Recording.open(tmp_path / "nothing.mcap")
    with pytest.raises(CodecError, match="expected a place to write"):
        RecordingWriter(tmp_path / "no folder" / "rec.mcap")
    with pytest.raises(CodecError, match="expected one of zstd, lz4, none, found 'gzip'"):
        RecordingWriter(tmp_path / "rec.mcap", compression="gzip")


def test_an_unknown_topic_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    write_recording(path, [(SEISMIC, "i32le", blocks(SEISMIC, 10, 10, "<i4"))])
    with Recording.open(path) as recording, pytest.raises(CodecError, match="a stream /y, found"):
        next(recording.blocks({"/y"}))


def test_a_torn_recording_gives_every_whole_chunk_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    samples = np.random.default_rng(0).integers(-(2**30), 2**30, (300_000, 3)).astype("<i4")
    parts = [
        SignalBlock(SEISMIC, START_NS, i, samples[i : i + 1000]) for i in range(0, 300_000, 1000)
    ]
    write_recording(path, [(SEISMIC, "i32le", parts)])
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with Recording.open(path) as recording:
        found = [b for _, b in recording.blocks()]
        assert recording.streams == (SEISMIC,)
        assert recording.end_ns == found[-1].last_ns
        assert recording.damage
    kept = samples_of(found)[1]
    assert 80_000 < len(kept) < 220_000
    assert np.array_equal(kept, samples[: len(kept)])
