from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import IMU, at, blocks, imu_samples, read_back, walker_session, write_walk

from groundtrace.evaluation.positions import turn_onto
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import parse_pipeline
from groundtrace_codecs.events import (
    Label,
    StepEvent,
    TrackPoint,
)
from groundtrace_codecs.signals import Channel, SignalBlock, Stream
from groundtrace_viewers.rerun.process import quiet_environment, viewer_program
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from pathlib import Path


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


@pytest.mark.sweep
def test_masses_of_each_sensor_and_combined_add_up_to_one(tmp_path: Path) -> None:
    path = replayed(tmp_path / "masses.rrd", "dstp")
    for source in ("accelerometer", "gyroscope", "combined"):
        _, rows = read_back(path, f"/masses/steps/imu/waist/{source}/points", SCALARS)
        masses = np.array(rows)
        assert len(masses) >= 8
        np.testing.assert_allclose(masses[:, :3].sum(axis=1), 1.0, atol=1e-5)


def test_the_lane_of_steps_says_their_types(tmp_path: Path) -> None:
    kinds = ("forward", "backward", "left")
    steps = [
        StepEvent(at(1 + i), "step", "", "/imu/waist", "types", 1.0, type=kind)
        for i, kind in enumerate(kinds)
    ]
    labels = (Label(at(1), "step", label="backward"), Label(at(2), "trailing", label="left"))
    path = write_walk(tmp_path / "types.rrd", labels, *steps)
    _, states = read_back(path, "/state/3-types", "StateChange:state")
    assert [s for [s] in states if s] == list(kinds)
    _, states = read_back(path, "/state/1-truth/step", "StateChange:state")
    assert [s for [s] in states if s] == ["backward", "trailing"]


def test_satellite_fixes_are_on_the_map_in_metres(tmp_path: Path) -> None:
    stream = Stream("/gnss", tuple(Channel(q, q, "deg") for q in ("latitude", "longitude")), 1.0)
    degrees = np.array([(46.5, 6.5), (46.5001, 6.5), (46.5001, 6.5001)])
    path = write_walk(tmp_path / "gnss.rrd", (), SignalBlock(stream, at(0), 0, degrees))
    _, places = read_back(path, "/map/site/satellites/points", "Points2D:positions")
    metres = np.array(places).reshape(-1, 2)
    np.testing.assert_allclose(metres, [(0, 0), (0, 11.12), (7.68, 11.12)], atol=0.05)


def test_a_recording_without_places_has_no_map(tmp_path: Path) -> None:
    import rerun as rr

    path = write_walk(tmp_path / "none.rrd", (Label(at(1), "step"),))
    entities = rr.chunk.RrdReader(str(path)).store().schema().entity_paths()
    assert not any(e.startswith("/map") for e in entities)


def test_a_track_alone_has_a_map_and_the_file_is_valid(tmp_path: Path) -> None:
    unknown = (float("nan"),) * 3
    points = [TrackPoint(at(i), 1, float(i), 0.5 * i, 0.0, 0.0, unknown, "track") for i in range(5)]
    path = write_walk(tmp_path / "track.rrd", (), *points)
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
