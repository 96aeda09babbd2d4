"""What is done with each step and frame, against the plain forms that it is a faster way of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_rotations import of_vectors, running_products, skew

from groundtrace.dsp.periodicity import _CLIP, Rhythm, Scale
from groundtrace.inertial.attitude import Attitude, AttitudeNoise
from groundtrace.inertial.frames import Samples, frame_of
from groundtrace.inertial.rotations import (
    crossed,
    headings_of,
    matrix,
    mean_matrix,
    normalised,
    product,
    turned,
)
from groundtrace.inertial.strapdown import (
    ErrorStateFilter,
    Pose,
    Segment,
    SensorNoise,
    integrate,
)
from groundtrace.kernels.grid import TOGETHER
from groundtrace.kernels.steps import autocorrelation, clip_window
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
from groundtrace_codecs.signals import G0_MPS2

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


def test_a_window_is_correlated_with_itself_as_by_products_of_its_parts():
    rng = np.random.default_rng(0)
    for row in np.sin(np.arange(320) * 0.28) + rng.normal(0, 0.5, (7, 320)):
        limit = _CLIP * np.median(np.abs(row))
        window, found = np.zeros(len(row) + 4 * TOGETHER), np.empty(4 * TOGETHER)
        clip_window(row, limit, window)
        autocorrelation(window, len(row), 100, np.empty(len(row) + 1), found)
        x = np.clip(row, -limit, limit)
        x = x - x.mean()
        products = np.array([x[: len(x) - k] @ x[k:] for k in range(101)])
        energy = np.array([(x[: len(x) - k] ** 2).sum() * (x[k:] ** 2).sum() for k in range(101)])
        np.testing.assert_allclose(found[:101], products / np.sqrt(energy + 1e-9), atol=1e-12)


def test_a_rhythm_does_not_depend_on_how_many_windows_come_at_once():
    signal = np.sin(np.arange(2000) * 0.28)[None, :] + np.random.default_rng(1).normal(0, 0.3, 2000)
    whole, parts = (Rhythm((Scale(4.0, 2), Scale(8.0, 2)), 6.0) for _ in range(2))
    expected = np.concatenate([whole(signal), whole.finish()], axis=1)
    found = [parts(signal[:, at : at + 7]) for at in range(0, 2000, 7)]
    np.testing.assert_array_equal(np.concatenate([*found, parts.finish()], axis=1), expected)


def samples_of(rng, count):
    field = rng.normal(0, 3e-5, (count, 3))
    return Samples(
        np.arange(count), rng.normal(0, 2, (count, 3)), rng.normal(0, 5, (count, 3)), field
    )


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 12))
def test_a_frame_is_the_mean_of_its_turned_samples(seed, count):
    rng = np.random.default_rng(seed)
    samples, bias, dt, delay_s = samples_of(rng, count), rng.normal(0, 0.01, 3), 0.01, 0.004
    frame = frame_of(samples, dt, bias, delay_s)
    rate = samples.rate - bias
    turns = running_products(of_vectors(rate * dt))
    middles = product(turns, of_vectors(-0.5 * dt * rate))
    prompt = turned(of_vectors(-delay_s * rate), samples.field)
    still, moved = turned(middles, prompt), turned(middles, crossed(rate, prompt))
    moved = moved - moved.mean(axis=0)
    xy = float(np.sum(moved * (still - still.mean(axis=0))))
    for found, expected in (
        (frame.turns, turns),
        (frame.mean_turn, mean_matrix(middles)),
        (frame.force, turned(middles, samples.force).mean(axis=0)),
        (frame.field, still.mean(axis=0)),
        (frame.rate, samples.rate.mean(axis=0)),
        (frame.speed, np.sqrt((rate**2).sum() / count)),
        (
            frame.rate_spread,
            np.sqrt(((samples.rate - samples.rate.mean(axis=0)) ** 2).sum() / count),
        ),
        (frame.delay_sums, (xy, float(np.sum(moved * moved)))),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_frame_without_a_field_tells_nothing_of_its_delay():
    samples = samples_of(np.random.default_rng(0), 5)
    frame = frame_of(replace(samples, field=np.full((5, 3), np.nan)), 0.01, np.zeros(3), 0.0)
    assert np.isnan(frame.field).all()
    assert frame.delay_sums == (0.0, 0.0)


def covariance_of(rng, size):
    root = rng.normal(0, 0.1, (size, size))
    return root @ root.T + 1e-3 * np.eye(size)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_an_update_of_the_attitude_is_that_of_matrices(seed):
    rng = np.random.default_rng(seed)
    attitude = Attitude(AttitudeNoise(), covariance=covariance_of(rng, 14))
    before, innovation = attitude.covariance, rng.normal(0, 0.1, 3)
    pick, frozen = rng.normal(size=(3, 14)), rng.random(14) < 0.3
    gain = np.linalg.solve(pick @ before @ pick.T + 0.01 * np.eye(3), pick @ before).T
    gain[frozen] = 0.0
    left = np.eye(14) - gain @ pick
    attitude._update(pick, innovation, 0.01, frozen)
    expected = left @ before @ left.T + 0.01 * gain @ gain.T
    np.testing.assert_allclose(attitude.covariance, expected, atol=1e-12)
    change = gain @ innovation
    np.testing.assert_allclose(attitude.bias, change[6:9], atol=1e-12)


def plain_step(pose, segment):
    """Strapdown over a segment: orientation, velocity, place, and the transition."""
    dt = segment.interval_s[:, None]
    rate = segment.rate - pose.gyro_bias
    angles = 0.5 * (rate[1:] + rate[:-1]) * dt
    turns = product(pose.orientation, running_products(of_vectors(angles)))
    turns = np.concatenate([pose.orientation[None], turns])
    forces = turned(turns, segment.force - pose.force_bias)
    pushes = 0.5 * (forces[1:] + forces[:-1]) * dt
    pushes[:, 2] -= G0_MPS2 * segment.interval_s
    gained = pushes.cumsum(axis=0)
    place = pose.place + ((pose.velocity + gained - 0.5 * pushes) * dt).sum(axis=0)
    length = segment.length_s
    axes = matrix(normalised(0.5 * (turns[0] + turns[-1]))) * length
    force = skew(gained[-1] + np.array([0.0, 0.0, G0_MPS2 * length]))
    out = np.eye(15)
    out[0:3, 9:12], out[3:6, 0:3], out[3:6, 12:15] = -axes, -force, -axes
    out[3:6, 9:12], out[6:9, 3:6] = 0.5 * force @ axes, length * np.eye(3)
    out[6:9, 0:3], out[6:9, 12:15] = -0.5 * length * force, -0.5 * length * axes
    out[6:9, 9:12] = length / 3 * out[3:6, 9:12]
    return turns[-1], pose.velocity + gained[-1], place, out


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 8))
def test_a_segment_of_a_foot_is_integrated_and_its_error_carried_as_by_matrices(seed, count):
    rng = np.random.default_rng(seed)
    pose = Pose(normalised(rng.normal(size=4)), *rng.normal(0, 0.1, (4, 3)))
    interval = rng.uniform(0.005, 0.015, count)
    rate, force = rng.normal(0, 3, (count + 1, 3)), rng.normal(0, 10, (count + 1, 3))
    segment = Segment(0, interval, rate, force, np.full(3, np.nan), 0.0, 0.0, float(interval.sum()))
    step = integrate(pose, segment)
    orientation, velocity, place, transition = plain_step(pose, segment)
    np.testing.assert_allclose(step.pose.orientation, orientation, atol=1e-12)
    np.testing.assert_allclose(step.pose.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(step.pose.place, place, atol=1e-12)
    np.testing.assert_allclose(step.transition, transition, atol=1e-12)
    foot = ErrorStateFilter(SensorNoise(), pose.orientation)
    foot.pose, foot.covariance = pose, covariance_of(rng, 15)
    carried = transition @ foot.covariance @ transition.T
    foot.predict(segment)
    off = foot.covariance - carried
    np.testing.assert_allclose(off - np.diag(np.diag(off)), 0.0, atol=1e-12)
    before, seen = foot.covariance, foot.still(0.05)
    gain = np.linalg.solve(seen.spread, seen.pick @ before).T
    foot.update(seen)
    expected = before - gain @ seen.spread @ gain.T
    np.testing.assert_allclose(foot.covariance, expected, atol=1e-11)


def test_headings_of_a_frame_are_those_of_its_orientations():
    from groundtrace.kernels.attitude import headings

    rng = np.random.default_rng(0)
    start, turns = normalised(rng.normal(size=4)), normalised(rng.normal(size=(6, 4)))
    orientation, heading = headings(start, turns, np.array([0.0, 1.0, 0.0]))
    assert orientation == pytest.approx(product(start, turns), abs=1e-12)
    assert heading == pytest.approx(headings_of(product(start, turns), np.eye(3)[1]), abs=1e-12)
