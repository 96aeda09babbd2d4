from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from viewer_sessions import room_session

from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.site import MOST_NAMES, RADIUS, SITE, labelled, marker_radius

if TYPE_CHECKING:
    from pathlib import Path


def test_few_sensors_are_all_named() -> None:
    assert labelled(MOST_NAMES) == list(range(MOST_NAMES))


def test_of_many_sensors_every_fourth_and_the_last_are_named() -> None:
    assert labelled(24) == [0, 4, 8, 12, 16, 20, 23]
    assert labelled(25)[-2:] == [20, 24]


def test_neighbours_on_a_line_do_not_cover_each_other() -> None:
    line = [(float(x), 0.0) for x in range(100)]
    assert marker_radius(line, 99.0) < RADIUS
    assert marker_radius(line[:2], 1.0) == RADIUS
    assert marker_radius(line[:1], 10.0) == RADIUS


def test_paths_that_the_geometry_states_are_on_the_map(tmp_path: Path) -> None:
    import rerun as rr

    session = room_session()
    assert session.geometry is not None
    paths = (((0.5, 0.5), (3.0, 0.5), (3.0, 2.0)), ((1.0, 0.5), (1.0, 2.0)))
    path = tmp_path / "paths.rrd"
    sink = RerunSink(path)
    sink.open(replace(session, geometry=replace(session.geometry, paths=paths)))
    sink.close()
    chunks = rr.chunk.RrdReader(str(path)).stream().filter(content=f"{SITE}/paths")
    (lines,) = [c.to_record_batch().column("LineStrips2D:strips")[0].as_py() for c in chunks]
    assert [[tuple(corner) for corner in line] for line in lines] == [list(p) for p in paths]
