"""Places by arrivals and heights: of a law known, of few sensors, with false and clipped ones."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from groundtrace.localizers.amplitudes import (
    BY_HEIGHT,
    BY_TIME,
    JointPlaces,
    TimesAmplitudesParameters,
    peaks,
)
from groundtrace.localizers.array_method import Window

ROOM = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)])
FOUR = np.array([(0.2, 0.3), (5.8, 0.4), (5.5, 4.7), (0.3, 4.6)])
PACE, DECAY = 1.5e-3, 1.0


def impacts(count: int, seed: int = 1, gains: float = 0.0) -> tuple[np.ndarray, ...]:
    """Places, arrivals [s] and logarithms of heights of impacts at four sensors."""
    rng = np.random.default_rng(seed)
    places = rng.uniform((0.5, 0.5), (5.5, 4.5), (count, 2))
    distance = np.hypot(*(places[:, None] - FOUR).transpose(2, 0, 1))
    times = PACE * distance * rng.normal(1, 0.05, distance.shape)
    heights = rng.normal(0, 1, (count, 1)) - DECAY * np.log(distance)
    heights += rng.normal(0, 0.1, distance.shape) + rng.normal(0, gains, 4)
    return places, times, heights


def located(times: np.ndarray, heights: np.ndarray, clipped: np.ndarray | None = None):
    joint = JointPlaces(FOUR, ROOM, TimesAmplitudesParameters())
    clipped = np.zeros(times.shape, bool) if clipped is None else clipped
    return joint, [joint.locate(*row) for row in zip(times, heights, clipped, strict=True)]


def errors(found: list, places: np.ndarray) -> np.ndarray:
    return np.hypot(*(np.array([(x.x, x.y) for x in found]) - places).T)


def squares(found: list, places: np.ndarray) -> np.ndarray:
    off = np.array([(x.x, x.y) for x in found]) - places
    inverse = np.linalg.inv(np.array([x.covariance for x in found]))
    return np.einsum("ni,nij,nj->n", off, inverse, off)


def test_four_sensors_place_impacts_on_a_floor_that_nobody_knew() -> None:
    places, times, heights = impacts(30)
    joint, found = located(times, heights)
    assert np.median(errors(found, places)[10:]) < 0.35
    assert np.median(np.hypot(*(places - (3.0, 2.5)).T)) > 1.2  # the middle of the room
    row, cell = np.unravel_index(joint.weights.log.argmax(), joint.weights.log.shape)
    assert BY_TIME[row, 0] == pytest.approx(PACE, rel=0.2)
    assert BY_HEIGHT[cell, 0] == pytest.approx(DECAY, abs=0.5)


def test_claimed_regions_hold_the_truth() -> None:
    held = []
    for seed in range(6):
        places, times, heights = impacts(20, seed, gains=0.2)
        held += (squares(located(times, heights)[1], places) <= 4.605).tolist()
    assert 0.8 <= np.mean(held) <= 1.0


def test_heights_tell_what_times_leave_open() -> None:
    places, times, heights = impacts(30, 3)
    times += np.random.default_rng(9).normal(0, 1.5e-3, times.shape)  # onsets in noise
    both = errors(located(times, heights)[1], places)
    alone = errors(located(times, np.full_like(heights, np.nan))[1], places)
    assert np.median(both[10:]) < np.median(alone[10:])


def test_a_false_arrival_moves_a_place_little_and_a_clipped_height_is_a_bound() -> None:
    places, times, heights = impacts(30, 4)
    times[20, 1] += 0.03
    near = heights.argmax(axis=1)
    clipped = np.zeros(heights.shape, bool)
    clipped[np.arange(25, 30), near[25:]] = True
    heights[clipped] -= 1.5
    found = located(times, heights, clipped)[1]
    assert errors(found, places)[20] < 1.0
    assert np.median(errors(found, places)[25:]) < 0.5


def test_gains_of_sensors_are_learnt() -> None:
    _, times, heights = impacts(40, 5)
    heights[:, 2] += 0.5
    joint, _ = located(times, heights)
    assert joint.gains[2] - joint.gains[[0, 1, 3]].mean() == pytest.approx(0.5, abs=0.2)


def test_two_arrivals_are_no_place_and_a_copy_goes_on_alike() -> None:
    _, times, heights = impacts(6, 6)
    joint, _ = located(times, heights)
    few = times[0].copy()
    few[:2] = np.nan
    assert not joint.locate(few, heights[0], np.zeros(4, bool)).located
    other = copy.deepcopy(joint)
    row = times[1], heights[1], np.zeros(4, bool)
    assert joint.locate(*row).x == other.locate(*row).x


def test_a_peak_is_that_of_the_first_milliseconds_and_flat_tops_clip() -> None:
    rate_hz, rng = 20_000.0, np.random.default_rng(0)
    time_s = np.arange(1400) / rate_hz
    wave = np.where(time_s >= 0.02, np.sin(2 * np.pi * 200 * (time_s - 0.02)), 0.0)
    wave[time_s >= 0.03] *= 5  # an echo
    values = np.round(1000 * np.stack([wave, wave, 0 * wave], axis=1))
    values += np.round(rng.normal(0, 2, values.shape))
    values[:, 1] = np.clip(values[:, 1], -500, 500)
    arrivals = np.array([0.02, 0.02, np.nan])
    window = Window(20_000_000, 0, rate_hz, values, arrivals)
    heights, clipped = peaks(window, arrivals, 0.004)
    assert heights[:2] == pytest.approx(np.log([1000, 500]), abs=0.02)
    assert np.isnan(heights[2])
    assert clipped.tolist() == [False, True, False]
