"""Scoring of positions: fixes against true positions, waypoints, closure and turn of a track.

A track of dead reckoning has a frame of its own: it begins anywhere and heads anywhere. Only its
length, its shape, and whether it returns to its start as the walker did can be right or wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import has_vehicles
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.assignment import assign, distances
from .matching import STEP_TOLERANCE_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, Label, TrackPoint


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


def answerable_places(labels: Sequence[Label], fixes: Sequence[Fix]) -> Places:
    """Return the true places that fixes are scored against: of vehicles those at their times."""
    truth = true_places(labels)
    if not len(truth) or not fixes or not has_vehicles(labels):
        return truth
    return places_at(truth, np.sort(np.array([fix.time_ns for fix in fixes], np.int64)))


def score_positions(
    labels: Sequence[Label],
    fixes: Sequence[Fix],
    tolerance_s: float = STEP_TOLERANCE_S,
    *,
    told_by: str = "",
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
    told_by
        The stage that would have given some; empty where there is none.

    Returns
    -------
    The score, or None where there are no true places, or no stage.
    """
    truth = answerable_places(labels, fixes)
    if not len(truth) or not (fixes or told_by):
        return None
    stages = list(dict.fromkeys(fix.stage for fix in fixes)) or [told_by]
    matched = {
        s: matched_fixes(truth, [f for f in fixes if f.stage == s], tolerance_s) for s in stages
    }
    answering_fixes, errors = matched[stages[-1]]
    total = summary("", errors)
    picks = np.array([fix.picks for fix in answering_fixes], np.int64)
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
        by_stage=[summary(stage, stage_match[1]) for stage, stage_match in matched.items()],
    )


def matched_fixes(
    truth: Places, fixes: Sequence[Fix], tolerance_s: float
) -> tuple[list[Fix], NDArray[np.float64]]:
    """Return the fixes that answer a true place, and their errors [m], shape (n, 2)."""
    ordered = sorted(fixes, key=lambda fix: fix.time_ns)
    estimated = found_places(ordered)
    pairs = match_places(truth, estimated, tolerance_s)
    errors = estimated.xy[pairs[:, 1]] - truth.xy[pairs[:, 0]]
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


