"""Wrong signs against the known numbers of the thesis's section 5.3.2."""

from __future__ import annotations

import numpy as np
import pytest
from room_layouts import NINE, at_1000_mps, layout

from groundtrace.layout.analysis import (
    drawn_wrong,
    grid_of,
    mean_wrong,
    poisson_binomial,
    sign_errors,
)
from groundtrace.localizers import arrival_order
from groundtrace.localizers.arrival_order import chance_wrong, pairs

#: Source, sigma [s]: lambda, variance of independent errors, mean and variance of physical ones.
GOLDEN = [
    ((1, 3), 5e-4, 0.515, 0.41, 0.863, 0.66),
    ((1, 3), 1e-3, 1.467, 1.15, 2.421, 1.98),
    ((0.5, 1), 5e-4, 0.821, 0.67, 1.291, 1.08),
    ((0.5, 1), 1e-3, 1.865, 1.34, 2.540, 2.17),
    ((4.5, 4.8), 5e-4, 1.921, 1.51, 2.860, 2.46),
    ((4.5, 4.8), 1e-3, 4.055, 2.91, 5.535, 5.77),
]


@pytest.mark.parametrize(("source", "sigma", "mean", "variance", "physical", "spread"), GOLDEN)
def test_wrong_signs_are_as_often_as_known(
    source: tuple[float, float],
    sigma: float,
    mean: float,
    variance: float,
    physical: float,
    spread: float,
) -> None:
    times = at_1000_mps(np.array([source]))[0]
    law = poisson_binomial(chance_wrong(times, *pairs(9), sigma))
    count = np.arange(37)
    assert law.sum() == pytest.approx(1.0)
    assert law @ count == pytest.approx(mean, abs=6e-4)
    assert mean_wrong(times, sigma) == pytest.approx(law @ count)
    assert law @ (count - law @ count) ** 2 == pytest.approx(variance, rel=0.03)
    drawn = drawn_wrong(times, sigma, 20_000, 3)
    assert drawn.mean() == pytest.approx(mean_wrong(times, np.sqrt(2) * sigma), rel=0.02)
    assert drawn.mean() == pytest.approx(physical, rel=0.03)
    assert drawn.var() == pytest.approx(spread, rel=0.06)


@pytest.mark.parametrize(("factor", "mean", "most"), [(1.0, 2.32, 6.31), (2**0.5, 3.24, 7.15)])
def test_the_map_of_wrong_signs_is_the_known_one(factor: float, mean: float, most: float) -> None:
    nodes = grid_of(layout().room, 41).nodes
    found = mean_wrong(at_1000_mps(nodes), factor * 1e-3)
    assert found.mean() == pytest.approx(mean, rel=0.02)
    assert found.max() == pytest.approx(most, abs=5e-3)
    assert nodes[found.argmax()] == pytest.approx((5.0, 5.0))


def test_independent_errors_are_fewer_and_vary_less_than_physical_ones() -> None:
    found = sign_errors(at_1000_mps(np.array([(4.5, 4.8), (1, 3)])), 1e-3, 20_000, 0)
    assert found.pairs == 36
    assert (found.independent < found.physical).all()
    assert found.variance_independent < found.independent.max()
    assert found.variance > found.physical.max()
    assert found.most_independent < found.most


def test_a_place_between_two_sensors_has_their_sign_wrong_half_the_time() -> None:
    drawn = drawn_wrong(np.array([0.0, 0.0, 1.0]), 1e-3, 4000, 1)
    assert drawn.mean() == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize(
    ("source", "known"),
    [((1, 2), {2: 0.92, 4: 0.78, 6: 0.62}), ((4.5, 4.8), {2: 0.85, 4: 0.62, 6: 0.48})],
)
def test_regions_bear_as_many_wrong_signs_as_known(
    source: tuple[float, float], known: dict[int, float]
) -> None:
    # the known values are of some hundred draws: 0.05 is two of their standard deviations
    regions = arrival_order.known_regions(np.array(NINE), layout().outline)
    signs, told = arrival_order.measured_signs(regions, at_1000_mps(np.array([source]))[0])
    true = arrival_order.distances(regions, signs, told).argmin()
    rng = np.random.default_rng(4)
    for errors, share in known.items():
        flips = np.argsort(rng.random((2000, 36)), axis=1) < errors
        wrong = arrival_order.distances(regions, np.where(flips, -signs, signs), told)
        alone = (wrong == wrong.min(axis=1, keepdims=True)).sum(axis=1) == 1
        assert np.mean(alone & (wrong.argmin(axis=1) == true)) == pytest.approx(share, abs=0.05)
