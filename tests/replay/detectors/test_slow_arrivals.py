"""The compiled TOA-CV against the plain one: the same candidates, decisions and frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from replay_blocks import START_NS, stream_of
from slow_arrivals import slow_toa_cv

from groundtrace.detectors.variance_change import VarianceChange
from groundtrace.pipeline.conformance import outcome, rechunked
from groundtrace.pipeline.gates import Candidates, decide
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.signals import SignalBlock


def footsteps(channels: int, rate_hz: float, kind: type, seed: int) -> SignalBlock:
    """Four seconds of noise and decaying bursts; a channel clips, one is silent for a while."""
    rng = np.random.default_rng(seed)
    n = round(4 * rate_hz)
    x = rng.normal(0, 30, (n, channels))
    wave = np.exp(-np.arange(n) / (0.02 * rate_hz)) * np.sin(np.arange(n) * 0.3)
    for time_s in np.arange(0.3, 3.9, 0.55):
        for channel in range(channels):
            at = round((time_s + rng.uniform(0, 0.01)) * rate_hz)
            x[at:, channel] += rng.uniform(200, 9000) * wave[: n - at]
    x[:, 0] = np.clip(x[:, 0], -2500, 2500)
    x[round(1.2 * rate_hz) : round(1.4 * rate_hz), -1] = 0.0
    samples = x.astype(kind)
    return SignalBlock(stream_of(channels, rate_hz), START_NS, 0, samples)


@pytest.mark.parametrize(
    ("channels", "rate_hz", "kind"),
    [
        (16, 20_000.0, np.int16),
        (9, 4_000.0, np.int32),
        (3, 1_000.0, np.float32),
        (1, 500.0, np.float64),
    ],
)
@pytest.mark.parametrize("low_hz", [20.0, 0.0])
def test_the_compiled_picker_says_what_the_plain_one_says(channels, rate_hz, kind, low_hz):
    block = footsteps(channels, rate_hz, kind, seed=channels)
    parameters = VarianceChange.Parameters(low_hz=low_hz)
    slow = slow_toa_cv(block, parameters)
    columns, gates = VarianceChange.columns, VarianceChange.gates
    candidates = Candidates(slow.time_ns, slow.channel.astype(np.int32), slow.value)
    decisions, _ = decide(candidates, columns, gates, parameters)
    assert decisions.accepted.sum() >= channels
    for size in (10**9, round(0.3 * rate_hz) + 1):
        stage = StageRunner(StageConfig("toa-cv", "picks"), VarianceChange, parameters)
        events = [e for item in rechunked([block], size) for e in stage.process(item)]
        found = outcome([*events, *stage.flush()])
        assert np.array_equal(found.times, slow.time_ns)
        assert np.array_equal(found.channels, slow.channel)
        assert np.array_equal(found.accepted, decisions.accepted)
        assert np.allclose(found.values, slow.value, rtol=1e-6)
        assert np.allclose(found.trace, slow.frames, rtol=1e-6, atol=1e-12)


def test_a_sensor_whose_scale_is_negative_is_picked_as_the_plain_picker_does():
    block = footsteps(9, 4_000.0, np.int16, seed=1)
    turned = tuple(replace(c, scale=-2e-3) for c in block.stream.channels)
    block = replace(block, stream=replace(block.stream, channels=turned))
    parameters = VarianceChange.Parameters()
    slow = slow_toa_cv(block, parameters)
    stage = StageRunner(StageConfig("toa-cv", "picks"), VarianceChange, parameters)
    found = outcome([*stage.process(block), *stage.flush()])
    assert np.array_equal(found.times, slow.time_ns)
    assert np.allclose(found.trace, slow.frames, rtol=1e-6, atol=1e-12)


def test_a_sensor_that_comes_alive_after_long_silence_is_no_arrival():
    rng = np.random.default_rng(3)
    x = rng.normal(0, 300, (10_000, 2))
    x[2_000:8_000] = 0.0
    block = SignalBlock(stream_of(2, 2_000.0), START_NS, 0, x)
    stage = StageRunner(StageConfig("toa-cv", "picks"), VarianceChange, VarianceChange.Parameters())
    found = outcome([*stage.process(block), *stage.flush()])
    assert not ((found.times - START_NS) // 1_000_000 == 4_000).any()
