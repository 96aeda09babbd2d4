"""The viewer's file of a shared result: replayed for it, or one that is there already."""

from __future__ import annotations

import io
import subprocess
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from groundtrace.commands.output import say
from groundtrace.commands.replaying import replay
from groundtrace.results import read_results
from groundtrace_codecs.events import Fix, Pick, StepEvent, TrackPoint

from .errors import ViewerError
from .identity import stream_of
from .recipe import written_recipe
from .serve import quiet_environment, viewer_program

if TYPE_CHECKING:
    from groundtrace.results import Results

    from .share_sources import Sources

#: What of the signals a file shows, for people.
LIGHT = "envelopes of fast signals, without their samples"
FULL = "all that groundtrace replay shows"


def timeline_file(sources: Sources, given: Path | None, light: bool, target: Path) -> str:
    """Write the viewer's file of a result, and return what of the signals it shows.

    A file that is ``given`` is taken as it is; else the recording is replayed; where the recording
    is not there, the file that ``groundtrace replay`` left beside the results is taken.

    Parameters
    ----------
    sources
        What is shared.
    given
        A viewer's file of the same recording, or None.
    light
        Leave the samples of fast signals out.
    target
        The file to write.

    Raises
    ------
    ViewerError
        Where there is neither recording nor file, or the file is of another recording.
    """
    if given is None and sources.recording is not None:
        _replayed(sources, sources.recording, light, target)
        return LIGHT if light else FULL
    there = given if given is not None else _beside(sources)
    if there is None:
        raise ViewerError(
            f"{sources.path.name}: expected its recording {sources.name} beside it, --recording "
            f"FILE or --rrd FILE, found none of them"
        )
    if given is None:
        say(f"{sources.name} is not there: its timeline {there.name} is taken as it is")
    _check(sources, there)
    if light:
        _without_samples(there, target)
        return LIGHT
    target.write_bytes(there.read_bytes())
    return f"what {there.name} has"


def _replayed(sources: Sources, recording: Path, light: bool, target: Path) -> None:
    """Replay a recording as the results say that it was."""
    with tempfile.TemporaryDirectory(prefix="groundtrace-") as folder:
        fresh = Path(folder, "fresh.mcap")
        recipe = written_recipe(sources.results, Path(folder))
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as said:
            replay(
                recording,
                pipeline=str(recipe.pipeline),
                geometry=recipe.geometry,
                from_=recipe.from_,
                to=recipe.to,
                rrd=target,
                out=fresh,
                full_rate="none" if light else "",
            )
        for line in said.getvalue().splitlines():
            if "annotations are left out" not in line:  # said already
                say(line)
        if _decided(read_results(fresh)) != _decided(sources.results):
            say(
                f"{sources.path.name}: this version decides otherwise than when it was made: the "
                f"timeline shows what it decides now; replay and share again to have both the same"
            )


def _decided(results: Results) -> list[str]:
    kinds = (StepEvent, Pick, Fix, TrackPoint)
    return sorted(repr(event) for event in results.events if isinstance(event, kinds))


def _beside(sources: Sources) -> Path | None:
    """Return the viewer's file that a replay left with the results."""
    stem = sources.path.name.removesuffix(".mcap").removesuffix(".results")
    names = dict.fromkeys((f"{stem}.rrd", f"{sources.stem}.rrd"))
    return next((p for p in map(sources.path.with_name, names) if p.is_file()), None)


def _check(sources: Sources, rrd: Path) -> None:
    """Refuse a file that shows another recording; the viewer's id of one is made of its name."""
    import rerun as rr

    try:
        shown = rr.chunk.RrdReader(str(rrd)).recordings()
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ViewerError(f"{rrd.name}: expected a viewer's file, found: {reason}") from error
    expected = stream_of(sources.name, sources.config.application).get_recording_id()
    if expected not in {each.recording_id for each in shown}:
        raise ViewerError(
            f"{rrd.name}: expected the timeline of {sources.name}, found that of another recording"
        )


def _without_samples(rrd: Path, target: Path) -> None:
    """Copy a viewer's file without the samples of signals that have an envelope."""
    import rerun as rr

    paths = {chunk.entity_path for chunk in rr.chunk.RrdReader(str(rrd)).stream()}
    tails = [path.removeprefix("/envelope") for path in paths if path.startswith("/envelope/")]
    drop = sorted(f"/signals{tail}" for tail in tails if f"/signals{tail}" in paths)
    command = [str(viewer_program()), "rrd", "filter", str(rrd), "-o", str(target)]
    if drop:
        command += ["--drop-entity", *drop]
    done = subprocess.run(command, env=quiet_environment(), capture_output=True, text=True)
    if done.returncode or not target.is_file():
        reason = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
        raise ViewerError(f"{rrd.name}: expected it to be filtered, found: {reason}")
