"""The views that explain: read back, verified by the viewer's program, drawn without complaint."""

from __future__ import annotations

import subprocess
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from conftest import skip_or_fail
from viewer_sessions import read_back

from groundtrace.explain.compare import compare
from groundtrace.explain.reasons import matched
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, with_settings
from groundtrace.pipeline.engine import EventList
from groundtrace.pipeline.results import Evidence, Provenance, Results, evidence_of, stage_evidence
from groundtrace.pipeline.source import Source
from groundtrace_codecs.events import GateSpec
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.pages import (
    BEHIND,
    FIRST,
    PASSED,
    Focus,
    compare_view,
    gate_top,
    recording_at,
    verdicts_of,
    why_view,
)
from groundtrace_viewers.rerun.process import connect, open_viewer, viewer_program

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from shared_viewer import SharedViewer

#: A step of the walk that a threshold of 2 m/s2 loses, and its candidate [s].
MISSED_S, CANDIDATE_S, HEIGHT = 33.741, 33.7704, 0.8383
GATES = "/gates/steps/imu/waist"


@cache
def results(*settings: str) -> Results:
    from groundtrace.pipeline.engine import replay

    name = "room-walk.mcap" if settings[0].startswith("picks") else "waist-walk.mcap"
    pipeline = "room-footsteps" if name.startswith("room") else "waist-peaks"
    chain = build_pipeline(with_settings(load_pipeline(pipeline), settings))
    sink = EventList()
    with Recording.open(path_of(name)) as opened:
        stop_ns = opened.start_ns + 4_000_000_000 if name.startswith("room") else None
        replay(Source(opened, stop_ns=stop_ns), chain, [sink])
        origin = Provenance(name, "ab" * 32, opened.start_ns, opened.end_ns, chain.recipe())
        return Results(name, origin, opened.labels, None, tuple(sink.events))


def evidence(*settings: str) -> Evidence:
    return evidence_of(results(*settings))


def at(shown: Evidence, seconds: float) -> int:
    return shown.start_ns + round(seconds * 1e9)


