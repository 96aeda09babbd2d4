"""What a page shows of a terminal is what it shows: the commands of its console blocks run.

A page runs from top to bottom in a folder of its own, commands of groundtrace in this process,
lines of the shell by bash. ``...`` stands for what may differ, ``[exit 1]`` for a command that
fails. Blocks that cannot run (installing, files of the reader) are ``sh``. With
``GROUNDTRACE_DOCS=update`` what is printed is put into the pages instead.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from command_runs import printed
from sweeps import swept

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```console\n(.*?)^```", re.M | re.S)
PAGES = sorted(
    str(page.relative_to(ROOT))
    for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md"))
    if BLOCK.search(page.read_text("utf-8"))
)


def steps_of(block: str) -> list[tuple[str, str]]:
    """Return the commands of a block, each with what it prints."""
    parts = [part.partition("\n") for part in re.split(r"(?m)^\$ ", block)[1:]]
    return [(command, printed) for command, _, printed in parts]


#: What makes a line one of the shell: pipes, files, variables, several commands.
SHELL = frozenset("|><;&$*`")


def printed_by(line: str) -> str:
    """Return what a line prints, both streams in their order, and how it ends if not well."""
    words = shlex.split(line)
    if words[0] == "groundtrace" and not SHELL & set(line):
        code, said = printed(*words[1:])
    else:
        paths = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
        done = subprocess.run(
            ["bash", "-c", line],
            env={**os.environ, "PYTHONUNBUFFERED": "1", "PATH": paths},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=120,
            check=False,
        )
        code, said = done.returncode, done.stdout
    return said + (f"[exit {code}]\n" if code else "")


def agrees(expected: str, printed: str) -> bool:
    """Whether a command printed what a page says."""
    pattern = re.escape(expected).replace(re.escape("..."), ".*?")
    return re.fullmatch(pattern, printed, re.S) is not None


#: Pages whose commands take longest.
LONG = {
    "docs/howto/no-display.md",
    "docs/howto/place-sensors.md",
    "docs/howto/report-bug.md",
    "docs/tutorials/fleet.md",
    "docs/tutorials/share.md",
    "docs/tutorials/vehicles.md",
}


@pytest.mark.parametrize("page", swept(PAGES, *(page for page in PAGES if page not in LONG)))
def test_the_commands_of_a_page_print_what_it_says(
    page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.setenv(display, "")
    text = (ROOT / page).read_text("utf-8")
    wrong = []
    for block in BLOCK.findall(text):
        for command, expected in steps_of(block):
            said = printed_by(command)
            if not agrees(expected, said):
                wrong.append(f"$ {command}\nexpected:\n{expected}printed:\n{said}")
                text = text.replace(f"$ {command}\n{expected}", f"$ {command}\n{said}")
    if wrong and os.environ.get("GROUNDTRACE_DOCS") == "update":
        (ROOT / page).write_text(text, "utf-8")
    else:
        assert not wrong, "\n".join(wrong)


def test_pages_that_show_a_terminal_are_found() -> None:
    assert {"README.md", "docs/command-line.md"} <= set(PAGES)
    shown = [p for p in ROOT.glob("docs/**/*.md") if "\n$ " in p.read_text("utf-8")]
    assert {str(p.relative_to(ROOT)) for p in shown} <= set(PAGES), "a prompt outside a block"


def test_dots_stand_for_anything_and_nothing_else_differs() -> None:
    assert agrees("a\n...\nb\n", "a\n1\n2\nb\n")
    assert not agrees("steps: 19 of 23\n", "steps: 20 of 23\n")
    assert not agrees("", "warning\n")


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 120
