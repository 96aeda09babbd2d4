"""The unit of work: one recording through one pipeline, scored and explained, step by step.

Imported where the work is done, and only there: with all it needs it takes a second to load.
"""

from __future__ import annotations

import io
import itertools
import time
from contextlib import redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.events import Gap
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..commands.fitting import default_pipeline
from ..commands.truth import truth_of_recording
from ..engine import replay
from ..errors import GroundtraceError, RecordingError
from ..explain import evidence_of
from ..explain.measuring import EventList
from ..explain.reasons import StepReasons
from ..explain.unfiltered import Unfiltered
from ..health.imu import judged
from ..pipeline import build_pipeline, load_pipeline, parse_pipeline
from ..placement_watch import noted
from ..results import RUN, Provenance, Results, given_to
from ..score import score_events
from ..score.report import answers_of
from ..score.truth import scored_truth
from ..source import Source
from ..suitability import Prepared, prepared
from .figures import FIGURES
from .rows import Part, Row, StepRow, failed
from .task import Done, Identity, Task, owners_of, recipe_sha256, told_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.mcap.bytesource import ByteSource

    from ..pipeline import Pipeline
    from ..score import Score
    from ..warned import Warned


def evaluated(task: Task, identity: Identity, row: Row) -> Done:
    """Replay, score and explain; whatever goes wrong becomes the row's error.

    Parameters
    ----------
    task
        What to do.
    identity
        Key of the part, and the bytes of a remote recording.
    row
        What is known already.
    """
    began = time.perf_counter()
    remote = identity.remote
    try:
        if identity.error:
            raise RecordingError(identity.error)
        part = _part(task, row, remote)
        sha256 = row.sha256 if remote is None else remote.sha256()
    except (CodecError, GroundtraceError) as error:
        said = told_by(task, error)
    except OSError as error:
        said = f"{row.recording}: expected a file to use, found: {error.strerror or error}"
    except Exception as error:  # a bug costs its recording, and is told; the fleet goes on
        said = _place_of(error)
    else:
        done = replace(part.row, sha256=sha256, wall_s=time.perf_counter() - began)
        return Done(identity.key, replace(part, row=done).encoded())
    row = replace(row, wall_s=time.perf_counter() - began)
    return Done(identity.key, failed(row, said).encoded(), failed=True)


