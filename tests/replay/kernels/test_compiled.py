"""Compiled functions: kept where that can be, rows of numbers as numpy has them, several cores."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.kernels.compiling import inlined as compiled
from groundtrace.kernels.lanes import (
    LANES,
    LANES_32,
    absolute,
    cut_off,
    every,
    greater,
    in_lanes,
    lesser,
    multiply_add,
    put_row,
    row,
    row_from,
    zero_rows,
)

RNG = np.random.default_rng(4)


@compiled
def _of_rows(one, other, found):
    for i in range(len(one)):
        a, b = row(one, i), row(other, i)
        put_row(found[0], i, a + b)
        put_row(found[1], i, a - b)
        put_row(found[2], i, a * b)
        put_row(found[3], i, a / b)
        put_row(found[4], i, greater(a, b))
        put_row(found[5], i, lesser(a, every(0.25)))
        put_row(found[8], i, absolute(a))
        put_row(found[9], i, cut_off(a, every(0.5)))


def test_a_row_is_counted_with_lane_by_lane():
    one, other = RNG.normal(size=(5, LANES)), np.exp(RNG.uniform(-690, 700, (5, LANES)))
    other[0, :4] = [1e-300, 1.0, 0.999999, 2.0**0.5]
    found = np.empty((10, 5, LANES))
    _of_rows(one, other, found)
    expected = [one + other, one - other, one * other, one / other]
    expected += [np.maximum(one, other), np.minimum(one, 0.25)]
    assert np.array_equal(found[:6], expected)
    assert np.array_equal(found[8], np.abs(one))
    assert np.array_equal(found[9], np.where(np.abs(one) < 0.5, 0.0, one))


@compiled
def _of_a_sum(rows, found):
    put_row(found, 0, multiply_add(row(rows, 0), row(rows, 1), row(rows, 2)))


@pytest.mark.parametrize(("kind", "lanes"), [(np.float32, LANES_32), (np.float64, LANES)])
def test_a_product_and_a_sum_may_be_rounded_once(kind, lanes):
    rows = RNG.normal(size=(3, lanes)).astype(kind)
    found = np.empty((1, lanes), kind)
    _of_a_sum(rows, found)
    exact = rows[0].astype(np.longdouble) * rows[1] + rows[2]
    assert np.abs(found[0] - exact).max() <= 4 * np.finfo(kind).eps


def test_rows_of_numbers_begin_where_a_line_of_the_cache_does():
    rows = zero_rows(3, 5)
    assert rows.shape == (3, 5, LANES)
    assert rows.ctypes.data % (LANES * rows.itemsize) == 0
    assert not rows.any()
    lanes = in_lanes(np.arange(1.0, 10.0))
    assert lanes.shape == (2, 1, LANES)
    assert lanes.ravel().tolist() == [*range(1, 10), *[0] * 7]


@compiled
def _of_single_rows(one, found):
    put_row(found, 0, row(one, 1) * every(one[0, 3]) + row_from(one, 5))


def test_a_row_of_single_precision_is_counted_with_as_numpy_does():
    one = RNG.normal(size=(2, LANES_32)).astype(np.float32)
    found = np.empty((1, LANES_32), np.float32)
    _of_single_rows(one, found)
    assert np.array_equal(found[0], one[1] * one[0, 3] + one.ravel()[5 : 5 + LANES_32])
