"""Roads and ways along them: places, headings, speeds, delays."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_roads import drive

from groundtrace.simulate.road import Drive, Road

CORNERS = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
TIME_S = np.linspace(0, 20, 2001)


def test_a_road_goes_on_straight_beyond_its_ends():
    road = Road.through(CORNERS)
    found = road.places(np.array([-5.0, 0.0, 4.0, 10.0, 15.0, 20.0, 27.0]))
    assert found == pytest.approx(
        np.array([(-5, 0), (0, 0), (4, 0), (10, 0), (10, 5), (10, 10), (10, 17)])
    )
    assert np.rad2deg(road.headings(np.array([-5.0, 5.0, 15.0, 99.0]))) == pytest.approx(
        [0, 0, 90, 90]
    )


@pytest.mark.parametrize(
    ("place", "along_m"),
    [((-3, 1), -3), ((4, -2), 4), ((11, 5), 15), ((12, 30), 40), ((13, -3), 10)],
)
def test_the_nearest_point_of_a_road_is_found_beyond_its_ends_as_well(place, along_m):
    assert Road.through(CORNERS).nearest_m(np.array(place)) == pytest.approx(along_m)


def test_a_lane_is_parallel_to_its_road():
    lane = Road.through(CORNERS).beside(2.0)
    assert lane.corners == pytest.approx(np.array([(0, 2), (8, 2), (8, 10)]))
    assert Road.through(CORNERS).beside(-2.0).corners[1] == pytest.approx((12, -2))


@pytest.mark.parametrize("radius_m", [50.0, -50.0])
def test_a_bend_turns_to_the_side_of_its_radius_about_the_place_given(radius_m):
    place, heading = np.array([3.0, 4.0]), 0.5
    road = Road.bend(place, heading, radius_m)
    middle_m = road.nearest_m(place)
    assert road.places(np.array(middle_m)) == pytest.approx(place, abs=1e-3)
    assert road.headings(np.array(middle_m)) == pytest.approx(heading, abs=0.01)
    turned = np.diff(road.headings(np.array([middle_m - 20.0, middle_m + 20.0])))
    assert turned == pytest.approx(40 / radius_m, abs=0.011)


@pytest.mark.parametrize("speeds", [(20.0, 20.0), (20.0, 5.0), (4.0, 25.0)])
@pytest.mark.parametrize("forward", [True, False])
def test_places_speeds_and_headings_agree(speeds, forward):
    bend = Road.bend(np.zeros(2), 0.3, 80.0)
    way = Drive(bend, 10.0, bend.nearest_m(np.zeros(2)), (5.0, 15.0), speeds, forward)
    velocity = np.gradient(way.places(TIME_S), TIME_S, axis=0)[1:-1]
    # The chords of the bend are 0.8 m: heading steps by 0.01 rad from one to the next; a speed
    # that begins to grow by 2.1 m/s2 is between two times off by half of 10 ms of it.
    assert np.hypot(*velocity.T) == pytest.approx(way.speeds(TIME_S)[1:-1], abs=0.011)
    turned = np.arctan2(*velocity.T[::-1]) - way.headings(TIME_S)[1:-1]
    assert np.abs(np.angle(np.exp(1j * turned))).max() < 0.011
    assert way.places(np.array(10.0)) == pytest.approx(np.zeros(2), abs=1e-3)


def test_speed_changes_evenly_between_its_times():
    way = drive(speed_mps=20.0, end_speed_mps=10.0)
    assert way.speeds(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx([20, 20, 15, 10, 10])


@pytest.mark.parametrize("velocity_mps", [80.0, 250.0])
def test_what_is_heard_was_made_a_delay_before(velocity_mps):
    way = drive(Road.bend(np.zeros(2), 0.0, 40.0), speed_mps=30.0)
    places = np.array([(5.0, 5.0), (200.0, -30.0)])
    emitted = way.emitted_s(TIME_S, places, velocity_mps)
    heard = emitted + way.distances(emitted, places) / velocity_mps
    assert np.abs(heard - TIME_S[:, None]).max() < 1e-7


def test_the_closest_approach_of_a_straight_way_is_where_it_is_abeam():
    way = drive(speed_mps=20.0)
    assert way.closest_s(np.array([30.0, 7.0]), 20.0) == pytest.approx(11.5, abs=1e-6)


@pytest.mark.parametrize("place", [(-250.0, 3.0), (250.0, 3.0)])
def test_who_does_not_come_by_before_the_end_does_not_pass(place):
    assert drive(speed_mps=20.0).closest_s(np.array(place), 20.0) is None
