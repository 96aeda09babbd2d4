from __future__ import annotations

import numpy as np
import pytest
import shapely

from groundtrace.errors import PipelineError
from groundtrace.localizers.arrival_order import Regions, find_regions, pairs
from groundtrace.localizers.base import outline_of


def corners(width: float, height: float) -> np.ndarray:
    """Sensors in the corners and the centre."""
    w, h = width, height
    return np.array([(0, 0), (w, 0), (0, h), (w, h), (w / 2, h / 2)], np.float64)


def nine(width: float, height: float) -> np.ndarray:
    return np.array([(x, y) for y in (0, height / 2, height) for x in (0, width / 2, width)])


def regions_of(sensors: np.ndarray, width: float, height: float) -> Regions:
    return find_regions(sensors, shapely.box(0, 0, width, height))


def test_pairs_stand_in_the_order_of_the_thesis() -> None:
    first, second = pairs(9)
    for place, (i, j) in enumerate(zip(first + 1, second + 1, strict=True)):
        assert i < j
        assert place + 1 == (j - 2) * (j - 1) // 2 + i


@pytest.mark.parametrize(
    ("width", "height", "count"),
    [
        (10, 10, 16),
        (10, 6, 20),
        (8, 6, 20),
        (3.6, 5.4, 20),
        (17, 10, 20),
        (18, 10, 16),
        (20, 6, 16),
    ],
)
def test_corners_and_centre_make_the_known_number_of_regions(
    width: float, height: float, count: int
) -> None:
    found = regions_of(corners(width, height), width, height)
    assert len(found) == count
    assert found.areas.sum() == pytest.approx(width * height)


@pytest.mark.parametrize(("width", "height", "count"), [(10, 10, 88), (7, 7, 88), (3.6, 5.4, 152)])
def test_nine_sensors_on_a_grid_make_the_known_number_of_regions(
    width: float, height: float, count: int
) -> None:
    found = regions_of(nine(width, height), width, height)
    assert len(found) == count
    assert len(np.unique(found.signs, axis=0)) == count
    assert found.areas.sum() == pytest.approx(width * height)


def test_areas_of_nine_sensors_on_ten_metres_are_the_known_ones() -> None:
    areas = regions_of(nine(10, 10), 10, 10).areas
    found = (areas.min(), float(np.median(areas)), areas.max())
    assert found == pytest.approx((5 / 24, 25 / 24, 125 / 48))


@pytest.mark.parametrize(("count", "most"), [(3, 6), (4, 18), (5, 46), (6, 101), (9, 583)])
def test_sensors_anywhere_reach_the_corrected_maximum(count: int, most: int) -> None:
    sensors = np.random.default_rng(2).uniform(0, 1, (count, 2))
    assert len(find_regions(sensors, shapely.box(-3e3, -3e3, 3e3, 3e3))) == most


def test_signs_are_those_of_points_in_the_region() -> None:
    found = regions_of(nine(3.6, 5.4), 3.6, 5.4)
    apart = np.linalg.norm(found.centres[:, None] - found.sensors, axis=2)
    signs = np.sign(apart[:, found.first] - apart[:, found.second])
    np.testing.assert_array_equal(signs, found.signs)


def test_regions_are_those_that_samples_of_the_room_group_into() -> None:
    found = regions_of(nine(10, 10), 10, 10)
    axis = np.arange(0, 10, 0.05)
    # off all the lines
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + np.sqrt([2e-4, 3e-4])
    apart = np.linalg.norm(points[:, None] - found.sensors, axis=2)
    signs = np.sign(apart[:, found.first] - apart[:, found.second]).astype(np.int8)
    grouped, index, counts = np.unique(signs, axis=0, return_inverse=True, return_counts=True)
    order = np.lexsort(found.signs.T[::-1])
    np.testing.assert_array_equal(grouped, found.signs[order])
    sums = np.stack([np.bincount(index.ravel(), p) for p in points.T], axis=1)
    np.testing.assert_allclose(sums / counts[:, None], found.centres[order], atol=0.05)


def test_neighbours_share_an_edge_and_differ_by_the_pairs_of_one_line() -> None:
    found = regions_of(nine(10, 10), 10, 10)
    differ = (found.signs[found.neighbours[:, 0]] != found.signs[found.neighbours[:, 1]]).sum(1)
    assert set(differ.tolist()) == {1, 3}  # the lines through the middle are of three pairs
    # Euler: edges between regions, of a square with 88 parts
    assert len(found.neighbours) == 120


def test_a_room_that_is_not_convex_cuts_regions_and_neighbours() -> None:
    room = shapely.Polygon([(0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10)])
    found = find_regions(corners(10, 10), room)
    assert found.areas.sum() == pytest.approx(64)
    whole = regions_of(corners(10, 10), 10, 10)
    assert len(found) < len(whole)
    assert len(found.neighbours) < len(whole.neighbours)


def test_sensors_on_a_line_make_strips() -> None:
    found = regions_of(np.array([(0.0, 1.0), (1, 1), (2, 1), (3, 1)]), 5, 5)
    assert len(found) == 6  # five distinct lines halfway between
    assert len(found.neighbours) == 5
    np.testing.assert_allclose(found.centres[:, 1], 2.5)


def test_sensors_at_one_place_have_no_line_and_no_sign() -> None:
    found = regions_of(np.array([(1.0, 1.0), (1, 1), (4, 2)]), 5, 5)
    assert len(found) == 2
    np.testing.assert_array_equal(found.signs[:, 0], 0)
    np.testing.assert_array_equal(found.signs[:, 1], found.signs[:, 2])


@pytest.mark.parametrize("sensors", [[(1.0, 1.0)], [(1.0, 1.0), (1.0, 1.0)]])
def test_without_a_line_the_room_is_one_region(sensors: list[tuple[float, float]]) -> None:
    found = regions_of(np.array(sensors), 4, 4)
    assert (len(found), found.areas.tolist(), found.centres.tolist()) == (1, [16.0], [[2.0, 2.0]])
    assert found.neighbours.shape == (0, 2)


def test_sixteen_sensors_make_thousands_of_regions_that_fill_the_room() -> None:
    sensors = np.random.default_rng(0).uniform(0, 10, (16, 2))
    found = regions_of(sensors, 10, 10)
    assert len(found) > 3000
    assert found.areas.sum() == pytest.approx(100)


def test_without_an_outline_the_sensors_rectangle_is_searched_and_a_bad_one_is_refused() -> None:
    assert outline_of(nine(10, 5)).bounds == pytest.approx((-1, -1, 11, 6))
    crossed = np.array([(0, 0), (1, 1), (1, 0), (0, 2)], np.float64)
    for bad in (crossed, np.array([(0.0, 0.0), (1, 1)])):
        with pytest.raises(PipelineError, match="outline: expected corners around an area"):
            outline_of(nine(1, 1), bad)
