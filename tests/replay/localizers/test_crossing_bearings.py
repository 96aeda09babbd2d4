"""Places by bearings, and the law of attenuation."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from bearings import LAYOUTS, NORMS, WEIGHTS, drawn

from groundtrace.layout.attenuation import fit_attenuation
from groundtrace.localizers.bearings import Norm, Weights, intersect

STATIONS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [5.0, 0.0]])
PLACE = np.array([3.0, 4.0])
SIGMAS = np.full(len(STATIONS), 0.02)


def bearings(place: np.ndarray) -> np.ndarray:
    return np.arctan2(*(place - STATIONS).T[::-1])


@pytest.mark.parametrize("norm", ["l1", "l2"])
def test_exact_bearings_cross_at_the_source_whichever_way_they_point(norm: Norm) -> None:
    turned = bearings(PLACE) + np.array([0, np.pi, 0, -np.pi, 0])
    found = intersect(STATIONS, turned, SIGMAS, norm)
    assert (found.x, found.y) == pytest.approx(tuple(PLACE), abs=1e-3)
    assert found.residual < 1e-3


def test_the_first_norm_bears_a_wild_bearing_that_pulls_the_second() -> None:
    azimuths = bearings(PLACE)
    azimuths[4] += 1.2
    off = {
        norm: np.hypot(found.x - PLACE[0], found.y - PLACE[1])
        for norm in ("l1", "l2")
        for found in [intersect(STATIONS, azimuths, SIGMAS, norm)]
    }
    assert off["l1"] < 0.1 < 0.5 < off["l2"]


def test_the_covariance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(300):
        found = intersect(STATIONS, bearings(PLACE) + 0.02 * rng.standard_normal(5), SIGMAS, "l2")
        off = np.array([found.x, found.y]) - PLACE
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert np.mean(squares) == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("norm", ["l1", "l2"])
def test_a_10_as_printed_takes_every_distance_alike_and_claims_what_it_errs(norm: Norm) -> None:
    sigmas = np.array([0.002, 0.05, 0.05, 0.05, 0.05])
    azimuths = bearings(PLACE) + np.array([0.004, 0.05, -0.05, 0.05, -0.05])
    own, printed = (intersect(STATIONS, azimuths, sigmas, norm, w) for w in ("errors", "none"))
    to_line = [abs(np.sin(np.arctan2(f.y, f.x) - azimuths[0])) for f in (own, printed)]
    assert to_line[0] < to_line[1]
    rng, squares = np.random.default_rng(5), []
    for _ in range(300):
        noise = SIGMAS * rng.standard_normal(5)
        found = intersect(STATIONS, bearings(PLACE) + noise, SIGMAS, "l2", "none")
        off = np.array([found.x, found.y]) - PLACE
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert np.mean(squares) == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("weights", ["errors", "none"])
def test_bearings_that_miss_each_other_by_more_than_they_claim_tell_less(weights: Weights) -> None:
    azimuths = bearings(PLACE)
    agree = intersect(STATIONS, azimuths, SIGMAS, "l1", weights)
    azimuths[4] += 0.2  # ten deviations
    differ = intersect(STATIONS, azimuths, SIGMAS, "l1", weights)
    assert np.trace(differ.covariance) > 9 * np.trace(agree.covariance)
    two = intersect(STATIONS[:2], azimuths[:2], SIGMAS[:2], "l1", weights)
    assert np.isfinite(two.covariance).all()


@pytest.mark.parametrize("wild", [0.0, 0.1])
@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_places_are_nearer_than_the_middle_of_the_room(layout: str, wild: float) -> None:
    rng = np.random.default_rng(7)
    places, stations = rng.uniform(0.5, 9.5, (60, 2)), LAYOUTS[layout]
    azimuths, claimed = drawn(places, stations, np.deg2rad(6.0), wild, rng)
    rival = np.median(np.hypot(*(places - 5.0).T))
    for norm, weights in product(NORMS, WEIGHTS):
        told = zip(azimuths, claimed, strict=True)
        found = [intersect(stations, *one, norm, weights) for one in told]
        off = [np.hypot(f.x - x, f.y - y) for f, (x, y) in zip(found, places, strict=True)]
        assert np.nanmedian(off) < rival / 2


def test_one_bearing_and_parallel_ones_lead_nowhere() -> None:
    one = np.array([0.5, np.nan, np.nan, np.nan, np.nan])
    assert not intersect(STATIONS, one, SIGMAS, "l1").located
    assert not intersect(STATIONS[:2], np.array([0.3, 0.3]), SIGMAS[:2], "l2").located


def test_the_law_of_attenuation_comes_back_from_many_impacts_of_unknown_strength() -> None:
    rng = np.random.default_rng(1)
    distance = rng.uniform(0.5, 12, (60, 6))
    strength = rng.lognormal(0, 1, (60, 1))
    amplitude = strength * distance**-0.5 * np.exp(-0.08 * distance)
    amplitude *= rng.lognormal(0, 0.1, amplitude.shape)
    amplitude[3, 2] *= 30
    amplitude[5] = np.nan
    law = fit_attenuation(distance, amplitude)
    assert law is not None
    assert abs(law.exponent - 0.5) < 3 * law.exponent_sigma < 0.15
    assert abs(law.loss_per_m - 0.08) < 3 * law.loss_sigma
    assert law.scatter == pytest.approx(0.1, rel=0.2)
    assert law.samples == 59 * 6


def test_too_few_amplitudes_leave_the_law_open() -> None:
    assert fit_attenuation(np.array([[1.0, 2.0, 3.0]]), np.array([[1.0, 0.5, 0.3]])) is None
