"""Errors that arrivals share: their part is told by residuals, and widens the places they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundtrace.localizers.amplitudes import JointPlaces, TimesAmplitudesParameters
from groundtrace.localizers.base import PlacedSensors
from groundtrace.localizers.methods import SoTdoa, SoTdoaParameters
from groundtrace.localizers.path_errors import SHARED, PathErrors, _beside, _Fit
from groundtrace.pipeline.stage import LocationEstimate, no_location
from groundtrace_codecs.geometry import Medium

SENSORS = np.array(
    [
        (-5, -4),
        (-2, -4),
        (1, -4),
        (5, -4),
        (5, -1),
        (3, 1),
        (5, 4),
        (2, 4),
        (-1, 3),
        (-4, 4),
        (-5, 1),
    ],
    np.float64,
)
PACE_S = 0.002  # per metre


def estimate_at(place: np.ndarray, arrivals: int = 11) -> LocationEstimate:
    return LocationEstimate(*place.tolist(), 0.01 * np.eye(2), 1e-4, arrivals)


def fitted(sensors: np.ndarray, times: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The place of least squares, by Gauss and Newton; a pace of its own."""
    place, pace = start.copy(), PACE_S
    for _ in range(20):
        away = sensors - place
        distance = np.hypot(*away.T)
        slopes = np.column_stack([-pace * away / distance[:, None], np.ones(len(times)), distance])
        move = np.linalg.lstsq(slopes, times - pace * distance, rcond=None)[0]
        place, pace = place + move[:2], pace + move[3]
    return place


def shared_errors(rng: np.random.Generator, place: np.ndarray, size_s: float) -> np.ndarray:
    """Errors that grow with distance and are alike in about the same direction."""
    away = SENSORS - place
    angle, distance = np.arctan2(*away.T[::-1]), np.hypot(*away.T)
    alike = np.exp(np.cos(angle[:, None] - angle) - 1) * np.outer(distance, distance) / 25.0
    values, vectors = np.linalg.eigh(alike)
    return size_s * vectors @ (np.sqrt(values.clip(0)) * rng.standard_normal(len(values)))


def told(kind: str, count: int = 60) -> tuple[PathErrors, float, float]:
    """What is learnt of errors of a kind; mean squares of errors over the variance of residuals."""
    rng, errors = np.random.default_rng(3), PathErrors(SENSORS)
    moved, widened = [], []
    for _ in range(count):
        truth = rng.uniform(-2, 2, 2)
        times = PACE_S * np.hypot(*(SENSORS - truth).T)
        own = 1e-4 * rng.standard_normal(len(times))
        times = times + (own if kind == "own" else shared_errors(rng, truth, 1e-4))
        place = fitted(SENSORS, times, truth)
        fit = _Fit.at(SENSORS, place, 1.0, free=True)
        assert fit is not None
        ordered = times[fit.order]
        left = ordered - fit.weights @ (fit.slopes.T @ ordered)
        variance = float(left @ left) / fit.spare / PACE_S**2
        covariance = variance * fit.inverse[:2, :2]
        given = replace(estimate_at(place), covariance=covariance)
        wide = errors.widened(given, times).covariance
        off = place - truth
        moved.append(float(off @ np.linalg.inv(covariance) @ off))
        widened.append(float(off @ np.linalg.inv(wide) @ off))
    return errors, float(np.median(moved)), float(np.median(widened))


def test_errors_of_their_own_widen_nothing() -> None:
    errors, before, after = told("own")
    assert errors.share < 0.05
    assert 0.8 < before < 3  # the median of chi-square with two degrees of freedom is 1.4
    assert after == pytest.approx(before, rel=0.35)


def test_errors_in_common_move_places_by_more_than_residuals_tell_and_are_reckoned_with() -> None:
    errors, before, after = told("shared")
    assert errors.share > 0.5
    assert before > 10
    assert 0.3 < after < 4


