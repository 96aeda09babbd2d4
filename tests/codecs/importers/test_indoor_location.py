"""Traces of the Indoor Location Competition 2.0."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace_codecs.errors import FormatError, SchemaError
from groundtrace_codecs.importers.phone_logs import IndoorLocationImporter
from groundtrace_codecs.importers.run import choose, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

START_MS = 1_574_576_411_000
HEAD = f"#\tstartTime:{START_MS}\n#\tSiteName:somewhere\tFloorName:B1\n"


def line(after_ms: int, kind: str, *values: float | str) -> str:
    return "\t".join([str(START_MS + after_ms), kind, *map(str, values)]) + "\n"


def trace(folder: Path, *, more: str = "", head: str = HEAD) -> Path:
    rows = [line(5, "TYPE_WAYPOINT", 111.03, 109.58)]
    for k in range(50):
        at = 20 * k + (k % 3)
        rows += [
            line(at, "TYPE_ACCELEROMETER", 0.1, 0.2, 9.8, 3),
            line(at, "TYPE_GYROSCOPE", 0.01 * k, 0.0, 0.0, 3),
            line(at, "TYPE_MAGNETIC_FIELD", 30.0, 0.0, -40.0, 3),
            line(at, "TYPE_ROTATION_VECTOR", 0.0, 0.0, 0.0),
        ]
    rows.append(line(990, "TYPE_WAYPOINT", 112.0, 110.0))
    path = folder / "trace.txt"
    path.write_text(head + "".join(rows) + more, encoding="utf-8")
    return path


def test_a_trace_becomes_three_streams_of_a_phone_with_waypoints(tmp_path: Path) -> None:
    out = tmp_path / "trace.mcap"
    report = import_recording([trace(tmp_path)], out)
    assert (report.importer, report.labels) == ("indoor-location", {"waypoint": 2})
    with Recording.open(out) as opened:
        streams = {s.topic: s for s in opened.streams}
        assert sorted(streams) == ["/acc/phone", "/gyro/phone", "/mag/phone"]
        assert {s.placement for s in streams.values()} == {"phone"}
        assert [(x.x_m, x.y_m) for x in opened.labels] == [(111.03, 109.58), (112.0, 110.0)]
        assert opened.labels[0].time_ns == (START_MS + 5) * 1_000_000
        assert opened.geometry is not None
        assert opened.geometry.start == (111.03, 109.58)


def test_the_field_comes_in_tesla_and_every_sample_at_its_time(tmp_path: Path) -> None:
    found = IndoorLocationImporter().read([trace(tmp_path)], None)
    stream, _, blocks = next(s for s in found.sources if s[0].topic == "/mag/phone")
    (block,) = blocks
    assert [c.unit for c in stream.channels] == ["T", "T", "T"]
    np.testing.assert_allclose(block.values[0], [30e-6, 0, -40e-6], rtol=1e-6)
    assert len(block) == 50
    apart = np.abs(block.sample_times() - START_MS * 1_000_000 - 20_000_000 * np.arange(50))
    assert apart.max() <= 2_000_000


def test_a_trace_is_known_by_its_first_line(tmp_path: Path) -> None:
    assert choose([trace(tmp_path)]).name == "indoor-location"
    other = tmp_path / "other.txt"
    other.write_text("a\tb\n1\t2\n")
    assert IndoorLocationImporter().sniff(other) == 0


def test_a_trace_without_waypoints_starts_nowhere(tmp_path: Path) -> None:
    path = trace(tmp_path)
    kept = [x for x in path.read_text().splitlines(keepends=True) if "WAYPOINT" not in x]
    path.write_text("".join(kept))
    found = IndoorLocationImporter().read([path], None)
    assert (found.labels, found.geometry) == ((), None)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (line(1000, "TYPE_GYROSCOPE", 1, 2), "expected 3 values, found 2"),
        (line(1000, "TYPE_WAYPOINT", "x", 2), "expected numbers"),
        ("9" * 18 + "\tTYPE_WAYPOINT\t1\t2\n", "expected a time since 1970, found 9"),
        ("-1\tTYPE_WAYPOINT\t1\t2\n", "expected a time since 1970, found -1"),
    ],
)
def test_a_broken_line_is_left_out_and_counted(tmp_path: Path, more: str, words: str) -> None:
    found = IndoorLocationImporter().read([trace(tmp_path, more=more)], None)
    assert len(found.labels) == 2
    (warning,) = found.warnings
    assert warning.startswith(f"1 broken line was left out: line 205: {words}")


def test_a_file_without_an_accelerometer_is_no_trace(tmp_path: Path) -> None:
    path = tmp_path / "empty.txt"
    path.write_text(HEAD)
    with pytest.raises(FormatError, match="expected TYPE_ACCELEROMETER lines"):
        IndoorLocationImporter().read([path], None)


def test_two_traces_are_not_one_recording(tmp_path: Path) -> None:
    path = trace(tmp_path)
    with pytest.raises(SchemaError, match="expected one trace"):
        IndoorLocationImporter().read([path, path], None)
