"""Filters: the same samples whatever the blocks, and the response they are designed for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_blocks import block_of, cuts_of, parts_of, stream_of
from scipy import signal

from groundtrace.detectors.body_signals import WalkingSignal
from groundtrace.dsp.filters import (
    ExponentialMean,
    SmoothedSlope,
    StreamingFilter,
    UnbiasedMean,
    WeightedSums,
    bandpass,
    bessel,
    corner,
    phase_delay_s,
    planar,
)
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

N = 300
NOISE = np.random.default_rng(6).normal(3.0, 1.0, (2, N))

AVERAGERS = {
    "band-pass": lambda: StreamingFilter(bandpass(5.0, 100.0, 1000.0)),
    "exponential mean": lambda: ExponentialMean(0.07),
    "no memory": lambda: ExponentialMean(1.0),
    "unbiased mean": lambda: UnbiasedMean(13.5),
    "weighted sums": lambda: WeightedSums(np.hanning(9)[1:-1]),
    "weighted sums from rest": lambda: WeightedSums(np.hanning(9)[1:-1], at_rest=True),
}


@pytest.mark.parametrize("make", AVERAGERS.values(), ids=AVERAGERS)
@given(cuts=cuts_of(N))
def test_parts_give_exactly_the_samples_of_the_whole(make, cuts):
    whole, filtered = make()(NOISE), make()
    parts = [filtered(part) for part in parts_of(NOISE, cuts)]
    assert np.array_equal(np.concatenate(parts, axis=1), whole)


@given(cuts=cuts_of(N), rate_hz=st.sampled_from([50.0, 1000.0, 4000.0]))
def test_parts_give_exactly_the_slope_of_the_whole(cuts, rate_hz):
    def run(edges):
        slope = SmoothedSlope(rate_hz, 0.008, 0.003)
        found = [slope(x) for x in parts_of(NOISE, edges)] + [slope.flush()]
        return [np.concatenate([f[i] for f in found], axis=-1) for i in range(2)]

    for one, other in zip(run(cuts), run([]), strict=True):
        assert np.array_equal(one, other)


def test_a_filter_starts_in_the_steady_state_of_the_first_sample():
    band = StreamingFilter(bandpass(5.0, 100.0, 1000.0))
    assert np.abs(band(np.full((2, 100), 1e4))).max() < 1e-6
    low = StreamingFilter(bandpass(0.0, 100.0, 1000.0))
    assert np.allclose(low(np.full((1, 100), 7.0)), 7.0)


def gain(sos: np.ndarray, hz: float, rate_hz: float) -> float:
    return float(np.abs(signal.freqz_sos(sos, worN=[hz], fs=rate_hz)[1][0]))


def test_a_band_pass_passes_its_band():
    sos = bandpass(20.0, 200.0, 1000.0)
    assert gain(sos, 63.0, 1000.0) == pytest.approx(1.0, abs=0.02)
    for edge in (20.0, 200.0):
        assert gain(sos, edge, 1000.0) == pytest.approx(np.sqrt(0.5), abs=0.01)
    assert gain(sos, 2.0, 1000.0) < 0.02
    assert gain(sos, 480.0, 1000.0) < 0.02


@pytest.mark.parametrize(
    ("low", "high", "rate", "passed", "stopped"),
    [
        (20.0, 2000.0, 1000.0, 400.0, 1.0),  # upper corner cannot be had: high-pass
        (0.0, 100.0, 1000.0, 1.0, 480.0),
        (20.0, 0.0, 1000.0, 400.0, 1.0),
        (0.5, 20.0, 6.0, 2.0, 0.01),
        (0.0, 2.0, 6.0, 0.1, 2.95),
    ],
)
def test_a_corner_that_cannot_be_had_is_left_out(low, high, rate, passed, stopped):
    sos = bandpass(low, high, rate)
    assert gain(sos, passed, rate) == pytest.approx(1.0, abs=0.05)
    assert gain(sos, stopped, rate) < 0.05


@pytest.mark.parametrize(("low", "high", "rate"), [(20.0, 2000.0, 6.0), (0.0, 0.0, 1000.0)])
def test_without_any_corner_the_signal_passes_unchanged(low, high, rate):
    assert np.array_equal(StreamingFilter(bandpass(low, high, rate))(NOISE), NOISE)


def test_a_corner_above_what_the_rate_allows_is_lowered():
    assert corner(3.0, 100.0) == 3.0
    assert corner(3.0, 6.0) == pytest.approx(2.7)


def test_the_delay_of_a_sinusoid_is_the_one_seen():
    rate, hz = 1000.0, 3.0
    sos = signal.butter(2, 8.0, fs=rate, output="sos")
    time = np.arange(4000) / rate
    filtered = StreamingFilter(sos)(np.sin(2 * np.pi * hz * time)[None, :])[0]
    delayed = np.sin(2 * np.pi * hz * (time - phase_delay_s(sos, hz, rate)))
    ratio = filtered[2000:] @ delayed[2000:] / (delayed[2000:] @ delayed[2000:])
    assert np.abs(filtered[2000:] - ratio * delayed[2000:]).max() < 1e-3


def test_an_exponential_mean_is_that_of_the_plain_recursion():
    mean, expected = 0.0, []
    for x in NOISE[0]:
        mean += 0.07 * (x - mean)
        expected.append(mean)
    assert np.allclose(ExponentialMean(0.07)(NOISE[:1])[0], expected, rtol=1e-12)


def test_an_unbiased_mean_is_right_from_the_first_sample_on():
    assert np.allclose(UnbiasedMean(50.0)(np.full((1, 20), 4.0)), 4.0)
    weights = np.exp(-np.arange(N) / 50.0)[::-1]
    mean = UnbiasedMean(50.0)(NOISE)[:, -1]
    assert np.allclose(mean, (NOISE * weights).sum(axis=1) / weights.sum())


@pytest.mark.parametrize("rate_hz", [200.0, 1000.0, 4000.0])
def test_the_slope_of_a_line_is_its_slope_without_delay(rate_hz):
    slope = SmoothedSlope(rate_hz, 0.010, 0.005)
    line = 0.25 * np.arange(200.0)[None, :]
    x, found = slope(line)
    assert x.shape[1] == 200 - slope.delay
    assert np.array_equal(x[0], line[0, : x.shape[1]])
    inner = slice(slope.delay, None)
    assert np.allclose(found[0, inner], 0.25)


def test_the_slope_is_largest_where_the_signal_jumps():
    step = np.repeat([0.0, 1.0], 100)[None, :]
    slope = SmoothedSlope(1000.0, 0.008, 0.002)
    found = [slope(step), slope.flush()]
    values = np.concatenate([f[1][0] for f in found])
    assert len(values) == 200
    assert abs((values * np.arange(200)).sum() / values.sum() - 99.5) < 1e-9


@pytest.mark.parametrize("length", [1, 2, 5])
def test_a_run_shorter_than_the_smoothing_has_a_slope_too(length):
    slope = SmoothedSlope(1000.0, 0.02, 0.01)
    assert slope(NOISE[:, :length])[0].shape == (2, 0)
    x, found = slope.flush()
    assert np.array_equal(x, NOISE[:, :length])
    assert np.isfinite(found).all()


def test_an_offset_of_the_signal_changes_no_slope():
    one, other = (SmoothedSlope(1000.0, 0.004, 0.003) for _ in range(2))
    assert np.allclose(one(NOISE)[1], other(NOISE + 1e6)[1], atol=1e-6)


def test_planar_values_are_scaled_channel_by_channel():
    channels = (Channel("a", "seismic", "V", scale=0.5), Channel("b", "seismic", "V", scale=2.0))
    stream = Stream("/s", channels, 100.0)
    block = SignalBlock(stream, 0, 0, np.array([[2, 3], [4, 5]], np.int16))
    values = planar(block)
    assert values.tolist() == [[1.0, 2.0], [6.0, 10.0]]
    assert values.flags.c_contiguous


@pytest.mark.parametrize("rate_hz", [6.0, 50.0, 200.0])
def test_the_walking_signal_takes_gravity_away_at_any_rate(rate_hz):
    walking = WalkingSignal(rate_hz, 3.0, 0.25)
    time = np.arange(round(40 * rate_hz)) / rate_hz
    values = 9.81 + np.cos(2 * np.pi * 1.8 * time)
    _, filtered = walking(block_of(stream_of(1, rate_hz), 0, values))
    late = filtered[0, len(time) // 2 :]
    assert abs(late.mean()) < 0.05
    assert 0.5 < np.abs(late).max() < 1.1
    assert abs(walking.delay_ns) < 0.3e9


@given(hz=st.floats(0.01, 0.49), rate_hz=st.floats(1.0, 2e4))
def test_the_bessel_low_pass_is_that_of_scipy(hz: float, rate_hz: float) -> None:
    expected = signal.bessel(2, hz * rate_hz, "low", fs=rate_hz, output="sos", norm="mag")
    np.testing.assert_allclose(bessel(hz * rate_hz, rate_hz), expected, rtol=1e-9, atol=1e-12)


@given(hz=st.floats(0.001, 0.45), rate_hz=st.floats(1.0, 2e4))
def test_the_delay_is_that_of_the_response_of_scipy(hz: float, rate_hz: float) -> None:
    sos = np.concatenate([bessel(0.2 * rate_hz, rate_hz), bandpass(0.0, 0.3 * rate_hz, rate_hz)])
    _, (response,) = signal.freqz_sos(sos, worN=[hz * rate_hz], fs=rate_hz)
    turns = (
        phase_delay_s(sos, hz * rate_hz, rate_hz) * hz * rate_hz + np.angle(response) / 2 / np.pi
    ) % 1
    assert min(turns, 1 - turns) < 1e-9


@pytest.mark.parametrize("length", [1, 2, 9])
def test_sums_from_rest_are_as_if_the_first_sample_had_always_been(length: int) -> None:
    weights = np.random.default_rng(length).normal(size=length)
    before = np.repeat(NOISE[:, :1], length, axis=1)
    longer = WeightedSums(weights)(np.concatenate([before, NOISE], axis=1))[:, length:]
    np.testing.assert_allclose(WeightedSums(weights, at_rest=True)(NOISE), longer, atol=1e-12)
