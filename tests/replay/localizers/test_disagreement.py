"""Localizers that disagree about a step, as candidates with gates and as events."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from groundtrace.errors import PipelineError
from groundtrace.localizers.disagreement import LocalizerDisagreement
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig
from groundtrace.pipeline.conformance import assert_same, outcome
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import CandidateBlock, Disagreement, Fix, Gap, Note, StageSpec
from groundtrace_codecs.geometry import Geometry, Sensor

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event

SOURCES = ("one", "two", "three")
SPECS = [StageSpec(name, "any", "/s", ("all",), (), (), (), "fix") for name in SOURCES]
SPREAD = (0.01, 0.0, 0.01)


def stage(geometry: Geometry | None = None, **given: Any) -> StageRunner:
    kind = LocalizerDisagreement
    parameters = kind.Parameters(**given)
    config = StageConfig("disagreement", "apart")
    return StageRunner(config, kind, parameters, {kind.takes[0]: SOURCES}, geometry)


def fix(name: str, time_ns: int, x: float, spread: tuple[float, float, float] = SPREAD) -> Fix:
    return Fix(time_ns, x, 1.0, spread, 1e-4, name, 9, name)


def said(runner: StageRunner, items: list[Any]) -> list[Event]:
    return [e for item in items for e in runner.process(item)] + list(runner.flush())


def test_the_pair_farthest_apart_for_its_uncertainty_is_the_candidate() -> None:
    wide = (4.0, 0.0, 4.0)
    fixes = [fix("one", 5, 1.0), fix("two", 5, 2.0), fix("three", 5, 3.0, wide)]
    spec, block, event = said(stage(), [*SPECS, *fixes])
    assert isinstance(spec, StageSpec)
    assert (spec.emits, spec.channels) == ("disagreement", ("one, two", "one, three", "two, three"))
    assert isinstance(block, CandidateBlock)
    assert spec.channels[block.channel[0]] == "one, two"
    assert block.value[0].tolist() == pytest.approx([1.0, 1 / np.sqrt(0.02), 1.5, 1.0, 3.0])
    assert event == Disagreement(5, 1.0, float(block.value[0, 1]), "one, two", "apart")


def test_places_that_are_near_or_uncertain_are_a_rejected_candidate() -> None:
    near = said(stage(), [*SPECS, fix("one", 5, 1.0), fix("two", 5, 1.4)])
    vague = said(stage(), [*SPECS, fix("one", 5, 1.0), fix("two", 5, 2.0, (9.0, 0.0, 9.0))])
    for events, gate in ((near, 0), (vague, 1)):
        _, block = events
        assert isinstance(block, CandidateBlock)
        assert block.margin[0, gate] < 0
        assert not block.accepted[0]


def test_a_step_is_decided_when_the_next_one_has_come_or_the_clock_steps() -> None:
    runner = stage()
    first = [*SPECS, fix("one", 5, 1.0), fix("three", 5, 2.0)]
    held = [e for item in first for e in runner.process(item)]
    assert not any(isinstance(e, CandidateBlock) for e in held)
    assert [type(e) for e in runner.process(fix("one", 9, 1.0))] == [CandidateBlock, Disagreement]
    assert list(runner.process(fix("two", 9, 3.0))) == []
    gap = Gap("/s", 20, 20, "clock step", 0)
    assert [type(e) for e in runner.process(gap)] == [CandidateBlock, Disagreement]
    assert list(runner.flush()) == []


def test_a_step_with_a_single_place_has_nothing_to_compare() -> None:
    assert said(stage(), [*SPECS, fix("one", 5, 1.0), fix("one", 9, 1.0)])[1:] == []


def test_a_copy_of_a_comparison_goes_on() -> None:
    items = [*SPECS, fix("one", 5, 1.0), fix("two", 5, 2.0), fix("one", 9, 1.0), fix("two", 9, 4.0)]
    whole = said(stage(), items)
    one = stage()
    events = [e for item in items[:4] for e in one.process(item)]
    other = copy.deepcopy(one)
    assert_same(outcome(whole), outcome([*events, *said(other, items[4:])]), "copied")


def test_lengths_keep_their_proportion_to_a_site_of_unknown_unit() -> None:
    places = 270.0 * np.array([(x, y) for x in (0, 1, 2) for y in (0, 1, 2)])
    sensors = tuple(Sensor(f"G{i}", f"G{i}", *xy) for i, xy in enumerate(places.tolist()))
    site = Geometry(sensors, unit="unknown")
    spread = (100.0, 0.0, 100.0)
    near, far = (
        said(stage(site), [*SPECS, fix("one", 5, 1.0, spread), fix("two", 5, x, spread)])
        for x in (41.0, 61.0)
    )
    assert isinstance(near[0], StageSpec)
    assert [c.unit for c in near[0].columns[:3]] == ["units", "1", "units"]
    assert [type(e) for e in near[1:]] == [Note, CandidateBlock]
    assert [type(e) for e in far[1:]] == [Note, CandidateBlock, Disagreement]
    assert isinstance(near[1], Note)
    assert "unit of length is unknown" in near[1].text
    stages = tuple(map(StageConfig, ("toa-cv", "coincidence", "power-law", "walkers")))
    for geometry, factor in ((site, 100.0), (None, 1.0)):
        tracker: Any = build_pipeline(PipelineConfig("p", stage=stages), geometry).stages[-1]
        assert tracker.parameters.sigma_q == pytest.approx(0.1 * factor, rel=0.01)


def test_a_comparison_of_a_single_localizer_is_refused() -> None:
    stages = tuple(map(StageConfig, ("toa-cv", "coincidence", "power-law", "disagreement")))
    with pytest.raises(PipelineError, match="disagreement: expected two localizers before it, fou"):
        build_pipeline(PipelineConfig("p", stage=stages))
