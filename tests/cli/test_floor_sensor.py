"""One cheap sensor on a floor, from a table to the reason of a missed step, as a user meets it."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import done, run

if TYPE_CHECKING:
    from pathlib import Path

MAP = """format = "csv"
rate_hz = {rate}
[[stream]]
topic = "/floor"
placement = "{placement}"
columns = [{{column = "v", quantity = "{quantity}", axis = "z", unit = "m/s2"}}]
"""
RATE_HZ = 200
STEPS_S = np.arange(3.0, 18.0, 0.6)
Capture = pytest.CaptureFixture[str]


def table(folder: Path, placement: str, quantity: str, hum: float = 0.0) -> list[Path | str]:
    """A walk in noise, one step of it hardly there; how it is imported."""
    t = np.arange(20 * RATE_HZ) / RATE_HZ
    signal = 0.01 * np.random.default_rng(3).standard_normal(len(t))
    signal += hum * np.sin(2 * np.pi * 60 * t)
    for k, at_s in enumerate(STEPS_S):
        height = 0.032 if k == 7 else 0.08
        swing = np.sin(2 * np.pi * 18 * (t - at_s)) * np.exp(-(((t - at_s) / 0.05) ** 2))
        signal += height * swing
    (folder / "floor.csv").write_text("v\n" + "\n".join(f"{v:.5f}" for v in signal) + "\n")
    text = MAP.format(rate=float(RATE_HZ), placement=placement, quantity=quantity)
    (folder / "map.toml").write_text(text)
    rows = "".join(f"{at_s:.3f},step\n" for at_s in STEPS_S)
    (folder / "truth.csv").write_text("time_s,kind\n" + rows)
    return ["import", "floor.csv", "--map", "map.toml", "--truth", "truth.csv", "--out", "f.mcap"]


def test_the_next_commands_lead_to_the_reason_of_the_missed_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    done(capsys, *table(tmp_path, "", "ground_acceleration"))
    ran = done(capsys, "info", "f.mcap")
    following = ran.out.splitlines()[-1].removeprefix("next: groundtrace ")
    assert following == "replay f.mcap --pipeline floor-steps"
    done(capsys, *shlex.split(following), "--no-viewer")
    score = done(capsys, "score", "f.results.mcap").out
    assert score.startswith("steps: 24 of 25 found, 0 false")
    why = done(capsys, "why", "f.results.mcap").out
    (row,) = [line for line in why.splitlines() if line.startswith("8 ")]
    assert "threshold" in row
    assert "v ratio" in row
    assert "--set picks.ratio=" in row


def test_a_floor_s_placement_suggests_it_without_any_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    command = table(tmp_path, "floor", "ground_acceleration")
    done(capsys, *command[:4], "--out", "f.mcap")
    last = done(capsys, "info", "f.mcap").out.splitlines()[-1]
    assert last == "next: groundtrace replay f.mcap --pipeline floor-steps"


def test_a_floor_s_acceleration_by_a_worn_sensor_s_name_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    done(capsys, *table(tmp_path, "floor", "acceleration"))
    ran = run(capsys, "replay", "f.mcap", "--pipeline", "floor-steps", "--no-viewer")
    said = ran.err
    assert ran.code == 1
    assert "floor-steps needs 1 or more seismic channels; f.mcap has acceleration" in said
    assert said.rstrip().endswith(
        "Of a sensor on a floor the quantity is ground_acceleration: say so in its map."
    )


def test_no_band_above_hum_is_advised_that_the_rate_does_not_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    done(capsys, *table(tmp_path, "floor", "ground_acceleration", hum=0.1))
    (line,) = [x for x in done(capsys, "info", "f.mcap").out.splitlines() if "hum at 60.0" in x]
    assert "low_hz" not in line
    assert "floor-steps finds steps at the frequencies beside it" in line
    done(capsys, "replay", "f.mcap", "--no-viewer")
    assert done(capsys, "score", "f.results.mcap").out.startswith("steps: 24 of 25 found")
