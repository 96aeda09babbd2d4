"""``groundtrace demo``."""

from __future__ import annotations

import shutil
import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import Annotated

from groundtrace_recordings import path_of

from ..api.files import writable
from ..api.results import load_results
from ..pipeline.results import atomic_write, file_sha256
from .console import has_display, print_json, print_line
from .options import FLAG, ForceOthers, Json, Quiet
from .replay import replay
from .score import print_found

#: The bundled recording, and the pipeline it goes through.
RECORDING, PIPELINE = "lower-back.mcap", "waist-steps"


def demo(
    *,
    no_viewer: Annotated[bool, FLAG] = False,
    force: ForceOthers = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Replay the bundled walk of a real person, score it, and name the first missed step.

    Parameters
    ----------
    no_viewer
        Write no timeline and open no viewer.
    """
    bundled, recording = path_of(RECORDING), Path(RECORDING)
    if not (recording.is_file() and file_sha256(recording) == file_sha256(bundled)):
        with atomic_write(writable(recording, force=force)) as fresh:
            shutil.copyfile(bundled, fresh)
    timeline = None if no_viewer else Path(f"{recording.stem}.rrd")
    show = has_display() and not no_viewer
    with redirect_stdout(sys.stderr) if json else nullcontext():
        replay(
            recording,
            pipeline=PIPELINE,
            rrd=timeline,
            spawn=show,
            no_viewer=no_viewer,
            force=force,
            quiet=quiet,
        )
    results = load_results(f"{recording.stem}.results.mcap")
    score = results.score().steps
    missed = next(iter(results.misses), None)
    command = None if missed is None else f"groundtrace why {results.path} --step {missed.step}"
    if json:
        print_json(
            {
                "recording": str(recording),
                "results": str(results.path),
                "timeline": None if timeline is None else str(timeline),
                "truth": score.truth,
                "detected": score.detected,
                "matched": score.matched,
                "f1": score.f1,
                "tolerance_s": score.tolerance_s,
                "missed": [{"step": each.step, "time_s": each.time_s} for each in results.misses],
                "next": command,
            }
        )
        return
    print_found(score)
    if missed is None:
        print_line("missed: none")
        return
    print_line(f"missed: step {missed.step} at {missed.time_s:.3f} s")
    print_line(f"next: {command}")
