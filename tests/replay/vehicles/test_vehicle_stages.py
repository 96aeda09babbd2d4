"""Places, courses, crossings and passes, through the shipped pipelines."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from vehicle_runs import START_NS, replayed, road, told

from groundtrace.errors import PipelineError
from groundtrace.evaluation.report import score_events
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, parse_pipeline
from groundtrace.pipeline.stage import LocationEstimate
from groundtrace.simulate.road import VehicleOptions
from groundtrace_codecs.events import (
    CandidateBlock,
    Event,
    Fix,
    LikelihoodSurface,
    LineCrossing,
    Note,
    Pass,
    StageSpec,
    TraceBlock,
    TrackPoint,
)
from groundtrace_codecs.geometry import Geometry

CAR = VehicleOptions()
STATIONS = VehicleOptions(layout="stations", passes=2, seed=3, duration_s=60)


@pytest.fixture(scope="module")
def car() -> list[Event]:
    return replayed(CAR, "vehicle-tracks")


@pytest.fixture(scope="module")
def stations() -> list[Event]:
    return replayed(STATIONS, "vehicle-passes")


def test_blocks_of_any_size_give_the_same_tracks(car: list[Event]) -> None:
    assert told(replayed(CAR, "vehicle-tracks", samples=33)) == told(car)


def test_blocks_of_any_size_give_the_same_passes(stations: list[Event]) -> None:
    assert told(replayed(STATIONS, "vehicle-passes", samples=77)) == told(stations)


def test_the_direct_course_is_within_a_metre_of_the_way(car: list[Event]) -> None:
    simulation, _ = road(CAR)
    points = [e for e in car if isinstance(e, TrackPoint) and e.stage == "course"]
    assert {p.track for p in points} == {1}
    score = score_events(simulation.labels, car, START_NS, START_NS + 30 * 10**9)
    assert score.track is not None
    assert score.track.stage == "course"
    assert score.track.ways is not None
    assert score.track.ways.across_median_m < 1
    assert score.track.ways.speed_median_mps < 1
    assert score.positions is not None
    by_stage = {e.group: e for e in score.positions.by_stage}
    assert {"likelihood", "ratio-squares", "ratio-correlation"} == set(by_stage)
    assert by_stage["ratio-squares"].cep50_m < 2


def test_the_lines_of_both_antennas_are_crossed_when_and_where_they_were(
    car: list[Event],
) -> None:
    found = [e for e in car if isinstance(e, LineCrossing) and e.stage == "course"]
    assert [e.line for e in found] == ["A1-A3", "B1-B3"]
    slope = np.deg2rad(75)
    for event, y in zip(found, (0.0, 20.0), strict=True):
        # the road passes 1 m beside the middle of the sensors, (10, 10)
        true_x = 10 + (y - 10) / np.tan(slope) - 1 / np.sin(slope)
        assert event.x_m == pytest.approx(true_x, abs=max(4 * event.along_sigma_m, 0.5))
        assert event.y_m == pytest.approx(y, abs=1e-6)
        # the vehicle is heard throughout and raises the floors; held near 1 their factor gave 9.6
        assert event.speed_mps == pytest.approx(10, abs=0.3)


def test_every_cycle_with_a_vehicle_has_a_surface_that_peaks_near_its_place(
    car: list[Event],
) -> None:
    surfaces = {e.time_ns: e for e in car if isinstance(e, LikelihoodSurface)}
    fixes = [e for e in car if isinstance(e, Fix) and e.stage == "likelihood"]
    assert len(fixes) > 8
    for fix in fixes:
        surface = surfaces[fix.time_ns]
        values = surface.values()
        row, column = np.unravel_index(int(values.argmax()), values.shape)
        assert abs(surface.x_m + column * surface.step_m - fix.x_m) <= 2 * surface.step_m
        assert abs(surface.y_m + row * surface.step_m - fix.y_m) <= 2 * surface.step_m


def test_the_trace_of_ratios_has_all_estimators_with_their_deviations(car: list[Event]) -> None:
    traces = [e for e in car if isinstance(e, TraceBlock) and e.spec.stage == "ratio-squares"]
    spec = traces[0].spec
    assert spec.channels == ("A2/A1", "A3/A1", "B1/A1", "B2/A1", "B3/A1")
    assert [q.name for q in spec.trace][::2] == ["likelihood", "median", "geometric", "means"]
    values = np.concatenate([t.value for t in traces])
    assert (values[..., 1::2] > 0).all()
    spread = np.abs(values[..., 0] - values[..., 4]) / np.hypot(values[..., 1], values[..., 5])
    assert np.median(spread) < 1


def test_a_run_of_noise_has_no_course() -> None:
    quiet = VehicleOptions(duration_s=20, snr=0.05)
    events = replayed(quiet, "vehicle-tracks")
    assert not [e for e in events if isinstance(e, TrackPoint | Fix)]


def test_passes_are_in_time_in_direction_and_in_speed(stations: list[Event]) -> None:
    simulation, _ = road(STATIONS)
    score = score_events(simulation.labels, stations, START_NS, START_NS + 60 * 10**9)
    assert score.passes is not None
    assert (score.passes.matched, score.passes.found) == (6, 6)
    assert score.passes.vehicles_right == 2
    assert score.passes.order_right
    assert score.passes.speed_median_percent < 10
    assert score.steps is None


def test_three_axes_are_one_station() -> None:
    options = VehicleOptions(layout="stations", components=3, duration_s=40)
    found = [e for e in replayed(options, "vehicle-passes") if isinstance(e, Pass)]
    assert sorted(e.station for e in found) == ["S1", "S2", "S3"]
    assert {(e.vehicle, e.direction) for e in found} == {(1, "forward")}


def test_candidates_of_passes_carry_every_gate(stations: list[Event]) -> None:
    blocks = [e for e in stations if isinstance(e, CandidateBlock) and e.spec.stage == "passes"]
    assert blocks
    for block in blocks:
        assert block.margin.shape == (len(block), 8)
        assert np.array_equal(block.accepted, (block.margin >= 0).all(axis=1))


def test_a_copy_of_a_pipeline_goes_on_as_the_pipeline_does(stations: list[Event]) -> None:
    simulation, blocks = road(STATIONS)
    config = load_pipeline("vehicle-passes")
    first = build_pipeline(config, simulation.geometry)
    middle = len(blocks) // 2
    events = [e for b in blocks[:middle] for e in first.process(b)]
    second = copy.deepcopy(first)
    events += [e for b in blocks[middle:] for e in second.process(b)]
    assert told([*events, *second.flush()]) == told(stations)


def test_without_places_a_note_says_what_is_lacking() -> None:
    _, blocks = road(CAR)
    chain = build_pipeline(load_pipeline("vehicle-tracks"), Geometry())
    events = [e for b in blocks for e in chain.process(b)]
    notes = {e.source for e in events if isinstance(e, Note)}
    assert notes == {"likelihood", "curve", "cycle-course", "course"}
    assert {e.stage for e in events if isinstance(e, StageSpec)} == {"presence"}


def test_a_stage_of_vehicles_needs_one_that_hears_them() -> None:
    text = b'name="p"\napplication="vehicle"\n[[stage]]\nuse="vehicle-course"\n'
    with pytest.raises(PipelineError, match="a stage that hears vehicles before it"):
        build_pipeline(parse_pipeline(text, "p"))


def test_a_line_that_is_none_is_refused() -> None:
    simulation, blocks = road(CAR)
    text = b'name="p"\n[[stage]]\nuse="vehicle-presence"\n[[stage]]\nuse="vehicle-course"\n'
    text += b'[stage.parameters]\nline = "1,2 3"\n'
    chain = build_pipeline(parse_pipeline(text, "p"), simulation.geometry)
    with pytest.raises(PipelineError, match="line: expected two places as x,y x,y"):
        list(chain.process(blocks[0]))


def test_a_place_by_solving_is_one_of_the_ways() -> None:
    simulation, blocks = road(CAR)
    text = b'name="p"\napplication="vehicle"\n[[stage]]\nuse="vehicle-presence"\n'
    text += b'[[stage]]\nname="solved"\nuse="vehicle-ratios"\n[stage.parameters]\nmethod="solve"\n'
    chain = build_pipeline(parse_pipeline(text, "p"), simulation.geometry)
    events = [e for b in blocks for e in chain.process(b)] + list(chain.flush())
    fixes = [e for e in events if isinstance(e, Fix)]
    assert {e.method for e in fixes} == {"vehicle-ratios solve"}
    score = score_events(simulation.labels, events, START_NS, START_NS + 30 * 10**9)
    assert score.positions is not None
    assert score.positions.n == score.positions.truth
    assert score.positions.cep50_m < 3


def test_a_long_thin_ellipse_is_as_unsure_as_its_longer_axis() -> None:
    thin = LocationEstimate(0.0, 0.0, np.array([[400.0, 0.0], [0.0, 0.01]]), 0.1, 3)
    assert thin.larger_sigma_m == pytest.approx(20)
    assert np.sqrt(np.trace(thin.covariance) / 2) < 15
    turned = LocationEstimate(0.0, 0.0, np.array([[200.0, 199.9], [199.9, 200.0]]), 0.1, 3)
    assert turned.larger_sigma_m == pytest.approx(20, abs=0.01)
    assert LocationEstimate(0.0, 0.0, np.full((2, 2), np.inf), 0.1, 3).larger_sigma_m == np.inf
