from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from page_sessions import write_walk
from viewer_sessions import IMU, SEISMIC, at, decisions, room_session

from groundtrace.cli.replay import replay
from groundtrace.pipeline.results import read_results
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.events import Fix, Gap, Label, Note, StepEvent
from groundtrace_viewers.errors import ViewerError
from groundtrace_viewers.rerun.moments import (
    PENDING,
    PageMoment,
    PageMoments,
    moments_of_results,
    moments_of_session,
    opening_s,
)
from groundtrace_viewers.web.annotate import RenewedMoments, replayed

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace.pipeline.results import Results

PIPELINE = """
name = "room"
application = "room"
[[stage]]
use = "sta-lta"
name = "picker"
[[stage]]
use = "coincidence"
name = "associate"
"""


def moments(*more: object) -> PageMoments:
    session = replace(room_session(), pipeline=PIPELINE, labels=())
    return moments_of_session(session, [*decisions(), *more])


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Results:
    folder = tmp_path_factory.mktemp("walked")
    return replayed(write_walk(folder / "walk.mcap"), None, "", folder)[1]


def test_results_of_a_span_are_shown_over_that_span(tmp_path: Path) -> None:
    recording, part = write_walk(tmp_path / "walk.mcap"), tmp_path / "part.mcap"
    replay(recording, from_=3.0, to=8.0, out=part, no_viewer=True)
    (tmp_path / "page").mkdir()
    _, shown = replayed(recording, part, "", tmp_path / "page")
    made = read_results(part).provenance
    assert (shown.provenance.from_ns, shown.provenance.to_ns) == (made.from_ns, made.to_ns)


def test_every_event_that_a_person_looks_for_is_listed_by_time() -> None:
    found = moments(
        Gap("/seismic", at(2.2), at(2.3), "missing", 200),
        Gap("/seismic", at(2.4), at(2.41), "missing", 20, bridged=True),
        Gap("/seismic", at(2.5), at(2.5), "clock step", 0, bridged=True),
        Fix(at(2.6), 1.5, 2.25, (0.1, 0.0, 0.1), 0.1, "hyperbolic", 4, "places"),
        Note(at(3.0), "loud", "WARN", "picker"),
        Note(at(3.1), "chatter", "INFO", "picker"),
    )
    times = [m.t_s for m in found.events]
    assert times == sorted(times)
    texts = {(m.kind, m.text) for m in found.events}
    assert {("gap", "/seismic missing, 200 lost"), ("fix", "(1.50, 2.25) m")} <= texts
    assert ("note", "loud") in texts
    assert ("note", "chatter") not in texts
    assert ("gap", "/seismic missing, 20 lost") not in texts
    assert ("gap", "/seismic clock step, 0 lost") in texts


def test_it_opens_at_what_is_wrong_first_else_at_a_step_else_at_any_event() -> None:
    gap, step = PageMoment(0.5, "gap", "", ""), PageMoment(2.0, "step", "", "")
    assert opening_s([gap, step], [PageMoment(9.0, "missed", "", "")]) == 9.0
    assert opening_s([gap, step], []) == 2.0
    assert opening_s([gap], []) == 0.5
    assert opening_s([], []) == 0.0
    found = moments()
    assert found.opens_s == next(m.t_s for m in found.events if m.kind == "step")


def test_the_page_knows_how_long_samples_and_frames_are() -> None:
    found = moments()
    assert (found.sample_of, found.sample_s) == ("/seismic", 1 / SEISMIC.rate_hz)
    assert found.channels == tuple(c.name for stream in (SEISMIC, IMU) for c in stream.channels)
    assert found.start_ns == str(room_session().start_ns)


def test_only_the_stage_with_the_last_word_makes_steps() -> None:
    other = StepEvent(at(4.7), "step", "", "/seismic", "an earlier stage", 1.0)
    found = moments(other)
    assert found.steps == "associate"
    assert {m.stage for m in found.events if m.kind == "step"} == {"associate"}


