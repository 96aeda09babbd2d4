"""Other tools read our files: Rerun checks and converts them and draws previews by itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from groundtrace_codecs.events import Label, Note, StepEvent
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_codecs.writer import RecordingWriter

START_NS = 1_700_000_000_000_000_000
SEISMIC = Stream("/seismic", tuple(Channel(f"G{i}", "seismic", "count") for i in range(2)), 2000.0)
MOTION = tuple(
    Channel(f"{name}_{axis}", quantity, unit, axis)
    for name, quantity, unit in (
        ("acc", "acceleration", "m/s2"),
        ("gyro", "angular_velocity", "rad/s"),
    )
    for axis in "xyz"
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "rec.mcap"
    random = np.random.default_rng(1)
    streams = (
        (SEISMIC, "i16le"),
        (Stream("/imu/waist", MOTION, 100.0, "waist"), "f32le"),
        (Stream("/imu/foot", MOTION, 1000.0, "foot"), "f32le"),
    )
    with RecordingWriter(path) as writer:
        writer.set_geometry(Geometry((Sensor("g0", "G0", 1.0, 2.0),)))
        for stream, sample_format in streams:
            writer.add_stream(stream, sample_format)
            shape = (int(stream.rate_hz), len(stream.channels))
            samples = random.integers(-99, 99, shape).astype(np.int16)
            writer.write(SignalBlock(stream, START_NS, 0, samples))
        writer.add_labels([Label(START_NS, "step")])
        writer.add_event(StepEvent(START_NS, "step", "left", "/seismic", "zc", 1.0))
        writer.add_event(Note(START_NS, "hello"))
    return path


def rerun(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the rerun of this interpreter; CI=1 keeps it from calling home."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    program = Path(sys.executable).with_name("rerun")
    return subprocess.run(
        [program, *arguments],
        env={**os.environ, "CI": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_rerun_finds_nothing_wrong_with_our_files(written: Path) -> None:
    done = rerun("mcap", "check", written)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if " /" in line and "Chunks" not in line]
    rows = [line for line in lines if not line.startswith("/")]
    assert len(rows) == 10, done.stdout
    assert all(line.split()[0] == "ok" for line in rows), done.stdout


def test_rerun_draws_envelope_and_imu_as_scalars_and_steps_as_text(written: Path) -> None:
    target = written.with_suffix(".rrd")
    done = rerun("mcap", "convert", written, "-o", target)
    assert done.returncode == 0, done.stderr
    import rerun as rr

    rows: dict[tuple[str, str], int] = {}
    for chunk in rr.chunk.RrdReader(str(target)).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            key = (str(chunk.entity_path), name)
            rows[key] = rows.get(key, 0) + batch.num_rows
    drawn = {path: n for (path, name), n in rows.items() if name.startswith("Scalars")}
    assert drawn == {"/seismic/envelope": 100, "/imu/waist": 100, "/imu/foot/preview": 100}
    assert any(path == "/groundtrace/log" and n.startswith("TextLog") for path, n in rows)
    assert any(path == "/tf_static" and n.startswith("Transform3D") for path, n in rows)
