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

from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.writer import RecordingWriter

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


def write_as_logged(recording: Path, path: Path) -> bytes:
    """Write a recording in the small chunks of a logger that is followed; return its bytes."""
    with Recording.open(recording) as opened, RecordingWriter(path, chunk_bytes=8192) as writer:
        for stream in opened.streams:
            writer.add_stream(stream)
        writer.add_labels(opened.labels)
        for _, block in opened.blocks():
            writer.write(block)
    return path.read_bytes()


@contextmanager
def serving(recording: Path, *options: str) -> Iterator[Served]:
    """Run ``groundtrace annotate --serve`` until the block ends."""
    asked = ("annotate", str(recording), "--serve", "--no-browser", *options)
    with running(recording.parent, *asked) as (process, url):
        yield Served(url, token_of(url), port_of(url), process)


@contextmanager
def showing(recording: Path, *options: str) -> Iterator[Served]:
    """Run ``groundtrace replay --web`` until the block ends."""
    asked = ("replay", str(recording), "--web", *options)
    with running(recording.parent, *asked, ends_with=130) as (process, url):
        yield Served(url, token_of(url), port_of(url), process)


def token_of(url: str) -> str:
    """Return what the path of a page begins with."""
    return url.split("/")[3]


def port_of(url: str) -> int:
    """Return the port of a page on this machine."""
    return int(url.split(":")[2].split("/")[0])


@contextmanager
def running(
    folder: Path, *asked: str, ends_with: int = 0
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a command that serves a page, which it says on stderr, until the block ends."""
    program = "from groundtrace.cli.main import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", program, *asked],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        cwd=folder,
        text=True,
    )
    try:
        yield process, _url(process)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == ends_with, "Ctrl-C ends it cleanly"
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
