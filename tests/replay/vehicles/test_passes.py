"""What stands out at stations, and chains of it along a road."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import find_peaks

from groundtrace.vehicles.passes import Chain, Peak, chains, prominences, station_peaks, tops
from groundtrace.vehicles.traffic import PlaceCheck

ALONG = np.array([0.0, 20.0, 40.0])
TIMES = np.arange(0, 60, 0.2) + 0.1
SPEEDS = (1.5, 45.0)


def peak(time_s: float, db: float = 20.0, sigma_s: float = 0.15) -> Peak:
    return Peak(time_s, sigma_s, 0.3, db, 1.0)


def linked(*times_s: list[float], along: np.ndarray = ALONG, least_db: float = 4.0) -> list[Chain]:
    return list(chains(along, [[peak(t) for t in those] for those in times_s], SPEEDS, least_db))


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30))
def test_tops_are_the_peaks_of_scipy(heights: list[int]) -> None:
    level = np.array(heights, float)
    assert tops(level).tolist() == find_peaks(level)[0].tolist()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 6), min_size=3, max_size=40), st.integers(1, 40))
def test_prominences_are_those_of_the_definition(heights: list[int], reach: int) -> None:
    level = np.array(heights, float)
    found = prominences(level, np.arange(len(level)), reach)
    for i, height in enumerate(heights):
        lowest = []
        for side in (heights[max(0, i - reach) : i][::-1], heights[i + 1 : i + 1 + reach]):
            after, low = len(lowest) == 1, height
            for other in side:
                if other > height or (after and other == height and low < height):
                    break
                low = min(low, other)
            lowest.append(low)
        assert found[i] == height - max(lowest)


def test_a_vehicle_is_a_peak_with_its_moment_and_noise_has_none() -> None:
    rng = np.random.default_rng(1)
    off = []
    for moment in np.linspace(20, 40, 20):
        mean = 1 + 100 * (1 + ((TIMES - moment) / 0.5) ** 2) ** -0.75
        powers = mean * rng.gamma(20, 1 / 20, len(TIMES))
        (one,) = station_peaks(TIMES, powers, powers, 15.0, 8.0)
        off.append((one.time_s - moment) / one.sigma_s)
    assert np.abs(off).max() < 2.5
    noise = rng.gamma(20, 1 / 20, len(TIMES))
    assert station_peaks(TIMES, noise, noise, 15.0, 8.0) == ()
    assert station_peaks(TIMES, np.full(len(TIMES), np.nan), noise, 15.0, 8.0) == ()


def test_a_vehicle_of_either_direction_is_a_chain_with_its_speed() -> None:
    ahead, back = linked([10.0, 34.1], [12.0, 32.0], [14.1, 30.0])
    assert (ahead.direction, back.direction) == (1, -1)
    assert 1 / ahead.slowness == pytest.approx(10, rel=0.05)
    assert -1 / back.slowness == pytest.approx(10, rel=0.05)
    assert ahead.prominence_db == 20
    assert [station for station, _ in back.members] == [2, 1, 0]


def test_what_shakes_all_at_once_or_goes_at_walking_pace_is_no_vehicle() -> None:
    for chain in linked([10.0], [10.0], [10.0]):
        assert chain.legs_mps[1] > 30
    assert linked([10.0], [25.0], [40.0]) == []


def test_moments_that_places_contradict_are_a_chain_and_its_legs_say_so() -> None:
    (chain,) = linked([10.0], [11.9], [16.8])
    assert chain.legs_mps[0] == pytest.approx(20 / 4.4, abs=0.3)
    assert 1.5 < chain.ratio < 3
    assert chain.slowness_sigma > 0.1 * chain.slowness


def test_a_station_of_four_may_miss_a_pass_and_one_of_three_may_not() -> None:
    along = np.array([0.0, 20.0, 40.0, 60.0])
    (chain,) = linked([10.0], [], [14.0], [16.0], along=along)
    assert [station for station, _ in chain.members] == [0, 2, 3]
    assert chain.prominence_db == 15
    assert linked([10.0], [], [14.0]) == []


def test_a_peak_belongs_to_one_chain_and_the_usual_one_goes_first() -> None:
    found = linked([10.0], [12.0], [14.0, 22.0])
    assert [chain.moments().tolist() for chain in found] == [[10.0, 12.0, 14.0]]


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(st.floats(0, 60), max_size=5), min_size=2, max_size=6))
def test_chains_of_any_peaks_have_speeds_and_share_none(times: list[list[float]]) -> None:
    along = 15.0 * np.arange(len(times))
    found = linked(*times, along=along)
    members = [(station, id(one)) for chain in found for station, one in chain.members]
    assert len(set(members)) == len(members)
    for chain in found:
        assert np.isfinite([*chain.legs_mps, chain.slowness, chain.slowness_sigma]).all()
        assert chain.legs_mps[0] > 0


def test_places_that_contradict_the_speeds_are_said_once() -> None:
    check = PlaceCheck(("A", "B", "C"), ALONG)
    for start in (0.0, 30.0, 60.0, 90.0, 120.0):
        assert check.text() == ""
        (chain,) = linked([start], [start + 1.9], [start + 6.8 + 0.01 * start])
        check.update(chain)
    text = check.text()
    assert "5 vehicles take 2.9 times as long for a metre from B to C as from A to B" in text
    assert check.text() == ""
    even = PlaceCheck(("A", "B", "C"), ALONG)
    for start in (0.0, 30.0, 60.0, 90.0, 120.0):
        (chain,) = linked([start], [start + 2.0], [start + 4.2])
        even.update(chain)
    assert even.text() == ""
