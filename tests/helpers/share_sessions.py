"""A short walk in a folder, replayed so that some of its steps are missed, and what is shared."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, NamedTuple

from groundtrace.cli.main import main
from groundtrace.simulate.gait import WalkOptions
from groundtrace.simulate.recording import write
from groundtrace.simulate.walk import simulate_walk
from groundtrace_viewers.rerun.process import VIEWER_FILES
from groundtrace_viewers.web.summary import sources_of

if TYPE_CHECKING:
    from pathlib import Path

#: With so high a threshold steps are missed.
STRICT = "steps.score=0.95"


class Walk(NamedTuple):
    """A recording, what a replay made of it, and how many steps that missed."""

    recording: Path
    results: Path
    rrd: Path
    missed: int


def quietly(*arguments: object) -> str:
    """Run a command that must succeed; return what it prints."""
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        main([str(argument) for argument in arguments])
    return out.getvalue()


def shared_walk(folder: Path) -> Walk:
    """Write a recording into a folder, replay and annotate it."""
    recording = folder / "walk.mcap"
    write(simulate_walk(WalkOptions(seed=3, duration_s=12.0)), recording)
    results, rrd = folder / "walk.results.mcap", folder / "walk.rrd"
    quietly("annotate", recording, "--add", "note@3", "--note", "<b>slow</b>", "--author", "ada")
    quietly("replay", recording, "--out", results, "--rrd", rrd, "--set", STRICT)
    matching = sources_of(results, None).matching
    return Walk(recording, results, rrd, 0 if matching is None else len(matching.missed))


def small_viewer(folder: Path) -> Path:
    """Return a folder with files named as the viewer's, which are large."""
    folder.mkdir()
    for name in VIEWER_FILES:
        (folder / name).write_bytes(name.encode())
    return folder
