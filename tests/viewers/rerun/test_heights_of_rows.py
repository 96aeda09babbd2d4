"""No row of a layout is too low to read, however many there are and whatever they ask for."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace_viewers.rerun.blueprint import LEAST_ROW, legible_shares


def test_small_rows_are_raised_and_the_others_keep_their_ratio() -> None:
    found = legible_shares([4.0, 2.0, 0.1])
    assert found[2] == LEAST_ROW
    assert found[0] / found[1] == pytest.approx(2.0)
    assert sum(found) == pytest.approx(1.0)


def test_shares_that_can_be_read_stay() -> None:
    assert legible_shares([3.0, 2.0, 1.0]) == pytest.approx([3 / 6, 2 / 6, 1 / 6])


@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=12))
def test_no_row_is_lower_than_can_be_read(shares: list[float]) -> None:
    found = legible_shares(shares)
    assert sum(found) == pytest.approx(1.0)
    assert min(found) >= min(LEAST_ROW, 1 / len(shares)) - 1e-9
    order = sorted(range(len(shares)), key=shares.__getitem__)
    assert all(found[a] <= found[b] + 1e-9 for a, b in pairwise(order))
