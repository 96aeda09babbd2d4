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
    floating,
    greater,
    in_lanes,
    lesser,
    multiply_add,
    put_row,
    row,
    row_from,
    stored_row,
    zero_rows,
)
from groundtrace.kernels.logarithms import ROUGHNESS, logarithm, rough_logarithm
from groundtrace.kernels.picker import load
from groundtrace.kernels.tiles import TILE, turn

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
        put_row(found[6], i, logarithm(b))
        put_row(found[7], i, rough_logarithm(b))
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
    assert np.abs(found[6] - np.log(other)).max() <= 2e-16 * np.abs(np.log(other)).max()
    below = np.log(other) - found[7]
    assert (below >= 0).all()
    assert (below <= ROUGHNESS).all()
    assert np.array_equal(found[8], np.abs(one))
    assert np.array_equal(found[9], np.where(np.abs(one) < 0.5, 0.0, one))


@compiled
def _of_stored_rows(stored, found):
    one, other = stored_row(stored, 0), stored_row(stored, 1)
    put_row(found, 0, floating(one))
    put_row(found, 1, floating(greater(one, other)))
    put_row(found, 2, floating(lesser(one, other)))


@pytest.mark.parametrize("kind", [np.int16, np.uint16, np.int32, np.float32, np.float64])
def test_a_row_as_stored_is_compared_and_converted(kind):
    stored = RNG.uniform(-30_000, 30_000, (2, LANES)).astype(np.int16).astype(kind)
    found = np.empty((3, LANES))
    _of_stored_rows(stored, found)
    expected = [stored[0], np.maximum(*stored), np.minimum(*stored)]
    assert np.array_equal(found, np.array(expected, np.float64))


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


@compiled
def _loaded(samples, first, start, rows):
    load(samples, first, start, rows)


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.float32, np.float64])
@pytest.mark.parametrize("channels", [3, 11, 16])
def test_samples_are_put_into_lanes_the_last_channel_standing_for_others(channels, kind):
    samples = (100 * RNG.normal(size=(channels, 29))).astype(kind)
    rows = np.zeros((21, LANES), kind)
    _loaded(samples, LANES * (channels > LANES), 5, rows)
    there = np.minimum(np.arange(LANES) + LANES * (channels > LANES), channels - 1)
    assert np.array_equal(rows, samples[there, 5:26].T)


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


@compiled
def _turned(source, target):
    turn(source, 1, source.shape[1], target, 2, target.shape[1])


@pytest.mark.parametrize("kind", [np.int16, np.uint8, np.float32, np.float64])
@pytest.mark.parametrize("wanted", [np.float32, np.float64])
def test_a_square_is_turned_and_converted(kind, wanted):
    source = RNG.uniform(0, 255, (TILE, 11)).astype(kind)
    target = np.zeros((TILE, 12), wanted)
    _turned(source, target)
    expected = np.zeros_like(target)
    expected[:, 2 : 2 + TILE] = source[:, 1 : 1 + TILE].T
    assert np.array_equal(target, expected)
