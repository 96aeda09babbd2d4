"""Text exported by Xsens MT Manager, written here as its versions write it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.errors import FormatError, SchemaError
from groundtrace_codecs.importers.run import check_needs_map, choose, import_recording
from groundtrace_codecs.importers.time import unwrapped
from groundtrace_codecs.importers.xsens import XsensImporter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from groundtrace_codecs.importers.base import Imported

OLD = "// Start Time: 0\n// Sample rate: 120.0Hz\n// Scenario: 5.9\n// Firmware Version: 2.5.1\n"
NEW = (
    "// General information: \n//  MT Manager version: 2022.2.0 \n// Device information: \n"
    "//  DeviceId: 00B42D4F\n//  Firmware Version: 4.4.0\n{rate}// Coordinate system: ENU\n"
)
RATE = "//  Update Rate: 100.0Hz\n"
UTC = [
    "UTC_Nano",
    "UTC_Year",
    "UTC_Month",
    "UTC_Day",
    "UTC_Hour",
    "UTC_Minute",
    "UTC_Second",
    "UTC_Valid",
]
IMU = [f"{sensor}_{axis}" for sensor in ("Acc", "Gyr", "Mag") for axis in "XYZ"]


def motion(count: int) -> list[list[str]]:
    """Return rows of acceleration, rotation and field of a sensor that swings."""
    t = np.arange(count) / 100
    columns = [
        0.1 * t,
        np.sin(t),
        9.8 + 0 * t,
        np.cos(t),
        -t,
        0.01 * t,
        0.8 + 0 * t,
        0.5 + 0 * t,
        -t,
    ]
    return [[f"{v:.6f}" for v in row] for row in np.stack(columns, axis=1)]


def write(
    path: Path, comments: str, names: Sequence[str], rows: Sequence[Sequence[str]], end: str = ""
) -> Path:
    lines = ["\t".join(names) + end, *("\t".join(row) + end for row in rows)]
    path.write_text(comments + "\n".join(lines) + "\n")
    return path


def read(*paths: Path) -> Imported:
    assert choose(paths).name == "xsens"
    return XsensImporter().read(paths, None)


def counted(path: Path, counter: Sequence[int], comments: str = OLD) -> Path:
    rows = [[str(n), *m] for n, m in zip(counter, motion(len(counter)), strict=True)]
    return write(path, comments, ["Counter", *IMU], rows, end="\t")


def times_of(found: Imported, topic: str = "/imu") -> list[int]:
    (blocks,) = (b for s, _, b in found.sources if s.topic == topic)
    return [t for block in blocks for t in block.sample_times().tolist()]


def test_a_rate_that_is_no_number_is_none(tmp_path: Path) -> None:
    comments = OLD.replace("120.0Hz", "120.0.Hz")
    with pytest.raises(FormatError, match="expected // Update Rate"):
        read(counted(tmp_path / "x.txt", [0, 1, 2], comments))


@pytest.mark.parametrize("comment", ["// Update Ra\x0c 0Hz\n", '"// one\n// of two lines"\n'])
def test_names_of_columns_are_those_of_the_first_row(tmp_path: Path, comment: str) -> None:
    path = counted(tmp_path / "x.txt", [0, 1, 2], comment + OLD)
    assert len(times_of(XsensImporter().read([path], None))) == 3


@pytest.mark.filterwarnings("error")
def test_a_counter_that_no_device_can_have_is_left_alone(tmp_path: Path) -> None:
    path = counted(tmp_path / "x.txt", [0, 10**20, 2, 3])
    assert len(times_of(read(path))) == 4


def test_an_old_export_gives_units_the_manual_tells_at_the_rate_of_its_comments(
    tmp_path: Path,
) -> None:
    found = read(counted(tmp_path / "a.txt", range(40_000, 40_060)))
    streams = {stream.topic: (stream, list(blocks)) for stream, _, blocks in found.sources}
    assert set(streams) == {"/imu", "/mag"}
    stream, (block,) = streams["/imu"]
    assert [(c.quantity, c.unit, c.axis) for c in stream.channels] == [
        (quantity, unit, axis)
        for quantity, unit in (("acceleration", "m/s2"), ("angular_velocity", "rad/s"))
        for axis in "xyz"
    ]
    assert stream.rate_hz == 120.0
    expected = np.array([[float(c) for c in row[:6]] for row in motion(60)])
    assert np.array_equal(block.values, expected)
    mag = streams["/mag"][0].channels[0]
    assert (mag.quantity, mag.unit) == ("magnetic_field_normalised", "1")
    assert found.start_ns == 0
    assert found.warnings == ()
    assert found.remarks[0].endswith("the clock is not that of the calendar")


def test_packets_that_are_lost_are_a_gap_over_the_wrap_of_the_counter(tmp_path: Path) -> None:
    counter = [*range(65_530, 65_536), *range(2, 20)]
    found = read(counted(tmp_path / "a.txt", counter))
    period_ns = 1e9 / 120
    places = [*range(6), *range(8, 26)]
    assert times_of(found) == [round(i * period_ns) for i in places]
    assert found.warnings == ("a.txt: 2 packets are missing, in 1 gaps",)


def test_a_packet_that_comes_twice_or_late_is_put_right(tmp_path: Path) -> None:
    path = counted(tmp_path / "a.txt", [5, 6, 8, 7, 7, 9])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:9], lines[8], lines[10]]) + "\n")
    found = read(path)
    assert times_of(found) == [round(i * 1e9 / 120) for i in range(5)]
    assert found.warnings[0] == "a.txt: 1 packets come twice"
    assert any("1 times go back" in line for line in found.warnings)


@pytest.mark.parametrize("ticks_per_s", [10_000, 1_000_000])
def test_fine_sample_times_count_before_the_rate_and_wrap(tmp_path: Path, ticks_per_s: int) -> None:
    step = ticks_per_s // 100
    ticks = [(2**32 - 3 * step + i * step) % 2**32 for i in range(50) if i != 20]
    rows = [[str(i), str(t), *m] for i, (t, m) in enumerate(zip(ticks, motion(49), strict=True))]
    path = write(
        tmp_path / "a.txt", NEW.format(rate=RATE), ["PacketCounter", "SampleTimeFine", *IMU], rows
    )
    times = np.array(times_of(read(path)))
    expected = np.array([i for i in range(50) if i != 20]) * 10_000_000
    assert np.array_equal(times - times[0], expected)


def test_rows_with_utc_put_the_recording_on_the_calendar(tmp_path: Path) -> None:
    empty = [""] * len(UTC)
    told = ["250000000", "2024", "5", "1", "12", "30", "7", "7"]
    invalid = [*told[:-1], "0"]
    rows = [
        [str(i), *(told if i == 4 else invalid if i == 2 else empty), *m]
        for i, m in enumerate(motion(10))
    ]
    path = write(tmp_path / "a.txt", NEW.format(rate=RATE), ["PacketCounter", *UTC, *IMU], rows)
    found = read(path)
    assert found.start_ns == 1_714_566_607_250_000_000 - 40_000_000  # 2024-05-01T12:30:07.25Z
    assert found.remarks[0].startswith("the magnetic field")


def test_seconds_of_the_day_are_read_where_there_are_no_hours(tmp_path: Path) -> None:
    rows = [
        [str(i), "2024", "5", "1", f"{45007.25 + i / 100:.3f}", *m] for i, m in enumerate(motion(9))
    ]
    names = ["PacketCounter", "Year", "Month", "Day", "Second", *IMU]
    found = read(write(tmp_path / "a.txt", NEW.format(rate=RATE), names, rows))
    assert found.start_ns == 1_714_566_607_250_000_000


def test_pressure_quaternion_and_fixes_are_streams_of_their_own(tmp_path: Path) -> None:
    quaternion = [f"Quat_q{i}" for i in range(4)]
    names = ["PacketCounter", *IMU, *quaternion, "Pressure", "Latitude", "Longitude", "Altitude"]
    fixes = [["0.0", "0.0", "0.0"], ["48.1", "11.5", "519.0"]]
    rows = [
        [str(i), *m, "1", "0", "0", "0", "1013.25" if i % 5 == 0 else "NaN", *fixes[i == 7]]
        for i, m in enumerate(motion(20))
    ]
    path = write(
        tmp_path / "a.txt", NEW.format(rate=RATE), [*names, "RSSI"], [[*r, "1"] for r in rows]
    )
    found = read(path)
    values = {s.topic: np.concatenate([b.values for b in blocks]) for s, _, blocks in found.sources}
    assert values["/orientation"].tolist() == [[1.0, 0.0, 0.0, 0.0]] * 20
    np.testing.assert_allclose(values["/baro"], np.full((4, 1), 101_325.0))
    assert values["/fix"].tolist() == [[48.1, 11.5, 519.0]]
    assert found.warnings == ("a.txt: left out: RSSI",)


def test_files_of_one_station_lie_on_one_clock_by_their_counters(tmp_path: Path) -> None:
    left = counted(tmp_path / "walk_00B42D01.txt", range(65_530, 65_570 - 34))
    right = counted(tmp_path / "walk_00B42D02.txt", range(3, 40))
    found = read(left, right)
    assert {s.topic for s, _, _ in found.sources} >= {"/imu/00B42D01", "/imu/00B42D02"}
    first = times_of(found, "/imu/00B42D02")[0] - times_of(found, "/imu/00B42D01")[0]
    assert first == round(9 * 1e9 / 120)
    assert "2 files are put together by their packet counters" in found.remarks


def test_degrees_called_radians_are_a_warning_of_the_import(tmp_path: Path) -> None:
    rows = [
        [str(i), *m[:3], *(f"{200 * np.sin(i / 5 + k):.4f}" for k in range(3)), *m[6:]]
        for i, m in enumerate(motion(300))
    ]
    path = write(tmp_path / "a.txt", NEW.format(rate=RATE), ["PacketCounter", *IMU], rows)
    report = import_recording([path], tmp_path / "out.mcap")
    assert any(line.endswith("was deg/s called rad/s?") for line in report.warnings)


def test_without_a_rate_or_fine_times_it_is_refused_in_one_line(tmp_path: Path) -> None:
    rows = [[str(i), "NaN", *m] for i, m in enumerate(motion(9))]
    names = ["PacketCounter", "SampleTimeFine", *IMU]
    path = write(tmp_path / "a.txt", NEW.format(rate=""), names, rows)
    with pytest.raises(
        FormatError,
        match=r"a.txt: expected // Update Rate or SampleTimeFine in every row, found neither; a "
        r"map can state the rate: groundtrace import a.txt --guess writes one",
    ):
        read(path)
    check_needs_map(path)


@pytest.mark.parametrize("before", ["", "\ufeff", "a line of no kind\n\n"])
@pytest.mark.parametrize("word", ["Acquisition frequency", "Sampling rate"])
def test_a_line_before_the_names_may_tell_the_rate(tmp_path: Path, before: str, word: str) -> None:
    rows = [[f"{i}.0", *m] for i, m in enumerate(motion(9)) if i not in (3, 4)]
    names = ["PacketCounter", *IMU]
    path = write(tmp_path / "a.txt", f"{before}{word}: 50 Hz\n", names, rows)
    found = read(path)
    assert (
        np.diff(times_of(found, "/imu")).tolist()
        == [20_000_000] * 2 + [60_000_000] + [20_000_000] * 3
    )


def test_two_files_of_one_sensor_are_refused(tmp_path: Path) -> None:
    paths = [counted(tmp_path / f"{i}_00B42D01.txt", range(9)) for i in range(2)]
    with pytest.raises(SchemaError, match="expected a sensor of its own in each file"):
        read(*paths)


def test_other_text_is_not_taken_for_an_export(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("// a comment\nt\tax\tay\taz\n0\t1\t2\t3\n")
    assert XsensImporter().sniff(path) == 0.0


def test_a_counter_goes_on_over_its_end_whichever_way_packets_come() -> None:
    counter = np.array([65_534, 65_535, 1, 0, 2], np.int64)
    assert unwrapped(counter, 1 << 16).tolist() == [65_534, 65_535, 65_537, 65_536, 65_538]
