"""``groundtrace export`` to a ROS 2 bag: rosbags, Rerun and our own importer read it back."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command_runs import done, run

from groundtrace_codecs.recording import Recording
from groundtrace_codecs.schemas.ros2 import KINDS, ros2msg
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import write_recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

pytest.importorskip("rosbags", reason="rosbags is not installed")
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Capture = pytest.CaptureFixture[str]
Values = dict[str, tuple["NDArray[np.int64]", "NDArray[np.float64]"]]
START_NS = 1_700_000_000_123_456_789
JAZZY = get_typestore(Stores.ROS2_JAZZY)


def axes(name: str, quantity: str, unit: str, scale: float = 1.0) -> tuple[Channel, ...]:
    return tuple(Channel(f"{name}_{a}", quantity, unit, a, scale) for a in "xyz")


ACC = axes("acc", "acceleration", "m/s2")
GYRO = axes("gyro", "angular_velocity", "rad/s")
FAST = tuple(
    Channel(c.name, c.quantity, c.unit, c.axis, 1e-3)
    for c in (*GYRO, *ACC, *axes("mag", "magnetic_field", "T"))
)
FIX = tuple(channel for _, channel in KINDS["sensor_msgs/NavSatFix"])
STREAMS = (
    (Stream("/imu", (*ACC, *GYRO), 100.0, "waist"), "f64le"),
    (Stream("/foot", FAST, 1000.0), "i16le"),
    (Stream("/acc/phone", ACC, 50.0), "f64le"),
    (Stream("/baro", (Channel("p", "pressure", "Pa", scale=100.0),), 10.0), "f64le"),
    (Stream("/fix", FIX, 1.0, irregular=True), "f64le"),
    (Stream("/seismic", (Channel("G1", "seismic", "count"),), 2000.0), "i16le"),
)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def recording() -> Values:
    """Write two seconds, in /imu with a gap; return times and values in SI by topic."""
    random = np.random.default_rng(3)
    sources, values = [], {}
    for stream, form in STREAMS:
        count = 4 if stream.irregular else int(2 * stream.rate_hz)
        samples = random.integers(-30_000, 30_000, (count, len(stream.channels)))
        stored = samples.astype(np.int16) if form == "i16le" else samples / 7
        times = START_NS + np.cumsum([0, 11, 7, 14]) * 100_000_003 if stream.irregular else None
        cut = 60 if stream.topic == "/imu" else count
        blocks = [
            SignalBlock(stream, START_NS, first + (5 if first else 0), part, own)
            for first, part, own in (
                (0, stored[:cut], None if times is None else times[:cut]),
                (cut, stored[cut:], None),
            )
            if len(part)
        ]
        sources.append((stream, form, blocks))
        values[stream.topic] = (
            np.concatenate([b.sample_times() for b in blocks]),
            np.concatenate([b.values for b in blocks]),
        )
    write_recording("rec.mcap", sources)
    return values


def expected(values: Values, topic: str, columns: list[int]) -> list[tuple[int, list[float]]]:
    times, samples = values[topic]
    return list(zip(times.tolist(), samples[:, columns].tolist(), strict=True))


def vector(message: Any) -> list[float]:
    return [message.x, message.y, message.z]


def stamp(message: Any) -> int:
    time = message.header.stamp
    return int(time.sec) * 10**9 + int(time.nanosec)


def messages(path: str) -> dict[str, list[Any]]:
    """Return every message as rosbags decodes it by the schema in the file."""
    found: dict[str, list[Any]] = {}
    with AnyReader([Path(path)]) as bag:
        for connection, time_ns, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            assert time_ns == stamp(message)
            found.setdefault(f"{connection.topic} {connection.msgtype}", []).append(message)
    return found


def test_rosbags_reads_every_sample_at_its_time(capsys: Capture) -> None:
    values = recording()
    ran = done(capsys, "export", "rec.mcap", "-o", "bag.mcap", "--format", "ros2")
    found = messages("bag.mcap")
    assert {name.replace("sensor_msgs/msg/", "") for name in found} == {
        "/imu Imu",
        "/foot Imu",
        "/foot/mag MagneticField",
        "/acc/phone Imu",
        "/baro FluidPressure",
        "/fix NavSatFix",
    }
    for topic, columns in (("/imu", [0, 1, 2, 3, 4, 5]), ("/foot", [3, 4, 5, 0, 1, 2])):
        assert [
            (stamp(m), vector(m.linear_acceleration) + vector(m.angular_velocity))
            for m in found[f"{topic} sensor_msgs/msg/Imu"]
        ] == expected(values, topic, columns)
    assert [
        (stamp(m), vector(m.magnetic_field))
        for m in found["/foot/mag sensor_msgs/msg/MagneticField"]
    ] == expected(values, "/foot", [6, 7, 8])
    assert [
        (stamp(m), [m.fluid_pressure]) for m in found["/baro sensor_msgs/msg/FluidPressure"]
    ] == expected(values, "/baro", [0])
    assert [
        (stamp(m), [m.latitude, m.longitude, m.altitude])
        for m in found["/fix sensor_msgs/msg/NavSatFix"]
    ] == expected(values, "/fix", [0, 1, 2])
    assert "/seismic: left out, no message holds it: G1" in ran.out


def test_what_a_sensor_does_not_measure_is_marked_as_the_message_says(capsys: Capture) -> None:
    recording()
    done(capsys, "export", "rec.mcap", "-o", "bag.mcap")
    found = messages("bag.mcap")
    for name, unknown in (
        ("/imu", {"orientation"}),
        ("/acc/phone", {"orientation", "angular_velocity"}),
    ):
        message = found[f"{name} sensor_msgs/msg/Imu"][0]
        for part in ("orientation", "angular_velocity", "linear_acceleration"):
            first = getattr(message, f"{part}_covariance")[0]
            assert first == (-1.0 if part in unknown else 0.0), (name, part)
    assert found["/imu sensor_msgs/msg/Imu"][0].header.frame_id == "waist"


def test_our_own_reader_and_importer_give_the_samples_back(capsys: Capture) -> None:
    values = recording()
    done(capsys, "export", "rec.mcap", "-o", "bag.mcap")
    done(capsys, "import", "bag.mcap", "-o", "back.mcap")
    with Recording.open("back.mcap") as opened:
        kinds = {s.topic: [c.quantity for c in s.channels] for s in opened.streams}
        assert kinds["/acc/phone"] == ["acceleration"] * 3
        assert {s.topic: s.rate_hz for s in opened.streams}["/foot"] == 1000.0
        for topic in ("/imu", "/acc/phone", "/baro", "/fix"):
            blocks = [b for _, b in opened.blocks({topic})]
            times, samples = values[topic]
            assert np.concatenate([b.sample_times() for b in blocks]).tolist() == times.tolist()
            assert np.array_equal(np.concatenate([b.values for b in blocks]), samples)


def test_rerun_finds_nothing_wrong_and_its_loader_keeps_the_signals(capsys: Capture) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    recording()
    done(capsys, "export", "rec.mcap", "-o", "bag.mcap")
    program = Path(sys.executable).with_name("rerun")
    for arguments in (("check", "bag.mcap"), ("convert", "bag.mcap", "-o", "bag.rrd")):
        ran = subprocess.run(
            [program, "mcap", *arguments],
            env={**os.environ, "CI": "1"},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert ran.returncode == 0, ran.stderr
        assert "error" not in ran.stdout.lower(), ran.stdout
    import rerun as rr

    rows: dict[tuple[str, str], int] = {}
    for chunk in rr.chunk.RrdReader("bag.rrd").stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            key = (str(chunk.entity_path), name.partition(":")[0])
            rows[key] = rows.get(key, 0) + batch.num_rows
    drawn = {"/imu": "Scalars", "/foot": "Scalars", "/foot/mag": "Arrows3D", "/fix": "GeoPoints"}
    counts = {"/imu": 200, "/foot": 2000, "/foot/mag": 2000, "/fix": 4}
    assert {topic: rows.get((topic, what)) for topic, what in drawn.items()} == counts


@pytest.mark.parametrize("kind", KINDS)
def test_the_schemas_are_the_published_ones(kind: str) -> None:
    name = kind.replace("/", "/msg/")
    ours = get_typestore(Stores.EMPTY)
    ours.register(get_types_from_msg(ros2msg(kind), name))
    for each, fields in ours.fielddefs.items():
        assert fields == JAZZY.fielddefs[each], each
    assert ours.hash_rihs01(name) == JAZZY.hash_rihs01(name)


def test_a_recording_without_such_sensors_is_refused_and_nothing_stays(capsys: Capture) -> None:
    stream = Stream("/seismic", (Channel("G1", "seismic", "count"),), 100.0)
    block = SignalBlock(stream, START_NS, 0, np.zeros((100, 1), np.int16))
    write_recording("rec.mcap", [(stream, "i16le", [block])])
    ran = run(capsys, "export", "rec.mcap", "-o", "bag.mcap")
    assert ran.error == (
        "rec.mcap: expected an accelerometer, gyroscope, magnetometer, barometer, thermometer or "
        "satellite fixes, found /seismic"
    )
    assert [path.name for path in Path().iterdir()] == ["rec.mcap"]
