"""Who strikes the simulated floor: paths inside any outline, two walkers, impacts, random rooms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from simulated_rooms import L_OUTLINE, L_ROOM, of_kind, samples_of
from sweeps import swept

from groundtrace.errors import SimulationError
from groundtrace.simulate.room import simulate_room
from groundtrace.simulate.room_plan import RoomOptions, clear_rectangle, drawn, paths_in
from groundtrace_codecs.geometry import Geometry, Sensor

SHAPES = ["straight", "l", "v", "u", "circle", "ellipse", "there-and-back"]
RECTANGLE = ((0.0, 0.0), (4.0, 0.0), (4.0, 7.0), (0.0, 7.0))
SLANTED = ((0.0, 0.0), (7.0, 1.0), (6.0, 8.0), (-1.0, 6.0))
RING = ((0, 0), (9, 0), (9, 9), (0, 9), (0, 6), (5, 6), (5, 3), (0, 3))
OUTLINES = {"rectangle": RECTANGLE, "slanted": SLANTED, "l": L_OUTLINE, "c": RING}


def site(outline) -> Geometry:
    sensors = tuple(Sensor(f"G{i}", f"G{i}", x, y) for i, (x, y) in enumerate(outline, 1))
    return Geometry(sensors=sensors, outline=outline)


def places(simulation, kind="step", target="") -> np.ndarray:
    return np.array([(x.x_m, x.y_m) for x in of_kind(simulation, kind) if x.target == target])


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
@pytest.mark.parametrize("shape", SHAPES)
def test_every_path_stays_inside_every_outline_in_even_paces(shape, outline):
    (path,) = paths_in(outline, shape)
    run_m = np.arange(0.0, 40.0, 0.58)
    feet = path.feet(run_m)
    room = shapely.Polygon(outline)
    assert shapely.contains_xy(room.buffer(-0.4), *feet.T).all()
    paces = np.hypot(*np.diff(feet, axis=0).T)
    assert np.median(paces) == pytest.approx(0.59, abs=0.05)
    assert paces.max() < 0.8


def test_the_widest_clear_rectangle_of_an_l_lies_in_one_arm():
    low, high = clear_rectangle(L_OUTLINE)
    assert low == pytest.approx((0.7, 0.7), abs=1e-5)
    assert high == pytest.approx((2.8, 6.3), abs=1e-5)  # the other arm has 6.6 m x 1.6 m


def test_the_default_path_begins_where_it_always_did():
    simulation = simulate_room(RoomOptions(steps=3))
    assert simulation.geometry.start == (0.7, 0.8)
    assert simulate_room(RoomOptions(steps=3, path="u")).labels == simulation.labels


@pytest.mark.parametrize("shape", ["straight", "l", "v", "u"])
def test_open_paths_are_walked_to_and_fro(shape):
    (path,) = paths_in(RECTANGLE, shape)
    there = path.feet(np.array([0.0, path.length_m]))
    back = path.feet(np.array([2 * path.length_m]))
    np.testing.assert_allclose(there[0], back[0], atol=0.15)  # the feet are 14 cm apart
    assert np.hypot(*(there[1] - there[0])) > 2


def test_there_and_back_comes_back_beside():
    (path,) = paths_in(RECTANGLE, "there-and-back")
    x, y = path.points.T
    assert np.ptp(y) == pytest.approx(5.6, abs=1e-4)
    assert np.ptp(x) == pytest.approx(0.8, abs=1e-4)


def test_two_walkers_cross_in_the_middle_at_the_same_time():
    simulation = simulate_room(RoomOptions(walkers=2, steps=9))
    steps = of_kind(simulation, "step")
    assert {x.target for x in simulation.labels} == {"1", "2"}
    one, two = ([x for x in steps if x.target == who] for who in "12")
    assert len(one) == len(two) == 9
    middle_s = []
    for walker in (one, two):
        away = [np.hypot(x.x_m - 2.7, x.y_m - 2.7) for x in walker]
        middle_s.append(walker[int(np.argmin(away))].time_ns / 1e9)
        assert min(away) < 0.4
    assert abs(middle_s[0] - middle_s[1]) < 0.7
    cadences = [np.median(np.diff([x.time_ns for x in walker])) for walker in (one, two)]
    assert cadences[1] / cadences[0] > 1.08
    assert [x.label for x in two[:2]] == ["left", "right"]


def test_two_walkers_have_a_walking_span_and_picks_each():
    simulation = simulate_room(RoomOptions(path="crossing", steps=4, channels=4))
    spans = of_kind(simulation, "walking")
    assert sorted(x.target for x in spans) == ["1", "2"]
    for span in spans:
        steps = [x for x in of_kind(simulation, "step") if x.target == span.target]
        picks = [x for x in of_kind(simulation, "pick") if x.target == span.target]
        assert len(picks) == 4 * len(steps)
        assert all(span.time_ns < x.time_ns < span.end_ns for x in steps)


def test_waves_of_two_walkers_add_up():
    both = simulate_room(RoomOptions(walkers=2, steps=4, snr=1e7))
    times = [x.time_ns for x in both.labels]
    assert times == sorted(times)
    quiet = samples_of(both)[:12_000]
    assert np.abs(quiet).max() <= 1
    assert np.abs(samples_of(both)).max() < 32767


def test_impacts_are_apart_inside_and_nobody_walks():
    simulation = simulate_room(RoomOptions(impacts=True, geometry=L_ROOM, rate_hz=1000.0))
    impacts = of_kind(simulation, "impact")
    assert len(impacts) == 20
    assert {x.kind for x in simulation.labels} == {"impact", "pick"}
    assert len(of_kind(simulation, "pick")) == 20 * 4
    gaps = np.diff([x.time_ns for x in impacts]) / 1e9
    assert gaps.min() >= 1
    assert gaps.max() <= 3
    room = shapely.Polygon(L_OUTLINE)
    assert shapely.contains_xy(room, *places(simulation, "impact").T).all()
    assert np.ptp(places(simulation, "impact"), axis=0).min() > 3


@pytest.mark.parametrize("seed", swept(range(1, 13), 1, 2, 3))
def test_a_random_room_is_one_a_person_can_walk_in(seed):
    options = RoomOptions(seed=seed, random=True, rate_hz=1000.0, steps=12)
    chosen = drawn(options)
    room = shapely.Polygon(chosen.geometry.outline)
    assert room.is_valid
    assert np.ptp(chosen.geometry.outline, axis=0).min() >= 4
    assert np.ptp(chosen.geometry.outline, axis=0).max() <= 10
    assert 4 <= len(chosen.geometry.sensors) <= 16
    assert shapely.contains_xy(
        room, *np.array([(s.x, s.y) for s in chosen.geometry.sensors]).T
    ).all()
    simulation = simulate_room(options)
    assert shapely.contains_xy(room.buffer(-0.4), *places(simulation).T).all()
    assert np.abs(samples_of(simulation)).max() < 32767
    assert simulation.metadata["simulation"]["random"] == "True"


def test_random_rooms_are_of_all_kinds():
    rooms = [drawn(RoomOptions(seed=seed, random=True)) for seed in range(40)]
    assert {x.shoe for x in rooms} == {"heel", "bare", "mixed"}
    assert {x.path for x in rooms} == set(SHAPES)
    assert {len(x.geometry.outline) for x in rooms} == {4, 6}
    sides = [np.ptp(x.geometry.outline, axis=0) for x in rooms]
    assert 4 < sum(a == b for a, b in sides) < 20
    assert all(x.resonances and 0.3 <= x.walls <= 0.6 for x in rooms)
    assert all(0.12 <= x.thickness_m <= 0.3 and 5e-6 <= x.loss_s <= 5e-5 for x in rooms)


def test_giving_one_option_leaves_the_rest_of_a_random_room_as_it_was():
    options = RoomOptions(seed=5, random=True)
    room, other = drawn(options), drawn(replace(options, walls=0.0, shoe="bare"))
    assert (other.walls, other.shoe) == (0.0, "bare")
    assert (other.geometry, other.loss_s, other.path) == (room.geometry, room.loss_s, room.path)
    assert drawn(replace(options, channels=5)).geometry.outline == room.geometry.outline
    assert len(drawn(replace(options, channels=5)).geometry.sensors) == 5


@pytest.mark.parametrize(
    ("geometry", "said"),
    [
        (Geometry(), "an outline of 3 or more corners"),
        (replace(L_ROOM, unit="unknown"), "places in metres"),
        (Geometry(outline=RECTANGLE), "1 to 64 sensors"),
        (site(((0, 0), (4, 4), (4, 0), (0, 4))), "corners around an area"),
        (site(((0, 0), (9, 0), (9, 0.3), (0, 0.3))), "0.5 m or more to walk in"),
        (
            Geometry((Sensor("a", "G", 1, 1), Sensor("b", "G", 2, 2)), outline=RECTANGLE),
            "another channel for every sensor",
        ),
        (Geometry((Sensor("a", "G", 1, 1, axis="q"),), outline=RECTANGLE), "x, y or z"),
    ],
)
def test_a_geometry_nobody_can_walk_in_is_refused(geometry, said):
    with pytest.raises(SimulationError, match=f"expected {said}, found"):
        simulate_room(RoomOptions(geometry=geometry))
