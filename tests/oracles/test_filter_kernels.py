"""Kernels of filters against scipy's, bit by bit, on any signal in blocks of any length."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from plain_python import inputs
from scipy import signal

from groundtrace.dsp.filters import bandpass
from groundtrace.kernels import filters

if TYPE_CHECKING:
    from collections.abc import Callable

CHANNELS = inputs((1, 3, 16), (1, 3))


def signals(channels: int) -> dict[str, np.ndarray]:
    """Return signals, each (channels, 200)."""
    noise = np.random.default_rng(channels).normal(3.0, 1.0, (channels, 200))
    hostile = noise.copy()
    hostile[:, 150], hostile[-1, 180] = np.nan, -np.inf
    return {
        "noise": noise,
        "zeros": 0.0 * noise,
        "out of silence": np.where(np.arange(200) < 90, 0.0, noise),
        "denormal": 5e-324 * np.round(9 * noise),
        "large": 1e300 * noise,
        "not finite": hostile,
    }


CASES = [(channels, name) for channels in CHANNELS for name in signals(1)]


def in_blocks(kernel: Callable[..., None], x: np.ndarray, seed: int, *given: object) -> np.ndarray:
    """Run a kernel over a signal cut into blocks, one of them empty."""
    cuts = np.sort(np.random.default_rng(seed).integers(0, x.shape[1], 5))
    edges = [0, *cuts.tolist(), int(cuts[-1]), x.shape[1]]
    parts = []
    for a, b in pairwise(edges):
        block = np.ascontiguousarray(x[:, a:b])
        parts.append(np.empty(block.shape))
        kernel(block, *given, parts[-1])
    return np.concatenate(parts, axis=1)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
@pytest.mark.parametrize(("channels", "name"), CASES)
@pytest.mark.parametrize("band", [(5.0, 100.0), (0.0, 3.5), (20.0, 0.0)], ids=str)
def test_sections_are_those_of_scipy(channels: int, name: str, band: tuple[float, float]) -> None:
    x, sos = signals(channels)[name], bandpass(*band, 1000.0)
    held = np.random.default_rng(1).normal(size=(len(sos), channels, 2))
    expected, left = signal.sosfilt(sos, x, axis=1, zi=held)
    found = in_blocks(filters.sections, x, 2, sos, held)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(held, left)


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
@pytest.mark.parametrize(("channels", "name"), CASES)
@pytest.mark.parametrize("length", [1, 2, 31])
def test_weighted_sums_are_those_of_scipy(channels: int, name: str, length: int) -> None:
    x = signals(channels)[name]
    weights = np.random.default_rng(length).normal(size=length)
    held = np.zeros((channels, length))
    # two terms of the denominator, or scipy convolves; what is infinite it takes times 0
    expected = np.array([signal.lfilter(weights, [1.0, 0.0], row) for row in x])
    found = in_blocks(filters.weighted, x, 3, weights, held)
    known = np.isfinite(x).cumprod(axis=1) > 0
    np.testing.assert_array_equal(found[known], expected[known])


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
@pytest.mark.parametrize(("channels", "name"), CASES)
@pytest.mark.parametrize("coefficient", [0.001, 0.07, 1.0])
def test_recursive_means_are_those_of_scipy(channels: int, name: str, coefficient: float) -> None:
    x, held = signals(channels)[name], np.zeros(channels)
    expected = signal.lfilter([coefficient], [1.0, coefficient - 1.0], x, axis=1)
    found = in_blocks(filters.recursive_means, x, 4, coefficient, held)
    known = np.isfinite(x).cumprod(axis=1) > 0
    np.testing.assert_array_equal(found[known], expected[known])
