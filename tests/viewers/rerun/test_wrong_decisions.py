from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rerun as rr
from viewer_sessions import STEPS_S, at, read_back, room_session, write_room, write_walker

from groundtrace.api.replay import PlannedReplay
from groundtrace.evaluation.steps import score_steps
from groundtrace.explain.suitability import prepared
from groundtrace.explain.why import explain_steps
from groundtrace.pipeline.config import checked_pipeline
from groundtrace.pipeline.results import ResultsSink, evidence_of, read_results
from groundtrace.simulate.recording import write
from groundtrace.simulate.road import VehicleOptions
from groundtrace.simulate.vehicle import simulate_vehicle
from groundtrace_codecs.events import Label
from groundtrace_codecs.recording import Recording
from groundtrace_recordings import path_of
from groundtrace_viewers.rerun.sink import RerunSink
from groundtrace_viewers.rerun.timeline import MISSED
from groundtrace_viewers.rerun.wrong_decisions import (
    BARS,
    CARD,
    MARGINS,
    REACH,
    VERDICTS,
    Verdict,
    doublings,
    verdicts,
)

if TYPE_CHECKING:
    from pathlib import Path

    from shared_viewer import SharedViewer

    from groundtrace.explain.why import StepExplanation

WALK = path_of("waist-walk.mcap")
#: So high that 21 of the 74 true steps of the bundled walk are missed.
HEIGHT = 2.0

WHOLE = (at(0.0), at(6.0))


def names(found: list[Verdict]) -> list[str]:
    return [one.verdict for one in found]


def bare(found: list[Verdict]) -> list[tuple[int, str]]:
    return [(one.time_ns, one.verdict) for one in found]


def test_a_step_within_the_tolerance_is_a_hit_and_lies_at_the_truth() -> None:
    session = room_session()
    found = verdicts(session, [at(s + 0.1) for s in STEPS_S], WHOLE)
    assert found == [(at(s), "hit", "", at(s + 0.1)) for s in STEPS_S]


def test_what_is_not_found_is_missed_and_what_is_not_there_is_false() -> None:
    found = verdicts(room_session(), [at(STEPS_S[0]), at(1.1)], WHOLE)
    assert bare(found[:2]) == [(at(STEPS_S[0]), "hit"), (at(1.1), "false")]
    assert names(found[2:]) == ["missed"] * (len(STEPS_S) - 1)


def test_nothing_is_said_of_what_is_ignored_or_was_not_replayed() -> None:
    session = room_session()
    ignore = Label(at(1.9), "ignore", end_ns=at(2.1))
    ignoring = replace(session, labels=(*session.labels, ignore))
    assert len(verdicts(ignoring, [], WHOLE)) == len(STEPS_S) - 1
    replayed = verdicts(session, [], (at(1.9), at(2.7)))
    assert bare(replayed) == [(at(2.0), "missed"), (at(2.6), "missed")]


def test_a_step_found_late_is_one_with_the_false_one_in_the_log() -> None:
    session = room_session()
    steps = [at(s) for s in STEPS_S]
    steps[2] += 140_000_000
    wrong = [one for one in verdicts(session, steps, WHOLE) if one.verdict != "hit"]
    assert wrong == [
        (at(STEPS_S[2]), "missed", "found 140 ms late, tolerance 120 ms", None),
        (steps[2], "false", "answers step 3, 140 ms late", None),
    ]


def test_verdicts_count_as_the_score_does() -> None:
    session = room_session()
    rng = np.random.default_rng(5)
    steps = [at(s) for s in rng.uniform(0.0, 6.0, 30)]
    said = names(verdicts(session, steps, WHOLE))
    score = score_steps(session.labels, np.array(steps, np.int64), session.start_ns, session.end_ns)
    assert score is not None
    assert said.count("hit") == score.matched
    assert said.count("missed") == score.truth - score.matched
    assert said.count("false") == score.detected - score.matched


