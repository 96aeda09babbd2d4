"""The localizer that learns the floor from the impacts so far, and covariances that are told."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from localizer_cases import ROOM, SENSORS, THETA_S, rms, uniform

from groundtrace.localizers.base import PRIOR_COUNT, ArrivalPrior, PlacedSensors, RunningSigma
from groundtrace.localizers.joint_calibration import scatter_of_room, scattered_pace
from groundtrace.localizers.methods import Hyperbolic, PowerLaw, SelfCalibrating
from groundtrace.localizers.wave_physics import PLATE
from groundtrace.pipeline.plugins import load
from groundtrace_codecs.geometry import Medium

SCALE = float(np.cbrt(THETA_S / PLATE))
METHODS = ("hyperbolic", "power-law", "self-calibrating", "so-tdoa")


def begun(kind: Any, medium: Medium | None = None, outline: Any = ROOM, **given: Any) -> Any:
    worker = kind(kind.Parameters(**given))
    medium = Medium(velocity_mps=1225.0) if medium is None else medium
    assert worker.prepare(PlacedSensors(SENSORS, outline, medium)) == ""
    return worker


def normalised(found: list[Any], places: np.ndarray) -> float:
    """Mean normalised estimation error squared; 2 where covariances mean what they say."""
    error = np.array([(f.x, f.y) for f in found]) - places
    spread = np.array([f.covariance for f in found])
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(spread), error)))


def test_after_a_few_impacts_places_are_as_good_as_with_a_calibrated_floor() -> None:
    places, times = uniform(60, 2e-4)
    learning, alone = begun(SelfCalibrating), begun(PowerLaw)
    found = np.array([[(f.x, f.y) for f in map(w.locate, times)] for w in (learning, alone)])
    late = np.hypot(*(found - places)[:, 20:].transpose(2, 0, 1))
    assert rms(late[0]) < 0.26
    assert rms(late[0]) < rms(late[1])
    floor = learning.running.floor
    assert floor.exponent == pytest.approx(4 / 3, abs=0.06)
    assert floor.scale == pytest.approx(SCALE, rel=0.15)


def test_before_there_are_impacts_enough_it_is_the_power_law() -> None:
    _, times = uniform(3, 2e-4)
    one, other = begun(SelfCalibrating), begun(PowerLaw)
    for row in times:
        assert one.locate(row).x == other.locate(row).x


def test_what_the_geometry_knows_of_the_floor_counts_from_the_first_impact_on() -> None:
    places, times = uniform(5, 2e-4)
    worker = begun(SelfCalibrating, Medium(arrival_scale=SCALE, arrival_exponent=4 / 3))
    found = [worker.locate(row) for row in times]
    assert rms(np.hypot(*(np.array([(f.x, f.y) for f in found]) - places).T)) < 0.35
    assert worker.running.floor.scale == pytest.approx(SCALE, rel=0.1)


CORNERS = np.array([(4.0, 0.0), (0.0, 0.0), (0.0, 6.0), (4.0, 6.0)])
WALLS = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 6.0), (0.0, 6.0)])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("unit_m", [1.0, 0.3048])
def test_errors_that_all_impacts_share_are_not_taken_for_a_slow_floor(
    seed: int, unit_m: float
) -> None:
    """Forty impacts at four places among four sensors: each path is slower or faster by its own."""
    rng = np.random.default_rng(seed)
    worker = SelfCalibrating(SelfCalibrating.Parameters(exponent=1.0))
    assert worker.prepare(PlacedSensors(CORNERS / unit_m, WALLS / unit_m, Medium())) == ""
    places = np.tile([(1.0, 2.0), (2.0, 0.5), (2.0, 5.5), (3.0, 4.0)], (10, 1))
    apart = np.hypot(*(places[:, None] - CORNERS).transpose(2, 0, 1))
    paths = np.tile(np.exp(rng.normal(0, 0.25, (4, 4))), (10, 1))
    times = apart / 1000.0 * paths + rng.normal(0, 5e-5, apart.shape)
    found = [worker.locate(row) for row in times]
    floor = worker.running.floor
    assert 0.5 < floor.pace_s / (floor.reference_m * unit_m / 1000.0) < 2
    assert normalised(found[8:], places[8:] / unit_m) < 3
    # forty tell hardly more of the pace than six
    assert worker.running.pace_deviation > 0.5


def test_what_errs_alike_counts_as_few() -> None:
    prior = ArrivalPrior(pace_s=0.01, pace_deviation=0.6, exponent_deviation=0.1)
    surer = prior.surer(4.0)
    assert (surer.pace_deviation, surer.exponent_deviation) == pytest.approx((0.3, 0.05))
    assert ArrivalPrior(exponent_deviation=0.0).surer(4.0).exponent_deviation == 0.0


def test_the_pace_that_scatters_arrivals_as_impacts_all_over_the_room_would() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 1, (400, 2)) * WALLS.max(axis=0)
    apart = np.hypot(*(places[:, None] - CORNERS).transpose(2, 0, 1))
    pace = scattered_pace(apart / 800.0, scatter_of_room(CORNERS, WALLS, 1.0)[1])
    assert pace == pytest.approx(np.sqrt(13.0) / 800.0, rel=0.1)


def test_an_impact_is_placed_by_those_before_it_only() -> None:
    _, times = uniform(24, 2e-4)
    worker = begun(SelfCalibrating)
    whole = [worker.locate(row).x for row in times]
    part = begun(SelfCalibrating)
    assert [part.locate(row).x for row in times[:15]] == whole[:15]
    other = copy.deepcopy(part)
    assert [other.locate(row).x for row in times[15:]] == whole[15:]


@pytest.mark.parametrize(
    ("kind", "sigma_s"),
    [
        # at 0.1 ms a hyperbola errs by its law more than by its arrivals: it says 0.65
        (Hyperbolic, 5e-4),
        (PowerLaw, 1e-4),
        (PowerLaw, 5e-4),
        (SelfCalibrating, 1e-4),
        (SelfCalibrating, 5e-4),
    ],
)
def test_covariances_mean_what_they_say(kind: Any, sigma_s: float) -> None:
    places, times = uniform(80, sigma_s)
    worker = begun(kind)
    found = [worker.locate(row) for row in times]
    # of 2 that are right under this law; regions allow for laws that are not quite it
    assert 0.4 < normalised(found[20:], places[20:]) < 3.2


def test_a_sigma_is_told_by_places_with_arrivals_to_spare() -> None:
    worker = begun(PowerLaw)
    few = np.full(9, np.nan)
    few[:4] = uniform(1, 2e-4)[1][0, :4]
    worker.locate(few)
    assert worker.sigma.value_s == 5e-4
    for row in uniform(40, 1e-4)[1]:
        worker.locate(row)
    assert worker.sigma.value_s == pytest.approx(1e-4, rel=0.3)
    assert PRIOR_COUNT < 40
    assert RunningSigma(5e-4, 4).value_s == 5e-4


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("sensors", [(0, 4, 8), (0, 2, 6), (1, 3, 5, 7)])
def test_three_arrivals_suffice_for_a_place_with_a_covariance(
    method: str, sensors: tuple[int, ...]
) -> None:
    times = np.full(9, np.nan)
    times[list(sensors)] = uniform(1, 2e-4)[1][0, list(sensors)]
    found = begun(load("stages", method)).locate(times)
    assert found.located
    assert found.picks == len(sensors)
    assert np.isfinite(found.residual)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)
    times[sensors[0]] = np.nan
    if len(sensors) == 3:
        assert not begun(load("stages", method)).locate(times).located
