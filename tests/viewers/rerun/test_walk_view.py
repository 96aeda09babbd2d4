from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import IMU, at, blocks, imu_samples, read_back, walker_session

from groundtrace.evaluation.positions import turn_onto
from groundtrace.pipeline.config import build_pipeline, parse_pipeline
from groundtrace_codecs.events import (
    CandidateBlock,
    Disturbance,
    Heading,
    Label,
    Quantity,
    StageSpec,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_viewers.rerun.process import quiet_environment, viewer_program
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.events import Event

SCALARS = "Scalars:scalars"
ROOT = "/detector/steps/imu/waist"
CANDIDATES = ("accepted", "rejected")


def replayed(path: Path, plugin: str) -> Path:
    """Replay the waist sensor through one detector into a viewer's file."""
    recipe = f'name = "p"\napplication = "walker"\n[[stage]]\nname = "steps"\nuse = "{plugin}"\n'
    chain = build_pipeline(parse_pipeline(recipe.encode(), "p.toml"), None)
    session = replace(walker_session(), pipeline=chain.recipe())
    sink = RerunSink(path)
    sink.open(session)
    for block in blocks(IMU, imu_samples(), 50):
        sink.write(block)
        for event in chain.process(block):
            sink.write(event)
    for event in chain.flush():
        sink.write(event)
    sink.close()
    return path


def written(path: Path, labels: tuple[Label, ...], *items: Event | SignalBlock) -> Path:
    """Write a walker's events into a viewer's file."""
    sink = RerunSink(path)
    sink.open(replace(walker_session(), labels=labels))
    for item in items:
        sink.write(item)
    sink.close()
    return path


@pytest.mark.parametrize("plugin", ["adaptive", "dp", "dstp", "rest-swing", "zc"])
def test_every_candidate_is_a_mark_at_its_peak_on_the_filtered_signal(
    tmp_path: Path, plugin: str
) -> None:
    path = replayed(tmp_path / "walk.rrd", plugin)
    times, curve = read_back(path, f"{ROOT}/decision", SCALARS)
    assert len(times) > 200
    on = dict(zip(times.tolist(), np.array(curve).ravel().tolist(), strict=True))
    marks = [read_back(path, f"{ROOT}/{verdict}/peak", SCALARS) for verdict in CANDIDATES]
    peaks = [(t, v) for ts, vs in marks for t, [v] in zip(ts.tolist(), vs, strict=True)]
    assert len(peaks) >= 8
    assert all(on[t] == pytest.approx(v, abs=1e-3) for t, v in peaks)
    times, valleys = read_back(path, f"{ROOT}/accepted/valley", SCALARS)
    assert len(times) or plugin == "adaptive"  # a score rises from no valley
    assert all(on[t] == pytest.approx(v, abs=1e-3) for t, [v] in zip(times, valleys, strict=True))


def test_masses_of_each_sensor_and_combined_add_up_to_one(tmp_path: Path) -> None:
    path = replayed(tmp_path / "masses.rrd", "dstp")
    for source in ("accelerometer", "gyroscope", "combined"):
        _, rows = read_back(path, f"/masses/steps/imu/waist/{source}/points", SCALARS)
        masses = np.array(rows)
        assert len(masses) >= 8
        np.testing.assert_allclose(masses[:, :3].sum(axis=1), 1.0, atol=1e-5)


def test_headings_have_the_turn_that_is_nearest_to_the_truth(tmp_path: Path) -> None:
    turning = np.linspace(0.0, 3 * np.pi, 31)
    truth = tuple(Label(at(i / 10), "heading", value=x) for i, x in enumerate(turning.tolist()))
    wrapped = (turning + 0.1 + np.pi) % (2 * np.pi) - np.pi
    found = [Heading(at(i / 10), x, 0.05, "fused") for i, x in enumerate(wrapped.tolist())]
    path = written(tmp_path / "turn.rrd", truth, *found, Disturbance(at(1), at(2), 9.0, "fused"))
    _, values = read_back(path, "/heading/fused", "Measurements:values")
    np.testing.assert_allclose(np.array(values).ravel(), np.degrees(turning + 0.1), atol=1e-9)
    _, states = read_back(path, "/state/6-disturbances", "StateChange:state")
    assert states == [["disturbed"], [""]]
    times, shade = read_back(path, "/heading/disturbed", "Measurements:values")
    assert times[[0, -1]].tolist() == [1_000_000_000, 2_000_000_000]
    assert np.isnan(shade[-1][0])


def test_headings_by_compass_and_gyroscope_alone_have_curves_of_their_own(tmp_path: Path) -> None:
    names = ("field", "gyroscope", "compass")
    columns = tuple(Quantity(name, "deg") for name in names)
    spec = StageSpec("fused", "compass", "/imu/waist", ("field",), columns, (), (), "heading")
    times = np.array([at(i / 10) for i in range(31)], np.int64)
    turning = np.linspace(170.0, 190.0, 31)
    value = np.column_stack([np.zeros(31), turning + 2, turning - 30])
    wrapped = ((value + 180) % 360 - 180).astype(np.float32)
    block = CandidateBlock(
        spec, times, np.zeros(31, np.int32), wrapped,
        np.zeros((31, 0), np.float32), np.zeros((31, 0), np.float32), np.ones(31, np.bool_),
    )  # fmt: skip
    found = [
        Heading(int(t), float(np.radians(x)), 0.01, "fused")
        for t, x in zip(times, turning, strict=True)
    ]
    path = written(tmp_path / "alone.rrd", (), *found, block)
    for name, off in (("gyroscope", 2.0), ("compass", -30.0)):
        _, values = read_back(path, f"/heading/fused/{name}", "Measurements:values")
        np.testing.assert_allclose(np.array(values).ravel(), turning + off, atol=1e-3)


def test_without_truth_headings_do_not_jump_at_the_full_turn(tmp_path: Path) -> None:
    found = [Heading(at(i / 10), x, 0.05, "fused") for i, x in enumerate((3.1, -3.1, -3.0))]
    path = written(tmp_path / "jump.rrd", (), *found)
    _, values = read_back(path, "/heading/fused", "Measurements:values")
    assert np.abs(np.diff(np.array(values).ravel())).max() < 10


def test_the_lane_of_steps_says_their_types(tmp_path: Path) -> None:
    kinds = ("forward", "backward", "left")
    steps = [
        StepEvent(at(1 + i), "step", "", "/imu/waist", "types", 1.0, type=kind)
        for i, kind in enumerate(kinds)
    ]
    labels = (Label(at(1), "step", label="backward"), Label(at(2), "trailing", label="left"))
    path = written(tmp_path / "types.rrd", labels, *steps)
    _, states = read_back(path, "/state/3-types", "StateChange:state")
    assert [s for [s] in states if s] == list(kinds)
    _, states = read_back(path, "/state/1-truth/step", "StateChange:state")
    assert [s for [s] in states if s] == ["backward", "trailing"]


def test_satellite_fixes_are_on_the_map_in_metres(tmp_path: Path) -> None:
    stream = Stream("/gnss", tuple(Channel(q, q, "deg") for q in ("latitude", "longitude")), 1.0)
    degrees = np.array([(46.5, 6.5), (46.5001, 6.5), (46.5001, 6.5001)])
    path = written(tmp_path / "gnss.rrd", (), SignalBlock(stream, at(0), 0, degrees))
    _, places = read_back(path, "/map/site/satellites/points", "Points2D:positions")
    metres = np.array(places).reshape(-1, 2)
    np.testing.assert_allclose(metres, [(0, 0), (0, 11.12), (7.68, 11.12)], atol=0.05)


def test_a_recording_without_places_has_no_map(tmp_path: Path) -> None:
    import rerun as rr

    path = written(tmp_path / "none.rrd", (Label(at(1), "step"),))
    entities = rr.chunk.RrdReader(str(path)).store().schema().entity_paths()
    assert not any(e.startswith("/map") for e in entities)


def test_a_track_alone_has_a_map_and_the_file_is_valid(tmp_path: Path) -> None:
    unknown = (float("nan"),) * 3
    points = [TrackPoint(at(i), 1, float(i), 0.5 * i, 0.0, 0.0, unknown, "track") for i in range(5)]
    path = written(tmp_path / "track.rrd", (), *points)
    _, lines = read_back(path, "/map/site/tracks/lines/track/1", "LineStrips2D:strips")
    assert len(lines) == 4
    command = [str(viewer_program()), "rrd", "verify", str(path)]
    done = subprocess.run(command, env=quiet_environment(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


def test_places_are_turned_onto_those_of_a_track() -> None:
    places = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 3.0)])
    angle = 2.1
    rotation = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    onto = places @ rotation.T + (4.0, -1.0)
    np.testing.assert_allclose(turn_onto(places, onto)(places), onto, atol=1e-12)
