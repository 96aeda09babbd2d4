"""Compiled functions: kept where that can be, rows of numbers as numpy has them, several cores."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from groundtrace.compiled import compiled
from groundtrace.lanes import (
    LANES,
    LANES_32,
    absolute,
    column,
    cut_off,
    every,
    greater,
    in_lanes,
    lesser,
    put_row,
    row,
    row_from,
    zero_rows,
)
from groundtrace.logarithms import ROUGHNESS, logarithm, rough_logarithm
from groundtrace.tiles import TILE, turn

if TYPE_CHECKING:
    from pathlib import Path

RNG = np.random.default_rng(4)


@compiled
def _of_rows(one, other, samples, found):
    for i in range(len(one)):
        a, b = row(one, i), row(other, i)
        put_row(found[0], i, a + b)
        put_row(found[1], i, a - b)
        put_row(found[2], i, a * b)
        put_row(found[3], i, a / b)
        put_row(found[4], i, greater(a, b))
        put_row(found[5], i, lesser(a, every(0.25)))
        put_row(found[6], i, logarithm(b))
        put_row(found[7], i, column(samples, 1, i))
        put_row(found[8], i, rough_logarithm(b))
        put_row(found[9], i, absolute(a))
        put_row(found[10], i, cut_off(a, every(0.5)))


@pytest.mark.parametrize("kind", [np.int16, np.float64])
def test_a_row_is_counted_with_lane_by_lane(kind):
    one, other = RNG.normal(size=(5, LANES)), np.exp(RNG.uniform(-690, 700, (5, LANES)))
    other[0, :4] = [1e-300, 1.0, 0.999999, 2.0**0.5]
    samples = (100 * RNG.normal(size=(4, 5))).astype(kind)
    found = np.empty((11, 5, LANES))
    _of_rows(one, other, samples, found)
    expected = [one + other, one - other, one * other, one / other]
    expected += [np.maximum(one, other), np.minimum(one, 0.25)]
    assert np.array_equal(found[:6], expected)
    assert np.abs(found[6] - np.log(other)).max() <= 2e-16 * np.abs(np.log(other)).max()
    below = np.log(other) - found[8]
    assert (below >= 0).all()
    assert (below <= ROUGHNESS).all()
    assert np.array_equal(found[9], np.abs(one))
    assert np.array_equal(found[10], np.where(np.abs(one) < 0.5, 0.0, one))
    there = np.minimum(np.arange(1, 1 + LANES), len(samples) - 1)  # the last one stands for others
    assert np.array_equal(found[7], samples[there].T.astype(np.float64))


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


def _run(code: str, **environment: str) -> str:
    paths = os.pathsep.join(p for p in sys.path if p)
    given = os.environ | {"PYTHONPATH": paths} | environment
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=given, check=True, capture_output=True, text=True).stdout


def test_where_nothing_can_be_kept_functions_are_compiled_all_the_same(tmp_path: Path):
    code = (
        "from numba.core.caching import CacheImpl; CacheImpl._locator_classes = [];"
        "from groundtrace.compiled import compiled;"
        "print(compiled(lambda x: x + 1)(41))"
    )
    assert _run(code) == "42\n"