#: How many metres weigh as much as the whole tolerance in time, where several could match. Chosen
#: by judgement: a step's length and a little.
METRES_PER_TOLERANCE = 1.0
#: Truth is straight between two of its waypoints that are no further apart [s]. Chosen by
#: judgement: steps of a walk are nearer, pauses are longer.
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
        bridged = between & (knots[after] - knots[before] <= hold_s * NS_PER_S)
        there = bridged | (near <= tolerance_s * NS_PER_S)
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
            scored = ~ignored(labels, time_ns)
            xy = np.array([row[1:3] for row in rows], np.float64)
            target = np.array([row[3] for row in rows], np.str_)
            return Places(time_ns[scored], xy[scored], target[scored])
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
        places = truth.of(name).at(times, HOLD_S, 0.0)
        rows += [
            (int(t), float(x), float(y), name)
            for t, (x, y) in zip(times, places, strict=True)
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


def match_places(truth: Places, estimated: Places, tolerance_s: float) -> NDArray[np.intp]:
    """Match estimated to true places one to one, by time first.

    Pairs lie within the tolerance, or within half the usual distance between the true times of
    one target where that is less, so that an estimate answers the truth nearest in time. Where
    several could match, as with two walkers, time and place decide together; how far off a place
    is never forbids a match.

    Returns
    -------
    Index pairs (truth, estimated), shape (n, 2).
    """
    apart = [np.diff(np.unique(truth.of(name).time_ns)) for name in truth.names()]
    gate_ns = tolerance_s * NS_PER_S
    if any(len(each) for each in apart):
        gate_ns = min(gate_ns, float(np.median(np.concatenate(apart))) / 2)
    pairs = [
        _match_group(truth, estimated, rows, columns, gate_ns)
        for rows, columns in _groups(truth.time_ns, estimated.time_ns, gate_ns)
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
    estimated: Places,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    gate_ns: float,
) -> NDArray[np.intp]:
    late = np.abs(truth.time_ns[rows][:, None] - estimated.time_ns[columns][None, :])
    apart = distances(truth.xy[rows], estimated.xy[columns]) / METRES_PER_TOLERANCE
    cost = np.where(late <= gate_ns, np.hypot(late / max(gate_ns, 1.0), apart), np.inf)
    pairs = assign(cost, np.inf)
    return np.column_stack([rows[pairs[:, 0]], columns[pairs[:, 1]]])


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
    estimated = np.column_stack([np.interp(at, since, column) for column in places.T])
    off = np.hypot(*(estimated - true).T)
    way_m = _length(true)
    if way_m == 0:
        return None
    between = places[(since > at[0]) & (since < at[-1])]
    walked_m = _length(np.concatenate([estimated[:1], between, estimated[-1:]]))
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


#: True places from which on a shape can be compared. Source: definition: two make a line, whatever
#: the shape.
LEAST_PLACES = 3


@dataclass(frozen=True, slots=True)
class ClosureScore:
    """Length, end and shape of one track.

    Attributes
    ----------
    walked_m
        Length of the track between the first and the last true place [m].
    apart_m, true_apart_m
        How far its place at the last true time is from that at the first, and the truth of
        it [m]; where the walker returned to the start the latter is about 0.
    percent
        Difference of the two as a part of the way [%].
    aligned_rmse_m
        Root mean square distance from the true places after the rotation and shift that make it
        least [m], or None with fewer than three true places.
    aligned_end_m
        The distance of the last of them, or None.
    """

    walked_m: float
    apart_m: float
    true_apart_m: float
    percent: float
    aligned_rmse_m: float | None
    aligned_end_m: float | None


def score_closure(truth: Places, points: Sequence[TrackPoint]) -> ClosureScore | None:
    """Score the only track against the only target.

    Returns
    -------
    The score, or None where there are several of either, or no way between true places.
    """
    if len({point.track for point in points}) != 1 or len(truth.names()) != 1:
        return None
    if len(np.unique(truth.time_ns)) < max(2, len(truth)):
        return None
    ordered = sorted(points, key=lambda point: point.time_ns)
    time_ns = np.array([point.time_ns for point in ordered], np.int64)
    places = np.array([(point.x_m, point.y_m) for point in ordered])
    # counted from one time, nanoseconds are exact in floating point
    at = (truth.time_ns - time_ns[0]).astype(np.float64)
    since = (time_ns - time_ns[0]).astype(np.float64)
    estimated = np.column_stack([np.interp(at, since, column) for column in places.T])
    between = places[(since > at[0]) & (since < at[-1])]
    walked = float(_lengths(np.concatenate([estimated[:1], between, estimated[-1:]])).sum())
    if walked == 0:
        return None
    apart, true_apart = (float(np.linalg.norm(xy[-1] - xy[0])) for xy in (estimated, truth.xy))
    off = aligned_distances(estimated, truth.xy) if len(truth) >= LEAST_PLACES else None
    return ClosureScore(
        walked_m=walked,
        apart_m=apart,
        true_apart_m=true_apart,
        percent=100 * abs(apart - true_apart) / walked,
        aligned_rmse_m=None if off is None else float(np.sqrt((off**2).mean())),
        aligned_end_m=None if off is None else float(off[-1]),
    )


def aligned_distances(
    estimated: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances after the best rotation and shift of ``estimated``, both (n, 2) [m]."""
    return _norms(turn_onto(estimated, truth)(estimated) - truth)


def _lengths(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return _norms(np.diff(places, axis=0))


def _norms(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """A rotation, shape (2, 2), and then a shift, shape (2,) [m]."""

    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]

    def __call__(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where places lie then, shape (n, 2) [m]."""
        return np.asarray(places @ self.rotation.T + self.shift)


def turn_onto(places: NDArray[np.float64], onto: NDArray[np.float64]) -> Turn:
    """Return the turn with the least squares of what is left between places, shape (n, 2) each."""
    centre, target = places.mean(axis=0), onto.mean(axis=0)
    (a, b), (c, d) = (places - centre).T @ (onto - target)
    angle = np.arctan2(b - c, a + d)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Turn(rotation, target - rotation @ centre)
