"""Scoring of picks against hand picks or computed arrivals.

Which pick answers a true arrival, and whether it is right, late, early or missed, is decided here
only: ``score`` counts it and ``why`` explains it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, Pick

#: A pick further than this from the true arrival does not answer it [s]. Chosen by judgement: a
#: picker is late by milliseconds, and the next step is hundreds away.
ANSWER_S = 0.05
#: Largest error of a right pick [s] where no other is asked for. Chosen by judgement: bending waves
#: go a metre or two in it.
RIGHT_S = 0.002


@dataclass(frozen=True, slots=True, eq=False)
class PickResiduals:
    """The first pick after an impact on every channel, minus the true arrival.

    Attributes
    ----------
    impacts
        Names of the impacts, in order of time.
    impact
        Index of each arrival's impact, shape (n,).
    channels
        Of each arrival.
    error_s
        Pick minus arrival [s], shape (n,); NaN where there is no pick.
    truth
        The true arrivals, in order of time.
    picks
        The first pick after each one's impact, or None.
    """

    impacts: list[str]
    impact: NDArray[np.intp]
    channels: list[str]
    error_s: NDArray[np.float64]
    truth: list[Label]
    picks: list[Pick | None]

    def states(self, tolerance_s: float = RIGHT_S) -> list[str]:
        """Return whether each arrival's pick is ``right``, ``late``, ``early`` or ``missed``.

        An arrival is missed where nothing answers it: no pick at all, or the first one farther off
        than :data:`ANSWER_S`.
        """
        return [pick_state(error, tolerance_s) for error in self.error_s.tolist()]


def pick_state(error_s: float, tolerance_s: float = RIGHT_S) -> str:
    """Return what an error [s] makes of a pick: ``right``, ``late``, ``early`` or ``missed``."""
    if not abs(error_s) <= ANSWER_S:
        return "missed"
    if abs(error_s) <= tolerance_s:
        return "right"
    return "late" if error_s > 0 else "early"


@dataclass(frozen=True, slots=True)
class PickErrors:
    """Errors of the first picks after impacts.

    Attributes
    ----------
    label
        Which impact; empty for all together.
    truth
        True arrivals.
    answered
        Arrivals whose first pick lies within 50 ms.
    answered_fraction
        Their part.
    right, late, early, missed
        How many are right to :data:`RIGHT_S`, late, early, and not answered.
    median_abs_ms, median_ms, iqr_ms
        Of the answered ones [ms], pick minus truth; None where none is answered.
    earliest_ms, latest_ms
        Extremes over all first picks, answered or not [ms].
    """

    label: str
    truth: int
    answered: int
    answered_fraction: float
    right: int
    late: int
    early: int
    missed: int
    median_abs_ms: float | None
    median_ms: float | None
    iqr_ms: float | None
    earliest_ms: float | None
    latest_ms: float | None


@dataclass(frozen=True, slots=True)
class PickScore:
    """How well arrivals were picked: all together, and impact by impact.

    ``stage`` names the stage whose picks these are; of several topics, each one's last.
    """

    stage: str
    all: PickErrors
    impacts: list[PickErrors]


def score_picks(labels: Sequence[Label], picks: Sequence[Pick]) -> PickScore | None:
    """Score picks against ``pick`` labels.

    Returns
    -------
    The score, or None where the truth has no picks.
    """
    residuals = pick_residuals(labels, picks)
    if not len(residuals.error_s):
        return None
    each = [
        _summary(name, residuals.error_s[residuals.impact == i])
        for i, name in enumerate(residuals.impacts)
    ]
    stage = ", ".join(dict.fromkeys(pick.stage for pick in picks))
    return PickScore(stage, _summary("", residuals.error_s), each)


def pick_residuals(labels: Sequence[Label], picks: Sequence[Pick]) -> PickResiduals:
    """Return the errors of the answers to the ``pick`` labels.

    The answer to a true arrival is the first pick on its channel between the last impact (or
    step) before the arrival and the next one, so that a false early pick counts as such.
    """
    truth = sorted(x for x in labels if x.kind == "pick")
    impacts = sorted(x for x in labels if x.kind in ("impact", "step"))
    origins = np.array([x.time_ns for x in impacts], np.int64)
    by_channel: dict[str, list[Pick]] = {}
    for pick in sorted(picks, key=lambda pick: pick.time_ns):
        by_channel.setdefault(pick.channel, []).append(pick)
    times = {
        name: np.array([pick.time_ns for pick in channel_picks], np.int64)
        for name, channel_picks in by_channel.items()
    }
    group = np.searchsorted(origins, [x.time_ns for x in truth], side="right") - 1
    none = np.empty(0, np.int64)
    first = [
        _first_row(times.get(label.channel, none), origins, int(k))
        for label, k in zip(truth, group, strict=True)
    ]
    answers = [
        None if row is None else by_channel[label.channel][row]
        for label, row in zip(truth, first, strict=True)
    ]
    errors = [
        float("nan") if pick is None else float(pick.time_ns - label.time_ns) / NS_PER_S
        for label, pick in zip(truth, answers, strict=True)
    ]
    present, impact = np.unique(group, return_inverse=True)
    labelled = [x.label for x in impacts]
    names = [
        "before"
        if k < 0
        else labelled[k]
        if labelled.count(labelled[k]) == 1
        else f"impact {k + 1}"
        for k in present
    ]
    return PickResiduals(
        names, impact, [x.channel for x in truth], np.array(errors, np.float64), truth, answers
    )


def _first_row(
    times_ns: NDArray[np.int64], origins_ns: NDArray[np.int64], group: int
) -> int | None:
    """Return the first of a channel's picks between an impact and the next; None without one."""
    begin = origins_ns[group] if group >= 0 else np.iinfo(np.int64).min
    end = origins_ns[group + 1] if group + 1 < len(origins_ns) else np.iinfo(np.int64).max
    at = int(np.searchsorted(times_ns, begin, side="left"))
    return None if at == len(times_ns) or times_ns[at] >= end else at


def _summary(name: str, errors_s: NDArray[np.float64]) -> PickErrors:
    errors_ms = errors_s[~np.isnan(errors_s)] * 1e3
    states = [pick_state(error) for error in errors_s.tolist()]
    count = Counter(states)
    good = errors_s[[state != "missed" for state in states]] * 1e3
    low, middle, high = np.percentile(good, [25, 50, 75]) if len(good) else [None] * 3
    return PickErrors(
        label=name,
        truth=len(errors_s),
        answered=len(good),
        answered_fraction=len(good) / len(errors_s),
        right=count["right"],
        late=count["late"],
        early=count["early"],
        missed=count["missed"],
        median_abs_ms=float(np.median(np.abs(good))) if len(good) else None,
        median_ms=None if middle is None else float(middle),
        iqr_ms=None if low is None else float(high - low),
        earliest_ms=float(errors_ms.min()) if len(errors_ms) else None,
        latest_ms=float(errors_ms.max()) if len(errors_ms) else None,
    )
