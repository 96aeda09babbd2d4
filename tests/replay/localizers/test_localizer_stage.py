from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from localizer_cases import ROOM, SENSORS, THETA_S, times_of

from groundtrace.errors import PipelineError
from groundtrace.explain.redecide import OfflineDecider, parse_axis
from groundtrace.localizers.base import PlacedSensors, first_arrivals
from groundtrace.localizers.methods import PowerLaw
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import PipelineConfig, load_pipeline
from groundtrace.pipeline.conformance import assert_same, outcome
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.plugins import load
from groundtrace.pipeline.results import Evidence, stage_evidence
from groundtrace.pipeline.source import Source
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import CandidateBlock, Fix, Gap, Note, Pick, StageSpec, StepEvent
from groundtrace_codecs.geometry import Geometry, Medium, Sensor
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event

METHODS = ("hyperbolic", "power-law", "self-calibrating", "so-tdoa")
START_NS = 1_700_000_000_000_000_000
NAMES = tuple(f"G{i + 1}" for i in range(9))
SITE = Geometry(
    tuple(Sensor(n, n, float(x), float(y)) for n, (x, y) in zip(NAMES, SENSORS, strict=True)),
    tuple((float(x), float(y)) for x, y in ROOM),
    medium=Medium(velocity_mps=1225.0, theta_s=THETA_S),
)
PICKED = StageSpec("picks", "toa-cv", "/s", NAMES, (), (), (), "pick")
STEPPED = StageSpec("steps", "coincidence", "/s", ("all",), (), (), (), "step")


def stage(method: str = "power-law", geometry: Geometry | None = SITE, **given: Any) -> Any:
    kind = load("stages", method)
    sources = dict(zip(kind.takes, (("picks",), ("steps",)), strict=True))
    return StageRunner(StageConfig(method), kind, kind.Parameters(**given), sources, geometry)


def pick(channel: str, since_s: float) -> Pick:
    return Pick(START_NS + round(since_s * NS_PER_S), channel, "/s", "picks", 1e-4, 9.0)


def step_at(since_s: float, topic: str = "/s") -> StepEvent:
    return StepEvent(START_NS + round(since_s * NS_PER_S), "step", "", topic, "steps", 9.0, 9)


def impact(x: float, y: float, at_s: float = 1.0) -> list[Event]:
    """Arrivals of an impact in order of time, then its step."""
    since = times_of(np.array([[x, y]]))[0]
    since += at_s - since.min()
    picks = sorted(zip(since.tolist(), NAMES, strict=True))
    return [*(pick(n, s) for s, n in picks), step_at(picks[0][0])]


def said(runner: Any, items: list[Event]) -> list[Event]:
    given = [STEPPED, *items]
    return [e for item in given for e in runner.process(item)] + list(runner.flush())


def fixes(events: list[Event]) -> list[Fix]:
    return [e for e in events if isinstance(e, Fix)]


@pytest.mark.parametrize("method", METHODS)
def test_every_localizer_turns_a_step_and_its_arrivals_into_a_place(method: str) -> None:
    events = said(stage(method), [PICKED, *impact(2.0, 7.0)])
    spec, block, fix = events
    assert isinstance(spec, StageSpec)
    assert (spec.emits, spec.topic) == ("fix", "/s")
    assert isinstance(block, CandidateBlock)
    assert [q.name for q in spec.columns] == ["picks", "residual", "x", "y", "sigma"]
    assert [g.name for g in spec.gates] == ["picks", "residual"]
    assert isinstance(fix, Fix)
    assert (fix.x_m, fix.y_m) == pytest.approx((2.0, 7.0), abs=0.6)
    assert (fix.method, fix.stage, fix.picks) == (method, method, 9)
    assert fix.time_ns == block.time_ns[0]
    assert fix.covariance[0] > 0


def test_of_several_picks_of_a_channel_the_first_after_the_step_counts() -> None:
    items = [PICKED, *impact(2.0, 7.0)]
    late = [pick(n, 1.045) for n in NAMES]
    straight = fixes(said(stage(), items))
    echoed = fixes(said(stage(), [*items[:-1], *late, items[-1]]))
    before = fixes(said(stage(), [PICKED, pick("G1", 0.9), *items[1:]]))
    assert straight == echoed == before


def test_arrivals_after_the_window_are_not_of_the_step() -> None:
    (fix,) = fixes(said(stage(window_s=0.006), [PICKED, *impact(0.5, 0.5)]))
    assert fix.picks < 9


def test_too_few_arrivals_are_a_rejected_candidate() -> None:
    items = [PICKED, pick("G1", 1.0), pick("G2", 1.001), step_at(1.0)]
    _, block = said(stage(), items)
    assert isinstance(block, CandidateBlock)
    assert not block.accepted[0]
    assert block.margin[0, 0] == -1


