"""The loops of inertial navigation against straight numpy.

With ``NUMBA_DISABLE_JIT=1`` they run as the plain Python that they are written in.
"""

from __future__ import annotations

import itertools

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
    rotated,
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
RECORDS = ("STATE", "FRAME", "SETTINGS")


def samples_of(rng, count):
    field, unseen = rng.normal(0, 3e-5, (count, 3)), rng.uniform(0, 1e-4, (count, 6))
    rate, force = rng.normal(0, 2, (count, 3)), rng.normal(0, 5, (count, 3))
    return Samples(np.arange(count), rate, force, field, unseen)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 12))
def test_a_frame_is_the_mean_of_its_turned_samples(seed, count):
    rng = np.random.default_rng(seed)
    samples, bias, dt, delay_s = samples_of(rng, count), rng.normal(0, 0.01, 3), 0.01, 0.004
    frame = frame_of(samples, dt, bias, delay_s)
    rate = samples.rate - bias
    turns = running_products(of_vectors(rate * dt))
    middles = product(turns, of_vectors(-0.5 * dt * rate))
    prompt = rotated(of_vectors(-delay_s * rate), samples.field)
    still, moved = rotated(middles, prompt), rotated(middles, crossed(rate, prompt))
    moved = moved - moved.mean(axis=0)
    xy = float(np.sum(moved * (still - still.mean(axis=0))))
    for found, expected in (
        (frame.turns, turns),
        (frame.record["mean_turn"], mean_matrix(middles)),
        (frame.record["force"], rotated(middles, samples.force).mean(axis=0)),
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


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 12), st.booleans())
def test_what_a_field_is_tested_by_is_what_numpy_says(seed, count, doubted):
    rng = np.random.default_rng(seed)
    state, frame, p = (np.zeros((), getattr(kernels.attitude, x)) for x in RECORDS)
    north, up = state["earth_field"] = 2e-5, -4.5e-5
    state["hard_iron"], state["clean_iron"] = rng.normal(0, 1e-6, (2, 3))
    state["doubted"], state["covariance"][2, 2] = doubted, 1e-4
    p["drift_factor"], p["deviation_frames"], p["derivative_frames"] = 2.0, 5, 3
    frame["earth_turn"] = matrix(normalised(rng.normal(size=4)))
    frame["earth_field"] = rng.normal(0, 3e-5, 3)
    norms, azimuths = rng.normal(5e-5, 1e-6, count), rng.normal(0, 0.1, count)
    iron = state["clean_iron"] if doubted else state["hard_iron"]
    x, y, z = field = frame["earth_field"] - frame["earth_turn"] @ iron
    kernels.attitude.field_tests(state[()], frame[()], norms, azimuths, 0.1, p[()])
    assert norms[-1] == pytest.approx(np.linalg.norm(field), rel=1e-12)
    assert azimuths[-1] == pytest.approx(np.arctan2(x, y), rel=1e-12)
    left = np.sign(azimuths[-1]) * max(abs(azimuths[-1]) - 2.0 * 0.01, 0.0)
    flat, seen = np.hypot(x, y), azimuths[-3:]
    expected = [
        np.hypot(np.hypot(flat * np.sin(left), flat * np.cos(left) - north), z - up) * 1e6,
        abs(norms[-1] - np.hypot(north, up)) * 1e6,
        norms[-5:].std() * 1e6,
        abs(flat - north) * 1e6,
        abs(np.degrees(left)),
        abs(np.degrees(np.angle(np.exp(1j * (seen[-1] - seen[0]))))) / (len(seen) * 0.1),
        abs(np.degrees(np.arctan2(-z, flat) - np.arctan2(-up, north))),
        0.0,
    ]
    np.testing.assert_allclose(frame["tests"], expected, rtol=1e-6, atol=1e-9)


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
    forces = rotated(turns, segment.force - pose.force_bias)
    pushes = 0.5 * (forces[1:] + forces[:-1]) * dt
    pushes[:, 2] -= G0_MPS2 * segment.interval_s
    gained = pushes.cumsum(axis=0)
    place = pose.position + ((pose.velocity + gained - 0.5 * pushes) * dt).sum(axis=0)
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
    lasts_s, nothing = float(interval.sum()), np.full(3, np.nan)
    segment = Segment(
        0, interval, rate, force, nothing, 0.0, 0.0, lasts_s, np.zeros(3), np.zeros(6), 0.0
    )
    step = integrate(pose, segment)
    orientation, velocity, place, transition = plain_step(pose, segment)
    np.testing.assert_allclose(step.pose.orientation, orientation, atol=1e-12)
    np.testing.assert_allclose(step.pose.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(step.pose.position, place, atol=1e-12)
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


def held_at_a_limit(rate, most):
    """What was missed, and for how long, at the sample after each run at a limit known before."""
    missed, held = np.zeros(rate.shape), np.zeros(len(rate))
    for k, sign in itertools.product(range(3), (1, -1)):
        x, i = sign * rate[:, k], 1
        while i < len(x):
            n = 0
            while i + n < len(x) and x[i + n] >= 0.985 * most:
                n += 1
            if n >= 3 and i + n < len(x):
                a, b = x[i] - x[i - 1], x[i + n - 1] - x[i + n]
                if min(a, b) * n >= 3 * 4 * 0.015 * most:
                    missed[i + n, k] += sign * n * n / 3 * a * b / (a + b)
                    held[i + n] = max(held[i + n], n)
            i += n + 1
    return missed, held


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 40))
def test_turns_missed_at_a_limit_are_those_of_parabolas_over_it(seed, cut):
    rng = np.random.default_rng(seed)
    at = np.arange(400) / 200
    true = rng.uniform(3, 16, 3) * np.sin(2 * np.pi * np.outer(at, rng.uniform(0.5, 4, 3)))
    rate = np.clip(true, -8.0, 8.0)
    rate[0], rate[1], rate[2] = -8.0, 8.0, 0.0  # the limits are known
    state = np.zeros((), kernels.navigation.PLATEAUS)
    missed, held = np.empty((2, 400, 3)), np.empty((2, 400))
    for part in (slice(0, cut), slice(cut, 400)):  # over blocks
        given_ = (np.ascontiguousarray(rate[part]), state[()], 0.015, 3, 3.0)
        kernels.navigation.plateaus(*given_, missed[0, part], held[0, part])
    missed[1], held[1] = held_at_a_limit(rate, 8.0)
    np.testing.assert_allclose(missed[0], missed[1], atol=1e-12)
    np.testing.assert_array_equal(held[0], held[1])
    # what a sine has over its limit is about a parabola
    over = np.abs(true).sum() - np.abs(rate[3:]).sum()
    assert np.abs(missed[0]).sum() < 2.0 * over + 10.0


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_what_a_gyroscope_missed_turns_the_pose_and_makes_it_less_sure(seed):
    rng = np.random.default_rng(seed)
    foot = ErrorStateFilter(SensorNoise(), normalised(rng.normal(size=4)))
    before, start = foot.covariance, foot.pose.orientation
    missed = rng.normal(0, 0.2, 3)
    kernels.navigation.add_missed_turn(foot.state[()], missed, 0.5, 2.0)
    axes = matrix(start)
    spread = axes @ np.diag((2.0 * missed) ** 2) @ axes.T
    np.testing.assert_allclose((foot.covariance - before)[:3, :3], spread, atol=1e-12)
    np.testing.assert_allclose((foot.covariance - before)[3:], 0.0, atol=1e-12)
    expected = product(start, of_vectors(0.5 * missed[None])[0])
    np.testing.assert_allclose(foot.pose.orientation, expected, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_what_was_not_seen_makes_turn_and_velocity_less_sure(seed):
    rng = np.random.default_rng(seed)
    foot = ErrorStateFilter(SensorNoise(), normalised(rng.normal(size=4)))
    before, start, unseen = foot.covariance, foot.pose, rng.uniform(0, 0.2, 6)
    kernels.navigation.add_unseen_motion(foot.state[()], unseen)
    axes, spread = matrix(start.orientation), np.zeros((15, 15))
    spread[:3, :3] = axes @ np.diag(unseen[:3]) @ axes.T
    spread[3:6, 3:6] = axes @ np.diag(unseen[3:]) @ axes.T
    np.testing.assert_allclose(foot.covariance - before, spread, atol=1e-12)
    np.testing.assert_array_equal(foot.pose.row, start.row)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.01, 3.0))
