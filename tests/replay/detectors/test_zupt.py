"""ZUPT: stances of a foot, the steps they begin with, and the statistic they rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walking_blocks import START_NS, Walk, foot, waist

from groundtrace.detectors.zero_velocity import (
    ZeroVelocityDetector,
    ZeroVelocityParameters,
    ZeroVelocityStatistic,
)
from groundtrace.pipeline.conformance import check_stage, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.signals import NS_PER_S

LEAD = ZeroVelocityParameters().lead_s


def detected(walk: Walk, **changes: float):
    parameters = ZeroVelocityParameters(**changes)
    return run(
        StageRunner(StageConfig("zupt", "steps"), ZeroVelocityDetector, parameters), [walk.block]
    )


def statistic_of(samples: np.ndarray, window: int, p: ZeroVelocityParameters) -> np.ndarray:
    """The definition, window by window."""
    out = []
    for end in range(window, len(samples) + 1):
        a, w = samples[end - window : end, :3], samples[end - window : end, 3:]
        mean = a.mean(axis=0)
        off = a - p.gravity * mean / np.linalg.norm(mean)
        out.append(
            (off**2).sum(axis=1).mean() / p.acceleration_sigma**2
            + (w**2).sum(axis=1).mean() / p.rotation_sigma**2
        )
    return np.array(out)


def test_the_statistic_is_what_its_definition_says() -> None:
    p = ZeroVelocityParameters(window_s=0.05)
    samples = foot().block.samples
    found = ZeroVelocityStatistic(200.0, p)(samples[:, :3].T, samples[:, 3:].T)
    assert np.allclose(found[9:], statistic_of(samples, 10, p), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("gyroscope", [True, False])
@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_every_stance_after_a_swing_is_a_step(rate_hz: float, gyroscope: bool) -> None:
    walk = foot(rate_hz, gyroscope=gyroscope)
    found = detected(walk)
    starts = (found.times - START_NS) / NS_PER_S + LEAD
    assert found.accepted.tolist() == [False] + [True] * 8  # it stood before it first swung
    assert np.abs(starts[1:] - walk.steps_s).max() <= 0.05
    # a swing begins smoothly: the accelerometer alone sees it late
    late_s = 0.08 if gyroscope else 0.15
    assert np.allclose(found.values[1:-1, 1], 0.5, atol=late_s)
    assert found.values[-1, 1] == pytest.approx(2.0, abs=0.08)


@pytest.mark.parametrize("gyroscope", [True, False])
def test_it_conforms_on_a_foot(gyroscope: bool) -> None:
    assert check_stage(ZeroVelocityDetector, [foot(gyroscope=gyroscope).block]).accepted.any()


def test_a_window_of_one_sample_works_too() -> None:
    assert detected(foot(20.0), window_s=0.01, floor=0.1).accepted.sum() == 8


def test_no_candidate_lies_before_the_recording() -> None:
    walk = foot()
    at_zero = replace(walk, block=replace(walk.block, anchor_ns=0))
    assert detected(at_zero).times.min() == 0


def test_stance_at_the_waist_is_not_taken_for_steps() -> None:
    assert not detected(waist()).accepted.any()


def test_only_the_angular_rate_counts_where_the_acceleration_is_not_trusted() -> None:
    walk = foot()
    shaken = np.array(walk.block.samples)
    shaken[:, 0] += np.random.default_rng(1).normal(0, 12.0, len(shaken))
    noisy = replace(walk, block=replace(walk.block, samples=shaken))
    assert detected(noisy).accepted.sum() < 8
    assert detected(noisy, acceleration_sigma=1e3).accepted.sum() == 8
