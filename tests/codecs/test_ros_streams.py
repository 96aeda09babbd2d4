"""Recordings of other tools: ROS 2, messages in messages, Foxglove fixes, what is left alone."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.recording import OtherTopic, Recording
from groundtrace_codecs.schemas.protobuf import descriptor_set, set_time
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(
    get_types_from_msg("std_msgs/Header header\nsensor_msgs/Imu[] samples\n", "ours/msg/Batch")
)
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nours/Inner inner\nsensor_msgs/Temperature air\n", "ours/msg/Outer"
    )
    | get_types_from_msg("float64 x\nsensor_msgs/FluidPressure baro\n", "ours/msg/Inner")
)
START_NS = 1_700_000_000_000_000_000
TYPES = STORE.types


def header(time_ns: int, frame: str = "f") -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def imu(time_ns: int, value: float, frame: str = "f") -> Any:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    return TYPES["sensor_msgs/msg/Imu"](
        header=header(time_ns, frame),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(x=value + 3, y=value + 4, z=value + 5),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(x=value, y=value + 1, z=value + 2),
        linear_acceleration_covariance=np.zeros(9),
    )


def fix(time_ns: int, latitude: float, variance_m2: float = 0.0) -> Any:
    return TYPES["sensor_msgs/msg/NavSatFix"](
        header=header(time_ns),
        status=TYPES["sensor_msgs/msg/NavSatStatus"](status=-1, service=1),
        latitude=latitude,
        longitude=11.0,
        altitude=float("nan"),
        position_covariance=variance_m2 * np.eye(3).reshape(9),
        position_covariance_type=2 if variance_m2 else 0,
    )


class Bag:
    """A small MCAP file as another tool would write it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self.mcap = Writer(self._file)
        self.mcap.start(profile="ros2")
        self._ids: dict[str, tuple[int, str]] = {}

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.mcap.finish()
        self._file.close()

    def ros(self, topic: str, log_ns: int, message: Any, *, little: bool = True) -> None:
        kind = message.__msgtype__
        if topic not in self._ids:
            text = STORE.generate_msgdef(kind, ros_version=2)[0]
            schema = self.mcap.register_schema(kind, "ros2msg", text.encode())
            self._ids[topic] = (self.mcap.register_channel(topic, "cdr", schema), kind)
        data = bytes(STORE.serialize_cdr(message, kind, little_endian=little))
        self.mcap.add_message(self._ids[topic][0], log_ns, data, log_ns)

    def protobuf(self, topic: str, log_ns: int, message: Any) -> None:
        if topic not in self._ids:
            name = message.DESCRIPTOR.full_name
            schema = self.mcap.register_schema(name, "protobuf", descriptor_set(type(message)))
            self._ids[topic] = (self.mcap.register_channel(topic, "protobuf", schema), name)
        self.mcap.add_message(self._ids[topic][0], log_ns, message.SerializeToString(), log_ns)


def columns(recording: Recording, topic: str) -> tuple[list[int], list[list[float]]]:
    blocks = [b for _, b in recording.blocks({topic})]
    times = [t - START_NS for b in blocks for t in b.sample_times().tolist()]
    return times, [row for b in blocks for row in b.samples.tolist()]


