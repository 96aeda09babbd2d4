"""The analysis of a layout in the viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr

from groundtrace.layout.analysis import RoomAnalysis, Settings, analyze_room, layout_of
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_viewers.rerun.pages import _coloured, room_page, room_view

if TYPE_CHECKING:
    from pathlib import Path

    from shared_viewer import SharedViewer

PLACES = ((0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0), (2.0, 1.0))


@pytest.fixture(scope="module")
def found() -> RoomAnalysis:
    sensors = tuple(Sensor(f"S{i}", f"S{i}", x, y) for i, (x, y) in enumerate(PLACES))
    site = Geometry(sensors, PLACES[:4], medium=Medium(theta_s=1e-5))
    return analyze_room(*layout_of(site, "room.toml", 5e-4), Settings(5, 3))


def test_every_map_is_logged_below_an_entity_of_its_own(
    found: RoomAnalysis, tmp_path: Path
) -> None:
    room_view(found, path=tmp_path / "room.rrd")
    logged = rr.chunk.RrdReader(tmp_path / "room.rrd").store().schema().entity_paths()
    for name in ("so-tdoa", "hyperbolic", "power-law", "signs", "regions"):
        assert {f"/{name}/room/map", f"/{name}/room/scale", f"/{name}/room/outline"} <= set(logged)
    assert {"/sensors/room/added", "/sensors/room/move", "/page"} <= set(logged)


def test_the_page_says_what_is_found_and_how_to_read_it(found: RoomAnalysis) -> None:
    page = room_page(found)
    assert page.startswith("# room.toml\n")
    assert "power law: mean" in page
    assert "## How to read it" in page
    assert page.count("\n| S") == 5


def test_pixels_outside_the_room_are_clear() -> None:
    pixels = _coloured(np.array([[0.0, 2.0, np.nan]]), 2.0)
    assert pixels.shape == (1, 3, 4)
    assert pixels[0, :, 3].tolist() == [255, 255, 0]
    assert pixels[0, 1, :3].sum() > pixels[0, 0, :3].sum()


def test_all_maps_are_drawn_without_complaint(
    found: RoomAnalysis, tmp_path: Path, viewer: SharedViewer
) -> None:
    room_view(found, path=tmp_path / "room.rrd")
    state, _ = viewer.show(tmp_path / "room.rrd")
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    assert sorted(v.kind for v in state.views) == ["2D"] * 6 + ["TextDocument"]
