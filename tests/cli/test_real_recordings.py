"""The main job on real recordings: import, replay, score, by the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from first_breaks import errors_of

from groundtrace.cli.main import main


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """Run a command with --json; return its document."""
    capsys.readouterr()
    main([*map(str, arguments), "--json"])
    return json.loads(capsys.readouterr().out)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("subject", "least_f1"), [("HA", 0.80), ("MS", 0.78)])
def test_steps_of_a_waist_recording_are_found_far_above_chance(
    subject: str, least_f1: float, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data / "mobgap" / subject / "001" / "data.mat"
    imported = run(capsys, "import", source, "-o", "rec.mcap", "--map", "mobgap-test11")
    assert imported["labels"]["walking"] == 6
    run(capsys, "replay", "rec.mcap", "--pipeline", "waist-steps", "--no-viewer", "--out", "r.mcap")
    steps = run(capsys, "score", "r.mcap")["steps"]
    assert steps["f1"] >= least_f1
    assert steps["f1"] > max(steps["chance_f1"], steps["chance_f1_metronome"]) + 0.3
    assert abs(steps["count_error_signed"]) <= 0.12 * steps["count_truth"]


@pytest.mark.parametrize(
    ("line", "hand_picks", "median_ms"),
    [("field_example_01", 120, 1.0), ("field_example_02", 207, 1.8)],
)
def test_first_breaks_of_a_refraction_line_answer_the_hand_picks(
    line: str,
    hand_picks: int,
    median_ms: float,
    data: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("obspy")
    folder = data / "refrapy-seg2" / line
    truth = folder / "picks" / f"{line}.sgt"
    imported = run(capsys, "import", folder / "data", "-o", "line.mcap", "--truth", truth)
    assert imported["labels"]["pick"] == hand_picks
    run(
        capsys,
        "replay",
        "line.mcap",
        "--pipeline",
        "hammer-shots",
        "--no-viewer",
        "--out",
        "r.mcap",
    )
    picks = run(capsys, "score", "r.mcap")["picks"]["all"]
    assert picks["answered_fraction"] >= 0.95
    assert picks["median_abs_ms"] <= median_ms
    assert picks["earliest_ms"] > -20


@pytest.mark.parametrize("line", ["field_example_01", "field_example_02"])
def test_first_breaks_are_no_worse_than_plain_aic_and_claim_what_they_err(
    line: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rival has the whole trace, or its first 0.15 s, which fits these lines."""
    pytest.importorskip("obspy")
    folder = data / "refrapy-seg2" / line
    truth = folder / "picks" / f"{line}.sgt"
    run(capsys, "import", folder / "data", "-o", "line.mcap", "--truth", truth)
    found = errors_of(Path("line.mcap"))
    own_ms = np.abs(found.error_s) * 1e3
    for error_s in found.rivals.values():
        rival_ms = np.abs(error_s) * 1e3
        assert np.median(own_ms) <= np.median(rival_ms)
        assert np.percentile(own_ms, 95) <= np.percentile(rival_ms, 95)
    ratio = np.abs(found.error_s / found.sigma_s)
    assert 0.6 <= np.mean(ratio < 1) <= 0.8
    assert np.mean(ratio < 1.645) >= 0.8
    assert found.error_s.min() > -0.02


def test_a_robot_recording_of_another_tool_opens_untouched(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = data / "robot-localization" / "robot_localization_test1.mcap"
    found = run(capsys, "info", path)
    imu = next(s for s in found["streams"] if s["topic"] == "/imu/data")
    assert imu["samples"] == 11864
    assert imu["rate_hz"] == pytest.approx(30, abs=0.1)
    assert [other["topic"] for other in found["others"]] == ["/husky_velocity_controller/odom"]
    replayed = run(capsys, "replay", path, "--no-viewer", "--out", "r.mcap")
    assert replayed["events"]["steps"] < 20
