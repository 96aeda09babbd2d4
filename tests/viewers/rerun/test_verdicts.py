from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from viewer_sessions import STEPS_S, at, read_back, room_session, write_room, write_walker

from groundtrace.evaluation.steps import score_steps
from groundtrace_codecs.events import Label
from groundtrace_viewers.rerun.decisions import Verdict, verdicts

if TYPE_CHECKING:
    from pathlib import Path

WHOLE = (at(0.0), at(6.0))


def names(found: list[Verdict]) -> list[str]:
    return [one.verdict for one in found]


def bare(found: list[Verdict]) -> list[tuple[int, str]]:
    return [(one.time_ns, one.verdict) for one in found]


def test_a_step_within_the_tolerance_is_a_hit_and_lies_at_the_truth() -> None:
    session = room_session()
    found = verdicts(session, [at(s + 0.1) for s in STEPS_S], WHOLE)
    assert found == [(at(s), "hit", "") for s in STEPS_S]


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
        (at(STEPS_S[2]), "missed", "found 140 ms late, tolerance 120 ms"),
        (steps[2], "false", "answers step 3, 140 ms late"),
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
    assert (times.tolist(), lines) == ([2_000_000_000], [["missed step at +2.000 s"]])
    assert read_back(path, "/log/score", "TextLog:level")[1] == [["ERROR"]]


def test_a_replay_without_a_stage_for_steps_has_no_verdict(tmp_path: Path) -> None:
    paths = rr.chunk.RrdReader(str(write_walker(tmp_path / "w.rrd"))).store().schema()
    assert "/state/2-score" not in paths.entity_paths()
