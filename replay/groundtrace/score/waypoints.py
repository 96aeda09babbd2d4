"""How far a track is from the waypoints that truth has, in the map's own frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.events import TrackPoint
    from groundtrace_codecs.labels import Label


@dataclass(frozen=True, slots=True)
class WaypointScore:
    """Distances of a track from waypoints, its place at their times straight between its points.

    Attributes
    ----------
    n
        How many waypoints.
    median_m, mean_m, p95_m
        Of the distances from all waypoints but the first, where a reckoning may begin [m].
    end_m
        Distance from the last one [m].
    way_m
        Length of the way straight from waypoint to waypoint [m].
    end_percent
        The end's distance as a part of that way [%].
    way_error_percent
        Longer (or, negative, shorter) that the track is between the first and the last waypoint,
        as a part of that way [%].
    """

    n: int
    median_m: float
    mean_m: float
    p95_m: float
    end_m: float
    way_m: float
    end_percent: float
    way_error_percent: float


def score_waypoints(labels: Sequence[Label], points: Sequence[TrackPoint]) -> WaypointScore | None:
    """Score the points of one stage against the waypoints of one target.

    A track stands still before its first and after its last point.

    Returns
    -------
    The score, or None with fewer than two waypoints, of several targets, or without a way.
    """
    truth = sorted((x for x in labels if x.kind == "waypoint"), key=lambda x: x.time_ns)
    truth = [x for x in truth if x.x_m is not None and x.y_m is not None]
    if len(truth) < 2 or len({x.target for x in truth}) > 1 or not points:
        return None
    ordered = sorted(points, key=lambda point: point.time_ns)
    origin = ordered[0].time_ns  # counted from it, nanoseconds are exact in floating point
    since = np.array([p.time_ns - origin for p in ordered], np.float64)
    at = np.array([x.time_ns - origin for x in truth], np.float64)
    places = np.array([(p.x_m, p.y_m) for p in ordered])
    true = np.array([(x.x_m, x.y_m) for x in truth], np.float64)
    found = np.column_stack([np.interp(at, since, column) for column in places.T])
    off = np.hypot(*(found - true).T)
    way_m = _length(true)
    if way_m == 0:
        return None
    between = places[(since > at[0]) & (since < at[-1])]
    walked_m = _length(np.concatenate([found[:1], between, found[-1:]]))
    return WaypointScore(
        n=len(truth),
        median_m=float(np.median(off[1:])),
        mean_m=float(off[1:].mean()),
        p95_m=float(np.percentile(off[1:], 95)),
        end_m=float(off[-1]),
        way_m=way_m,
        end_percent=100 * float(off[-1]) / way_m,
        way_error_percent=100 * (walked_m / way_m - 1),
    )


def _length(places: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    return float(np.hypot(*np.diff(places, axis=0).T).sum())
