"""The heading estimator on a sensor whose orientation is known."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from turning_sensor import RATE_HZ, Turning, errors_deg, run, turning

from groundtrace.inertial.attitude import HeadingParameters
from groundtrace.inertial.frames import Samples
from groundtrace.inertial.heading import HeadingEstimator, QuietSeconds
from groundtrace.inertial.magnetometer import COLUMNS
from groundtrace.inertial.rotations import headings_of
from groundtrace_codecs.signals import NS_PER_S

#: The columns that are headings by one kind of sensor.
SOURCES = ("gyroscope", "compass")


def rmse(errors: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


@pytest.mark.parametrize("kind", ["error-state", "exponential", "kalman"])
def test_every_filter_finds_the_heading_in_an_undisturbed_field(kind: str) -> None:
    case = turning()
    found = run(case, HeadingParameters(filter=kind))  # type: ignore[arg-type]
    assert rmse(errors_deg(case, found)) < 1.5
    assert not found.disturbed.any()


def test_the_standard_deviation_covers_the_errors() -> None:
    case = turning()
    found = run(case)
    normalised = (np.radians(errors_deg(case, found)) / found.sigma) ** 2
    assert np.nanmean(normalised) < 2


@pytest.mark.parametrize("portions", [1, 7, 200])
def test_portions_of_any_size_give_exactly_the_same(portions: int) -> None:
    case = turning(12.0)
    whole, cut = run(case), run(case, portions=portions)
    assert np.array_equal(whole.heading, cut.heading)
    assert np.array_equal(whole.sigma, cut.sigma)
    assert np.array_equal(whole.disturbed, cut.disturbed)


def test_a_copy_made_in_the_middle_goes_on_as_the_original() -> None:
    samples = turning(12.0).samples
    one = HeadingEstimator(HeadingParameters(), RATE_HZ)
    one.add(samples.rows(0, 605))
    other = copy.deepcopy(one)
    rest = samples.rows(605, len(samples))
    for a, b in zip(one.add(rest), other.add(rest), strict=True):
        assert np.array_equal(a.orientation, b.orientation)


def test_the_bias_of_the_gyroscope_is_found_at_rest() -> None:
    estimator = HeadingEstimator(HeadingParameters(), RATE_HZ)
    frames = estimator.add(turning(10.0, rest_s=10.0).samples)
    assert frames[-1].resting
    assert frames[-1].bias == pytest.approx([0.004, -0.003, 0.005], abs=5e-4)


def test_what_comes_later_changes_nothing_of_what_was_said() -> None:
    case = turning(20.0)
    early = run(replace(case, samples=case.samples.rows(0, 1000)))
    assert np.array_equal(early.heading, run(case).heading[:1000])


def test_a_magnet_on_the_sensor_is_disturbance_for_as_long_as_it_is_there() -> None:
    case = turning().attached((20, -10, 12), 20.0, 45.0)
    found = run(case)
    on = (case.seconds >= 20) & (case.seconds < 45)
    assert found.disturbed[on].mean() > 0.98
    assert found.disturbed[~on].mean() < 0.03
    assert rmse(errors_deg(case, found)) < 2.0


def test_behind_a_magnet_on_the_sensor_the_compass_goes_on() -> None:
    case = turning(120.0).attached((20, -10, 12), 20.0, 110.0)
    drifting = replace(
        case, samples=replace(case.samples, rate=case.samples.rate + np.array([0, 0, 0.0]))
    )
    # a gyroscope with wrong scale drifts while it turns, unless the compass holds it
    drifting = replace(
        drifting, samples=replace(drifting.samples, rate=drifting.samples.rate * 1.01)
    )
    learned = run(drifting)
    gyro_only = replace(
        drifting,
        samples=replace(
            drifting.samples,
            field=np.where(((case.seconds > 20) & (case.seconds < 110))[:, None], np.nan,
                           drifting.samples.field),
        ),
    )  # fmt: skip
    assert rmse(errors_deg(case, learned)) < rmse(errors_deg(case, run(gyro_only)))


def test_without_a_field_the_gyroscope_goes_on_and_knows_less_and_less() -> None:
    case = turning(40.0)
    field = np.where((case.seconds > 10)[:, None], np.nan, case.samples.field)
    found = run(replace(case, samples=replace(case.samples, field=field)))
    assert not found.disturbed.any()
    assert rmse(errors_deg(case, found)) < 3.0
    assert found.sigma[-1] > 1.5 * run(case).sigma[-1]


def test_a_magnetometer_that_answers_late_is_found_out() -> None:
    case = turning(40.0)
    estimator = HeadingEstimator(HeadingParameters(), RATE_HZ)
    field = np.roll(case.samples.field, 2, axis=0)
    field[:2] = field[2]
    estimator.add(replace(case.samples, field=field))
    # two samples late, and half a sample as a sample stands for the middle of its interval
    assert estimator.delay_s == pytest.approx(0.015, abs=0.004)


def test_a_reference_taken_beside_a_magnet_is_replaced_when_the_sensor_turned() -> None:
    case = turning(60.0, rest_s=10.0)
    # a magnet beside the place of rest: constant in the earth frame
    back = case.orientation * np.array([1, -1, -1, -1])
    from groundtrace.inertial.rotations import rotated

    beside = rotated(back, np.broadcast_to([14e-6, 3e-6, 6e-6], (len(back), 3)))
    field = case.samples.field + np.where((case.seconds < 10)[:, None], beside, 0.0)
    found = run(replace(case, samples=replace(case.samples, field=field)))
    late = case.seconds > 35
    assert rmse(errors_deg(case, found)[late]) < 2.0
    assert not found.disturbed[late].any()


def alone(case: Turning) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the headings by gyroscope and by compass alone, frame by frame [deg]."""
    estimator = HeadingEstimator(HeadingParameters(), RATE_HZ)
    frames = [*estimator.add(case.samples), *estimator.flush()]
    names = [column.name for column in COLUMNS]
    steep = np.isnan(errors_deg(case, run(case)))
    true = np.degrees(headings_of(case.orientation, np.array([1.0, 0, 0])))
    starts = np.array([int(np.searchsorted(case.samples.time_ns, f.time_ns[0])) for f in frames])
    found = np.array([f.values for f in frames])[:, [names.index(n) for n in SOURCES]]
    off = (found - true[starts, None] + 180) % 360 - 180
    gyroscope, compass = np.where(steep[starts, None], np.nan, off).T
    return gyroscope, compass


