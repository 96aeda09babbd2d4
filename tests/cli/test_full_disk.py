"""A disk that takes no more: one line with the output's name, what was there stays, no traceback.

The limit of a file's length stands for the disk: the system refuses the same writes, in this
process, in its threads and in those it starts.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import done, run
from sweeps import swept

from groundtrace.cli.main import main
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Iterator

Capture = pytest.CaptureFixture[str]
WALK, RESULTS = "in/walk.mcap", "in/walk.results.mcap"
#: Each kind of output, and what writes it.
OUTPUTS = {
    "page.html": ("score", RESULTS, "--html"),
    "shared.html": ("share", RESULTS, "--single-file", "-o"),
    "shared.zip": ("share", RESULTS, "--zip", "-o"),
    "why.rrd": ("why", RESULTS, "--at", "2", "--rrd"),
    "compare.rrd": ("compare", RESULTS, RESULTS, "--rrd"),
    "room.rrd": ("analyze", "room", "in/room.toml", "--lattice", "3", "--draws", "2", "--rrd"),
    "replay.rrd": ("replay", WALK, "--out", "new.mcap", "--rrd"),
    "replay.mcap": ("replay", WALK, "--no-viewer", "--out"),
    "figure.svg": ("figure", RESULTS, "--at", "2", "-o"),
    "figure.pdf": ("figure", RESULTS, "--at", "2", "-o"),
    "figure.png": ("figure", RESULTS, "--at", "2", "-o"),
    "sweep.svg": ("sweep", RESULTS, "--grid", "steps.swing=0.4:0.6:3", "--figure"),
    "best.toml": ("sweep", RESULTS, "--grid", "steps.swing=0.4:0.6:3", "--write"),
    "steps.csv": ("export", RESULTS, "--kind", "candidates", "-o"),
    "steps.parquet": ("export", RESULTS, "--kind", "steps", "-o"),
    "labels.txt": ("export", RESULTS, "--format", "audacity", "-o"),
    "bag": ("export", WALK, "--format", "ros2", "-o"),
    "signals.mseed": ("export", WALK, "--format", "miniseed", "-o"),
    "signals.csv": ("export", WALK, "-o"),
    "fleet.parquet": ("fleet", WALK, "--pipeline", "waist-steps", "--resume", "-o"),
    "fleet.html": ("fleet-report", "in/fleet.parquet", "-o"),
    "table.mcap": ("import", "in/table.csv", "--map", "in/map.toml", "-o"),
    "cut.mcap": ("cut", WALK, "--to", "4", "-o"),
    "filtered.mcap": ("filter", WALK, "--without", "/baro/*", "-o"),
    "converted.mcap": ("convert", WALK, "-o"),
    "merged.mcap": ("merge", WALK, "in/room.mcap", "--align", "none", "-o"),
    "mended.mcap": ("doctor", "in/torn.mcap", "--repair"),
    "walk.mcap": ("simulate", "walk", "--duration-s", "3", "-o"),
    "room.png": ("analyze", "room", "in/room.toml", "--lattice", "3", "--draws", "2", "--png"),
}
MAP = """format = "csv"
time = {column = "t"}
[[stream]]
topic = "/imu"
columns = [{column = "a", quantity = "acceleration", axis = "z", unit = "g"}]
"""
ROOM = "".join(
    f'[[sensor]]\nname = "G{i}"\nchannel = "G{i}"\nx = {x}\ny = {y}\n'
    for i, (x, y) in enumerate([(0, 0), (5, 0), (5, 5), (0, 5)])
)
FULL = "expected room to write, found: File too large"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a short walk, its results and a fleet's table, once; all that is compiled, is."""
    folder = tmp_path_factory.mktemp("inputs")
    walk, results = folder / "walk.mcap", folder / "walk.results.mcap"
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "6", "-o", str(walk)])
    main(["replay", str(walk), "--out", str(results), "--rrd", str(folder / "walk.rrd")])
    table = ("-o", str(folder / "fleet.parquet"))
    main(["fleet", str(walk), "--pipeline", "waist-steps", *table, "--workers", "1"])
    (folder / "table.csv").write_text("t,a\n" + "".join(f"{i / 100},{i % 7}\n" for i in range(900)))
    (folder / "map.toml").write_text(MAP)
    (folder / "room.toml").write_text(ROOM)
    (folder / "torn.mcap").write_bytes(walk.read_bytes()[:-1000])
    main(["cut", str(path_of("room-walk.mcap")), "--to", "2", "-o", str(folder / "room.mcap")])
    return folder


