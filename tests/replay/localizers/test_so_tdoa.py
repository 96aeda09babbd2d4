from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from localizer_cases import ROOM, SENSORS, SOURCE, distances_off, repeated, rms, times_of, uniform

from groundtrace.localizers.arrival_order import (
    distances,
    known_regions,
    likeliest,
    locate,
    measured_signs,
)

if TYPE_CHECKING:
    from groundtrace.localizers.arrival_order import Regions
    from groundtrace.pipeline.stage import LocationEstimate

#: Theta, sigma, RMSE of the region centres, and of samples of the room with ties averaged [m]; of
#: 5000 runs.
GOLDEN = [
    (5e-6, 2e-4, 0.24, 0.31),
    (5e-6, 5e-4, 0.80, 0.86),
    (5e-6, 1e-3, 1.43, 1.43),
    (1e-5, 2e-4, 0.20, 0.25),
    (1e-5, 5e-4, 0.63, 0.71),
    (1e-5, 1e-3, 1.20, 1.22),
    (5e-5, 2e-4, 0.15, 0.17),
    (5e-5, 5e-4, 0.33, 0.41),
    (5e-5, 1e-3, 0.77, 0.81),
]


def found(times: np.ndarray) -> LocationEstimate:
    return locate(SENSORS, times, ROOM)


def regions() -> Regions:
    return known_regions(SENSORS, ROOM)


def on_samples(times: np.ndarray) -> np.ndarray:
    """Samples of the room instead of regions (5.13), off their borders, ties averaged."""
    axis = np.linspace(0, 10, 25)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + np.sqrt([2e-12, 3e-12])
    apart = np.linalg.norm(nodes[:, None] - SENSORS, axis=2)
    first, second = regions().first, regions().second
    agree = (
        np.sign(times[:, first] - times[:, second]) @ np.sign(apart[:, first] - apart[:, second]).T
    )
    best = agree == agree.max(axis=1, keepdims=True)
    return best @ nodes / best.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(("theta", "sigma", "by_region", "by_sample"), GOLDEN)
def test_errors_are_those_of_the_thesis_simulation(
    theta: float, sigma: float, by_region: float, by_sample: float
) -> None:
    times = repeated(theta, sigma)
    assert rms(distances_off(found, times, SOURCE)) == pytest.approx(by_region, rel=0.12)
    sampled = np.hypot(*(on_samples(times) - SOURCE).T)
    assert rms(sampled) == pytest.approx(by_sample, rel=0.12)


@pytest.mark.parametrize(("sigma", "golden"), [(2e-4, 0.69), (5e-4, 0.90), (1e-3, 1.33)])
def test_errors_over_the_room_are_the_known_ones(sigma: float, golden: float) -> None:
    sources, times = uniform(800, sigma)
    assert rms(distances_off(found, times, sources)) == pytest.approx(golden, rel=0.12)


def test_true_arrivals_give_the_centre_of_their_region() -> None:
    place = found(times_of(SOURCE)[0])
    assert (place.residual, place.ties, place.picks) == (0.0, 1, 9)
    nearest = np.linalg.norm(regions().centres - SOURCE, axis=1).min()
    assert np.hypot(place.x - 1, place.y - 3) == pytest.approx(nearest, abs=0.3)


def test_ties_are_averaged() -> None:
    # the order of (1, 2) and (3, 4) contradict each other: both sides of the middle fit as well
    sensors = np.array([(0.0, 0.0), (10, 0), (0, 10), (10, 10)])
    place = locate(sensors, np.array([0.0, 1.0, 3.0, 2.0]) * 1e-3, ROOM)
    assert place.ties > 1
    assert place.x == pytest.approx(5.0)
    assert place.residual > 0


def test_equal_arrivals_count_half_for_either_side() -> None:
    signs, compared = measured_signs(regions(), np.array([1.0, 1, 2, 3, 4, 5, 6, 7, 8]))
    assert (signs[0], int((signs == 0).sum())) == (0.0, 1)
    assert compared.all()
    far = distances(regions(), signs, compared)
    signs[0] = 1.0
    np.testing.assert_array_equal(np.abs(far - distances(regions(), signs, compared)), 0.5)


def test_sensors_without_an_arrival_are_left_out_of_the_comparison() -> None:
    times = times_of(SOURCE)[0]
    times[[2, 6]] = np.nan
    _, compared = measured_signs(regions(), times)
    assert compared.sum() == 21
    place = found(times)
    assert (place.picks, place.residual) == (7, 0.0)
    assert np.hypot(place.x - 1, place.y - 3) < 1


def test_three_arrivals_suffice_and_two_do_not() -> None:
    times = np.full(9, np.nan)
    times[[0, 1, 3]] = times_of(SOURCE)[0][[0, 1, 3]]
    assert found(times).located
    times[0] = np.nan
    place = found(times)
    assert not place.located
    assert place.picks == 2
    assert np.isnan(place.covariance).all()


def test_the_covariance_is_that_of_the_errors() -> None:
    sources, times = uniform(400, 5e-4)
    places = [found(row) for row in times]
    off = np.array([(p.x, p.y) for p in places]) - sources
    inverse = np.linalg.inv(np.array([p.covariance for p in places]))
    assert 0.8 < np.einsum("ni,nij,nj->n", off, inverse, off).mean() < 3


def test_the_model_of_sign_errors_finds_better_than_counting_signs() -> None:
    sources, times = uniform(600, 5e-4)
    counted = rms(distances_off(found, times, sources))
    modelled = rms(distances_off(lambda t: likeliest(regions(), t, 1e-5, 5e-4), times, sources))
    assert modelled < 0.95 * counted
    few = np.where(np.arange(9) < 2, times[0], np.nan)
    assert not likeliest(regions(), few, 1e-5, 5e-4).located
