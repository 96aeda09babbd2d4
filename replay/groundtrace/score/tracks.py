"""Scoring of tracks against true places: OSPA and GOSPA over time, SIAP measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .assignment import distances
from .closure import ClosureScore, score_closure
from .identity import IdentityScore, score_identity
from .places import found_places, true_places
from .set_distances import gospa, ospa
from .waypoints import WaypointScore, score_waypoints
from .ways import WayScore, score_ways

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import TrackPoint
    from groundtrace_codecs.labels import Label

    from .places import Places

#: Cut-off [m] and order of OSPA and GOSPA; within the cut-off a track belongs to a target.
CUTOFF_M = 2.0
ORDER = 2.0
#: A track is there between two of its points if they are no further apart [s].
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
    ways: WayScore | None = None


def score_tracks(
    labels: Sequence[Label], points: Sequence[TrackPoint], tolerance_s: float = 0.12
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
    found = moments(truth, points, tolerance_s)
    targets, tracks = sum(m.targets for m in found), sum(m.tracks for m in found)
    covered, associated = sum(m.covered for m in found), sum(m.associated for m in found)
    pairs = sum(m.pairs for m in found)
    square = sum(m.localisation_m2 for m in found)
    return TrackScore(
        stage=points[-1].stage,
        times=len(found),
        tracks=len({point.track for point in points}),
        ospa_m=float(np.mean([m.ospa_m for m in found])),
        gospa_m=float(np.mean([m.gospa_m for m in found])),
        localisation_rmse_m=(square / pairs) ** 0.5 if pairs else None,
        missed=targets - pairs,
        false=tracks - pairs,
        completeness=covered / targets,
        ambiguity=associated / covered if covered else 1.0,
        spuriousness=(tracks - associated) / tracks if tracks else 0.0,
        accuracy_m=sum(m.apart_m for m in found) / associated if associated else None,
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
    found = [
        found_places([p for p in ordered if p.track == number]) for number in numbers_of(points)
    ]
    targets, tracks = (
        np.array([one.at(time_ns, HOLD_S, tolerance_s) for one in each]).reshape(
            -1, len(time_ns), 2
        )
        for each in (named, found)
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
