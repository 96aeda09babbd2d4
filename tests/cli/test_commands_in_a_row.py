"""Commands after each other: simulate or import, info, replay, score; and what replay leaves."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_runs import assert_same_decisions, decisions, done, run
from sweeps import swept
from truth_tables import write_truth_csv

from groundtrace.pipeline.config import load_pipeline, named_pipelines
from groundtrace.pipeline.results import read_results
from groundtrace.simulate.recording import write
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace_codecs import (
    NS_PER_S,
    Channel,
    Geometry,
    Pick,
    Recording,
    Sensor,
    SignalBlock,
    StepEvent,
    Stream,
    write_recording,
)
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Sequence

Capture = pytest.CaptureFixture[str]
WALK = path_of("waist-walk.mcap")
PASS = path_of("vehicle-pass.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording of a room, at a rate that keeps tests fast."""
    path = tmp_path_factory.mktemp("room") / "room.mcap"
    write(simulate_room(RoomOptions(seed=3, steps=6, channels=5, rate_hz=5000.0)), path)
    return path


def names() -> list[str]:
    return sorted(path.name for path in Path().iterdir())


def test_replay_alone_replays_the_bundled_walk_and_leaves_two_files(capsys: Capture) -> None:
    ran = done(capsys, "replay")
    assert "bundled walk" in ran.err
    assert names() == ["room-walk.results.mcap", "room-walk.rrd"]
    assert "20 steps" in ran.out
    assert "rerun room-walk.rrd" in ran.out
    assert Path("room-walk.rrd").stat().st_size > 100_000


def test_no_viewer_leaves_no_viewers_file(capsys: Capture) -> None:
    ran = done(capsys, "replay", WALK, "--no-viewer")
    assert names() == ["waist-walk.results.mcap"]
    assert "timeline" not in ran.out


