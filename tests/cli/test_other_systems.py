"""What Windows and macOS do not have is not called: the core runs where it is hidden."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from groundtrace_recordings import path_of

if TYPE_CHECKING:
    from pathlib import Path

#: Executed by every process of Python before anything else, workers too: hides what one system
#: alone has, and notes that.
HIDDEN = """
import os, signal, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
names = {"pread", "pwrite", "preadv", "fork", "killpg", "getuid", "geteuid", "statvfs",
         "sched_getaffinity", "mkfifo", "set_blocking", "O_NONBLOCK",
         "SIGHUP", "SIGKILL", "SIGUSR1", "SIGALRM"}
for name in names - set(os.environ["LEFT"].split()):
    for module in (os, signal):
        if hasattr(module, name):
            delattr(module, name)
with open(os.environ["TOLD"], "a", encoding="utf-8") as told:
    told.write(f"{os.getpid()}\\n")
"""
#: Of these, what functions of the standard library call here that every system has: the end of a
#: process, the room on a disk.
LEFT = "SIGKILL statvfs"
FLEET = "fleet {walk} {copy} --pipeline waist-steps -o fleet.parquet --workers 2"


@pytest.mark.parametrize(
    "commands",
    [
        ("info {walk}",),
        (
            "replay {walk} --pipeline waist-steps --no-viewer --out a.results.mcap --quiet",
            "score a.results.mcap",
            "why a.results.mcap",
            "export a.results.mcap -o steps.csv --kind steps",
        ),
        ("annotate {copy} --add note@2 --note left", "annotate {copy} --list"),
        ("simulate room -o room.mcap --steps 2",),
        pytest.param((FLEET,), marks=pytest.mark.sweep),
    ],
    ids=lambda commands: commands[-1].split()[0],
)
def test_a_command_needs_nothing_that_one_system_alone_has(
    commands: tuple[str, ...], tmp_path: Path
) -> None:
    walk = path_of("waist-walk.mcap")
    copy, told = tmp_path / "copy.mcap", tmp_path / "told"
    copy.write_bytes(walk.read_bytes())
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "sitecustomize.py").write_text(HIDDEN, "utf-8")
    left = LEFT if commands == (FLEET,) else ""
    hidden = {"PYTHONPATH": str(tmp_path / "own"), "TOLD": str(told), "LEFT": left}
    for command in commands:
        words = [word.format(walk=walk, copy=copy) for word in command.split()]
        ran = groundtrace(words, tmp_path, **hidden)
        assert (ran.returncode, ran.stderr.count("Traceback")) == (0, 0), ran.stderr
    processes = len(set(told.read_text("utf-8").split()))
    assert processes >= (3 if commands == (FLEET,) else len(commands))


def test_a_console_without_a_letter_is_told_its_number(tmp_path: Path) -> None:
    copy = tmp_path / "walk.mcap"
    copy.write_bytes(path_of("waist-walk.mcap").read_bytes())
    add = ["annotate", str(copy), "--add", "note@2", "--note", "\u6771"]
    assert groundtrace(add, tmp_path).returncode == 0
    told = groundtrace(["annotate", str(copy), "--list"], tmp_path, PYTHONIOENCODING="cp1252")
    assert (told.returncode, told.stderr) == (0, "")
    assert "\\u6771" in told.stdout


def groundtrace(
    words: list[str], folder: Path, **settings: str
) -> subprocess.CompletedProcess[str]:
    run = [sys.executable, "-c", "from groundtrace.cli.main import main; main()", *words]
    environment = os.environ | settings
    return subprocess.run(run, cwd=folder, env=environment, capture_output=True, text=True)
