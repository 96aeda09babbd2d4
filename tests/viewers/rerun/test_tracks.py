"""Tracks on the map: a segment a row, where a walker is now, and that it goes in the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from viewer_sessions import SEISMIC, START_NS, at, blocks, read_back, room_session, seismic_samples

from groundtrace_codecs.events import TrackPoint
from groundtrace_viewers.rerun.blueprint import site_view
from groundtrace_viewers.rerun.places import CORNERS, HOLD_S, PRESENT, TRACK_LINES
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.site import bounds
from groundtrace_viewers.rerun.timeline import FILTERED_TRACK, SEGMENTS_S, SMOOTHED_TRACK, Entity

if TYPE_CHECKING:
    from pathlib import Path

    from shared_viewer import SharedViewer

SPREAD = (0.09, 0.02, 0.04)


def point(seconds: float, x: float, stage: str = "track", track: int = 1) -> TrackPoint:
    return TrackPoint(at(seconds), track, x, 2.0, 0.7, 0.0, SPREAD, stage, 1.0)


def written(path: Path, points: list[TrackPoint]) -> Path:
    sink = RerunSink(path)
    sink.open(room_session())
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        sink.write(block)
    for each in points:
        sink.write(each)
    sink.close()
    return path


@pytest.fixture
def walked(tmp_path: Path) -> Path:
    """Two walkers filtered, the first of them smoothed."""
    first = [point(1 + 0.5 * k, 1 + 0.5 * k) for k in range(5)]
    second = [point(1.2 + 0.5 * k, 4 - 0.5 * k, track=2) for k in range(3)]
    smooth = [point(1 + 0.5 * k, 1.1 + 0.5 * k, "track.smoothed") for k in range(5)]
    return written(tmp_path / "walk.rrd", [*first, *second, *smooth])


@pytest.mark.parametrize(
    ("stage", "first", "colour"),
    [("track", 1.0, FILTERED_TRACK), ("track.smoothed", 1.1, SMOOTHED_TRACK)],
)
def test_a_track_grows_by_a_segment_at_each_step(
    walked: Path, stage: str, first: float, colour: int
) -> None:
    times, strips = read_back(walked, f"{TRACK_LINES}/{stage}/1", "LineStrips2D:strips")
    assert (times + START_NS).tolist() == [at(1 + 0.5 * k) for k in range(1, 5)]
    segments = np.array(strips)[:, 0]
    assert segments[:, 0, 0].tolist() == pytest.approx([first + 0.5 * k for k in range(4)])
    assert segments[:-1, 1].tolist() == segments[1:, 0].tolist()
    _, shades = read_back(walked, f"{TRACK_LINES}/{stage}/1", "LineStrips2D:colors")
    assert {shade[0] for shade in shades} == {colour}


def test_walkers_are_shown_where_they_are_until_some_time_after_their_last_step(
    walked: Path,
) -> None:
    for track, count, last_s in ((1, 5, 3.0), (2, 3, 2.2)):
        path = f"{PRESENT}/track/{track}"
        times, places = read_back(walked, f"{path}/place", "Points2D:positions")
        assert [len(p) for p in places] == [1] * count + [0]
        assert times[-1] + START_NS == at(last_s + HOLD_S)
        _, strips = read_back(walked, f"{path}/ellipse", "LineStrips2D:strips")
        assert [len(s) for s in strips] == [1] * count + [0]
        assert len(strips[0][0]) == CORNERS


def test_a_smoothed_track_is_a_line_alone(walked: Path) -> None:
    assert len(read_back(walked, f"{PRESENT}/track.smoothed/1/place", "Points2D:positions")[0]) == 0


def test_a_track_that_comes_in_parts_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "parts.rrd"
    sink = RerunSink(path)
    sink.open(room_session())
    pieces = list(blocks(SEISMIC, seismic_samples(), 1000))
    for k, block in enumerate(pieces):
        sink.write(point(0.5 * k, 0.2 * k))
        sink.write(block)
    sink.close()
    times, _ = read_back(path, f"{TRACK_LINES}/track/1", "LineStrips2D:strips")
    assert len(times) == len(pieces) - 1


def test_the_map_shows_all_of_a_track_before_the_cursor() -> None:
    path = f"{TRACK_LINES}/track/1"
    shown = bounds(room_session())
    assert shown is not None
    line = Entity(path, "map", visible_s=SEGMENTS_S)
    view = site_view(shown, [line, Entity(f"{PRESENT}/track/1/place", "map")])
    assert list(view.visualizer_overrides) == [path]


@pytest.mark.sweep
def test_a_map_with_tracks_is_drawn_without_complaint(walked: Path, viewer: SharedViewer) -> None:
    state, _ = viewer.show(walked, 2.6)
    assert {v.name: v.reports for v in state.views if v.reports} == {}
