"""Rest and swing: four thresholds one after the other, each with its margin."""

from __future__ import annotations

import numpy as np
import pytest
from walking_blocks import START_NS, waist

from groundtrace.detectors.swing import SwingDetector, SwingParameters, extreme
from groundtrace.pipeline.conformance import check_stage, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.signals import NS_PER_S

GATES = [gate.name for gate in SwingDetector.gates]


def detected(walk, **changes):
    stage = StageRunner(
        StageConfig("rest-swing", "steps"), SwingDetector, SwingParameters(**changes)
    )
    return run(stage, [walk.block])


@pytest.mark.parametrize(("rate_hz", "cadence_hz"), [(6.0, 1.0), (25.0, 1.8), (100.0, 1.8)])
def test_all_steps_are_found_and_no_others(rate_hz: float, cadence_hz: float) -> None:
    walk = waist(rate_hz, cadence_hz)
    found = detected(walk)
    times = (found.times[found.accepted] - START_NS) / NS_PER_S
    assert len(times) == 20
    assert np.abs(times[:, None] - walk.steps_s).min(axis=0).max() <= 0.12


def test_it_conforms_at_a_low_rate() -> None:
    assert check_stage(SwingDetector, [waist(6.0, 1.0).block]).accepted.any()


@pytest.mark.parametrize(
    ("gate", "parameter"),
    [
        ("peak", "peak"),
        ("valley", "valley"),
        ("rebound", "rebound"),
        ("settle", "settle"),
        ("swing", "swing"),
    ],
)
def test_each_threshold_rejects_what_does_not_reach_it(gate: str, parameter: str) -> None:
    found = detected(waist(), **{parameter: 20.0})
    assert not found.accepted.any()
    failed = found.margins < 0
    assert failed[:, GATES.index(gate)].all()


def test_a_swing_that_takes_too_long_is_none() -> None:
    walk = waist(50.0, 0.5)
    assert not detected(walk, delay_s=0.3).accepted[2:-2].any()


def test_ripples_smaller_than_a_turn_are_no_swing() -> None:
    assert len(detected(waist(), turn=0.2).times) < len(detected(waist(), turn=0.001).times)


def test_an_extreme_ends_where_the_signal_has_come_back_by_a_turn() -> None:
    way = np.array([0.0, 1.0, 0.95, 1.2, 1.0, 5.0])
    assert extreme(way, 0.1) == 3
    assert extreme(way, 0.5) == 5
    assert extreme(np.array([2.0, 1.0, 3.0]), 0.5) == 0