@pytest.mark.skipif(sys.platform != "linux", reason="a display is always there")
def test_spawn_without_a_display_writes_the_file_and_says_so(
    room: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    ran = done(capsys, "replay", room, "--spawn")
    assert "no display" in ran.err
    assert names() == ["room.results.mcap", "room.rrd"]


def test_a_torn_recording_replays_and_says_what_is_damaged(capsys: Capture) -> None:
    whole = WALK.read_bytes()
    Path("torn.mcap").write_bytes(whole[: len(whole) // 2])
    replay = ("replay", "torn.mcap", "--pipeline", "waist-peaks", "--no-viewer")
    ran = done(capsys, *replay, losses=True)
    assert re.search(r"damage: \d places? skipped; see groundtrace info torn.mcap", ran.out)
    torn = decisions(Path("torn.results.mcap"))["steps"]
    done(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--out", "whole.mcap")
    found = decisions(Path("whole.mcap"))["steps"]
    kept = len(torn.times)
    assert 0.2 * len(found.times) < kept < len(found.times)
    assert np.array_equal(torn.times, found.times[:kept])
    assert "damage: " in done(capsys, "info", "torn.mcap").out


def test_from_and_to_replay_only_that_span(room: Path, capsys: Capture) -> None:
    span = ("--from", 1.0, "--to", 2.5)
    told = done(capsys, "replay", room, "--no-viewer", "--out", "r.mcap", *span, "--json").document
    assert told["recorded_s"] == pytest.approx(1.5)
    assert told["samples"] == 1.5 * 5 * 5000
    results = read_results(Path("r.mcap"))
    times = [e.time_ns for e in results.events if isinstance(e, Pick | StepEvent)]
    start_ns = results.provenance.start_ns
    assert times
    assert min(times) >= start_ns + NS_PER_S
    assert max(times) < start_ns + 2.5 * NS_PER_S


@pytest.mark.parametrize("pipeline", ["room-footsteps", "waist-steps"])
def test_a_paced_replay_takes_its_time_and_decides_the_same(
    pipeline: str, room: Path, capsys: Capture
) -> None:
    recording, rate = (room, 10.0) if pipeline == "room-footsteps" else (WALK, 100.0)
    done(capsys, "replay", recording, "--no-viewer", "--out", "fast.mcap")
    began = time.monotonic()
    paced = ("--rate", rate, "--no-viewer", "--out", "paced.mcap", "--json")
    told = done(capsys, "replay", recording, *paced).document
    assert told["pipeline"] == pipeline
    # the first block is due at once
    assert time.monotonic() - began > 0.9 * (told["recorded_s"] - 0.1) / rate
    assert_same_decisions(Path("fast.mcap"), Path("paced.mcap"))


def seismic(path: Path, channels: int, *, placed: bool) -> None:
    """Write noise of some geophones, with or without the places of the sensors."""
    names = [f"G{i}" for i in range(channels)]
    stream = Stream("/seismic", tuple(Channel(n, "voltage", "V", "z") for n in names), 1000.0)
    noise = np.random.default_rng(1).normal(size=(1000, channels))
    sensors = tuple(Sensor(n, n, float(i), 0.0) for i, n in enumerate(names))
    blocks = [SignalBlock(stream, 0, 0, noise)]
    site = Geometry(sensors=sensors) if placed else None
    write_recording(path, [(stream, "f32le", blocks)], geometry=site)


@pytest.mark.parametrize(("channels", "placed"), [(2, True), (3, False)])
def test_replay_asks_where_the_recording_tells_no_pipeline(
    channels: int, placed: bool, capsys: Capture
) -> None:
    seismic(Path("line.mcap"), channels, placed=placed)
    said = run(capsys, "replay", "line.mcap", "--no-viewer").error
    assert said.startswith("line.mcap: expected --pipeline NAME")
    assert "/seismic" in said


def test_three_placed_waveforms_choose_the_room_and_an_accelerometer_the_waist(
    capsys: Capture,
) -> None:
    seismic(Path("line.mcap"), 3, placed=True)
    for recording, pipeline in (("line.mcap", "room-footsteps"), (WALK, "waist-steps")):
        told = done(capsys, "replay", recording, "--no-viewer", "--json").document
        assert told["pipeline"] == pipeline


def test_score_takes_truth_from_a_csv(capsys: Capture) -> None:
    done(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--out", "r.mcap")
    own = done(capsys, "score", "r.mcap", "--json").document
    with Recording.open(WALK) as recording:
        write_truth_csv(Path("truth.csv"), recording.labels, recording.start_ns)
    again = done(capsys, "score", "r.mcap", "--truth", "truth.csv", "--json").document
    assert again == own
    Path("two.csv").write_text("time_s,kind\n0.5,step\n0.9,step\n", "utf-8")
    two = done(capsys, "score", "r.mcap", "--truth", "two.csv", "--json").document["steps"]
    assert (two["truth"], two["matched"]) == (2, 0)


def test_score_says_the_same_to_people(room: Path, capsys: Capture) -> None:
    done(capsys, "replay", room, "--no-viewer", "--out", "r.mcap")
    score = done(capsys, "score", "r.mcap", "--json", "--tolerance", 0.05).document
    text = done(capsys, "score", "r.mcap", "--tolerance", 0.05).out
    assert f"steps: {score['steps']['matched']} of {score['steps']['truth']} found" in text
    assert f"F1 {score['steps']['f1']:.3f} at 50 ms" in text
    picks = score["picks"]
    answered = f"{picks['all']['answered']} of {picks['all']['truth']} answered"
    assert f"picks of {picks['stage']}: {answered}" in text


@pytest.mark.parametrize(
    ("kind", "options", "truth"),
    [
        ("room", ("--seed", 5, "--steps", 8, "--channels", 6, "--rate-hz", 8000), 8),
        ("walk", ("--seed", 5, "--duration-s", 30), None),
    ],
)
def test_simulate_info_replay_score_end_to_end(
    kind: str, options: Sequence[object], truth: int | None, capsys: Capture
) -> None:
    assert "step" in done(capsys, "simulate", kind, "-o", "rec.mcap", *options).out
    info = done(capsys, "info", "rec.mcap", "--json").document
    assert info["gaps"] == info["damage"] == []
    done(capsys, "replay", "rec.mcap", "--no-viewer")
    steps = done(capsys, "score", "rec.results.mcap", "--json").document["steps"]
    assert steps["truth"] == info["truth"]["step"] == (truth or steps["truth"])
    assert steps["f1"] > 0.95
    assert steps["f1"] > steps["chance_f1"] + 0.3


def test_a_table_with_a_map_is_imported_replayed_and_scored(capsys: Capture) -> None:
    t = np.arange(0, 20, 0.02)
    swing = np.where(t > 4, 0.3 * np.sin(2 * np.pi * 1.8 * (t - 4)), 0.0)
    rows = [f"{a:.2f};{1 + b:.5f}" for a, b in zip(t, swing, strict=True)]
    Path("walk.csv").write_text("\n".join(["seconds;up", *rows]), "utf-8")
    Path("map.toml").write_text(
        'format = "csv"\ndelimiter = ";"\ntime = {column = "seconds", unit = "s"}\n'
        '[[stream]]\ntopic = "/imu/waist"\nplacement = "waist"\n'
        'columns = [{column = "up", quantity = "acceleration", axis = "z", unit = "g"}]\n',
        "utf-8",
    )
    steps = [f"{4 + (k + 0.25) / 1.8:.4f},step" for k in range(28)]
    Path("truth.csv").write_text("\n".join(["time_s,kind", *steps]), "utf-8")
    imported = ("walk.csv", "-o", "walk.mcap", "--map", "map.toml", "--truth", "truth.csv")
    assert "walk.csv" not in done(capsys, "import", *imported).err
    assert "/imu/waist" in done(capsys, "info", "walk.mcap").out
    done(capsys, "replay", "walk.mcap", "--no-viewer")
    score = done(capsys, "score", "walk.results.mcap", "--json").document["steps"]
    assert score["recall"] > 0.95
    assert abs(score["count_error_signed"]) <= 1


@pytest.mark.parametrize("name", sorted(named_pipelines()))
def test_a_printed_pipeline_has_all_parameters_of_the_pipeline(name: str, capsys: Capture) -> None:
    printed = done(capsys, "pipelines", name).out
    Path("mine.toml").write_text(printed, "utf-8")
    assert load_pipeline("mine.toml").name == name
    assert done(capsys, "pipelines", "mine.toml").out == printed


@pytest.mark.parametrize(
    "name",
    swept(sorted(set(named_pipelines()) - {"signals"}), "room-footsteps", "waist-steps"),
)
def test_a_printed_pipeline_is_a_pipeline_that_decides_the_same(
    name: str, room: Path, capsys: Capture
) -> None:
    recording = {"walker": WALK, "vehicle": PASS}.get(load_pipeline(name).application, room)
    if load_pipeline(name).needs.placement == "foot":
        recording = Path("foot.mcap")
        foot = ("--placement", "foot", "--duration-s", 20, "--seed", 7)
        done(capsys, "simulate", "walk", "-o", recording, *foot)
    printed = done(capsys, "pipelines", name).out
    Path("mine.toml").write_text(printed, "utf-8")
    span = ("--to", 16) if recording == WALK else ()  # 20 of its 74 steps
    for pipeline, out in ((name, "named.mcap"), ("mine.toml", "printed.mcap")):
        replay = ("replay", recording, "--pipeline", pipeline, *span)
        done(capsys, *replay, "--no-viewer", "--out", out)
    assert_same_decisions(Path("named.mcap"), Path("printed.mcap"))
    assert read_results(Path("printed.mcap")).provenance.pipeline == printed


def test_a_setting_changes_the_decisions_and_is_kept_with_the_results(capsys: Capture) -> None:
    high = ("--set", "steps.height=2.0", "--set", "steps.swing=3")
    done(
        capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--out", "r.mcap", *high
    )
    done(capsys, "replay", WALK, "--pipeline", "waist-peaks", "--no-viewer", "--out", "all.mcap")
    assert "height = 2.0 " in read_results(Path("r.mcap")).provenance.pipeline
    few, many = (decisions(Path(name))["steps"] for name in ("r.mcap", "all.mcap"))
    assert np.array_equal(few.times, many.times)
    assert few.accepted.sum() < many.accepted.sum()