def test_the_lane_and_the_log_lead_to_the_missed_step(tmp_path: Path) -> None:
    path = write_room(tmp_path / "room.rrd")
    times, states = read_back(path, "/state/2-score", "StateChange:state")
    shown = [(t, s) for t, [s] in zip(times.tolist(), states, strict=True) if s]
    expected = ["missed" if k == 2 else "hit" for k in range(len(STEPS_S))]
    assert shown == [(round(t * 1e9), s) for t, s in zip(STEPS_S, expected, strict=True)]
    times, lines = read_back(path, "/log/score", "TextLog:text")
    assert (times.tolist(), lines) == ([2_000_000_000], [["2.000 s  missed step"]])
    assert read_back(path, "/log/score", "TextLog:level")[1] == [["ERROR"]]


def test_a_replay_without_a_stage_for_steps_has_no_verdict(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_walker(tmp_path / "w.rrd"))).store().schema()
    assert "/state/2-score" not in paths.entity_paths()


def test_a_gate_s_distance_is_told_in_doublings_whatever_its_side() -> None:
    assert doublings(1.0, 2.0, passed=False) == -1.0
    assert doublings(0.5, 2.0, passed=True) == 2.0, "an upper limit"
    assert doublings(1e9, 2.0, passed=True) == REACH
    for value, threshold in ((np.inf, 1.0), (np.nan, 1.0), (-1.0, 2.0), (1.0, 0.0), (0.0, 1.0)):
        assert doublings(value, threshold, passed=True) == REACH
        assert doublings(value, threshold, passed=False) == -REACH


def replay_bundled(
    folder: Path, *settings: str, path: Path = WALK, pipeline: str = "waist-peaks"
) -> tuple[Path, Path]:
    """Replay the bundled walk, or another; return the viewer's file and the results."""
    rrd, results = folder / "walk.rrd", folder / "walk.results.mcap"
    with Recording.open(path) as recording:
        asked = checked_pipeline(pipeline, settings)
        plan = PlannedReplay.of(recording, path, prepared(asked, recording))
        plan.run([ResultsSink(results, plan.provenance()), RerunSink(rrd)])
    return rrd, results


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StepExplanation]:
    """Return a replay with missed steps, and what why says of its results."""
    rrd, results = replay_bundled(tmp_path_factory.mktemp("walk"), f"steps.height={HEIGHT}")
    return rrd, explain_steps(evidence_of(read_results(results, evidence=True)))


def test_at_every_miss_the_card_says_what_why_and_what_mends_it(
    walk: tuple[Path, StepExplanation],
) -> None:
    rrd, explained = walk
    times, texts = read_back(rrd, CARD, "TextDocument:text")
    cards = {round(t / 1e9, 3): text for t, [text] in zip(times.tolist(), texts, strict=True)}
    assert len(explained.missed) == 21
    for missed in explained.missed:
        card = cards[round(missed.time_s, 3)]
        assert f"Missed: step {missed.step}," in card
        assert missed.reason.text in card
        assert missed.remedy is not None
        assert f"`--set {missed.remedy.settings[0]}`" in card
        assert f"missed 21 → {missed.remedy.after.fn}," in card
    right = [text for text in cards.values() if text.startswith("### Right")]
    assert len(right) == explained.counts.tp
    numbers = [re.match(r"### (?:Right|Missed): step (\d+),", text) for text in cards.values()]
    assert sorted(int(found[1]) for found in numbers if found) == list(range(1, 75))


def test_beyond_some_wrong_steps_the_card_says_who_looks_for_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace_viewers.rerun.wrong_decisions.MOST_MENDED", 2)
    rrd, _ = replay_bundled(tmp_path, f"steps.height={HEIGHT}")
    _, texts = read_back(rrd, CARD, "TextDocument:text")
    missed = [text for [text] in texts if text.startswith("### Missed")]
    assert ["--set steps" in text for text in missed] == [True] * 2 + [False] * (len(missed) - 2)
    assert all("groundtrace why --step" in text for text in missed[2:])


