"""Scoring of tracks against true positions: OSPA and GOSPA over time, SIAP measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..dsp.assignment import assign, cheapest, distances
from .matching import STEP_TOLERANCE_S
from .positions import (
    ClosureScore,
    WaypointScore,
    found_places,
    match_places,
    score_closure,
    score_waypoints,
    true_places,
)
from .vehicles import VehicleTrackScore, score_ways

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Fix, Label, TrackPoint

    from .positions import Places

#: Cut-off [m] and order of OSPA and GOSPA; within the cut-off a track belongs to a target. Chosen
#: by judgement: people who walk apart keep more between them.
CUTOFF_M = 2.0
ORDER = 2.0
#: A track is there between two of its points if they are no further apart [s]. Chosen by judgement:
#: steps of a walk are nearer, pauses are longer.
HOLD_S = 2.0


@dataclass(frozen=True, slots=True)
class Moment:
    """Tracks and targets at one true time.

    Attributes
    ----------
    time_ns
        When.
    targets, tracks
        How many there are.
    covered, associated
        Targets with a track within the cut-off, and tracks with a target within it.
    apart_m
        Sum over the associated tracks of the distance to their target [m].
    ospa_m, gospa_m
        Distances of order 2 [m].
    localisation_m2, pairs
        Sum of the squared distances of the pairs that GOSPA makes, and their number.
    """

    time_ns: int
    targets: int
    tracks: int
    covered: int
    associated: int
    apart_m: float
    ospa_m: float
    gospa_m: float
    localisation_m2: float
    pairs: int


@dataclass(frozen=True, slots=True)
class TrackScore:
    """How well targets were tracked, at the times for which truth has places.

    Attributes
    ----------
    stage
        The stage scored: the last one that tracks.
    times, tracks
        How many true times, and how many tracks.
    ospa_m, gospa_m
        Means over time [m].
    localisation_rmse_m
        Root mean square distance of the pairs that GOSPA makes [m], or None without pairs.
    missed, false
        Targets without a track and tracks without a target, summed over time.
    completeness
        SIAP: part of the targets that have a track within the cut-off.
    ambiguity
        SIAP: tracks per target that has one; 1 is best.
    spuriousness
        SIAP: part of the tracks that have no target.
    accuracy_m
        SIAP: mean distance of the tracks from their targets [m], or None without any.
    cutoff_m, order
        Of OSPA and GOSPA.
    identity
        Which track was which target, or None where truth does not tell its targets apart.
    closure
        Length, end and shape of the track in a frame of its own, or None unless there is one
        track of one target.
    waypoints
        Distances from the waypoints that truth has, or None without two of one target.
    ways
        Errors across and along the ways of vehicles, or None where truth has none.
    """

    stage: str
    times: int
    tracks: int
    ospa_m: float
    gospa_m: float
    localisation_rmse_m: float | None
    missed: int
    false: int
    completeness: float
    ambiguity: float
    spuriousness: float
    accuracy_m: float | None
    cutoff_m: float
    order: float
    identity: IdentityScore | None
    closure: ClosureScore | None
    waypoints: WaypointScore | None
    ways: VehicleTrackScore | None = None


def score_tracks(
    labels: Sequence[Label], points: Sequence[TrackPoint], tolerance_s: float = STEP_TOLERANCE_S
) -> TrackScore | None:
    """Score the tracks of one stage.

    Places of other names, or that truth has at the same time, are those of several targets.

    Parameters
    ----------
    labels
        The truth.
    points
        Of one stage.
    tolerance_s
        How far before its first and after its last point a track still is [s].

    Returns
    -------
    The score, or None where there are no true places or no tracks.
    """
    truth = true_places(labels)
    if not len(truth) or not points:
        return None
    scored_moments = moments(truth, points, tolerance_s)
    targets, tracks = sum(m.targets for m in scored_moments), sum(m.tracks for m in scored_moments)
    covered, associated = (
        sum(m.covered for m in scored_moments),
        sum(m.associated for m in scored_moments),
    )
    pairs = sum(m.pairs for m in scored_moments)
    square = sum(m.localisation_m2 for m in scored_moments)
    return TrackScore(
        stage=points[-1].stage,
        times=len(scored_moments),
        tracks=len({point.track for point in points}),
        ospa_m=float(np.mean([m.ospa_m for m in scored_moments])),
        gospa_m=float(np.mean([m.gospa_m for m in scored_moments])),
        localisation_rmse_m=(square / pairs) ** 0.5 if pairs else None,
        missed=targets - pairs,
        false=tracks - pairs,
        completeness=covered / targets,
        ambiguity=associated / covered if covered else 1.0,
        spuriousness=(tracks - associated) / tracks if tracks else 0.0,
        accuracy_m=sum(m.apart_m for m in scored_moments) / associated if associated else None,
        cutoff_m=CUTOFF_M,
        order=ORDER,
        identity=_identity(truth, points, tolerance_s),
        closure=score_closure(truth, points),
        waypoints=score_waypoints(labels, points),
        ways=score_ways(labels, points),
    )


def _identity(
    truth: Places, points: Sequence[TrackPoint], tolerance_s: float
) -> IdentityScore | None:
    names = truth.names()
    if "" in names and (len(names) > 1 or len(np.unique(truth.time_ns)) < len(truth)):
        return None
    time_ns = np.unique(truth.time_ns)
    targets, tracks = presence(truth, points, time_ns, tolerance_s)
    if not any(names):
        targets = truth.xy[:, None]
    return score_identity(names, targets, numbers_of(points), tracks, CUTOFF_M)


def moments(truth: Places, points: Sequence[TrackPoint], tolerance_s: float) -> list[Moment]:
    """Compare tracks and targets at every true time.

    Targets that truth names are there between their true times as well, as tracks are; without
    names only places of the very same time are those of several targets.
    """
    time_ns = np.unique(truth.time_ns)
    targets, tracks = presence(truth, points, time_ns, tolerance_s)
    nameless = truth.of("")
    return [
        _moment(
            int(t),
            np.concatenate([nameless.xy[nameless.time_ns == t], _there(targets[k])]),
            _there(tracks[k]),
        )
        for k, t in enumerate(time_ns)
    ]


def presence(
    truth: Places, points: Sequence[TrackPoint], time_ns: NDArray[np.int64], tolerance_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where named targets and tracks are at times; NaN where they are not.

    Returns
    -------
    Shapes (n, n_named, 2) and (n, n_tracks, 2) [m], by name and by number.
    """
    ordered = sorted(points, key=lambda point: point.time_ns)
    named = [truth.of(name) for name in truth.names() if name]
    tracked = [
        found_places([p for p in ordered if p.track == number]) for number in numbers_of(points)
    ]
    targets, tracks = (
        np.array([one.at(time_ns, HOLD_S, tolerance_s) for one in each]).reshape(
            -1, len(time_ns), 2
        )
        for each in (named, tracked)
    )
    return targets.swapaxes(0, 1), tracks.swapaxes(0, 1)


