"""Every command that writes: what is there stays without --force, what is read is only read."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from command_runs import done, run

from groundtrace.cli.main import main
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

Capture = pytest.CaptureFixture[str]
SITE = "".join(
    f'[[sensor]]\nname = "G{i}"\nchannel = "G{i}"\nx = {x}\ny = {y}\n'
    for i, (x, y) in enumerate([(0, 0), (5, 0), (5, 5), (0, 5)])
)
MAP = """format = "csv"
time = {column = "t"}
[[stream]]
topic = "/imu"
columns = [{column = "a", quantity = "acceleration", axis = "z", unit = "g"}]
"""
#: Inputs of all commands, in a folder of their own.
WALK, RESULTS, TABLE, SITE_TOML = (
    "in/walk.mcap",
    "in/walk.results.mcap",
    "in/table.csv",
    "in/site.toml",
)
#: Each command that writes, OUT standing for its output.
WRITES: tuple[tuple[object, ...], ...] = (
    ("import", TABLE, "--map", "in/map.toml", "-o", "OUT"),
    ("import", TABLE, "--guess", "-o", "OUT"),
    ("replay", WALK, "--no-viewer", "--out", "OUT"),
    ("replay", WALK, "--out", "new.mcap", "--rrd", "OUT"),
    ("score", RESULTS, "--html", "OUT"),
    ("why", RESULTS, "--at", 2, "--rrd", "OUT"),
    ("compare", RESULTS, RESULTS, "--rrd", "OUT"),
    ("sweep", RESULTS, "--grid", "steps.swing=0.4:0.6:3", "--write", "OUT"),
    ("sweep", RESULTS, "--grid", "steps.swing=0.4:0.6:3", "--figure", "OUT"),
    ("export", RESULTS, "--kind", "steps", "-o", "OUT.csv"),
    ("export", WALK, "-o", "OUT", "--format", "ros2"),
    ("cut", WALK, "--to", 2, "-o", "OUT"),
    ("filter", WALK, "--topic", "/truth", "-o", "OUT"),
    ("convert", WALK, "-o", "OUT"),
    ("merge", WALK, RESULTS, "-o", "OUT"),
    ("fleet", WALK, "--pipeline", "waist-steps", "-o", "OUT.parquet"),
    ("doctor", WALK, "--repair", "OUT"),
    ("share", RESULTS, "--single-file", "-o", "OUT.html"),
    ("share", RESULTS, "--zip", "-o", "OUT.zip"),
    ("annotate", WALK, "--commit", "-o", "OUT"),
    ("calibrate", WALK, "--geometry-out", "OUT"),
    ("analyze", "room", SITE_TOML, "--png", "OUT"),
    ("analyze", "room", SITE_TOML, "--rrd", "OUT"),
    ("simulate", "room", "--steps", 3, "-o", "OUT"),
    ("simulate", "walk", "--duration-s", 5, "-o", "OUT"),
    ("simulate", "vehicle", "-o", "OUT"),
)
#: Commands whose output is a folder.
FOLDERS: tuple[tuple[object, ...], ...] = (
    ("export", RESULTS, "-o", "OUT"),
    ("share", RESULTS, "-o", "OUT"),
)
#: Of the commands that read, those that do so each in its own way, the quick ones.
READS: tuple[tuple[object, ...], ...] = (
    ("info", WALK),
    ("info", RESULTS),
    ("import", TABLE, "--map", "in/map.toml", "-o", "OUT"),
    ("import", TABLE, "--guess", "-o", "OUT"),
    ("replay", WALK, "--no-viewer", "--out", "OUT", "--geometry", SITE_TOML),
    ("score", RESULTS, "--html", "OUT"),
    ("why", RESULTS),
    ("compare", RESULTS, RESULTS),
    ("sweep", RESULTS, "--grid", "steps.swing=0.4:0.6:3", "--write", "OUT"),
    ("export", RESULTS, "--kind", "steps", "-o", "OUT.csv"),
    ("export", WALK, "-o", "OUT", "--format", "ros2"),
    ("cut", WALK, "--to", 2, "-o", "OUT"),
    ("filter", WALK, "--topic", "/truth", "-o", "OUT"),
    ("convert", WALK, "-o", "OUT"),
    ("doctor", WALK, "--repair", "OUT"),
)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a short walk, its results and a table, once."""
    folder = tmp_path_factory.mktemp("inputs")
    walk, results = folder / "walk.mcap", folder / "walk.results.mcap"
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "6", "-o", str(walk)])
    main(["replay", str(walk), "--no-viewer", "--out", str(results)])
    rows = "".join(f"{i / 100},{1 + i % 5 / 9}\n" for i in range(300))
    (folder / "table.csv").write_text("t,a\n" + rows)
    (folder / "map.toml").write_text(MAP)
    (folder / "site.toml").write_text(SITE)
    return folder


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(inputs, "in")