def test_a_missed_step_says_why_and_a_false_one_what_let_it_pass(walked: Results) -> None:
    steps = [e for e in walked.events if isinstance(e, StepEvent)]
    quiet_ns = walked.provenance.start_ns + 100_000_000
    here = Label(steps[0].time_ns, "step")
    found = moments_of_results(walked, labels=(Label(quiet_ns, "step"), here))
    missed = [m for m in found.misses if m.kind == "missed"]
    false = [m for m in found.misses if m.kind == "false"]
    assert [m.t_s for m in missed] == [0.1]
    assert missed[0].text.partition(":")[0] in ("threshold", "quiet", "filter")
    assert len(false) == len(steps) - 1
    assert all("threshold" in m.text for m in false)


def test_a_wrong_step_says_what_mends_it_and_other_thresholds_what_they_would_make(
    walked: Results,
) -> None:
    steps = [e for e in walked.events if isinstance(e, StepEvent)]
    found = moments_of_results(walked, labels=(Label(steps[0].time_ns, "step"),))
    (first, *_) = [m for m in found.misses if m.kind == "false"]
    assert first.gates
    assert [(g.passed, g.doublings >= 0) for g in first.gates] == [(True, True)] * len(first.gates)
    mended = [m for m in found.misses if m.remedy]
    assert all(f"false {len(steps) - 1} → " in m.effect for m in mended)
    assert found.curves
    for curve in found.curves:
        at = curve.values.index(curve.now)
        assert (curve.right[at], curve.missed[at], curve.false[at]) == (1, 0, len(steps) - 1)


def test_a_page_opens_before_all_causes_are_found_and_is_told_them_later(
    walked: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels = (Label(walked.provenance.start_ns, "step"),)
    whole = moments_of_results(walked, labels=labels)
    first = moments_of_results(walked, labels=labels, within_s=0.0)
    assert (first.pending, whole.pending) == (len(whole.misses), 0)
    assert [(m.t_s, m.kind) for m in first.misses] == [(m.t_s, m.kind) for m in whole.misses]
    assert {m.text for m in first.misses} == {PENDING}

    monkeypatch.setattr("groundtrace_viewers.web.annotate.OPENING_S", 0.0)
    wrong = replace(walked, labels=labels)
    told = RenewedMoments(wrong, ())
    deadline = time.monotonic() + 30.0
    while json.loads(told.json())["pending"] and time.monotonic() < deadline:
        time.sleep(0.05)
    assert told.json() == moments_of_results(wrong).json()


def test_without_truth_nothing_is_wrong(walked: Results) -> None:
    found = moments_of_results(walked, labels=())
    assert (found.truth, found.misses, found.curves) == (False, (), ())
    assert found.events


def test_frames_are_those_of_the_detector(walked: Results) -> None:
    assert moments_of_results(walked).frame_s == pytest.approx(0.05)


def test_the_document_is_made_of_what_browsers_can_read(walked: Results) -> None:
    document = json.loads(moments_of_results(walked).json())
    assert document["sha256"] == walked.provenance.sha256
    assert document["timeline"] == "t"
    assert isinstance(document["start_ns"], str)
    assert document["sample_s"] is None


def test_results_choose_the_pipeline_and_those_of_another_recording_are_refused(
    tmp_path: Path,
) -> None:
    recording = write_walk(tmp_path / "walk.mcap")
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
    _, first = replayed(recording, None, "", tmp_path / "first")
    results = tmp_path / "first" / "results.mcap"
    _, again = replayed(recording, results, "", tmp_path / "again")
    assert again.provenance.pipeline == first.provenance.pipeline
    other = tmp_path / "other.mcap"
    write(simulate_walk(WalkOptions(seed=4, duration_s=2.0)), other)
    with pytest.raises(ViewerError, match=r"expected results of other\.mcap as it is, found"):
        replayed(other, results, "", tmp_path)
