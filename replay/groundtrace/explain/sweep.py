"""Sweeps: many settings on one or several recordings, and which of them to trust."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from .chain import StepChain
from .measuring import Judged, Task, judge_all, recording_in, with_values

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from .bootstrap import Verdicts
    from .evidence import Evidence
    from .grid import Grid

#: Up to so many settings times recordings, what was measured for is kept step by step.
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
    kept
        Step by step, by (setting, recording), where the signal had to be measured for it.
    rate
        How fast.
    """

    subjects: tuple[Subject, ...]
    grid: Grid
    tolerance_s: float
    counts: NDArray[np.int64]
    now: NDArray[np.int64]
    kept: dict[tuple[int, int], Verdicts]
    rate: Rate


def f1_of(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the F1 of counts (right, false, missed) along the last axis; 0 of nothing."""
    whole: NDArray[np.int64] = counts @ np.array([2, 1, 1])
    f1: NDArray[np.float64] = 2 * counts[..., 0] / np.maximum(whole, 1)
    return f1


def count(
    subjects: Sequence[Subject],
    grid: Grid,
    tolerance_s: float = 0.12,
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
    kept = _by_place(judged, places)
    return Counted(tuple(subjects), grid, tolerance_s, counts, now, kept, rate)


def _by_place(judged: Sequence[Judged], places: list[list[int]]) -> dict[tuple[int, int], Verdicts]:
    """Return verdicts by (setting, recording)."""
    return {
        (row, one.key[0]): verdict
        for one in judged
        if one.verdicts
        for row, verdict in zip(places[one.key[1]], one.verdicts, strict=True)
    }


def verdicts(
    counted: Counted, rows: Sequence[int], jobs: int = 1, done: Callable[[], None] = lambda: None
) -> list[list[Verdicts]]:
    """Return step by step how some settings did, and last the pipeline as it stands.

    One list for each setting, in it one entry for each recording.
    """
    subjects, tolerance_s = counted.subjects, counted.tolerance_s
    several = range(len(subjects))
    more = [row for row in rows if any((row, r) not in counted.kept for r in several)]
    tasks, places = _tasks(subjects, counted.grid, more, tolerance_s, detailed=True)
    found = counted.kept | _by_place(judge_all(tasks, jobs, done), places)
    now = [j.verdicts[0] for j in _as_it_stands(subjects, tolerance_s)]
    return [*([found[row, r] for r in several] for row in rows), now]


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
    tasks, _ = _tasks(subjects, grid, range(len(grid)), 0.12, detailed=False)
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
    return judge_all(tasks, 1, lambda: None)


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