@pytest.fixture
def _in_place(inputs: Path) -> None:
    shutil.copytree(inputs, "in")


@contextmanager
def no_more_than(size: int) -> Iterator[None]:
    """Let no file grow beyond a length, as a disk that is full does not.

    Python keeps no compiled modules meanwhile: it takes a write cut short for a whole one (3.11).
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.setenv("PYTHONDONTWRITEBYTECODE", "1")
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)


#: Outputs that are tried every day: of each way in which one is written, one.
EVERYDAY = (
    "shared.zip",
    "replay.rrd",
    "replay.mcap",
    "best.toml",
    "steps.csv",
    "steps.parquet",
    "bag",
    "signals.mseed",
    "fleet.parquet",
    "table.mcap",
    "cut.mcap",
    "mended.mcap",
    "room.png",
)


@pytest.mark.parametrize("out", swept(OUTPUTS, *EVERYDAY))
@pytest.mark.usefixtures("_in_place")
def test_a_full_disk_is_one_line_and_what_was_there_stays(out: str, capsys: Capture) -> None:
    Path(out).write_text("mine", "utf-8")
    if out == "fleet.parquet":  # its parts are there: the table alone is to be written
        shutil.copytree("in/fleet.parts", "fleet.parts")
    before = {p.name for p in Path().iterdir()}
    with no_more_than(100):
        ran = run(capsys, *OUTPUTS[out], out, "--force")
    assert ran.code == 1, (ran.out, ran.err)
    *said, last = ran.err.splitlines()
    assert last.startswith("groundtrace: ")
    assert FULL in last
    assert out.partition(".")[0] in last
    told = ("timeline: ", "pipeline: ", "remark: ", "note: ")
    assert all(line.startswith(told) for line in said), said
    assert Path(out).read_text("utf-8") == "mine"
    left = {p.name for p in Path().iterdir()} - before
    assert left <= {f"{out}.partial", f"{out}.mending", "new.mcap.partial"}, (
        "recordings keep what was written, and say so"
    )


@pytest.mark.parametrize("out", swept((o for o in OUTPUTS if o != "bag"), *EVERYDAY[:6]))
@pytest.mark.usefixtures("_in_place")
def test_no_output_takes_the_place_of_a_device(out: str, capsys: Capture) -> None:
    os.mkfifo(out)
    ran = run(capsys, *OUTPUTS[out], out, "--force")
    assert ran.error.startswith(f"{out}: expected a file")
    assert ran.error.endswith("found a device or pipe")
    assert Path(out).is_fifo()


@pytest.mark.parametrize("command", [("export",), ("share",)])
@pytest.mark.usefixtures("_in_place")
def test_a_folder_that_a_full_disk_ends_does_not_appear(
    command: tuple[str, ...], capsys: Capture
) -> None:
    with no_more_than(100):
        said = run(capsys, *command, RESULTS, "-o", "out").err.splitlines()
    assert said[-1] == f"groundtrace: out: {FULL}"
    assert {p.name for p in Path().iterdir()} == {"in"}


@pytest.mark.parametrize("command", ["export", "share"])
@pytest.mark.usefixtures("_in_place")
def test_no_folder_takes_the_place_of_where_one_works_or_of_a_mounted_disk(
    command: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("work/deep").mkdir(parents=True)
    results = Path(RESULTS).resolve()
    asked = (command, results, "--force", "-o")
    monkeypatch.chdir("work/deep")
    for here in (".", "", "..", Path.cwd()):
        said = run(capsys, *asked, here).error
        assert said.endswith(
            ": expected a folder that can be replaced, found the one that the command runs in"
        )
    Path("disk").mkdir()
    monkeypatch.setattr("os.path.ismount", lambda path: Path(path).name == "disk")
    said = run(capsys, *asked, "disk").error
    wanted = (
        "disk: expected a folder that can be replaced, found one where a file system is mounted"
    )
    assert said == wanted
    assert [p.name for p in Path().iterdir()] == ["disk"]


@pytest.mark.usefixtures("_in_place")
def test_an_import_whose_temporary_file_finds_no_room_is_one_line(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundtrace_codecs.importers.stored._IN_MEMORY", 1)
    with no_more_than(100):
        ran = run(capsys, *OUTPUTS["table.mcap"], "table.mcap")
    assert ran.error == f"{tempfile.gettempdir()}: {FULL}"
    assert not Path("table.mcap").exists()


def test_a_demo_that_finds_no_room_is_one_line_and_leaves_no_torn_recording(
    capsys: Capture,
) -> None:
    with no_more_than(100):
        assert run(capsys, "demo", "--no-viewer").error == f"lower-back.mcap: {FULL}"
    assert list(Path().iterdir()) == []


@pytest.mark.usefixtures("_in_place")
def test_a_mark_that_finds_no_room_is_one_line_and_the_others_stay(capsys: Capture) -> None:
    done(capsys, "annotate", WALK, "--add", "missed@1.5")
    listed = done(capsys, "annotate", WALK, "--list").out
    with no_more_than(10):
        assert "found: File too large" in run(capsys, "annotate", WALK, "--add", "missed@2.5").error
    assert done(capsys, "annotate", WALK, "--list").out == listed


@pytest.mark.usefixtures("_in_place")
def test_a_mark_of_which_the_journal_alone_has_room_is_told_as_that_and_kept(
    capsys: Capture,
) -> None:
    done(capsys, "annotate", WALK, "--add", "missed@1.5")
    sidecar, journal = Path("in/walk.annotations.mcap"), Path("in/walk.annotations.journal")
    before = sidecar.read_bytes()
    room = journal.stat().st_size + 400
    assert room < sidecar.stat().st_size
    with no_more_than(room):
        said = run(capsys, "annotate", WALK, "--add", "missed@2.5").error
    assert said == f"{sidecar}: {FULL}; the journal {journal.name} has all of it"
    assert sidecar.read_bytes() == before
    assert {p.name for p in Path("in").glob("walk.annotations.*")} == {sidecar.name, journal.name}
    assert "2.500" in done(capsys, "annotate", WALK, "--list").out


def piped(*arguments: str, out: int | str, buffered: bool, before: str = "") -> tuple[int, str]:
    """Run a command in a process of its own; return its exit code and what it says on stderr."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    environment |= {} if buffered else {"PYTHONUNBUFFERED": "1"}
    code = f"{before}from groundtrace.cli.main import main; main()"
    with Path(os.devnull).open("wb") if isinstance(out, int) else Path(out).open("wb") as file:
        ran = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            stdout=out if isinstance(out, int) else file,
            stderr=subprocess.PIPE,
            env=environment,
            text=True,
            check=False,
        )
    return ran.returncode, ran.stderr


