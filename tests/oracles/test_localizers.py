"""What localizers do with each step, against the plain forms that it is a faster way of."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtrace.localizers import amplitudes
from groundtrace.localizers.gcc_phat import (
    MISFIT_S,
    ONSET,
    PASSES,
    Band,
    Delays,
    GccPhat,
    OnsetSeparation,
    consistent,
    correlated,
)
from groundtrace.localizers.tdoa import Model, losses
from groundtrace.pipeline.gates import Candidates, GateState

seeds = st.integers(0, 2**32 - 1)


def plain_line(u, t, weight, slope):
    """t - t0 - k u with the best t0 and k under weights."""
    whole = weight.sum(axis=-2)
    u_mean, t_mean = (weight * u).sum(axis=-2) / whole, (weight * t).sum(axis=-2) / whole
    k = np.full_like(u_mean, slope or 0.0)
    if slope is None:
        square = (weight * u * u).sum(axis=-2) - whole * u_mean**2
        along = (weight * u * t).sum(axis=-2) - whole * u_mean * t_mean
        k = np.maximum(along / np.maximum(square, np.finfo(float).tiny), 0.0)
    return t - k[..., None, :] * u - (t_mean - k * u_mean)[..., None, :]


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 16), st.integers(1, 150), st.sampled_from([None, 1e-3]), st.booleans())
def test_losses_of_a_lattice_are_those_of_reweighted_lines(seed, sensors, nodes, slope, own):
    rng = np.random.default_rng(seed)
    times = rng.uniform(0, 0.02, (2, sensors))
    u = rng.uniform(0.1, 12, (2, sensors, nodes) if own else (sensors, nodes))
    threshold, t = 5e-4, times[..., None]
    left = plain_line(u, t, np.ones_like(t * u), slope)
    for _ in range(2):
        left = plain_line(u, t, threshold / np.maximum(np.abs(left), threshold), slope)
    inner = np.minimum(np.abs(left), threshold)
    expected = (inner * (2 * np.abs(left) - inner)).mean(axis=-2)
    found = losses(u, times, Model(1.0, slope, threshold))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-18)


def plain_student(left, variance, bound):
    """Log likelihood about the best level by Student's law; what is a bound that holds is mute."""
    level = left.mean(axis=-2, keepdims=True)
    for _ in range(amplitudes.PASSES):
        off = left - level
        weight = 1 / (amplitudes.FREEDOM * variance + off * off)
        weight = np.where(bound & (off < 0), 0.0, weight)
        whole = np.maximum(weight.sum(axis=-2, keepdims=True), 1e-12)
        level = level + (weight * off).sum(axis=-2, keepdims=True) / whole
    off = np.where(bound & (left < level), 0.0, left - level)
    tails = np.log(1 + off * off / (amplitudes.FREEDOM * variance)).sum(axis=-2)
    scale = np.log(variance).sum(axis=-2) + np.log(whole[..., 0, :])
    return -((amplitudes.FREEDOM + 1) * tails + scale) / 2


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 16), st.integers(1, 150), st.booleans())
def test_likelihoods_of_floors_are_those_of_students_law(seed, sensors, nodes, clips):
    rng = np.random.default_rng(seed)
    times, distance = rng.uniform(0, 0.02, sensors), rng.uniform(0.15, 12, (sensors, nodes))
    pace, constant, part = amplitudes.BY_TIME[:9].T[..., None, None]
    travel = pace * distance
    none = np.zeros((sensors, 1), bool)
    expected = plain_student(times[:, None] - travel, constant**2 + (part * travel) ** 2, none)
    found = amplitudes.time_logs(times, distance, amplitudes.BY_TIME[:9])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    heights, clipped = rng.normal(0, 2, sensors), rng.random(sensors) < 0.4 * clips
    decay, spread = amplitudes.BY_HEIGHT[:9].T[..., None, None]
    left = heights[:, None] + decay * np.log(distance)
    expected = plain_student(left, np.broadcast_to(spread**2, left.shape), clipped[:, None])
    found = amplitudes.height_logs(heights, clipped, np.log(distance), amplitudes.BY_HEIGHT[:9])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(seeds, st.integers(3, 12))
def test_delays_of_pairs_are_where_the_whole_correlation_is_highest(seed, channels):
    rng = np.random.default_rng(seed)
    band = Band.of(400, 8000.0, 20.0, 2000.0, 0.5)
    shape = (channels, len(band.turn))
    white = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    farthest_s = np.full((channels, channels), 0.02)
    found = correlated(white, band, farthest_s)
    first, second = np.triu_indices(channels, 1)
    step = 2 * np.pi / (8 * band.turn[-1])
    grid = np.arange(-int(np.ceil(0.02 / step)), int(np.ceil(0.02 / step)) + 1) * step
    steering = np.exp(1j * np.multiply.outer(band.turn, grid))
    rows = ((white[first] * np.conj(white[second])) @ steering).real
    assert np.abs(found.delay_s - grid[rows.argmax(axis=1)]).max() <= step


def plain_consistent(delays, channels):
    """Least squares of a matrix with a row for each pair."""
    rows = np.arange(len(delays.first))
    design = np.zeros((len(rows), channels))
    design[rows, delays.first], design[rows, delays.second] = 1, -1
    weight = delays.weight + 1e-9 * delays.weight.max()
    trust = np.ones(len(rows))
    for _ in range(PASSES):
        share = weight * trust / weight.max()
        normal = design.T @ (design * share[:, None]) + share.mean()
        arrivals = np.linalg.solve(normal, design.T @ (share * delays.delay_s))
        misfit = design @ arrivals - delays.delay_s
        trust = 1 / (1 + (misfit / MISFIT_S) ** 2)
    return arrivals, misfit


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 16))
def test_arrivals_that_agree_best_are_those_of_the_equations_of_all_pairs(seed, channels):
    rng = np.random.default_rng(seed)
    first, second = np.triu_indices(channels, 1)
    true = rng.normal(0, 5e-3, channels)
    late = true[first] - true[second] + rng.normal(0, 2e-4, len(first))
    weight = rng.uniform(0.1, 1, len(first))
    delays = Delays(first, second, late, weight, weight)
    for found, expected in zip(
        consistent(delays, channels), plain_consistent(delays, channels), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(0, 60))
def test_the_nearest_arrival_is_the_nearest_of_its_channel_that_stands(seed, count):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.integers(0, 40, count)) * 10_000_000
    value = np.zeros((count, len(GccPhat.columns)), np.float32)
    value[:, ONSET] = rng.integers(0, 2, count)
    channel, alive = rng.integers(0, 3, count).astype(np.int32), rng.random(count) < 0.6
    found = OnsetSeparation().values(
        Candidates(times, channel, value), GccPhat.columns, alive, 0.1, GateState()
    )
    for row in range(count):
        standing = (channel == channel[row]) & alive & (value[:, ONSET] == 0)
        apart = np.abs(times[standing] - times[row]) / 1e9
        assert found[row] == (apart.min(initial=np.inf) if value[row, ONSET] else np.inf)
