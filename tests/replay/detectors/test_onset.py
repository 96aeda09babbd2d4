"""Onsets by AIC: Maeda's formula, and a change of variance found where it is."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.kernels.picker import EDGE, criterion_of, onsets


def aic(windows: np.ndarray) -> np.ndarray:
    """Return AIC(k) for k = 1 ... n-1 of windows of shape (m, n); shape (m, n-1)."""
    m, n = windows.shape
    found = np.empty((m, n))
    for window, own in zip(np.ascontiguousarray(windows), found, strict=True):
        criterion_of(window, np.inf, np.empty((3, n)), own)
    return found[:, : n - 1]


def aic_onset(windows: np.ndarray, correlation: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the onset in each window and its standard deviation, both in samples.

    Parameters
    ----------
    windows
        Shape (m, n), as :func:`onsets` takes them one by one.
    correlation
        Correlation length of the signal [samples].

    Returns
    -------
    onset
        Shape (m,): index of the first sample of the signal, with fraction.
    deviation
        Shape (m,).
    """
    m, n = windows.shape
    rows = np.ascontiguousarray(windows.T, dtype=np.float64)
    starts, lengths = np.zeros(m, np.intp), np.full(m, n, np.intp)
    found = onsets(rows, starts, lengths, np.arange(m), correlation)
    return found[0], found[1]


def maeda(window: np.ndarray) -> list[float]:
    """AIC(k) = k ln var(x[:k]) + (n - k) ln var(x[k:]) by plain loops."""

    def variance(x: list[float]) -> float:
        mean = sum(x) / len(x)
        return sum((v - mean) ** 2 for v in x) / len(x)

    x, n = window.tolist(), len(window)
    return [
        k * np.log(variance(x[:k])) + (n - k) * np.log(variance(x[k:])) for k in range(2, n - 1)
    ]


def bursts(count: int, n: int, onset: int, ratio: float, seed: int = 0) -> np.ndarray:
    """Windows of noise whose amplitude grows by ``ratio`` at ``onset``."""
    x = np.random.default_rng(seed).normal(size=(count, n))
    x[:, onset:] *= ratio
    return x


def test_the_criterion_is_maedas_formula():
    windows = bursts(5, 60, 33, 8.0)
    expected = [maeda(w) for w in windows]
    # a side of a few samples may have hardly any variance, which is bounded below: left out
    inner = slice(EDGE, -EDGE)
    assert np.allclose(aic(windows)[:, 1:-1][:, inner], np.array(expected)[:, inner], atol=1e-3)


def test_far_from_the_least_the_criterion_is_rough_but_above_what_matters():
    (window,) = bursts(1, 200, 120, 20.0)
    (exact,), margin, found = aic(window[None, :]), 30.0, np.empty(200)
    start, stop = criterion_of(window, margin, np.empty((3, 200)), found)
    inner = slice(EDGE, -EDGE)
    exact, rough = exact[inner], found[:199][inner]
    near = exact <= exact.min() + margin
    assert np.array_equal(rough[near], exact[near])
    assert (rough[~near] > exact.min() + margin).all()
    assert (rough != exact).any()
    assert not near[: start - EDGE].any()
    assert not near[stop - EDGE :].any()


def test_the_criterion_does_not_depend_on_an_offset():
    windows = bursts(5, 60, 33, 8.0)
    assert np.allclose(aic(windows)[:, 1:-1], aic(windows + 10.0)[:, 1:-1], atol=1e-3)


@pytest.mark.parametrize("onset", [20, 100, 180])
def test_the_least_criterion_is_where_the_plain_loop_has_it(onset):
    window = bursts(1, 200, onset, 20.0)[0]
    least = 2 + int(np.argmin(maeda(window)[2:-2])) + 2
    found, _ = aic_onset(window[None, :], 0.0)
    assert abs(found[0] - least) <= 1.0


@pytest.mark.parametrize("n", [100, 201])
@pytest.mark.parametrize("part", [0.3, 0.5, 0.8])
def test_a_change_of_variance_is_found_within_a_sample_or_so(n, part):
    onset = round(part * n)
    found, deviation = aic_onset(bursts(200, n, onset, 30.0, seed=n), 0.0)
    assert abs(np.median(found) - onset) < 0.75
    assert np.mean(np.abs(found - onset) <= 2.0) > 0.95
    assert np.median(deviation) < 1.0


def test_the_deviation_tells_how_far_off_the_onset_is():
    strong, weak = (aic_onset(bursts(300, 120, 60, r), 0.0) for r in (30.0, 2.5))
    for found, deviation in (strong, weak):
        error = np.sqrt(np.median((found - 60) ** 2))
        assert error < 2 * np.median(deviation) + 0.5
    assert np.median(weak[1]) > 4 * np.median(strong[1])


def test_a_long_correlation_widens_the_deviation():
    windows = bursts(50, 120, 60, 4.0)
    assert (aic_onset(windows, 10.0)[1] > aic_onset(windows, 1.0)[1]).mean() > 0.95


def test_scale_and_offset_change_nothing():
    windows = bursts(20, 120, 60, 10.0)
    found, deviation = aic_onset(windows, 0.0)
    for changed in (windows * 1e-9, windows * 1e6, windows + 1e4):
        again, spread = aic_onset(changed, 0.0)
        assert np.allclose(again, found, atol=1e-3)
        assert np.allclose(spread, deviation, atol=1e-3)


@pytest.mark.parametrize("n", [30, 90, 301])
def test_windows_do_not_depend_on_each_other(n):
    windows = bursts(40, n, n // 2, 10.0)
    together = np.array(aic_onset(windows, 2.0))
    for size in (1, 3, 7):
        parts = [aic_onset(windows[i : i + size], 2.0) for i in range(0, 40, size)]
        assert np.array_equal(np.concatenate(parts, axis=1), together)


@pytest.mark.parametrize("n", [1, 2 * EDGE + 2])
def test_a_window_too_short_for_two_variances_gives_its_middle(n):
    found, deviation = aic_onset(np.ones((3, n)), 0.0)
    assert found.tolist() == [n / 2] * 3
    assert np.allclose(deviation, n / np.sqrt(12))


@pytest.mark.parametrize("value", [0.0, 7.0, -1e-300])
def test_a_constant_window_gives_its_middle_and_a_wide_deviation(value):
    found, deviation = aic_onset(np.full((2, 41), value), 0.0)
    assert np.allclose(found, 20.5, atol=0.5)
    assert (deviation > 5).all()


def test_a_signal_out_of_perfect_silence_is_found():
    window = np.zeros((1, 100))
    window[0, 60:] = np.random.default_rng(1).normal(size=40)
    found, _ = aic_onset(window, 0.0)
    assert abs(found[0] - 60) <= 1.0