@pytest.mark.parametrize(
    ("command", "buffered"),
    swept(
        product(("pipelines waist-steps", "--help", "info in/walk.mcap --json"), (True, False)),
        ("--help", True),
        ("info in/walk.mcap --json", False),
    ),
)
@pytest.mark.usefixtures("_in_place")
def test_a_reader_that_has_seen_enough_ends_a_command_without_a_word(
    command: str, buffered: bool
) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        assert piped(*command.split(), out=writing, buffered=buffered) == (1, "")
    finally:
        os.close(writing)


@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_output_into_a_full_disk_is_one_line(buffered: bool) -> None:
    said = "groundtrace: output: expected room to write, found: No space left on device\n"
    assert piped("pipelines", "waist-steps", out="/dev/full", buffered=buffered) == (1, said)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    "command",
    swept(["--help", "pipelines waist-steps", "info none"], "pipelines waist-steps", "info none"),
)
def test_output_and_errors_into_a_full_disk_end_with_1(command: str) -> None:
    code = "from groundtrace.cli.main import main; main()"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    asked = [sys.executable, "-c", code, *command.split()]
    with Path("/dev/full").open("wb") as full:
        ran = subprocess.run(asked, stdout=full, stderr=full, env=environment, check=False)
    assert ran.returncode == 1


def test_a_figure_says_what_its_name_must_end_in(capsys: Capture) -> None:
    Path("room.toml").write_text(ROOM)
    said = run(capsys, "analyze", "room", "room.toml", "--png", "room").error
    assert said == "room: expected a name that ends in .png, found room"


def test_an_error_after_output_that_nobody_reads_is_one_line() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        ran = piped("info", "none", out=writing, buffered=True, before="print('held back'); ")
    finally:
        os.close(writing)
    assert ran == (1, "groundtrace: none: expected a recording, found no such file\n")
