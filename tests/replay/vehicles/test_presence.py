"""What tells a vehicle from footsteps and blows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtrace.vehicles.presence import CyclePower, Features, PresenceFeatures, spectral_shape

RATE = 200.0
NAMES = ("flatness", "centroid_hz")


def times_of(n: int) -> np.ndarray:
    return 1_700_000_000_300_000_000 + (np.arange(n) * (1e9 / RATE)).astype(np.int64)


def vehicle(seconds: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(1, int(seconds * RATE)))


def steps(seconds: float, hz: float, seed: int = 0) -> np.ndarray:
    """Footsteps that ring at 20 Hz for 50 ms, with a tenth of the noise of a vehicle below."""
    x = 0.1 * vehicle(seconds, seed)
    t = np.arange(60) / RATE
    ring = 3 * np.exp(-t / 0.05) * np.sin(2 * np.pi * 20 * t)
    rng = np.random.default_rng(seed)
    for step in np.arange(0.3, seconds - 0.5, 1 / hz):
        start = int((step + rng.normal(0, 0.01)) * RATE)
        x[0, start : start + 60] += ring * rng.uniform(0.7, 1.3)
    return x


def features(x: np.ndarray) -> Features:
    return PresenceFeatures(RATE, 1).add(times_of(x.shape[1]), x)


def test_footsteps_lift_the_mean_power_and_not_the_running_median() -> None:
    quiet, walks = 0.1 * vehicle(60), steps(60, 1.9)
    found = [CyclePower(RATE, 1, 0.5).add(times_of(x.shape[1]), x) for x in (quiet, walks)]
    still, walked = (10 * np.log10(np.median(f.steady)) for f in found)
    means = [10 * np.log10(np.mean(x**2)) for x in (quiet, walks)]
    lifted = means[1] - means[0]
    assert lifted > 12
    assert walked - still < 0.6 * lifted
    assert 10 * np.log10(np.median(found[1].power) / np.median(found[0].power)) < lifted / 2 + 3


def test_the_spectrum_of_a_line_is_not_flat() -> None:
    t = np.arange(800) / RATE
    x = np.stack([vehicle(4)[0], np.sin(2 * np.pi * 12 * t)])
    flatness, centroid = spectral_shape(x, RATE, (5, 40))
    assert flatness[0] > 0.75
    assert flatness[1] < 0.05
    assert centroid == pytest.approx([22.5, 12], abs=2.5)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 900), max_size=6))
def test_features_do_not_depend_on_the_blocks(sizes: list[int]) -> None:
    x, times = steps(9.5, 1.9), times_of(1900)
    expected = features(x)
    stream = PresenceFeatures(RATE, 1)
    edges = np.minimum(np.cumsum([0, *sizes, 1900]), 1900).tolist()
    found = [stream.add(times[a:b], x[:, a:b]) for a, b in pairwise(edges)]
    assert np.array_equal(np.concatenate([f.time_ns for f in found]), expected.time_ns)
    assert set(expected.time_ns % 1_000_000_000) == {0}
    assert len(expected.time_ns) == 5
    for name in NAMES:
        joined = np.concatenate([getattr(f, name) for f in found], axis=1)
        assert np.array_equal(joined, getattr(expected, name)), name


def test_a_silent_channel_has_features() -> None:
    found = features(np.zeros((1, 2000)))
    assert all(np.isfinite(getattr(found, name)).all() for name in NAMES)
