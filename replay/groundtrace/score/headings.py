"""Scoring of headings against true directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .places import ignored

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Heading
    from groundtrace_codecs.labels import Label

#: Between two headings no further apart the shorter way round is taken [s].
HOLD_S = 1.0


@dataclass(frozen=True, slots=True)
class HeadingScore:
    """How well directions were found, heading minus truth, the shorter way round.

    Attributes
    ----------
    stage
        The stage scored: the last one that gives headings.
    truth, n
        True headings, and those of them at which the stage has one.
    rmse_deg, bias_deg, p95_deg
        Root mean square, circular mean, and 95th percentile of the absolute error [deg]; None
        where ``n`` is 0.
    """

    stage: str
    truth: int
    n: int
    rmse_deg: float | None
    bias_deg: float | None
    p95_deg: float | None


def wrapped(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles within [-pi, pi)."""
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi, np.float64)


def score_headings(
    labels: Sequence[Label], headings: Sequence[Heading], tolerance_s: float = 0.12
) -> HeadingScore | None:
    """Score the headings of one stage against ``heading`` labels.

    Parameters
    ----------
    labels
        The truth; their values are headings [rad].
    headings
        Of one stage.
    tolerance_s
        How far the nearest heading may lie where none lie close on both sides [s].

    Returns
    -------
    The score, or None where there are no true headings or none were found.
    """
    times, errors = heading_errors(labels, headings, tolerance_s)
    if not len(times) or not headings:
        return None
    found = errors[~np.isnan(errors)]
    if not len(found):
        return HeadingScore(headings[-1].stage, len(times), 0, None, None, None)
    bias = float(np.angle(np.exp(1j * found).mean()))
    return HeadingScore(
        stage=headings[-1].stage,
        truth=len(times),
        n=len(found),
        rmse_deg=float(np.degrees(np.sqrt(np.mean(found**2)))),
        bias_deg=float(np.degrees(bias)),
        p95_deg=float(np.degrees(np.percentile(np.abs(found), 95))),
    )


def heading_errors(
    labels: Sequence[Label], headings: Sequence[Heading], tolerance_s: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the times of the true headings outside ``ignore`` spans, and the errors there [rad].

    An error is NaN where there is no heading.
    """
    rows = sorted(
        (x.time_ns, x.value) for x in labels if x.kind == "heading" and x.value is not None
    )
    times = np.array([time for time, _ in rows], np.int64)
    true = np.array([value for _, value in rows], np.float64)
    kept = ~ignored(labels, times)
    times, true = times[kept], true[kept]
    if not headings:
        return times, np.full(len(times), np.nan)
    ordered = sorted(headings, key=lambda heading: heading.time_ns)
    known_ns = np.array([heading.time_ns for heading in ordered], np.int64)
    known = np.array([heading.heading_rad for heading in ordered], np.float64)
    return times, wrapped(_at(known_ns, known, times, tolerance_s) - true)


def _at(
    known_ns: NDArray[np.int64],
    known: NDArray[np.float64],
    times: NDArray[np.int64],
    tolerance_s: float,
) -> NDArray[np.float64]:
    """Return headings at times [rad]: between two close ones, else the nearest, else NaN."""
    after = np.clip(np.searchsorted(known_ns, times), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    gap = known_ns[after] - known_ns[before]
    between = (known_ns[before] <= times) & (times <= known_ns[after])
    between &= (gap > 0) & (gap <= HOLD_S * NS_PER_S)
    part = (times - known_ns[before]) / np.maximum(gap, 1)
    turned = known[before] + part * wrapped(known[after] - known[before])
    earlier = np.abs(times - known_ns[before]) <= np.abs(known_ns[after] - times)
    nearest = np.where(earlier, before, after)
    near = np.abs(known_ns[nearest] - times) <= tolerance_s * NS_PER_S
    return np.where(between, turned, np.where(near, known[nearest], np.nan))
