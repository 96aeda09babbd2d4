"""Places from ratios, (16) and (17), and from the powers of one cycle, (7)."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_powers import ANTENNAS, LAW, MU

from groundtrace.vehicles import likelihood
from groundtrace.vehicles.likelihood import CyclePlace, profiled_mu
from groundtrace.vehicles.medium import PowerLaw, ranges

TRIANGLE = np.array([(0.0, 0.0), (20.0, 3.0), (6.0, 18.0)])
NODES = likelihood.lattice((-10, -10), (40, 40), 1.0)
PLACE = np.array([9.3, 17.6])
AXIS = np.arange(-10.0, 40.5, 1.0)


def log_theta(place: np.ndarray, sensors: np.ndarray, exponent: float = 1.5) -> np.ndarray:
    r = ranges(place, sensors)
    return exponent * np.log(r[1:] / r[0])


def test_squared_distances_are_as_the_ratio_of_powers_to_two_over_n() -> None:
    # (7 / 12)^2 = 0.3403; with the exponent printed in (16), 1 / n, it would be 0.5833
    s = (7 / 12) ** 1.5
    assert s ** (2 / 1.5) == pytest.approx(0.3403, abs=1e-4)
    sensors = np.array([(0.0, 0.0), (19.0, 0.0), (0.0, 5.0)])
    place = np.array([7.0, 0.0])
    found = likelihood.solve(sensors, log_theta(place, sensors))
    assert np.abs(found - place).max(axis=1).min() < 1e-9


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.3])
def test_three_sensors_are_solved_exactly(exponent: float) -> None:
    rng = np.random.default_rng(7)
    for place in rng.uniform(-30, 40, (50, 2)):
        found = likelihood.solve(TRIANGLE, log_theta(place, TRIANGLE, exponent), exponent)
        assert np.linalg.norm(found - place, axis=1).min() < 1e-6


def test_sensors_in_a_line_leave_a_mirror_image() -> None:
    line = np.array([(0.0, 0.0), (10.0, 0.0), (25.0, 0.0)])
    found = likelihood.solve(line, log_theta(PLACE, line))
    assert sorted(found[:, 1]) == pytest.approx([-17.6, 17.6])
    assert found[:, 0] == pytest.approx([9.3, 9.3])


def test_ratios_that_no_place_has_give_none() -> None:
    line = np.array([(0.0, 0.0), (10.0, 0.0), (25.0, 0.0)])
    assert len(likelihood.solve(line, np.array([3.0, -6.0]))) == 0


def test_the_table_finds_the_node_of_true_ratios() -> None:
    place = np.array([9.0, 18.0])
    truth = log_theta(place, ANTENNAS)
    best = likelihood.correlation(NODES, ANTENNAS, truth)
    assert NODES[best.argmax()].tolist() == [9, 18]
    assert best.max() == pytest.approx(1)
    assert NODES[likelihood.squares(NODES, ANTENNAS, truth).argmin()].tolist() == [9, 18]


def test_the_reference_tells_places_apart_that_the_others_do_not() -> None:
    sensors = ANTENNAS[:3]
    truth = log_theta(PLACE, sensors)
    r = ranges(NODES, sensors)
    ratio = r[:, 1:] / r[:, :1]
    printed = (ratio / np.linalg.norm(ratio, axis=1, keepdims=True)) @ np.exp(truth)
    printed /= np.linalg.norm(np.exp(truth))
    close = likelihood.correlation(NODES, sensors, truth)
    assert (printed > printed.max() - 1e-4).sum() > 3 * (close > close.max() - 1e-4).sum()


def test_a_place_from_ratios_is_refined_below_the_table_with_its_error() -> None:
    exact = likelihood.locate(NODES, ANTENNAS, log_theta(PLACE, ANTENNAS), 0.05 / 2**0.5)
    assert (exact.x, exact.y) == pytest.approx(PLACE.tolist(), abs=1e-6)
    rng = np.random.default_rng(8)
    truth = -1.5 * np.log(ranges(PLACE, ANTENNAS))
    off = []
    for _ in range(120):
        logs = truth + rng.normal(0, 0.05 / 2**0.5, 6)
        found = likelihood.locate(NODES, ANTENNAS, logs[0] - logs[1:], 0.05 / 2**0.5)
        off.append(np.array([found.x, found.y]) - PLACE)
    assert np.cov(np.array(off).T) == pytest.approx(exact.covariance, rel=0.35, abs=0.01)


def test_the_profiled_mu_is_the_likeliest() -> None:
    a = np.random.default_rng(9).gamma(9, 1, (4, 6))
    mu = profiled_mu(a, 1 / 3)

    def value(scale: float) -> np.ndarray:
        m = (scale * mu)[:, None]
        return np.asarray((-np.log(m) - 4.5 * (a / m - 1) ** 2).sum(axis=1))

    assert (value(1.0) > value(0.999)).all()
    assert (value(1.0) > value(1.001)).all()


@pytest.mark.parametrize("known", [True, False])
def test_one_cycle_gives_a_place_with_its_error(known: bool) -> None:
    sigma = 0.03
    law = PowerLaw(MU, 1.5)
    rng = np.random.default_rng(10)
    mean = law.power(ranges(PLACE, ANTENNAS))
    off, spreads = [], []
    for _ in range(60):
        powers = mean * (1 + sigma * rng.normal(size=6))
        cycle = CyclePlace(powers, ANTENNAS, law, known, sigma)
        found = cycle.locate(cycle.surface(AXIS, AXIS))
        off.append(np.array([found.x, found.y]) - PLACE)
        spreads.append(found.covariance)
    assert np.cov(np.array(off).T) == pytest.approx(np.mean(spreads, axis=0), rel=0.6, abs=0.05)


def test_a_node_on_top_of_a_sensor_is_a_place_as_any() -> None:
    cycle = CyclePlace(LAW.power(ranges(PLACE, ANTENNAS)), ANTENNAS, LAW)
    assert np.isfinite(cycle.surface(np.array([0.0, 15.0]), np.array([0.0, 30.0])).values).all()


def test_a_dead_sensor_does_not_count() -> None:
    powers = LAW.power(ranges(PLACE, ANTENNAS))
    powers[1] = 0.0
    cycle = CyclePlace(powers, ANTENNAS, LAW)
    found = cycle.locate(cycle.surface(AXIS, AXIS))
    assert (found.x, found.y) == pytest.approx(PLACE.tolist(), abs=0.05)
    assert found.picks == 5
