"""Iron on a sensor: told from the field of the place by turns within some seconds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundtrace.inertial.carried_iron import CarriedIron, FieldWindows, IronFit, iron_window

Array = np.ndarray[Any, np.dtype[np.float64]]
RATE_HZ = 50.0
IRON = np.array([2e-5, -1e-5, 1.5e-5])


def attitudes(headings: Array, tilt: float = 0.2) -> Rotation:
    """A sensor that turns about the vertical, and rocks by ``tilt`` [rad] meanwhile."""
    rocking = tilt * np.sin(np.arange(len(headings)) / RATE_HZ * 2 * np.pi / 1.7)
    about = np.stack([rocking, 0.7 * rocking, 0 * rocking], axis=1)
    return Rotation.from_rotvec(about) * Rotation.from_euler("z", headings[:, None])


def corners(count: int, apart_s: float = 8.0) -> Array:
    t = np.arange(round((count + 1) * apart_s * RATE_HZ)) / RATE_HZ
    return sum((np.clip(t - k * apart_s, 0, 1) * math.pi / 2 for k in range(1, count + 1)), 0 * t)


def place(length: int, seed: int, size: float = 4e-6) -> Array:
    """The field of the place: that of the earth, and what a building adds over some seconds."""
    rng = np.random.default_rng(seed)
    kernel = np.hanning(round(2 * RATE_HZ))
    noise = rng.standard_normal((length + len(kernel), 3))
    smooth = np.stack([np.convolve(n, kernel, "valid")[:length] for n in noise.T], axis=1)
    return np.array([0.0, 2e-5, -4e-5]) + size * smooth / smooth.std()


def fit_of(turns: Rotation, level: Array, size: int = 10**6) -> tuple[CarriedIron, IronFit | None]:
    """Feed fields in level axes in blocks; return what is gathered, and the fit."""
    quaternions = turns.as_quat()[:, [3, 0, 1, 2]]
    windows, carried = FieldWindows(RATE_HZ), CarriedIron()
    times = np.rint(np.arange(len(level)) / RATE_HZ * 1e9).astype(np.int64)
    for first in range(0, len(level), size):
        rows = slice(first, first + size)
        windows.add(times[rows], quaternions[rows], level[rows])
        for window in windows.until(int(times[rows][-1])):
            carried.add(window)
    return carried, carried.fit()


@pytest.mark.parametrize("seed", range(5))
def test_iron_is_found_beside_what_a_building_does(seed: int) -> None:
    turns = attitudes(corners(6))
    level = place(len(turns), seed) + turns.apply(IRON)
    _, fit = fit_of(turns, level)
    assert fit is not None
    assert fit.believed
    np.testing.assert_allclose(fit.field, IRON, atol=5e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_building_alone_is_not_taken_for_iron(seed: int) -> None:
    turns = attitudes(corners(6))
    _, fit = fit_of(turns, place(len(turns), seed))
    assert fit is not None
    assert not fit.believed


def test_a_field_that_is_another_one_round_one_corner_is_not_taken_for_iron() -> None:
    headings = corners(1, apart_s=20.0)
    turns = attitudes(headings, tilt=0.0)
    north = np.array([2e-5, 0.0, -4e-5])
    level = Rotation.from_euler("z", 0.5 * headings[:, None]).apply(north) + 1e-8 * place(
        len(turns), 0
    )
    carried, fit = fit_of(turns, level)
    assert carried.turning < 4
    assert fit is not None
    assert not fit.believed


def test_a_level_sensor_tells_nothing_of_the_vertical_part() -> None:
    turns = attitudes(corners(6), tilt=0.0)
    _, fit = fit_of(turns, place(len(turns), 0, 1e-6) + turns.apply(IRON))
    assert fit is not None
    np.testing.assert_allclose(fit.field[:2], IRON[:2], atol=2e-6)
    assert abs(fit.field[2]) < 1e-6


@pytest.mark.parametrize("size", [1, 7, 400])
def test_the_fit_is_the_same_whatever_the_blocks(size: int) -> None:
    turns = attitudes(corners(4))
    level = place(len(turns), 1) + turns.apply(IRON)
    level[700:720] = np.nan  # a window without a field everywhere tells nothing
    whole, cut = fit_of(turns, level), fit_of(turns, level, size)
    assert whole[0].windows == cut[0].windows > 16
    assert whole[1] is not None
    assert cut[1] is not None
    np.testing.assert_array_equal(whole[1].field, cut[1].field)


def test_windows_before_and_after_a_gap_count_together() -> None:
    """The level axes are others then, the sensor carries what it carried."""
    carried = CarriedIron()
    for first, seed in ((0.0, 0), (1.0, 1)):
        turns = attitudes(first + corners(3))
        level = place(len(turns), seed, 1e-6) + turns.apply(IRON)
        windows = FieldWindows(RATE_HZ)
        quaternions = turns.as_quat()[:, [3, 0, 1, 2]]
        windows.add(np.arange(len(level)), quaternions, level)
        for window in windows.until(2**62):
            carried.add(window)
        assert not windows.until(2**62)
    fit = carried.fit()
    assert fit is not None
    np.testing.assert_allclose(fit.field, IRON, atol=1e-6)
    assert fit.words == "20, -10, 15 uT"


def test_nothing_is_told_without_windows_or_field() -> None:
    carried = CarriedIron()
    assert carried.fit() is None
    carried.add(iron_window(np.stack([np.eye(3)] * 6), np.zeros((6, 3))))
    assert carried.fit() is None
    slow = FieldWindows(2.0)
    slow.add(np.arange(100), np.tile([1.0, 0, 0, 0], (100, 1)), np.ones((100, 3)))
    assert not slow.until(2**62)
