"""Scoring of vehicles: passes of stations, and tracks along the road."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.events import has_vehicles
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.assignment import assign
from .positions import HOLD_S, ignored, true_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label, Pass, TrackPoint

    from .positions import Places

    Array = NDArray[np.float64]

#: A pass that is told further than this from the true one does not answer it [s]. Chosen by
#: judgement: a vehicle at 10 m/s is 10 m on, and the next is seconds away.
PASS_TOLERANCE_S = 1.0


@dataclass(frozen=True, slots=True)
class VehiclePass:
    """How one vehicle was told.

    Attributes
    ----------
    target
        The vehicle's name.
    truth, found
        Stations that it passed, and those at which that was found.
    vehicle
        Number of the vehicle that most of the found passes were told to be; 0 where none.
    together
        Of the found passes those of that number.
    direction_right
        Whether the direction is; None where none was told.
    speed_mps, speed_error_mps
        True mean speed, and found less true [m/s]; None where none was told.
    """

    target: str
    truth: int
    found: int
    vehicle: int
    together: int
    direction_right: bool | None
    speed_mps: float
    speed_error_mps: float | None


@dataclass(frozen=True, slots=True)
class PassScore:
    """How well passes at stations were found.

    Attributes
    ----------
    stage
        The stage scored: the last one that gives passes.
    truth, found, matched
        Passes at stations.
    tolerance_s
        Largest distance of a match [s].
    median_abs_s, bias_s
        Of found less true times [s]; None without a match.
    order_right
        Whether the matched passes of all stations came in the true order, those that truth has
        within the tolerance of one another apart.
    vehicles_right
        Vehicles of which every found pass is told to be of one vehicle and the direction is right.
    speed_median_percent
        Median of the absolute errors of speed [%]; None where none was told.
    vehicles
        Each by itself.
    """

    stage: str
    truth: int
    found: int
    matched: int
    tolerance_s: float
    median_abs_s: float | None
    bias_s: float | None
    order_right: bool
    vehicles_right: int
    speed_median_percent: float | None
    vehicles: list[VehiclePass]


def score_passes(
    labels: Sequence[Label], passes: Sequence[Pass], *, told_by: str = ""
) -> PassScore | None:
    """Score the passes of one stage against ``pass`` labels.

    Passes are matched station by station, one to one and nearest in time; of two that are as near
    that of the right direction answers.

    Parameters
    ----------
    labels
        The truth.
    passes
        Of one stage.
    told_by
        The stage that would have found some; empty where there is none.

    Returns
    -------
    The score, or None where the truth has no passes, or there is no stage.
    """
    truth, detected = scored_passes(labels, passes)
    if not truth or not (passes or told_by):
        return None
    pairs = match_passes(truth, detected)
    errors = np.array([(b.time_ns - a.time_ns) / NS_PER_S for a, b in pairs])
    vehicles = [_vehicle(target, truth, pairs) for target in dict.fromkeys(x.target for x in truth)]
    off = [
        100 * abs(v.speed_error_mps) / v.speed_mps
        for v in vehicles
        if v.speed_error_mps is not None
    ]
    return PassScore(
        stage=passes[-1].stage if passes else told_by,
        truth=len(truth),
        found=len(detected),
        matched=len(pairs),
        tolerance_s=PASS_TOLERANCE_S,
        median_abs_s=float(np.median(np.abs(errors))) if len(errors) else None,
        bias_s=float(np.median(errors)) if len(errors) else None,
        order_right=_in_order(pairs),
        vehicles_right=sum(_is_right(v) for v in vehicles),
        speed_median_percent=float(np.median(off)) if off else None,
        vehicles=vehicles,
    )


def scored_passes(
    labels: Sequence[Label], passes: Sequence[Pass]
) -> tuple[list[Label], list[Pass]]:
    """Return true passes in the order of time, and found ones, outside of what is ignored."""
    scored = [x for x, no in zip(labels, _ignored(labels, labels), strict=True) if not no]
    truth = sorted((x for x in scored if x.kind == "pass"), key=lambda x: x.time_ns)
    detected = [p for p, no in zip(passes, _ignored(labels, passes), strict=True) if not no]
    return truth, detected


def match_passes(truth: Sequence[Label], detected: Sequence[Pass]) -> list[tuple[Label, Pass]]:
    """Return which found pass answers which true one, in the order of truth."""
    pairs: list[tuple[Label, Pass]] = []
    for station in dict.fromkeys(x.channel for x in truth):
        true = [x for x in truth if x.channel == station]
        station_passes = [p for p in detected if p.station == station]
        if not station_passes:
            continue
        late = np.abs(
            np.array([[(p.time_ns - x.time_ns) / NS_PER_S for p in station_passes] for x in true])
        )
        wrong = np.array(
            [[bool(p.direction) and p.direction != x.label for p in station_passes] for x in true]
        )
        cost = np.where(late <= PASS_TOLERANCE_S, late + 0.1 * wrong, np.inf)
        pairs += [(true[i], station_passes[j]) for i, j in assign(cost, np.inf).tolist()]
    return sorted(pairs, key=lambda pair: (pair[0].time_ns, pair[0].channel))


def _ignored(labels: Sequence[Label], items: Sequence[Label] | Sequence[Pass]) -> list[bool]:
    flags: list[bool] = ignored(labels, np.array([x.time_ns for x in items], np.int64)).tolist()
    return flags


def _vehicle(
    target: str, truth: Sequence[Label], pairs: Sequence[tuple[Label, Pass]]
) -> VehiclePass:
    mine = [x for x in truth if x.target == target]
    matched = [p for x, p in pairs if x.target == target]
    numbers = Counter(p.vehicle for p in matched if p.vehicle)
    number, together = numbers.most_common(1)[0] if numbers else (0, 0)
    its = [p for p in matched if p.vehicle == number and number]
    speed = float(np.mean([x.value for x in mine if x.value is not None] or [np.nan]))
    return VehiclePass(
        target=target,
        truth=len(mine),
        found=len(matched),
        vehicle=number,
        together=together,
        direction_right=its[0].direction == mine[0].label if its else None,
        speed_mps=speed,
        speed_error_mps=float(its[0].speed_mps - speed) if its else None,
    )


def _is_right(v: VehiclePass) -> bool:
    return v.direction_right is True and v.together == v.found


def _in_order(pairs: Sequence[tuple[Label, Pass]]) -> bool:
    """Return whether found times increase with true ones that are clearly apart."""
    apart_ns = PASS_TOLERANCE_S * NS_PER_S
    return all(
        b.time_ns > a.time_ns
        for x, a in pairs
        for y, b in pairs
        if y.time_ns - x.time_ns > apart_ns
    )


@dataclass(frozen=True, slots=True)
class VehicleTrackScore:
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


def score_ways(labels: Sequence[Label], points: Sequence[TrackPoint]) -> VehicleTrackScore | None:
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
    return VehicleTrackScore(
        n=len(errors),
        across_median_m=float(np.median(across)),
        across_p90_m=float(np.percentile(across, 90)),
        along_median_m=float(np.median(along)),
        speed_median_mps=float(np.median(speed)),
    )


def _errors(point: TrackPoint, ways: Sequence[Places]) -> tuple[float, float, float] | None:
    """Return errors across, along and of speed against the nearest vehicle; None without any."""
    about = np.array([0, -NS_PER_S // 4, NS_PER_S // 4], np.int64) + point.time_ns
    position = np.array([point.x_m, point.y_m])
    best: tuple[float, float, float] | None = None
    nearest = np.inf
    for way in ways:
        here, before, after = way.at(about, HOLD_S, 0.0)
        motion = after - before
        length = float(np.hypot(*motion))
        off = position - here
        if not np.isfinite(length) or length == 0 or np.hypot(*off) >= nearest:
            continue
        nearest = float(np.hypot(*off))
        ahead = motion / length
        speed = abs(float(np.hypot(point.vx_mps, point.vy_mps)) - 2 * length)
        across = abs(float(off[1] * ahead[0] - off[0] * ahead[1]))
        best = across, float(off @ ahead), speed
    return best
