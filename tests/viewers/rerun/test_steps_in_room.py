from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from viewer_sessions import (
    NAMES,
    SEISMIC,
    START_NS,
    STEPS_S,
    at,
    blocks,
    read_back,
    room_session,
    seismic_samples,
)

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import parse_pipeline
from groundtrace.pipeline.engine import replay
from groundtrace_codecs.events import Bearing, Disagreement, Fix, Pick, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import Channel
from groundtrace_viewers.rerun.sink import RerunSink

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from groundtrace.pipeline.engine import ReplaySession
    from groundtrace_codecs.events import Event

SCALARS, LABELS = "Scalars:scalars", "Points2D:labels"
STRIPS = "LineStrips2D:strips"
RECIPE = """
name = "test"
[[stage]]
name = "picks"
use = "sta-lta"
[[stage]]
name = "steps"
use = "coincidence"
[[stage]]
use = "so-tdoa"
"""
PICKS = StageSpec("picker", "?", "/seismic", NAMES, (), (), (), "pick")
STEPS = StageSpec("steps", "?", "/seismic", ("all",), (), (), (), "step")
BY_SIGNS = StageSpec("by-signs", "so-tdoa", "/seismic", ("all",), (), (), (), "fix")


def written(path: Path, session: ReplaySession, events: Iterable[Event], wide: int = 1) -> Path:
    sink = RerunSink(path)
    sink.open(session)
    for event in (PICKS, STEPS, BY_SIGNS, *events):
        sink.write(event)
    samples = np.tile(seismic_samples(), (1, wide))
    for block in blocks(session.streams[0], samples, 1000):
        sink.write(block)
    sink.close()
    return path


