"""Recordings of phone apps: Sensor Logger and phyphox."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace_codecs.errors import CodecError, FormatError, SchemaError
from groundtrace_codecs.importers.phone import PhoneImporter
from groundtrace_codecs.importers.run import choose, files_of, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from groundtrace_codecs.importers.base import Imported
    from groundtrace_codecs.signals import SignalBlock, Stream

START_NS = 1_714_521_600_123_456_789
STEP_NS = 10_000_000
ANDROID = "platform,appVersion,standardisation\nandroid,1.30,false\n"
IOS = "platform,appVersion,standardisation\nios,1.30,false\n"
IOS_STANDARD = "platform,appVersion,standardisation\nios,1.30,true\n"


def logger(rows: Iterable[tuple[int, float, float, float]]) -> str:
    """Return a table of Sensor Logger: place on the grid, x, y, z; columns come z, y, x."""
    lines = [
        f"{START_NS + k * STEP_NS},{k * STEP_NS / 1e9 - 0.02:.7f},{z!r},{y!r},{x!r}"
        for k, x, y, z in rows
    ]
    return "\n".join(["time,seconds_elapsed,z,y,x", *lines]) + "\n"


def still(x: float, y: float, z: float, count: int = 100) -> str:
    return logger((k, x, y, z) for k in range(count) if not 40 <= k < 50)


def folder(path: Path, files: Mapping[str, str]) -> Path:
    for name, text in files.items():
        (path / name).parent.mkdir(exist_ok=True, parents=True)
        (path / name).write_text(text, encoding="utf-8")
    return path


def archive(path: Path, files: Mapping[str, str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, text in files.items():
            out.writestr(name, text)
    return path


def streams(found: Imported) -> dict[str, tuple[Stream, list[SignalBlock]]]:
    return {s.topic: (s, list(blocks)) for s, _, blocks in found.sources}


def read(*paths: Path) -> Imported:
    return PhoneImporter().read(paths, None)


def walk() -> dict[str, str]:
    baro = [f"{START_NS + k * 10**9},{k},0.0,1013.{k}" for k in range(5)]
    fixes = [f"{START_NS + k * 10**9},{k},{k + 3.5},1.0,0.0,500.0,11.5,48.{k}" for k in range(5)]
    return {
        "TotalAcceleration.csv": still(1.0, 2.0, 9.5),
        "Accelerometer.csv": still(1.0, 2.0, -0.3),
        "Gyroscope.csv": still(0.1, 0.2, 0.3),
        "Magnetometer.csv": still(20.0, 0.0, -40.0),
        "Barometer.csv": "time,seconds_elapsed,relativeAltitude,pressure\n" + "\n".join(baro),
        "Location.csv": "time,seconds_elapsed,horizontalAccuracy,speed,bearing,altitude,longitude,"
        "latitude\n" + "\n".join(fixes),
        "Pedometer.csv": f"time,seconds_elapsed,steps\n{START_NS},0,3\n",
        "Annotation.csv": f"time,seconds_elapsed,text,millisecond_press_duration\n"
        f"{START_NS + 10**8},0.1,turned,200\n",
        "Metadata.csv": ANDROID,
    }


@pytest.mark.parametrize("kind", ["zip", "folder"])
def test_sensor_logger_gives_axes_by_name_units_and_the_gap(tmp_path: Path, kind: str) -> None:
    make = archive if kind == "zip" else folder
    path = make(tmp_path / ("walk.zip" if kind == "zip" else "walk"), walk())
    assert choose(files_of([path])).name == "phone"
    report = import_recording([path], tmp_path / "out.mcap")
    assert report.warnings == ("left alone: Pedometer",)
    assert report.labels == {"note": 1}
    with Recording.open(tmp_path / "out.mcap") as opened:
        found = {s.topic: s for s in opened.streams}
        kinds = ("acc", "baro", "fix", "gyro", "mag")
        assert sorted(found) == [f"/{k}/phone" for k in kinds]
        assert (found["/acc/phone"].rate_hz, found["/acc/phone"].placement) == (100.0, "phone")
        assert opened.labels[0].note == "turned"
        blocks = {t: [b for _, b in opened.blocks({t})] for t in found}
    times = np.concatenate([b.sample_times() for b in blocks["/acc/phone"]])
    assert np.array_equal(times - START_NS, [k * STEP_NS for k in range(100) if not 40 <= k < 50])
    np.testing.assert_allclose(blocks["/acc/phone"][0].values[0], [1.0, 2.0, 9.5])
    np.testing.assert_allclose(blocks["/gyro/phone"][0].values[0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(blocks["/mag/phone"][0].values[0], [20e-6, 0, -40e-6])
    np.testing.assert_allclose(blocks["/baro/phone"][0].values[0], [101300.0])
    np.testing.assert_allclose(blocks["/fix/phone"][0].values[0], [48.0, 11.5, 500.0, 3.5])


@pytest.mark.parametrize(("metadata", "z_mps2"), [(ANDROID, 9.5), (IOS, -9.5), (IOS_STANDARD, 9.5)])
def test_gravity_is_added_where_no_table_has_it_and_turned_on_ios(
    tmp_path: Path, metadata: str, z_mps2: float
) -> None:
    tables = {"Accelerometer.csv": still(1.0, 2.0, -0.25), "Gravity.csv": still(0.0, 0.0, 9.75)}
    found = read(archive(tmp_path / "x.zip", {**tables, "Metadata.csv": metadata}))
    ((_, blocks),) = streams(found).values()
    sign = np.sign(z_mps2)
    assert blocks[0].values[0].tolist() == [sign * 1.0, sign * 2.0, z_mps2]
    assert "acceleration is Accelerometer.csv plus Gravity.csv" in found.warnings


@pytest.mark.parametrize(("metadata", "z_mps2"), [(ANDROID, 1.0), (IOS, -9.80665)])
def test_the_uncalibrated_accelerometer_is_in_g_on_ios_only(
    tmp_path: Path, metadata: str, z_mps2: float
) -> None:
    files = {"AccelerometerUncalibrated.csv": still(0.0, 0.0, 1.0), "Metadata.csv": metadata}
    ((_, blocks),) = streams(read(archive(tmp_path / "x.zip", files))).values()
    assert blocks[0].values[0, 2] == pytest.approx(z_mps2)


def test_acceleration_without_gravity_gets_a_topic_that_says_so(tmp_path: Path) -> None:
    path = folder(tmp_path / "x", {"Accelerometer.csv": still(0.0, 0.0, 0.1)})
    found = read(path / "Accelerometer.csv")
    assert list(streams(found)) == ["/acc_linear/phone"]
    assert len(found.warnings) == 2


def test_late_and_repeated_rows_are_put_right_and_counted(tmp_path: Path) -> None:
    places = [0, 1, 3, 2, 4, 4, 5]
    table = logger((k, float(k), 0.0, 0.0) for k in places)
    files = {"Gyroscope.csv": table, "Metadata.csv": ANDROID}
    found = read(archive(tmp_path / "x.zip", files))
    (block,) = streams(found)["/gyro/phone"][1]
    assert block.values[:, 0].tolist() == [0, 1, 2, 3, 4, 5]
    assert found.warnings == (
        "/gyro/phone: 1 times go back, by up to 0.01 s: sorted by time",
        "/gyro/phone: 1 samples come twice: one kept",
    )


CLOCK = (
    '"event","experiment time","system time","system time text"\n'
    '"START",0.000000000E0,1714521600.250,"2024-05-01 02:00:00.250 UTC+02:00"\n'
    '"PAUSE",5.000000000E-1,1714521600.750,"..."\n'
    '"START",5.000000000E-1,1714521610.000,"..."\n'
    '"PAUSE",1.000000000E0,1714521610.500,"..."\n'
)


def phyphox(name: str, unit: str, delimiter: str = ",", decimal: str = ".") -> str:
    head = ["Time (s)", *(f"{name} {a} ({unit})" for a in "xyz"), f"Absolute {name} ({unit})"]
    lines = [delimiter.join(f'"{c}"' for c in head)]
    for k in range(100):
        cells = [f"{v:.9E}".replace(".", decimal) for v in (k / 100, 1.5, -2.5, 9.5, 10.0)]
        lines.append(delimiter.join(cells))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ",")])
def test_phyphox_is_read_with_every_separator_and_keeps_its_pause(
    tmp_path: Path, delimiter: str, decimal: str
) -> None:
    files = {
        "Accelerometer.csv": phyphox("Acceleration", "m/s^2", delimiter, decimal),
        "Linear Acceleration.csv": phyphox("Linear Acceleration", "m/s^2", delimiter, decimal),
        "Gyroscope.csv": phyphox("Gyroscope", "rad/s", delimiter, decimal),
        "Magnetometer.csv": phyphox("Magnetic field", "µT", delimiter, decimal),
        "meta/time.csv": CLOCK,
        "meta/device.csv": '"property","value"\n"version","1.1.14"\n',
    }
    path = archive(tmp_path / "walk.zip", files)
    assert choose([path]).name == "phone"
    found = read(path)
    assert found.warnings == ()
    have = streams(found)
    assert sorted(have) == ["/acc/phone", "/acc_linear/phone", "/gyro/phone", "/mag/phone"]
    stream, blocks = have["/acc/phone"]
    assert stream.rate_hz == 100.0
    assert [len(b) for b in blocks] == [50, 50]
    assert blocks[0].values[0].tolist() == [1.5, -2.5, 9.5]
    assert [b.start_ns for b in blocks] == [1_714_521_600_250_000_000, 1_714_521_610_000_000_000]
    np.testing.assert_allclose(have["/mag/phone"][1][0].values[0], [1.5e-6, -2.5e-6, 9.5e-6])


def test_phyphox_is_known_by_units_where_words_are_of_another_language(tmp_path: Path) -> None:
    text = phyphox("Beschleunigung", "m/s^2").replace("Time (s)", "Zeit (s)")
    path = folder(tmp_path / "x", {"Raw Data.csv": text, "meta/time.csv": CLOCK})
    assert choose(files_of([path])).name == "phone"
    found = read(*files_of([path]))
    assert (list(streams(found)), found.start_ns) == (["/acc/phone"], 1_714_521_600_250_000_000)


def test_a_table_of_places_is_a_fix(tmp_path: Path) -> None:
    head = '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Velocity (m/s)"\n'
    (tmp_path / "Location.csv").write_text(head + "0,48.1,11.5,500,1\n1,48.2,11.5,501,1\n")
    found = read(tmp_path / "Location.csv")
    assert list(streams(found)) == ["/fix/phone"]
    assert len(found.sources[0][0].channels) == 3
    assert "no meta/time.csv: times count from the start of the experiment" in found.warnings


def test_a_fix_says_how_exact_it_is(tmp_path: Path) -> None:
    head = '"Time (s)","Latitude (°)","Longitude (°)","Height (m)","Horizontal Accuracy (m)"\n'
    (tmp_path / "Location.csv").write_text(head + "0,48.1,11.5,500,4.5\n1,48.2,11.5,501,6\n")
    stream, _, blocks = read(tmp_path / "Location.csv").sources[0]
    (column,) = stream.columns_of({"horizontal_accuracy"})
    assert np.concatenate([b.values[:, column] for b in blocks]).tolist() == [4.5, 6.0]


def test_other_tables_and_archives_are_not_phones(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,ax\n0,1\n1,2\n")
    archive(tmp_path / "x.zip", {"x.csv": "t,ax\n0,1\n"})
    for name in ("x.csv", "x.zip"):
        assert PhoneImporter().sniff(tmp_path / name) == 0
        with pytest.raises(FormatError, match="expected CSV tables of Sensor Logger or phyphox"):
            read(tmp_path / name)


def test_a_wrong_cell_is_named_by_file_line_and_column(tmp_path: Path) -> None:
    text = still(0.0, 0.0, 1.0).replace("1.0", "one", 1)
    path = archive(tmp_path / "x.zip", {"Gyroscope.csv": text})
    with pytest.raises(SchemaError, match=r"Gyroscope\.csv: line 2: z: expected a number"):
        read(path)


def test_an_archive_cut_short_is_refused_in_one_line(tmp_path: Path) -> None:
    path = archive(tmp_path / "x.zip", walk())
    path.write_bytes(path.read_bytes()[:800])
    with pytest.raises(FormatError, match=r"^x\.zip: expected a whole archive, found: [^\n]+$"):
        read(path)


def test_an_archive_with_a_name_that_is_no_text_is_refused_in_one_line(tmp_path: Path) -> None:
    path = archive(tmp_path / "x.zip", {"Gyroscopé.csv": still(0.0, 0.0, 1.0)})
    path.write_bytes(path.read_bytes().replace("é".encode(), b"\xc8\x41"))
    with pytest.raises(FormatError, match=r"^x\.zip: expected a whole archive, found: [^\n]+$"):
        read(path)


@settings(max_examples=examples(80), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 1500), value=st.integers(0, 255))
def test_a_changed_byte_of_an_archive_gives_samples_or_the_importers_own_error(
    tmp_path: Path, place: int, value: int
) -> None:
    files = {"Gyroscope.csv": still(0.0, 0.0, 1.0), "Metadata.csv": ANDROID}
    data = bytearray(archive(tmp_path / "x.zip", files).read_bytes())
    data[place % len(data)] = value
    (tmp_path / "x.zip").write_bytes(data)
    try:
        assert streams(read(tmp_path / "x.zip"))
    except CodecError as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)


@settings(max_examples=examples(100), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    head=st.sampled_from(
        [b"", b"time,seconds_elapsed,z,y,x\n", b'"Time (s)","Gyroscope x (rad/s)"\n', b"PK\3\4"]
    ),
    body=st.binary(max_size=100) | st.text("0123456789,.eE+-nanif\n", max_size=60).map(str.encode),
    name=st.sampled_from(["Gyroscope.csv", "x.zip"]),
)
def test_any_bytes_give_samples_or_the_importers_own_error(
    tmp_path: Path, head: bytes, body: bytes, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(head + body)
    PhoneImporter().sniff(path)
    try:
        assert streams(read(path))
    except CodecError as error:
        assert "\n" not in str(error)  # noqa: PT017 (either outcome is right)
