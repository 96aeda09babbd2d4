"""Passes by stations, and vehicles on a road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from vehicle_powers import fluctuating

from groundtrace.vehicles.passes import PassFinder, Road, RoadPass, StationPass, associate, smoothed

ALONG, OFFSETS = (0.0, 60.0, 150.0), (5.0, 6.0, 4.0)
FLOOR, FREEDOM = 0.02, 36
TIMES = np.arange(0, 240, 0.5) + 0.25
FINDER = PassFinder(relative_sigma=(2 / FREEDOM) ** 0.5)


@dataclass(frozen=True)
class Vehicle:
    """It is in the middle of the road, at 75 m, at a time [s] and has a velocity [m/s]."""

    time_s: float
    velocity_mps: float

    def at(self, along_m: float) -> float:
        return self.time_s + (along_m - 75) / self.velocity_mps


def passes_of(vehicles: list[Vehicle], seed: int = 0) -> list[tuple[StationPass, ...]]:
    rng = np.random.default_rng(seed)
    found = []
    for along, offset in zip(ALONG, OFFSETS, strict=True):
        mean = np.full(len(TIMES), FLOOR)
        for v in vehicles:
            fine = TIMES[:, None] + np.linspace(-0.225, 0.225, 10) - v.at(along)
            mean += (50 * ((v.velocity_mps * fine) ** 2 + offset**2) ** -0.75).mean(axis=1)
        powers = fluctuating(mean, rng, FREEDOM)
        found.append(FINDER.find(TIMES, powers, np.full(len(TIMES), FLOOR)))
    return found


def vehicles_of(vehicles: list[Vehicle], seed: int = 0, offsets: bool = False) -> list[RoadPass]:
    road = Road(ALONG, OFFSETS if offsets else ())
    return list(associate(road, passes_of(vehicles, seed)))


def assert_found(found: list[RoadPass], vehicles: list[Vehicle]) -> None:
    order = sorted(vehicles, key=lambda v: v.time_s)
    assert [p.direction for p in found] == [np.sign(v.velocity_mps) for v in order]
    for one, v in zip(found, order, strict=True):
        assert one.time_at(75.0) == pytest.approx(v.time_s, abs=0.6)
        error = abs(one.speed_mps - abs(v.velocity_mps))
        assert error < 4 * max(one.speed_sigma_mps, 0.01)


def test_a_pass_has_its_moment_and_width_with_their_errors() -> None:
    off = []
    for seed in range(20):
        for station, those in enumerate(passes_of([Vehicle(100.0, 8.0)], seed)):
            assert len(those) == 1
            moment = Vehicle(100.0, 8.0).at(ALONG[station])
            width = OFFSETS[station] / 8
            off.append(
                (
                    (those[0].time_s - moment) / those[0].time_sigma_s,
                    np.log(those[0].half_width_s / width) / those[0].log_width_sigma,
                )
            )
    assert np.std(off, axis=0) == pytest.approx([1, 1], abs=0.25)


def test_noise_has_no_passes() -> None:
    assert [len(those) for those in passes_of([])] == [0, 0, 0]
    assert PassFinder().find(TIMES[:3], np.full(3, np.nan), np.ones(3)) == ()


@pytest.mark.parametrize("offsets", [True, False])
def test_vehicles_of_both_directions_have_their_speeds(offsets: bool) -> None:
    vehicles = [Vehicle(25, 12), Vehicle(60, -9), Vehicle(110, 20), Vehicle(180, 1.5)]
    assert_found(vehicles_of(vehicles, offsets=offsets), vehicles)


def test_vehicles_that_meet_are_kept_apart() -> None:
    vehicles = [Vehicle(60, -9), Vehicle(66, 14)]
    found = vehicles_of(vehicles)
    assert_found(found, vehicles)
    assert [len(p.passes) for p in found] == [3, 3]


def test_a_vehicle_that_overtakes_is_kept_apart() -> None:
    vehicles = [Vehicle(120, 8), Vehicle(122.5, 15)]
    found = vehicles_of(vehicles)
    assert_found(found, vehicles)


def test_passes_a_second_apart_are_fitted_jointly() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(0, 40, 0.25)
    mean = np.full(len(times), FLOOR)
    for moment, peak in ((18.0, 1.0), (21.0, 3.0)):
        mean += peak * (1 + ((times - moment) / 0.8) ** 2) ** -0.75
    found = FINDER.find(times, fluctuating(mean, rng, FREEDOM), np.full(len(times), FLOOR))
    assert [p.time_s for p in found] == pytest.approx([18, 21], abs=0.4)
    assert [p.together for p in found] == [2, 2]
    assert [p.peak for p in found] == pytest.approx([1, 3], rel=0.4)


def test_two_that_meet_at_a_station_lose_one_pass_and_no_vehicle() -> None:
    vehicles = [Vehicle(120, 8), Vehicle(123.98, 15)]  # 0.5 s apart at 150 m
    found = vehicles_of(vehicles)
    assert sorted(len(p.passes) for p in found) in ([2, 3], [3, 3])
    assert_found(found, vehicles)


def test_a_time_that_fits_no_speed_is_no_vehicle() -> None:
    def at(time_s: float) -> StationPass:
        return StationPass(time_s, 0.1, 0.5, 0.1, 1.0, 0.1, 50.0, 1)

    assert associate(Road((0.0, 100.0)), [[at(10)], [at(10.5)]]) == ()
    (vehicle,) = associate(Road((0.0, 100.0)), [[at(10)], [at(20), at(500)]])
    assert (vehicle.speed_mps, vehicle.direction) == (pytest.approx(10), 1)
    assert vehicle.passes == ((0, 0), (1, 0))
    assert vehicle.speed_sigma_mps == pytest.approx(10 * np.sqrt(2 * (0.01 + 0.01)) / 10)


def test_smoothing_keeps_a_constant() -> None:
    assert smoothed(np.full(9, 2.0), 5) == pytest.approx(2)
    assert smoothed(np.array([1.0, 5.0]), 7) == pytest.approx([1, 5])
