"""Powers of cycles, the noise below them, and the analytic signal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from groundtrace.dsp.filters import bandpass
from groundtrace.vehicles.presence import (
    AnalyticBand,
    CyclePower,
    CyclePowers,
    NoiseFloor,
    degrees_of_freedom,
    power,
)

RATE = 200.0
START_NS = 1_700_000_000_300_000_000


def times_of(n: int) -> np.ndarray:
    return START_NS + (np.arange(n) * (1e9 / RATE)).astype(np.int64)


def noise(seconds: float, seed: int = 0, channels: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(channels, int(seconds * RATE)))


def joined(parts: list[CyclePowers]) -> CyclePowers:
    return CyclePowers(
        np.concatenate([p.time_ns for p in parts]),
        np.concatenate([p.power for p in parts], axis=1),
        np.concatenate([p.steady for p in parts], axis=1),
        np.concatenate([p.freedom for p in parts], axis=1),
    )


def in_blocks(x: np.ndarray, sizes: list[int]) -> list[slice]:
    edges = np.minimum(np.cumsum([0, *sizes, x.shape[1]]), x.shape[1]).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 700), max_size=6))
def test_powers_of_cycles_do_not_depend_on_the_blocks(sizes: list[int]) -> None:
    x, times = noise(9.3), times_of(1860)
    whole, parts = CyclePower(RATE, 2), CyclePower(RATE, 2)
    expected = joined([whole.add(times, x), whole.flush()])
    found = joined([*(parts.add(times[s], x[:, s]) for s in in_blocks(x, sizes)), parts.flush()])
    assert np.array_equal(found.time_ns, expected.time_ns)
    assert np.array_equal(found.power, expected.power)
    assert np.array_equal(found.steady, expected.steady)
    assert np.array_equal(found.freedom, expected.freedom)


def test_cycles_lie_on_whole_seconds_whenever_a_recorder_began() -> None:
    x = noise(9.3)
    cycles = CyclePower(RATE, 2)
    found = joined([cycles.add(times_of(1860), x), cycles.flush()])
    assert set(found.time_ns % 1_000_000_000) == {500_000_000}
    assert len(found.time_ns) == 10  # 0.7 s, eight whole ones and 0.6 s
    assert np.diff(found.time_ns).tolist() == [1_000_000_000] * 9


def test_power_of_a_sinusoid_in_the_band_is_half_its_squared_amplitude() -> None:
    t = np.arange(4000) / RATE
    cycles = CyclePower(RATE, 1)
    found = cycles.add(times_of(4000), 3 * np.sin(2 * np.pi * 14 * t)[None])
    assert found.power[0, 3:] == pytest.approx(4.5, rel=0.01)


def test_degrees_of_freedom_tell_how_much_the_power_of_noise_scatters() -> None:
    cycles = CyclePower(RATE, 2, low_hz=10, high_hz=30)
    found = cycles.add(times_of(200_000), noise(1000))
    freedom = 1 / np.mean(1 / found.freedom[:, 2:])
    scatter = found.power[:, 2:].var() / found.power[:, 2:].mean() ** 2
    assert scatter == pytest.approx(2 / freedom, rel=0.15)
    _, response = signal.freqz_sos(bandpass(10, 30, RATE, order=4), worN=4000, fs=RATE)
    power = np.abs(response) ** 2
    width = power.sum() ** 2 / (power**2).sum() * RATE / 2 / 4000
    assert freedom == pytest.approx(2 * width, rel=0.05)  # 2 B T


def test_a_silent_channel_has_no_power_and_all_degrees_of_freedom() -> None:
    assert degrees_of_freedom(np.zeros((1, 100))).tolist() == [100]


def test_the_floor_is_the_mean_power_of_the_noise_below_passes() -> None:
    rng = np.random.default_rng(1)
    freedom = np.full((2, 600), 40.0)
    powers = np.array([[1.0], [5.0]]) * rng.gamma(20, 1 / 20, (2, 600))
    quiet = NoiseFloor()(powers, freedom)
    assert quiet.power[:, 120:].mean(axis=1) == pytest.approx([1, 5], rel=0.02)
    off = (quiet.power[:, 150::40] - [[1], [5]]) / quiet.sigma[:, 150::40]
    assert np.std(off) == pytest.approx(1, abs=0.4)
    powers[:, 200:230] += 100
    passed = NoiseFloor()(powers, freedom)
    assert passed.power[:, 200:350].mean(axis=1) == pytest.approx([1, 5], rel=0.08)


def test_the_floor_does_not_depend_on_the_blocks() -> None:
    powers = np.random.default_rng(2).gamma(20, 1 / 20, (2, 50))
    freedom = np.full((2, 50), 40.0)
    whole, parts = NoiseFloor(20), NoiseFloor(20)
    expected = whole(powers, freedom).power
    spans = [slice(0, 1), slice(1, 1), slice(1, 33), slice(33, 50)]
    found = np.concatenate([parts(powers[:, s], freedom[:, s]).power for s in spans], axis=1)
    assert np.array_equal(found, expected)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 700), max_size=6))
def test_the_analytic_signal_does_not_depend_on_the_blocks(sizes: list[int]) -> None:
    x, times = noise(9.3), times_of(1860)
    expected_ns, expected = AnalyticBand(RATE, 10, 30)(times, x)
    band = AnalyticBand(RATE, 10, 30)
    parts = [band(times[s], x[:, s]) for s in in_blocks(x, sizes)]
    assert np.array_equal(np.concatenate([t for t, _ in parts]), expected_ns)
    assert np.array_equal(np.concatenate([y for _, y in parts], axis=1), expected)


def test_the_analytic_signal_is_hilberts_in_the_band_and_in_time() -> None:
    t = np.arange(2000) / RATE
    x = (1 + 0.5 * np.sin(2 * np.pi * 0.7 * t)) * np.cos(2 * np.pi * 20 * t)
    times, found = AnalyticBand(RATE, 10, 30)(times_of(2000), 7 + x[None])
    place = np.searchsorted(times_of(2000), times)
    assert len(times) > 1700
    assert found[0] == pytest.approx(signal.hilbert(x)[place], abs=0.02)
    assert power(found)[0] == pytest.approx(0.5 * np.abs(signal.hilbert(x)[place]) ** 2, abs=0.03)


@pytest.mark.parametrize("rate_hz", [100.0, 500.0])
def test_the_band_is_that_of_the_window_method_of_scipy(rate_hz: float) -> None:
    band = AnalyticBand(rate_hz, 10.0, 30.0)
    late = np.arange(-band.delay, band.delay + 1)
    base = signal.firwin(len(late), 10.0, fs=rate_hz)
    expected = 2 * base * np.exp(2j * np.pi * 20.0 / rate_hz * late)
    np.testing.assert_allclose(band.kernel, expected, rtol=1e-12, atol=1e-15)