def test_a_filter_in_doubt_is_as_much_less_sure_as_it_was_off(seed, sigma):
    rng = np.random.default_rng(seed)
    foot = ErrorStateFilter(SensorNoise(), normalised(rng.normal(size=4)))
    foot.pose = Pose(foot.pose.orientation, *rng.normal(0, 2, (4, 3)))
    foot.covariance = before = covariance_of(rng, 15)
    excess = max(foot.still(sigma).distance ** 2 / 3, 1.0)
    kernels.navigation.doubt(foot.state[()], sigma)
    np.testing.assert_allclose(foot.covariance, excess * before, rtol=1e-9)
    seen, pose = foot.still(sigma), foot.pose
    kernels.navigation.speed_update(foot.state[()], sigma)
    gain = np.linalg.solve(seen.spread, seen.pick @ (excess * before)).T
    np.testing.assert_allclose(foot.pose.row[4:], pose.moved(gain @ seen.value).row[4:], atol=1e-9)


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


def foot_knots(rng, count):
    """Knots of a foot: as predicted, as measured, and how errors go from one to the next."""
    knots, covariance = np.zeros(count, kernels.navigation.KNOT), covariance_of(rng, 15)
    for knot in knots:
        step = np.eye(15) + 0.05 * rng.normal(size=(15, 15))
        predicted = step @ covariance @ step.T + 0.01 * np.eye(15)
        covariance = 0.5 * predicted
        knot["transition"], knot["predicted_covariance"] = step, predicted
        knot["covariance"] = covariance
        knot["pose"] = rng.normal(size=16)
        knot["pose"][:4] = normalised(knot["pose"][:4])
        knot["predicted"] = knot["pose"] + 0.1 * rng.normal(size=16)
        # what is measured turns little
        turn = of_vectors(0.01 * rng.normal(size=(1, 3)))[0]
        knot["predicted"][:4] = product(turn, knot["pose"][:4])
    return knots


