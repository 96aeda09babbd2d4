"""From samples to a course and to a place: the modules one after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import signal
from vehicle_powers import ANTENNAS, LAW

from groundtrace.vehicles import likelihood, ratios
from groundtrace.vehicles.courses import Observed, Search, fit_course
from groundtrace.vehicles.medium import ranges
from groundtrace.vehicles.presence import AnalyticBand, CyclePower, NoiseFloor, power

if TYPE_CHECKING:
    from collections.abc import Callable

RATE = 200.0


def recorded(
    place_at: Callable[[np.ndarray], np.ndarray], start_s: float, end_s: float, total_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times and samples of a vehicle that is there for a while; sensors hear noise of their own."""
    rng = np.random.default_rng(1)
    t = np.arange(int(total_s * RATE)) / RATE
    amplitude = np.sqrt(500 * LAW.power(ranges(place_at(t), ANTENNAS))).T
    amplitude *= (t >= start_s) & (t < end_s)
    sos = signal.butter(2, [8, 30], "bandpass", fs=RATE, output="sos")
    shaking = signal.sosfilt(sos, rng.normal(size=(6, len(t))), axis=1)
    samples = amplitude * shaking + 0.5 * rng.normal(size=(6, len(t)))
    return (t * 1e9).astype(np.int64), samples


def test_samples_become_a_course() -> None:
    velocity = np.array([1.0, 6.0])
    times, samples = recorded(
        lambda t: np.array([13.0, 15.0]) + (t[:, None] - 70) * velocity, 64, 76, 90
    )
    found = CyclePower(RATE, 6).add(times, samples)
    floors = NoiseFloor()(found.power, found.freedom)
    middle = found.time_ns / 1e9
    span = (middle > 64) & (middle < 76)
    observed = Observed(
        middle[span], found.power.T[span], floors.power.T[span], ANTENNAS, LAW, cycle_s=1.0
    )
    fit = fit_course(observed, Search.about(ANTENNAS))
    assert fit is not None
    assert fit.evidence > 100
    assert fit.course.at(np.array(70.0)) == pytest.approx([13, 15], abs=1.5)
    assert fit.course.velocity == pytest.approx(velocity, abs=0.7)
    crossing = fit.course.crossing(ANTENNAS[0], ANTENNAS[2])
    assert crossing is not None
    assert crossing.inside
    assert crossing.time_s == pytest.approx(67.5, abs=4 * crossing.time_sigma_s)
    assert crossing.along_m == pytest.approx(10.5, abs=4 * crossing.along_sigma_m)


def test_samples_become_a_place_by_ratios() -> None:
    place = np.array([9.0, 19.0])
    times, samples = recorded(lambda t: np.tile(place, (len(t), 1)), 0, 40, 40)
    _, analytic = AnalyticBand(RATE, 8, 30)(times, samples)
    powers = power(analytic)
    found = ratios.estimate(powers[1:], powers[:1])
    nodes = likelihood.lattice((-10, -10), (40, 40), 1.0)
    own = float(found.log_sigma.mean()) / 2**0.5
    location = likelihood.locate(nodes, ANTENNAS, found.log_theta, own)
    sigma = np.sqrt(np.diag(location.covariance))
    # the noise of the ground makes all powers somewhat more alike: ratios are not corrected for it
    assert np.abs([location.x - 9, location.y - 19] / sigma).max() < 5
    assert sigma.max() < 1
