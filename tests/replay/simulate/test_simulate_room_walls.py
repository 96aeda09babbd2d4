"""Walls of the simulated room: images where they must be, and waves that arrive as theirs."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_rooms import L_OUTLINE, L_ROOM, of_kind, one_step, start_of, values_of

from groundtrace.localizers.wave_physics import Plate
from groundtrace.simulate.footfall import ArrivalLaw
from groundtrace.simulate.room import Walls

SQUARE = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0)])
TURNED = SQUARE @ np.array([[0.6, 0.8], [-0.8, 0.6]])


def seen(walls: Walls, source, place) -> dict[tuple[float, float], float]:
    """Return gain by place of everything that is seen from one place."""
    images = walls.images(np.array(source, float), np.array([place], float))
    pairs = zip(np.round(images.places, 9).tolist(), images.gains[:, 0].tolist(), strict=True)
    return {tuple(at): gain for at, gain in pairs if gain}


def test_without_reflection_there_is_only_the_force():
    assert seen(Walls(SQUARE, 0.0), (1, 1), (5, 3)) == {(1, 1): 1.0}


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1]], ids=["one way", "other way"])
def test_a_rectangle_has_four_first_and_eight_second_images(corners):
    found = seen(Walls(corners, 0.5), (1.0, 1.0), (5.0, 3.0))
    direct = found.pop((1, 1))
    first = {(-1, 1): 0.5, (11, 1): 0.5, (1, -1): 0.5, (1, 7): 0.5}
    corner = {(-1, -1), (-1, 7), (11, -1), (11, 7)}
    opposite = {(-11, 1), (13, 1), (1, -7), (1, 9)}
    assert found == first | dict.fromkeys(corner | opposite, 0.25)
    assert direct == 1


def test_a_turned_rectangle_sees_as_much():
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    walls = Walls(TURNED, 0.5)
    assert walls.rectangular
    straight = Walls(SQUARE, 0.5).images(np.array([1.0, 1.0]), np.array([[5.0, 3.0]]))
    turned = walls.images(np.array([1.0, 1.0]) @ turn, np.array([[5.0, 3.0]]) @ turn)
    np.testing.assert_allclose(turned.places, straight.places @ turn, atol=1e-9)
    np.testing.assert_allclose(turned.gains, straight.gains)


def test_a_sensor_at_a_wall_and_in_a_corner_sees_every_image():
    assert len(seen(Walls(SQUARE, 0.5), (1, 1), (0, 2))) == 13
    assert len(seen(Walls(SQUARE, 0.5), (1, 1), (6, 4))) == 13


def test_an_image_is_seen_only_where_its_ray_meets_its_wall():
    # a trapezium: from (3, 0.5) the right slope mirrors towards the left, not towards the floor
    walls = Walls(np.array([(0.0, 0.0), (6.0, 0.0), (4.0, 2.0), (2.0, 2.0)]), 0.5)
    assert not walls.rectangular
    images = walls.images(np.array([3.0, 0.5]), np.array([[3.0, 1.5], [5.5, 0.2]]))
    # nothing from the slopes' images to a place right under the top, all of it from top and bottom
    np.testing.assert_array_equal(images.gains[:, 0] > 0, [True, True, False, True, False])
    assert images.gains[2, 1] == 0.5


def test_the_inner_corner_of_an_l_hides_images_and_weakens_what_comes_through():
    walls = Walls(np.array(L_OUTLINE), 0.6)
    images = walls.images(np.array([6.0, 2.0]), np.array([[1.0, 6.0], [1.0, 1.0], [3.5, 3.0]]))
    np.testing.assert_allclose(images.gains[0], [0.8**2, 1.0, 1.0])
    # from the upper wall of the right arm nothing reaches the upper arm
    assert images.gains[3, 0] == 0
    assert images.gains[1, 1] == 0.6
    # the left wall's image is hidden from the upper arm by the inner corner
    assert images.gains[6, 0] == 0
    assert images.gains[6, 1] == 0.6


def test_reflections_are_the_direct_wave_from_the_image_and_come_later():
    side = (6.0, 4.0)
    echoing, free = (
        one_step(side_m=side, channels=4, walls=walls, rate_hz=20_000.0) for walls in (0.5, 0.0)
    )
    step = of_kind(free, "step")[0]
    law = ArrivalLaw.of(Plate())
    struck = (step.time_ns - start_of(free)) / 1e9
    echo = values_of(echoing) - values_of(free)
    for column, sensor in enumerate(free.geometry.sensors):
        # nearest of the images that do not coincide with the foot's own wave
        images = Walls(np.array(free.geometry.outline), 0.5).images(
            np.array([step.x_m, step.y_m]), np.array([[sensor.x, sensor.y]])
        )
        away = np.sort(np.hypot(*(images.places[1:] - (sensor.x, sensor.y)).T))[0]
        wave = np.abs(echo[:, column])
        arrived = np.argmax(wave > 0.05 * wave[: int((struck + 0.05) * 20_000)].max()) / 20_000
        assert arrived - struck == pytest.approx(float(law(np.array(away))), abs=8e-4)


def test_a_sensor_in_a_corner_feels_the_wave_of_two_walls_at_once():
    # Its images are as far from it as the foot is.
    echoing, free = (one_step(channels=4, walls=walls, path="straight") for walls in (0.9, 0.0))
    a, b = values_of(echoing)[:, 0], values_of(free)[:, 0]
    onset = np.argmax(np.abs(b) > 0.05 * np.abs(b).max())
    first = slice(onset, onset + 16)  # before the walls behind it answer
    corner = 1.9**2  # of two walls with 0.9
    np.testing.assert_allclose(a[first], corner * b[first], atol=0.06 * np.abs(b).max())


def test_truth_does_not_depend_on_the_walls():
    free, echoing = (one_step(geometry=L_ROOM, walls=walls) for walls in (0.0, 0.7))
    assert free.labels == echoing.labels
    assert free.geometry == echoing.geometry


def test_nothing_arrives_before_the_direct_wave():
    simulation = one_step(geometry=L_ROOM, walls=0.9, path="l")
    values = np.abs(values_of(simulation))
    for pick in of_kind(simulation, "pick"):
        column = [c.name for c in simulation.sources[0][0].channels].index(pick.channel)
        before = round((pick.time_ns - start_of(simulation)) * 2e-5) - 20
        assert values[:before, column].max() < 0.05 * values[:, column].max()