def test_at_every_decision_there_is_a_bar_for_each_gate(walk: tuple[Path, StepExplanation]) -> None:
    rrd, explained = walk
    times, bars = read_back(rrd, f"{BARS}/bar", "LineStrips2D:strips")
    _, colours = read_back(rrd, f"{BARS}/bar", "LineStrips2D:colors")
    assert len(bars[0]) == 0, "before the first decision"
    first = explained.missed[0]
    row = [round(t / 1e9, 3) for t in times.tolist()].index(round(first.time_s, 3))
    lengths = [strip[1][0] for strip in bars[row]]
    assert [length < 0 for length in lengths] == [not g.passed for g in first.reason.readings]
    assert [c == MISSED for c in colours[row]] == [not g.passed for g in first.reason.readings]


def test_the_log_names_cause_and_remedy_of_every_wrong_step(
    walk: tuple[Path, StepExplanation],
) -> None:
    rrd, explained = walk
    _, lines = read_back(rrd, "/log/score", "TextLog:text")
    for [line], missed in zip(lines, explained.missed, strict=True):
        short = missed.reason.text.partition(" (margin")[0]
        assert f"missed step {missed.step}: {short}; --set steps.height=" in line


def test_wrong_steps_have_a_list_of_their_own(tmp_path: Path, viewer: SharedViewer) -> None:
    rrd, _ = replay_bundled(tmp_path, f"steps.height={HEIGHT}")
    state, _ = viewer.show(rrd, 1.0)
    views = {view.origin: view.name for view in state.views if view.kind == "TextLog"}
    assert views["/log/score"] == "Wrong: 21 missed, 0 false"
    assert views["/log"] == "Events"


def test_misses_are_bands_as_wide_as_the_tolerance(walk: tuple[Path, StepExplanation]) -> None:
    rrd, explained = walk
    for path in ("/missed/imu/waist", f"{MARGINS}/missed", "/detector/steps/imu/waist/missed"):
        times, _ = read_back(rrd, path, "Measurements:values")
        spans = times.reshape(-1, 3)
        assert len(spans) == len(explained.missed)
        assert np.allclose(spans[:, 1] - spans[:, 0], 240e6)


def test_where_no_step_is_wrong_there_is_no_card(tmp_path: Path) -> None:
    rrd, _ = replay_bundled(tmp_path)
    paths = rr.chunk.RrdReader(str(rrd)).store().schema().entity_paths()
    assert "/state/2-score" in paths
    assert CARD not in paths


def test_a_missed_pass_says_which_gate_and_what_mends_it(tmp_path: Path) -> None:
    cars = tmp_path / "cars.mcap"
    layout = VehicleOptions(layout="stations", passes=1, duration_s=40.0, rate_hz=100.0)
    write(simulate_vehicle(layout), cars)
    rrd, _ = replay_bundled(tmp_path, "passes.fast_leg=5", path=cars, pipeline="vehicle-passes")
    _, texts = read_back(rrd, CARD, "TextDocument:text")
    assert len(texts) == 1 + 3, "three stations, and before the first"
    for [text] in texts[1:]:
        assert text.startswith("### Missed: pass of V1 at S")
        assert "`--set passes.fast_leg=" in text


def test_at_a_step_that_too_few_sensors_picked_each_says_what_it_lacked(tmp_path: Path) -> None:
    room = path_of("room-walk.mcap")
    rrd, results = replay_bundled(tmp_path, "picks.ratio=1800", path=room, pipeline="room-steps")
    explained = explain_steps(evidence_of(read_results(results, evidence=True)))
    missed = next(m for m in explained.missed if m.reason.channels)
    at_ns = round(missed.time_s * 1e9)
    times, words = read_back(rrd, f"{VERDICTS}/words", "Points2D:labels")
    row = int(np.argmin(np.abs(times - at_ns)))
    assert len(words[row]) == len(missed.reason.channels), "the others have a green ring"
    assert all(word.endswith(" < 1800") for word in words[row])
    _, rings = read_back(rrd, f"{VERDICTS}/rings", "LineStrips2D:strips")
    assert len(rings[row]) == 9 + 1, "each sensor, and where the step was"
    _, cards = read_back(rrd, CARD, "TextDocument:text")
    assert any("picked on 2 of 4 channels needed  \n" in text for [text] in cards)
    right = [one for one, row in zip(times.tolist(), words, strict=True) if not row]
    assert len(right) == explained.counts.tp, "no rings at a step that is right"
