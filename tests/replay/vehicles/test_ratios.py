"""Ratios of powers: (10) to (15), as corrected."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from scipy.optimize import minimize_scalar

from groundtrace.vehicles.ratios import (
    DEVIATIONS,
    Method,
    by_likelihood,
    estimate,
    independent,
    log_likelihood,
)

K = 1000


def drawn(theta: float, trials: int, samples: int = K) -> tuple[np.ndarray, np.ndarray]:
    """Exponential powers of two sensors, shapes (trials, samples); theta is mean p_l / mean p_n."""
    rng = np.random.default_rng(5)
    return rng.exponential(size=(trials, samples)), theta * rng.exponential(size=(trials, samples))


def test_theta_is_the_ratio_of_distances_of_the_first_sensor_over_the_second() -> None:
    # r_n = 10 m and r_l = 20 m: the paper's own (r_l / r_n)^1.5 would be 2.83
    powers = drawn((10 / 20) ** 1.5, 20)
    found = estimate(*powers, "likelihood").theta
    assert found.mean() == pytest.approx(0.354, abs=0.01)


def test_newton_finds_the_maximum_of_the_likelihood() -> None:
    p_n, p_l = drawn(0.48, 5)
    log_s = np.log(p_n / p_l)
    for row, found in zip(log_s, by_likelihood(log_s), strict=True):
        best = minimize_scalar(
            lambda x, row=row: -float(log_likelihood(np.array(x), row)), bounds=(-5, 5)
        )
        assert found == pytest.approx(best.x, abs=1e-4)
        share = np.exp(found + row) / (1 + np.exp(found + row))
        assert share.sum() == pytest.approx(K / 2)  # (14) as corrected
        x = np.exp(np.linspace(-8, 8, 200))[:, None] * np.exp(row)
        assert (x / (1 + x) ** 2).sum(axis=1).max() < K / 4  # (14) as printed has no root


@pytest.mark.parametrize("theta", [0.1, 1.0, 20.0])
@pytest.mark.parametrize("method", list(DEVIATIONS))
def test_every_estimator_has_its_deviation_whatever_theta(method: Method, theta: float) -> None:
    found = estimate(*drawn(theta, 400), method, correlated=False)
    assert found.theta.mean() / theta == pytest.approx(1, abs=0.01)
    assert found.log_theta.std() == pytest.approx(DEVIATIONS[method] / K**0.5, rel=0.12)
    assert found.log_sigma == pytest.approx(DEVIATIONS[method] / K**0.5)


def test_the_mean_ratio_of_powers_would_be_useless() -> None:
    p_n, p_l = drawn(1.0, 400)
    assert np.mean(1 / (p_n / p_l).mean(axis=1)) < 0.2


def test_a_ratio_upside_down_is_one_over_it() -> None:
    p_n, p_l = drawn(3.0, 10)
    for method in DEVIATIONS:
        one, other = estimate(p_n, p_l, method), estimate(p_l, p_n, method)
        assert one.log_theta == pytest.approx(-other.log_theta, abs=1e-9)


@pytest.mark.parametrize("method", list(DEVIATIONS))
def test_alike_neighbours_count_for_less(method: Method) -> None:
    rng = np.random.default_rng(6)
    kernel = signal.firwin(41, 0.15)  # a band of 0.15 of what the rate carries
    white = rng.normal(size=(2, 300, K + 40)) + 1j * rng.normal(size=(2, 300, K + 40))
    p_n, p_l = np.abs(signal.lfilter(kernel, 1, white, axis=-1)[..., 40:]) ** 2
    found = estimate(p_n, p_l, method)
    assert found.count.mean() == pytest.approx(0.2 * K, rel=0.3)
    assert found.log_theta.std() == pytest.approx(found.log_sigma.mean(), rel=0.25)


def test_independent_samples_count_nearly_all() -> None:
    p_n, p_l = drawn(1.0, 50)
    log_s = np.log(p_n / p_l)
    assert independent(by_likelihood(log_s), log_s).mean() > 0.9 * K
