"""Lengths of steps calibrated by a walk of known distance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import check_schema, done, run

from groundtrace.inertial.length_calibration import calibrate_lengths
from groundtrace.inertial.steps import ReckoningParameters

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_known_distance_makes_other_walks_of_the_person_right(
    capsys: pytest.CaptureFixture[str],
) -> None:
    simulate = ("simulate", "walk", "--person", "4")
    done(capsys, *simulate, "--path", "l", "--seed", "31", "-o", "known.mcap")
    done(capsys, *simulate, "--path", "loop", "--seed", "32", "-o", "other.mcap")
    found = done(capsys, "calibrate", "known.mcap", "--distance", "35", "--json").document
    check_schema("calibrate-distance", found)
    assert [one["model"] for one in found["models"]][-1] == "fused"
    constants = found["models"][-1]["constants"]
    told = [f"--set=track.{name}={value}" for name, value in constants.items()]
    again = done(capsys, "calibrate", "other.mcap", "--distance", "64", "--json").document
    # the other walk, calibrated by itself, has the same constants
    for name, value in again["models"][-1]["constants"].items():
        assert value == pytest.approx(constants[name], rel=0.02)
    done(capsys, "replay", "other.mcap", "--pipeline", "pedestrian", "--no-viewer", *told)
    text = done(capsys, "calibrate", "known.mcap", "--distance", "35").out
    assert "use it with: groundtrace replay REC.mcap --pipeline pedestrian --set track." in text


def test_every_model_comes_to_the_distance_but_for_the_ends_of_walks() -> None:
    rng = np.random.default_rng(0)
    count = 40
    time_s = np.cumsum(np.full(count, 0.5)) + np.where(np.arange(count) >= 20, 10.0, 0.0)
    measures = rng.uniform((1.8, 4.0, 0.02, 0.15), (2.0, 6.0, 0.04, 0.25), (count, 4))
    steps = np.column_stack([time_s, measures])
    found = calibrate_lengths(steps, 36.0, ReckoningParameters())
    assert found.length_m == pytest.approx(36.0 / (count - 4 + 4 * 0.25))
    constants = {one.model: one.constants for one in found.models}
    assert constants["fixed"]["length_m"] == pytest.approx(found.length_m)
    parts = np.ones(count)
    parts[[0, 19, 20, 39]] = 0.25
    weinberg = constants["weinberg"]["weinberg"] * measures[:, 1] ** 0.25
    assert weinberg @ parts == pytest.approx(36.0)


def test_a_recording_without_steps_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    done(capsys, "simulate", "room", "--duration-s", "4", "-o", "room.mcap")
    said = run(capsys, "calibrate", "room.mcap", "--distance", "35").error
    assert said.startswith("room.mcap: expected steps of dead reckoning, found none")
