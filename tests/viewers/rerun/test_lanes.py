from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from viewer_sessions import START_NS, read_back, room_session, write_room

from groundtrace_viewers.rerun.blueprint import _views, blueprint
from groundtrace_viewers.rerun.timeline import (
    APART,
    AXIS,
    AXIS_NS,
    LANES,
    MARK_NS,
    Entity,
    Lane,
    Timeline,
    coincident,
    lane_number,
)

if TYPE_CHECKING:
    from pathlib import Path


class Recorder:
    """Stands for a timeline: keeps what a lane sends."""

    def __init__(self) -> None:
        self.changes: list[tuple[int, str]] = []

    def declare(self, *_: object) -> None:
        pass

    def static(self, *_: object) -> None:
        pass

    def send(self, _: str, times: tuple[int, ...], columns: object) -> None:
        (column,) = columns
        states = [s for [s] in column.as_arrow_array().to_pylist()]
        self.changes += zip(times, states, strict=True)


def lane() -> tuple[Lane, Recorder]:
    recorder = Recorder()
    return Lane(recorder, "/state/x", {"a": 0xFF, "b": 0xFF}), recorder  # type: ignore[arg-type]


def test_a_moment_is_a_short_mark_that_ends() -> None:
    x, recorder = lane()
    x.add(0, "a")
    x.flush()
    assert recorder.changes == [(0, "a"), (MARK_NS, "")]


def test_the_next_mark_ends_the_one_before() -> None:
    x, recorder = lane()
    x.add(MARK_NS // 2, "b")
    x.add(0, "a")
    x.flush()
    assert recorder.changes == [(0, "a"), (MARK_NS // 2, "b"), (MARK_NS // 2 + MARK_NS, "")]


def test_marks_flushed_in_parts_are_those_flushed_at_once() -> None:
    starts = [0, 50, 500, 520, 900]
    whole, at_once = lane()
    parts, in_parts = lane()
    for start in starts:
        whole.add(start * 1_000_000, "a" if start % 20 else "b")
        parts.add(start * 1_000_000, "a" if start % 20 else "b")
        parts.flush(start * 1_000_000)
    whole.flush()
    parts.flush()
    assert in_parts.changes == at_once.changes


def test_a_group_is_decided_by_its_first_accepted_member() -> None:
    times = np.array([0, 10, 20, 100, 110, 300])
    accepted = np.array([False, True, True, False, False, True])
    assert coincident(times, accepted, 50) == [1, 3, 5]


def test_no_candidates_make_no_groups() -> None:
    assert coincident(np.empty(0, np.int64), np.empty(0, np.bool_), 50) == []


def test_marks_are_thick_lines_at_the_height_of_their_lane(tmp_path: Path) -> None:
    path = write_room(tmp_path / "room.rrd")
    heights = {}
    for entity in rr.chunk.RrdReader(str(path)).store().schema().entity_paths():
        if entity.startswith(f"{LANES}/"):
            _, values = read_back(path, entity, "Scalars:scalars")
            rows = np.array(values).reshape(-1, 3)
            assert np.isnan(rows[:, 2]).all()
            heights[entity] = set(rows[:, :2].ravel().tolist())
    of_truth = {h for path, found in heights.items() for h in found if "/1-truth/" in path}
    others = {h for path, found in heights.items() for h in found if "/1-truth/" not in path}
    assert max(of_truth) == 7.0
    assert max(others) < min(of_truth)
    assert all(len(found) == 1 for found in heights.values())


def test_lanes_of_the_same_number_stand_below_each_other() -> None:
    timeline = Timeline(rr.RecordingStream("test"), 0)
    rows = [timeline.row_of(path, number) for path, number in (("a", 1), ("b", 1), ("c", 2))]
    assert rows == [7.0, pytest.approx(7.0 - APART), 6.0]
    assert timeline.row_of("a", 1) == 7.0


@pytest.mark.parametrize(
    ("path", "number"),
    [("/state/1-truth/step", 1), ("/state/7-gaps", 7), ("/state/x", 7), ("/state/A/steps", 7)],
)
def test_lanes_have_a_row_by_the_number_of_their_name(path: str, number: int) -> None:
    assert lane_number(path) == number


@pytest.mark.parametrize(("seconds", "whole"), [(60, True), (600, False)])
def test_plots_on_the_common_axis_open_on_what_is_recorded(*, seconds: int, whole: bool) -> None:
    session = replace(room_session(), end_ns=START_NS + seconds * 10**9)
    entities = [Entity("/state/1-truth/step", "lane"), Entity("/envelope/x", "envelope", "x")]
    seen = [
        view.properties["VisibleTimeRanges"]
        for view in _views(blueprint(session, entities).root_container)
        if isinstance(view, rrb.TimeSeriesView)
    ]
    assert len(seen) == 2
    for ranges in seen:
        [told] = ranges.ranges.as_arrow_array().to_pylist()
        ends = {side: told["range"][side] for side in ("start", "end")}
        assert str(ends).count(str(seconds * 10**9)) == int(whole)


def test_a_curve_without_values_keeps_the_axis_to_what_is_shown(tmp_path: Path) -> None:
    times, values = read_back(write_room(tmp_path / "room.rrd"), AXIS, "Scalars:scalars")
    assert np.isnan(np.array(values)).all()
    assert times[0] == 0
    assert np.diff(times).max() <= AXIS_NS


def test_states_may_have_any_words_and_the_viewer_has_nothing_to_say(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    recording = rr.RecordingStream("lanes", recording_id="lanes")
    recording.save(tmp_path / "lanes.rrd")
    said = Lane(Timeline(recording, START_NS), "/state/4-picks", {"rejected: ratio": 0xFF})
    said.add(START_NS, "rejected: ratio")
    said.add(START_NS + 10**9, "V1 10.0 m/s")
    said.flush()
    recording.flush()
    recording.disconnect()
    assert capfd.readouterr().err == ""
