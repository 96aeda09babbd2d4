"""Feet of others: strides found, and tracks that close, through the named pipeline."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_runs import SCHEMAS, done
from jsonschema import Draft202012Validator
from scipy.io import savemat

from groundtrace.pipeline.results import read_results
from groundtrace_codecs.events import TrackPoint
from groundtrace_codecs.recording import Recording


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def imported_and_scored(capsys: pytest.CaptureFixture[str], *what: object) -> dict:
    done(capsys, "import", *what, "-o", "foot.mcap")
    asked = ("replay", "foot.mcap", "--pipeline", "foot-inertial", "--no-viewer", "--out", "r.mcap")
    ran = done(capsys, *asked, "--json").document
    truth = ("--truth", "truth.csv") if Path("truth.csv").exists() else ()
    score = done(capsys, "score", "r.mcap", "--json", *truth).document
    schema = SCHEMAS / "score.schema.json"
    Draft202012Validator(json.loads(schema.read_text("utf-8"))).validate(score)
    return {**score, "replay": ran}


@pytest.mark.parametrize(
    ("name", "strides"),
    [("2017-11-22-11-25-20", 18), ("2017-11-27-11-11-53", 17), ("SensorConnectData_34", 24)],
)
def test_walkers_and_runners_end_where_they_are_seen_to(
    name: str, strides: int, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data / "llio-pyshoe" / f"{name}_LLIO.mat"
    found = imported_and_scored(capsys, source, "--map", "llio-pyshoe")
    closure = found["track"]["closure"]
    assert closure["percent"] < 1.5
    assert closure["aligned_rmse_m"] < 0.01 * closure["walked_m"]
    text = done(capsys, "score", "r.mcap").out
    assert "turned and shifted onto the truth: RMSE" in text
    assert found["track"]["tracks"] == 1
    assert found["track"]["times"] == strides + 1


@pytest.mark.parametrize(
    ("name", "most_m"), [("SensorConnectData_38", 5.0), ("SensorConnectData_44", 2.0)]
)
def test_a_gyroscope_held_at_its_limit_is_warned_of_and_the_track_claims_no_more_than_it_knows(
    name: str, most_m: float, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = data / "llio-pyshoe" / f"{name}_LLIO.mat"
    found = imported_and_scored(capsys, source, "--map", "llio-pyshoe")
    warned = [warning["text"] for warning in found["replay"]["warnings"]]
    assert any("held at its limit for" in text and "unsure" in text for text in warned)
    with Recording.open(Path("foot.mcap")) as recording:
        last = recording.labels[-1].time_ns
    events = read_results(Path("r.mcap")).events
    points = [e for e in events if isinstance(e, TrackPoint) and e.stage == "track.smoothed"]
    end = min(points, key=lambda p: abs(p.time_ns - last))
    assert found["track"]["closure"]["aligned_end_m"] < most_m
    xx, xy, yy = end.covariance
    claimed = np.sqrt(4.605 * np.linalg.eigvalsh([[xx, xy], [xy, yy]])[-1])
    assert found["track"]["closure"]["aligned_end_m"] < claimed


def test_a_walk_that_returns_closes(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("truth.csv").write_text("time_s,kind,x_m,y_m\n1,waypoint,0,0\n41,waypoint,0,0\n")
    source = data / "xio-gait" / "short_walk.csv"
    found = imported_and_scored(capsys, source, "--map", "xio-gait")
    assert found["track"]["closure"]["percent"] < 1.5
    assert 20 < found["track"]["closure"]["walked_m"] < 28


def test_places_of_a_frame_with_z_down_come_turned_round(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    samples = np.tile([0.0, 0, 9.81, 0, 0, 0], (400, 1))
    places = {"strideIndex": np.array([0, 399]), "GCP": np.array([(1.0, 2.0), (3.0, -4.0)])}
    savemat("foot.mat", {"imu_data": samples, **places})
    done(capsys, "import", "foot.mat", "--map", "llio-pyshoe", "-o", "foot.mcap")
    with Recording.open(tmp_path / "foot.mcap") as recording:
        assert [(x.x_m, x.y_m) for x in recording.labels] == [(1.0, -2.0), (3.0, 4.0)]
