"""Measuring again, without files, and judging many settings of one measurement."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import SignalBlock

from ..engine import replay
from ..pipeline import build_pipeline, parse_pipeline, with_settings
from ..results import file_sha256
from ..source import Source
from ..suitability import PLACEMENT, refuse_unsuitable, with_placements
from ..warned import warnings_of
from .chain import StepChain
from .counted import counted_kind, truth_for
from .evidence import Evidence, stage_evidence

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event
    from groundtrace_codecs.labels import Label

    from ..pipeline import PipelineConfig
    from ..sinks import Session
    from .bootstrap import Verdicts
    from .grid import Axis

A = TypeVar("A")
B = TypeVar("B")


@dataclass(slots=True)
class EventList:
    """A sink that keeps the events and leaves out the signals."""

    events: list[Event] = field(default_factory=list)

    def open(self, session: Session) -> None:
        """Begin; nothing is needed."""

    def write(self, item: SignalBlock | Event) -> None:
        """Take an event."""
        if not isinstance(item, SignalBlock):
            self.events.append(item)

    def close(self) -> None:
        """End; nothing is held."""


def recording_in(places: Sequence[Path], sha256: str = "") -> Path | None:
    """Return the first of some places where a recording is, by its SHA-256 where that is given."""
    for path in places:
        if path.is_file() and (not sha256 or file_sha256(path) == sha256):
            return path
    return None


def resolved(config: PipelineConfig) -> PipelineConfig:
    """Return a pipeline with every parameter as it stands, defaults written out."""
    return parse_pipeline(build_pipeline(config).recipe().encode(), config.name)


def with_values(
    config: PipelineConfig, axes: Sequence[Axis], values: Sequence[Any]
) -> PipelineConfig:
    """Return a pipeline with the axes' parameters at ``values``."""
    pairs = zip(axes, values, strict=True)
    return with_settings(config, [f"{a.name}={msgspec.json.encode(v).decode()}" for a, v in pairs])


def measure_evidence(
    path: Path, config: PipelineConfig, labels: Sequence[Label] | None = None
) -> Evidence:
    """Replay a recording through a pipeline and keep the evidence in memory.

    Parameters
    ----------
    path
        The recording.
    config
        The pipeline.
    labels
        Truth instead of the recording's own.
    """
    config = resolved(config)
    sink = EventList()
    with Recording.open(path) as recording:
        refuse_unsuitable(config, recording.streams, recording.name)
        # places take long, and no step depends on them, as passes do
        geometry = None if counted_kind(config) == "step" else recording.geometry
        config, told, _ = with_placements(config, recording)
        chain = build_pipeline(config, geometry, recording.labels)
        replay(Source(recording), chain, [sink])
        notes = [Note(recording.start_ns, text, "WARN", PLACEMENT) for text in told]
        return Evidence(
            path.name,
            config,
            stage_evidence(sink.events, [stage.key for stage in config.stage]),
            tuple(e for e in sink.events if isinstance(e, Gap)),
            recording.labels if labels is None else tuple(labels),
            recording.start_ns,
            recording.end_ns,
            geometry,
            warnings=warnings_of([*notes, *sink.events], recording.start_ns),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """Settings to judge on one recording that share one measurement.

    Attributes
    ----------
    key
        Anything that names the task to whoever gave it.
    source
        What was measured, or the recording to measure first.
    config, labels
        The pipeline and the truth.
    axes
        What is swept by deciding again.
    rows
        One value for each axis, setting by setting.
    tolerance_s
        Of the match [s].
    detailed
        Whether to say which steps are found, beside how many.
    """

    key: Any
    source: Evidence | Path
    config: PipelineConfig
    labels: tuple[Label, ...]
    axes: tuple[Axis, ...]
    rows: tuple[tuple[Any, ...], ...]
    tolerance_s: float
    detailed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What came of a task.

    Attributes
    ----------
    key
        The task's.
    counts
        Shape (n, 3), int64: steps or passes right, false and missed of each setting.
    verdicts
        Step by step, where asked for.
    associates
        Whether an associator was on the way.
    measured
        Whether the recording had to be measured first.
    measured_s, decided_s
        Wall time taken to measure and to decide [s].
    """

    key: Any
    counts: NDArray[np.int64]
    verdicts: tuple[Verdicts, ...]
    associates: bool
    measured: bool
    measured_s: float
    decided_s: float


def judge(task: Task) -> Judged:
    """Decide and match every setting of a task, after measuring where that is needed.

    Raises
    ------
    PipelineError
        Where a setting needs candidates below the floor of the measurement.
    """
    began = time.perf_counter()
    evidence = task.source
    if isinstance(evidence, Path):
        evidence = measure_evidence(evidence, task.config, task.labels)
    measured = time.perf_counter()
    chain = StepChain(evidence, task.axes)
    truth = truth_for(evidence, task.labels, task.tolerance_s)
    counts = np.zeros((len(task.rows), 3), np.int64)
    verdicts: dict[int, Verdicts] = {}
    for row in chain.order(task.rows):
        found = truth.verdicts(chain.passed(task.rows[row]))
        right = int(found.hit.sum())
        counts[row] = right, len(found.false_ns), len(found.hit) - right
        if task.detailed:
            verdicts[row] = found
    return Judged(
        task.key,
        counts,
        tuple(verdicts[row] for row in sorted(verdicts)),
        chain.associates,
        isinstance(task.source, Path),
        measured - began,
        time.perf_counter() - measured,
    )


def in_processes(
    function: Callable[[A], B], arguments: Sequence[A], jobs: int, done: Callable[[], None]
) -> list[B]:
    """Call a function for each argument, in ``jobs`` processes at once; results in that order.

    ``done`` is called after each of them.
    """
    jobs = min(jobs, len(arguments))
    results: dict[int, B] = {}
    if jobs < 2:
        for index, argument in enumerate(arguments):
            results[index] = function(argument)
            done()
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(function, a): i for i, a in enumerate(arguments)}
            try:
                for future in as_completed(futures):
                    results[futures[future]] = future.result()
                    done()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    return [results[index] for index in range(len(arguments))]


def judge_all(tasks: Sequence[Task], jobs: int, done: Callable[[], None]) -> list[Judged]:
    """Judge tasks: those with evidence here, the others in ``jobs`` processes at once.

    ``done`` is called after each one that had to be measured.
    """
    ready = [judge(task) for task in tasks if not isinstance(task.source, Path)]
    rest = [task for task in tasks if isinstance(task.source, Path)]
    return ready + in_processes(judge, rest, jobs, done)