def _place_of(error: Exception) -> str:
    """Return an error that nobody expected, with the line of code it is from."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    at = "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}"
    line = "" if trace is None else f":{trace.tb_lineno})"
    return f"{type(error).__name__}: {error}{at}{line}"


def _part(task: Task, row: Row, remote: ByteSource | None) -> Part:
    """Replay a recording and return all that is said about it."""
    sink = EventList()
    with Recording.open(remote or task.location) as opened:
        if RUN in opened.metadata:
            raise RecordingError(f"{opened.name}: expected a recording, found results of one")
        labels, row = _with_truth(task, row, opened)
        ready = _ready(task, opened)
        source = Source(opened)
        items = judged(noted(source, dict.fromkeys(ready.looked_at)), source.streams)
        tally = replay(itertools.chain(ready.notes, items), ready.chain, [sink])
        if not tally.samples:
            raise RecordingError(f"{opened.name}: expected signals to replay, found none")
        asked = build_pipeline(ready.asked, opened.geometry, opened.labels)
        row = replace(
            row,
            pipeline=asked.config.name,
            pipeline_sha256=task.recipe.sha256 if task.recipe.toml else _sha256(asked, row),
            parameters=asked.recipe(),
            start_ns=opened.start_ns,
            duration_s=(opened.end_ns - opened.start_ns) / NS_PER_S,
            topics=", ".join(s.topic for s in opened.streams),
            channels=sum(len(s.channels) for s in opened.streams),
            samples=tally.samples,
            damaged_places=len(opened.damage),
            lost_messages=sum(d.messages or 0 for d in opened.damage),
        )
        origin = Provenance(row.recording, row.sha256, opened.start_ns, opened.end_ns, "")
        placements = {s.topic: s.placement for s in opened.streams if s.placement}
        origin = replace(origin, pipeline=ready.chain.recipe(), placements=placements)
        given = given_to(origin.pipeline, opened.labels)
        result = Results(
            row.recording, origin, labels, opened.geometry, tuple(sink.events), given=given
        )
        result = replace(result, labels=scored_truth(labels, result).labels)
    return _judged(row, result, remote or task.location)


def _with_truth(task: Task, row: Row, opened: Recording) -> tuple[tuple[Label, ...], Row]:
    truth = None if task.truth is None else Path(task.truth)
    with redirect_stderr(io.StringIO()):  # remarks of one recording say nothing in a fleet
        labels = truth_of_recording(opened, Path(task.location), truth)
    source = "recording" if opened.labels else "annotations" if labels else ""
    source = truth.name if truth is not None else source
    return labels, replace(row, truth=source, labels=len(labels))


def _ready(task: Task, opened: Recording) -> Prepared:
    toml = task.recipe.toml
    config = (
        parse_pipeline(toml.encode(), task.recipe.name)
        if toml
        else load_pipeline(default_pipeline(opened))
    )
    return prepared(config, opened)


def _sha256(chain: Pipeline, row: Row) -> str:
    """Return the hash that a pipeline has where it is asked for by name."""
    return recipe_sha256(chain.recipe(), owners_of(chain.config), row.tolerance_s)


def _judged(row: Row, result: Results, source: ByteSource | str) -> Part:
    """Score and explain a result."""
    said = answers_of(result.events)
    gaps = [e for e in result.events if isinstance(e, Gap)]
    origin = result.provenance
    score = score_events(
        result.labels, result.events, origin.start_ns, origin.end_ns, row.tolerance_s
    )
    steps = _steps(result, row.tolerance_s, source) if score.steps is not None else ()
    causes: dict[str, int] = {}
    for step in steps:
        if step.cause:
            causes[step.cause] = causes.get(step.cause, 0) + 1
    row = replace(
        row,
        gaps=sum(not g.bridged for g in gaps),
        lost_samples=sum(g.lost for g in gaps),
        found_steps=len(said.steps),
        found_picks=len(said.picks),
        found_fixes=len(said.fixes),
        found_passes=len(said.passes),
        warnings=" | ".join(warned.line for warned in result.warnings),
        figures={figure.name: _plain(figure.of(score)) for figure in FIGURES},
        causes=dict(sorted(causes.items())),
        score_json=_json(score, result.warnings),
    )
    return Part(row, steps)


def _steps(result: Results, tolerance_s: float, source: ByteSource | str) -> tuple[StepRow, ...]:
    """Return every scored step and what became of it, by time."""
    evidence = evidence_of(result)
    signal = Unfiltered(evidence.config, lambda: source)
    reasons = StepReasons(replace(evidence, unfiltered=signal), tolerance_s)
    matching = reasons.matching
    truth, found = matching.truth_ns.tolist(), matching.found_ns.tolist()
    rows = [
        StepRow("matched", int(t) + 1, None, truth[t], found[f]) for t, f in matching.pairs.tolist()
    ]
    for found_ns in matching.found_ns[matching.false].tolist():
        pair = reasons.wrong_time(found_ns)
        rows.append(StepRow("false", found_ns=found_ns, text="" if pair is None else pair.text))
    for number, index in enumerate(matching.missed.tolist(), 1):
        why, late = reasons.at(truth[index]), reasons.pair_of(truth[index])
        found_ns = None if late is None else late.found_ns
        missed = StepRow("missed", index + 1, number, truth[index], found_ns)
        rows.append(replace(missed, cause=why.cause, gate=why.gate, text=why.text))
    return tuple(sorted(rows, key=lambda row: (row.time_ns, row.verdict)))


def _json(score: Score, warnings: Sequence[Warned]) -> str:
    """Return a score as ``groundtrace score --json`` gives it, without parts that are None."""
    parts = msgspec.to_builtins(score, enc_hook=str)
    kept = {k: v for k, v in parts.items() if v is not None}
    kept["warnings"] = [warned.document for warned in warnings]
    return msgspec.json.encode(kept).decode()


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python."""
    return value.item() if hasattr(value, "item") else value
