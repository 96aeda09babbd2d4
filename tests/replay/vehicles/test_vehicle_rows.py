"""Nodes in a row, as people lay them out beside a road: three components, 250 Hz, no outline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sweeps import swept
from vehicle_nodes import EMPTY, MIXED, Table, rival
from vehicle_nodes import told as told_of_site
from vehicle_powers import LAW
from vehicle_runs import replayed, told

from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace.vehicles.course_stages import (
    CourseFinder,
    CourseParameters,
    CurveFinder,
    CurveParameters,
    CycleCourseFinder,
    CycleCourseParameters,
    mirror_lost,
)
from groundtrace.vehicles.courses import Observed
from groundtrace.vehicles.medium import fit_powers, ranges
from groundtrace.vehicles.stations import StationPowers
from groundtrace_codecs.events import Event, Fix, Note, Pass, TrackPoint
from groundtrace_codecs.geometry import Geometry, Sensor

ROW = VehicleOptions(components=3, rate_hz=250, offset_m=8, passes=1, duration_s=24, seed=2)
PLACES = np.array([(0.0, 0.0), (20.0, 0.0), (40.0, 0.0)])


def nodes(*places: tuple[float, float]) -> Geometry:
    """A site of nothing but nodes of three components."""
    return Geometry(
        sensors=tuple(
            Sensor(f"N{i}", f"N{i}{axis}", *place, axis=axis)
            for i, place in enumerate(places, 1)
            for axis in "xyz"
        )
    )


def in_a_row(count: int) -> VehicleOptions:
    return replace(ROW, geometry=nodes(*[(20.0 * i, 0.0) for i in range(count)]))


def warnings(events: list[Event], stage: str) -> list[str]:
    return [
        e.text for e in events if isinstance(e, Note) and e.level == "WARN" and e.source == stage
    ]


def test_which_side_of_three_nodes_in_a_row_it_is_on_is_said_not_to_be_told() -> None:
    events = replayed(in_a_row(3), "vehicle-tracks")
    tracks = {(e.stage, e.track) for e in events if isinstance(e, TrackPoint)}
    assert ("course", 1) in tracks
    for stage, _ in tracks:
        (text,) = [text for text in warnings(events, stage) if "mirror" in text]
        assert "in the row of N1, N2, N3 fits the powers as well" in text
    for stage in {e.stage for e in events if isinstance(e, Fix)}:
        (text,) = warnings(events, stage)
        assert "stand in a row: which side of it a place is on" in text


def test_a_row_gives_the_same_whatever_the_blocks() -> None:
    assert told(replayed(in_a_row(3), "vehicle-tracks", samples=83)) == told(
        replayed(in_a_row(3), "vehicle-tracks")
    )


@pytest.mark.parametrize("count", [1, 2])
def test_two_nodes_or_one_have_no_tracks_and_a_note_that_says_how_many_it_takes(count: int) -> None:
    events = replayed(in_a_row(count), "vehicle-tracks")
    assert not [e for e in events if isinstance(e, TrackPoint | Fix)]
    (text,) = places_missing(events)
    assert text.endswith(f"places of 3 or more stations, found {count}")


def places_missing(events: list[Event]) -> list[str]:
    return [text for text in warnings(events, "course") if "though one was asked" not in text]


def test_nodes_at_one_spot_are_one_station() -> None:
    spot = replace(ROW, geometry=nodes((5.0, 0.0), (5.0, 0.0), (5.0, 0.0)))
    events = replayed(spot, "vehicle-tracks")
    assert not [e for e in events if isinstance(e, TrackPoint | Fix)]
    (text,) = places_missing(events)
    assert text.endswith("found 1")


@pytest.mark.parametrize("count", [1, 3])
def test_a_row_has_passes_whatever_its_length(count: int) -> None:
    events = replayed(in_a_row(count), "vehicle-passes")
    assert {e.station for e in events if isinstance(e, Pass)} == {
        f"N{i}" for i in range(1, count + 1)
    }


def wild(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, powers and floors at a row: up to two vehicles, bursts, fades, a dead node."""
    rng = np.random.default_rng(seed)
    times = np.arange(int(rng.integers(8, 40))) * 0.5
    mean = np.full((len(times), 3), 0.005)
    for _ in range(int(rng.integers(0, 3))):
        place, velocity, mu = rng.uniform(-30, 60, 2), rng.normal(0, 10, 2), rng.lognormal(0, 2)
        way = place + (times[:, None] - times[-1] / 2) * velocity
        mean = mean + mu * LAW.power(ranges(way, PLACES))
    if seed % 4 == 1:
        mean[rng.integers(0, len(times)) :, rng.integers(0, 3)] *= rng.lognormal(2, 2)
    if seed % 4 == 2:
        mean *= rng.lognormal(0, 1, mean.shape)
    freedom = rng.choice([1, 3, 18, 100])
    powers = mean * rng.gamma(freedom, 1 / freedom, mean.shape)
    if seed % 4 == 3:
        powers[:, rng.integers(0, 3)] = rng.choice([0, np.nan])
    return times, powers, np.full(powers.shape, 0.005)


