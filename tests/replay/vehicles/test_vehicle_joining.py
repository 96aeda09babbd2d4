"""Cycles of several recorders put together, lines that are crossed, stations along a road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vehicle_runs import replayed, road

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.simulate.road import VehicleOptions
from groundtrace.vehicles.course_stages import TrackOrigin, crossing_of, lines_of
from groundtrace.vehicles.courses import RunCollector, RunLimits
from groundtrace.vehicles.lines import Course
from groundtrace.vehicles.stations import StationPowers
from groundtrace_codecs.events import Pass
from groundtrace_codecs.geometry import Geometry, Sensor, Stations

STATIONS = VehicleOptions(layout="stations", passes=2, seed=3, duration_s=60)


def site(
    *places: tuple[str, float, float], along: tuple[tuple[float, float], ...] = ()
) -> Stations:
    sensors = tuple(Sensor(name, name, x, y) for name, x, y in places)
    return Geometry(sensors=sensors, road=along).stations()


def test_stations_with_a_recorder_each_pass_as_those_of_one() -> None:
    simulation, blocks = road(STATIONS)
    chain = build_pipeline(load_pipeline("vehicle-passes"), simulation.geometry)
    events = []
    for block in blocks:
        for column in range(3):
            one = block.select([column])
            stream = replace(one.stream, topic=f"/recorder{column + 1}")
            events += chain.process(replace(one, stream=stream))
    events += chain.flush()
    apart = [e for e in events if isinstance(e, Pass)]
    together = [e for e in replayed(STATIONS, "vehicle-passes") if isinstance(e, Pass)]
    assert [(p.time_ns, p.station, p.vehicle) for p in apart] == [
        (p.time_ns, p.station, p.vehicle) for p in together
    ]


def test_axes_of_one_place_are_one_station() -> None:
    sensors = [Sensor("S1", f"S1{axis}", 1.0, 2.0, axis=axis) for axis in "xyz"]
    found = Geometry(sensors=(*sensors, Sensor("S2", "S2", 5.0, 2.0))).stations()
    assert found.names == ("S1", "S2")
    assert found.of_channel == {"S1x": 0, "S1y": 0, "S1z": 0, "S2": 1}


def test_antennas_are_lines_by_their_names() -> None:
    found = lines_of(site(("A1", 0, 0), ("A3", 20, 0), ("A2", 10, 0), ("B1", 0, 9)), "1,2 3,4")
    assert [line.name for line in found] == ["line", "A1-A3"]
    assert found[1].end.tolist() == [20, 0]


@pytest.mark.parametrize(("velocity", "crossed"), [((1.0, 5.0), True), ((5.0, 1.0), False)])
def test_a_line_is_crossed_only_across(velocity: tuple[float, float], crossed: bool) -> None:
    line = lines_of(site(("A1", 0, 0), ("A2", 20, 0)))[0]
    course = Course(0.0, np.array([10.0, -1.0]), np.array(velocity), np.eye(4))
    found = list(crossing_of(line, course, (-9.0, 9.0), TrackOrigin(1, "course", 0)))
    assert bool(found) == crossed
    if crossed:
        assert (found[0].time_ns, found[0].x_m) == (200_000_000, pytest.approx(10.2))
        assert not list(crossing_of(line, course, (1.0, 9.0), TrackOrigin(1, "course", 0)))


def test_stations_beside_a_road_are_told_from_antennas_across_it() -> None:
    along = ((-50.0, 5.0), (100.0, 5.0))
    assert site(("S1", 0, 0), ("S2", 20, 0), ("S3", 40, 1), along=along).in_line()
    assert not site(("A1", 0, 0), ("A2", 0, 20), ("A3", 0, 40), along=along).in_line()
    assert not site(
        ("A1", 0, 0), ("A2", 20, 0), ("B1", 0, 20), ("B2", 20, 20), along=along
    ).in_line()


def test_places_along_a_bent_road_are_along_its_corners() -> None:
    bent = ((0.0, 0.0), (10.0, 0.0), (10.0, 30.0))
    way, away = site(("S1", 4, 2), ("S2", 13, 20), along=bent).along_road()
    assert way == pytest.approx([4, 30])
    assert away == pytest.approx([2, 3])


def cycle(second: float, present: bool) -> StationPowers:
    one = np.ones(1)
    return StationPowers(round(second * 1e9), one, one, np.zeros(1), one, np.array([present]))


def test_a_run_has_its_lead_and_ends_after_quiet() -> None:
    runs = RunCollector(RunLimits(lead_s=2, quiet_s=3, most_s=60))
    heard = {5, 6, 8}
    found = [runs.take(cycle(t, t in heard)) for t in range(20)]
    (run,) = [r for r in found if r]
    assert [c.time_ns // 10**9 for c in run] == list(range(2, 13))
    assert found.index(run) == 12
    assert runs.flush() == []


def test_a_run_that_does_not_end_is_cut() -> None:
    runs = RunCollector(RunLimits(lead_s=0, quiet_s=3, most_s=10))
    found = [runs.take(cycle(t, True)) for t in range(25)]
    assert [len(r) for r in found if r] == [12, 12]
