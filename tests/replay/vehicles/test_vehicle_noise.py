"""The noise taken off the powers of a cycle, with its uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_powers import ANTENNAS, LAW, MU

from groundtrace.vehicles import likelihood
from groundtrace.vehicles.likelihood import CyclePlace, noise_subtracted
from groundtrace.vehicles.medium import ranges
from groundtrace.vehicles.ratios import (
    DEVIATIONS,
    Method,
    Noise,
    RatioEstimate,
    estimate,
    without_noise,
)

K = 60
PLACE = np.array([9.3, 17.6])
FLOOR_SIGMA = 0.15
AXIS = np.arange(-10.0, 40.5, 2.0)


def test_the_deviation_of_a_power_less_the_noise_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(1)
    mean = np.array([1.5, 3.0, 100.0])  # over a noise of 1
    powers = mean * rng.gamma(9 * K, 1 / (9 * K), (20000, 3))
    floors = 1 + 0.1 * rng.normal(size=(20000, 3))
    signal, _ = noise_subtracted(powers, floors, None, (9 * K) ** -0.5)
    _, sigma = noise_subtracted(mean, np.ones(3), np.full(3, 0.1), (9 * K) ** -0.5)
    assert signal.std(axis=0) / (mean - 1) == pytest.approx(sigma, rel=0.03)
    assert sigma[0] > 4 * sigma[2]


@pytest.mark.parametrize("method", list(DEVIATIONS))
def test_ratios_without_the_noise_err_as_they_say(method: Method) -> None:
    rng = np.random.default_rng(2)
    vehicle = np.array([20.0, 3.0, 1.5])
    powers = rng.exponential(size=(600, 3, K)) * (vehicle + 1)[:, None]
    every = estimate(powers[:, 1:], powers[:, :1], method, correlated=False)
    off, said = [], []
    for row, power in enumerate(powers.mean(axis=2)):
        floors = 1 + FLOOR_SIGMA * rng.normal(size=3)
        noise = Noise.of(power, floors, np.full(3, FLOOR_SIGMA))
        heard = RatioEstimate(every.log_theta[row], every.log_sigma[row], every.count[row])
        found = without_noise(heard, noise)
        off.append(found.log_theta - np.log(vehicle[0] / vehicle[1:]))
        said.append(found.log_sigma)
    assert np.std(off, axis=0) == pytest.approx(np.median(said, axis=0), rel=0.15)
    assert np.abs(np.mean(off, axis=0)).max() < 0.06


def test_a_sensor_that_hardly_hears_the_vehicle_has_little_weight() -> None:
    truth = MU * ranges(PLACE, ANTENNAS) ** -1.5
    powers = truth + 0.01
    powers[5] += 30 * truth[5]  # mostly noise, and a wrong part of it is taken for the vehicle's
    floors = np.where(np.arange(6) == 5, 29 * truth[5], 0.01)
    off = []
    for sigmas in (np.zeros(6), 0.1 * floors):
        signal, sigma = noise_subtracted(powers, floors, sigmas, 0.02)
        known = sigma if sigmas.any() else 0.02
        found = CyclePlace(signal, ANTENNAS, LAW, False, known)
        place = found.locate(found.surface(AXIS, AXIS))
        off.append(np.hypot(place.x - PLACE[0], place.y - PLACE[1]))
    assert off[1] < 0.2 * off[0]


def test_least_squares_of_logarithms_weigh_sensors_by_how_sure_they_are() -> None:
    rng = np.random.default_rng(3)
    nodes = likelihood.lattice((-10, -10), (40, 40), 2.0)
    truth = -1.5 * np.log(ranges(PLACE, ANTENNAS))
    sigmas = np.array([0.05, 0.05, 0.05, 0.05, 0.6, 0.6])
    off = {True: [], False: []}
    for _ in range(60):
        logs = truth + sigmas * rng.normal(size=6)
        for weighed, errors in off.items():
            known = sigmas if weighed else 0.05
            found = likelihood.locate(nodes, ANTENNAS, logs[0] - logs[1:], known)
            errors.append(np.array([found.x, found.y]) - PLACE)
    spread = likelihood.locate(nodes, ANTENNAS, truth[0] - truth[1:], sigmas).covariance
    assert np.cov(np.array(off[True]).T) == pytest.approx(spread, rel=0.5, abs=0.02)
    assert np.std(off[True]) < 0.3 * np.std(off[False])
