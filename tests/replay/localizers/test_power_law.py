from __future__ import annotations

import numpy as np
import pytest
from localizer_cases import (
    ROOM,
    SENSORS,
    SOURCE,
    THETA_S,
    distances_off,
    repeated,
    rms,
    times_of,
    uniform,
    velocity,
)

from groundtrace.localizers import arrival_order, tdoa
from groundtrace.localizers.tdoa import locate_power_law


def robust(times: np.ndarray) -> tuple[float, float]:
    place = locate_power_law(SENSORS, times, ROOM)
    return place.x, place.y


@pytest.mark.parametrize("theta", [5e-6, 1e-5, 5e-5])
def test_true_arrivals_are_inverted_whatever_the_floor(theta: float) -> None:
    assert robust(times_of(SOURCE, theta)[0] + 77.0) == pytest.approx((1, 3), abs=0.02)


@pytest.mark.parametrize(
    ("sigma", "plain", "half", "huber"),
    [(2e-4, 0.25, 0.20, 0.25), (5e-4, 0.59, 0.48, 0.62), (1e-3, 1.11, 0.87, 1.19)],
)
def test_errors_over_the_room_are_the_known_ones(
    sigma: float, plain: float, half: float, huber: float
) -> None:
    sources, times = uniform(600, sigma)
    off = distances_off(lambda t: locate_power_law(SENSORS, t, ROOM, huber=np.inf), times, sources)
    assert (rms(off), float(np.median(off))) == pytest.approx((plain, half), rel=0.12)
    off = distances_off(lambda t: locate_power_law(SENSORS, t, ROOM), times, sources)
    assert rms(off) == pytest.approx(huber, rel=0.12)


def test_without_late_arrivals_the_free_fit_beats_the_signs_and_calibration_beats_both() -> None:
    times = repeated(THETA_S, 2e-4, 200)
    sources, times = uniform(300, 5e-4)
    speed = velocity(sources)
    signs = rms(distances_off(lambda t: arrival_order.locate(SENSORS, t, ROOM), times, sources))
    free = rms(distances_off(lambda t: locate_power_law(SENSORS, t, ROOM), times, sources))
    known = rms(
        distances_off(lambda t: tdoa.locate_hyperbolic(SENSORS, t, speed, ROOM), times, sources)
    )
    assert known < free < 0.83 * signs


def test_with_late_arrivals_the_bounded_loss_beats_all_others() -> None:
    sources, times = uniform(400, 5e-4, late=0.15)
    speed = velocity(sources)
    signs = distances_off(lambda t: arrival_order.locate(SENSORS, t, ROOM), times, sources)
    bounded = distances_off(lambda t: locate_power_law(SENSORS, t, ROOM), times, sources)
    plain = distances_off(
        lambda t: locate_power_law(SENSORS, t, ROOM, huber=np.inf), times, sources
    )
    known = distances_off(lambda t: tdoa.locate_hyperbolic(SENSORS, t, speed, ROOM), times, sources)
    assert rms(bounded) < rms(signs) < rms(known) < rms(plain)
    assert np.median(bounded) < np.median(signs) < np.median(plain)


def test_a_constant_velocity_is_the_exponent_one() -> None:
    source = np.array([6.2, 2.4])
    times = np.linalg.norm(SENSORS - source, axis=1) / 900
    place = locate_power_law(SENSORS, times, ROOM, exponent=1.0)
    assert (place.x, place.y) == pytest.approx(source, abs=0.02)


def test_four_arrivals_and_fewer_give_the_middle_of_all_places_that_fit() -> None:
    whole = locate_power_law(SENSORS, times_of(SOURCE)[0], ROOM)
    times = np.full(9, np.nan)
    times[[0, 1, 3]] = times_of(SOURCE)[0][[0, 1, 3]]
    place = locate_power_law(SENSORS, times, ROOM)
    assert place.picks == 3
    assert np.trace(place.covariance) > 4 * np.trace(whole.covariance)
    off = np.array([1 - place.x, 3 - place.y])
    assert off @ np.linalg.inv(place.covariance) @ off < 9
    times[0] = np.nan
    assert not locate_power_law(SENSORS, times, ROOM).located


def test_the_covariance_is_that_of_the_errors() -> None:
    sources, times = uniform(300, 5e-4)
    places = [locate_power_law(SENSORS, row, ROOM) for row in times]
    off = np.array([(p.x, p.y) for p in places]) - sources
    inverse = np.linalg.inv(np.array([p.covariance for p in places]))
    assert 0.8 < np.einsum("ni,nij,nj->n", off, inverse, off).mean() < 3


def test_places_stay_inside_a_room_that_is_not_convex() -> None:
    room = np.array([(0.0, 0.0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10)])
    rng = np.random.default_rng(0)
    for row in rng.uniform(0, 1e-2, (20, 9)):
        place = locate_power_law(SENSORS, row, room)
        assert place.x <= 4 + 1e-9 or place.y <= 4 + 1e-9