def arrivals(late_ms: dict[str, float], at_s: float = 0.8) -> list[Event]:
    """Return picks so many milliseconds after a step, and the step."""
    picks = [
        Pick(at(at_s + ms / 1e3), name, "/seismic", "picker", 1e-4, 9.0)
        for name, ms in late_ms.items()
    ]
    return [*picks, StepEvent(at(at_s), "step", "", "/seismic", "steps", 9.0, len(picks))]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay by a pipeline, with its curves."""
    pipeline = build_pipeline(parse_pipeline(RECIPE.encode(), "test"), room_session().geometry)
    path = tmp_path_factory.mktemp("curves") / "room.rrd"
    sink = RerunSink(path)
    sink.open(replace(room_session(), pipeline=pipeline.recipe()))
    replay(blocks(SEISMIC, seismic_samples(), 700), pipeline, [sink])
    sink.close()
    return path


def test_a_sensors_name_says_when_the_wave_arrived_and_is_grey_without(tmp_path: Path) -> None:
    events = arrivals({"G1": 0.0, "G2": 3.2, "G3": 5.04})
    path = written(tmp_path / "r.rrd", room_session(), events)
    times, labels = read_back(path, "/map/site/names", LABELS)
    assert labels[1] == ["G1 +0.0 ms", "G2 +3.2 ms", "G3 +5.0 ms", "G4"]
    assert labels[0] == labels[2] == list(NAMES)
    np.testing.assert_array_equal(times - times[0], [0, 800_000_000, 1_300_000_000])
    _, colours = read_back(path, "/map/site/names", "Points2D:colors")
    assert [a == b for a, b in zip(colours[0], colours[1], strict=True)] == [True] * 3 + [False]


def test_the_region_of_a_steps_signs_is_lit_and_goes_out(tmp_path: Path) -> None:
    events = arrivals({"G1": 0.0, "G2": 2.0, "G3": 5.0, "G4": 3.0})
    path = written(tmp_path / "r.rrd", room_session(), events)
    times, rings = read_back(path, "/map/site/regions/rings", STRIPS)
    assert times.tolist() == [800_000_000, 1_300_000_000]
    assert [len(r) for r in rings] == [1, 0]
    corners = np.array(rings[0][0])
    apart = np.linalg.norm(corners.mean(axis=0) - [(0, 0), (6, 0), (6, 5), (0, 5)], axis=1)
    assert np.argsort(apart).tolist() == [0, 1, 3, 2], "the order of the arrivals"
    assert len(read_back(path, "/map/site/regions/fills", STRIPS)[1][0]) > 5
    [page] = read_back(path, "/signs", "TextDocument:text")[1][-1]
    assert "0 of 6 signs wrong" in page


def test_wrong_signs_are_counted_and_marked(tmp_path: Path) -> None:
    # of a rectangle's corners the farthest lies opposite the nearest
    events = arrivals({"G1": 0.0, "G3": 2.0, "G2": 3.0, "G4": 4.0})
    path = written(tmp_path / "r.rrd", room_session(), events)
    [page] = read_back(path, "/signs", "TextDocument:text")[1][-1]
    assert "of 6 signs wrong" in page
    assert "0 of 6" not in page
    assert "✗" in page.split("```")[1]
    assert "| pair i–j | measured | region |" in page


def test_all_borders_of_regions_are_drawn_once(tmp_path: Path) -> None:
    path = written(tmp_path / "r.rrd", room_session(), [])
    drawn = [
        chunk
        for chunk in rr.chunk.RrdReader(str(path)).stream().filter(content="/map/site/regions/**")
        if chunk.is_static
    ]
    batch = drawn[0].to_record_batch()
    # of a rectangle's corners: two middle lines and two diagonals
    assert len(batch.column(STRIPS)[0]) == 4


def test_two_arrivals_light_nothing(tmp_path: Path) -> None:
    path = written(tmp_path / "r.rrd", room_session(), arrivals({"G1": 0.0, "G2": 1.0}))
    _, rings = read_back(path, "/map/site/regions/rings", STRIPS)
    assert not any(len(r) for r in rings)
    [[page]] = read_back(path, "/signs", "TextDocument:text")[1]
    assert page == "No step with 3 arrivals so far."


def test_a_site_without_places_has_neither_map_nor_regions(tmp_path: Path) -> None:
    session = replace(room_session(), geometry=None, labels=())
    path = written(tmp_path / "r.rrd", session, arrivals({"G1": 0.0, "G2": 1.0, "G3": 2.0}))
    paths = rr.chunk.RrdReader(str(path)).store().schema().entity_paths()
    assert not any(p.startswith(("/map", "/signs")) for p in paths)


def test_the_curve_of_a_picker_is_its_own_at_every_sample_around_steps(replayed: Path) -> None:
    times, values = read_back(replayed, "/decision/picks/seismic", SCALARS)
    assert len(times)
    steps, _ = read_back(replayed, "/steps/seismic", SCALARS)
    steps = steps[::3]  # an upright: two ends, and where the line ends
    missed = [at(STEPS_S[0]) - START_NS]
    assert np.abs(steps - missed).min() > 10**8
    steps = np.append(steps, missed)
    from_step = (times[:, None] - steps) / 1e9
    assert (np.abs(from_step).min(axis=1) < 0.1001).all()
    curve = np.array(values)
    assert np.isnan(curve).all(axis=1).sum() == len(steps), "curves end between steps"
    assert np.nanmax(curve) == 24.0, "cut at four thresholds"


def test_a_stage_tells_its_curve_whose_cells_peaks_are_the_frames_ratio() -> None:
    stage = build_pipeline(parse_pipeline(RECIPE.encode(), "test"), None).stages[0]
    curves, frames = [], []
    for block in blocks(SEISMIC, seismic_samples(), 1000):
        events = list(stage.process(block))
        curves.append(stage.curve("/seismic"))  # type: ignore[attr-defined]
        frames += [e for e in events if type(e).__name__ == "TraceBlock"]
    time_ns = np.concatenate([c.time_ns for c in curves])
    value = np.concatenate([c.value for c in curves])
    np.testing.assert_array_equal(np.diff(time_ns), 500_000)
    for frame in frames:
        for start, reached in zip(frame.time_ns, frame.value[:, :, 0], strict=True):
            inside = (time_ns >= start) & (time_ns < start + 50_000_000)
            if inside.sum() == 100:
                np.testing.assert_allclose(value[inside].max(axis=0), reached, rtol=1e-5)


@pytest.mark.parametrize("picker", ["sta-lta", "toa-cv", "toa-sb"])
def test_the_curve_around_a_step_is_that_of_one_run_over_everything(
    tmp_path: Path, picker: str
) -> None:
    recipe = parse_pipeline(RECIPE.replace("sta-lta", picker).encode(), "test")
    pipeline = build_pipeline(recipe, room_session().geometry)
    sink = RerunSink(tmp_path / "room.rrd")
    sink.open(replace(room_session(), pipeline=pipeline.recipe()))
    replay(blocks(SEISMIC, seismic_samples(), 700), pipeline, [sink])
    sink.close()
    times, values = read_back(tmp_path / "room.rrd", "/decision/picks/seismic", SCALARS)
    drawn = np.array(values)
    shown = ~np.isnan(drawn).all(axis=1)
    stage = build_pipeline(recipe, None).stages[0]
    known, curves = [], []
    for block in blocks(SEISMIC, seismic_samples(), 700):
        stage.process(block)
        curve = stage.curve("/seismic")  # type: ignore[attr-defined]
        if curve is not None:
            known.append(curve.time_ns)
            curves.append(curve.value)
    rows = np.searchsorted(np.concatenate(known) - START_NS, times[shown])
    top = np.nanmax(drawn)
    expected = np.minimum(np.concatenate(curves)[rows], top)
    assert shown.sum() > 1000
    # half a step of the value axis, and what the start of a run leaves
    assert np.abs(drawn[shown] - expected).max() < 0.015 * top


def triaxial() -> ReplaySession:
    """Two stations of three axes, at the left corners."""
    names = [f"{station}{axis}" for station in ("A", "B") for axis in "xyz"]
    channels = tuple(Channel(n, "ground_velocity", "m/s", n[1], 2e-9) for n in names)
    sensors = tuple(Sensor(n, n, 0.0, 5.0 * (n[0] == "B"), axis=n[1]) for n in names)
    geometry = Geometry(sensors, ((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)))
    return replace(
        room_session(), streams=(replace(SEISMIC, channels=channels),), geometry=geometry
    )


def test_bearings_are_rays_to_the_wall_with_their_sides(tmp_path: Path) -> None:
    session = triaxial()
    sink = RerunSink(tmp_path / "tri.rrd")
    sink.open(session)
    step = StepEvent(at(0.8), "step", "", "/seismic", "steps", 9.0, 3)
    ray = Bearing(at(0.8), "A", np.pi / 4, 0.1, 0.9, ambiguous=False, stage="bearings")
    samples = np.tile(seismic_samples(), (1, 2))[:, :6]
    first = Pick(at(0.8), "Ax", "/seismic", "picker", 1e-4, 9.0)
    for event in (
        replace(PICKS, channels=tuple(c.name for c in session.streams[0].channels)),
        first,
        step,
        ray,
    ):
        sink.write(event)
    for block in blocks(session.streams[0], samples, 1000):
        sink.write(block)
    sink.close()
    times, rays = read_back(tmp_path / "tri.rrd", "/map/site/bearings/rays", STRIPS)
    assert times.tolist() == [800_000_000, 1_300_000_000]
    np.testing.assert_allclose(rays[0], [[[0.0, 0.0], [5.0, 5.0]]], atol=1e-6)
    assert len(rays[1]) == 0
    _, fans = read_back(tmp_path / "tri.rrd", "/map/site/bearings/fans", STRIPS)
    assert len(fans[0]) == 2
    _, motion = read_back(tmp_path / "tri.rrd", "/hodogram/plots/motion", STRIPS)
    assert len(motion[0]) == 4, "two squares a station"
    _, names = read_back(tmp_path / "tri.rrd", "/map/site/names", LABELS)
    assert len(names[0]) == 2, "one name a place"


def test_localizers_that_disagree_are_joined_by_a_line(tmp_path: Path) -> None:
    sure = (0.01, 0.0, 0.01)
    events = [
        Fix(at(2.0), 1.0, 1.0, sure, 0.0, "one", 4, "one"),
        Fix(at(2.0), 4.0, 1.0, sure, 0.0, "other", 4, "other"),
        Disagreement(at(2.0), 3.0, 21.2, "one, other", "disagreement"),
    ]
    path = written(tmp_path / "r.rrd", room_session(), events)
    times, lines = read_back(path, "/map/site/disagreements", STRIPS)
    assert times.tolist() == [2_000_000_000]
    np.testing.assert_allclose(lines[0], [[[1.0, 1.0], [4.0, 1.0]]])
    _, [text] = read_back(path, "/log/disagreements", "TextLog:text")
    assert text == ["2.000 s  one and other disagree by 3.00 m, 21.2 sigma (disagreement)"]


def test_true_paths_of_two_walkers_are_apart(tmp_path: Path) -> None:
    session = room_session()
    labels = tuple(
        replace(x, target="B" if x.label == "left" else "A") if x.kind == "step" else x
        for x in session.labels
    )
    path = written(tmp_path / "r.rrd", replace(session, labels=labels), [])
    for walker, first in (("A", 1.4), ("B", 0.8)):
        times, _ = read_back(path, f"/map/site/truth/path/{walker}", STRIPS)
        assert times.tolist() == [round((first + 1.2 * k) * 1e9) for k in (1, 2, 3)]
    _, states = read_back(path, "/state/1-truth/step", "StateChange:state")
    assert [s for [s] in states if s] == ["B", "A"] * (len(STEPS_S) // 2)


def test_an_unknown_unit_is_named_where_lengths_are(tmp_path: Path) -> None:
    session = room_session()
    assert session.geometry is not None
    odd = replace(session, geometry=replace(session.geometry, unit="unknown"))
    apart = Disagreement(START_NS, 3.0, 21.2, "one, other", "disagreement")
    path = written(tmp_path / "r.rrd", odd, [apart])
    _, [text] = read_back(path, "/log/disagreements", "TextLog:text")
    assert "3.00 units" in text[0]


def test_sensors_are_named_where_there_are_no_steps(tmp_path: Path) -> None:
    path = written(tmp_path / "r.rrd", replace(room_session(), application="shots"), [])
    times, labels = read_back(path, "/map/site/names", LABELS)
    assert (times.tolist(), labels) == ([0], [list(NAMES)])
