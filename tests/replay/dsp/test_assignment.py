"""One row or one column is assigned as a solver would, without one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from groundtrace.dsp.assignment import assign

COSTS = st.lists(st.one_of(st.floats(0, 9), st.just(np.inf), st.just(np.nan)), min_size=1)


@pytest.mark.parametrize("shape", [(1, -1), (-1, 1)], ids=["a row", "a column"])
@given(costs=COSTS, gate=st.floats(0, 9))
def test_the_cheapest_allowed_pair_is_the_one_taken(shape, costs, gate):
    cost = np.reshape(costs, shape)
    found = assign(cost, gate)
    allowed = cost <= gate
    if not allowed.any():
        assert found.shape == (0, 2)
        return
    row, column = linear_sum_assignment(np.where(allowed, cost, 100.0))
    assert found.tolist() == [[row[0], column[0]]]
    assert found.dtype == np.intp
