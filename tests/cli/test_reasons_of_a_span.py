"""``why`` and ``sweep`` of a span's results say what those of the whole recording do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from command_runs import done

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]
ROOM, BACK = path_of("room-walk.mcap"), path_of("lower-back.mcap")


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def replayed(capsys: Capture, name: str, recording: Path, *options: object) -> str:
    results = f"{name}.results.mcap"
    done(capsys, "replay", recording, "--no-viewer", "--quiet", "--out", results, *options)
    return results


@pytest.mark.parametrize("from_s", [8.0, 20.0, 24.3, 24.53])
def test_a_missed_step_of_a_span_has_the_reason_that_it_has_in_the_whole(
    from_s: float, capsys: Capture
) -> None:
    pipeline = ("--pipeline", "waist-steps")
    whole = replayed(capsys, "whole", BACK, *pipeline)
    part = replayed(capsys, "part", BACK, *pipeline, "--from", from_s, "--to", 40)

    def reasons(results: str) -> dict[float, Any]:
        missed = done(capsys, "why", results, "--json").document["missed"]
        inside = (m for m in missed if from_s <= m["time_s"] < 40)
        return {round(m["time_s"], 3): m["reason"] for m in inside}

    found, of_whole = reasons(part), reasons(whole)
    assert found == of_whole
    assert bool(found) == (from_s < 24.52)


@pytest.mark.parametrize("from_s", [0.85, 0.9, 3.0, 6.31])
def test_a_sweep_of_a_span_begins_with_what_the_span_decided(
    from_s: float, capsys: Capture
) -> None:
    part = replayed(capsys, "part", ROOM, "--pipeline", "room-steps", "--from", from_s)
    score = done(capsys, "score", part, "--json").document["steps"]
    grid = ("--grid", "picks.refractory_s=0.05,0.25", "--grid", "picks.ratio=5,10")
    swept = done(capsys, "sweep", part, *grid, "--json").document
    now, right = swept["now"], score["matched"]
    stands = (right, score["detected"] - right, score["truth"] - right)
    assert (now["tp"], now["fp"], now["fn"]) == stands
