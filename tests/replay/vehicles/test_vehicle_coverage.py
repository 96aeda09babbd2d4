"""Whether the direct course's covariance is what its errors are, neither less nor more."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_powers import ANTENNAS, FLOOR, LAW, MU, straight

from groundtrace.vehicles.course_stages import direct_rides, search_bounds
from groundtrace.vehicles.courses import Observed, Search, fit_course
from groundtrace.vehicles.medium import ranges

TIMES = np.arange(0, 14, 0.5)
PLACE, VELOCITY = (12.0, 17.0), (2.0, 5.0)
#: About the truth: whether another side of a sensor is taken for it is another question.
NEAR = Search((8, 13), (16, 21), (4, 7), places=2, headings=8, speeds=2, refined=2)
TRIALS = 40


def powers_of(rng: np.random.Generator, alike: float) -> Observed:
    """Powers that scatter by a third, and are alike from a cycle to the next by so much."""
    mean = MU * ranges(straight(TIMES, PLACE, VELOCITY), ANTENNAS) ** -1.5 + FLOOR
    # the sum of 18 squares of processes whose correlation is the root of that of their squares
    steps = rng.normal(size=(*mean.shape, 18))
    for cycle in range(1, len(steps)):
        steps[cycle] = alike**0.5 * steps[cycle - 1] + (1 - alike) ** 0.5 * steps[cycle]
    powers = mean * (steps**2).mean(axis=2)
    return Observed(TIMES, powers, np.full(mean.shape, FLOOR), ANTENNAS, LAW)


@pytest.mark.parametrize("alike", [0.0, 0.5])
def test_errors_of_a_course_are_about_what_its_covariance_says(alike: float) -> None:
    rng = np.random.default_rng(4)
    squares = []
    for _ in range(TRIALS):
        fit = fit_course(powers_of(rng, alike), NEAR)
        assert fit is not None
        off = np.concatenate([fit.course.position - PLACE, fit.course.velocity - VELOCITY])
        squares.append(float(off @ np.linalg.solve(fit.course.covariance, off)))
    # chi-square of 4 degrees of freedom: half are within 3.36; beyond, where a sensor is passed
    # closely, the likelihood is not a normal law's, and 90 % are not within 7.78 (see the docs)
    assert 2.3 < np.median(squares) < 5.0
    assert 0.6 <= np.mean(np.array(squares) < 7.78) <= 0.96


@pytest.mark.sweep
def test_courses_over_grounds_that_no_fit_knows_err_as_they_say() -> None:
    rng = np.random.default_rng(12)
    off, far = [], []
    for _ in range(6):
        place, heading = 15 + rng.uniform(-12, 12, 2), rng.uniform(0, 2 * np.pi)
        speed = rng.uniform(4, 12)
        velocity = speed * np.array([np.cos(heading), np.sin(heading)])
        way = straight(TIMES, place, velocity)
        gains = np.exp(rng.normal(0, 0.3, len(ANTENNAS)))
        mean = MU * gains * ranges(way, ANTENNAS) ** -rng.uniform(1.0, 2.4)
        powers = (mean + FLOOR) * rng.gamma(9, 1 / 9, mean.shape)
        observed = Observed(TIMES, powers, np.full(mean.shape, FLOOR), ANTENNAS, LAW)
        (ride,) = direct_rides(observed, search_bounds(ANTENNAS, (1.0, 30.0)), float("inf"))
        at = np.array([TIMES.mean()])
        across = np.array([-velocity[1], velocity[0]]) / speed
        spread = across @ ride.courses[0].spread_at(at)[0] @ across
        far.append(abs(across @ (ride.courses[0].at(at)[0] - straight(at, place, velocity)[0])))
        off.append(far[-1] / np.sqrt(spread))
    assert np.mean(np.array(off) <= 1.0) >= 0.5
    assert max(off) < 2.5
    assert np.median(far) <= 2.0
