"""What a replay says of time in which nothing was recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done

if TYPE_CHECKING:
    from pathlib import Path

MAP = """format = "csv"
time = {column = "t", unit = "s"}
[[stream]]
topic = "/imu"
placement = "waist"
columns = [
  {column = "x", quantity = "acceleration", unit = "m/s2", axis = "x"},
  {column = "y", quantity = "acceleration", unit = "m/s2", axis = "y"},
  {column = "z", quantity = "acceleration", unit = "m/s2", axis = "z"},
]
"""


def imported(folder: Path, capsys: pytest.CaptureFixture[str], lost: tuple[float, ...]) -> None:
    """Write a recording of 20 s at 50 Hz without the samples within some spans."""
    times = np.arange(1000) / 50
    heard = np.ones(1000, bool)
    for start, stop in zip(lost[::2], lost[1::2], strict=True):
        heard &= ~((times >= start) & (times < stop))
    rows = [f"{t:.2f},0,0,{9.81 + np.sin(12 * t):.4f}" for t in times[heard]]
    (folder / "t.csv").write_text("\n".join(["t,x,y,z", *rows]) + "\n")
    (folder / "m.toml").write_text(MAP)
    done(capsys, "import", folder / "t.csv", "--map", folder / "m.toml", "-o", folder / "t.mcap")


def test_time_that_is_lost_is_said_by_topic_and_what_is_filled_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    imported(tmp_path, capsys, (4.0, 5.0, 8.0, 8.1, 12.0, 13.5))
    replay = ("replay", tmp_path / "t.mcap", "--pipeline", "waist-peaks", "--no-viewer", "--force")
    assert "not recorded: 2.5 s of /imu, in gaps" in done(capsys, *replay).out
    ran = done(capsys, *replay, "--json")
    check_schema("replay", ran.document)
    assert ran.document["lost_s"] == {"/imu": pytest.approx(2.5, abs=0.02)}


def test_nothing_is_said_where_all_gaps_are_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    imported(tmp_path, capsys, (8.0, 8.1))
    ran = done(
        capsys, "replay", tmp_path / "t.mcap", "--pipeline", "waist-peaks", "--no-viewer", "--force"
    )
    assert "not recorded" not in ran.out
