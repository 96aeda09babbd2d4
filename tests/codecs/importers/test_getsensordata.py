"""Logs of GetSensorData."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.errors import FormatError, SchemaError
from groundtrace_codecs.geometry import metres_per_radian
from groundtrace_codecs.importers.base import ImportMap
from groundtrace_codecs.importers.phone_logs import GetSensorDataImporter
from groundtrace_codecs.importers.run import choose, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

#: 2023-06-14T08:00:58Z.
START_NS = 1_686_729_658_000_000_000
#: The sensors' clock began so much earlier than the log [s].
UP_S = 65_093.5
DATE = "% Date of creation: Wed Jun 14 10:00:58 GMT+02:00 2023\n"
HEAD = (
    "% LogFile created by the 'GetSensorData' App for Android.\n"
    "% Accelerometer data: 'ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);"
    "Acc_Z(m/s^2);Accuracy(integer)'\n"
    "% Magnetometer data: 'MAGN;AppTimestamp(s);SensorTimestamp(s);Mag_X(uT);;Mag_Y(uT);Mag_Z(uT);"
    "Accuracy(integer)'\n"
    "% Pressure data: 'PRES;AppTimestamp(s);SensorTimestamp(s);Pres(mbar);Accuracy(integer)'\n"
    "% GNSS/GPS data: 'GNSS;AppTimestamp(s);SensorTimeStamp(s);Latit(deg);Long(deg);Altitude(m);"
    "Bearing(deg);Accuracy(m);Speed(m/s);SatInView;SatInUse'\n"
    "% POSI Reference: 'POSI;Timestamp(s);Counter;Latitude(degrees); Longitude(degrees);"
    "floor ID(0,1,2..4);Building ID(0,1,2..3);'\n"
)


def log(folder: Path, *, date: str = DATE, head: str = HEAD, more: str = "") -> Path:
    """Five seconds at 50 Hz; what the app is told is 2 to 6 ms late."""
    rows = ["POSI;0.5;1;49.4600;11.1100;0;100\n"]
    for k in range(250):
        at, late = 0.02 * k, 0.002 * (1 + k % 3)
        rows.append(f"ACCE;{at + late:.4f};{UP_S + at:.4f};0.1;0.2;9.8;3\n")
        rows.append(f"MAGN;{at + late:.4f};{UP_S + at:.4f};20.0;0.0;-40.0;0\n")
        rows.append(f"WIFI;{at:.4f};1.0;a;b;2412;-60\n")
    for k in range(5):
        rows.append(f"PRES;{k + 0.01:.4f};{UP_S + k:.4f};976.{k}000;3\n")
        # two listeners are told of each fix
        fix = f"{1_686_729_640 + k};49.46;11.11;346.0;0.0;{8.0 + k};0.0;12;9\n"
        rows += [f"GNSS;{k + 0.9:.4f};{fix}", f"GNSS;{k + 0.95:.4f};{fix}"]
    rows.append("POSI;4.5;2;49.4601;11.1102;-2;100\n")
    path = folder / "log.txt"
    path.write_text(head + date + "".join(rows) + more, encoding="utf-8")
    return path


def test_a_log_becomes_streams_of_a_phone_with_waypoints_on_the_earth(tmp_path: Path) -> None:
    out = tmp_path / "log.mcap"
    report = import_recording([log(tmp_path)], out)
    assert (report.importer, report.labels) == ("getsensordata", {"waypoint": 2})
    assert "lines of other kinds, left out: 250 WIFI" in report.remarks
    with Recording.open(out) as opened:
        streams = {s.topic: s for s in opened.streams}
        assert sorted(streams) == ["/acc/phone", "/baro/phone", "/fix/phone", "/mag/phone"]
        assert opened.geometry is not None
        assert opened.geometry.origin == (49.46, 11.11, 0.0)
        assert opened.geometry.start is None  # nobody says that the walk began there
        first, last = opened.labels
        east, north = metres_per_radian(math.radians(49.46))
        assert (first.x_m, first.y_m) == (0.0, 0.0)
        assert last.x_m == pytest.approx(east * math.radians(0.0002))
        assert last.y_m == pytest.approx(north * math.radians(0.0001))
        assert last.note == "floor -2, building 100"
        assert last.time_ns == START_NS + 4_500_000_000


def test_samples_lie_at_the_sensors_times_on_the_apps_clock(tmp_path: Path) -> None:
    found = GetSensorDataImporter().read([log(tmp_path)], None)
    times = {
        stream.topic: np.concatenate([b.sample_times() for b in blocks])
        for stream, _, blocks in found.sources
    }
    since_ms = (times["/acc/phone"] - START_NS) / 1e6
    np.testing.assert_allclose(since_ms, 20.0 * np.arange(250) + 4.0, atol=0.2)
    np.testing.assert_allclose((times["/baro/phone"] - START_NS) / 1e6, 1e3 * np.arange(5) + 4.0)
    # fixes have clocks of their own: each lies where the app was told of it, once
    np.testing.assert_allclose((times["/fix/phone"] - START_NS) / 1e9, np.arange(5) + 0.9)


def test_fixes_say_how_exact_they_are(tmp_path: Path) -> None:
    out = tmp_path / "log.mcap"
    import_recording([log(tmp_path)], out)
    with Recording.open(out) as opened:
        blocks = [b for _, b in opened.blocks(["/fix/phone"])]
        (column,) = blocks[0].stream.columns_of({"horizontal_accuracy"})
        accuracy_m = np.concatenate([b.values[:, column] for b in blocks])
        np.testing.assert_allclose(accuracy_m, 8.0 + np.arange(5))


def test_a_phone_that_knows_one_place_alone_has_one_fix(tmp_path: Path) -> None:
    stuck = "".join(f"GNSS;{k};1686729640;49.46;11.11;346.0;0.0;8.0;0.0;12;9\n" for k in range(4))
    path = log(tmp_path)
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(x for x in lines if not x.startswith("GNSS")) + stuck)
    sources = {s[0].topic: s[2] for s in GetSensorDataImporter().read([path], None).sources}
    assert sum(len(block) for block in sources["/fix/phone"]) == 1


def test_a_log_whose_date_is_in_no_known_zone_begins_at_zero(tmp_path: Path) -> None:
    date = "% Date of creation: Wed Jun 14 10:00:58 CEST 2023\n"
    found = GetSensorDataImporter().read([log(tmp_path, date=date)], None)
    assert found.warnings == ("time zone CEST: times count from the start of the log",)
    assert 0 <= found.start_ns < 1e9
    nothing = GetSensorDataImporter().read([log(tmp_path, date="")], None)
    assert nothing.warnings == ("no date of creation: times count from the start of the log",)


def test_a_log_that_is_cut_short_loses_its_last_line_alone(tmp_path: Path) -> None:
    found = GetSensorDataImporter().read([log(tmp_path, more="ACCE;5.0023;65098.5;0.1;0")], None)
    assert len(found.warnings) == 1
    assert found.warnings[0].startswith("1 broken line was left out: line 775: expected 4 values")


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    path = log(tmp_path)
    assert choose([path]).name == "getsensordata"
    with pytest.raises(SchemaError, match="expected one log, found 2 files: import each by itself"):
        GetSensorDataImporter().read([path, path], None)
    map_ = ImportMap("csv", (), file="m.toml")
    with pytest.raises(SchemaError, match=r"m.toml: expected no map for a log of a phone"):
        GetSensorDataImporter().read([path], map_)
    empty = tmp_path / "empty.txt"
    empty.write_text(HEAD)
    with pytest.raises(FormatError, match=r"empty.txt: expected ACCE lines, found none"):
        GetSensorDataImporter().read([empty], None)
