"""What once led users astray, a row each: what was typed, and what is said of it now."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from command_runs import Ran, done, run

from groundtrace_codecs.importers.run import MAPPED
from groundtrace_recordings import path_of

Capture = pytest.CaptureFixture[str]
#: In a folder with walk.mcap and its results, shots.mcap and its results, results that warn, a torn
#: walk, a text table and a MATLAB file: what was typed, how it ends, and what is said.
SAID = {
    # a pipeline that does not fit is refused before anything is read, by name of those that do
    "replay walk.mcap --pipeline foot-inertial": (1, "needs a sensor on the foot; walk.mcap has"),
    "replay walk.mcap --pipeline vehicle-passes": (1, "positions; walk.mcap has acceleration, "),
    "replay walk.mcap --pipeline hammer-shots": (1, ". Fitting: heading, pedestrian-aligned, "),
    "info walk.mcap": (0, "\nfitting pipelines: waist-steps, "),
    # files of other tools: what they are, and the command that takes them
    "info table.csv": (1, "table.csv: expected a recording, found a text table; import it: "),
    "replay table.csv": (1, "groundtrace import table.csv --guess writes a map to start from"),
    "import table.csv -o a.mcap": (1, "groundtrace import table.csv --guess writes one"),
    "info data.mat": (1, "import data.mat -o data.mcap --map MAP.toml"),
    "replay data.mat": (1, "found a MATLAB file; import it: groundtrace import data.mat"),
    "import data.mat --guess": (1, "found a MATLAB file: write its map by hand"),
    # recordings in the place of results, and the other way round
    "score walk.mcap": (1, "replay it first: groundtrace replay walk.mcap"),
    "why walk.mcap": (1, "replay it first: groundtrace replay walk.mcap"),
    "info walk.results.mcap": (0, "results of walk.mcap by waist-steps, "),
    # what is asked about is of the results, and within them
    "why shots.results.mcap": (0, "first-breaks: 31 right to 2 ms, 4 late, 13 early, 0 missed"),
    "score shots.results.mcap": (0, "31 right to 2 ms, 4 late, 13 early; 0 missed"),
    "why walk.results.mcap --at 9999": (2, "--at: expected 0 to 11.990 s, found 9999 s"),
    # damage: a count, or that it is unknown; nothing about nothing
    "doctor torn.mcap": (0, "\nlost: an unknown number\n"),
    "info torn.mcap": (0, "damage: unknown number of messages lost at byte "),
    "convert torn.mcap -o copy.mcap": (3, ": damage, unknown number of messages lost: "),
    # imports say what applies, and the next command
    "import table.csv -o a.mcap --map table.toml": (
        0,
        "imported table.csv (csv) into a.mcap: 1 stream, 0.990 s\n  /acc: 100 samples\n"
        "next: groundtrace info a.mcap\n",
    ),
}
#: What is said of nothing.
NEVER = ("0 messages", "? messages", "1 files", "1 notes", "1 settings", "0 sensors")
MAP = """format = "csv"
time = {column = "t", unit = "s"}
[[stream]]
topic = "/acc"
columns = [{column = "x", quantity = "acceleration", axis = "x", unit = "m/s2"}]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the folder, once."""
    from groundtrace.cli.main import main

    folder = tmp_path_factory.mktemp("files")
    patch = pytest.MonkeyPatch()
    patch.chdir(folder)
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "12", "-o", "walk.mcap"])
    shutil.copy(path_of("shots.mcap"), "shots.mcap")
    for name in ("walk", "shots"):
        main(["replay", f"{name}.mcap", "--no-viewer"])
    torn = path_of("waist-walk.mcap").read_bytes()
    Path("torn.mcap").write_bytes(torn[: len(torn) * 2 // 3])
    rows = "".join(f"{i / 100:.2f},{i % 7}\n" for i in range(100))
    Path("table.csv").write_text(f"t,x\n{rows}", "utf-8")
    Path("table.toml").write_text(MAP, "utf-8")
    scipy.io.savemat("data.mat", {"x": np.arange(9.0)})
    patch.undo()
    return folder


def ran_there(files: Path, capsys: Capture, line: str) -> Ran:
    """Run a command in a copy of the folder, which is the current one."""
    shutil.copytree(files, ".", dirs_exist_ok=True)
    return run(capsys, *line.split())


@pytest.mark.parametrize("line", SAID, ids=str)
def test_what_led_astray_says_what_to_do(line: str, files: Path, capsys: Capture) -> None:
    ran = ran_there(files, capsys, line)
    said = ran.out + ran.err
    code, expected = SAID[line]
    assert (ran.code, expected in said) == (code, True), said
    for nothing in NEVER:
        assert not re.search(rf"(?<![\d.]){re.escape(nothing)}\b", said)


def test_a_warning_is_printed_once_and_the_document_says_how_often_and_since_when(
    files: Path, capsys: Capture
) -> None:
    line = "replay shots.mcap --no-viewer"
    lines = ran_there(files, capsys, line).out.splitlines()
    said = [each for each in lines if each.startswith("warning: ")]
    warned = run(capsys, *line.split(), "--json").document["warnings"]
    assert [f"warning: {each['text']}" for each in warned] == said
    assert said[0].startswith("warning: 12 of 48 sensors of the geometry have no channel")
    assert (warned[0]["count"], warned[0]["time_s"]) == (1, 0.0)


def test_score_and_why_agree_on_what_was_found_missed_and_late(
    files: Path, capsys: Capture
) -> None:
    scored = ran_there(files, capsys, "score shots.results.mcap --json").document
    explained = run(capsys, "why", "shots.results.mcap", "--json").document
    states = ("right", "late", "early", "missed")
    assert scored["picks"]["stage"] == explained["stage"] == "first-breaks"
    counts = {state: explained["counts"][state] for state in states}
    assert {state: scored["picks"]["all"][state] for state in states} == counts
    assert sum(counts.values()) == scored["picks"]["all"]["truth"] == 48


def test_a_length_is_the_same_wherever_it_is_told(files: Path, capsys: Capture) -> None:
    command = "import table.csv -o a.mcap --map table.toml --json"
    imported = ran_there(files, capsys, command).document
    shown = run(capsys, "info", "a.mcap", "--json").document
    assert (imported["end_ns"] - imported["start_ns"]) / 1e9 == shown["duration_s"] == 0.99


def test_plugins_are_grouped_by_what_users_do(capsys: Capture) -> None:
    rows = done(capsys, "plugins").out.splitlines()[1:]
    uses = dict.fromkeys(row.split()[0] for row in rows)
    assert list(uses) == ["detect", "locate", "track", "import", "export", "show"]
    assert set(MAPPED) <= {row.split()[1] for row in rows if row.startswith("import")}
