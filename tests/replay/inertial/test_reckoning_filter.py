"""The filter and the track of dead reckoning."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundtrace.inertial.pdr_filter import (
    OFFSET,
    PERSISTENCE_S,
    PLACE,
    SCALE,
    MagneticBearing,
    ReckoningFilter,
    ReckoningNoise,
    Stride,
    Track,
    Unheard,
)
from groundtrace.inertial.steps import PositionReference, repeats_of
from groundtrace_codecs.signals import NS_PER_S

NOISE = ReckoningNoise(drift=0.002, mount=0.1, length=0.15, scale=0.1, way=0.1)
SURE = 1e-4


def walker(*, learns: bool = False, offset: float | None = 0.0) -> ReckoningFilter:
    made = ReckoningFilter(NOISE, np.zeros(2), 0.0, learns_scale=learns)
    if offset is not None:
        made.sight(offset, SURE, 1.0)
    return made


def track(filter_: ReckoningFilter, smooth_s: float = 1e6) -> Track:
    return Track(filter_, 0, "track", 1, smooth_s)


def at(step: int) -> int:
    return step * NS_PER_S // 2


def walk(along: Track, count: int, sight: MagneticBearing | None = None, first: int = 1) -> None:
    for k in range(first, first + count):
        along.step(Stride(at(k), 0.7, 0.0, sight, 0.0), 0.0, settled=True)


def test_steps_go_their_length_along_their_azimuth() -> None:
    made = walker()
    for heading in (0.0, math.pi / 2):
        made.step(2.0, heading)
    np.testing.assert_allclose(made.state[PLACE], [2, 2], atol=1e-6)


def test_the_covariance_grows_with_every_step_and_more_across_than_along_an_unsure_azimuth() -> (
    None
):
    made = walker()
    spreads = []
    for _ in range(50):
        made.wait(0.5)
        made.step(0.7, 0.0)
        spreads.append(np.diag(made.covariance)[PLACE].copy())
    assert (np.diff(spreads, axis=0) > 0).all()
    far = 50 * 0.7
    assert spreads[-1][0] == pytest.approx((0.1 * far) ** 2 + 50 * (0.15 * 0.7) ** 2, rel=0.01)
    assert spreads[-1][1] > (0.1 * far) ** 2


def test_the_spread_of_many_simulated_walks_is_what_the_covariance_says() -> None:
    rng = np.random.default_rng(3)
    ends = []
    for _ in range(400):
        mount, scale = 0.1 * rng.standard_normal(), 0.1 * rng.standard_normal()
        length = 0.7 * np.exp(scale) * (1 + 0.15 * rng.standard_normal(40))
        azimuth = mount + 0.1 * rng.standard_normal(40)
        ends.append([(length * np.cos(azimuth)).sum(), (length * np.sin(azimuth)).sum()])
    made = walker()
    for _ in range(40):
        made.step(0.7, 0.0)
    expected = np.sqrt(np.diag(made.covariance)[PLACE])
    np.testing.assert_allclose(np.std(ends, axis=0), expected, rtol=0.15)


def test_a_known_place_turns_the_rest_of_the_walk() -> None:
    along = track(walker())
    walk(along, 20)
    azimuth = 0.15
    along.fix(PositionReference(at(20), 14 * math.cos(azimuth), 14 * math.sin(azimuth), 0.3))
    assert along.filter.azimuth(0.0) == pytest.approx(azimuth, abs=0.02)
    assert along.filter.state[SCALE] == 0


def test_known_places_calibrate_the_lengths_only_where_they_may() -> None:
    along = track(walker(learns=True))
    walk(along, 40)
    along.fix(PositionReference(at(40), 40 * 0.7 * 1.15, 0.0, 0.1))
    assert math.exp(along.filter.state[SCALE]) == pytest.approx(1.15, abs=0.02)


def test_smoothing_brings_a_known_place_back_to_the_steps_before_it() -> None:
    along = track(walker())
    walk(along, 20)
    azimuth = 0.2
    true = 0.7 * np.outer(np.arange(21), [math.cos(azimuth), math.sin(azimuth)])
    along.fix(PositionReference(at(20), *true[20], 0.1))
    points = along.flush()
    assert {p.stage for p in points} == {"track.smoothed"}
    found = np.array([(p.x_m, p.y_m) for p in points[:21]])
    assert np.hypot(*(found - true).T).max() < 0.25
    variances = np.array([p.covariance[0] + p.covariance[2] for p in points])
    assert variances[10] < 0.5 * (1 + variances[-1])


def test_a_walk_whose_direction_nothing_told_is_turned_towards_the_first_known_place() -> None:
    along = track(walker(offset=None))
    walk(along, 20)
    assert along.filter.lost
    along.fix(PositionReference(at(20), -13.0, 5.0, 1.0))
    assert not along.filter.lost
    expected = math.atan2(5.0, -13.0)
    assert math.cos(along.filter.azimuth(0.0) - expected) > math.cos(0.1)
    middle = next(p for p in along.flush() if p.time_ns == at(10))
    assert math.hypot(middle.x_m + 6.5, middle.y_m - 2.5) < 0.8


def test_sights_are_averaged_and_a_far_one_hardly_counts() -> None:
    made = walker(offset=None)
    for k in range(200):
        made.sight(0.3 + 0.2 * (-1) ** k, 0.2, 1.0)
    assert made.state[OFFSET] == pytest.approx(0.3, abs=0.05)
    made.sight(0.3 + 3.0, 0.2, 1.0)
    assert made.state[OFFSET] == pytest.approx(0.3, abs=0.06)


def test_sights_that_err_alike_count_as_one() -> None:
    one, many = walker(offset=None), walker(offset=None)
    for made, repeats in ((one, 1.0), (many, 10.0)):
        made.sight(0.0, 0.2, 1.0)
        for _ in range(10):
            made.sight(0.0, 0.2, repeats)
    assert many.covariance[OFFSET, OFFSET] > 4 * one.covariance[OFFSET, OFFSET]


def test_sights_find_the_drift_of_the_gyroscope() -> None:
    along = track(walker())
    for k in range(1, 400):
        along.step(
            Stride(
                at(k),
                0.7,
                0.002 * at(k) / NS_PER_S,
                MagneticBearing(-0.002 * k / 2, 0.05, 2.0),
                0.0,
            ),
            0.0,
            settled=True,
        )
    assert along.filter.state[OFFSET + 1] == pytest.approx(-0.002, rel=0.2)


def test_a_gyroscope_zeroed_at_rest_drifts_less_the_longer_it_rested() -> None:
    spreads = []
    for rested_s in (1.0, 10.0):
        made = walker()
        made.rest(rested_s)
        spreads.append(made.covariance[OFFSET + 1, OFFSET + 1])
    assert spreads[1] < 0.2 * spreads[0] <= 0.2 * 0.002**2


def test_smoothing_in_pieces_says_every_moment_once() -> None:
    along = track(walker(), smooth_s=5.0)
    said = along.begin()
    for k in range(1, 61):
        said += along.step(Stride(at(k), 0.7, 0.0, None, 0.0), 0.0, settled=True)
    said += along.flush()
    smoothed = [p.time_ns for p in said if p.stage == "track.smoothed"]
    assert smoothed == [at(k) for k in range(61)]


def test_a_direction_that_nothing_tells_is_in_the_spread_until_a_place_tells_it() -> None:
    made = Track(walker(), 0, "track", 1, 1e6, math.radians(10.0))
    plain = track(walker())
    for second in range(1, 11):
        stride = Stride(second * NS_PER_S, 1.0, 0.0, None, 0.0)
        point, other = (one.step(stride, 0.0, settled=True)[0] for one in (made, plain))
    assert point.x_m == other.x_m
    added = np.subtract(point.covariance, other.covariance)
    assert added == pytest.approx([0.0, 0.0, (10.0 * math.radians(10.0)) ** 2])
    (known,) = made.fix(PositionReference(11 * NS_PER_S, 10.0, 0.0, 1.0))
    (same,) = plain.fix(PositionReference(11 * NS_PER_S, 10.0, 0.0, 1.0))
    # a place 10 m from a sure beginning, known to 1 m, tells the direction to a tenth
    left_rad = 1 / math.hypot(1 / math.radians(10.0), 10.0)
    added = np.subtract(known.covariance, same.covariance)
    assert added == pytest.approx([0.0, 0.0, (10.0 * left_rad) ** 2], rel=0.03)


def test_so_is_an_axis_that_the_walk_has_not_told_yet_for_as_long_as_it_has_not() -> None:
    made, plain = track(walker()), track(walker())
    for second in range(1, 11):
        stride = Stride(second * NS_PER_S, 1.0, 0.0, None, 0.0)
        (point,) = made.step(stride, 0.0, 0.3 if second < 10 else 0.1, settled=False)
        (other,) = plain.step(stride, 0.0, settled=False)
        added = np.subtract(point.covariance, other.covariance)
        sigma_rad = 0.3 if second < 10 else 0.1
        assert added == pytest.approx([0.0, 0.0, (second * sigma_rad) ** 2])
    (known,) = made.fix(PositionReference(11 * NS_PER_S, 10.0, 0.0, 0.01))
    (same,) = plain.fix(PositionReference(11 * NS_PER_S, 10.0, 0.0, 0.01))
    assert known.covariance == pytest.approx(same.covariance, abs=0.03)


def test_a_turn_that_lost_samples_hid_widens_the_way_after_it() -> None:
    hidden, plain = track(walker()), track(walker())
    for k in range(1, 21):
        for one, unseen_rad2 in ((hidden, 0.01 if k == 11 else 0.0), (plain, 0.0)):
            stride = Stride(at(k), 1.0, 0.0, None, 0.0, unseen_rad2)
            (point, *_) = one.step(stride, 0.0, settled=True)
            if one is hidden:
                aside = point.covariance[2]
    added = aside - point.covariance[2]
    assert added == pytest.approx(10.0**2 * 0.01, rel=0.01)


@pytest.mark.parametrize("apart_s", [1.0, 10.0, 100.0])
def test_fixes_that_err_alike_tell_together_what_their_mean_does(apart_s: float) -> None:
    """The variance of the mean of a Gauss-Markov process, which the filter has after N fixes."""
    lasting_s, count, sigma_m = 30.0, 40, 6.0
    moments = apart_s * np.arange(count)
    correlation = np.exp(-np.abs(moments[:, None] - moments) / lasting_s)
    weights = np.linalg.solve(correlation, np.ones(count))
    exact_m2 = sigma_m**2 / weights.sum()
    standing = ReckoningFilter(NOISE, np.zeros(2), 1e6, learns_scale=False)
    repeats = [1.0] + [repeats_of(apart_s, lasting_s)] * (count - 1)
    for each in repeats:
        standing.fix(np.zeros(2), sigma_m, each, learns_scale=False)
    assert float(standing.covariance[0, 0]) == pytest.approx(exact_m2, rel=1e-6)


def test_a_fix_that_repeats_moves_a_track_less() -> None:
    moved, surprises = [], []
    for repeats in (1.0, 60.0):
        made = track(walker())
        made.step(Stride(NS_PER_S, 1.0, 0.0, None, 0.0), 0.0, settled=True)
        (point,) = made.fix(PositionReference(NS_PER_S, 5.0, 0.0, 0.5, repeats))
        moved.append(point.x_m - 1.0)
        surprises.append(point.nis)
    assert 0 < moved[1] < moved[0] / 2
    assert surprises[0] == surprises[1]  # it is as far off, however many others are, too


@pytest.mark.parametrize(("seconds", "sigma_m", "taught"), [(900, 3.0, True), (60, 5.0, False)])
def test_fixes_that_err_alike_teach_lengths_on_a_long_way_alone(
    seconds: int, sigma_m: float, taught: bool
) -> None:
    made = track(walker(learns=True))
    for second in range(1, seconds + 1):
        made.step(Stride(second * NS_PER_S, 1.0, 0.0, None, 0.0), 0.0, settled=True)
        place = PositionReference(
            second * NS_PER_S, 1.15 * second, 0.0, sigma_m, repeats_of(1.0, 30.0)
        )
        made.fix(place)
    scale = float(made.filter.state[SCALE])
    assert scale == pytest.approx(math.log(1.15) if taught else 0.0, abs=0.02)


@pytest.mark.parametrize("start_s", [0.0, 6.0])
def test_the_way_of_the_unheard_is_that_of_a_persistent_random_walk(start_s: float) -> None:
    rng, step_s, end_s, walkers = np.random.default_rng(3), 0.05, 20.0, 20_000
    turns = rng.normal(0, math.sqrt(2 * step_s / PERSISTENCE_S), (walkers, round(end_s / step_s)))
    turns[:, 0] = 0
    way = 1.3 * step_s * np.exp(1j * np.cumsum(turns, axis=1))[:, round(start_s / step_s) :]
    gone = way.sum(axis=1)
    unheard = Unheard(0, round(end_s * NS_PER_S), 1.3, 0.0)
    ahead_m, variance_m2 = unheard.way(round(start_s * NS_PER_S))
    assert ahead_m == pytest.approx(gone.real.mean(), rel=0.02)
    assert variance_m2 == pytest.approx((gone.real.var() + gone.imag.var()) / 2, rel=0.05)


def test_an_unheard_walker_who_stood_for_a_part_of_the_time_is_anywhere_about() -> None:
    given = (0, 10 * NS_PER_S, 1.3, 0.0)
    walks, partly = Unheard(*given).way(0), Unheard(*given, walking=0.1).way(0)
    assert walks[0] > 10 > partly[0] == 0
    assert 0 < partly[1] < 1.3**2
    assert Unheard(*given, walking=0.0).way(0) == (0, 0)


def test_a_track_goes_on_over_an_unheard_time_most_likely_ahead() -> None:
    made = track(walker())
    walk(made, 10)
    begin_ns = made.time_ns + 2 * NS_PER_S
    point, *smoothed = made.resume(Unheard(made.time_ns, begin_ns, 1.4, 0.0), 1.0)
    assert (point.x_m, point.y_m) == pytest.approx((7.0 + 2.7, 0.0), abs=0.2)
    assert [p.stage for p in smoothed] == ["track.smoothed"] * 11
    # the gyroscope's frame is another one: its headings are less by what it is turned
    (last,) = made.step(Stride(begin_ns + at(1), 0.7, -1.0, None, 0.0), 0.0, settled=True)
    assert (last.x_m, last.y_m) == pytest.approx((point.x_m + 0.7, 0.0), abs=0.1)


def test_the_direction_after_an_unheard_time_is_told_by_the_compass() -> None:
    made = track(walker())
    walk(made, 10)
    begin_ns = made.time_ns + 60 * NS_PER_S
    point, *_ = made.resume(Unheard(made.time_ns, begin_ns, 1.4, 0.0), 0.0)
    assert made.filter.lost
    for k in range(1, 6):
        sight = MagneticBearing(math.pi / 2, 0.1, 1.0)
        made.step(Stride(begin_ns + at(k), 0.7, 0.0, sight, 0.0), 0.0, settled=True)
    last = made.flush()[-1]
    assert last.y_m - point.y_m == pytest.approx(3.5, abs=0.2)
    assert last.x_m == pytest.approx(point.x_m, abs=0.2)
    assert min(last.covariance[::2]) > 100
