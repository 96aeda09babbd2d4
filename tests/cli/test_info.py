"""``info`` says what a file is, and what to do next."""

from __future__ import annotations

import shlex

import pytest
from command_runs import Ran, done

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


def test_counts_agree_with_their_nouns_and_nothing_lost_is_not_told() -> None:
    assert [counted(n, "message") for n in (0, 1, 2)] == ["0 messages", "1 message", "2 messages"]
    assert counted(2, "entry", "entries") == "2 entries"
    assert [lost_messages(n) for n in (None, 0, 3)] == [
        "unknown number of messages lost ",
        "",
        "3 messages lost ",
    ]
