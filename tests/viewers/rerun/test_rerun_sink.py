from __future__ import annotations

import subprocess
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from viewer_sessions import (
    IMU,
    SEISMIC,
    SPEC,
    START_NS,
    STEPS_S,
    blocks,
    imu_samples,
    read_back,
    room_session,
    seismic_samples,
    write_room,
    write_walker,
)

from groundtrace_codecs.events import CandidateBlock, Label, Note, Quantity
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.decisions import TOP_EDGE, ceiling
from groundtrace_viewers.rerun.process import quiet_environment, viewer_program
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import SINGLES

if TYPE_CHECKING:
    from pathlib import Path

SCALARS = "Scalars:scalars"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room(tmp_path_factory.mktemp("room") / "room.rrd")


def sample_times(rate_hz: float, n: int) -> np.ndarray:
    return np.rint(np.arange(n) * 1e9 / rate_hz).astype(np.int64)


def test_the_file_passes_the_viewers_own_verification(room: Path) -> None:
    command = [str(viewer_program()), "rrd", "verify", str(room)]
    done = subprocess.run(command, env=quiet_environment(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


def test_every_seismic_sample_is_logged_at_its_time(room: Path) -> None:
    times, values = read_back(room, "/signals/seismic", SINGLES)
    samples = seismic_samples()
    np.testing.assert_array_equal(times, sample_times(SEISMIC.rate_hz, len(samples)))
    np.testing.assert_allclose(np.array(values), samples * 2e-9 * 1e6, rtol=1e-7)


def test_worn_sensors_are_logged_by_quantity_in_readable_units(room: Path) -> None:
    samples = imu_samples()
    for quantity, columns, factor in (
        ("acceleration", slice(0, 3), 1.0),
        ("angular_velocity", slice(3, 6), 1.0),
        ("magnetic_field", slice(6, 9), 1e6),
        ("pressure", slice(9, 10), 1e-2),
    ):
        times, values = read_back(room, f"/signals/imu/waist/{quantity}", SCALARS)
        np.testing.assert_array_equal(times, sample_times(IMU.rate_hz, len(samples)))
        np.testing.assert_array_equal(np.array(values), samples[:, columns] * factor)


@pytest.mark.parametrize("rows", [1, 333, 1000, 12_000])
def test_blocks_may_be_cut_anyhow(tmp_path: Path, rows: int) -> None:
    samples = seismic_samples()[:3000] if rows == 1 else seismic_samples()
    sink = RerunSink(tmp_path / "cut.rrd")
    sink.open(room_session())
    for block in blocks(SEISMIC, samples, rows):
        sink.write(block)
    sink.close()
    times, values = read_back(tmp_path / "cut.rrd", "/signals/seismic", SINGLES)
    np.testing.assert_array_equal(times, sample_times(SEISMIC.rate_hz, len(samples)))
    np.testing.assert_allclose(np.array(values), samples * 2e-9 * 1e6, rtol=1e-7)
    times, values = read_back(tmp_path / "cut.rrd", "/envelope/seismic", SINGLES)
    peaks = np.abs(samples * 2e-9).reshape(-1, 20, 4).max(axis=1) * 1e6
    np.testing.assert_array_equal(times, np.arange(len(peaks)) * 10_000_000)
    np.testing.assert_array_equal(np.array(values, np.float32), peaks.astype(np.float32))


def test_curves_end_at_a_gap(tmp_path: Path) -> None:
    path = write_room(tmp_path / "gap.rrd", lost=(4000, 5001))
    for entity, component in (("/signals/seismic", SINGLES), ("/envelope/seismic", SINGLES)):
        times, values = read_back(path, entity, component)
        broken = times[np.isnan(np.array(values)).all(axis=1)]
        np.testing.assert_array_equal(broken, [2_000_000_000])
        assert not np.any((times > 2_000_000_000) & (times < 2_500_500_000))


def test_the_layout_is_in_the_file(room: Path) -> None:
    reader = rr.chunk.RrdReader(str(room))
    assert len(reader.blueprints()) == 1
    assert reader.recordings()[0].application_id == "groundtrace-room"


def test_the_same_recording_gets_the_same_identity(tmp_path: Path, room: Path) -> None:
    again = write_room(tmp_path / "again.rrd")
    first, second = (rr.chunk.RrdReader(str(p)).recordings()[0] for p in (room, again))
    assert first.recording_id == second.recording_id


def test_no_view_lacks_its_entity(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_walker(tmp_path / "w.rrd"))).store().schema()
    entities = set(paths.entity_paths())
    assert not any(p.startswith(("/map", "/detector", "/envelope", "/picks")) for p in entities)
    assert "/signals/imu/waist/acceleration" in entities


def test_a_decision_is_logged_with_its_threshold(room: Path) -> None:
    _, values = read_back(room, "/detector/picker/seismic/decision", SCALARS)
    assert np.array(values).shape == (120, 4)
    times, threshold = read_back(room, "/detector/picker/seismic/threshold", SCALARS)
    assert threshold == [[4.0], [4.0]]
    assert times[0] == 0


def test_the_plot_of_a_ratio_ends_where_the_threshold_can_be_seen() -> None:
    assert ceiling(SPEC) == 16.0
    in_units = replace(SPEC, trace=(Quantity("ratio", "m/s2"),))
    assert ceiling(in_units) == 0.0
    assert ceiling(replace(SPEC, trace=(), gates=())) == 0.0


def test_candidates_beyond_the_plot_lie_at_its_edge(tmp_path: Path) -> None:
    sink = RerunSink(tmp_path / "high.rrd")
    sink.open(room_session())
    value = np.array([[9000.0, 1.0], [5.0, 1.0]], np.float32)
    yes, channel = np.ones(2, np.bool_), np.zeros(2, np.int32)
    times = START_NS + np.array([10, 20])
    sink.write(CandidateBlock(SPEC, times, channel, value, value, value, yes))
    sink.close()
    _, accepted = read_back(tmp_path / "high.rrd", "/detector/picker/seismic/accepted", SCALARS)
    np.testing.assert_allclose(np.array(accepted).ravel(), [16.0 * TOP_EDGE, 5.0])


def test_candidates_are_split_into_accepted_and_rejected(room: Path) -> None:
    _, accepted = read_back(room, "/detector/picker/seismic/accepted", SCALARS)
    _, rejected = read_back(room, "/detector/picker/seismic/rejected", SCALARS)
    assert len(accepted) == 4 * (len(STEPS_S) - 1)
    assert rejected == [[3.0]] * 4


def test_the_lane_of_a_stage_names_the_first_gate_that_failed(room: Path) -> None:
    times, states = read_back(room, "/state/4-picker", "StateChange:state")
    shown = [(t, s[0]) for t, s in zip(times.tolist(), states, strict=True) if s != [""]]
    expected = ["rejected: ratio" if k == 2 else "accepted" for k in range(len(STEPS_S))]
    assert [s for _, s in shown] == expected
    assert [t for t, _ in shown] == [round(s * 1e9) for s in STEPS_S]


def test_steps_and_rejections_of_a_stage_share_its_lane(room: Path) -> None:
    _, states = read_back(room, "/state/3-associate", "StateChange:state")
    assert [s for [s] in states if s] == ["step"] * (len(STEPS_S) - 1)


def test_a_walk_goes_on_after_what_is_ignored(tmp_path: Path) -> None:
    sink = RerunSink(tmp_path / "ignore.rrd")
    session = room_session()
    second = 1_000_000_000
    ignore = Label(START_NS + 2 * second, "ignore", end_ns=START_NS + 3 * second)
    sink.open(replace(session, labels=(*session.labels, ignore)))
    sink.close()
    path = tmp_path / "ignore.rrd"
    times, states = read_back(path, "/state/1-truth/walking", "StateChange:state")
    assert [s for [s] in states] == ["walking", "ignore", "walking", ""]
    np.testing.assert_array_equal(times / second, [0.5, 2.0, 3.0, 5.5])


def test_truth_becomes_lanes_by_kind(room: Path) -> None:
    _, feet = read_back(room, "/state/1-truth/step", "StateChange:state")
    assert [s for [s] in feet if s] == ["left", "right"] * 4
    times, _ = read_back(room, "/state/1-truth/walking", "StateChange:state")
    assert not len(times), "in a room the steps say when somebody walks"


def test_events_are_log_lines_and_rows(room: Path) -> None:
    times, lines = read_back(room, "/log/steps", "TextLog:text")
    assert len(lines) == 7
    assert lines[0] == ["0.800 s  step, peak 9, 4 channels (associate)"]
    assert times[0] == 800_000_000
    assert not len(read_back(room, "/log/picks", "TextLog:text")[0]), "they would hide the steps"
    _, levels = read_back(room, "/log/gaps", "TextLog:level")
    assert levels == [["WARN"]]
    _, channels = read_back(room, "/table/picks", "channel")
    assert [c for [c] in channels[:4]] == ["G1", "G2", "G3", "G4"]
    _, kinds = read_back(room, "/table/steps", "kind")
    assert kinds == [["step"]] * 7


def test_the_true_path_grows_step_by_step(room: Path) -> None:
    times, strips = read_back(room, "/map/site/truth/path", "LineStrips2D:strips")
    assert times.tolist() == [round(s * 1e9) for s in STEPS_S[1:]]
    np.testing.assert_allclose(strips[0][0], [[1.0, 2.0], [1.5, 2.2]], rtol=1e-6)


def test_a_sink_needs_somewhere_to_show() -> None:
    with pytest.raises(ViewerError, match="expected a file, spawn or web"):
        RerunSink()


def test_nothing_can_be_written_before_the_session(tmp_path: Path) -> None:
    sink = RerunSink(tmp_path / "x.rrd")
    with pytest.raises(ViewerError, match="open"):
        sink.write(Note(START_NS, "early"))