def test_what_each_kind_leaves_over_is_what_is_expected_of_it() -> None:
    fit = _Fit.at(SENSORS, np.array([1.0, -0.5]), 1.0, free=True)
    assert fit is not None
    rng = np.random.default_rng(1)
    taken = np.eye(11) - fit.weights @ fit.slopes.T
    own = taken @ rng.standard_normal((11, 20_000))
    ratio = np.sum(own * _beside(own)) / np.sum(own**2)
    assert fit.alone == pytest.approx(ratio, abs=0.02)
    root = np.linalg.cholesky(fit.correlation + 1e-9 * np.eye(11))
    shared = taken @ root @ rng.standard_normal((11, 20_000))
    ratio = np.sum(shared * _beside(shared)) / np.sum(shared**2)
    assert fit.common == pytest.approx(ratio, abs=0.02)
    assert fit.factor(0.0) == pytest.approx(1.0)
    assert fit.factor(0.5) > 2


def test_a_velocity_that_is_known_takes_nothing_from_the_residuals() -> None:
    rng, place = np.random.default_rng(2), np.array([0.5, 0.5])
    errors = PathErrors(SENSORS, scale=PACE_S)
    for _ in range(40):
        times = PACE_S * np.hypot(*(SENSORS - place).T) + 1e-4 * rng.standard_normal(11)
        errors.widened(estimate_at(place), times)
    assert errors.share < SHARED


@pytest.mark.parametrize("arrivals", [3, 4])
def test_too_few_arrivals_tell_nothing_and_widen_nothing(arrivals: int) -> None:
    errors, times = PathErrors(SENSORS), np.full(11, np.nan)
    times[:arrivals] = 0.01
    given = estimate_at(np.zeros(2), arrivals)
    assert errors.widened(given, times) is given
    assert errors.share == pytest.approx(SHARED)


def test_no_place_and_sensors_in_a_line_are_left_alone() -> None:
    nowhere = no_location(2)
    assert PathErrors(SENSORS).widened(nowhere, np.full(11, np.nan)) is nowhere
    line = np.column_stack([np.arange(12.0), np.zeros(12)])
    given = estimate_at(np.array([3.3, 0.0]))
    assert PathErrors(line).widened(given, np.arange(12.0)) is given


def test_places_by_signs_claim_what_an_uneven_floor_does() -> None:
    rng = np.random.default_rng(6)
    corners = np.array([[-5.0, -4], [5, -4], [5, 4], [-5, 4]])
    signs = SoTdoa(SoTdoaParameters())
    signs.begin(PlacedSensors(SENSORS, corners, Medium()))
    wider = []
    for number, place in enumerate(rng.uniform(-3.5, 3.5, (40, 2))):
        times = PACE_S * np.hypot(*(SENSORS - place).T) + shared_errors(rng, place, 1e-3)
        found, alone = signs.locate_step(number, times), signs.locate(times)
        assert (found.x, found.y) == (alone.x, alone.y)
        wider.append(np.linalg.det(found.covariance) / np.linalg.det(alone.covariance))
    assert min(wider) >= 1.0
    assert np.median(wider[20:]) > 3.0


def test_places_by_times_and_heights_claim_it_too() -> None:
    rng, corners = np.random.default_rng(6), np.array([[-5.0, -4], [5, -4], [5, 4], [-5, 4]])
    inside = []
    for size_s in (1e-3, 0.0):
        joint = JointPlaces(SENSORS, corners, TimesAmplitudesParameters())
        area = []
        for place in rng.uniform(-3.5, 3.5, (40, 2)):
            distance = np.hypot(*(SENSORS - place).T)
            times = PACE_S * distance + shared_errors(rng, place, size_s) + rng.normal(0, 1e-4, 11)
            heights = rng.normal(0, 0.2, 11) - np.log(distance)
            found = joint.locate(times, heights, np.zeros(11, np.bool_))
            off = np.array([found.x, found.y]) - place
            area.append(float(off @ np.linalg.solve(found.covariance, off)) < 4.605)
        inside.append(np.mean(area[10:]))
    assert min(inside) >= 0.8
