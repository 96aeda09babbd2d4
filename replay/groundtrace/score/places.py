"""True places, and which estimated places answer them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .assignment import assign, distances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, TrackPoint
    from groundtrace_codecs.labels import Label

#: How many metres weigh as much as the whole tolerance in time, where several could match.
METRES_PER_TOLERANCE = 1.0
#: Truth is straight between two of its waypoints that are no further apart [s].
HOLD_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places in time.

    Attributes
    ----------
    time_ns
        Shape (n,), sorted.
    xy
        Shape (n, 2) [m].
    target
        Shape (n,): names of the targets that were there; empty where truth names none.
    """

    time_ns: NDArray[np.int64]
    xy: NDArray[np.float64]
    target: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.time_ns)

    def names(self) -> list[str]:
        """Return the targets, sorted."""
        return sorted(set(self.target.tolist()))

    def of(self, target: str) -> Places:
        """Return the places of one target."""
        mine = self.target == target
        return Places(self.time_ns[mine], self.xy[mine], self.target[mine])

    def at(
        self, time_ns: NDArray[np.int64], hold_s: float, tolerance_s: float
    ) -> NDArray[np.float64]:
        """Return where one target is at times, straight between its places.

        Parameters
        ----------
        time_ns
            Shape (m,).
        hold_s
            It is there between two places that are no further apart [s].
        tolerance_s
            And so long before and after each place [s].

        Returns
        -------
        Shape (m, 2) [m]; NaN where it is not.
        """
        # Counted from the first place, nanoseconds are exact in floating point.
        since = (time_ns - self.time_ns[0]).astype(np.float64)
        knots = (self.time_ns - self.time_ns[0]).astype(np.float64)
        after = np.clip(np.searchsorted(knots, since), 0, len(knots) - 1)
        before = np.maximum(np.where(knots[after] == since, after, after - 1), 0)
        near = np.minimum(np.abs(since - knots[before]), np.abs(since - knots[after]))
        between = (since >= knots[before]) & (since <= knots[after])
        held = between & (knots[after] - knots[before] <= hold_s * NS_PER_S)
        there = held | (near <= tolerance_s * NS_PER_S)
        places = np.column_stack([np.interp(since, knots, column) for column in self.xy.T])
        places[~there] = np.nan
        return places


def ignored(labels: Sequence[Label], time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which times lie in an ``ignore`` span."""
    out = np.zeros(len(time_ns), np.bool_)
    for x in labels:
        if x.kind == "ignore" and x.end_ns is not None:
            out |= (time_ns >= x.time_ns) & (time_ns < x.end_ns)
    return out


def true_places(labels: Sequence[Label]) -> Places:
    """Return where truth says that somebody was: places of steps and impacts, else waypoints.

    Those inside ``ignore`` spans are left out.
    """
    for kinds in (("step", "impact"), ("waypoint",)):
        rows = sorted(
            (x.time_ns, x.x_m, x.y_m, x.target)
            for x in labels
            if x.kind in kinds and x.x_m is not None and x.y_m is not None
        )
        if rows:
            time_ns = np.array([row[0] for row in rows], np.int64)
            kept = ~ignored(labels, time_ns)
            xy = np.array([row[1:3] for row in rows], np.float64)
            target = np.array([row[3] for row in rows], np.str_)
            return Places(time_ns[kept], xy[kept], target[kept])
    return Places(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0, np.str_))


def places_at(truth: Places, time_ns: NDArray[np.int64]) -> Places:
    """Return where all vehicles are at times, straight between waypoints; times without are out.

    Parameters
    ----------
    truth
        Waypoints.
    time_ns
        Shape (m,).
    """
    times = np.unique(time_ns)
    rows: list[tuple[int, float, float, str]] = []
    for name in truth.names():
        found = truth.of(name).at(times, HOLD_S, 0.0)
        rows += [
            (int(t), float(x), float(y), name)
            for t, (x, y) in zip(times, found, strict=True)
            if not np.isnan(x)
        ]
    rows.sort()
    return Places(
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1:3] for row in rows], np.float64).reshape(-1, 2),
        np.array([row[3] for row in rows], np.str_),
    )


def found_places(events: Sequence[Fix | TrackPoint]) -> Places:
    """Return the places of events that are in order of time."""
    time_ns = np.array([e.time_ns for e in events], np.int64)
    xy = np.array([(e.x_m, e.y_m) for e in events], np.float64).reshape(-1, 2)
    return Places(time_ns, xy, np.full(len(events), ""))


def match_places(truth: Places, found: Places, tolerance_s: float) -> NDArray[np.intp]:
    """Match estimated to true places one to one, by time first.

    Pairs lie within the tolerance, or within half the usual distance between the true times of
    one target where that is less, so that an estimate answers the truth nearest in time. Where
    several could match, as with two walkers, time and place decide together; how far off a place
    is never forbids a match.

    Returns
    -------
    Index pairs (truth, found), shape (n, 2).
    """
    apart = [np.diff(np.unique(truth.of(name).time_ns)) for name in truth.names()]
    gate_ns = tolerance_s * NS_PER_S
    if any(len(each) for each in apart):
        gate_ns = min(gate_ns, float(np.median(np.concatenate(apart))) / 2)
    pairs = [
        _match_group(truth, found, rows, columns, gate_ns)
        for rows, columns in _groups(truth.time_ns, found.time_ns, gate_ns)
    ]
    return np.concatenate([np.empty((0, 2), np.intp), *pairs])


def _groups(
    truth_ns: NDArray[np.int64], found_ns: NDArray[np.int64], gate_ns: float
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return indices of truth and estimates, cut where nothing reaches across."""
    order = np.argsort(np.concatenate([truth_ns, found_ns]), kind="stable")
    times = np.concatenate([truth_ns, found_ns])[order]
    cuts = np.flatnonzero(np.diff(times) > gate_ns) + 1
    groups = [
        (part[part < len(truth_ns)], part[part >= len(truth_ns)] - len(truth_ns))
        for part in np.split(order, cuts)
    ]
    return [(rows, columns) for rows, columns in groups if len(rows) and len(columns)]


def _match_group(
    truth: Places,
    found: Places,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    gate_ns: float,
) -> NDArray[np.intp]:
    late = np.abs(truth.time_ns[rows][:, None] - found.time_ns[columns][None, :])
    apart = distances(truth.xy[rows], found.xy[columns]) / METRES_PER_TOLERANCE
    cost = np.where(late <= gate_ns, np.hypot(late / max(gate_ns, 1.0), apart), np.inf)
    pairs = assign(cost, np.inf)
    return np.column_stack([rows[pairs[:, 0]], columns[pairs[:, 1]]])
