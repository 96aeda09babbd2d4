"""Arrivals by the statistics of noise: the thesis's three rules as one level; late by how much."""

from __future__ import annotations

import numpy as np
import pytest
from pickers import emergent, figures, lateness

from groundtrace.detectors.noise_statistics import STRETCHES, NoiseStatistics
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Pick
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

RATE_HZ = 20_000.0


def picks(samples: np.ndarray, **given: float) -> list[Pick]:
    parameters = NoiseStatistics.Parameters(low_hz=0.0, high_hz=0.0, **given)
    stream = Stream("/s", (Channel("G1", "seismic", "count"),), RATE_HZ)
    runner = StageRunner(StageConfig("toa-sb", "picks"), NoiseStatistics, parameters)
    events = [*runner.process(SignalBlock(stream, 0, 0, samples[:, None])), *runner.flush()]
    return [e for e in events if isinstance(e, Pick)]


def noise(n: int = 8000, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


def burst(length_s: float, size: float = 20.0) -> np.ndarray:
    """Noise with a square wave of 1 kHz for a while, from 0.2 s on."""
    x = noise()
    n = round(length_s * RATE_HZ)
    x[4000 : 4000 + n] += size * np.sign(np.sin(2 * np.pi * 0.05 * (np.arange(n) + 0.5)))
    return x


def test_a_signal_that_stays_outside_the_noise_is_an_arrival() -> None:
    (found,) = picks(burst(0.03))
    assert found.time_ns / 1e9 == pytest.approx(0.2, abs=2e-4)
    assert found.uncertainty_s < 1e-3


@pytest.mark.parametrize(("length_s", "count"), [(0.0042, 0), (0.0058, 1)])
def test_half_of_ten_milliseconds_must_be_outside(length_s: float, count: int) -> None:
    assert len(picks(burst(length_s))) == count


def test_the_level_is_that_at_which_the_rules_of_the_thesis_just_hold() -> None:
    x = burst(0.03)
    (found,) = picks(x, noise_s=0.05)
    sigma = x[:3900].std()
    held = []
    for k in range(4000, 4200):
        parts = [x[k + 1 : k + 1 + round(s * RATE_HZ)] for s, _ in STRETCHES]
        levels = [
            np.sort(np.abs(p))[len(p) - int(np.ceil(part * len(p)))]
            for p, (_, part) in zip(parts, STRETCHES, strict=True)
        ]
        held.append(min(abs(x[k]), *levels))
    assert found.value == pytest.approx(max(held) / sigma, rel=0.25)


def test_noise_alone_has_no_arrivals() -> None:
    assert picks(noise(200_000)) == []


@pytest.mark.parametrize(("peak", "bias_ms", "near"), [(10, 0.45, 0.95), (20, 0.22, 0.99)])
@pytest.mark.parametrize("name", ["toa-sb", "toa-cv"])
def test_emergent_signals_are_picked_no_later_than_the_rules_alone_do(
    name: str, peak: int, bias_ms: float, near: float
) -> None:
    late = lateness(name, emergent(peak, 60, np.random.default_rng(peak)))
    bias, spread, part, found = figures(late)
    assert found == 1.0
    assert 0 <= bias <= bias_ms
    assert spread <= 0.21
    assert part >= near
