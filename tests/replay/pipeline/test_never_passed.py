"""Thresholds that no candidate can reach: computed, and told at the begin of a run."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import examples

from groundtrace.detectors.coincidence import Coincidence, CoincidenceParameters
from groundtrace.detectors.dempster_shafer import (
    RULES,
    BeliefParameters,
    DempsterShaferDetector,
    SensorMass,
    TrapezoidMembership,
)
from groundtrace.errors import PipelineError
from groundtrace.pipeline.parameters import StageConfig, build
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import GateSpec, Note, Quantity, StageSpec
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

NS = 10**9


def walking(*, gyroscope: bool = True) -> SignalBlock:
    t = np.arange(1000) / 100
    swing = np.sin(2 * np.pi * 1.8 * t)
    quantities = [("acceleration", "m/s2")] + [("angular_velocity", "rad/s")] * gyroscope
    channels = tuple(Channel(f"{q[:3]}_z", q, unit, "z") for q, unit in quantities)
    columns = [9.81 + 3 * swing, 1 + swing][: len(channels)]
    return SignalBlock(Stream("/imu", channels, 100.0), 5 * NS, 0, np.stack(columns, axis=1))


def told(block: SignalBlock, **parameters: object) -> list[str]:
    given_ = build(BeliefParameters, parameters, "steps")
    stage = StageRunner(StageConfig("dstp", "steps"), DempsterShaferDetector, given_)
    notes = [event for event in stage.process(block) if isinstance(event, Note)]
    assert all(note.level == "WARN" and note.time_ns == 5 * NS for note in notes)
    return [note.text for note in notes]


def test_the_defaults_can_accept_with_and_without_a_gyroscope() -> None:
    assert not told(walking())
    assert not told(walking(gyroscope=False))


def test_a_mass_limit_above_what_the_disjunctive_rule_can_reach_is_told() -> None:
    lines = told(walking(), rule="disjunctive")
    assert any(
        "peak_mass is 0.5, but peak_mass reaches 0.475 at most (rule disjunctive, "
        "reliabilities 0.95 and 0.5)" in line
        for line in lines
    )
    # one source that knows nothing: nothing can be said of a union with it
    assert any("reaches 0 at most" in x for x in told(walking(gyroscope=False), rule="disjunctive"))


def test_what_is_told_depends_on_the_numbers_and_not_on_a_name() -> None:
    sure = {"rule": "disjunctive", "accelerometer": 1.0, "gyroscope": 1.0}
    assert not told(walking(), **sure)
    (line,) = {
        x.split(": ", 1)[1]
        for x in told(walking(), accelerometer=0.3, gyroscope=0.1)
        if "peak_mass" in x
    }
    assert line.startswith("steps accepts nothing: peak_mass is 0.5, but peak_mass reaches 0.3")


@settings(max_examples=examples(60))
@given(
    st.sampled_from(sorted(RULES)),
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.lists(st.floats(0, 8), min_size=6, max_size=6).map(sorted),
    st.integers(0, 2**32 - 1),
)
def test_no_heights_reach_more_than_is_said(rule, reliability, corners, seed) -> None:
    evidence = SensorMass(
        TrapezoidMembership(corners[0], corners[2]),
        TrapezoidMembership(corners[1], corners[3], corners[4], corners[5]),
        reliability,
        rule,
        "belief",
    )
    heights = np.random.default_rng(seed).uniform(-1, 10, (2000, 2))
    reached = np.nan_to_num(evidence.of(heights)[:, :3], nan=-np.inf).max(axis=0)
    assert (reached <= np.array(evidence.most()) + 2e-3).all()


def test_corners_that_fall_are_refused_before_a_replay() -> None:
    with pytest.raises(PipelineError, match=r"^s\.certain_from: expected at most certain_at \(1\)"):
        build(BeliefParameters, {"certain_from": 3.0}, "s")


@pytest.mark.parametrize(("wanted", "lines"), [(6, 0), (7, 1)])
def test_more_channels_than_there_are_cannot_coincide(wanted: int, lines: int) -> None:
    parameters = CoincidenceParameters(min_channels=wanted)
    stage = StageRunner(StageConfig("coincidence", "steps"), Coincidence, parameters)
    names = tuple(f"G{i}" for i in range(6))
    gates = (GateSpec("ratio", "1", "ratio", 5.0),)
    spec = StageSpec("picks", "toa-cv", "/imu", names, (Quantity("r", "1"),), gates, (), "pick")
    found = stage.process_all([spec, walking(), walking()])
    notes = [event for events in found for event in events if isinstance(event, Note)]
    assert len(notes) == lines
    if lines:
        assert "min_channels is 7, but channels reaches 6 at most" in notes[0].text
        assert notes[0].time_ns == 5 * NS


def test_a_rhythm_above_one_is_outside_its_bounds() -> None:
    from groundtrace.detectors.adaptive import AdaptiveParameters

    with pytest.raises(PipelineError, match=r"s\.rhythm: expected float >= 0 and <= 1, found 1\.5"):
        build(AdaptiveParameters, {"rhythm": 1.5}, "s")
