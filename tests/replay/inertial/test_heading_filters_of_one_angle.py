"""The filters of EPFL: golden numbers, and why the printed signs are wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundtrace.inertial.heading_baselines import AzimuthKalman, Exponential, exponential_update


def test_the_corrected_azimuth_lies_between_gyroscope_and_compass() -> None:
    azimuth, bias = exponential_update(96.0, 90.5, 0.0, 0.7, 10.0)
    assert azimuth == pytest.approx(94.35, abs=1e-12)
    assert azimuth == pytest.approx(0.7 * 96.0 + 0.3 * 90.5)
    assert bias == pytest.approx(0.3 * 0.55)


@pytest.mark.parametrize(("alpha", "azimuth"), [(1.0, 96.0), (0.0, 90.5)])
def test_alpha_chooses_between_the_two(alpha: float, azimuth: float) -> None:
    assert exponential_update(96.0, 90.5, 0.1, alpha, 5.0)[0] == pytest.approx(azimuth)


def test_the_bias_comes_near_the_true_one_without_overshooting() -> None:
    true, bias, azimuth, seen = 0.5, 0.0, 0.0, []
    for _ in range(40):
        azimuth += (true - bias) * 10.0
        azimuth, bias = exponential_update(azimuth, 0.0, bias, 0.7, 10.0)
        azimuth = 0.0  # the azimuth's own correction apart, each interval starts at the compass
        seen.append(bias)
    assert np.all(np.diff(seen) > 0)
    assert max(seen) <= true
    assert seen[-1] == pytest.approx(true, abs=1e-3)


def test_the_exponential_filter_waits_until_the_gyroscope_is_not_good_enough() -> None:
    waiting = Exponential(alpha=0.7, tolerance_rad=math.radians(1.0), least_s=0.0)
    waiting.advance(1.0, 1e-8)
    assert waiting.correct(0.1, 0.05) == 0.0
    waiting.advance(1.0, math.radians(2.0) ** 2)
    assert waiting.correct(0.1, 0.05) == pytest.approx(0.03)


@pytest.mark.parametrize("made", [Exponential, AzimuthKalman])
def test_a_constant_bias_is_learned(made: type[Exponential] | type[AzimuthKalman]) -> None:
    filter_, drift = made(), math.radians(0.05)
    error = 0.0
    for _ in range(6000):
        error += drift * 0.1 + filter_.advance(0.1, 1e-7)
        error += filter_.correct(-error, math.radians(5.0))
    assert abs(math.degrees(error)) < 1.0