@pytest.mark.parametrize("seed", swept([0, 1, 2, 3, 13], 0, 3))
def test_a_run_of_any_powers_at_a_row_ends_without_an_error(seed: int) -> None:
    times, powers, floors = wild(seed)
    for worker in (
        CourseFinder(CourseParameters()),
        CycleCourseFinder(CycleCourseParameters()),
        CurveFinder(CurveParameters()),
    ):
        worker.begin(nodes(*map(tuple, PLACES.tolist())).stations(), "course")
        for time_s, power, floor in zip(times, powers, floors, strict=True):
            worker.take(
                StationPowers(round(time_s * 1e9), power, floor, 0 * floor, power, floor > 0)
            )
        found = worker.finish()
        points = [
            e for e in worker.follow(np.ones(len(found), np.bool_)) if isinstance(e, TrackPoint)
        ]
        assert all(np.isfinite([p.x_m, p.y_m, p.vx_mps, p.vy_mps]).all() for p in points)


def test_a_fit_whose_powers_leave_a_parameter_open_ends() -> None:
    def mean(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # only the sum of the two counts; it comes nearer so slowly that the damping vanishes
        return np.full(3, np.exp(values.sum() / 20)), np.ones((3, 2))

    fit = fit_powers(mean, np.array([1.0, 2.0, 3.0]), np.zeros(2))
    assert not np.isfinite(fit.covariance).all()


def test_only_what_stands_beside_a_row_has_a_mirror_image() -> None:
    times = np.arange(0, 20, 0.5)
    for across, told_apart in ((9.0, False), (0.0, True)):
        way = np.stack([4 * times - 20, np.full(len(times), across)], axis=1)
        powers = 50 * LAW.power(ranges(way, PLACES)) + 0.005
        seen = Observed(times, powers, np.full(powers.shape, 0.005), PLACES, LAW)
        lost = mirror_lost(seen, way, 1.0)
        assert (lost == np.inf) is told_apart
        if not told_apart:
            assert lost == pytest.approx(0, abs=1e-9)
        bent = replace(seen, sensors=PLACES + np.array([(0, 0), (0, 12), (0, 0)]))
        bent = replace(bent, powers=50 * LAW.power(ranges(way, bent.sensors)) + 0.005)
        assert told_apart or mirror_lost(bent, way, 1.0) > 3


def test_passes_of_a_drawn_site_are_no_worse_than_peaks_in_order() -> None:
    site = {"seed": 24, "layout": "nodes", "components": 3}  # a seed that chose nothing
    mixed = simulate_vehicle(VehicleOptions(**site, **MIXED))
    empty = simulate_vehicle(VehicleOptions(**site, **EMPTY))
    ours, rivals = Table(), Table()
    ours.add(mixed, told_of_site(mixed))
    rivals.add(mixed, rival(mixed))
    assert ours.right >= rivals.right
    assert ours.wrong + ours.false <= rivals.wrong + rivals.false
    assert len(told_of_site(empty)) <= len(rival(empty))