def smooth_foot(knots):
    """Smooth all but the last; return poses, planar covariances and the covariance of the first."""
    state, last = np.zeros((), kernels.navigation.STATE), knots[-1]
    state["pose"], state["covariance"] = last["pose"], last["covariance"]
    poses, planar = np.empty((len(knots) - 1, 16)), np.empty((len(knots) - 1, 3))
    kernels.navigation.smooth(knots[:-1], last, state[()], poses, planar)
    return poses, planar, state["covariance"]


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(2, 5))
def test_a_foot_is_smoothed_as_by_inverses(seed, count):
    knots = foot_knots(np.random.default_rng(seed), count)
    poses, planar, first = smooth_foot(knots)
    pose, spread = knots["pose"][-1], knots["covariance"][-1]
    for i in range(count - 2, -1, -1):
        knot, later = knots[i], knots[i + 1]
        wide = later["predicted_covariance"]
        gain = knot["covariance"] @ later["transition"].T @ np.linalg.inv(wide)
        turned_by = product(pose[:4], later["predicted"][:4] * [1, -1, -1, -1])
        error = np.concatenate([2 * turned_by[1:], pose[4:] - later["predicted"][4:]])
        error[:3] *= np.sign(turned_by[0])
        change = gain @ error
        spread = knot["covariance"] + gain @ (spread - wide) @ gain.T
        turn = product(of_vectors(change[None, :3])[0], knot["pose"][:4])
        pose = np.concatenate([turn, knot["pose"][4:] + change[3:]])
        np.testing.assert_allclose(poses[i], pose, rtol=1e-6, atol=1e-6)
        flat = [spread[6, 6], spread[6, 7], spread[7, 7]]
        np.testing.assert_allclose(planar[i], flat, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(first, spread, rtol=1e-6, atol=1e-6)


def test_a_foot_whose_covariance_is_zero_is_smoothed_to_where_it_was():
    knots = foot_knots(np.random.default_rng(0), 3)
    knots["covariance"] = knots["predicted_covariance"] = 0.0
    poses, planar, _ = smooth_foot(knots)
    np.testing.assert_allclose(poses, knots["pose"][:-1], atol=1e-12)
    assert not planar.any()


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 80))
def test_what_a_step_shows_is_what_numpy_says(seed, count):
    rng = np.random.default_rng(seed)
    orientation = normalised(rng.normal(size=(count, 4)))
    force, axis = rng.normal(size=(count, 3)), rng.normal(size=3)
    x, y, _ = rotated(orientation, axis).T
    heading = kernels.strides.mean_heading(orientation, axis)
    assert heading == pytest.approx(np.unwrap(np.arctan2(y, x)).mean(), abs=1e-9)
    values, parts = np.empty((3, count)), np.empty((3, 2))
    kernels.strides.resolve(orientation, force, axis, values)
    ahead = (x * force[:, 0] + y * force[:, 1]) / np.hypot(x, y)
    right = (y * force[:, 0] - x * force[:, 1]) / np.hypot(x, y)
    np.testing.assert_allclose(values, [ahead, right, force[:, 2]], atol=1e-9)
    phase = rng.uniform(-1.5, 1.5, count)
    kernels.strides.swing(values, phase, parts)
    inside = (phase >= -1) & (phase < 1)
    expected = values[:, inside] @ np.exp(-2j * np.pi * phase[inside])
    np.testing.assert_allclose(parts @ [1, 1j], expected, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 80))
