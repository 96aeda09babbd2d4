"""Every view of every layout shows its data: pictures with and without them are compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from shared_viewer import pixels, running_viewer
from shot_sessions import shot_labels, write_shots
from sweeps import swept

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import named_pipelines, parse_pipeline
from groundtrace.pipeline.engine import ReplaySession, replay
from groundtrace.pipeline.source import Source
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.recording import Recording
from groundtrace_viewers.rerun.blueprint import blueprint
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import TIMELINE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rerun.experimental import ViewerClient
    from shared_viewer import SharedViewer

    from groundtrace.simulate.recording import Simulation

#: What stations beside a road have, and the pipeline of antennas has not.
PASSES = '[[stage]]\nname = "passes"\nuse = "vehicle-passes"\n'


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of recording: through what it is replayed, with what stages more."""

    pipeline: str
    simulation: Simulation
    map_tiles: bool = False
    more: str = ""


def case(kind: str) -> Case:
    if kind == "room":
        # longer than the viewer shows at first: it has views that shorter ones have not
        room = RoomOptions(seed=4, duration_s=61.0, channels=4, rate_hz=4000.0)
        return Case("room-footsteps", simulate_room(room))
    if kind == "bearings":
        stations = RoomOptions(seed=4, duration_s=5.0, channels=4, triaxial=True)
        return Case("room-bearings", simulate_room(stations))
    if kind == "walker":
        walk = WalkOptions(seed=3, duration_s=14.0, gnss=True)
        return Case("pedestrian", simulate_walk(walk), map_tiles=True)
    car = VehicleOptions(rate_hz=100.0, duration_s=24.0)
    return Case("vehicle-tracks", simulate_vehicle(car), more=PASSES)


@pytest.fixture
def viewer() -> Iterator[SharedViewer]:
    """Return a viewer whose window is small: each picture of a view draws all of it."""
    yield from running_viewer("800x520")


def side_by_side(*args: Any, **options: Any) -> rrb.Blueprint:
    """Return a layout's views without tabs: what no tab shows has no picture."""
    found = blueprint(*args, **options)
    time = rrb.TimePanel(state="hidden", timeline=TIMELINE, play_state="paused")
    panels = (rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden"), time)
    views = rrb.Grid(*views_of(found.root_container))
    return rrb.Blueprint(views, *panels, auto_views=False, auto_layout=False)


def views_of(part: Any) -> list[rrb.View]:
    if isinstance(part, rrb.View):
        return [part]
    return [view for inner in part.contents for view in views_of(inner)]


def replayed(folder: Path, case: Case) -> tuple[Path, float]:
    """Replay a simulation; return its timeline and the time of its third step or pass [s]."""
    path = folder / "r.mcap"
    write(case.simulation, path)
    with Recording.open(path) as recording:
        recipe = named_pipelines()[case.pipeline].read_text() + case.more
        config = parse_pipeline(recipe.encode(), case.pipeline)
        chain = build_pipeline(config, recording.geometry, recording.labels)
        source = Source(recording)
        session = ReplaySession(
            path.name,
            chain.config.application,
            recording.start_ns,
            recording.end_ns,
            source.streams,
            recording.geometry,
            recording.labels,
            chain.recipe(),
        )
        sink = RerunSink(folder / "r.rrd", map_tiles=case.map_tiles)
        sink.open(session)
        replay(source, chain, [sink])
        sink.close()
    steps = sorted(x.time_ns for x in session.labels if x.kind in ("step", "pass"))
    return folder / "r.rrd", (steps[2] - session.start_ns) / 1e9 + 0.01


def without_data(folder: Path, rrd: Path) -> Path:
    """Write a recording of the same kind in which there is nothing."""
    application = rr.chunk.RrdReader(str(rrd)).recordings()[0].application_id
    recording = rr.RecordingStream(application, recording_id="empty", send_properties=False)
    recording.save(folder / "empty.rrd")
    recording.set_time(TIMELINE, duration=0.0)
    recording.log("/nothing", rr.AnyValues(nothing=True))
    recording.set_time(TIMELINE, duration=20.0)
    recording.log("/nothing", rr.AnyValues(nothing=True))
    recording.flush()
    recording.disconnect()
    return folder / "empty.rrd"


def pictures(client: ViewerClient) -> dict[str, np.ndarray]:
    """Return a picture of every view."""
    views = client.get_state().views
    return {view.name: pixels(client.take_screenshot(view.view_id)) for view in views}


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Return the part of two pictures that differs; they may be a pixel apart in size."""
    height, width = np.minimum(one.shape, other.shape)[:2]
    apart = np.abs(one[:height, :width] - other[:height, :width])
    return float((apart.max(axis=2) > 24).mean())


def complaints_and_sameness(
    viewer: SharedViewer, rrd: Path, empty: Path, at_s: float
) -> tuple[dict, list[str], int]:
    """Return complaints of views, views that look the same without data, and how many there are."""
    viewer.open(rrd, at_s)
    shown = pictures(viewer.client)
    views = viewer.client.get_state().views
    viewer.open_beside(empty, at_s)
    nothing = pictures(viewer.client)
    assert shown.keys() == nothing.keys(), "one layout for both"
    reports = {v.name: [r.summary for r in v.reports] for v in views if v.reports}
    same = [name for name, picture in shown.items() if changed(picture, nothing[name]) < 1e-3]
    return reports, same, len(views)


@pytest.mark.parametrize(
    "kind", swept(["room", "bearings", "walker", "shots", "vehicle"], "walker")
)
def test_every_view_shows_its_data_and_none_complains(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, viewer: SharedViewer
) -> None:
    monkeypatch.setattr("groundtrace_viewers.rerun.sink.blueprint", side_by_side)
    if kind == "shots":
        rrd, at_s = write_shots(tmp_path / "r.rrd", shot_labels()), 1.05
    else:
        rrd, at_s = replayed(tmp_path, case(kind))
    reports, same, views = complaints_and_sameness(viewer, rrd, without_data(tmp_path, rrd), at_s)
    assert reports == {}
    assert same == []
    assert views >= 8
