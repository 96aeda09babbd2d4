"""What a sweep says: the best settings, how sure that is, the front, and each one left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .bootstrap import Interval, bootstrap
from .counted import counted_kind, noun_of
from .plateau import middle, pareto_front
from .sweep import Counted, Rate, f1_of, reproduced, verdicts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from .bootstrap import Confidence


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


def rank(
    counted: Counted, top: int = 10, jobs: int = 1, done: Callable[[], None] = lambda: None
) -> Ranking:
    """Say which settings are best, and how sure that is.

    Parameters
    ----------
    counted
        Every setting's steps.
    top
        How many of the highest F1 to list.
    jobs, done
        As those of :func:`~groundtrace.explain.sweep.count`.
    """
    f1 = f1_of(counted.counts.sum(axis=0))
    levels = np.unique(f1)[::-1][:top]
    rows = [middle(counted.grid, f1 == level) for level in levels]
    sure = bootstrap(verdicts(counted, rows, jobs, done))
    same = [int((f1 == level).sum()) for level in levels]
    ranked = tuple(
        _ranked(counted, row, n, sure, i) for i, (row, n) in enumerate(zip(rows, same, strict=True))
    )
    return Ranking(
        tuple(s.evidence.name for s in counted.subjects),
        _parameters(counted),
        noun_of(counted_kind(counted.subjects[0].evidence.config)),
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


def _ranked(counted: Counted, row: int, same: int, sure: Confidence, place: int) -> Ranked:
    tp, fp, fn = counted.counts[:, row].sum(axis=0).tolist()
    f1 = float(f1_of(counted.counts[:, row].sum(axis=0)))
    return Ranked(
        counted.grid.setting(row),
        tp,
        fp,
        fn,
        f1,
        same,
        sure.f1[place],
        sure.behind[place],
        sure.worse(place),
    )


def _now(counted: Counted, sure: Confidence, f1: NDArray[np.float64]) -> Ranked:
    config = counted.subjects[0].evidence.config
    values = {stage.key: stage.parameters for stage in config.stage}
    settings = {axis.name: values[axis.stage][axis.parameter] for axis in counted.grid.axes}
    total = counted.now.sum(axis=0)
    tp, fp, fn = total.tolist()
    own = float(f1_of(total))
    same = int((f1 == own).sum())
    return Ranked(settings, tp, fp, fn, own, same, sure.f1[-1], sure.behind[-1], sure.worse(-1))


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
    whole = counted.counts.sum(axis=0)
    left_out = []
    for subject, own in zip(counted.subjects, counted.counts, strict=True):
        others = f1_of(whole - own)
        row = middle(counted.grid, others == others.max())
        tp, fp, fn = own[row].tolist()
        left_out.append(
            LeftOut(
                subject.evidence.name,
                counted.grid.setting(row),
                tp,
                fp,
                fn,
                float(f1_of(own[row])),
                float(f1_of(own).max()),
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