@pytest.mark.parametrize("method", METHODS)
def test_arrivals_without_a_source_are_rejected_by_their_residual(method: str) -> None:
    since = np.random.default_rng(3).uniform(0, 0.04, 9)
    items = [pick(n, 1.0 + s) for s, n in sorted(zip(since.tolist(), NAMES, strict=True))]
    parameter = "max_residual" if method == "so-tdoa" else "max_residual_s"
    runner = stage(method, **{parameter: 1e-3})
    _, block = said(runner, [PICKED, *items, step_at(1.0)])
    assert isinstance(block, CandidateBlock)
    assert block.margin[0, 0] >= 0
    assert block.margin[0, 1] < 0
    assert not block.accepted[0]


@pytest.mark.parametrize(
    ("method", "geometry", "lacking"),
    [
        ("power-law", None, "places of three or more sensors"),
        ("so-tdoa", replace(SITE, sensors=SITE.sensors[:2]), "places of three or more sensors"),
        ("hyperbolic", replace(SITE, medium=Medium()), "a velocity"),
    ],
)
def test_a_site_that_lacks_what_is_needed_is_said_once(
    method: str, geometry: Geometry | None, lacking: str
) -> None:
    events = said(stage(method, geometry), [PICKED, *impact(2, 7), *impact(3, 7, 2.0)])
    (note,) = events
    assert isinstance(note, Note)
    assert (note.level, note.source) == ("WARN", method)
    assert lacking in note.text


def test_channels_without_a_place_are_left_out() -> None:
    site = replace(SITE, sensors=SITE.sensors[:6])
    (fix,) = fixes(said(stage(geometry=site), [PICKED, *impact(2.0, 7.0)]))
    assert fix.picks == 6


def test_a_velocity_may_be_given_and_signs_may_be_modelled() -> None:
    bare = replace(SITE, medium=Medium())
    for runner in (
        stage("hyperbolic", bare, velocity_mps=1225.0),
        stage("so-tdoa", bare, sign_sigma_s=5e-4),
    ):
        (fix,) = fixes(said(runner, [PICKED, *impact(2.0, 7.0)]))
        assert (fix.x_m, fix.y_m) == pytest.approx((2.0, 7.0), abs=0.6)


def test_steps_and_picks_of_other_stages_and_topics_are_none_of_its_business() -> None:
    other = replace(step_at(1.0), stage="others")
    assert said(stage(), [PICKED, *impact(2, 7)[:-1], other, step_at(1.0, "/t")])[1:] == []


def test_after_a_clock_step_old_arrivals_are_forgotten() -> None:
    *picks, step = impact(2.0, 7.0)
    gap = Gap("/s", START_NS, START_NS, "clock step", 0)
    assert fixes(said(stage(), [PICKED, *picks, gap, step])) == []


def test_a_copy_goes_on() -> None:
    items = [PICKED, *impact(2.0, 7.0), *impact(3.0, 6.0, 1.6)]
    whole = said(stage(), items)
    one = stage()
    events = [e for item in [STEPPED, *items[:5]] for e in one.process(item)]
    other = copy.deepcopy(one)
    assert_same(outcome(whole), outcome([*events, *said(other, items[5:])]), "copied")


def test_a_localizer_without_steps_before_it_is_refused() -> None:
    picks, power = StageConfig("toa-cv"), StageConfig("power-law")
    with pytest.raises(PipelineError, match="power-law: expected a stage that gives steps before"):
        build_pipeline(PipelineConfig("p", stage=(picks, power)))
    with pytest.raises(PipelineError, match="gives picks and one that gives steps"):
        build_pipeline(PipelineConfig("p", stage=(power,)))


def test_steps_are_decided_again_as_if_there_were_no_localizers() -> None:
    config = load_pipeline("room-footsteps")
    with Recording.open(path_of("room-walk.mcap")) as opened:
        chain = build_pipeline(config, opened.geometry)
        stop_ns = opened.start_ns + 4 * NS_PER_S
        found = [e for item in Source(opened, stop_ns=stop_ns) for e in chain.process(item)]
        found += chain.flush()
        start_ns, end_ns = opened.start_ns, opened.end_ns
    assert {f.stage for f in fixes(found)} == {*METHODS, "times-amplitudes", "place"}
    stages = stage_evidence(found, [s.key for s in config.stage])
    evidence = Evidence("w", config, stages, (), (), start_ns, end_ns)
    steps = [e.time_ns for e in found if isinstance(e, StepEvent)]
    assert OfflineDecider(evidence).outcome().step_times().tolist() == steps
    with pytest.raises(PipelineError, match="expected a stage that decides about steps"):
        parse_axis("power-law.max_residual_s=0.001,0.002", config)