def named(arguments: Sequence[object], out: str) -> list[str]:
    return [str(a).replace("OUT", out) for a in arguments]


def state(folder: Path) -> dict[str, tuple[str, int]]:
    """Return content and time of change of every file below a folder."""
    return {
        str(p.relative_to(folder)): (
            hashlib.sha256(p.read_bytes()).hexdigest(),
            p.stat().st_mtime_ns,
        )
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.mark.parametrize("arguments", WRITES, ids=lambda a: f"{a[0]} {' '.join(map(str, a[-3:]))}")
def test_an_output_that_is_there_is_refused_in_one_line_and_stays(
    arguments: tuple[object, ...], capsys: Capture
) -> None:
    out = next(str(a) for a in arguments if str(a).startswith("OUT")).replace("OUT", "kept")
    Path(out).write_text("mine", "utf-8")
    before = state(Path())
    said = run(capsys, *named(arguments, "kept")).error
    assert said.startswith(f"{out}: expected a new ")
    assert said.endswith("found an existing one; see --force")
    assert state(Path()) == before


@pytest.mark.parametrize("there", ["walk.results.mcap", "walk.rrd"])
def test_outputs_that_a_replay_names_itself_stay_too(there: str, capsys: Capture) -> None:
    Path(there).write_text("mine", "utf-8")
    before = state(Path())
    said = run(capsys, "replay", WALK).error
    assert said == f"{there}: expected a new file, found an existing one; see --force"
    assert state(Path()) == before


@pytest.mark.parametrize("arguments", FOLDERS, ids=lambda a: a[0])
def test_a_folder_that_is_there_is_refused_and_stays(
    arguments: tuple[object, ...], capsys: Capture
) -> None:
    Path("kept").mkdir()
    Path("kept/mine.txt").write_text("mine", "utf-8")
    before = state(Path())
    assert run(capsys, *named(arguments, "kept")).error.startswith("kept: expected a new ")
    assert run(capsys, *named(arguments, "kept"), "--force").error.endswith("it stays")
    assert state(Path()) == before


class _Opened:
    """Files opened for writing, as the interpreter's audit tells; hooks cannot be taken back."""

    def __init__(self) -> None:
        self.watching = False
        self.written: list[str] = []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.watching or event != "open" or not isinstance(arguments[0], str | bytes):
            return
        if arguments[2] & (os.O_WRONLY | os.O_RDWR):
            self.written.append(os.fsdecode(arguments[0]))


@pytest.fixture(scope="module")
def _audit() -> _Opened:
    return _Opened()


@pytest.fixture
def opened(_audit: _Opened) -> Iterator[_Opened]:
    _audit.written, _audit.watching = [], True
    yield _audit
    _audit.watching = False


@pytest.mark.parametrize("arguments", READS, ids=lambda a: f"{a[0]} {' '.join(map(str, a[-3:]))}")
def test_inputs_that_cannot_be_written_are_enough_and_are_never_opened_to_write(
    arguments: tuple[object, ...], opened: _Opened, capsys: Capture
) -> None:
    folder = Path("in").resolve()
    before = state(folder)
    for path in folder.iterdir():
        path.chmod(0o444)
    folder.chmod(0o555)
    try:
        done(capsys, *named(arguments, "made"))
    finally:
        folder.chmod(0o755)
    assert not [path for path in opened.written if Path(path).resolve().is_relative_to(folder)]
    assert state(folder) == before
    assert not [p.name for p in Path().iterdir() if not p.name.startswith(("in", "made"))]
