"""Rails on slow waves at a high rate: two tops of one side that share a level."""

from __future__ import annotations

import numpy as np
import pytest

from groundtrace.detectors.fault_scan import FaultScan
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

RATE_HZ = 8000.0


def kinds(samples: np.ndarray) -> set[str]:
    stream = Stream("/s", (Channel("G1", "voltage", "V"),), RATE_HZ)
    scan, block = FaultScan(stream), SignalBlock(stream, 0, 0, samples[:, None])
    scan.recorded(block)
    scan.update(block)
    return {found.kind for found in scan.findings()}


def wave(seed: int, tops: int) -> np.ndarray:
    """Swings of 30 Hz that differ in height, in noise of 0.05 %."""
    rng = np.random.default_rng(seed)
    t = np.arange(8000) / RATE_HZ
    size = np.exp(-30 * (t - 0.3) ** 2 * (9 if tops == 1 else 1))
    return 1e6 * (size * np.sin(2 * np.pi * 30 * t) + rng.normal(0, 5e-4, len(t)))


@pytest.mark.parametrize("seed", range(4))
def test_a_rail_that_wanders_is_told_on_either_side_and_a_wave_is_not(seed: int) -> None:
    whole = wave(seed, tops=9)
    rng = np.random.default_rng(seed)
    rail = 5e5 * np.repeat(rng.uniform(0.998, 1.002, 20), 400) + rng.normal(0, 250, 8000)
    assert "clipped" not in kinds(np.rint(whole))
    assert "clipped" in kinds(np.rint(np.minimum(whole, rail)))
    assert "clipped" in kinds(np.rint(np.maximum(whole, -rail)))


def test_one_flat_top_is_no_rail() -> None:
    whole = wave(1, tops=1)
    highest = np.sort(whole)[-1]
    rng = np.random.default_rng(1)
    cut = np.minimum(whole, 0.93 * highest + rng.normal(0, 250, len(whole)))
    assert "clipped" not in kinds(np.rint(cut))
