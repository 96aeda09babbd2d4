"""What a shell is told: 0 done, 1 input, 2 usage, 3 losses, 130 interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import run

from groundtrace.cli import replay as replay_command
from groundtrace.cli.exit_codes import ExitCode
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).parents[2]
WALK = str(path_of("waist-walk.mcap"))
REPLAY = ("replay", "walk.mcap", "--no-viewer", "--to", "12")
#: Each command, and how it ends, beside walk.mcap, its walk.results.mcap and torn.mcap.
ENDINGS: dict[ExitCode, Sequence[tuple[str, ...]]] = {
    ExitCode.DONE: [
        ("info", "walk.mcap"),
        ("info", "torn.mcap"),
        REPLAY,
        ("score", "walk.results.mcap"),
        ("doctor", "torn.mcap", "--repair", "mended.mcap"),
    ],
    ExitCode.ERROR: [
        ("info", "none.mcap"),
        ("info", "notes.txt"),
        ("score", "walk.mcap"),
        ("replay", "walk.mcap", "--no-viewer", "--out", "notes.txt"),
        ("replay", "walk.mcap", "--no-viewer", "--pipeline", "room-footsteps"),
        ("replay", "walk.mcap", "--no-viewer", "--pipeline", "notes.txt"),
        ("replay", "torn.mcap", "--no-viewer", "--strict"),
    ],
    ExitCode.USAGE: [
        ("raplay", "walk.mcap"),
        ("replay", "walk.mcap", "--piepline", "waist-steps"),
        ("replay", "walk.mcap", "--from", "early"),
        ("replay", "walk.mcap", "--from", "5", "--to", "4"),
        ("replay", "walk.mcap", "--from", "1e6"),
        ("replay", "walk.mcap", "--pipeline", "waist-stpes"),
        (*REPLAY, "--set", "steps.swin=0.3"),
        (*REPLAY, "--pipeline", "waist-steps", "--set", "steps.score=much"),
        ("replay", "walk.mcap", "--full-rate", "some"),
        ("why", "walk.results.mcap", "--at", "9999"),
        ("why", "walk.results.mcap", "--step", "9999"),
        ("why", "walk.results.mcap", "--step", "1", "--kind", "picks"),
        ("sweep", "walk.results.mcap", "--grid", "steps.swin=0.1:0.2:3"),
        ("cut", "walk.mcap", "-o", "part.mcap", "--from", "1e6"),
        ("export", "walk.results.mcap", "-o", "a.geojson", "--origin", "here"),
        ("filter", "walk.mcap", "-o", "part.mcap"),
        ("import", "walk.csv"),
        ("figure", "walk.results.mcap", "-o", "a.png"),
        ("share", "walk.results.mcap", "-o", "a.html", "--zip"),
        ("fleet", "walk.mcap", "-o", "table.csv"),
        ("merge", "-o", "both.mcap"),
    ],
    ExitCode.LOSSES: [
        ("replay", "torn.mcap", "--no-viewer"),
        ("convert", "torn.mcap", "-o", "copy.mcap"),
        ("cut", "torn.mcap", "-o", "copy.mcap", "--to", "12"),
        ("filter", "torn.mcap", "-o", "copy.mcap", "--topic", "/imu/*"),
        ("export", "torn.mcap", "-o", "tables", "--kind", "signals"),
        ("fleet", "walk.mcap", "torn.mcap", "notes.mcap", "-o", "t.parquet", "--workers", "1"),
    ],
}
CASES = [(code, words) for code, commands in ENDINGS.items() for words in commands]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What lies in the folder of each case, by its name."""
    folder = tmp_path_factory.mktemp("files")
    walk = path_of("waist-walk.mcap").read_bytes()
    patch = pytest.MonkeyPatch()
    patch.chdir(folder)
    Path("walk.mcap").write_bytes(walk)
    replay_command.replay(Path("walk.mcap"), no_viewer=True, to=12.0)
    patch.undo()
    return {
        "walk.mcap": walk,
        "walk.results.mcap": (folder / "walk.results.mcap").read_bytes(),
        "torn.mcap": walk[: len(walk) * 2 // 3],
        "notes.txt": b"of a person\n",
        "notes.mcap": b"of a person\n",
    }


@pytest.mark.parametrize(("code", "words"), CASES, ids=[" ".join(words) for _, words in CASES])
def test_a_command_ends_as_the_table_says(
    code: ExitCode,
    words: tuple[str, ...],
    files: dict[str, bytes],
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name, content in files.items():
        Path(name).write_bytes(content)
    ran = run(capsys, *words)
    assert ran.code == code, ran.err
    if code in (ExitCode.ERROR, ExitCode.USAGE):
        assert ran.out == ""
        assert ran.err


def test_a_command_that_the_user_stops_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(replay_command, "_run", stopped)
    assert run(capsys, "replay", WALK, "--no-viewer").code == ExitCode.INTERRUPTED


def test_all_that_is_wrong_with_how_a_replay_was_asked_is_said_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    settings = ("steps.swin=0.3", "stpes.swing=0.3", "steps.score=much", "steps.score", "a=1")
    sets = [word for setting in settings for word in ("--set", setting)]
    asked = ("--pipeline", "waist-steps", *sets, "--from", 5, "--to", 4, "--at-miss", 1)
    ran = run(capsys, "replay", "none.mcap", *asked)
    assert (ran.code, ran.out) == (2, "")
    said = [line.removeprefix("groundtrace: ") for line in ran.err.splitlines()]
    assert len(said) == len(settings) + 2
    assert "did you mean swing?" in said[0]
    assert "did you mean steps?" in said[1]
    assert said[2] == "steps.score: expected float >= 0 and <= 1, found 'much'"
    assert said[-2] == "--to: expected more than --from 5, found 4"
    assert said[-1].startswith("--at-miss: expected no --from")


def test_the_page_of_the_command_line_lists_every_code() -> None:
    page = (ROOT / "docs/command-line.md").read_text("utf-8")
    rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")]
    assert [int(row) for row in rows if row.isdigit()] == [code.value for code in ExitCode]
