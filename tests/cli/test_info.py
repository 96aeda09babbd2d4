"""``info`` says what a file is, and what to do next."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from command_runs import Ran, done, run
from scipy.io import savemat

from groundtrace.cli.console import counted, lost_messages
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]


def next_command(ran: Ran) -> list[str]:
    """Return the arguments of the command that the last line names."""
    last = ran.out.splitlines()[-1]
    assert last.startswith("next: groundtrace "), last
    return shlex.split(last.removeprefix("next: groundtrace "))


@pytest.mark.parametrize(
    ("name", "fitting", "others"),
    [
        ("room-walk.mcap", ["room-footsteps", "room-steps", "hammer-shots"], "waist-steps"),
        ("waist-walk.mcap", ["waist-steps", "pedestrian", "heading"], "foot-inertial"),
        ("vehicle-pass.mcap", ["vehicle-tracks", "vehicle-passes"], "waist-steps"),
    ],
)
def test_a_recording_s_fitting_pipelines_are_listed_and_the_next_command_replays_it(
    name: str, fitting: list[str], others: str, capsys: Capture
) -> None:
    ran = done(capsys, "info", "--quick", path_of(name))
    (line,) = [each for each in ran.out.splitlines() if each.startswith("fitting pipelines: ")]
    listed = line.removeprefix("fitting pipelines: ").split(", ")
    assert listed[0] == fitting[0]
    assert set(fitting) <= set(listed)
    assert others not in listed
    assert done(capsys, "info", "--quick", path_of(name), "--json").document["pipelines"] == listed
    arguments = next_command(ran)
    assert arguments == ["replay", str(path_of(name)), "--pipeline", fitting[0]]
    done(capsys, *arguments, "--to", 1, "--no-viewer")


def test_results_say_what_they_are_of_and_what_to_do_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    done(capsys, "replay", path_of("waist-walk.mcap"), "--no-viewer", "--set", "steps.score=0.31")
    ran = done(capsys, "info", "waist-walk.results.mcap")
    first, stage, *_ = ran.out.splitlines()
    assert first.startswith(
        "waist-walk.results.mcap: results of waist-walk.mcap by waist-steps, 59.990 s, "
    )
    assert stage.startswith("stage steps: adaptive: ")
    assert "score 0.31" in stage
    assert next_command(ran) == ["score", "waist-walk.results.mcap"]
    assert "steps: " in done(capsys, *next_command(ran)).out
    said = run(capsys, "why", "waist-walk.results.mcap", "--at", 9999).error
    assert said == "--at: expected 0 to 59.990 s, found 9999 s"
    for command in ("score", "why"):
        said = run(capsys, command, path_of("waist-walk.mcap")).error
        assert said == (
            "waist-walk.mcap: expected results, found a recording; "
            "replay it first: groundtrace replay waist-walk.mcap"
        )


@pytest.mark.parametrize("command", ["info", "replay"])
def test_a_file_of_another_tool_is_named_with_the_command_that_takes_it(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i / 100},{i % 5},{i % 7}\n" for i in range(300))
    Path("walk.csv").write_text("time_s,ax,ay\n" + rows, "utf-8")
    assert run(capsys, command, "walk.csv").error == (
        "walk.csv: expected a recording, found a text table; import it: groundtrace import "
        "walk.csv -o walk.mcap --map MAP.toml (groundtrace import walk.csv --guess writes a map "
        "to start from)"
    )
    done(capsys, "import", "walk.csv", "--guess")
    Path("walk.rrd").write_bytes(b"RRF2" + bytes(40))
    assert run(capsys, command, "walk.rrd").error == (
        "walk.rrd: expected a recording, found a timeline; open it with: rerun walk.rrd"
    )
    savemat("data.mat", {"a": [1.0, 2.0]})
    assert "found a MATLAB file; import it: groundtrace import data.mat -o data.mcap --map " in (
        run(capsys, command, "data.mat").error
    )


def test_counts_agree_with_their_nouns_and_nothing_lost_is_not_told() -> None:
    assert [counted(n, "message") for n in (0, 1, 2)] == ["0 messages", "1 message", "2 messages"]
    assert counted(2, "entry", "entries") == "2 entries"
    assert [lost_messages(n) for n in (None, 0, 3)] == [
        "unknown number of messages lost ",
        "",
        "3 messages lost ",
    ]
