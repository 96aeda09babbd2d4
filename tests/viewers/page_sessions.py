"""A short walk as a recording with truth, and the page's servers over it."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from groundtrace.simulate import WalkOptions, simulate_walk, write

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

START_S = 90.0


class Served(NamedTuple):
    """A page that is served."""

    url: str
    token: str
    port: int
    process: subprocess.Popen[str]


def write_walk(path: Path) -> Path:
    """Write a short simulated walk with true steps."""
    write(simulate_walk(WalkOptions(seed=3, duration_s=12.0)), path)
    return path


@contextmanager
def serving(recording: Path, *options: str) -> Iterator[Served]:
    """Run ``groundtrace annotate --serve`` until the block ends."""
    program = "from groundtrace.commands import main; main()"
    asked = ["annotate", str(recording), "--serve", "--no-browser", *options]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *asked],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        cwd=recording.parent,
        text=True,
    )
    try:
        url = _url(process)
        token, port = url.partition("token=")[2], int(url.split(":")[2].split("/")[0])
        yield Served(url, token, port, process)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0, "Ctrl-C ends it cleanly"
        if process.stderr is not None:
            process.stderr.close()


def _url(process: subprocess.Popen[str]) -> str:
    """Return the address that the command says."""
    said = []
    while process.stderr is not None and select.select([process.stderr], [], [], START_S)[0]:
        line = process.stderr.readline()
        said.append(line)
        found = re.search(r"http://\S+", line)
        if found:
            return found.group()
        if not line:
            break
    raise AssertionError(f"no address: {''.join(said)}")
