"""One floor for all impacts: scale, exponent and clocks out of arrivals of known law."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from localizer_cases import ROOM, SENSORS, THETA_S, rms

from groundtrace.localizers.base import EXPONENT, ArrivalModel, ArrivalPrior, reference_distance
from groundtrace.localizers.joint_calibration import (
    LOSSES,
    FreeParameters,
    Impacts,
    fit,
    known_start,
    places_on,
    start,
)
from groundtrace.localizers.wave_physics import PLATE, arrivals

if TYPE_CHECKING:
    from numpy.typing import NDArray

BOUNDS = np.array([ROOM.min(axis=0), ROOM.max(axis=0)])
CORNERS = SENSORS[[0, 2, 6, 8]]
SCALE = float(np.cbrt(THETA_S / PLATE))


def heard(
    seed: int, count: int = 40, sigma_s: float = 2e-4, sensors: NDArray[np.float64] = SENSORS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of impacts all over the room, and their arrivals by (4.24) with errors."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 10, (count, 2))
    times = arrivals(np.linalg.norm(places[:, None] - sensors, axis=2), THETA_S)
    return places, times + rng.normal(0, sigma_s, times.shape)


def off(found: NDArray[np.float64], places: NDArray[np.float64]) -> float:
    return rms(np.hypot(*(found - places).T))


def test_scale_exponent_and_places_come_out_together() -> None:
    places, times = heard(1)
    impacts = Impacts(SENSORS, times, BOUNDS)
    begun = start(impacts, ROOM)
    found = fit(impacts, begun.floor, begun.places)
    assert found.floor.exponent == pytest.approx(EXPONENT, abs=3 * found.deviations[1])
    assert found.floor.scale == pytest.approx(SCALE, rel=0.15)
    assert found.sigma_s == pytest.approx(2e-4, rel=0.25)
    # a calibrated hyperbola reaches 0.24 m, the power law with a scale of its own 0.25 m
    assert off(found.places, places) < 0.24


def test_every_loss_gives_nearly_the_same_and_late_arrivals_change_little() -> None:
    places, times = heard(2)
    rng = np.random.default_rng(0)
    late = np.where(rng.random(times.shape) < 0.1, rng.exponential(5e-3, times.shape), 0.0)
    impacts = Impacts(SENSORS, times + late, BOUNDS, places)
    begun = known_start(impacts)
    scales = [fit(impacts, begun.floor, places, loss=loss).floor for loss in LOSSES]
    assert [f.exponent for f in scales] == pytest.approx([EXPONENT] * len(LOSSES), abs=0.1)
    assert [f.pace_s for f in scales] == pytest.approx(
        [SCALE * reference_distance(SENSORS) ** EXPONENT] * len(LOSSES), rel=0.06
    )


@pytest.mark.parametrize("known", [True, False])
def test_clock_offsets_longer_than_waves_take_are_found(known: bool) -> None:
    places, times = heard(3)
    offsets = np.random.default_rng(4).normal(0, 5e-3, 9)
    offsets -= offsets.mean()
    impacts = Impacts(SENSORS, times + offsets, BOUNDS, places if known else None)
    found = known_start(impacts, offsets=True) if known else start(impacts, ROOM, offsets=True)
    assert found.floor.offsets_s.sum() == pytest.approx(0, abs=1e-12)
    assert np.abs(found.floor.offsets_s - offsets).max() < 4e-4
    assert np.all(np.abs(found.floor.offsets_s - offsets) < 5 * found.deviations[2:])
    assert off(places_on(impacts, found.floor, ROOM), places) < 0.45


def test_four_sensors_place_better_with_a_shared_scale_than_with_their_own() -> None:
    from groundtrace.localizers import tdoa

    shared, own = [], []
    for seed in range(4):
        places, times = heard(seed, sensors=CORNERS)
        impacts = Impacts(CORNERS, times, BOUNDS)
        begun = start(impacts, ROOM)
        found = fit(impacts, begun.floor, begun.places, prior=ArrivalPrior(exponent_deviation=0.05))
        shared.append(off(places_on(impacts, found.floor, ROOM), places))
        single = [tdoa.locate_power_law(CORNERS, row, ROOM) for row in times]
        own.append(off(np.array([(p.x, p.y) for p in single]), places))
    assert rms(np.array(own)) > 1.0
    assert rms(np.array(shared)) < 0.6


def test_impacts_as_far_from_all_sensors_tell_no_scale() -> None:
    middle = np.tile([[5.0, 5.0]], (20, 1))
    times = np.random.default_rng(5).normal(0, 2e-4, (20, 4))
    impacts = Impacts(CORNERS, times, BOUNDS, middle)
    floor = ArrivalModel(reference_distance(CORNERS), 5e-3, EXPONENT, np.zeros(4))
    found = fit(impacts, floor, middle, free=FreeParameters(exponent=False))
    assert np.isinf(found.deviations[0]) or found.deviations[0] > 1e3


def test_missing_arrivals_leave_the_rest_of_an_impact() -> None:
    places, times = heard(6)
    times[np.random.default_rng(1).random(times.shape) < 0.2] = np.nan
    impacts = Impacts(SENSORS, times, BOUNDS)
    begun = start(impacts, ROOM)
    found = fit(impacts, begun.floor, begun.places)
    assert found.floor.scale == pytest.approx(SCALE, rel=0.2)
    assert np.array_equal(np.isnan(found.residuals_s), np.isnan(times))
    assert off(found.places, places) < 0.35
