"""DSTP: evidence of two sensors about peaks and valleys, at any sampling rate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from walking_blocks import START_NS, Walk, waist

from groundtrace.detectors.dempster_shafer import (
    RULES,
    BeliefParameters,
    DempsterShaferDetector,
    SensorMass,
    TrapezoidMembership,
    over_ignorance,
    vertex,
)
from groundtrace.pipeline.conformance import Outcome, check_stage, run
from groundtrace.pipeline.gates import Candidates, decide
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import SignalBlock

NAMES = [column.name for column in DempsterShaferDetector.columns]
MASSES = ("{0}_{1}", "{0}_non{1}", "{0}_{1}_ignorance")


def detected(walk: Walk, parameters: BeliefParameters | None = None) -> Outcome:
    parameters = parameters or BeliefParameters()
    return run(
        StageRunner(StageConfig("dstp", "steps"), DempsterShaferDetector, parameters), [walk.block]
    )


@cache
def recorded() -> tuple[SignalBlock | Gap, ...]:
    with Recording.open(path_of("waist-walk.mcap")) as recording:
        return tuple(Source(recording, topics=["/imu/waist"], block_s=60.0))


def bundled(parameters: BeliefParameters) -> Outcome:
    """What is found in the walk that ships with us, whose steps are of many heights."""
    return run(
        StageRunner(StageConfig("dstp", "steps"), DempsterShaferDetector, parameters), recorded()
    )


def seconds(outcome: Outcome) -> NDArray[np.float64]:
    return (outcome.times[outcome.accepted] - START_NS) / NS_PER_S


def column(outcome: Outcome, name: str) -> NDArray[np.float64]:
    return outcome.values[:, NAMES.index(name)].astype(np.float64)


def masses_of(outcome: Outcome, source: str, what: str) -> NDArray[np.float64]:
    """Masses of a source, in the order of a frame of two hypotheses."""
    parts = [column(outcome, name.format(source, what)) for name in MASSES]
    return np.column_stack([np.zeros(len(outcome.times)), *parts])


@pytest.mark.parametrize(
    ("rate_hz", "cadence_hz"), [(6.0, 1.0), (10.0, 0.5), (10.0, 1 / 3), (50.0, 1.8), (100.0, 1.8)]
)
@pytest.mark.parametrize("gyroscope", [True, False])
def test_all_steps_are_found_and_no_others(rate_hz, cadence_hz, gyroscope) -> None:
    walk = waist(rate_hz, cadence_hz, gyroscope=gyroscope)
    found = seconds(detected(walk))
    nearest = np.abs(found[:, None] - walk.steps_s).min(axis=0)
    assert len(found) == 20
    assert nearest.max() <= 0.12


@pytest.mark.parametrize("walk", [waist(6.0, 1.0), waist(gyroscope=False)], ids=["6 Hz", "no gyro"])
def test_it_conforms_at_low_rates_and_without_a_gyroscope(walk: Walk) -> None:
    assert check_stage(DempsterShaferDetector, [walk.block]).accepted.any()


@pytest.mark.parametrize("rule", sorted(RULES))
def test_the_combined_masses_are_what_the_rule_makes_of_the_sensors(rule: str) -> None:
    found = detected(waist(), BeliefParameters(rule=rule))
    for what in ("peak", "valley"):
        sources = [masses_of(found, s, what) for s in ("accelerometer", "gyroscope")]
        for masses in sources:
            assert np.allclose(masses.sum(axis=1), 1, atol=1e-6)
        names = (f"{what}_mass", f"non{what}_mass", f"{what}_ignorance")
        combined = np.column_stack([column(found, name) for name in names])
        expected = RULES[rule](*sources)
        assert np.allclose(combined, expected[:, 1:], atol=1e-6)
        assert np.allclose(
            column(found, f"{what}_certainty"), over_ignorance(expected, 1), atol=1e-6
        )
        conflict = RULES["smets"](*sources)[:, 0]
        assert np.allclose(column(found, f"{what}_conflict"), conflict, atol=1e-6)


def test_without_a_gyroscope_the_second_source_is_vacuous() -> None:
    found = detected(waist(gyroscope=False))
    assert np.array_equal(
        masses_of(found, "gyroscope", "peak"), np.tile([0, 0, 0, 1], (len(found.times), 1))
    )
    alone = masses_of(found, "accelerometer", "peak")
    assert np.allclose(column(found, "peak_mass"), alone[:, 1], atol=1e-6)
    nothing = detected(waist(gyroscope=False), BeliefParameters(rule="disjunctive"))
    assert np.allclose(column(nothing, "peak_ignorance"), 1)
    assert not nothing.accepted.any()


def test_a_sensor_that_is_not_trusted_at_all_says_nothing() -> None:
    with_one = detected(waist(), BeliefParameters(gyroscope=0.0))
    without = detected(waist(gyroscope=False))
    assert np.array_equal(with_one.values, without.values)


@pytest.mark.parametrize("criterion", ["belief", "plausibility", "pignistic"])
def test_on_two_hypotheses_every_criterion_accepts_the_same(criterion: str) -> None:
    found = detected(waist(), BeliefParameters(criterion=criterion))
    assert np.array_equal(found.accepted, detected(waist()).accepted)


def test_total_conflict_is_not_a_number_and_no_step() -> None:
    sure = TrapezoidMembership(0.0, 0.5)
    evidence = SensorMass(sure, TrapezoidMembership(1.0, 1.0), (1.0, 1.0), "dempster", "belief")
    rows = evidence.of(np.array([[2.0, 0.6], [2.0, 2.0]]))
    assert np.isnan(rows[0, :5]).all()
    assert rows[0, 5] == 1  # the conflict
    assert np.isfinite(rows[1]).all()
    assert np.isfinite(replace(evidence, rule="yager").of(np.array([[2.0, 0.6]]))).all()
    candidates = Candidates(
        np.zeros(1, np.int64),
        np.zeros(1, np.int32),
        np.concatenate([[2.0, 2.0, 0.2], rows[0], rows[1]]).astype(np.float32)[None],
    )
    decisions, _ = decide(
        candidates, DempsterShaferDetector.columns, DempsterShaferDetector.gates, BeliefParameters()
    )
    assert not decisions.accepted[0]


@pytest.mark.parametrize(
    "change",
    [
        {"peak_mass": 0.8},
        {"peak_certainty": 0.6, "valley_certainty": 0.5},
        {"peak_lead": 0.9},
        {"valley_mass": 0.85},
        {"fall_s": 0.2},
        {"pause_s": 0.25},
        {"refractory_s": 0.7},
    ],
    ids=str,
)
def test_deciding_again_equals_a_fresh_run_with_those_gates(change: dict[str, float]) -> None:
    base, fresh = bundled(BeliefParameters()), bundled(BeliefParameters(**change))
    decisions, _ = decide(
        Candidates(base.times, base.channels, base.values),
        DempsterShaferDetector.columns,
        DempsterShaferDetector.gates,
        BeliefParameters(**change),
    )
    assert np.array_equal(decisions.accepted, fresh.accepted)
    assert np.array_equal(decisions.margin, fresh.margins)
    assert not np.array_equal(fresh.accepted, base.accepted)


def test_what_is_much_too_high_is_no_step() -> None:
    walk = waist()
    samples = np.array(walk.block.samples)
    samples[50:55, 2] += 60.0
    found = detected(Walk(replace(walk.block, samples=samples), walk.steps_s))
    knock = int(np.argmax(column(found, "height")))
    assert found.accepted.sum() == 20
    assert not found.accepted[knock]
    assert column(found, "nonpeak_mass")[knock] > 0.5


def test_a_peak_between_two_samples_is_placed_there() -> None:
    t = np.array([-1.0, 0.0, 1.0])
    assert vertex(1 - (t - 0.3) ** 2) == pytest.approx(0.3)
    assert vertex(np.ones(3)) == 0.0
