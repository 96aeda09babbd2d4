"""Power of windows: what a transform of each window gives."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.dsp.spectral import WindowPower

N = 700
SAMPLES = np.random.default_rng(2).integers(-3000, 3000, (2, N)).astype(np.int16)


def transformed(
    x: np.ndarray, taper: np.ndarray, transform: int, hop: int, *, mean_removed: bool
) -> np.ndarray:
    pieces = np.lib.stride_tricks.sliding_window_view(x.astype(np.float64), len(taper))[::hop]
    if mean_removed:
        pieces = pieces - pieces.mean(axis=1, keepdims=True)
    return np.abs(np.fft.rfft(pieces * taper, transform)) ** 2


@pytest.mark.parametrize(
    ("window", "hop", "transform"),
    [(60, 30, 60), (60, 30, 120), (17, 5, 64), (16, 40, 20), (17, 3, 17), (12, 1, 12), (1, 1, 2)],
)
@pytest.mark.parametrize("mean_removed", [False, True])
def test_power_is_that_of_a_fourier_transform(window, hop, transform, mean_removed):
    taper = np.hamming(window)
    expected = transformed(SAMPLES[0], taper, transform, hop, mean_removed=mean_removed)
    power = WindowPower(taper, transform, mean_removed=mean_removed)
    assert np.allclose(power(SAMPLES[0], 0, hop, len(expected)), expected, atol=1e-6)
    few = WindowPower(taper, transform, 7, mean_removed=mean_removed, kind=np.float32)
    found = few(SAMPLES[0], hop, hop, len(expected) - 1)
    assert found.dtype == np.float32
    assert np.allclose(found[:, : expected.shape[1]], expected[1:, :7], atol=1e-6 * expected.max())


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_channels_are_those_alone_and_windows_those_from_elsewhere(kind):
    power = WindowPower(np.hamming(60), 60, kind=kind)
    both = power(SAMPLES, 0, 30, 22)
    assert np.array_equal(both[1], power(SAMPLES[1], 0, 30, 22))
    assert np.array_equal(both[0, 5:], power(SAMPLES[0], 150, 30, 17))  # in other lanes


@pytest.mark.parametrize("cut", [1, 59, 60, 333, 699])
def test_windows_that_begin_in_what_came_before_are_those_of_the_whole(cut: int) -> None:
    power = WindowPower(np.hamming(60), 60)
    before, after = SAMPLES[:, :cut].copy(), SAMPLES[:, cut:].copy()
    assert np.array_equal(power(after, -cut, 30, 22, before), power(SAMPLES, 0, 30, 22))
