"""The Kalman filter and its smoother: what filterpy makes of the same measurements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter as Oracle

from groundtrace.dsp.kalman import KalmanFilter, smoothed


class Step(NamedTuple):
    """A transition and the covariance of its error."""

    f: np.ndarray
    q: np.ndarray


def spread(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (4, 2), (5, 3), (5, 7)])
def test_filter_and_smoother_are_those_of_filterpy(n, m):
    rng = np.random.default_rng(10 * n + m)
    x, p = rng.normal(size=n), spread(rng, n)
    told = Oracle(dim_x=n, dim_z=m)
    told.x, told.P = x.copy(), p.copy()
    found = KalmanFilter(x, p)
    steps, states, spreads = [], [], []
    for _ in range(9):
        step = Step(rng.normal(size=(n, n)), spread(rng, n))
        z, h, r = rng.normal(size=m), rng.normal(size=(m, n)), spread(rng, m)
        told.predict(F=step.f, Q=step.q)
        told.update(z, R=r, H=h)
        found.predict(step.f, step.q)
        nis = found.update(z, h, r)
        np.testing.assert_allclose(nis, told.mahalanobis**2, rtol=1e-12)
        for one, other in ((found.x, told.x), (found.p, told.P), (found.gain, told.K)):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        steps.append(step)
        states.append(found.x)
        spreads.append(found.p)
    after = smoothed(np.array(states), np.array(spreads), steps)
    expected = told.rts_smoother(np.array(states), np.array(spreads), *zip(*steps, strict=True))
    for one, other in zip(after, expected[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_of_one_measurement_the_smoothed_state_is_the_filtered_one():
    state, covariance = np.ones((1, 2)), np.eye(2)[None]
    after = smoothed(state, covariance, [Step(np.eye(2), np.eye(2))])
    assert np.array_equal(after[0], state)
    assert np.array_equal(after[1], covariance)
