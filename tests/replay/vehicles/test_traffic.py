"""Vehicles on a road by the powers of all stations at once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from vehicle_powers import fluctuating

from groundtrace.vehicles.medium import Scatter, cube_root_normalised, scatter_of
from groundtrace.vehicles.passes import station_peaks
from groundtrace.vehicles.traffic import (
    MOMENT,
    PassParameters,
    RoadPowers,
    RoadVehicle,
    Stretch,
    Vehicle,
    driven,
    vehicles_on,
)

TIMES = np.arange(0, 40, 0.25)
ALONG, OFFSETS = np.array([0.0, 10.0]), np.array([5.0, 5.0])
FLOOR, FREEDOM = 0.02, 14
#: When at 5 m along the road [s], velocity [m/s].
MEETING = ((19.6, 11.0), (20.5, -12.0))


def mean_of(vehicles: tuple[tuple[float, float], ...], away_m: np.ndarray = OFFSETS) -> np.ndarray:
    mean = np.full((len(TIMES), 2), FLOOR)
    for moment, velocity in vehicles:
        late = TIMES[:, None] - moment - (ALONG - 5) / velocity
        mean += 50 * ((velocity * late) ** 2 + away_m**2) ** -0.75
    return mean


def road_powers(
    vehicles: tuple[tuple[float, float], ...], seed: int, away_m: np.ndarray = OFFSETS
) -> RoadPowers:
    mean = mean_of(vehicles, away_m)
    powers = fluctuating(mean, np.random.default_rng(seed), FREEDOM)
    return RoadPowers(TIMES, powers, np.full(mean.shape, FLOOR), ALONG, OFFSETS, 1.5, 0.25)


def found(observed: RoadPowers) -> tuple[RoadVehicle, ...]:
    peaks = [station_peaks(TIMES, power, power, 15.0, 4.0) for power in observed.powers.T]
    vehicles = driven(observed, peaks, (1.5, 45.0))
    return tuple(v for v in vehicles if v.prominence_db > 10)


def test_two_within_a_second_at_stations_ten_metres_apart_are_two() -> None:
    vehicles = found(road_powers(MEETING, 1))
    assert sorted(v.direction for v in vehicles) == [-1, 1]
    for v in vehicles:
        moment, velocity = MEETING[0] if v.direction > 0 else MEETING[1]
        for station, one in v.passes:
            true = moment + (ALONG[station] - 5) / velocity
            assert one.time_s == pytest.approx(true, abs=4 * one.time_sigma_s)
        error = np.log(v.speed_mps / abs(velocity)) * v.speed_mps / v.speed_sigma_mps
        assert abs(error) < 4


@cache
def one_vehicle(seed: int) -> tuple[RoadVehicle, float]:
    """Return what is found of one vehicle at 9 m/s, and the error of its speed in sigmas."""
    (v,) = found(road_powers(((20.0, 9.0),), seed))
    return v, float(np.log(v.speed_mps / 9) * v.speed_mps / v.speed_sigma_mps)


def test_one_stays_one() -> None:
    v, off = one_vehicle(1)
    assert v.direction == 1
    assert abs(off) < 4


@pytest.mark.sweep
def test_one_stays_one_with_errors_that_are_true() -> None:
    vehicles, off = zip(*map(one_vehicle, range(5)), strict=True)
    assert {v.direction for v in vehicles} == {1}
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 1.7


def test_a_vehicle_on_a_road_further_off_is_heard_for_too_long() -> None:
    gate = PassParameters().breadth
    here, _ = one_vehicle(1)
    (there,) = found(road_powers(((20.0, 9.0),), 1, 3 * OFFSETS))
    assert here.breadth < gate < there.breadth
    assert here.breadth == pytest.approx(5 / (np.hypot(5, 3) + 0.35 * 9), rel=0.3)


def test_without_a_road_nothing_is_heard_for_too_long() -> None:
    (one,) = found(replace(road_powers(((20.0, 9.0),), 1), offsets_m=np.zeros(2)))
    assert one.breadth == 0


def test_a_vehicle_that_passes_long_after_the_last_cycle_is_none() -> None:
    observed = road_powers(MEETING[:1], 3)
    inside = Vehicle(observed.typical.copy(), 1)
    inside.values[MOMENT] = 19.0
    outside = Vehicle(observed.typical.copy(), 1)
    outside.values[MOMENT] = TIMES[-1] + 60.0
    assert vehicles_on(observed, [outside]) == ()
    assert len(vehicles_on(observed, [inside, outside])) == 1


def test_slopes_are_those_of_the_power() -> None:
    observed = road_powers((), 1)
    values = observed.typical + np.array([20.0, 0.1, 0.2, 0.05, 0.1, -0.2])
    vehicle, rows = Vehicle(values, -1), slice(60, 100)
    _, slopes = observed.power(vehicle, rows)
    for column in range(len(values)):
        step = np.zeros(len(values))
        step[column] = 1e-5
        more, less = (observed.power(Vehicle(values + s, -1), rows)[0] for s in (step, -step))
        assert slopes[..., column] == pytest.approx((more - less) / 2e-5, rel=1e-4, abs=1e-6)


def test_scatter_is_found_shared_or_not() -> None:
    rng = np.random.default_rng(1)
    mean = np.ones((2000, 2))
    own = fluctuating(mean, rng, FREEDOM)
    for powers, shared in ((own, 0.0), (own[:, :1] * mean, 0.95)):
        observed = RoadPowers(np.arange(2000.0), powers, 0.01 * mean, ALONG, OFFSETS, 1.5, 1.0)
        scatter = scatter_of(observed.powers, observed.noise, observed.valid, mean)
        assert scatter.variance == pytest.approx(2 / FREEDOM, rel=0.15)
        assert scatter.shared == pytest.approx(shared, abs=0.1)
        assert scatter.lasting < 0.1


def test_a_cube_root_of_fading_is_nearly_normal() -> None:
    drawn = cube_root_normalised(np.random.default_rng(1).exponential(size=100_000))
    assert drawn.mean() == pytest.approx(-1 / 3, abs=0.02)
    assert drawn.std() == pytest.approx(1, abs=0.04)


def test_no_vehicle_explains_powers_of_nobody() -> None:
    observed = road_powers((), 3)
    assert driven(observed, [(), ()], (1.5, 45.0)) == ()
    stretch = Stretch(observed, slice(0, 80), np.full((80, 2), FLOOR), Scatter())
    nobody = stretch.fit((), 5)
    more = stretch.fit((Vehicle(observed.typical + np.array([10.0, 0, 0, 0, 0, 0]), 1),), 25)
    assert nobody.evidence > more.evidence