@pytest.fixture(scope="module")
def rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file about one missed step."""
    path = tmp_path_factory.mktemp("why") / "why.rrd"
    shown = evidence("steps.height=2.0")
    why_view(shown, "# why", path=path, at_ns=at(shown, MISSED_S))
    return path


def near(pixels: np.ndarray, colour: int) -> int:
    """Count pixels of a colour, 0xRRGGBBAA."""
    wanted = np.array([colour >> 24, colour >> 16 & 255, colour >> 8 & 255])
    return int((np.abs(pixels - wanted).max(axis=2) < 12).sum())


def test_a_gate_passed_failed_first_or_failed_behind_another() -> None:
    margin = np.array([[1, 0, 2], [-1, 1, -1], [1, -1, np.nan], [np.nan, 1, 1]], np.float32)
    assert verdicts_of(margin).tolist() == [
        [PASSED, PASSED, PASSED],
        [FIRST, PASSED, BEHIND],
        [PASSED, FIRST, BEHIND],
        [FIRST, PASSED, PASSED],
    ]


def test_the_panel_of_a_gate_ends_above_its_threshold() -> None:
    values, shown = np.array([0.1, 7, np.inf], np.float32), np.ones(3, np.bool_)
    assert gate_top(GateSpec("height", "m/s2", "height", 0.4), values, shown) > 0.4
    assert gate_top(GateSpec("height", "m/s2", "height", 0.0), values, shown) > 7
    assert gate_top(GateSpec("height", "m/s2", "height", 0.0), values[:0], shown[:0]) > 0


def test_the_window_stays_inside_the_recording() -> None:
    focus = Focus(3_000_000_000, 2_000_000_000, 5_000_000_000)
    assert focus.window_ns == (2_000_000_000, 5_000_000_000)
    assert focus.at_s == 1.0
    assert Focus(None, 2, 5).window_ns == (2, 5)


def test_every_candidate_stands_at_its_value_in_the_panel_of_every_gate(rrd: Path) -> None:
    part = evidence("steps.height=2.0").stages[0]
    verdicts = verdicts_of(part.margin)
    for index, gate in enumerate(part.spec.gates):
        seen = []
        for mark, verdict in (("passed", PASSED), ("first", FIRST), ("behind", BEHIND)):
            path = f"{GATES}/{index + 1}-{gate.name}/{mark}"
            times, values = read_back(rrd, path, "Scalars:scalars")
            rows = verdicts[:, index] == verdict
            own = part.candidates.time_ns[rows] - evidence("steps.height=2.0").start_ns
            assert times.tolist() == own.tolist()
            top = gate_top(gate, part.gate_value[:, index], np.ones(len(rows), np.bool_))
            expected = np.minimum(part.gate_value[rows, index], 0.9 * top)
            assert np.array(values).ravel() == pytest.approx(expected)
            seen += times.tolist()
        assert len(seen) == len(part.candidates)
        _, line = read_back(rrd, f"{GATES}/{index + 1}-{gate.name}/threshold", "Scalars:scalars")
        assert np.array(line).ravel() == pytest.approx([gate.threshold] * 2)


def test_the_candidate_that_explains_the_moment_is_marked_at_every_gate(rrd: Path) -> None:
    for gate in ("1-height", "2-swing", "3-activity", "4-refractory"):
        times, values = read_back(rrd, f"{GATES}/{gate}/asked", "Scalars:scalars")
        assert times / 1e9 == pytest.approx([CANDIDATE_S], abs=1e-3)
        if gate == "1-height":
            assert np.array(values).ravel() == pytest.approx([HEIGHT], abs=1e-3)
        moment, _ = read_back(rrd, f"{GATES}/{gate}/moment", "Scalars:scalars")
        assert moment / 1e9 == pytest.approx([MISSED_S] * 2, abs=1e-3)


def test_the_lanes_say_what_each_gate_and_the_score_made_of_it(rrd: Path) -> None:
    shown = evidence("steps.height=2.0")
    times, states = read_back(rrd, "/state/score", "StateChange:state")
    marks = [(t, s[0]) for t, s in zip(times.tolist(), states, strict=True) if s[0]]
    found = matched(shown, 0.12)
    assert sorted(t for t, s in marks if s == "missed") == [
        int(t) - shown.start_ns for t in found.truth_ns[found.missed]
    ]
    assert sum(s == "hit" for _, s in marks) == len(found.pairs)
    _, states = read_back(rrd, "/state/steps/1-height", "StateChange:state")
    assert {s[0] for s in states} == {PASSED, FIRST, ""}


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("both") / "both.rrd"
    a, b = results("steps.height=2.0"), results("steps.height=0.4")
    found = compare(a, b, a.labels)
    sides = evidence("steps.height=2.0"), evidence("steps.height=0.4")
    compare_view(*sides, found, "# both", path=path)
    return path


def test_both_sides_and_their_differences_are_in_one_file(both: Path) -> None:
    for side, threshold in (("A", 2.0), ("B", 0.4)):
        path = f"/detector/{side}/steps/imu/waist/threshold"
        _, line = read_back(both, path, "Scalars:scalars")
        assert np.array(line).ravel() == pytest.approx([threshold] * 2)
        _, states = read_back(both, f"/state/{side}", "StateChange:state")
        assert sum(s == ["missed"] for s in states) == (21 if side == "A" else 0)
    _, states = read_back(both, "/state/differs", "StateChange:state")
    assert sum(s == ["B right"] for s in states) == 21


def test_the_viewers_program_verifies_the_files(rrd: Path, both: Path) -> None:
    for path in (rrd, both):
        command = [str(viewer_program()), "rrd", "verify", str(path)]
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr


def test_a_miss_is_drawn_without_complaint_and_with_its_colours(
    rrd: Path, viewer: SharedViewer
) -> None:
    from groundtrace_viewers.rerun.pages import GATE_COLOURS

    state, pixels = viewer.show(rrd)
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    kinds = [v.kind for v in state.views]
    assert (kinds.count("TimeSeries"), kinds.count("StateTimeline")) == (5, 1)
    for colour in (GATE_COLOURS[PASSED], GATE_COLOURS[FIRST], 0xFFFFFFFF):
        assert near(pixels, colour) > 40


@pytest.mark.sweep
def test_a_whole_result_a_room_and_aboth_are_drawn_without_complaint(
    tmp_path: Path, both: Path, viewer: SharedViewer
) -> None:
    why_view(evidence("steps.height=2.0"), "# all", path=tmp_path / "all.rrd")
    room = evidence("picks.ratio=800")
    why_view(room, "# room", path=tmp_path / "room.rrd", at_ns=at(room, 0.8))
    for path in (tmp_path / "all.rrd", tmp_path / "room.rrd", both):
        state, _ = viewer.show(path, 1.0)
        assert {v.name: v.reports for v in state.views if v.reports} == {}, path.name


def test_nothing_at_all_is_shown_without_complaint(tmp_path: Path) -> None:
    shown = evidence("steps.height=2.0")
    part = shown.stages[0]
    (bare,) = stage_evidence([part.spec], ["steps"])
    empty = Evidence(shown.name, shown.config, (bare,), (), (), shown.start_ns, shown.end_ns)
    for at_ns in (None, at(shown, 3)):
        why_view(empty, "# nothing", path=tmp_path / "empty.rrd", at_ns=at_ns)
        assert (tmp_path / "empty.rrd").stat().st_size > 1000


def test_a_recording_needs_somewhere_to_go() -> None:
    with (
        pytest.raises(ViewerError, match="expected a file or spawn, found none"),
        recording_at("x", "y", None, spawn=False, at_s=None),
    ):
        pass


@pytest.fixture
def viewers(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[subprocess.Popen[bytes], int]]]:
    """Viewers started without a screen, and their ports."""
    started: list[tuple[subprocess.Popen[bytes], int]] = []

    def without_screen(arguments: list[str], port: int) -> subprocess.Popen[bytes]:
        process = open_viewer(["--headless", *arguments], port)
        started.append((process, port))
        return process

    for module in ("pages", "sink"):
        monkeypatch.setattr(f"groundtrace_viewers.rerun.{module}.open_viewer", without_screen)
    yield started
    for process, _ in started:
        process.terminate()
        process.wait(10)


def test_a_started_viewer_stands_at_the_moment(
    viewers: list[tuple[subprocess.Popen[bytes], int]],
) -> None:
    shown = evidence("steps.height=2.0")
    try:
        why_view(shown, "# why", path=None, spawn=True, at_ns=at(shown, MISSED_S))
    except ViewerError as error:
        skip_or_fail("viewer", f"the viewer cannot draw here: {error}")
    (recording,) = connect(*viewers[0]).get_state().recordings
    assert recording.current_time == pytest.approx(MISSED_S * 1e9, abs=1e6)


def test_a_replay_started_at_a_miss_stands_there(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    viewers: list[tuple[subprocess.Popen[bytes], int]],
) -> None:
    from groundtrace.cli.main import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("groundtrace.cli.console.has_display", lambda: True)
    setting = ("--set", "steps.height=2.0", "--at-miss", "2", "--spawn")
    try:
        main(["replay", str(path_of("waist-walk.mcap")), "--pipeline", "waist-peaks", *setting])
    except SystemExit:
        skip_or_fail("viewer", "the viewer cannot draw here")
    (recording,) = connect(*viewers[0]).get_state().recordings
    assert recording.current_time == pytest.approx(MISSED_S * 1e9, abs=1e6)