def numbers_of(points: Sequence[TrackPoint]) -> list[int]:
    """Return the numbers of the tracks, in order."""
    return sorted({point.track for point in points})


def _there(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return places[~np.isnan(places[:, 0])]


def _moment(time_ns: int, targets: NDArray[np.float64], tracks: NDArray[np.float64]) -> Moment:
    apart = distances(targets, tracks)
    nearest = apart.min(axis=0) if len(tracks) else np.empty(0)
    mine = nearest <= CUTOFF_M
    covered = len(np.unique(apart.argmin(axis=0)[mine])) if len(tracks) else 0
    general = gospa(targets, tracks, CUTOFF_M, ORDER)
    return Moment(
        time_ns=time_ns,
        targets=len(targets),
        tracks=len(tracks),
        covered=covered,
        associated=int(mine.sum()),
        apart_m=float(nearest[mine].sum()),
        ospa_m=ospa(targets, tracks, CUTOFF_M, ORDER),
        gospa_m=general.distance,
        localisation_m2=general.localisation,
        pairs=general.pairs,
    )


@dataclass(frozen=True, slots=True)
class TargetScore:
    """How one target was tracked.

    Attributes
    ----------
    target
        Its name; empty where truth names none.
    times, covered
        How many times it was there, and at how many of them a track was matched to it.
    track
        The track that is its own when tracks are given to targets for good, or None.
    own
        Times at which that track was within the cut-off.
    switches
        How often another track than before was matched to it.
    rmse_m
        Root mean square distance of the tracks matched [m], or None without any.
    """

    target: str
    times: int
    covered: int
    track: int | None
    own: int
    switches: int
    rmse_m: float | None


@dataclass(frozen=True, slots=True)
class IdentityScore:
    """Whether tracks stay with their targets.

    Attributes
    ----------
    switches
        Sum over the targets.
    idf1
        With each target one track for good: twice the times at which they were together over the
        times of all targets and all tracks; 1 is best.
    targets
        Each of them, by name.
    """

    switches: int
    idf1: float
    targets: tuple[TargetScore, ...]


def score_identity(
    names: Sequence[str],
    targets: NDArray[np.float64],
    numbers: Sequence[int],
    tracks: NDArray[np.float64],
    cutoff_m: float,
) -> IdentityScore:
    """Say which track was which target.

    Parameters
    ----------
    names
        Of the m targets.
    targets
        Shape (n, m, 2): where they were [m]; NaN where they were not.
    numbers
        Of the k tracks.
    tracks
        Shape (n, k, 2) [m]; NaN where they were not.
    cutoff_m
        Largest distance of a target and its track [m].

    Notes
    -----
    Switches: K. Bernardin, R. Stiefelhagen: Evaluating multiple object tracking performance: the
    CLEAR MOT metrics, EURASIP Journal on Image and Video Processing (2008), section 2.1: a pair
    lasts while it keeps the cut-off, and only what is left over is matched anew. IDF1: E. Ristani
    et al.: Performance measures and a data set for multi-target, multi-camera tracking, ECCV
    workshops (2016), section 3.
    """
    apart = np.hypot(*np.moveaxis(targets[:, :, None] - tracks[:, None], -1, 0))
    owners = _owners(apart, cutoff_m)
    scores = []
    for i, name in enumerate(names):
        matched, distance = (x[:, i] for x in _matched(apart, cutoff_m))
        followed = matched[matched >= 0]
        column = owners.get(i)
        scores.append(
            TargetScore(
                target=name,
                times=int((~np.isnan(targets[:, i, 0])).sum()),
                covered=len(followed),
                track=None if column is None else numbers[column],
                own=0 if column is None else int((apart[:, i, column] <= cutoff_m).sum()),
                switches=int(np.count_nonzero(np.diff(followed))),
                rmse_m=float(np.sqrt(np.nanmean(distance**2))) if len(followed) else None,
            )
        )
    there = int((~np.isnan(targets[..., 0])).sum() + (~np.isnan(tracks[..., 0])).sum())
    together = 2 * sum(each.own for each in scores) / there if there else 0.0
    return IdentityScore(sum(each.switches for each in scores), together, tuple(scores))


def _owners(apart: NDArray[np.float64], cutoff_m: float) -> dict[int, int]:
    """Give targets one track each so that they are together most often, by index."""
    together = (apart <= cutoff_m).sum(axis=0, dtype=np.float64)
    rows, columns = cheapest(-together)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return {row: column for row, column in pairs if together[row, column]}


def _matched(
    apart: NDArray[np.float64], cutoff_m: float
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Match tracks to targets time by time, shape (n, m): index or -1, and distance or NaN."""
    n, m, _ = apart.shape
    matched, distance = np.full((n, m), -1, np.intp), np.full((n, m), np.nan)
    last: dict[int, int] = {}
    for k, cost in enumerate(apart):
        continued = {i: j for i, j in last.items() if cost[i, j] <= cutoff_m}
        left = cost.copy()
        left[list(continued)] = np.inf
        left[:, list(continued.values())] = np.inf
        new = {int(i): int(j) for i, j in assign(left, cutoff_m)}
        # a target remembers its track while it has none, unless another has taken that track
        last = {i: j for i, j in last.items() if j not in new.values()} | continued | new
        for i, j in (continued | new).items():
            matched[k, i], distance[k, i] = j, cost[i, j]
    return matched, distance


@dataclass(frozen=True, slots=True)
class Gospa:
    """A GOSPA distance and its parts.

    Attributes
    ----------
    distance
        Root of order p of the sum of the parts [m].
    localisation, missed, false
        The parts, to the power p [m^p]. For alpha other than 2 a pair further apart than c counts
        in ``localisation``, and only the surplus of one set is missed or false.
    pairs
        How many places are assigned to each other.
    """

    distance: float
    localisation: float
    missed: float
    false: float
    pairs: int


def ospa(x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float) -> float:
    """Return the optimal sub-pattern assignment distance [m].

    Parameters
    ----------
    x, y
        Places [m], shapes (n, 2) and (m, 2).
    c, p
        Cut-off [m] and order.

    Notes
    -----
    D. Schuhmacher, B.-T. Vo, B.-N. Vo: A consistent metric for performance evaluation of
    multi-object filters, IEEE Transactions on Signal Processing 56 (2008), equation (3).
    """
    largest = max(len(x), len(y))
    if not largest:
        return 0.0
    surplus = c**p * abs(len(x) - len(y))
    return float(((_least_costs(x, y, c, p).sum() + surplus) / largest) ** (1 / p))


def gospa(
    x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float, alpha: float = 2.0
) -> Gospa:
    """Return the generalised OSPA distance and its parts.

    Parameters
    ----------
    x, y
        True and estimated places [m], shapes (n, 2) and (m, 2).
    c, p, alpha
        Cut-off [m], order, and weight of what is left over, 0 < alpha <= 2.

    Notes
    -----
    A. S. Rahmathullah, A. F. Garcia-Fernandez, L. Svensson: Generalized optimal sub-pattern
    assignment metric, FUSION 2017, definition 1 and, for alpha = 2, proposition 1.
    """
    costs = _least_costs(x, y, c, p)
    near = costs < c**p
    # With alpha = 2 a pair at the cut-off costs just what leaving both alone does.
    alone = int((~near).sum()) if alpha == 2 else 0
    pairs = len(costs) - alone
    localisation = float(costs[near].sum() if alpha == 2 else costs.sum())
    unit = c**p / alpha
    missed, false = unit * (len(x) - pairs), unit * (len(y) - pairs)
    return Gospa((localisation + missed + false) ** (1 / p), localisation, missed, false, pairs)


def _least_costs(
    x: NDArray[np.float64], y: NDArray[np.float64], c: float, p: float
) -> NDArray[np.float64]:
    """Return the costs min(d, c)^p of the cheapest assignment of the smaller set."""
    if not len(x) or not len(y):
        return np.empty(0)
    cost = np.minimum(distances(x, y), c) ** p
    rows, columns = cheapest(cost)
    return np.asarray(cost[rows, columns], np.float64)


#: Of the bounds of consistency. Chosen by judgement: the usual one.
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Consistency:
    """Mean of normalised squares and the bounds it should keep.

    Attributes
    ----------
    n, dof
        How many squares, and their degrees of freedom each.
    mean
        Should be near ``dof``; above: the stage is too sure of itself, below: not enough.
    lower, upper
        Bounds of the mean of independent squares at 95 %. Errors of one track depend on each
        other, so that its NEES strays further than that; NIS should not.
    consistent
        Whether the mean keeps its bounds.
    inside_fraction
        Part of the single squares below their own 95 % bound; should be near 0.95.
    """

    n: int
    dof: int
    mean: float
    lower: float
    upper: float
    consistent: bool
    inside_fraction: float


@dataclass(frozen=True, slots=True)
class ConsistencyScore:
    """Consistency by what it is of; None where covariances or innovations are unknown.

    Attributes
    ----------
    nees_fixes, nees_tracks
        Normalised estimation error squared of the places of fixes and of track points.
    nis
        Normalised innovation squared, as the tracker gives it.
    """

    nees_fixes: Consistency | None
    nees_tracks: Consistency | None
    nis: Consistency | None


def normalised_squares(
    vectors: NDArray[np.float64], covariances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return e' P^-1 e for each vector: NEES of errors, NIS of innovations.

    Parameters
    ----------
    vectors
        Shape (n, d).
    covariances
        Shape (n, d, d).

    Returns
    -------
    Shape (n,); NaN where a covariance is unknown or not positive definite.

    Notes
    -----
    Y. Bar-Shalom, X.-R. Li, T. Kirubarajan: Estimation with Applications to Tracking and
    Navigation (2001), equations (5.4.2-1) and (5.4.2-3).
    """
    out = np.full(len(vectors), np.nan)
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(vectors).all(axis=1)
    valid = np.flatnonzero(finite)
    valid = valid[np.linalg.eigvalsh(covariances[valid])[:, 0] > 0]
    solved = np.linalg.solve(covariances[valid], vectors[valid][..., None])[..., 0]
    out[valid] = np.einsum("nd,nd->n", vectors[valid], solved)
    return out


def consistency(squares: NDArray[np.float64], dof: int) -> Consistency | None:
    """Compare normalised squares, NaN left out, to the chi-square law; None of none."""
    from scipy.special import gammaincinv  # scipy.stats has the quantile, but takes long to load

    def quantile(part: float, freedom: int) -> float:
        return 2 * float(gammaincinv(freedom / 2, part))

    valid = squares[~np.isnan(squares)]
    n = len(valid)
    if not n:
        return None
    tail = (1 - CONFIDENCE) / 2
    lower, upper = (quantile(q, n * dof) / n for q in (tail, 1 - tail))
    mean = float(valid.mean())
    inside = float(np.mean(valid <= quantile(CONFIDENCE, dof)))
    return Consistency(n, dof, mean, lower, upper, lower <= mean <= upper, inside)


def score_consistency(
    labels: Sequence[Label],
    fixes: Sequence[Fix],
    points: Sequence[TrackPoint],
    tolerance_s: float = STEP_TOLERANCE_S,
    filtered: Sequence[TrackPoint] | None = None,
) -> ConsistencyScore | None:
    """Compare the errors of places to their covariances, each of one stage.

    Parameters
    ----------
    labels
        The truth.
    fixes, points
        Whose places and covariances are compared.
    tolerance_s
        Within which a place answers a true one [s].
    filtered
        Points whose innovations are looked at; None: those of ``points``.

    Returns
    -------
    The score, or None where neither covariances with truth nor innovations are known.
    """
    nis = np.array([x.nis for x in (points if filtered is None else filtered)], np.float64)
    score = ConsistencyScore(
        nees_fixes=consistency(place_squares(labels, fixes, tolerance_s), 2),
        nees_tracks=consistency(place_squares(labels, points, tolerance_s), 2),
        nis=consistency(nis, 2),
    )
    return None if score == ConsistencyScore(None, None, None) else score


def place_squares(
    labels: Sequence[Label], events: Sequence[Fix | TrackPoint], tolerance_s: float
) -> NDArray[np.float64]:
    """Return the NEES of the places that answer a true one, in order of time."""
    truth = true_places(labels)
    if not len(truth) or not events:
        return np.empty(0)
    ordered = sorted(events, key=lambda event: event.time_ns)
    estimated = found_places(ordered)
    pairs = match_places(truth, estimated, tolerance_s)
    spread = np.array([ordered[j].covariance for j in pairs[:, 1]], np.float64).reshape(-1, 3)
    covariances = spread[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return normalised_squares(estimated.xy[pairs[:, 1]] - truth.xy[pairs[:, 0]], covariances)
