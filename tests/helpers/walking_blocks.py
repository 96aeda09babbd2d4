"""Made-up walks for the tests of step detectors on the body: waist and foot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundtrace_codecs.signals import Channel, SignalBlock, Stream

START_NS = 1_700_000_000_000_000_000
G = 9.80665


@dataclass(frozen=True)
class Walk:
    """A block of signal, and when its steps were [s from its first sample]."""

    block: SignalBlock
    steps_s: np.ndarray


def imu(rate_hz: float, *, gyroscope: bool = True, topic: str = "/imu") -> Stream:
    channels = [Channel(f"acc_{a}", "acceleration", "m/s2", a) for a in "xyz"]
    if gyroscope:
        channels += [Channel(f"gyr_{a}", "angular_velocity", "rad/s", a) for a in "xyz"]
    return Stream(topic, tuple(channels), rate_hz)


def waist(
    rate_hz: float = 100.0, cadence_hz: float = 1.8, *, gyroscope: bool = True, rest_s: float = 3.0
) -> Walk:
    """Rest, 20 steps of various heights, rest; a step is a peak and a valley of 0.8 s at most."""
    rng = np.random.default_rng(5)
    length_s = 2 * rest_s + 20 / cadence_hz
    t = np.arange(round(length_s * rate_hz)) / rate_hz
    starts = rest_s + np.arange(20) / cadence_hz
    step_s = min(1 / cadence_hz, 0.8)
    wave = np.zeros(len(t))
    for start, height in zip(starts, rng.uniform(1.2, 2.8, 20), strict=True):
        part = (t >= start) & (t < start + step_s)
        wave[part] = height * np.sin(2 * np.pi * (t[part] - start) / step_s)
    samples = rng.normal(0, 0.02, (len(t), 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
    samples[:, 2] += G + wave
    samples[:, 3] += 1.0 + 0.4 * wave
    kept = samples if gyroscope else samples[:, :3]
    block = SignalBlock(imu(rate_hz, gyroscope=gyroscope), START_NS, 0, kept)
    return Walk(block, starts + step_s / 4)


def foot(
    rate_hz: float = 200.0, *, gyroscope: bool = True, strides: int = 8, stance_s: float = 0.5
) -> Walk:
    """Stand 2 s, then swings of 0.5 s and stances; the last stance lasts 2 s."""
    swing_s, rest_s = 0.5, 2.0
    starts = rest_s + np.arange(strides) * (swing_s + stance_s)
    t = np.arange(round((starts[-1] + swing_s + rest_s) * rate_hz)) / rate_hz
    rng = np.random.default_rng(6)
    samples = rng.normal(0, 0.05, (len(t), 6))
    samples[:, 2] += G
    for start in starts:
        part = (t >= start) & (t < start + swing_s)
        phase = (t[part] - start) / swing_s
        samples[part, 0] += 15 * np.sin(2 * np.pi * phase)
        samples[part, 2] += 8 * np.sin(np.pi * phase) ** 2
        samples[part, 4] += 5 * np.sin(np.pi * phase)
    kept = samples if gyroscope else samples[:, :3]
    stream = imu(rate_hz, gyroscope=gyroscope, topic="/imu/foot")
    return Walk(SignalBlock(stream, START_NS, 0, kept), starts + swing_s)
