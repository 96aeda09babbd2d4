"""The smoother against a fit of all fixes at once, and the published experiment."""

from __future__ import annotations

import numpy as np
import pytest
from walked_paths import PATHS, filtered, located, rms, tracked

from groundtrace.trackers.kalman import F, H, Motion, WalkModel, first_spread, smoothed

MODEL = WalkModel(0.1, 0.5)


def places_fitted_at_once(places: np.ndarray, model: WalkModel) -> np.ndarray:
    """Least squares over all states: the maximum of the posterior, shape (n, 2)."""
    n = len(places)
    rows, values = [], []

    def add(blocks: dict[int, np.ndarray], target: np.ndarray, spread: np.ndarray) -> None:
        weight = np.linalg.cholesky(np.linalg.inv(spread)).T
        row = np.zeros((len(target), 4 * n))
        for k, block in blocks.items():
            row[:, 4 * k : 4 * k + 4] = block
        rows.append(weight @ row)
        values.append(weight @ target)

    add({0: np.eye(4)}, np.tile(places[0], 2), first_spread(model.r))
    for k in range(1, n):
        # the place before is exact: a spread far below all others
        spread = model.q + np.diag([1e-8, 1e-8, 0, 0])
        add({k: np.eye(4), k - 1: -F}, np.zeros(4), spread)
        add({k: H}, places[k], model.r)
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values))[0]
    return found.reshape(n, 4)[:, 2:]


def test_smoothing_is_the_fit_of_all_fixes_at_once() -> None:
    places = PATHS["bent"] + np.random.default_rng(1).normal(0, 0.5, (25, 2))
    found, _ = smoothed(*filtered(places, MODEL), [Motion.ahead(MODEL)] * len(places))
    assert found[:, 2:] == pytest.approx(places_fitted_at_once(places, MODEL), abs=1e-4)


def test_the_last_step_stays_and_none_gets_less_certain() -> None:
    states, spreads = filtered(PATHS["circle"], MODEL)
    found, covariances = smoothed(states, spreads, [Motion.ahead(MODEL)] * len(states))
    assert found[-1].tolist() == states[-1].tolist()
    gained = np.linalg.eigvalsh(spreads - covariances)
    assert gained.min() > -1e-9
    assert covariances[12, 2, 2] < 0.5 * spreads[12, 2, 2]


def test_what_the_filter_gave_is_left_as_it_was() -> None:
    states, spreads = filtered(PATHS["bent"], MODEL)
    before = states.copy(), spreads.copy()
    smoothed(states, spreads, [Motion.ahead(MODEL)] * len(states))
    assert np.array_equal(states, before[0])
    assert np.array_equal(spreads, before[1])


def test_a_single_step_is_smooth() -> None:
    states, spreads = filtered(PATHS["bent"][:1], MODEL)
    found, covariances = smoothed(states, spreads, [Motion.ahead(MODEL)] * len(states))
    assert found.tolist() == states.tolist()
    assert covariances.tolist() == spreads.tolist()


@pytest.mark.parametrize(
    ("name", "expected"), [("bent", 0.321), ("v", 0.331), ("wide v", 0.335), ("circle", 0.356)]
)
def test_smoothing_places_by_so_tdoa_gains_what_it_should(name: str, expected: float) -> None:
    path = PATHS[name]
    places = located(path, 150)
    assert rms(tracked(places, MODEL)[1] - path) == pytest.approx(expected, rel=0.1)
