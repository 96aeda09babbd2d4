"""Straight courses through places, (8) and (9) as corrected, and crossings of a line."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.vehicles.lines import Course, Loss, through


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_outliers_do_not_turn_a_robust_course(loss: Loss) -> None:
    rng = np.random.default_rng(11)
    times = np.arange(20.0)
    places = np.array([1.0, 2.0]) + np.outer(times, [3.0, -1.0]) + rng.normal(0, 0.3, (20, 2))
    places[[3, 15]] += [[40, 30], [-35, 50]]
    robust, plain = through(times, places, loss), through(times, places, "squares")
    assert robust.velocity == pytest.approx([3, -1], abs=0.1)
    assert np.abs(plain.velocity - [3, -1]).max() > 0.3
    assert np.sqrt(np.diag(robust.covariance)).max() < 0.5


def test_the_errors_of_a_course_are_those_of_many() -> None:
    rng = np.random.default_rng(12)
    times = np.arange(15.0)
    found = [
        through(times, np.outer(times, [3.0, -1.0]) + rng.normal(0, [0.5, 1.0], (15, 2)), "squares")
        for _ in range(300)
    ]
    speeds, headings = [c.speed_mps for c in found], [c.heading_rad for c in found]
    assert np.std(speeds) == pytest.approx(np.mean([c.speed_sigma_mps for c in found]), rel=0.15)
    assert np.std(headings) == pytest.approx(
        np.mean([c.heading_sigma_rad for c in found]), rel=0.15
    )
    ends = np.array([c.at(np.array(20.0)) for c in found])
    spread = np.mean([c.spread_at(np.array(20.0)) for c in found], axis=0)
    assert np.cov(ends.T) == pytest.approx(spread, rel=0.25, abs=0.03)


def test_a_crossing_has_its_moment_and_place() -> None:
    course = Course(2.0, np.array([5.0, -4.0]), np.array([1.0, 2.0]), np.zeros((4, 4)))
    crossing = course.crossing(np.array([0.0, 0.0]), np.array([20.0, 0.0]))
    assert crossing is not None
    assert (crossing.time_s, crossing.along_m) == pytest.approx((4, 7))
    assert crossing.position == pytest.approx([7, 0])
    assert crossing.inside
    assert not crossing.rightwards
    back = course.crossing(np.array([20.0, 0.0]), np.array([10.0, 0.0]))
    assert back is not None
    assert (back.inside, back.rightwards, back.along_m) == (False, True, pytest.approx(13))


def test_a_parallel_course_crosses_nothing() -> None:
    course = Course(0.0, np.zeros(2), np.array([3.0, 0.0]), np.eye(4))
    assert course.crossing(np.array([0.0, 5.0]), np.array([10.0, 5.0])) is None


def test_the_errors_of_a_crossing_are_those_of_many() -> None:
    rng = np.random.default_rng(13)
    root = rng.normal(size=(4, 4)) * 0.1
    covariance = root @ root.T
    mean = np.array([5.0, -4.0, 1.0, 2.0])
    line = np.array([0.0, 0.0]), np.array([20.0, 3.0])
    known = Course(2.0, mean[:2], mean[2:], covariance).crossing(*line)
    assert known is not None
    found = []
    for x in rng.multivariate_normal(mean, covariance, 2000):
        crossing = Course(2.0, x[:2], x[2:], covariance).crossing(*line)
        assert crossing is not None
        found.append((crossing.time_s, crossing.along_m))
    expected = known.time_sigma_s, known.along_sigma_m
    assert np.std(found, axis=0) == pytest.approx(expected, rel=0.1)