def test_an_imu_is_timed_by_its_stamp_and_by_log_time_where_that_is_zero(tmp_path: Path) -> None:
    path = tmp_path / "imu.mcap"
    with Bag(path) as bag:
        for i in range(40):
            stamp = 0 if i == 7 else START_NS + i * 10**7
            bag.ros("/imu", START_NS + i * 10**7 + 123, imu(stamp, float(i), "f" * (i // 9)))
    with Recording.open(path) as recording:
        (stream,) = recording.streams
        times, rows = columns(recording, "/imu")
    assert (stream.topic, stream.irregular, stream.rate_hz) == ("/imu", True, 100.0)
    names = [f"{q}_{a}" for q in ("acc", "gyro") for a in "xyz"]
    assert [c.name for c in stream.channels] == names
    assert times == [i * 10**7 + (123 if i == 7 else 0) for i in range(40)]
    assert rows == [[float(i + k) for k in range(6)] for i in range(40)]


def test_messages_of_both_byte_orders_in_one_channel_read_alike(tmp_path: Path) -> None:
    path = tmp_path / "orders.mcap"
    with Bag(path) as bag:
        for i in range(10):
            time_ns = START_NS + i * 10**7
            bag.ros("/imu", time_ns, imu(time_ns, float(i)), little=i % 3 == 0)
    with Recording.open(path) as recording:
        times, rows = columns(recording, "/imu")
    assert times == [i * 10**7 for i in range(10)]
    assert [row[0] for row in rows] == [float(i) for i in range(10)]


def test_an_array_of_imus_becomes_one_stream_of_all_its_samples(tmp_path: Path) -> None:
    path = tmp_path / "batch.mcap"
    kind = TYPES["ours/msg/Batch"]
    with Bag(path) as bag:
        for i, count in enumerate([5, 5, 0, 3, 5]):
            base = START_NS + i * 50_000_000
            inner = [imu(base + k * 10**7, 10.0 * i + k, "a" * (k % 2)) for k in range(count)]
            bag.ros("/batch", base + 50_000_000, kind(header=header(base), samples=inner))
    with Recording.open(path) as recording:
        (stream,) = recording.streams
        times, rows = columns(recording, "/batch.samples")
    assert stream.topic == "/batch.samples"
    expected = [(i, k) for i, n in enumerate([5, 5, 0, 3, 5]) for k in range(n)]
    assert times == [i * 50_000_000 + k * 10**7 for i, k in expected]
    assert [row[0] for row in rows] == [10.0 * i + k for i, k in expected]


def test_contained_messages_take_their_own_stamp_then_the_outer_one(tmp_path: Path) -> None:
    path = tmp_path / "outer.mcap"
    with Bag(path) as bag:
        for i in range(5):
            log_ns = START_NS + i * 10**9
            baro = TYPES["sensor_msgs/msg/FluidPressure"](header(0), 101325.0 + i, 0.0)
            inner = TYPES["ours/msg/Inner"](x=0.0, baro=baro)
            air = TYPES["sensor_msgs/msg/Temperature"](header(log_ns - 5), 20.0 + i, 0.0)
            outer = header(log_ns - 9 if i else 0)
            bag.ros("/o", log_ns, TYPES["ours/msg/Outer"](header=outer, inner=inner, air=air))
    with Recording.open(path) as recording:
        assert [s.topic for s in recording.streams] == ["/o.inner.baro", "/o.air"]
        assert [s.rate_hz for s in recording.streams] == [1.0, 1.0]
        pressure, temperature = (columns(recording, s.topic) for s in recording.streams)
        assert recording.start_ns == START_NS - 5
        assert recording.end_ns == START_NS + 4 * 10**9 - 5
    assert pressure[0] == [0, *(i * 10**9 - 9 for i in range(1, 5))]
    assert pressure[1] == [[101325.0 + i] for i in range(5)]
    assert temperature[0] == [i * 10**9 - 5 for i in range(5)]


def test_fixes_keep_what_is_not_a_number(tmp_path: Path) -> None:
    path = tmp_path / "fix.mcap"
    with Bag(path) as bag:
        bag.ros("/fix", START_NS, fix(START_NS, 48.0))
        bag.ros("/fix", START_NS + 1, fix(START_NS + 10**9, float("nan")))
    with Recording.open(path) as recording:
        _, rows = columns(recording, "/fix")
    assert np.array_equal(rows, [[48, 11, np.nan], [np.nan, 11, np.nan]], equal_nan=True)


def test_reversed_and_repeated_stamps_pass_as_recorded(tmp_path: Path) -> None:
    path = tmp_path / "stamps.mcap"
    offsets = [0, 10, 10, 5, 20]
    with Bag(path) as bag:
        for i, offset in enumerate(offsets):
            bag.ros("/imu", START_NS + i * 10**6, imu(START_NS + offset * 10**6, float(i)))
    with Recording.open(path) as recording:
        assert columns(recording, "/imu")[0] == [o * 10**6 for o in offsets]


def test_fixes_are_as_exact_as_their_covariance_says(tmp_path: Path) -> None:
    """The radius of 68 %, in two dimensions, is 1.51 standard deviations."""
    path = tmp_path / "exact.mcap"
    with Bag(path) as bag:
        for i, variance_m2 in enumerate([4.0, 0.0, 9.0]):
            bag.ros("/fix", START_NS + i * 10**9, fix(START_NS + i * 10**9, 48.0, variance_m2))
            bag.ros("/bare", START_NS + i * 10**9, fix(START_NS + i * 10**9, 48.0))
    with Recording.open(path) as recording:
        streams = {s.topic: [c.quantity for c in s.channels] for s in recording.streams}
        assert streams["/fix"] == ["latitude", "longitude", "altitude", "horizontal_accuracy"]
        assert streams["/bare"] == ["latitude", "longitude", "altitude"]
        accuracy_m = [row[3] for row in columns(recording, "/fix")[1]]
    assert accuracy_m == pytest.approx([2 * 1.50959, np.nan, 3 * 1.50959], rel=1e-4, nan_ok=True)


def test_what_fixes_say_of_themselves_is_written_as_a_covariance(tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    units = {"latitude": "deg", "longitude": "deg", "altitude": "m", "horizontal_accuracy": "m"}
    channels = tuple(Channel(name, name, unit) for name, unit in units.items())
    stream = Stream("/fix", channels, 1.0, irregular=True)
    values = np.array([[48.0, 11.0, 500.0, 3.0], [48.0, 11.0, 500.0, np.nan]])
    times_ns = START_NS + np.arange(2) * 10**9
    with RecordingWriter(path) as writer:
        writer.add_stream(stream, "f64le")
        writer.write(SignalBlock(stream, START_NS, 0, values, times_ns))
    with path.open("rb") as file:
        logged = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/fix"])]
    told = [STORE.deserialize_cdr(data, "sensor_msgs/msg/NavSatFix") for data in logged]
    assert told[0].position_covariance[[0, 4]] == pytest.approx(
        [(3.0 / 1.50959) ** 2] * 2, rel=1e-4
    )
    assert [x.position_covariance_type for x in told] == [1, 0]
    with Recording.open(path) as recording:
        assert np.array(columns(recording, "/fix")[1]) == pytest.approx(values, nan_ok=True)


def test_foxglove_fixes_are_streams_and_other_protobuf_is_listed(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
    from foxglove_schemas_protobuf.LocationFixes_pb2 import LocationFixes
    from foxglove_schemas_protobuf.Log_pb2 import Log

    path = tmp_path / "foxglove.mcap"
    with Bag(path) as bag:
        for i in range(4):
            time_ns = START_NS + i * 10**9
            one = LocationFix(latitude=48.0 + i, longitude=11.0, altitude=500.0)
            set_time(one.timestamp, time_ns)
            bag.protobuf("/fix", time_ns + 5, one)
            bag.protobuf("/fixes", time_ns + 5, LocationFixes(fixes=[one, one]))
            one.position_covariance.extend(25.0 * np.eye(3).reshape(9))
            one.position_covariance_type = LocationFix.DIAGONAL_KNOWN
            bag.protobuf("/exact", time_ns + 5, one)
            bag.protobuf("/rosout", time_ns, Log(message="x"))
    with Recording.open(path) as recording:
        assert [(s.topic, s.rate_hz) for s in recording.streams] == [
            ("/fix", 1.0),
            ("/fixes", 1.0),
            ("/exact", 1.0),
        ]
        assert columns(recording, "/fix")[0] == [i * 10**9 for i in range(4)]
        assert columns(recording, "/fixes")[1][2:4] == [[49.0, 11.0, 500.0]] * 2
        exact = columns(recording, "/exact")[1]
        assert [row[3] for row in exact] == pytest.approx([1.50959 * 5.0] * 4, rel=1e-4)
        fields = ("timestamp", "level", "message", "name", "file", "line")
        assert recording.others == (OtherTopic("/rosout", "foxglove.Log", "protobuf", 4, fields),)


def test_what_no_schema_explains_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "others.mcap"
    with Bag(path) as bag:
        mcap = bag.mcap
        bare = mcap.register_channel("/bare", "json", 0)
        broken = mcap.register_schema("a/msg/B", "ros2msg", b"Missing x")
        lost = mcap.register_channel("/broken", "cdr", broken)
        text = mcap.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        words = mcap.register_channel("/words", "cdr", text)
        for channel in (bare, lost, words):
            mcap.add_message(channel, START_NS, b"{}", START_NS)
    with Recording.open(path) as recording:
        assert recording.streams == ()
        assert list(recording.blocks()) == []
        assert (recording.start_ns, recording.end_ns) == (0, 0)
        assert recording.others == (
            OtherTopic("/bare", "", "json", 1),
            OtherTopic("/broken", "a/msg/B", "cdr", 1),
            OtherTopic("/words", "std_msgs/msg/String", "cdr", 1, ("data",)),
        )


def test_a_message_cut_short_names_file_topic_and_field(tmp_path: Path) -> None:
    path = tmp_path / "short.mcap"
    with Bag(path) as bag:
        bag.ros("/imu", START_NS, imu(START_NS, 0.0))
        bag.mcap.add_message(1, START_NS + 10**9, b"\0\1\0\0" + bytes(40), START_NS)
    fault = r"short\.mcap: /imu: .*: expected \d+ bytes at \d+, found"
    with Recording.open(path) as recording:
        assert sum(len(block) for _, block in recording.blocks()) > 0
        assert [d.messages for d in recording.damage] == [1]
        assert re.search(fault, recording.damage[0].reason)
    with (
        Recording.open(path, strict=True) as recording,
        pytest.raises(CodecError, match=fault),
    ):
        list(recording.blocks())


def test_the_robot_recording_opens_with_its_imu_and_fixes(data: Path) -> None:
    with Recording.open(data / "robot-localization" / "robot_localization_test1.mcap") as recording:
        assert [s.topic for s in recording.streams] == ["/imu/data", "/fix"]
        rate_hz = recording.streams[0].rate_hz
        assert [o.topic for o in recording.others] == ["/husky_velocity_controller/odom"]
        assert "twist" in recording.others[0].fields
        counts = dict.fromkeys(("/imu/data", "/fix"), 0)
        times = []
        for log_ns, block in recording.blocks():
            counts[block.topic] += len(block)
            times.append(log_ns)
        assert times == sorted(times)
        assert (recording.end_ns - recording.start_ns) / 1e9 == pytest.approx(395.3, abs=0.1)
    assert counts == {"/imu/data": 11865, "/fix": 989}
    assert rate_hz == pytest.approx(30.0, abs=0.1)


def test_the_robot_recording_reads_as_rosbags_reads_it(data: Path) -> None:
    from mcap.reader import make_reader

    path = data / "robot-localization" / "robot_localization_test1.mcap"
    with path.open("rb") as file:
        messages = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/imu/data"])]
    with Recording.open(path) as recording:
        values = np.concatenate([b.samples for _, b in recording.blocks({"/imu/data"})])
    for i in range(0, len(messages), 997):
        m = STORE.deserialize_cdr(messages[i], "sensor_msgs/msg/Imu")
        vectors = (m.linear_acceleration, m.angular_velocity)
        assert values[i].tolist() == [getattr(v, a) for v in vectors for a in "xyz"]
