"""Sweeps over what decides about vehicles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from command_runs import check_schema, done

from groundtrace.explain.reasons import PassTruth, scored_event
from groundtrace.explain.redecide import parse_axis
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.gates import Candidates
from groundtrace_codecs.events import StageSpec

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

S = 1_000_000_000


def truth(*, while_present: bool) -> PassTruth:
    times = {"A": np.array([100, 200]) * S, "B": np.array([110]) * S}
    return PassTruth(times, {"Ax": "A", "Ay": "A", "B": "B"}, (), 1.0, while_present=while_present)


def passed(*rows: tuple[float, int]) -> list[tuple[StageSpec, Candidates]]:
    spec = StageSpec("s", "p", "/t", ("Ax", "Ay", "B"), (), (), (), "pass")
    times = np.array([round(t * S) for t, _ in rows], np.int64)
    channels = np.array([c for _, c in rows], np.int32)
    return [(spec, Candidates(times, channels, np.zeros((len(rows), 1), np.float32)))]


def test_a_pass_told_answers_one_true_pass_of_its_station() -> None:
    found = truth(while_present=False).verdicts(
        passed((100.4, 0), (100.9, 1), (110.2, 0), (111.5, 2))
    )
    assert found.hit.tolist() == [True, False, False]
    assert sorted((found.false_ns / S).tolist()) == [100.9, 110.2, 111.5]
    assert truth(while_present=False).verdicts([]).hit.tolist() == [False] * 3


def test_a_stay_that_is_heard_answers_what_comes_by_in_it_and_is_false_far_from_all() -> None:
    near = [(t, 0) for t in np.arange(90, 108, 0.5)]
    far = [(t, 0) for t in np.arange(140, 150, 0.5)]
    found = truth(while_present=True).verdicts(passed(*near, *far, (108, 2)))
    assert found.hit.tolist() == [True, False, False]
    assert (found.false_ns / S).tolist() == [140]


def test_what_is_counted_follows_the_pipeline() -> None:
    passes, tracks = load_pipeline("vehicle-passes"), load_pipeline("vehicle-tracks")
    assert (scored_event(passes), scored_event(tracks)) == ("pass", "presence")
    assert parse_axis("presence.over_floor=3:9:3", passes).remeasure
    assert not parse_axis("presence.over_floor=3:9:3", tracks).remeasure
    assert not parse_axis("passes.prominence=6,8", passes).remeasure


def test_gates_of_passes_are_swept_from_results_and_those_of_presence_measured_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ("--layout", "stations", "--duration-s", "30", "--rate-hz", "100")
    done(capsys, "simulate", "vehicle", "-o", "road.mcap", *options)
    done(capsys, "replay", "road.mcap", "--no-viewer")
    grid = ("--grid", "passes.prominence=6,60", "--grid", "presence.over_floor=5,60")
    swept = done(capsys, "sweep", "road.results.mcap", *grid, "--jobs", "1", "--json").document
    check_schema("sweep", swept)
    assert (swept["counted"], swept["truth"], swept["rate"]["measurements"]) == ("passes", 3, 1)
    best, now = swept["best"], swept["now"]
    assert best["settings"] == {"passes.prominence": 6, "presence.over_floor": 5}
    assert (best["tp"], best["fp"], best["fn"]) == (now["tp"], now["fp"], now["fn"]) == (3, 0, 0)
    assert "3 true passes" in done(capsys, "sweep", "road.results.mcap", *grid[:2]).out
