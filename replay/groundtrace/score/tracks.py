"""Scoring of tracks against true places: OSPA and GOSPA over time, SIAP measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .assignment import distances
from .places import found_places, true_places
from .set_distances import gospa, ospa

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


def score_tracks(
    labels: Sequence[Label], points: Sequence[TrackPoint], tolerance_s: float = 0.12
) -> TrackScore | None:
    """Score the tracks of one stage.

    Places that truth has at the same time are those of several targets.

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
    )


def moments(truth: Places, points: Sequence[TrackPoint], tolerance_s: float) -> list[Moment]:
    """Compare tracks and targets at every true time."""
    ids = sorted({point.track for point in points})
    time_ns, first = np.unique(truth.time_ns, return_index=True)
    tracks = [_at([p for p in points if p.track == i], time_ns, tolerance_s) for i in ids]
    found = np.stack(tracks, axis=1)
    there = ~np.isnan(found[..., 0])
    targets = np.split(truth.xy, first[1:])
    return [
        _moment(int(t), xy, found[k, there[k]])
        for k, (t, xy) in enumerate(zip(time_ns, targets, strict=True))
    ]


def _at(
    points: Sequence[TrackPoint], time_ns: NDArray[np.int64], tolerance_s: float
) -> NDArray[np.float64]:
    """Return where a track is at times, straight between its points; NaN where it is not.

    Shape (n, 2).
    """
    known = found_places(sorted(points, key=lambda point: point.time_ns))
    # Counted from the first point, nanoseconds are exact in floating point.
    since = (time_ns - known.time_ns[0]).astype(np.float64)
    knots = (known.time_ns - known.time_ns[0]).astype(np.float64)
    after = np.clip(np.searchsorted(knots, since), 0, len(knots) - 1)
    before = np.maximum(np.where(knots[after] == since, after, after - 1), 0)
    near = np.minimum(np.abs(since - knots[before]), np.abs(since - knots[after]))
    between = (since >= knots[before]) & (since <= knots[after])
    held = between & (knots[after] - knots[before] <= HOLD_S * NS_PER_S)
    there = held | (near <= tolerance_s * NS_PER_S)
    places = np.column_stack([np.interp(since, knots, column) for column in known.xy.T])
    places[~there] = np.nan
    return places


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