def test_the_compass_alone_shows_a_magnet_and_the_gyroscope_alone_does_not() -> None:
    case = turning().attached((20, -10, 12), 20.0, 45.0)
    gyroscope, compass = alone(case)
    seconds = np.arange(len(compass)) * 0.1
    on = (seconds >= 20) & (seconds < 45)
    assert rmse(compass[~on]) < 4.0
    assert rmse(compass[on]) > 20.0
    assert rmse(gyroscope) < 4.0


def test_the_gyroscope_alone_learns_nothing_of_the_compass() -> None:
    case = turning().attached((20, -10, 12), 20.0, 45.0)
    samples = case.samples
    fast = replace(case, samples=replace(samples, rate=samples.rate + np.array([0, 0, 0.003])))
    unrested = replace(fast, samples=fast.samples.rows(600, 6000),
                       orientation=fast.orientation[600:])  # fmt: skip
    gyroscope, _ = alone(unrested)
    # a bias of 0.005 + 0.003 rad/s that no rest has shown: it drifts while the fused heading stays
    assert np.nanmax(np.abs(gyroscope)) > 10.0
    found = run(unrested)
    assert rmse(errors_deg(unrested, found)[found.sigma < np.pi]) < 4.0


#: Of the bias in the sensor's axes.
AXIS = np.array([0.6, -0.6, 0.5])


def held(bias_dps: float, seed: int = 0) -> Samples:
    """Twenty seconds in a hand that stands; its tremor turns the sensor by a third of a degree."""
    count, rng = round(20 * RATE_HZ), np.random.default_rng(seed)
    angle = gaussian_filter1d(rng.standard_normal((count, 3)), RATE_HZ / 5, axis=0)
    angle *= 0.005 / angle.std()
    rate = np.gradient(angle, 1 / RATE_HZ, axis=0) + np.radians(bias_dps) * AXIS
    up = np.array([0.0, 5.6, 8.05])
    force = up + np.cross(up, angle) + rng.normal(0, 0.05, (count, 3))
    time_ns = np.rint(np.arange(count) / RATE_HZ * NS_PER_S).astype(np.int64)
    return Samples(time_ns, rate, force, np.full((count, 3), np.nan), np.zeros((count, 6)))


def test_quiet_seconds_in_a_hand_tell_a_bias_that_no_rest_does() -> None:
    samples = held(4.0)
    estimator = HeadingEstimator(HeadingParameters(), RATE_HZ)
    frames = estimator.add(samples)
    assert not any(frame.resting for frame in frames)
    true = np.radians(4.0) * AXIS
    assert frames[-1].bias == pytest.approx(true, abs=np.radians(0.4))
    (turned,) = estimator.turned_rad2.values()
    assert np.degrees(np.sqrt(turned)).max() > 5  # before, nobody knew
    cut = HeadingEstimator(HeadingParameters(), RATE_HZ)
    parts = [cut.add(samples.rows(at, at + 37)) for at in range(0, len(samples), 37)]
    assert [f for part in parts for f in part][-1].bias.tolist() == frames[-1].bias.tolist()


@pytest.mark.parametrize("seed", range(6))
def test_a_gyroscope_without_a_bias_gets_none_by_a_tremor(seed: int) -> None:
    frames = HeadingEstimator(HeadingParameters(), RATE_HZ).add(held(0.0, seed))
    assert frames[-1].bias == pytest.approx([0, 0, 0], abs=np.radians(0.4))


def test_a_slow_turn_of_some_seconds_is_no_bias() -> None:
    samples = held(0.0)
    turns = (samples.time_ns >= 4 * NS_PER_S) & (samples.time_ns < 8 * NS_PER_S)
    rate = samples.rate + np.radians(8.0) * turns[:, None] * np.array([0.0, 0.57, 0.82])
    frames = HeadingEstimator(HeadingParameters(), RATE_HZ).add(replace(samples, rate=rate))
    assert frames[-1].bias == pytest.approx([0, 0, 0], abs=np.radians(0.5))


def test_a_sample_a_second_is_never_quiet() -> None:
    samples = held(4.0).rows(0, 1)
    quiet = QuietSeconds(1.0)
    assert [x for _ in range(20) for x in quiet.ends(samples)] == []
