"""Sweeps: many settings on one or several recordings, and which of them to trust."""

from __future__ import annotations

import time
from bisect import bisect_left
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np

from groundtrace_codecs.events import Gap, Note
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError, RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..pipeline.chain import build_pipeline
from ..pipeline.config import parse_pipeline, with_settings
from ..pipeline.engine import EventList, replay
from ..pipeline.results import Evidence, recording_in, stage_evidence
from ..pipeline.source import Source
from ..pipeline.warned import warnings_of
from ..runtime import safe_path
from .reasons import Interval, bootstrap, event_noun, scored_event, truth_for
from .redecide import Grid, StepChain, make_grid
from .suitability import PLACEMENT, refuse_unsuitable, with_placements

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label

    from ..pipeline.config import PipelineConfig
    from .reasons import Confidence, Verdicts
    from .redecide import Axis

#: Up to so many settings times recordings, what was measured for is kept step by step. Chosen by
#: judgement: it bounds memory.
KEPT = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """A recording that is swept over.

    Attributes
    ----------
    evidence
        What was measured, with the pipeline as it stands and the truth.
    places
        Where the recording may be, needed where the signal path is swept.
    sha256
        Of the recording; empty where the one place is known to be right.
    """

    evidence: Evidence
    places: tuple[Path, ...]
    sha256: str = ""

    @property
    def recorded_s(self) -> float:
        """Length of the recording [s]."""
        return (self.evidence.end_ns - self.evidence.start_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class Rate:
    """How fast a sweep was.

    Attributes
    ----------
    settings
        How many.
    recorded_s
        Recorded time that each of them was decided on [s].
    decided_s
        Wall time of deciding and matching, of all processes together [s].
    recorded_s_per_s
        Recorded time decided for each second of that.
    through
        ``gates`` of detectors alone, or an ``associator`` too.
    measurements, measured_s
        How many measurements were needed, and the wall time of all processes together [s].
    """

    settings: int
    recorded_s: float
    decided_s: float
    recorded_s_per_s: float
    through: str
    measurements: int
    measured_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """Every setting's steps, on every recording.

    Attributes
    ----------
    subjects, grid, tolerance_s
        What was swept.
    counts
        Shape (n_recordings, n_settings, 3), int64: steps right, false and missed.
    now
        Shape (n_recordings, 3): the same with the pipeline as it stands.
    verdicts
        Step by step, by (setting, recording), where the signal had to be measured for it.
    rate
        How fast.
    """

    subjects: tuple[Subject, ...]
    grid: Grid
    tolerance_s: float
    counts: NDArray[np.int64]
    now: NDArray[np.int64]
    verdicts: dict[tuple[int, int], Verdicts]
    rate: Rate


def f1_of(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the F1 of counts (right, false, missed) along the last axis; 0 of nothing."""
    denominator: NDArray[np.int64] = counts @ np.array([2, 1, 1])
    f1: NDArray[np.float64] = 2 * counts[..., 0] / np.maximum(denominator, 1)
    return f1


def count(
    subjects: Sequence[Subject],
    grid: Grid,
    tolerance_s: float = STEP_TOLERANCE_S,
    jobs: int = 1,
    done: Callable[[], None] = lambda: None,
) -> Counted:
    """Decide and score every setting of a grid on every recording.

    Settings that change only gates, or how picks are grouped, are decided from what is stored; the
    others are grouped by what has to be measured, and measured anew in ``jobs`` processes.

    Parameters
    ----------
    subjects
        Recordings, all through the same pipeline.
    grid
        The settings.
    tolerance_s
        Of the match [s].
    jobs
        Processes for measuring.
    done
        Called after each measurement.

    Raises
    ------
    PipelineError
        Where a setting lies below the stored floor.
    """
    rows = range(len(grid))
    tasks, places = _tasks(subjects, grid, rows, tolerance_s, detailed=False)
    keep = len(grid) * len(subjects) <= KEPT
    tasks = [replace(t, detailed=keep and isinstance(t.source, Path)) for t in tasks]
    counts = np.zeros((len(subjects), len(grid), 3), np.int64)
    judged = judge_all(tasks, jobs, done)
    for one in judged:
        recording, group = one.key
        counts[recording, places[group]] = one.counts
    now = np.array([j.counts[0] for j in _as_it_stands(subjects, tolerance_s)])
    rate = _rate(judged, len(grid), sum(s.recorded_s for s in subjects))
    verdicts_by_row = _by_place(judged, places)
    return Counted(tuple(subjects), grid, tolerance_s, counts, now, verdicts_by_row, rate)


def _by_place(judged: Sequence[Judged], places: list[list[int]]) -> dict[tuple[int, int], Verdicts]:
    """Return verdicts by (setting, recording)."""
    return {
        (row, one.key[0]): verdict
        for one in judged
        if one.verdicts
        for row, verdict in zip(places[one.key[1]], one.verdicts, strict=True)
    }


def verdicts(counted: Counted, rows: Sequence[int], jobs: int = 1) -> list[list[Verdicts]]:
    """Return step by step how some settings did, and last the pipeline as it stands.

    One list for each setting, in it one entry for each recording.
    """
    subjects, tolerance_s = counted.subjects, counted.tolerance_s
    several = range(len(subjects))
    more = [row for row in rows if any((row, r) not in counted.verdicts for r in several)]
    tasks, places = _tasks(subjects, counted.grid, more, tolerance_s, detailed=True)
    verdicts_by_row = counted.verdicts | _by_place(judge_all(tasks, jobs), places)
    now = [j.verdicts[0] for j in _as_it_stands(subjects, tolerance_s)]
    return [*([verdicts_by_row[row, r] for r in several] for row in rows), now]


def located(subjects: Sequence[Subject], grid: Grid) -> list[Subject]:
    """Return the subjects with their recordings found, where the signal path is swept.

    Raises
    ------
    RecordingError
        Where one is not to be found.
    """
    if not any(axis.remeasure for axis in grid.axes):
        return list(subjects)
    return [
        Subject(s.evidence, (_recording(s.evidence.name, s.places, s.sha256),)) for s in subjects
    ]


def measurements(subjects: Sequence[Subject], grid: Grid) -> list[Subject]:
    """Return the subject of each measurement that a sweep needs."""
    tasks, _ = _tasks(subjects, grid, range(len(grid)), STEP_TOLERANCE_S, detailed=False)
    return [subjects[t.key[0]] for t in tasks if isinstance(t.source, Path)]


def _recording(name: str, places: tuple[Path, ...], sha256: str) -> Path:
    """Return the place where the recording is that was measured."""
    path = recording_in(places, sha256)
    if path is not None:
        return path
    raise RecordingError(
        f"{name}: expected the recording beside its results, or --recording FILE, since the signal "
        f"path is swept, found none with its SHA-256"
    )


def _tasks(
    subjects: Sequence[Subject],
    grid: Grid,
    rows: Sequence[int],
    tolerance_s: float,
    *,
    detailed: bool,
) -> tuple[list[Task], list[list[int]]]:
    """Return the tasks, keyed by (recording, group), and the settings of each group."""
    signal = [i for i, axis in enumerate(grid.axes) if axis.remeasure]
    others = [i for i, axis in enumerate(grid.axes) if not axis.remeasure]
    groups: dict[tuple[Any, ...], list[int]] = {}
    for row in rows:
        groups.setdefault(tuple(grid.rows[row][i] for i in signal), []).append(row)
    tasks = []
    for recording, subject in enumerate(subjects):
        evidence = subject.evidence
        for group, (values, members) in enumerate(groups.items()):
            config = with_values(evidence.config, [grid.axes[i] for i in signal], values)
            measured = config == evidence.config
            tasks.append(
                Task(
                    (recording, group),
                    evidence
                    if measured
                    else _recording(evidence.name, subject.places, subject.sha256),
                    config,
                    evidence.labels,
                    tuple(grid.axes[i] for i in others),
                    tuple(tuple(grid.rows[row][i] for i in others) for row in members),
                    tolerance_s,
                    detailed,
                )
            )
    return tasks, list(groups.values())


def _as_it_stands(subjects: Sequence[Subject], tolerance_s: float) -> list[Judged]:
    """Judge the pipeline without a change."""
    tasks = [
        Task(i, s.evidence, s.evidence.config, s.evidence.labels, (), ((),), tolerance_s, True)
        for i, s in enumerate(subjects)
    ]
    return judge_all(tasks)


def _rate(judged: Sequence[Judged], settings: int, recorded_s: float) -> Rate:
    decided_s = sum(j.decided_s for j in judged)
    measured = [j.measured_s for j in judged if j.measured]
    return Rate(
        settings,
        recorded_s,
        decided_s,
        settings * recorded_s / max(decided_s, 1e-9),
        "associator" if any(j.associates for j in judged) else "gates",
        len(measured),
        sum(measured),
    )


def reproduced(subject: Subject) -> bool:
    """Whether deciding again without a change gives the steps that were stored."""
    evidence = subject.evidence
    chain = StepChain(evidence, ())
    again, final = chain.step_times(()), chain.links[-1].stage.key
    stored = [p.candidates.time_ns[p.accepted] for p in evidence.of(final)]
    return bool(np.array_equal(np.sort(again), np.sort(np.concatenate(stored))))


A = TypeVar("A")
B = TypeVar("B")


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
        refuse_unsuitable(config, recording.streams, recording.geometry, recording.name)
        # places take long, and no step depends on them, as passes do
        geometry = None if scored_event(config) == "step" else recording.geometry
        config, lines, _ = with_placements(config, recording)
        chain = build_pipeline(config, geometry, recording.labels)
        replay(Source(recording, bridge_s=chain.bridge_s), chain, [sink])
        notes = [Note(recording.start_ns, text, "WARN", PLACEMENT) for text in lines]
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
        row_verdicts = truth.verdicts(chain.passed(task.rows[row]))
        right = int(row_verdicts.hit.sum())
        counts[row] = right, len(row_verdicts.false_ns), len(row_verdicts.hit) - right
        if task.detailed:
            verdicts[row] = row_verdicts
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
            with safe_path():
                futures = {pool.submit(function, a): i for i, a in enumerate(arguments)}
            try:
                for future in as_completed(futures):
                    results[futures[future]] = future.result()
                    done()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    return [results[index] for index in range(len(arguments))]


def judge_all(
    tasks: Sequence[Task], jobs: int = 1, done: Callable[[], None] = lambda: None
) -> list[Judged]:
    """Judge tasks: those with evidence here, the others in ``jobs`` processes at once.

    ``done`` is called after each one that had to be measured.
    """
    ready = [judge(task) for task in tasks if not isinstance(task.source, Path)]
    rest = [task for task in tasks if isinstance(task.source, Path)]
    return ready + in_processes(judge, rest, jobs, done)


class _Builder:
    """Builds the pipeline with one parameter changed; remembers why that was refused first."""

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.reason = ""

    def accepts(self, axis: Axis, value: Any) -> bool:
        """Return whether a replay takes the value."""
        try:
            build_pipeline(with_values(self._config, [axis], [value]))
        except PipelineError as error:
            self.reason = self.reason or str(error)
            return False
        return True

    def accepted(self, axis: Axis, values: Iterable[Any]) -> set[Any]:
        """Return the values that a replay takes.

        What stages ask of each other bounds a parameter from one side, so that the two ends of a
        range tell of what lies between them, and the bound is found in a few trials.
        """
        distinct = sorted(set(values)) if axis.span else list(dict.fromkeys(values))
        if not axis.span:
            return {v for v in distinct if self.accepts(axis, v)}
        first, last = self.accepts(axis, distinct[0]), self.accepts(axis, distinct[-1])
        if first == last:
            return set(distinct) if first else set()
        bound = bisect_left(distinct, True, key=lambda v: self.accepts(axis, v) == last)
        return set(distinct[bound:] if last else distinct[:bound])


def without_refused(grid: Grid, config: PipelineConfig) -> tuple[Grid, str]:
    """Leave out the settings that a replay would refuse.

    Parameters
    ----------
    grid
        The settings.
    config
        The pipeline as it stands, which is no refused one.

    Returns
    -------
    The other settings, and what was left out and why, in one line; empty where nothing was.

    Raises
    ------
    PipelineError
        Where every setting is refused; it says why.
    """
    builder = _Builder(config)
    columns = list(zip(*grid.rows, strict=True))
    accepted = [builder.accepted(a, column) for a, column in zip(grid.axes, columns, strict=True)]
    rows = tuple(
        row
        for row in grid.rows
        if all(v in allowed for v, allowed in zip(row, accepted, strict=True))
    )
    count = len(grid) - len(rows)
    if not count:
        return grid, ""
    if not rows:
        raise PipelineError(builder.reason)
    note = f"{count} of {len(grid)} settings left out, which a replay refuses: {builder.reason}"
    if grid.shape is None:
        return Grid(grid.axes, rows, None), note
    axes = [
        replace(axis, values=tuple(v for v in axis.values if v in allowed))
        for axis, allowed in zip(grid.axes, accepted, strict=True)
    ]
    return make_grid(axes), note


@dataclass(frozen=True, slots=True)
class Swept:
    """A parameter that was swept: how many values from where to where."""

    name: str
    unit: str
    values: int
    first: Any
    last: Any
    remeasured: bool


@dataclass(frozen=True, slots=True)
class Ranked:
    """A setting and what it does, on all recordings together.

    Attributes
    ----------
    settings
        Value of each parameter, by ``stage.param``.
    tp, fp, fn, f1
        Steps right, false and missed, and their F1.
    same
        How many settings reach the same F1.
    interval
        Nine of ten bootstrap draws of its F1.
    behind
        The same of how far it is behind the best setting.
    worse
        Whether it is told apart from the best, as the worse.
    """

    settings: dict[str, Any]
    tp: int
    fp: int
    fn: int
    f1: float
    same: int
    interval: Interval
    behind: Interval
    worse: bool


@dataclass(frozen=True, slots=True)
class FrontPoint:
    """A pair of missed and false steps that no setting beats, and a setting that reaches it."""

    missed: int
    false: int
    f1: float
    same: int
    settings: dict[str, Any]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A recording under the setting that is best on all the others.

    Attributes
    ----------
    recording
        File name.
    settings
        Chosen without this recording.
    tp, fp, fn, f1
        What they do on it.
    in_sample_f1
        What the setting that is best on this recording alone does.
    """

    recording: str
    settings: dict[str, Any]
    tp: int
    fp: int
    fn: int
    f1: float
    in_sample_f1: float


@dataclass(frozen=True, slots=True)
class LeaveOneOut:
    """Every recording left out in turn, and the means."""

    recordings: tuple[LeftOut, ...]
    mean_f1: float
    mean_in_sample_f1: float


@dataclass(frozen=True, slots=True)
class Ranking:
    """What a sweep says.

    Attributes
    ----------
    recordings
        File names.
    parameters
        What was swept.
    counted
        What is counted: steps or passes.
    truth
        How many true ones are scored.
    tolerance_s
        Of the match [s].
    now
        The pipeline as it stands.
    best
        The middle of the plateau of the highest F1.
    top
        The highest F1 there are, each with the middle of its plateau; the best comes first.
    front
        Misses against false steps.
    left_out
        With several recordings.
    rate
        How fast.
    notes
        What to beware of.
    """

    recordings: tuple[str, ...]
    parameters: tuple[Swept, ...]
    counted: str
    truth: int
    tolerance_s: float
    now: Ranked
    best: Ranked
    top: tuple[Ranked, ...]
    front: tuple[FrontPoint, ...]
    left_out: LeaveOneOut | None
    rate: Rate
    notes: tuple[str, ...]


def rank(counted: Counted, top: int = 10, jobs: int = 1) -> Ranking:
    """Report the best settings, with confidence intervals.

    Parameters
    ----------
    counted
        Every setting's steps.
    top
        How many of the highest F1 to list.
    jobs
        Processes, as of :func:`count`.
    """
    f1 = f1_of(counted.counts.sum(axis=0))
    levels = np.unique(f1)[::-1][:top]
    rows = [middle(counted.grid, f1 == level) for level in levels]
    sure = bootstrap(verdicts(counted, rows, jobs))
    same = [int((f1 == level).sum()) for level in levels]
    ranked = tuple(
        _ranked(counted, row, n, sure, i) for i, (row, n) in enumerate(zip(rows, same, strict=True))
    )
    return Ranking(
        tuple(s.evidence.name for s in counted.subjects),
        _parameters(counted),
        event_noun(scored_event(counted.subjects[0].evidence.config)),
        int(counted.now[:, [0, 2]].sum()),
        counted.tolerance_s,
        _now(counted, sure, f1),
        ranked[0],
        ranked,
        _front(counted),
        _leave_one_out(counted) if len(counted.subjects) > 1 else None,
        counted.rate,
        _notes(counted),
    )


def _ranked(counted: Counted, row: int, same: int, sure: Confidence, index: int) -> Ranked:
    tp, fp, fn = counted.counts[:, row].sum(axis=0).tolist()
    f1 = float(f1_of(counted.counts[:, row].sum(axis=0)))
    return Ranked(
        counted.grid.setting(row),
        tp,
        fp,
        fn,
        f1,
        same,
        sure.f1[index],
        sure.behind[index],
        sure.worse(index),
    )


def _now(counted: Counted, sure: Confidence, f1: NDArray[np.float64]) -> Ranked:
    config = counted.subjects[0].evidence.config
    values = {stage.key: stage.parameters for stage in config.stage}
    settings = {axis.name: values[axis.stage][axis.parameter] for axis in counted.grid.axes}
    total = counted.now.sum(axis=0)
    tp, fp, fn = total.tolist()
    total_f1 = float(f1_of(total))
    same = int((f1 == total_f1).sum())
    return Ranked(
        settings, tp, fp, fn, total_f1, same, sure.f1[-1], sure.behind[-1], sure.worse(-1)
    )


def _parameters(counted: Counted) -> tuple[Swept, ...]:
    return tuple(
        Swept(a.name, a.unit, len(a.values), a.values[0], a.values[-1], a.remeasure)
        for a in counted.grid.axes
    )


def _front(counted: Counted) -> tuple[FrontPoint, ...]:
    total = counted.counts.sum(axis=0)
    points = []
    for missed, false in pareto_front(total[:, 2], total[:, 1]):
        equal = (total[:, 2] == missed) & (total[:, 1] == false)
        row = middle(counted.grid, equal)
        f1 = float(f1_of(total[row]))
        points.append(FrontPoint(missed, false, f1, int(equal.sum()), counted.grid.setting(row)))
    return tuple(points)


def _leave_one_out(counted: Counted) -> LeaveOneOut:
    total = counted.counts.sum(axis=0)
    left_out = []
    for subject, subject_counts in zip(counted.subjects, counted.counts, strict=True):
        others = f1_of(total - subject_counts)
        row = middle(counted.grid, others == others.max())
        tp, fp, fn = subject_counts[row].tolist()
        left_out.append(
            LeftOut(
                subject.evidence.name,
                counted.grid.setting(row),
                tp,
                fp,
                fn,
                float(f1_of(subject_counts[row])),
                float(f1_of(subject_counts).max()),
            )
        )
    return LeaveOneOut(
        tuple(left_out), _mean(x.f1 for x in left_out), _mean(x.in_sample_f1 for x in left_out)
    )


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _notes(counted: Counted) -> tuple[str, ...]:
    return tuple(
        f"{s.evidence.name}: the stored gates, decided again, give other steps than were stored"
        for s in counted.subjects
        if not reproduced(s)
    )


def middle(grid: Grid, equal: NDArray[np.bool_]) -> int:
    """Return the setting in the middle of those that are equally good.

    A setting whose neighbours do as well will not fall over on the next recording. In a full grid
    that is the deepest one of the largest connected set, where the grid's edge counts as an end;
    of random settings the one furthest from all others.

    Parameters
    ----------
    grid
        The settings.
    equal
        Which of them to choose from, shape (n,); at least one.
    """
    chosen = np.flatnonzero(equal)
    if len(chosen) == 1:
        return int(chosen[0])
    if grid.shape is not None:
        return _deepest(equal.reshape(grid.shape))
    return _furthest(grid.places(), equal)


def _deepest(equal: NDArray[np.bool_]) -> int:
    from scipy import ndimage

    along = [axis for axis, count in enumerate(equal.shape) if count > 1]
    inside = equal.squeeze()
    parts, count = ndimage.label(inside)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    largest = parts == 1 + int(np.argmax(sizes[1:]))
    depth = ndimage.distance_transform_cdt(np.pad(largest, 1), "chessboard")
    depth = depth[(slice(1, -1),) * len(along)]
    places = np.argwhere(largest & (depth == depth[largest].max()))
    centre = np.argwhere(largest).mean(axis=0)
    best = places[int(np.argmin(((places - centre) ** 2).sum(axis=1)))]
    return int(np.ravel_multi_index(tuple(best), inside.shape))


def _furthest(places: NDArray[np.float64], equal: NDArray[np.bool_]) -> int:
    from scipy.spatial import cKDTree

    chosen = np.flatnonzero(equal)
    if equal.all():
        return int(np.argmin(((places - places.mean(axis=0)) ** 2).sum(axis=1)))
    distance, _ = cKDTree(places[~equal]).query(places[chosen])
    return int(chosen[int(np.argmax(distance))])


def pareto_front(missed: NDArray[np.int64], false: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the pairs (missed, false) that no other pair beats, the fewest missed first.

    One beats another where it is better in one of the two and not worse in the other.
    """
    front: list[tuple[int, int]] = []
    for row in np.lexsort([false, missed]):
        pair = int(missed[row]), int(false[row])
        if not front or pair[1] < front[-1][1]:
            front.append(pair)
    return front
