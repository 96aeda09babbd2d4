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

#: Run as a program: hides what one system alone has, then runs a command.
HIDDEN = """
import os, signal, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in ("pread", "pwrite", "preadv", "fork", "killpg", "getuid", "geteuid", "statvfs",
             "sched_getaffinity", "mkfifo", "set_blocking", "O_NONBLOCK"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGHUP", "SIGKILL", "SIGUSR1", "SIGALRM"):
    if hasattr(signal, name):
        delattr(signal, name)
from groundtrace.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


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
    ],
    ids=lambda commands: commands[-1].split()[0],
)
def test_a_command_needs_nothing_that_one_system_alone_has(
    commands: tuple[str, ...], tmp_path: Path
) -> None:
    walk = path_of("waist-walk.mcap")
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(walk.read_bytes())
    for command in commands:
        words = [word.format(walk=walk, copy=copy) for word in command.split()]
        ran = subprocess.run(
            [sys.executable, "-c", HIDDEN, *words], cwd=tmp_path, capture_output=True, text=True
        )
        assert (ran.returncode, ran.stderr.count("Traceback")) == (0, 0), ran.stderr


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
