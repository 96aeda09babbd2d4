"""Direction of arrival by polarisation, against waves made with a known direction."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import numpy as np
import pytest
from scipy.signal import hilbert

from groundtrace.localizers.bearings import Method, Polarization, analytic, polarization

if TYPE_CHECKING:
    from numpy.typing import NDArray

RATE_HZ = 20_000.0
METHODS = get_args(Method)


def wave(
    azimuth: float, *, noise: float = 0.0, love: float = 0.0, seed: int = 0, turn: float = -1.0
) -> NDArray[np.float64]:
    """A decaying elliptical motion from ``azimuth``; up is cos, away is ``turn`` times sin."""
    t = np.arange(400) / RATE_HZ
    swell = np.exp(-t / 0.006) * (1 - np.exp(-t / 0.001))
    up, away = swell * np.cos(2 * np.pi * 200 * t), turn * 0.6 * swell * np.sin(2 * np.pi * 200 * t)
    across = love * swell * np.sin(2 * np.pi * 70 * t + 0.4)
    x = -away * np.cos(azimuth) - across * np.sin(azimuth)
    y = -away * np.sin(azimuth) + across * np.cos(azimuth)
    rng = np.random.default_rng(seed)
    return np.stack([x, y, up], axis=1) + noise * rng.standard_normal((400, 3))


def off_deg(found: Polarization, azimuth: float) -> float:
    return float(np.degrees(np.angle(np.exp(1j * (found.azimuth_rad - azimuth)))))


@pytest.mark.parametrize("samples", [1, 2, 7, 8, 401])
def test_the_analytic_signal_is_that_of_scipy(samples: int) -> None:
    x = np.random.default_rng(samples).normal(5.0, 2.0, (samples, 3))
    expected = hilbert(x - x.mean(axis=0), axis=0)
    assert np.allclose(analytic(x), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degrees", [0, 30, 45, 60, 135, -170])
def test_a_clean_wave_comes_from_where_it_came(method: Method, degrees: int) -> None:
    found = polarization(wave(np.radians(degrees)), method)
    assert abs(off_deg(found, np.radians(degrees))) < 0.01
    assert found.degree > 0.99
    assert found.ellipticity == pytest.approx(0.6, rel=0.1)


@pytest.mark.parametrize("degrees", [0, 30, 45, 60])
def test_the_analytic_covariance_is_good_to_a_degree_where_the_real_one_is_noise(
    degrees: int,
) -> None:
    """Equation (A.4) as printed; the eigenvector of the real covariance is the vertical."""
    azimuth = np.radians(degrees)
    analytic, printed = [], []
    for seed in range(60):
        values = wave(azimuth, noise=0.02, seed=seed)
        analytic.append(off_deg(polarization(values), azimuth))
        centred = values - values.mean(axis=0)
        main = np.linalg.eigh(centred.T @ centred)[1][:, -1]
        printed.append(np.degrees(np.arctan2(main[1], main[0])))
    assert np.std(analytic) < 1.0
    assert np.std(printed) > 20.0


def test_the_sine_and_cosine_of_a1_as_printed_would_give_ninety_degrees_minus_it() -> None:
    """Equation (A.1): with S_x ~ sin and S_y ~ cos the estimator (A.3) returns 90 - 30 = 60."""
    values = wave(np.radians(30))[:, [1, 0, 2]]
    assert np.degrees(polarization(values, "surface-wave").azimuth_rad) == pytest.approx(
        60, abs=0.1
    )


def test_a_prograde_wave_turns_the_direction_by_pi() -> None:
    found = polarization(wave(0.5, turn=1.0))
    assert abs(abs(off_deg(found, 0.5)) - 180) < 0.1


def test_a_strong_love_wave_of_another_frequency_turns_only_the_covariance_method() -> None:
    values = wave(0.7, love=1.6)
    assert abs(off_deg(polarization(values, "surface-wave"), 0.7)) < 10
    assert abs(off_deg(polarization(values, "covariance"), 0.7)) > 20
    assert abs(off_deg(polarization(wave(0.7, love=0.2)), 0.7)) < 5


@pytest.mark.parametrize("method", METHODS)
def test_the_error_given_is_the_error_made(method: Method) -> None:
    found = [polarization(wave(1.0, noise=0.1, seed=s), method) for s in range(100)]
    made = np.std([off_deg(f, 1.0) for f in found])
    said = np.degrees(np.sqrt(np.mean([f.sigma_rad**2 for f in found])))
    assert 0.6 < made / said < 1.6


def test_noise_alone_is_hardly_polarised_and_silence_not_at_all() -> None:
    noise = polarization(np.random.default_rng(3).standard_normal((400, 3)))
    assert noise.degree < 0.3
    silence = polarization(np.zeros((400, 3)))
    assert (silence.degree, silence.sigma_rad) == (0.0, np.pi)
