"""ROS 1 and ROS 2 bags, written with rosbags."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sweeps import examples

from groundtrace_codecs.errors import CodecError, FormatError, MissingReaderError, SchemaError
from groundtrace_codecs.importers.ros import RosImporter
from groundtrace_codecs.importers.run import choose, files_of, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.importers.base import Imported

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)
START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
#: Topic, time of the log [ns] and message.
Logged = tuple[str, int, Any]


class Maker:
    """Messages of one type store."""

    def __init__(self, store: Any) -> None:
        self.store = store

    def header(self, time_ns: int) -> Any:
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
        more = {"seq": 3} if self.store is ROS1 else {}
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="odd", **more)

    def imu(self, time_ns: int, value: float) -> Any:
        types = self.store.types
        vector = types["geometry_msgs/msg/Vector3"]
        return types["sensor_msgs/msg/Imu"](
            header=self.header(time_ns),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9),
            angular_velocity=vector(x=value + 3, y=value + 4, z=value + 5),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=value, y=value + 1, z=value + 2),
            linear_acceleration_covariance=np.zeros(9),
        )

    def scalar(self, kind: str, time_ns: int, value: float) -> Any:
        return self.store.types[f"sensor_msgs/msg/{kind}"](self.header(time_ns), value, 0.0)

    def field(self, time_ns: int) -> Any:
        vector = self.store.types["geometry_msgs/msg/Vector3"](x=20e-6, y=0.0, z=-40e-6)
        kind = self.store.types["sensor_msgs/msg/MagneticField"]
        return kind(self.header(time_ns), vector, np.zeros(9))

    def fix(self, time_ns: int, latitude: float) -> Any:
        types = self.store.types
        return types["sensor_msgs/msg/NavSatFix"](
            header=self.header(time_ns),
            status=types["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
            latitude=latitude,
            longitude=11.0,
            altitude=500.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )

    def walk(self, count: int = 200) -> list[Logged]:
        """Return two seconds with a gap, all five kinds and one message of another."""
        logged: list[Logged] = []
        for i in [k for k in range(count) if not 50 <= k < 70]:
            at = START_NS + i * STEP_NS
            logged.append(("/imu", at + 2000, self.imu(at, i / 10)))
            if i % 10 == 0:
                logged.append(("/mag", at + 2000, self.field(at)))
                logged.append(("/baro", at + 2000, self.scalar("FluidPressure", at, 101325.0 + i)))
                logged.append(("/air", at + 2000, self.scalar("Temperature", at, 20.0)))
            if i % 100 == 0:
                logged.append(("/fix", at + 2000, self.fix(at, 48.0)))
                text = self.store.types["std_msgs/msg/String"](data="x")
                logged.append(("/words", at + 2000, text))
        return logged


def bag1(folder: Path, logged: Sequence[Logged], name: str = "walk.bag") -> Path:
    with Writer1(folder / name) as writer:
        topics: dict[str, Any] = {}
        for topic, time_ns, message in logged:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(topics[topic], time_ns, ROS1.serialize_ros1(message, kind))
    return folder / name


def bag2(folder: Path, logged: Sequence[Logged], plugin: StoragePlugin, version: int = 9) -> Path:
    with Writer2(folder / "walk", version=version, storage_plugin=plugin) as writer:
        topics: dict[str, Any] = {}
        for topic, time_ns, message in logged:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            writer.write(topics[topic], time_ns, ROS2.serialize_cdr(message, kind))
    return folder / "walk"


def check_walk(out: Path) -> None:
    with Recording.open(out) as opened:
        streams = {s.topic: s for s in opened.streams}
        assert sorted(streams) == ["/air", "/baro", "/fix", "/imu", "/mag"]
        assert streams["/imu"].rate_hz == 100.0
        assert not streams["/imu"].irregular
        blocks = [b for _, b in opened.blocks({"/imu"})]
        times = np.concatenate([b.sample_times() for b in blocks]) - START_NS
        values = np.concatenate([b.samples for b in blocks])
        field = np.concatenate([b.samples for _, b in opened.blocks({"/mag"})])
        fixes = np.concatenate([b.samples for _, b in opened.blocks({"/fix"})])
    kept = np.array([k for k in range(200) if not 50 <= k < 70])
    assert np.array_equal(times, kept * STEP_NS)
    assert np.array_equal(values, kept[:, None] / 10 + np.arange(6))
    assert field[0].tolist() == [20e-6, 0.0, -40e-6]
    assert fixes.tolist() == [[48.0, 11.0, 500.0]] * 2


def test_a_ros_1_bag_gives_every_sample_at_its_stamp_and_keeps_the_gap(tmp_path: Path) -> None:
    path = bag1(tmp_path, Maker(ROS1).walk())
    report = import_recording([path], tmp_path / "out.mcap")
    assert (report.importer, report.samples["/imu"]) == ("ros", 180)
    assert report.warnings == ("left alone: /words (std_msgs/msg/String)",)
    check_walk(tmp_path / "out.mcap")


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_ros_2_bag_is_read_by_its_folder(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = bag2(tmp_path, Maker(ROS2).walk(), plugin)
    assert choose(files_of([folder])).name == "ros"
    report = import_recording([folder], tmp_path / "out.mcap")
    assert [w for w in report.warnings if "left alone" not in w] == []
    check_walk(tmp_path / "out.mcap")


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_the_file_of_a_bag_is_read_without_its_folder(tmp_path: Path, suffix: str) -> None:
    plugin = {".db3": StoragePlugin.SQLITE3, ".mcap": StoragePlugin.MCAP}[suffix]
    folder = bag2(tmp_path, Maker(ROS2).walk(), plugin)
    (path,) = folder.glob(f"*{suffix}")
    import_recording([path.rename(tmp_path / path.name)], tmp_path / "out.mcap")
    check_walk(tmp_path / "out.mcap")


def test_a_bag_of_before_definitions_were_kept_is_read(tmp_path: Path) -> None:
    folder = bag2(tmp_path, Maker(ROS2).walk(), StoragePlugin.SQLITE3, version=8)
    import sqlite3

    with sqlite3.connect(next(folder.glob("*.db3"))) as base:
        base.execute("DROP TABLE message_definitions")
        base.execute("UPDATE schema SET schema_version = 3")
    base.close()
    import_recording([folder], tmp_path / "out.mcap")
    check_walk(tmp_path / "out.mcap")


def test_split_bags_are_one_recording(tmp_path: Path) -> None:
    logged = Maker(ROS1).walk()
    parts = [bag1(tmp_path, logged[:100], "a.bag"), bag1(tmp_path, logged[100:], "b.bag")]
    import_recording(parts, tmp_path / "out.mcap")
    check_walk(tmp_path / "out.mcap")


def read(path: Path) -> Imported:
    return RosImporter().read([path], None)


def test_stamps_that_go_back_or_come_twice_are_put_right_and_counted(tmp_path: Path) -> None:
    make = Maker(ROS1)
    places = [0, 1, 3, 2, 4, 4, 5, 6]
    logged = [
        ("/imu", START_NS + i, make.imu(START_NS + p * STEP_NS, float(p)))
        for i, p in enumerate(places)
    ]
    found = read(bag1(tmp_path, logged))
    ((stream, _, blocks),) = found.sources
    (block,) = blocks
    assert stream.rate_hz == 100.0
    assert block.samples[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert found.warnings == (
        "/imu: 1 times go back, by up to 0.01 s: sorted by time",
        "/imu: 1 samples come twice: one kept",
    )


def test_a_single_fix_is_a_stream(tmp_path: Path) -> None:
    found = read(bag1(tmp_path, [("/fix", START_NS, Maker(ROS1).fix(START_NS, 48.0))]))
    ((stream, _, blocks),) = found.sources
    assert [len(b) for b in blocks] == [1]
    assert stream.irregular


def test_a_bag_without_signals_says_what_it_holds(tmp_path: Path) -> None:
    words = [x for x in Maker(ROS1).walk() if x[0] == "/words"]
    with pytest.raises(FormatError, match=r"walk\.bag: expected sensor_msgs.*found /words"):
        read(bag1(tmp_path, words))


def test_a_bag_cut_short_is_refused_in_one_line(tmp_path: Path) -> None:
    path = bag1(tmp_path, Maker(ROS1).walk())
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(FormatError, match=r"^walk\.bag: expected a whole ROS bag, found: [^\n]+$"):
        read(path)


def test_without_rosbags_the_error_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bag1(tmp_path, Maker(ROS1).walk(3))
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingReaderError, match=r"pip install 'groundtrace\[ros\]'"):
        read(path)


def test_a_map_has_no_place_with_a_bag(tmp_path: Path) -> None:
    from groundtrace_codecs.importers.base import ColumnMap, ImportMap, StreamMap

    column = ColumnMap("a", "seismic", "count")
    map_ = ImportMap("ros", (StreamMap("/s", (column,)),), rate_hz=1.0)
    with pytest.raises(SchemaError, match="expected no map"):
        RosImporter().read([bag1(tmp_path, Maker(ROS1).walk(3))], map_)


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    head=st.sampled_from([b"", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"]),
    body=st.binary(max_size=300),
    suffix=st.sampled_from([".bag", ".db3", ".mcap"]),
)
def test_any_bytes_give_the_importers_own_error(
    tmp_path: Path, head: bytes, body: bytes, suffix: str
) -> None:
    path = tmp_path / f"any{suffix}"
    path.write_bytes(head + body)
    RosImporter().sniff(path)
    with pytest.raises(CodecError):
        read(path)


OWN = get_typestore(Stores.ROS1_NOETIC)
OWN.register(
    get_types_from_msg(
        "std_msgs/Header header\nfloat64 lat\nfloat64 lon\nfloat32 alt\nstring mode\n",
        "rover_msgs/msg/Position",
    )
    | get_types_from_msg("rover_msgs/Position at\nint32 n\n", "rover_msgs/msg/State")
)


def places(path: Path, latitudes: Sequence[float], *, within: bool = False) -> Path:
    """Write a bag of positions of a type that nobody else knows, one a second."""
    make, kind = Maker(ROS1), "rover_msgs/msg/State" if within else "rover_msgs/msg/Position"
    with Writer1(path) as writer:
        topic = writer.add_connection("/rover", kind, typestore=OWN)
        for i, latitude in enumerate(latitudes):
            at = START_NS + i * 10**9
            message = OWN.types["rover_msgs/msg/Position"](
                make.header(at), latitude, 11.0 + i, 500.0, "x"
            )
            if within:
                message = OWN.types[kind](message, i)
            writer.write(topic, at + 2000, OWN.serialize_ros1(message, kind))
    return path


@pytest.mark.parametrize("within", [False, True])
def test_latitude_and_longitude_of_an_unknown_type_are_a_position_with_a_note(
    within: bool, tmp_path: Path
) -> None:
    path = places(tmp_path / "a.bag", [48.0, 48.5, 49.0], within=within)
    report = import_recording([path], tmp_path / "out.mcap")
    (note,) = report.warnings
    kind = "rover_msgs/Position"
    assert f"the lat and lon of {kind}, a message of unknown type, are taken for a posi" in note
    with Recording.open(tmp_path / "out.mcap") as opened:
        (stream,) = opened.streams
        assert stream.topic == ("/rover.at" if within else "/rover")
        assert [c.quantity for c in stream.channels] == ["latitude", "longitude", "altitude"]
        blocks = [b for _, b in opened.blocks()]
    values = np.concatenate([b.values for b in blocks])
    assert values.tolist() == [[48.0, 11.0, 500.0], [48.5, 12.0, 500.0], [49.0, 13.0, 500.0]]
    times = np.concatenate([b.sample_times() for b in blocks])
    assert (times - START_NS).tolist() == [0, 10**9, 2 * 10**9]


def test_what_is_called_a_latitude_and_is_none_is_left_alone(tmp_path: Path) -> None:
    path = places(tmp_path / "a.bag", [480_000_000.0, 481_000_000.0])
    with pytest.raises(FormatError, match=r"found /rover .latitude and longitude beyond 90 and"):
        import_recording([path], tmp_path / "out.mcap")


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_bag_under_another_name_is_known_by_its_content(kind: str, tmp_path: Path) -> None:
    if kind == "bag":
        path = bag1(tmp_path, Maker(ROS1).walk())
    else:
        plugin = {"db3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[kind]
        (path,) = bag2(tmp_path, Maker(ROS2).walk(), plugin).glob(f"*.{kind}")
    import_recording([path.rename(tmp_path / "walk.dat")], tmp_path / "out.mcap")
    check_walk(tmp_path / "out.mcap")
