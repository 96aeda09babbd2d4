"""The law of power: (1) to (4), and what fits it to a ground."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_powers import fluctuating

from groundtrace.vehicles.medium import (
    Geophone,
    Kind,
    PowerLaw,
    attenuation,
    local_exponent,
    loss_per_m,
    ranges,
    received_power,
)
from groundtrace.vehicles.medium_fit import fit_medium

DISTANCES = np.array([2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
LOSS_SPM = 1e-3


def track(speed: float, offset: float) -> np.ndarray:
    """Distances of a pass to four sensors beside a road, shape (80, 4)."""
    along = speed * np.linspace(-40, 40, 80)
    places = np.stack([along, np.zeros(80)], axis=1)
    return ranges(places, np.array([(0, offset), (20, 2 * offset), (-30, offset), (5, -offset)]))


def test_the_integral_falls_as_the_half_power_at_one_distance_only() -> None:
    low = local_exponent(DISTANCES, Geophone(10.0, 0.7, "low-pass"), LOSS_SPM)
    assert low - 1 == pytest.approx([0.08, 0.19, 0.34, 0.55, 0.84, 0.97], abs=0.006)


def test_a_real_geophone_makes_power_fall_faster() -> None:
    high = local_exponent(DISTANCES, Geophone(10.0, 0.7, "high-pass"), LOSS_SPM)
    assert (high[0] - 1, high[-1] - 1) == pytest.approx((1.13, 4.18), abs=0.01)
    assert (np.diff(high) > 0).all()


def test_the_corrected_prefactor_makes_the_law_of_the_paper_where_the_integral_is_a_root() -> None:
    # (2) as printed, with 1 / r^2, would make 2.5 of it
    geophone = Geophone(10.0, 0.7, "low-pass")
    near = np.linspace(15, 20, 11)
    halfway = near[np.abs(local_exponent(near, geophone, LOSS_SPM) - 1.5).argmin()]
    assert local_exponent(np.array([halfway]), geophone, LOSS_SPM) == pytest.approx(1.5, abs=0.01)


def test_the_integral_is_that_of_an_oscillator_where_nothing_is_lost() -> None:
    # int |H|^2 df of a low-pass oscillator is pi f0 / (4 xi)
    power = received_power(np.array([3.0]), Geophone(10.0, 0.7, "low-pass"), 0.0)
    assert power * 3 == pytest.approx(np.pi * 10 / (4 * 0.7), rel=1e-4)


def test_a_narrow_band_follows_the_law_with_loss() -> None:
    power = received_power(DISTANCES, Geophone(), LOSS_SPM, (19.9, 20.1))
    law = PowerLaw(1.0, 1.0, loss_per_m(LOSS_SPM, 20.0)).power(DISTANCES)
    assert power / power[0] == pytest.approx(law / law[0], rel=1e-3)
    amplitude = attenuation(np.array([20.0]), DISTANCES, LOSS_SPM)
    assert amplitude**2 == pytest.approx(law, rel=1e-9)


@pytest.mark.parametrize("kind", ["low-pass", "high-pass"])
def test_a_geophone_resonates_at_its_natural_frequency(kind: Kind) -> None:
    response = Geophone(10.0, 0.7, kind).response(np.array([10.0]))
    assert abs(response[0]) == pytest.approx(1 / 1.4)
    assert abs(np.angle(response[0])) == pytest.approx(np.pi / 2)


def test_on_top_of_a_sensor_power_is_that_at_half_a_metre() -> None:
    law = PowerLaw(2.0, 1.5)
    assert law.power(np.array([0.0, 0.5])) == pytest.approx([2 * 0.5**-1.5] * 2)
    assert law.slope(np.array([0.1])) == 0
    assert law.slope(np.array([3.0])) == pytest.approx(-0.5)


def test_a_fit_finds_the_law_of_a_pass_within_its_errors() -> None:
    rng = np.random.default_rng(3)
    r = track(8.0, 6.0)
    off = []
    for _ in range(40):
        powers = fluctuating(300 * r**-1.8 + 0.05, rng)
        found = fit_medium(r, powers, 0.05)
        assert found is not None
        off.append(
            (
                (found.law.exponent - 1.8) / found.exponent_sigma,
                (np.log(found.law.mu) - np.log(300)) / found.log_mu_sigma,
            )
        )
        assert found.scatter == pytest.approx(1 / 3, rel=0.2)
    assert np.std(off, axis=0) == pytest.approx([1, 1], abs=0.3)
    assert np.mean(off, axis=0) == pytest.approx([0, 0], abs=0.5)


def test_a_fit_tells_loss_from_spreading_where_distances_differ_enough() -> None:
    rng = np.random.default_rng(4)
    r = track(8.0, 4.0)
    law = PowerLaw(300.0, 1.0, loss_per_m(LOSS_SPM, 15.0))
    found = fit_medium(r, fluctuating(law.power(r), rng, 200), centre_hz=15.0)
    assert found is not None
    assert found.loss_spm == pytest.approx(LOSS_SPM, abs=4 * found.loss_spm_sigma)
    assert found.loss_spm_sigma < 0.2 * LOSS_SPM
    assert found.correlation < -0.5


def test_one_distance_tells_no_exponent() -> None:
    assert fit_medium(np.full((5, 2), 3.0), np.ones((5, 2))) is None
    assert fit_medium(np.array([[3.0, 4.0]]), np.ones((1, 2))) is None


def test_a_vehicle_that_moves_within_a_cycle_needs_its_distances_through_the_cycle() -> None:
    rng = np.random.default_rng(5)
    times = np.arange(-15, 15)[:, None] + (np.arange(10) + 0.5) / 10 - 0.5
    places = np.stack([8 * times, np.zeros(times.shape)], axis=-1)
    r = np.moveaxis(ranges(places, np.array([(0, 1.0), (4, -2.0), (-20, 3.0)])), 1, 2)
    powers = fluctuating(300 * (r**-1.5).mean(axis=2), rng, 1000)
    through, middle = fit_medium(r, powers), fit_medium(r.mean(axis=2), powers)
    assert through is not None
    assert middle is not None
    assert through.law.exponent == pytest.approx(1.5, abs=4 * through.exponent_sigma)
    assert abs(middle.law.exponent - 1.5) > 2 * abs(through.law.exponent - 1.5)
