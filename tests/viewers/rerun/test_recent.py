from __future__ import annotations

import numpy as np
import pytest
from viewer_sessions import IMU, SEISMIC, at, blocks, imu_samples, seismic_samples

from groundtrace_codecs.events import Pick
from groundtrace_viewers.rerun.samples import RecentSamples, Traces


@pytest.mark.parametrize("rows", [1, 40, 12_000])
def test_a_span_is_the_same_whatever_the_blocks(rows: int) -> None:
    samples = seismic_samples()[:400]
    recent = RecentSamples(SEISMIC)
    for block in blocks(SEISMIC, samples, rows):
        recent.push(block)
    pieces = list(recent.between(at(0.05), at(0.1)))
    times = np.concatenate([block.sample_times() for block in pieces])
    np.testing.assert_array_equal(times, at(0.05) + np.arange(100) * 500_000)
    values = np.concatenate([block.values for block in pieces])
    np.testing.assert_array_equal(values, samples[100:200] * 2e-9)


def test_only_the_last_seconds_are_kept() -> None:
    recent = RecentSamples(SEISMIC, keep_s=1.0)
    for block in blocks(SEISMIC, seismic_samples(), 500):
        recent.push(block)
    assert recent.value(at(4.9), [0]) == 0.0
    assert recent.value(at(5.1), [0]) != 0.0


def test_a_pick_lies_on_its_trace_in_the_units_shown() -> None:
    traces, samples = Traces([SEISMIC]), seismic_samples()
    for block in blocks(SEISMIC, samples, 1000):
        traces.push(block)
    pick = Pick(at(0.81), "G3", "/seismic", "picker", 0.0, 1.0)
    assert traces.of_pick(pick) == pytest.approx(samples[1620, 2] * 2e-9 * 1e6)


def test_a_step_is_as_high_as_the_curves_about_it() -> None:
    traces, samples = Traces([IMU, SEISMIC]), imu_samples()
    for block in blocks(IMU, samples, 100):
        traces.push(block)
    found = traces.extent("/imu/waist", at(2.0))
    about = samples[175:225, :3]
    expected = min(about.min(), 0.0), np.linalg.norm(about, axis=1).max()
    assert found == pytest.approx(expected)
    assert traces.extent("/seismic", at(2.0)) is None, "nothing of it came"


@pytest.mark.parametrize("rows", [7, 500])
def test_signal_with_an_arrival_is_kept_longer(rows: int) -> None:
    recent = RecentSamples(SEISMIC, keep_s=2.2)
    for block in blocks(SEISMIC, seismic_samples(), rows):
        recent.push(block)
        if block.start_ns <= at(1.5) < block.end_ns:
            recent.arrival(at(1.5))
    kept = list(recent.between(at(1.4), at(1.6)))
    assert sum(len(block) for block in kept) == 400
    assert not list(recent.between(at(0.0), at(0.4)))


def test_what_is_kept_longer_is_as_much_again_at_most() -> None:
    recent = RecentSamples(SEISMIC, keep_s=1.0)
    for block in blocks(SEISMIC, seismic_samples(), 100):
        recent.arrival(block.start_ns)
        recent.push(block)
    assert sum(len(block) for block in recent.between(at(0.0), at(60.0))) <= 2 * 2000 + 100
