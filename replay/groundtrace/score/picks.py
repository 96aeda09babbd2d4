"""Scoring of picks against hand picks or computed arrivals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Pick
    from groundtrace_codecs.labels import Label

#: A pick further than this from the true arrival does not answer it [s].
ANSWER_S = 0.05


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
    """

    impacts: list[str]
    impact: NDArray[np.intp]
    channels: list[str]
    error_s: NDArray[np.float64]


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
    median_abs_ms, median_ms, iqr_ms
        Of the answered ones [ms], pick minus truth; None where none is answered.
    earliest_ms, latest_ms
        Extremes over all first picks, answered or not [ms].
    """

    label: str
    truth: int
    answered: int
    answered_fraction: float
    median_abs_ms: float | None
    median_ms: float | None
    iqr_ms: float | None
    earliest_ms: float | None
    latest_ms: float | None


@dataclass(frozen=True, slots=True)
class PickScore:
    """How well arrivals were picked: all together, and impact by impact."""

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
    return PickScore(_summary("", residuals.error_s), each)


def pick_residuals(labels: Sequence[Label], picks: Sequence[Pick]) -> PickResiduals:
    """Return the errors of the answers to the ``pick`` labels.

    The answer to a true arrival is the first pick on its channel between the last impact (or
    step) before the arrival and the next one, so that a false early pick counts as such.
    """
    truth = sorted(x for x in labels if x.kind == "pick")
    impacts = sorted(x for x in labels if x.kind in ("impact", "step"))
    origins = np.array([x.time_ns for x in impacts], np.int64)
    by_channel: dict[str, list[int]] = {}
    for pick in picks:
        by_channel.setdefault(pick.channel, []).append(pick.time_ns)
    times = {name: np.sort(np.array(found, np.int64)) for name, found in by_channel.items()}
    group = np.searchsorted(origins, [x.time_ns for x in truth], side="right") - 1
    errors = [
        _first_error_s(label, times.get(label.channel), origins, int(k))
        for label, k in zip(truth, group, strict=True)
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
    return PickResiduals(names, impact, [x.channel for x in truth], np.array(errors, np.float64))


def _first_error_s(
    label: Label, times: NDArray[np.int64] | None, origins: NDArray[np.int64], group: int
) -> float:
    """Return first pick minus arrival [s], NaN where there is no pick before the next impact."""
    if times is None:
        return float("nan")
    begin = origins[group] if group >= 0 else np.iinfo(np.int64).min
    end = origins[group + 1] if group + 1 < len(origins) else np.iinfo(np.int64).max
    at = int(np.searchsorted(times, begin, side="left"))
    if at == len(times) or times[at] >= end:
        return float("nan")
    return float(times[at] - label.time_ns) / NS_PER_S


def _summary(name: str, errors_s: NDArray[np.float64]) -> PickErrors:
    found = errors_s[~np.isnan(errors_s)] * 1e3
    good = found[np.abs(found) <= ANSWER_S * 1e3]
    low, middle, high = np.percentile(good, [25, 50, 75]) if len(good) else [None] * 3
    return PickErrors(
        label=name,
        truth=len(errors_s),
        answered=len(good),
        answered_fraction=len(good) / len(errors_s),
        median_abs_ms=float(np.median(np.abs(good))) if len(good) else None,
        median_ms=None if middle is None else float(middle),
        iqr_ms=None if low is None else float(high - low),
        earliest_ms=float(found.min()) if len(found) else None,
        latest_ms=float(found.max()) if len(found) else None,
    )
