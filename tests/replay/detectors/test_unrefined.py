"""Unrefined pickers: the rules' own arrivals, whatever the blocks; the classic STA/LTA."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from groundtrace.pipeline.conformance import assert_same, rechunked, run
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

RATE_HZ, ONSET_S = 20_000.0, 0.2
RULES = {
    "toa-cv": {"floor": 5.0},
    "toa-sb": {"floor": 3.0},
    "sta-lta": {"average": "power", "gap_s": 0.0, "floor": 4.0, "ratio": 4.0},
}


def impacts() -> SignalBlock:
    rng = np.random.default_rng(4)
    t = np.arange(8000)[:, None] / RATE_HZ - ONSET_S
    since = np.maximum(t, 0)
    wave = np.sin(2 * np.pi * rng.uniform(80, 400, 8) * since) * np.exp(-since / 0.01)
    samples = 30 * wave * (1 - np.exp(-since / 0.001)) + rng.standard_normal((8000, 8))
    channels = tuple(Channel(f"G{i}", "seismic", "count") for i in range(8))
    return SignalBlock(Stream("/s", channels, RATE_HZ), 0, 0, samples)


def stage_of(name: str, **settings: Any) -> StageRunner:
    kind = load("stages", name)
    return StageRunner(StageConfig(name), kind, kind.Parameters(**settings))


@pytest.mark.parametrize("name", RULES)
def test_an_unrefined_arrival_is_the_first_sample_over_the_floor(name: str) -> None:
    block, settings = impacts(), RULES[name]
    stage = stage_of(name, refine="none", **settings)
    curves = []
    events = stage.process(block)
    told = stage.curve("/s")
    assert told is not None
    curves = told.value
    events += stage.flush()
    picks = [
        e for e in events if type(e).__name__ == "Pick" and abs(e.time_ns / 1e9 - ONSET_S) < 0.02
    ]
    assert len(picks) == 8
    for pick in picks:
        assert np.isnan(pick.uncertainty_s)
        at = int(np.searchsorted(told.time_ns, pick.time_ns))
        own = curves[:, int(pick.channel[1:])]
        assert own[at] > settings["floor"] >= own[at - 1]


@pytest.mark.parametrize("name", RULES)
def test_it_does_not_depend_on_the_blocks(name: str) -> None:
    block = impacts()
    whole = run(stage_of(name, refine="none", **RULES[name]), [block])
    parts = run(stage_of(name, refine="none", **RULES[name]), list(rechunked([block], 133)))
    assert_same(whole, parts, name)


def test_refinement_makes_the_late_rules_earlier() -> None:
    block = impacts()
    for name in ("toa-cv", "toa-sb"):
        raw = run(stage_of(name, refine="none", **RULES[name]), [block])
        refined = run(stage_of(name), [block])
        assert np.median(refined.times[refined.accepted]) < np.median(raw.times[raw.accepted])
