"""The truth beside a road: passes, waypoints, steps and impacts; and the traffic they tell of."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_roads import of_kind, simulated

from groundtrace.evaluation.positions import true_places
from groundtrace.evaluation.tracks import score_tracks
from groundtrace_codecs.events import TrackPoint

START_NS = 1_767_603_600_000_000_000


def seconds(label):
    return (label.time_ns - START_NS) / 1e9


def test_the_default_car_crosses_both_antennas():
    default = simulated()
    passes = of_kind(default, "pass")
    assert {p.channel for p in passes} == {"A1", "A2", "A3", "B1", "B2", "B3"}
    assert {(p.target, p.label, p.value) for p in passes} == {("V1", "forward", 10.0)}
    by_station = {p.channel: p for p in passes}
    for antenna, y in (("A", 0.0), ("B", 20.0)):
        ends = [by_station[f"{antenna}{i}"] for i in (1, 3)]
        assert min(p.y_m for p in ends) - 5 < y < max(p.y_m for p in ends) + 5
        assert 0 < np.mean([p.x_m for p in ends]) < 20


@pytest.mark.parametrize("bent", [{}, {"radius_m": 120.0}, {"end_speed_mps": 16.0}])
def test_a_pass_is_the_closest_of_the_way_that_waypoints_tell(bent):
    road = simulated(layout="stations", speed_mps=8.0, **bent)
    ways = of_kind(road, "waypoint")
    time_s = np.array([seconds(w) for w in ways])
    assert np.diff(time_s) == pytest.approx(np.ones(len(ways) - 1))
    fine = np.arange(time_s[0], time_s[-1], 0.01)
    places = [np.interp(fine, time_s, [getattr(w, n) for w in ways]) for n in ("x_m", "y_m")]
    assert len(of_kind(road, "pass")) == 3
    for one in of_kind(road, "pass"):
        sensor = next(s for s in road.geometry.sensors if s.name == one.channel)
        away = np.hypot(places[0] - sensor.x, places[1] - sensor.y)
        assert seconds(one) == pytest.approx(fine[np.argmin(away)], abs=0.35)
        told = float(one.note.split(" m")[0])
        assert told == pytest.approx(np.hypot(one.x_m - sensor.x, one.y_m - sensor.y), abs=0.006)
        assert told <= away.min() + 0.15
        near = np.abs(time_s - seconds(one)).argmin()
        ahead, behind = ways[near + 1], ways[near - 1]
        speed = np.hypot(ahead.x_m - behind.x_m, ahead.y_m - behind.y_m) / 2
        assert one.value == pytest.approx(speed, rel=0.03)


def test_several_vehicles_come_from_both_sides_in_order_and_some_overlap():
    busy = simulated(layout="stations", passes=5, overlap=True, seed=9)
    middle = [p for p in of_kind(busy, "pass") if p.channel == "S2"]
    assert [p.target for p in middle] == ["V1", "V2", "V3", "V4", "V5"]
    assert {p.label for p in middle} == {"forward", "backward"}
    assert middle[0].label != middle[1].label
    assert 0 < seconds(middle[1]) - seconds(middle[0]) <= 2.0
    assert len({p.value for p in middle}) == 5
    assert busy.sources[0][2].duration_s == 150
    for label, y in (("forward", 5 - 1.75), ("backward", 5 + 1.75)):
        assert {round(p.y_m, 6) for p in middle if p.label == label} == {y}
    order = [p.channel for p in of_kind(busy, "pass") if p.target == "V3"]
    forward = middle[2].label == "forward"
    assert order == (["S1", "S2", "S3"] if forward else ["S3", "S2", "S1"])
    levels = [float(mu) for mu in busy.metadata["vehicle_mu"].values()]
    assert 1.0 < max(levels) / min(levels) < 100


def test_places_that_scores_look_at_are_the_vehicles_alone():
    busy = simulated(layout="stations", passes=2, walkers=1, impacts=3, duration_s=60.0)
    assert set(true_places(busy.labels).names()) == {"V1", "V2"}
    found = [
        TrackPoint(
            w.time_ns, int(w.target[1]), w.x_m + 0.5, w.y_m, 0.0, 0.0, (1.0, 0.0, 1.0), "cars"
        )
        for w in of_kind(busy, "waypoint")
    ]
    score = score_tracks(busy.labels, found)
    assert score.localisation_rmse_m == pytest.approx(0.5)
    assert (score.completeness, score.missed, score.false) == (1.0, 0, 0)


def test_walkers_step_at_1_8_hz_within_their_span():
    walked = simulated(layout="stations", walkers=2, seed=5)
    for who in ("W1", "W2"):
        steps = [s for s in of_kind(walked, "step") if s.target == who]
        assert len(steps) > 20
        gaps = np.diff([seconds(s) for s in steps])
        assert np.median(gaps) == pytest.approx(1 / 1.8, abs=0.03)
        (span,) = [w for w in of_kind(walked, "walking") if w.target == who]
        assert span.time_ns <= steps[0].time_ns
        assert steps[-1].time_ns < span.end_ns


def test_the_recording_says_the_road_and_the_velocity():
    bent = simulated(layout="stations", radius_m=50.0, velocity_mps=180.0)
    assert bent.geometry.medium.velocity_mps == 180.0
    assert len(bent.geometry.road) > 100
    straight = simulated(layout="stations", stations=2, spacing_m=30.0)
    assert straight.geometry.road == ((-85.0, 5.0), (115.0, 5.0))
    assert [(s.name, s.x) for s in straight.geometry.sensors] == [("S1", 0.0), ("S2", 30.0)]


def test_a_vehicle_that_the_recording_ends_before_does_not_pass():
    ends = simulated(layout="stations", stations=4, spacing_m=50.0, speed_mps=5.0, duration_s=4.0)
    assert of_kind(ends, "pass") == []
