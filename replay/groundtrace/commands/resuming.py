"""What ``groundtrace replay`` does when it is stopped, and how ``--resume`` takes it up again."""

from __future__ import annotations

import hashlib
import shlex
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from ..checkpoint import Origin, checkpoint_path, remove_checkpoint
from ..errors import CheckpointError
from ..results import ResultsSink, read_results
from ..resumable import left
from .output import say

if TYPE_CHECKING:
    from pathlib import Path

    from groundtrace_codecs.geometry import Geometry

    from ..results import Provenance, Results
    from ..resumable import Keeper, Left
    from ..sinks import Session


def origin_of(provenance: Provenance, geometry: Geometry | None, block_s: float) -> Origin:
    """Return what a replay must have in common with one that it goes on from."""
    kept = tuple(word for word in provenance.arguments if word != "--resume")
    site = "" if geometry is None else hashlib.sha256(geometry.to_json()).hexdigest()
    return Origin(replace(provenance, arguments=kept), site, round(block_s * NS_PER_S))


def to_go_on_from(results: Path, origin: Origin) -> Left | None:
    """Return what was left of a replay; None, and said why, where it cannot go on."""
    try:
        before = left(results, origin)
    except CheckpointError as error:
        say(f"{error}; replaying from the start")
        return None
    since_s = (before.checkpoint.reached_ns - origin.provenance.start_ns) / NS_PER_S
    say(f"going on at {since_s:.1f} s")
    return before


def results_sink(results: Path, origin: Origin, before: Left | None) -> ResultsSink:
    """Return where results go; a checkpoint of another replay there is removed."""
    if before is None:
        remove_checkpoint(checkpoint_path(results))
        return ResultsSink(results, origin.provenance, force=True)
    provenance = before.checkpoint.origin.provenance
    return ResultsSink(results, provenance, force=True, ending=before.ending)


def stopped_s(keeper: Keeper, session: Session) -> float | None:
    """Return where a replay was stopped [s since the first sample]; None where it ended."""
    if not keeper.stopped:
        return None
    return (keeper.source.reached_ns - session.start_ns) / NS_PER_S


def say_stopped(keeper: Keeper, session: Session, at_s: float) -> None:
    """Say where a replay was stopped, and the command that goes on."""
    length_s = (session.end_ns - session.start_ns) / NS_PER_S
    words = ["groundtrace", *(w for w in sys.argv[1:] if w != "--resume"), "--resume"]
    going_on = f"; go on with: {shlex.join(words)}" if keeper.resumable else ""
    say(f"stopped at {at_s:.1f} s of {length_s:.1f} s: results are whole up to there{going_on}")


def results_at(path: Path, *, blocks: bool = True, evidence: bool = False) -> Results:
    """Read results; say so where they are of a replay that was stopped."""
    found = read_results(path, blocks=blocks, evidence=evidence)
    origin = found.provenance
    if origin.stopped_ns is not None:
        at_s = (origin.stopped_ns - origin.start_ns) / NS_PER_S
        length_s = (origin.end_ns - origin.start_ns) / NS_PER_S
        words = shlex.join(["groundtrace", *origin.arguments, "--resume"])
        said = f"partial, stopped at {at_s:.1f} s of {length_s:.1f} s; to go on: {words}"
        say(f"{path.name}: {said}")
    return found
