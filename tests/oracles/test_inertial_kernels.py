"""The loops of inertial navigation against straight numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_rotations import of_vectors, running_products, skew

from groundtrace import kernels
from groundtrace.inertial.frames import Samples, frame_of
from groundtrace.inertial.rotations import (
    crossed,
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
from groundtrace_codecs.signals import G0_MPS2

seeds = st.integers(0, 2**32 - 1)


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
        (frame.record["mean_turn"], mean_matrix(middles)),
        (frame.record["force"], turned(middles, samples.force).mean(axis=0)),
        (frame.record["field"], still.mean(axis=0)),
        (frame.record["rate"], samples.rate.mean(axis=0)),
        (frame.record["speed"], np.sqrt((rate**2).sum() / count)),
        (
            frame.record["rate_spread"],
            np.sqrt(((samples.rate - samples.rate.mean(axis=0)) ** 2).sum() / count),
        ),
        (frame.record["delay_sums"], (xy, float(np.sum(moved * moved)))),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_sample_without_a_field_leaves_the_frame_without_one():
    samples = samples_of(np.random.default_rng(0), 5)
    samples.field[2] = np.nan
    frame = frame_of(samples, 0.01, np.zeros(3), 0.0)
    assert np.isnan(frame.record["field"]).all()
    assert np.isfinite(frame.record["force"]).all()


def covariance_of(rng, size):
    root = rng.normal(0, 0.1, (size, size))
    return root @ root.T + 1e-3 * np.eye(size)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_an_update_of_the_attitude_is_that_of_matrices(seed):
    rng = np.random.default_rng(seed)
    state = np.zeros((), kernels.attitude.STATE)
    before, innovation = covariance_of(rng, 14), rng.normal(0, 0.1, 3)
    start = normalised(rng.normal(size=4))
    state["covariance"], state["orientation"] = before, start
    pick, frozen = rng.normal(size=(3, 14)), rng.random(14) < 0.3
    gain = np.linalg.solve(pick @ before @ pick.T + 0.01 * np.eye(3), pick @ before).T
    gain[frozen] = 0.0
    left = np.eye(14) - gain @ pick
    state["seen"] = pick
    kernels.attitude.measurement_update(state[()], tuple(innovation.tolist()), 0.01, frozen)
    expected = left @ before @ left.T + 0.01 * gain @ gain.T
    np.testing.assert_allclose(state["covariance"], expected, atol=1e-12)
    change = gain @ innovation
    turned_by = product(of_vectors(change[None, :3])[0], start)
    np.testing.assert_allclose(state["orientation"], turned_by, atol=1e-12)
    names = ("velocity", "gyro_bias", "hard_iron", "earth_field")
    found = np.concatenate([state[name] for name in names])
    np.testing.assert_allclose(found, change[3:], atol=1e-12)


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


def smoothed(covariances, transitions, predicted, states, guesses):
    """Rauch, Tung and Striebel with inverses."""
    states, spreads = states.copy(), covariances.copy()
    for i in range(len(states) - 2, -1, -1):
        gain = covariances[i] @ transitions[i + 1].T @ np.linalg.inv(predicted[i + 1])
        states[i] += gain @ (states[i + 1] - guesses[i + 1])
        spreads[i] += gain @ (spreads[i + 1] - predicted[i + 1]) @ gain.T
    return states, spreads


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 6))
def test_a_reckoned_track_is_smoothed_as_by_inverses(seed, count):
    rng = np.random.default_rng(seed)
    knots = np.zeros(count, kernels.reckoning.KNOT)
    for knot in knots:
        knot["transition"] = np.eye(6) + 0.1 * rng.normal(size=(6, 6))
        knot["covariance"], knot["predicted_covariance"] = (
            scale * covariance_of(rng, 6) for scale in (1.0, 4.0)
        )
        knot["state"], knot["predicted"] = rng.normal(size=(2, 6))
    names = ("covariance", "transition", "predicted_covariance", "state", "predicted")
    states, spreads = smoothed(*(knots[name].copy() for name in names))
    kernels.reckoning.smooth(knots, np.empty((6, 6, 6)))
    np.testing.assert_allclose(knots["state"], states, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(knots["covariance"], spreads, rtol=1e-6, atol=1e-6)


def test_a_state_that_is_known_exactly_stays_so_in_smoothing():
    knots = np.zeros(3, kernels.reckoning.KNOT)
    knots["transition"] = np.eye(6)
    kernels.reckoning.smooth(knots, np.empty((6, 6, 6)))
    assert not knots["state"].any()
    assert not knots["covariance"].any()


@pytest.mark.parametrize("hostile", [np.nan, np.inf])
def test_a_covariance_that_is_no_number_ends_no_update(hostile):
    state = np.zeros((), kernels.attitude.STATE)
    state["covariance"], state["seen"] = np.diag(np.full(14, hostile)), np.eye(14)[:3]
    kernels.attitude.measurement_update(state[()], (0.0, 0.0, 0.0), 1.0, np.zeros(14, np.bool_))
    assert not np.isfinite(state["covariance"]).all()
