"""Inputs that are cut short, replaced or lost while they are read: one line and exit code 1."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from command_runs import done, run

from groundtrace.cli.main import main
from groundtrace.pipeline.results import read_results
from groundtrace_codecs.importers.tables import DelimitedImporter
from groundtrace_codecs.mcap.byte_source import FileBytes
from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from groundtrace_codecs.importers.base import Imported

Capture = pytest.CaptureFixture[str]
COMMANDS = {
    "info": ("info", "walk.mcap"),
    "replay": ("replay", "walk.mcap", "--out", "out.results.mcap", "--rrd", "out.rrd"),
    "cut": ("cut", "walk.mcap", "--to", "4", "-o", "out.mcap"),
    "convert": ("convert", "walk.mcap", "-o", "out.mcap"),
    "export": ("export", "walk.mcap", "-o", "out.csv"),
    "ros2": ("export", "walk.mcap", "--format", "ros2", "-o", "out"),
    "merge": ("merge", "walk.mcap", "again.mcap", "-o", "out.mcap"),
    "repair": ("doctor", "walk.mcap", "--repair", "out.mcap"),
    "annotate": ("annotate", "walk.mcap", "--add", "missed@1.5"),
    "sweep": ("sweep", "walk.mcap", "--pipeline", "waist-steps", "--grid", "steps.score=0.1:0.6:3"),
    "score": ("score", "walk.results.mcap", "--html", "out.html"),
}
MAP = """format = "csv"
time = {column = "t"}
[[stream]]
topic = "/imu"
columns = [{column = "a", quantity = "acceleration", axis = "z", unit = "g"}]
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a short walk and its results."""
    folder = tmp_path_factory.mktemp("inputs")
    walk, results = str(folder / "walk.mcap"), str(folder / "walk.results.mcap")
    main(["cut", str(path_of("waist-walk.mcap")), "--to", "6", "-o", walk])
    main(["replay", walk, "--out", results, "--no-viewer"])
    return folder


@pytest.fixture
def walk(inputs: Path) -> Path:
    """Put copies of both here."""
    for path in inputs.iterdir():
        shutil.copy(path, path.name)
    shutil.copy("walk.mcap", "again.mcap")
    return Path("walk.mcap")


def after_reads(count: int, change: Callable[[Path], object], patch: pytest.MonkeyPatch) -> None:
    """Let something happen to a walk or its results, once so many reads of it are done."""
    read_at, reads = FileBytes.read_at, [0]

    def counted(source: FileBytes, offset: int, length: int) -> bytes:
        if Path(source.name).name.startswith("walk."):
            reads[0] += 1
            if reads[0] == count:
                change(Path(source.name))
        return read_at(source, offset, length)

    patch.setattr(FileBytes, "read_at", counted)


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.usefixtures("walk")
def test_a_recording_that_is_cut_short_while_it_is_read_is_one_line(
    name: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = Path(COMMANDS[name][1])
    size, before = file.stat().st_size, set(Path().iterdir())
    after_reads(3, lambda path: os.truncate(path, 1000), monkeypatch)
    assert run(capsys, *COMMANDS[name]).error == (
        f"{file}: expected a file that stays as it is while it is read, found 1000 bytes of {size}"
    )
    assert set(Path().iterdir()) - before <= {Path("out.mcap.partial")}


@pytest.mark.usefixtures("walk")
def test_a_disk_that_is_pulled_out_is_one_line(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object) -> bytes:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    after_reads(8, lambda _: monkeypatch.setattr(FileBytes, "_read", gone), monkeypatch)
    said = run(capsys, *COMMANDS["replay"]).error
    assert said.startswith("walk.mcap: byte ")
    assert said.endswith(": expected bytes to read, found: Input/output error")
    assert not list(Path().glob("out*"))


def test_a_recording_that_is_replaced_is_replayed_as_it_was_and_named_by_its_own_bytes(
    walk: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    was = hashlib.sha256(walk.read_bytes()).hexdigest()

    def replaced(path: Path) -> None:
        Path("other").write_bytes(b"another file")
        Path("other").replace(path)

    after_reads(3, replaced, monkeypatch)
    done(capsys, "replay", walk, "--out", "out.results.mcap", "--no-viewer")
    assert read_results(Path("out.results.mcap")).provenance.sha256 == was


@pytest.mark.parametrize("change", ["cut short", "gone"])
def test_a_table_that_changes_while_it_is_imported_leaves_no_recording(
    change: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, read = Path("table.csv"), DelimitedImporter.read
    table.write_text("t,a\n" + "".join(f"{i / 100},{i % 7}\n" for i in range(900)), "utf-8")
    Path("map.toml").write_text(MAP, "utf-8")

    def changed(importer: DelimitedImporter, *given: object) -> Imported:
        found = read(importer, *given)  # type: ignore[arg-type]
        if change == "gone":
            table.unlink()
        else:
            table.write_text("t,a\n", "utf-8")
        return found

    monkeypatch.setattr(DelimitedImporter, "read", changed)
    said = run(capsys, "import", table, "--map", "map.toml", "-o", "out.mcap").error
    assert said.startswith("table.csv: expected a file ")
    assert not Path("out.mcap").exists()
