"""The even grid and what runs on it: nothing is delayed, and parts give what the whole gives."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_blocks import cuts_of

from groundtrace.detectors.body_signals import Gravity, along
from groundtrace.dsp.periodicity import HOP, Rhythm, Scale, repetition
from groundtrace.dsp.resample import (
    GRID_HZ,
    CentredFilter,
    ColumnBuffer,
    UniformResampler,
    gaussian,
)
from groundtrace_codecs.signals import NS_PER_S

N = 600


def times(count, rate_hz):
    return np.rint(np.arange(count) * (NS_PER_S / rate_hz)).astype(np.int64)


def gridded(x, rate_hz, cuts=()):
    grid = UniformResampler(rate_hz, 3.5)
    at = times(x.shape[1], rate_hz)
    edges = [0, *sorted(cuts), x.shape[1]]
    parts = [grid(at[a:b], x[:, a:b]) for a, b in pairwise(edges)]
    parts.append(grid.flush())
    return (
        np.concatenate([p.time_ns for p in parts]),
        np.concatenate([p.values for p in parts], axis=1),
    )


@pytest.mark.parametrize("rate_hz", [6.0, 10.0, 25.0, 99.7, 405.65])
def test_a_step_is_the_same_curve_at_any_rate(rate_hz):
    t = np.arange(round(20 * rate_hz)) / rate_hz
    at, values = gridded(np.sin(2 * np.pi * 1.8 * t)[None, :] + 4, rate_hz)
    middle = slice(40, -40)
    wanted = 4 + np.sin(2 * np.pi * 1.8 * at / NS_PER_S)
    np.testing.assert_allclose(values[0, middle], wanted[middle], atol=0.15)
    assert at[0] == 0
    np.testing.assert_allclose(np.diff(at), NS_PER_S / GRID_HZ, atol=2)


@settings(max_examples=30, deadline=None)
@given(cuts=cuts_of(N), rate_hz=st.sampled_from([6.0, 31.7, 400.0]))
def test_parts_give_exactly_the_grid_of_the_whole(cuts, rate_hz):
    x = np.random.default_rng(1).normal(9.8, 1, (3, N))
    for whole, cut in zip(gridded(x, rate_hz), gridded(x, rate_hz, cuts), strict=True):
        np.testing.assert_array_equal(whole, cut)


@settings(max_examples=30, deadline=None)
@given(cuts=cuts_of(N))
def test_parts_give_exactly_the_filtered_signal_of_the_whole(cuts):
    x = np.random.default_rng(2).normal(0, 1, (2, N))
    whole, parted = CentredFilter(gaussian(0.4)), CentredFilter(gaussian(0.4))
    parts = [parted(part) for part in np.split(x, sorted(cuts), axis=1)]
    np.testing.assert_array_equal(
        np.concatenate([*parts, parted.flush()], axis=1),
        np.concatenate([whole(x), whole.flush()], axis=1),
    )


def test_a_centred_filter_delays_nothing_and_holds_the_ends():
    impulse = np.zeros((1, 81))
    impulse[0, 40] = 1.0
    smoother = CentredFilter(gaussian(0.1))
    y = np.concatenate([smoother(impulse), smoother.flush()], axis=1)
    assert y.shape == impulse.shape
    assert np.argmax(y) == 40
    level = CentredFilter(gaussian(0.1))
    y = np.concatenate([level(np.full((1, 9), 5.0)), level.flush()], axis=1)
    np.testing.assert_allclose(y, 5.0)


def test_what_never_came_has_no_end():
    assert CentredFilter(gaussian(0.1)).flush().shape == (1, 0)
    assert Gravity().flush()[0].shape == (1, 0)
    grid = UniformResampler(50.0, 3.5)
    assert grid(np.empty(0, np.int64), np.empty((3, 0))).values.shape == (3, 0)
    assert grid.flush().values.shape == (3, 0)


def test_gravity_is_found_under_the_movement_and_up_is_along_it():
    t = np.arange(400) / GRID_HZ
    down = np.array([0.6, 0.0, 0.8])
    up = 9.81 + 2 * np.sin(2 * np.pi * 1.8 * t)
    side = np.array([0.8, 0.0, -0.6])[:, None] * np.sin(2 * np.pi * 0.9 * t)
    gravity = Gravity()
    force = down[:, None] * up + side
    parts = [gravity(force), gravity.flush()]
    upward = np.concatenate([along(*part) for part in parts], axis=1)
    np.testing.assert_allclose(upward[0, 100:-100], up[100:-100], atol=0.02)
    assert not along(np.ones((3, 4)), np.zeros((3, 4))).any()


def waved(period_s, *harmonics):
    """Eight seconds of a periodic signal, amplitudes of its harmonics given."""
    phase = 2 * np.pi * np.arange(320) / GRID_HZ / period_s
    return sum(a * np.sin(k * phase + k) for k, a in enumerate(harmonics, 1))


@pytest.mark.parametrize("step_s", [0.38, 0.43, 0.55, 0.7, 0.8, 0.95, 1.1])
def test_a_rhythm_is_its_step_however_fast_or_slow(step_s):
    strength, found_s = repetition(waved(step_s, 1.0, 0.4), 2)
    assert strength > 0.9
    assert found_s == pytest.approx(step_s, abs=1 / GRID_HZ)


@pytest.mark.parametrize("step_s", [0.38, 0.43, 0.55, 0.6])
@pytest.mark.parametrize("one_foot", [0.3, 1.0, 1.5])
def test_a_stride_of_unequal_feet_is_two_steps(step_s, one_foot):
    strength, found_s = repetition(waved(2 * step_s, one_foot, 1.0), 2)
    assert strength > 0.9
    assert found_s == pytest.approx(step_s, abs=1 / GRID_HZ)


def test_noise_has_no_rhythm_and_silence_none_at_all():
    rng = np.random.default_rng(4)
    strengths = [repetition(rng.normal(0, 1, 320), 2)[0] for _ in range(50)]
    assert np.median(strengths) < 0.2
    assert repetition(np.zeros(320), 2)[0] <= 0


@pytest.mark.parametrize("ahead_s", [0.0, 2.0, 6.0, 20.0])
def test_every_hop_gets_its_rhythm_once_however_far_it_looks(ahead_s):
    wave = np.sin(2 * np.pi * np.arange(1003) / GRID_HZ / 0.55)[None, :]
    scales = (Scale(4.0, 2), Scale(8.0, 2))
    whole, parted = Rhythm(scales, ahead_s), Rhythm(scales, ahead_s)
    at_once = np.concatenate([whole(wave), whole.flush()], axis=1)
    parts = [parted(wave[:, i : i + 37]) for i in range(0, 1003, 37)]
    np.testing.assert_array_equal(at_once, np.concatenate([*parts, parted.flush()], axis=1))
    assert at_once.shape == (3, -(-1003 // HOP) + 1)
    assert at_once[0].min() > 0.9


def test_what_is_kept_is_found_by_its_place():
    kept = ColumnBuffer(2)
    kept.add(np.arange(10.0).reshape(2, 5))
    kept.discard_before(3)
    kept.add(np.array([[7.0], [8.0]]))
    assert (kept.first, kept.end) == (3, 6)
    np.testing.assert_array_equal(kept.between(4, 9), [[4.0, 7.0], [9.0, 8.0]])
