"""HDF5 files, and true headings and disturbances from a reference orientation in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np
import pytest

from groundtrace_codecs.errors import FormatError, SchemaError
from groundtrace_codecs.importers.run import choose, import_recording
from groundtrace_codecs.recording import Recording

if TYPE_CHECKING:
    from pathlib import Path

RATE_HZ = 200.0
MAP = """
format = "hdf5"
rate_hz = 200.0
orientation = {quaternion = "opt.quat", field = "mag"}
[[stream]]
topic = "/mag"
columns = [
  {column = "mag[:,0]", quantity = "magnetic_field", axis = "x", unit = "uT"},
  {column = "mag[:,1]", quantity = "magnetic_field", axis = "y", unit = "uT"},
  {column = "mag[:,2]", quantity = "magnetic_field", axis = "z", unit = "uT"},
]
"""


@pytest.fixture
def made(tmp_path: Path) -> tuple[Path, Path]:
    """A sensor that turns about the vertical, its field 3 samples late, disturbed from 4 to 5 s."""
    t = np.arange(2000) / RATE_HZ
    yaw = 0.6 * np.sin(3 * t) + 0.5
    quat = np.stack([np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)], axis=1)
    late = np.roll(yaw, 3)
    field = np.stack([18 * np.sin(late), 18 * np.cos(late), np.full(2000, -40.0)], axis=1)
    field[(t >= 4) & (t < 5), 2] += 12.0
    quat[1600:1700] = np.nan
    path, map_ = tmp_path / "trial.hdf5", tmp_path / "map.toml"
    with h5py.File(path, "w") as file:
        file["mag"] = field
        file["opt/quat"] = quat
    map_.write_text(MAP)
    return path, map_


def imported(made: tuple[Path, Path], tmp_path: Path) -> Recording:
    out = tmp_path / "out.mcap"
    import_recording([made[0]], out, map_path=made[1])
    return Recording.open(out)


def test_headings_are_those_of_the_sensor_axis(made: tuple[Path, Path], tmp_path: Path) -> None:
    with imported(made, tmp_path) as recording:
        found = [x for x in recording.labels if x.kind == "heading"]
    times = np.array([x.time_ns for x in found]) / 1e9
    assert np.allclose([x.value for x in found], 0.6 * np.sin(3 * times) + 0.5, atol=1e-9)
    assert len(found) == 475  # 50 a second for 10 s, without half a second of blindness


def test_the_disturbed_span_is_found_though_the_field_comes_late(
    made: tuple[Path, Path], tmp_path: Path
) -> None:
    with imported(made, tmp_path) as recording:
        (span,) = [x for x in recording.labels if x.kind == "disturbed"]
        (blind,) = [x for x in recording.labels if x.kind == "ignore"]
    assert span.time_ns / 1e9 == pytest.approx(4.0, abs=0.06)
    assert (span.end_ns or 0) / 1e9 == pytest.approx(5.0, abs=0.06)
    assert span.value == pytest.approx(12e-6, rel=0.05)
    assert (blind.time_ns, blind.end_ns) == (8_000_000_000, 8_500_000_000)


def test_an_orientation_of_another_length_is_refused(
    made: tuple[Path, Path], tmp_path: Path
) -> None:
    with h5py.File(made[0], "a") as file:
        del file["opt/quat"]
        file["opt/quat"] = np.zeros((5, 4))
    with pytest.raises(SchemaError, match=r"opt\.quat: expected 2000 rows of 4, found \(5, 4\)"):
        imported(made, tmp_path)


def test_hdf5_is_known_by_its_signature(made: tuple[Path, Path]) -> None:
    assert choose([made[0]]).name == "hdf5"


def test_damaged_bytes_are_one_line(made: tuple[Path, Path], tmp_path: Path) -> None:
    made[0].write_bytes(made[0].read_bytes()[:3000])
    with pytest.raises(FormatError, match=r"trial\.hdf5: expected an HDF5 file, found"):
        imported(made, tmp_path)
