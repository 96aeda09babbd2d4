"""Every sentence of a reason is borne out by the numbers it prints, whatever was recorded."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reason_texts import CHANNELS, Claims
from sweeps import examples

from groundtrace.detectors.adaptive import ByRhythm, ByScore
from groundtrace.explain.reasons import CAUSES, Reason, StepReasons, accepted_picks
from groundtrace.explain.redecide import associated
from groundtrace.explain.sweep import resolved
from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace.pipeline.gates import Candidates, decided_block, gate_specs
from groundtrace.pipeline.parameters import StageConfig, build
from groundtrace.pipeline.plugins import stage_named
from groundtrace.pipeline.results import Evidence, StageEvidence
from groundtrace.pipeline.stage import Frames, StageRunner, emitted
from groundtrace_codecs.events import CandidateBlock, Gap, Label, StageSpec
from groundtrace_codecs.signals import NS_PER_S

START, LENGTH_S = 1_700_000_000 * NS_PER_S, 6.0
#: Pipelines, and the stage whose candidates are made up.
BODIES = ("waist-steps", "waist-peaks")


@cache
def pipeline(name: str) -> PipelineConfig:
    return resolved(load_pipeline(name))


def stage_of(config: PipelineConfig, index: int) -> tuple[Any, Any, Any]:
    stage = config.stage[index]
    kind = stage_named(stage.use)
    return stage, kind, build(kind.Parameters, stage.parameters, stage.key)


def decided(block: CandidateBlock, frames: Frames) -> StageEvidence:
    found = Candidates(block.time_ns, block.channel, block.value)
    verdicts = (block.gate_value, block.margin, block.accepted)
    return StageEvidence(block.spec, found, *verdicts, frames)


MOMENTS = st.lists(st.integers(0, 600), max_size=14, unique=True).map(sorted)
#: Around every threshold, on it, and nowhere near it.
FACTORS = st.sampled_from([0.0, 0.3, 0.999, 0.9999999, 1.0, 1.0000001, 1.2, 5.0, np.nan, np.inf])


#: Stages that decide in one of several ways.
WAYS: dict[str, tuple[Any, ...]] = {"adaptive": (ByRhythm, ByScore)}


@st.composite
def detectors(draw: st.DrawFn, name: str, index: int, channels: tuple[str, ...]) -> StageEvidence:
    """Draw what a detector might have found: any candidates, and any trace."""
    stage, kind, parameters = stage_of(pipeline(name), index)
    way = draw(st.sampled_from(WAYS.get(stage.use, (kind,))))
    gates = gate_specs(way.gates, parameters)
    trace = (way.columns[0], *kind.trace[1:])
    spec = StageSpec(stage.key, stage.use, "/x", channels, way.columns, gates, trace,
                     emitted(kind))  # fmt: skip
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    times = draw(MOMENTS)
    jitter = draw(st.sampled_from([0, 1, 999_999]))
    levels = {g.name: g.threshold for g in gates}
    value = np.empty((len(times), len(way.columns)), np.float32)
    for row in value:
        row[:] = [levels.get(c.name, 1.0) * draw(FACTORS) for c in way.columns]
    time_ns = START + np.array(times, np.int64) * 10_000_000 + jitter
    channel = rng.integers(0, len(channels), len(times)).astype(np.int32)
    frames = _frames(draw, rng, spec, parameters, time_ns, value)
    block, _ = decided_block(spec, Candidates(time_ns, channel, value), kind, parameters)
    return decided(block, frames)


def _frames(
    draw: st.DrawFn, rng: np.random.Generator, spec: StageSpec, parameters: Any,
    time_ns: np.ndarray, value: np.ndarray,
) -> Frames:  # fmt: skip
    if draw(st.booleans()) and draw(st.booleans()):
        count = draw(st.sampled_from([0, 1, 40]))
    else:
        count = int(LENGTH_S / 0.05)
    begins = START + 50_000_000 * np.arange(count, dtype=np.int64)
    floor = float(parameters.floor)
    high = draw(st.sampled_from([0.2, 1.0, 20.0]))
    made = rng.uniform(-0.5, high, (count, len(spec.channels), len(spec.trace))) * floor
    made[:, :, 1:] = np.abs(made[:, :, 1:])
    exact = rng.random((count, len(spec.channels))) < 0.1
    made[exact, 0] = floor
    flat = [q.name for q in spec.trace].index("flat")
    kinds = rng.choice([0.0, 0.0, 0.0, 0.01, 0.05], (count, len(spec.channels)))
    made[:, :, flat] = kinds if draw(st.booleans()) else 0.0
    lag = draw(st.integers(0, 6))
    for at, row in zip(time_ns, value, strict=True):
        frame = int((at - START) // 50_000_000) + lag
        if frame < count and np.isfinite(row[0]):
            made[frame, :, 0] = row[0]
    return Frames(begins, made.astype(np.float32))


@st.composite
def truths(draw: st.DrawFn) -> tuple[Label, ...]:
    steps = [Label(START + k * 10_000_000, "step") for k in draw(MOMENTS)]
    more = []
    if draw(st.booleans()):
        first = draw(st.integers(0, 300))
        end_ns = START + (first + 250) * 10_000_000
        kind = draw(st.sampled_from(["walking", "ignore"]))
        more = [Label(START + first * 10_000_000, kind, end_ns=end_ns)]
    return tuple(sorted([*steps, *more]))


@st.composite
def gaps(draw: st.DrawFn) -> tuple[Gap, ...]:
    found = []
    for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
        start_ns = START + draw(st.integers(0, 550)) * 10_000_000
        reason = draw(st.sampled_from(["missing", "clock step", "damage"]))
        length = 0 if reason == "clock step" else draw(st.integers(1, 80)) * 10_000_000
        topic = draw(st.sampled_from(["/x", "", "/other"]))
        found.append(Gap(topic, start_ns, start_ns + length, reason, 7, draw(st.booleans())))
    return tuple(found)


def evidence_of(name: str, stages: tuple[StageEvidence, ...], *more: Any) -> Evidence:
    labels, found = more
    return Evidence("x.mcap", pipeline(name), stages, found, labels, START,
                    START + round(LENGTH_S * NS_PER_S))  # fmt: skip


def check_all(evidence: Evidence, tolerance_s: float) -> None:
    reasons = StepReasons(evidence, tolerance_s)
    for time_ns in reasons.matching.truth_ns[reasons.matching.missed].tolist():
        reason = reasons.at(time_ns)
        assert reason.cause in CAUSES
        Claims(reasons, reason, time_ns).check()
        pair = reasons.wrong_time(time_ns)
        assert (pair is not None) <= (reason.cause == "timing")
        if pair is not None:
            assert reasons.wrong_time(round(pair.found_s * NS_PER_S) + START) == pair


TOLERANCES = st.sampled_from([0.12, 0.05, 0.03, 0.25])
FEW = settings(
    max_examples=examples(150), suppress_health_check=[HealthCheck.too_slow], deadline=None
)


@FEW
@given(st.data(), st.sampled_from(BODIES), truths(), gaps(), TOLERANCES)
def test_what_is_said_of_a_worn_sensor_is_so(data, name, labels, found, tolerance_s) -> None:
    part = data.draw(detectors(name, 0, ("up",)))
    check_all(evidence_of(name, (part,), labels, found), tolerance_s)


@FEW
@given(st.data(), truths(), gaps(), TOLERANCES)
def test_what_is_said_of_groups_of_picks_is_so(data, labels, found, tolerance_s) -> None:
    picked = data.draw(detectors("room-steps", 0, CHANNELS))
    stage, kind, parameters = stage_of(pipeline("room-steps"), 1)
    runner = StageRunner(
        StageConfig(stage.use, stage.key), kind, parameters, {kind.takes[0]: (picked.spec.stage,)}
    )
    empty = Frames(np.empty(0, np.int64), np.empty((0, 1, 0), np.float32))
    blocks = associated(runner, [(picked.spec, accepted_picks(picked))])
    grouped = [b for b in blocks if isinstance(b, CandidateBlock)]
    if not grouped:
        return
    stages = (picked, decided(grouped[0], empty))
    check_all(evidence_of("room-steps", stages, labels, found), tolerance_s)


def one(*times_s: float, swing: float = 1.0, label_s: float = 2.0) -> StepReasons:
    """Return the reasons of a walk with candidates at some times."""
    _, kind, parameters = stage_of(pipeline("waist-steps"), 0)
    spec = StageSpec("steps", "adaptive", "/x", ("up",), kind.columns,
                     gate_specs(ByRhythm.gates, parameters), kind.trace, emitted(kind))  # fmt: skip
    time_ns = START + np.array([round(t * NS_PER_S) for t in times_s], np.int64)
    value = np.full((len(times_s), len(kind.columns)), 1.0, np.float32)
    value[:, 1] = swing
    found = Candidates(time_ns, np.zeros(len(time_ns), np.int32), value)
    block, _ = decided_block(spec, found, kind, parameters)
    begins = START + 50_000_000 * np.arange(120, dtype=np.int64)
    rows = np.full((120, 1, len(kind.trace)), 0.01, np.float32)
    rows[:, :, -1] = 0.0
    part = decided(block, Frames(begins, rows))
    labels = (Label(START + round(label_s * NS_PER_S), "step"),)
    return StepReasons(evidence_of("waist-steps", (part,), labels, ()), 0.12)


#: Sentences that are not so: the candidates, and what is said of the step at 2 s.
UNTRUE = (
    ((), "no candidate within 120 ms: the signal never rose above the floor: height reached "
         "0.779 m/s2, floor 0.05 m/s2"),
    ((), "no candidate within 120 ms: the signal never rose above the floor: height reached "
         "0.01 m/s2, floor 0.9 m/s2"),
    ((), "no candidate within 120 ms: height reached 0.01 m/s2 in a frame of 50 ms there, above "
         "the floor of 0.05 m/s2, but without a local maximum"),
    ((2.126,), "no candidate within 120 ms: the signal never rose above the floor: height "
               "reached 0.01 m/s2, floor 0.05 m/s2"),
    ((2.126,), "found 126 ms early, tolerance 120 ms"),
    ((2.126,), "found 120 ms late, tolerance 120 ms"),
    ((2.126,), "found 140 ms late, tolerance 120 ms"),
    ((2.126,), "found 126 ms late, tolerance 100 ms"),
    ((2.05,), "swing 1 m/s2 < 0.2 m/s2 (margin 0.8)"),
    ((2.05,), "swing 0.2 m/s2 < 0.2 m/s2 (margin -1e-09)"),
    ((2.05,), "merged with the step 300 ms earlier by the refractory gate (300 ms)"),
    ((2.05,), "its detection at 2.050 s answers step 1"),
    ((3.0,), "no candidate within 120 ms: the signal never rose above the floor: height reached "
             "0.01 m/s2, floor 0.05 m/s2; the nearest candidate comes 1000 ms early"),
    ((), "attenuated by the filter: peak amplitude 3 m/s2 at 31 dB over noise as recorded, 9 dB "
         "after the filter (change the band and replay)"),
    ((), "no candidate: the signal never rose above the floor: peak amplitude 3.2 m/s2 at 20 dB "
         "over noise, height reached 0.779"),
)  # fmt: skip


@pytest.mark.parametrize(("times", "text"), UNTRUE)
def test_the_check_finds_what_is_not_so(times, text) -> None:
    reasons = one(*times)
    wrong = Reason("quiet", text, "steps", "/x")
    with pytest.raises(AssertionError):
        Claims(reasons, wrong, START + 2 * NS_PER_S).check()


def test_the_check_lets_through_what_is_so() -> None:
    for reasons, text in (
        (one(), "no candidate within 120 ms: the signal never rose above the floor: height "
                "reached 0.01 m/s2, floor 0.05 m/s2; there is no candidate at all"),
        (one(2.126), "found 126 ms late, tolerance 120 ms"),
        (one(2.13, swing=0.1), "a candidate 130 ms late (tolerance 120 ms), which swing 0.1 m/s2 "
                               "< 0.2 m/s2 (margin -0.1) rejects too"),
        (one(1.9, 2.2, swing=0.1), "swing 0.1 m/s2 < 0.2 m/s2 (margin -0.1)"),
    ):  # fmt: skip
        found = reasons.at(START + 2 * NS_PER_S)
        assert found.text == text
        Claims(reasons, found, START + 2 * NS_PER_S).check()


def test_a_rejected_candidate_in_time_is_told_beside_the_late_step() -> None:
    reasons = one(2.02, 2.2)
    part = reasons.evidence.stages[0]
    value = part.candidates.value.copy()
    value[0, 1] = 0.1
    _, kind, parameters = stage_of(pipeline("waist-steps"), 0)
    found = replace(part.candidates, value=value)
    block, _ = decided_block(part.spec, found, kind, parameters)
    evidence = replace(reasons.evidence, stages=(decided(block, part.frames),))
    told = StepReasons(evidence, 0.12).at(START + 2 * NS_PER_S)
    assert told.cause == "timing"
    assert told.text == (
        "found 200 ms late, tolerance 120 ms; a candidate 20 ms late is rejected: "
        "swing 0.1 m/s2 < 0.2 m/s2 (margin -0.1)"
    )
