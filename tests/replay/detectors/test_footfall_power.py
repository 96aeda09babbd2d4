"""Footfalls by power: found at any rate, beside hum, where no onset is; and noise is not one."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from groundtrace.detectors.footfall_power import FootfallPower, FootfallPowerParameters, UsualPower
from groundtrace.pipeline.conformance import assert_same, rechunked, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import Note, Pick
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

STEPS_S = np.arange(3.0, 18.0, 0.6)
Array = np.ndarray[Any, np.dtype[np.float64]]


def stage() -> StageRunner:
    return StageRunner(StageConfig("footfall-power"), FootfallPower, FootfallPowerParameters())


def block_of(signal: Array, rate_hz: float) -> SignalBlock:
    channels = tuple(
        Channel(f"G{i}", "ground_velocity", "m/s", "z") for i in range(signal.shape[1])
    )
    return SignalBlock(Stream("/floor", channels, rate_hz), 0, 0, signal)


@cache
def noise(rate_hz: float, seconds: float = 20.0) -> Array:
    samples = np.random.default_rng(5).standard_normal((round(seconds * rate_hz), 1))
    samples.setflags(write=False)
    return samples


def walk(rate_hz: float, strength: float) -> Array:
    """Swings of 12 to 35 Hz of a tenth of a second, with a slow begin, in white noise of 1."""
    t = np.arange(len(noise(rate_hz)))[:, None] / rate_hz
    signal = noise(rate_hz).copy()
    for k, at_s in enumerate(STEPS_S):
        swing = np.sin(2 * np.pi * (12 + 23 * (k % 5) / 4) * (t - at_s))
        signal += strength * swing * np.exp(-(((t - at_s) / 0.05) ** 2))
    return signal


def picks_of(signal: Array, rate_hz: float) -> Array:
    events = run(stage(), [block_of(signal, rate_hz)]).events
    return np.array([e.time_ns / NS_PER_S for e in events if isinstance(e, Pick)])


def found(picks: Array, within_s: float = 0.05) -> int:
    return int(sum(np.abs(picks - at_s).min(initial=np.inf) < within_s for at_s in STEPS_S))


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 500.0, 4000.0, 20_000.0])
def test_footfalls_without_an_onset_are_found_at_any_rate(rate_hz: float) -> None:
    # as strong over white noise, which a higher rate spreads over more frequencies
    picks = picks_of(walk(rate_hz, 4.0 * np.sqrt(rate_hz / 100)), rate_hz)
    assert found(picks) >= len(STEPS_S) - 1
    assert len(picks) <= len(STEPS_S) + 2


def test_hum_does_not_hide_what_is_beside_it() -> None:
    rate_hz = 500.0
    signal = walk(rate_hz, 8.0)
    hum = 20 * np.sin(2 * np.pi * 50 * np.arange(len(signal)) / rate_hz)
    assert found(picks_of(signal + hum[:, None], rate_hz)) == len(STEPS_S)


@pytest.mark.parametrize(("rate_hz", "most"), [(100.0, 3), (500.0, 0), (4000.0, 0)])
def test_noise_is_no_footfall(rate_hz: float, most: int) -> None:
    assert len(picks_of(noise(rate_hz), rate_hz)) <= most


def test_a_silent_line_is_no_footfall_and_what_breaks_the_silence_is_one() -> None:
    rate_hz = 500.0
    signal = np.zeros((round(10 * rate_hz), 1))
    assert not len(picks_of(signal, rate_hz))
    signal[3000:3050] = np.sin(np.arange(50))[:, None]
    picks = picks_of(signal, rate_hz)
    assert len(picks) == 1
    assert abs(picks[0] - 3025 / rate_hz) < 0.03


@pytest.mark.parametrize("hops", [40, 66, 87, 88, 110])
def test_a_run_that_ends_before_anything_is_usual_is_judged_by_what_there_is(hops: int) -> None:
    rate_hz, hop = 500.0, 11  # samples of a hop; 22 of them are a chunk
    signal = noise(rate_hz)[: hops * hop].copy()
    middle = len(signal) // 2
    signal[middle - 20 : middle + 20] *= 30
    assert len(picks_of(signal, rate_hz)) == 1


@pytest.mark.parametrize("offset", [0.0, 1e3])
def test_what_a_line_stands_at_is_no_power(offset: float) -> None:
    rate_hz = 200.0
    signal = walk(rate_hz, 6.0)
    np.testing.assert_allclose(
        picks_of(signal + offset, rate_hz), picks_of(signal, rate_hz), atol=1e-6
    )


@pytest.mark.parametrize("size", [1, 7, 333, 4000])
def test_the_picks_are_the_same_whatever_the_blocks(size: int) -> None:
    signal = np.concatenate([walk(500.0, 6.0)[:4000]] * 2, axis=1)
    blocks = [block_of(signal, 500.0)]
    assert_same(run(stage(), blocks), run(stage(), rechunked(blocks, size)), f"blocks of {size}")


def test_the_trace_has_the_ratio_that_a_pick_has() -> None:
    made = run(stage(), [block_of(walk(500.0, 8.0), 500.0)])
    picks = [e for e in made.events if isinstance(e, Pick)]
    times, ratios = made.trace_times, made.trace[:, 0, 0]
    for pick in picks:
        frame = int(np.searchsorted(times, pick.time_ns, side="right")) - 1
        near = ratios[max(frame - 1, 0) : frame + 2]
        assert near.max() == pytest.approx(pick.value, rel=1e-5)


def test_a_rate_with_too_few_frequencies_is_said() -> None:
    runner = stage()
    events = runner.process(block_of(noise(25.0), 25.0)) + runner.flush()
    (note,) = [e for e in events if isinstance(e, Note)]
    assert "expected at least 6 frequencies from 5 to 400 Hz in windows of 0.25 s" in note.text
    assert "at 25 Hz" in note.text


def test_the_usual_is_the_median_of_the_last_seconds() -> None:
    rng = np.random.default_rng(0)
    power = rng.exponential(1.0, (22 * 40, 1, 60)) * np.linspace(1, 100, 60)
    ratios = UsualPower(20).ratios(power)
    assert ratios.shape == (1, len(power))
    assert ratios.mean() == pytest.approx(1.0, abs=0.05)
