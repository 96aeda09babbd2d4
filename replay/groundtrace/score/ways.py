"""How far tracks are from the ways of vehicles: across the way, along it, and in speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.labels import has_vehicles
from groundtrace_codecs.signals import NS_PER_S

from .places import HOLD_S, true_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import TrackPoint
    from groundtrace_codecs.labels import Label

    from .places import Places

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WayScore:
    """Errors of track points against the way of the nearest vehicle.

    Attributes
    ----------
    n
        Track points at whose time truth has a vehicle.
    across_median_m, across_p90_m
        Of the distances across the vehicle's way [m].
    along_median_m
        Median of how far ahead the track is [m], behind where negative.
    speed_median_mps
        Median of the absolute errors of speed [m/s].
    """

    n: int
    across_median_m: float
    across_p90_m: float
    along_median_m: float
    speed_median_mps: float


def score_ways(labels: Sequence[Label], points: Sequence[TrackPoint]) -> WayScore | None:
    """Score the track points of one stage against the ways of vehicles.

    Returns
    -------
    The score, or None where truth has no vehicles, or none at the time of any point.
    """
    if not has_vehicles(labels):
        return None
    truth = true_places(labels)
    ways = [truth.of(name) for name in truth.names()]
    errors = [e for p in points if (e := _errors(p, ways)) is not None]
    if not errors:
        return None
    across, along, speed = np.array(errors).T
    return WayScore(
        n=len(errors),
        across_median_m=float(np.median(across)),
        across_p90_m=float(np.percentile(across, 90)),
        along_median_m=float(np.median(along)),
        speed_median_mps=float(np.median(speed)),
    )


def _errors(point: TrackPoint, ways: Sequence[Places]) -> tuple[float, float, float] | None:
    """Return errors across, along and of speed against the nearest vehicle; None without any."""
    about = np.array([0, -NS_PER_S // 4, NS_PER_S // 4], np.int64) + point.time_ns
    place = np.array([point.x_m, point.y_m])
    best: tuple[float, float, float] | None = None
    nearest = np.inf
    for way in ways:
        here, before, after = way.at(about, HOLD_S, 0.0)
        motion = after - before
        length = float(np.hypot(*motion))
        off = place - here
        if not np.isfinite(length) or length == 0 or np.hypot(*off) >= nearest:
            continue
        nearest = float(np.hypot(*off))
        ahead = motion / length
        speed = abs(float(np.hypot(point.vx_mps, point.vy_mps)) - 2 * length)
        across = abs(float(off[1] * ahead[0] - off[0] * ahead[1]))
        best = across, float(off @ ahead), speed
    return best