def test_three_axes_at_one_place_are_one_sensor_the_vertical() -> None:
    sensors = [Sensor(f"A{axis}", f"A{axis}", 1.0, 2.0, axis=axis) for axis in "xyz"]
    sensors += [Sensor("B", "B", 3.0, 2.0), Sensor("Cx", "Cx", 0.0, 0.0, axis="x")]
    names = ["Ax", "Ay", "Az", "B", "Cx", "unplaced"]
    rows, places = Geometry(tuple(sensors)).placed(names)
    assert rows == {"Az": 0, "B": 1, "Cx": 2}
    assert places.tolist() == [[1.0, 2.0], [3.0, 2.0], [0.0, 0.0]]


def late_impacts(count: int, late_s: float, start_s: float = 1.0) -> list[Event]:
    """Impacts at random places, every other arrival late by that: no place explains them."""
    rng = np.random.default_rng(5)
    items: list[Event] = []
    for number in range(count):
        x, y = rng.uniform(2.0, 8.0, 2)
        since = times_of(np.array([[x, y]]))[0]
        since += rng.permutation(9) % 2 * late_s
        since += start_s + number - since.min()
        picks = sorted(zip(since.tolist(), NAMES, strict=True))
        items += [*(pick(n, s) for s, n in picks), step_at(picks[0][0])]
    return items


def test_a_localizer_whose_residuals_contradict_its_model_says_so_and_doubts_its_places() -> None:
    runner = stage("power-law", max_residual_s=1.0)
    events = said(runner, [PICKED, *late_impacts(12, 0.006), *late_impacts(30, 0.0, 20.0)])
    begun, ended = (e for e in events if isinstance(e, Note))
    assert "contradict what power-law presumes of waves" in begun.text
    assert (begun.level, begun.source) == ("WARN", "power-law")
    assert "those it expects again" in ended.text
    doubted = [(fix.time_ns, fix.doubted) for fix in fixes(events)]
    assert [is_doubted for t, is_doubted in doubted if t < begun.time_ns] == [False] * 7
    assert all(is_doubted for t, is_doubted in doubted if begun.time_ns <= t < ended.time_ns)
    assert not any(is_doubted for t, is_doubted in doubted if t >= ended.time_ns)


@pytest.mark.parametrize("method", METHODS)
def test_a_localizer_whose_model_holds_is_not_doubted(method: str) -> None:
    events = said(stage(method), [PICKED, *late_impacts(25, 3e-4)])
    assert not any(isinstance(e, Note) for e in events)
    assert [fix.doubted for fix in fixes(events)] == [False] * len(fixes(events))


def walked(count: int) -> list[tuple[float, float]]:
    return [(1.0 + 0.5 * k, 2.0) for k in range(count)]


@pytest.mark.parametrize("method", METHODS)
def test_of_a_walk_only_the_sensors_around_the_place_before_are_taken(method: str) -> None:
    runner = stage(method, nearest=5)
    items = [e for k, (x, y) in enumerate(walked(6)) for e in impact(x, y, 1.0 + 0.6 * k)]
    found = fixes(said(runner, [PICKED, *items]))
    assert [f.picks for f in found] == [9, 5, 5, 5, 5, 5]
    off = [np.hypot(f.x_m - x, f.y_m - y) for f, (x, y) in zip(found, walked(6), strict=True)]
    assert max(off) < 1.5


def test_a_place_far_from_the_one_before_is_found_by_all_sensors_after_a_pause() -> None:
    items = [*impact(1.0, 2.0, 1.0), *impact(8.0, 8.0, 4.0)]
    found = fixes(said(stage("power-law", nearest=5), [PICKED, *items]))
    assert [f.picks for f in found] == [9, 9]


def test_fewer_sensors_than_a_place_needs_are_told() -> None:
    events = said(stage("power-law", nearest=2), [PICKED, *impact(2.0, 7.0)])
    assert any("min_picks is 3, but picks reaches 2" in e.text for e in _notes(events))


def _notes(events: list[Event]) -> list[Note]:
    return [e for e in events if isinstance(e, Note)]


def test_what_was_located_by_near_sensors_is_located_again_as_it_was() -> None:
    runner = stage("power-law", nearest=5)
    items = [e for k, (x, y) in enumerate(walked(6)) for e in impact(x, y, 1.0 + 0.6 * k)]
    found = fixes(said(runner, [PICKED, *items]))
    worker = PowerLaw(PowerLaw.Parameters(nearest=5))
    assert worker.begin(PlacedSensors(np.array(SENSORS), np.array(SITE.outline), SITE.medium)) == ""
    channels = dict(zip(NAMES, range(len(NAMES)), strict=True))
    picks = [e for e in items if isinstance(e, Pick)]
    for fix in found:
        times = first_arrivals(picks, channels, fix.time_ns, worker.parameters.window_s)
        again = worker.locate_step(fix.time_ns, times)
        assert (again.x, again.y) == (fix.x_m, fix.y_m)
        xx, xy, yy = fix.covariance
        assert again.covariance == pytest.approx(np.array([[xx, xy], [xy, yy]]), rel=1e-12)
