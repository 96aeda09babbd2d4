"""Recordings whose clock begins at 0, at 30 Hz: nothing is told of a time before them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sweeps import swept

from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline, named_pipelines
from groundtrace.pipeline.conformance import BLOCK_SIZES, assert_same, rechunked, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load, plugins, stage_named
from groundtrace.pipeline.stage import StageRunner, detects, wanted_quantities
from groundtrace_codecs.events import CandidateBlock, Gap, TraceBlock
from groundtrace_codecs.geometry import Geometry, Sensor
from groundtrace_codecs.signals import NS_PER_S, Channel, SignalBlock, Stream

RATE_HZ = 30.0
DETECTORS = [p.name for p in plugins("stages") if detects(stage_named(p.name))]
IMU = Stream(
    "/imu",
    tuple(
        Channel(f"{quantity}_{axis}", quantity, unit, axis)
        for quantity, unit in (("acceleration", "m/s2"), ("angular_velocity", "rad/s"))
        for axis in "xyz"
    ),
    RATE_HZ,
    placement="waist",
)
PLACES = ((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0))
GROUND = Stream(
    "/seismic",
    tuple(
        Channel(f"G{i}", "ground_velocity", "m/s", "z", position_m=(x, y, 0.0))
        for i, (x, y) in enumerate(PLACES, 1)
    ),
    RATE_HZ,
)
SITE = Geometry(
    sensors=tuple(Sensor(f"G{i}", f"G{i}", x, y) for i, (x, y) in enumerate(PLACES, 1)),
    outline=PLACES,
)


def walker(stands_s: float) -> SignalBlock:
    """Sixteen seconds, of which somebody stands the first."""
    t = np.arange(0, 16, 1 / RATE_HZ)
    walks, phase = t >= stands_s, 2 * np.pi * 1.8 * t + 2.2
    samples = np.random.default_rng(1).normal(0, 0.03, (len(t), 6))
    samples[:, 2] += 9.81 + walks * (2.5 * np.sin(phase) + np.sin(2 * phase + 0.4))
    samples[:, 0] += walks * 0.8 * np.sin(phase + 1)
    samples[:, 4] += walks * 2.0 * np.sin(phase / 2)
    return SignalBlock(IMU, 0, 0, samples)


def ground(first_s: float) -> SignalBlock:
    """Impacts every 0.7 s; a sensor hears each one sample after the next nearer one."""
    t = np.arange(0, 16, 1 / RATE_HZ)
    samples = np.random.default_rng(2).normal(0, 1e-7, (len(t), len(PLACES)))
    for place in range(len(PLACES)):
        at = (np.arange(first_s, 15, 0.7) * RATE_HZ).astype(int) + place
        for late, size in enumerate((1.0, -0.7, 0.4, -0.2)):
            samples[np.minimum(at + late, len(t) - 1), place] += 2e-4 * size
    return SignalBlock(GROUND, 0, 0, samples)


def signals(quantities: frozenset[str]) -> list[SignalBlock]:
    if quantities & {"acceleration", "angular_velocity"}:
        return [walker(0.0), walker(0.4), walker(3.0)]
    return [ground(0.0), ground(3.0)]


@pytest.mark.parametrize("name", DETECTORS)
def test_no_candidate_of_a_detector_is_before_the_first_sample(name: str) -> None:
    kind = load("stages", name)
    for block in signals(wanted_quantities(kind)):
        whole = run(_stage(kind), [block])
        assert (whole.times >= 0).all()
        assert (whole.trace_times >= 0).all()
        assert all(event.time_ns >= 0 for event in whole.events)
        for size in BLOCK_SIZES[:2]:
            cut = run(_stage(kind), rechunked([block], size))
            assert_same(whole, cut, f"{name}: blocks of {size}")


@pytest.mark.parametrize("name", DETECTORS)
def test_no_candidate_after_a_gap_is_before_the_first_sample_after_it(name: str) -> None:
    kind = load("stages", name)
    late_ns = 100 * NS_PER_S
    for block in signals(wanted_quantities(kind)):
        gap = Gap(block.topic, block.end_ns, late_ns, "missing", 1800)
        second = SignalBlock(block.stream, late_ns, 0, block.samples)
        times = run(_stage(kind), [block, gap, second]).times
        assert not ((times > block.end_ns) & (times < late_ns)).any()


def test_a_candidate_that_a_filters_delay_puts_before_the_first_sample_is_at_it() -> None:
    found = run(_stage(load("stages", "zc")), [walker(3.0)])
    assert found.times[0] == 0
    assert found.times[1] > 0


#: Takes as long as all the others.
LONG = "vehicle-passes"


@pytest.mark.parametrize(
    "pipeline", swept(sorted(named_pipelines()), *(named_pipelines().keys() - {LONG}))
)
def test_no_pipeline_tells_of_a_time_before_the_recording(pipeline: str) -> None:
    config = load_pipeline(pipeline)
    blocks = [walker(0.0)] if config.application == "walker" else [ground(0.0)]
    chain = build_pipeline(config, SITE)
    events = [e for block in blocks for e in chain.process(block)] + chain.flush()
    assert min((t for event in events for t in _times(event)), default=0) >= 0


def _times(event: Any) -> list[int]:
    if isinstance(event, CandidateBlock | TraceBlock):
        return event.time_ns.tolist()
    return [event.time_ns] if hasattr(event, "time_ns") else []


def _stage(kind: Any) -> StageRunner:
    return StageRunner(StageConfig("d", "d"), kind, kind.Parameters())