def test_the_shape_of_a_step_is_that_of_its_integrals(seed, count):
    rng = np.random.default_rng(seed)
    force, time_ns = rng.normal(size=(count, 3)), np.arange(count) * 10_000_000
    found = kernels.strides.shape(time_ns, force, 50_000_000, 0.1, 10**9, np.empty((2, count)))
    smooth = np.convolve(force[:, 2], np.full(10, 0.1))[4:][:count]
    inner = smooth[5 : count - 5] if count >= 13 else smooth
    speed = np.cumsum(inner - inner.mean()) * 0.01
    height = np.cumsum(speed - speed.mean()) * 0.01
    top = int(inner.argmax())
    ended = int(inner[top:].argmin()) * 0.01
    np.testing.assert_allclose(found, (np.ptp(inner), np.ptp(height), ended), atol=1e-12)


def test_a_shape_of_no_numbers_is_none():
    given_ = (50_000_000, 0.1, 10**9, np.empty((2, 5)))
    still = kernels.strides.shape(np.arange(5) * 10_000_000, np.full((5, 3), np.nan), *given_)
    assert np.isnan(still[:2]).all()


def test_a_state_that_is_known_exactly_stays_so_in_smoothing():
    knots = np.zeros(3, kernels.reckoning.KNOT)
    knots["transition"] = np.eye(6)
    kernels.reckoning.smooth(knots, np.empty((6, 6, 6)))
    assert not knots["state"].any()
    assert not knots["covariance"].any()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # as plain Python, numpy's numbers warn
@pytest.mark.parametrize("hostile", [np.nan, np.inf])
def test_a_covariance_that_is_no_number_ends_no_update(hostile):
    state = np.zeros((), kernels.attitude.STATE)
    state["covariance"], state["seen"] = np.diag(np.full(14, hostile)), np.eye(14)[:3]
    kernels.attitude.measurement_update(state[()], (0.0, 0.0, 0.0), 1.0, np.zeros(14, np.bool_))
    assert not np.isfinite(state["covariance"]).all()


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_what_lines_hide_is_added_in_the_earth_s_axes(seed):
    """P = F P F' + Q, and R diag(turn) R' and R diag(velocity) R' besides."""
    rng, found = np.random.default_rng(seed), []
    unseen, before = rng.uniform(0, 1e-3, 6), covariance_of(rng, 14)
    orientation = normalised(rng.normal(size=4))
    for part in (np.zeros(6), unseen):
        state = np.zeros((), kernels.attitude.STATE)
        frame, p = (np.zeros((), getattr(kernels.attitude, name)) for name in RECORDS[1:])
        state["orientation"], state["covariance"] = orientation, before
        frame["mean_turn"], frame["force"], frame["unseen"] = np.eye(3), (0.1, 0.2, 9.8), part
        kernels.attitude.propagate(state[()], frame[()], (1.0, 0.0, 0.0, 0.0), 0.1, p[()])
        found.append(np.array(state["covariance"]))
    axes = matrix(orientation)
    expected = np.zeros((14, 14))
    for first in (0, 3):
        rows = slice(first, first + 3)
        expected[rows, rows] = axes @ np.diag(unseen[rows]) @ axes.T
    np.testing.assert_allclose(found[1] - found[0], expected, atol=1e-12)
