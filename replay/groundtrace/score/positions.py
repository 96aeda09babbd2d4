"""Scoring of position fixes against true places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import has_vehicles

from .places import found_places, match_places, places_at, true_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix
    from groundtrace_codecs.labels import Label

    from .places import Places


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """Errors of the matched fixes of a group, fix minus truth [m]; None where there is none.

    Attributes
    ----------
    group
        Which fixes: how many picks they rest on, or the stage that found them.
    n
        How many matched.
    rmse_m
        Root of the mean squared distance.
    cep50_m, cep95_m
        Radii about the true place that hold half, and 95 %, of the fixes.
    bias_x_m, bias_y_m
        Mean error by axis.
    """

    group: str
    n: int
    rmse_m: float | None
    cep50_m: float | None
    cep95_m: float | None
    bias_x_m: float | None
    bias_y_m: float | None


@dataclass(frozen=True, slots=True)
class PositionScore:
    """How well places were found.

    Attributes
    ----------
    stage
        The stage scored: the last one that gives fixes.
    truth, found
        True places, and fixes of the stage.
    n, rmse_m, cep50_m, cep95_m, bias_x_m, bias_y_m
        Of the matched fixes, as in :class:`PositionErrors`.
    by_picks
        The same by how many picks a fix rests on.
    by_stage
        The same for every stage that gives fixes.
    """

    stage: str
    truth: int
    found: int
    n: int
    rmse_m: float | None
    cep50_m: float | None
    cep95_m: float | None
    bias_x_m: float | None
    bias_y_m: float | None
    by_picks: list[PositionErrors]
    by_stage: list[PositionErrors]


def score_positions(
    labels: Sequence[Label], fixes: Sequence[Fix], tolerance_s: float = 0.12
) -> PositionScore | None:
    """Score fixes against the places of steps and impacts, else of waypoints.

    Vehicles are on their way at all times: fixes are scored against where they are at the fix's
    own time, straight between waypoints.

    Parameters
    ----------
    labels
        The truth.
    fixes
        Of all stages.
    tolerance_s
        Largest distance in time of a match [s].

    Returns
    -------
    The score, or None where there are no true places or no fixes.
    """
    truth = true_places(labels)
    if not len(truth) or not fixes:
        return None
    if has_vehicles(labels):
        truth = places_at(truth, np.array([fix.time_ns for fix in fixes], np.int64))
    stages = list(dict.fromkeys(fix.stage for fix in fixes))
    matched = {
        s: matched_fixes(truth, [f for f in fixes if f.stage == s], tolerance_s) for s in stages
    }
    kept, errors = matched[stages[-1]]
    total = summary("", errors)
    picks = np.array([fix.picks for fix in kept], np.int64)
    return PositionScore(
        stage=stages[-1],
        truth=len(truth),
        found=sum(fix.stage == stages[-1] for fix in fixes),
        n=total.n,
        rmse_m=total.rmse_m,
        cep50_m=total.cep50_m,
        cep95_m=total.cep95_m,
        bias_x_m=total.bias_x_m,
        bias_y_m=total.bias_y_m,
        by_picks=[summary(str(k), errors[picks == k]) for k in np.unique(picks)],
        by_stage=[summary(stage, found[1]) for stage, found in matched.items()],
    )


def matched_fixes(
    truth: Places, fixes: Sequence[Fix], tolerance_s: float
) -> tuple[list[Fix], NDArray[np.float64]]:
    """Return the fixes that answer a true place, and their errors [m], shape (n, 2)."""
    ordered = sorted(fixes, key=lambda fix: fix.time_ns)
    found = found_places(ordered)
    pairs = match_places(truth, found, tolerance_s)
    errors = found.xy[pairs[:, 1]] - truth.xy[pairs[:, 0]]
    return [ordered[j] for j in pairs[:, 1]], errors


def summary(group: str, errors: NDArray[np.float64]) -> PositionErrors:
    """Summarise errors [m], shape (n, 2)."""
    if not len(errors):
        return PositionErrors(group, 0, None, None, None, None, None)
    radius = np.hypot(errors[:, 0], errors[:, 1])
    half, most = np.percentile(radius, [50, 95])
    bias = errors.mean(axis=0)
    rmse = float(np.sqrt(np.mean(radius**2)))
    return PositionErrors(
        group, len(errors), rmse, float(half), float(most), float(bias[0]), float(bias[1])
    )
