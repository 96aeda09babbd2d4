"""How many vehicles there are on a road, and which way they go: by the evidence of all stations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from .passes import smoothed
from .traffic_fit import Stretch, TrafficFit
from .traffic_model import DISTANCE, MOMENT, PEAK, SLOWNESS, Vehicle
from .traffic_scatter import Scatter, scatter_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .traffic_model import RoadPowers

    Array = NDArray[np.float64]

#: Vehicles whose ways along the stations come this near in time are fitted jointly [s]; so much
#: before and after them is looked at.
_BESIDE_S, _ABOUT_S = 1.5, 5.0
#: By so much the evidence must grow.
_MARGIN = 1.5
#: Steps of a first trial, of a full fit; how many trials are fitted fully.
_FIRST, _FULL, _BEST = 5, 25, 2
_CHANGES, _SWEEPS = 6, 2
#: Half of what two halves of a vehicle are apart [s], and what each has of its peak, ln.
_APART_S, _HALF = 0.4, 0.5
#: Excess of power is smoothed over so many cycles, and looked for this far from the ends [s].
_SMOOTH, _INSIDE_S = 5, 3.0
_TRIED_MPS = (6.0, 14.0)
#: Of a vehicle that stations hear at once [s/m].
_LEAST_SLOWNESS = 1 / 50


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """A vehicle that was found.

    Attributes
    ----------
    vehicle
        Its values.
    covariance
        Shape (4 + n, 4 + n), of them.
    together
        How many vehicles were fitted jointly, itself counted in.
    """

    vehicle: Vehicle
    covariance: Array
    together: int


def vehicles_on(observed: RoadPowers, start: Sequence[Vehicle]) -> tuple[Told, ...]:
    """Find the vehicles on a road, in order of time.

    Vehicles that are near in time are a group. In each group directions are turned, and vehicles
    added, split and taken away, while the evidence grows.

    Parameters
    ----------
    observed
        Powers of at least two stations.
    start
        Where to start; where there is none, none is found.
    """
    if not start or not observed.known.any():
        return ()
    scatter = Scatter()
    groups = _groups(observed, start)
    fits: list[tuple[Stretch, TrafficFit]] = []
    for sweep in range(_SWEEPS + 1):
        fits = []
        for number, group in enumerate(groups):
            others = [v for k, those in enumerate(groups) if k != number for v in those]
            stretch = _stretch(observed, group, others, scatter)
            fit = stretch.fit(group, _FULL)
            fit = _searched(stretch, fit) if sweep else fit
            groups[number] = fit.vehicles
            fits.append((stretch, fit))
        everyone = [v for group in groups for v in group]
        mean = _mean(observed, everyone, slice(None))
        scatter = scatter_of(observed.powers, observed.noise, observed.known, mean)
        if sweep < _SWEEPS:
            groups = _groups(observed, everyone)
    told = [one for _, fit in fits for one in _told(observed, fit)]
    return tuple(sorted(told, key=lambda one: float(one.vehicle.values[MOMENT])))


def _told(observed: RoadPowers, fit: TrafficFit) -> Iterator[Told]:
    size = len(observed.usual)
    if not fit.vehicles:
        return
    covariance = np.asarray(np.linalg.inv(fit.information), np.float64)
    for number, vehicle in enumerate(fit.vehicles):
        own = slice(number * size, (number + 1) * size)
        yield Told(vehicle, covariance[own, own], len(fit.vehicles))


def _groups(observed: RoadPowers, vehicles: Sequence[Vehicle]) -> list[tuple[Vehicle, ...]]:
    spans = [(observed.moments(v), v) for v in vehicles]
    spans.sort(key=lambda span: float(span[0].min()))
    groups: list[list[Vehicle]] = []
    last = -np.inf
    for moments, vehicle in spans:
        if moments.min() - last > 2 * _BESIDE_S:
            groups.append([])
        groups[-1].append(vehicle)
        last = max(last, float(moments.max()))
    return [tuple(group) for group in groups]


def _mean(observed: RoadPowers, vehicles: Sequence[Vehicle], rows: slice) -> Array:
    mean = observed.noise[rows].copy()
    for vehicle in vehicles:
        mean += observed.power(vehicle, rows)[0]
    return mean


def _stretch(
    observed: RoadPowers, group: Sequence[Vehicle], others: Sequence[Vehicle], scatter: Scatter
) -> Stretch:
    moments = np.concatenate([observed.moments(v) for v in group])
    edges = moments.min() - _ABOUT_S, moments.max() + _ABOUT_S
    rows = slice(*np.searchsorted(observed.times_s, edges).tolist())
    return Stretch(observed, rows, _mean(observed, others, rows), scatter)


def _searched(stretch: Stretch, fit: TrafficFit) -> TrafficFit:
    """Change the vehicles of a stretch while that makes the powers likelier."""
    for _ in range(_CHANGES):
        tried = [stretch.fit(those, _FIRST) for those in _changes(stretch, fit)]
        tried.sort(key=lambda one: -one.evidence)
        full = [stretch.fit(one.vehicles, _FULL) for one in tried[:_BEST]]
        best = max(full, key=lambda one: one.evidence, default=fit)
        if not best.evidence > fit.evidence + _MARGIN:
            break
        fit = best
    return fit


def _changes(stretch: Stretch, fit: TrafficFit) -> Iterator[tuple[Vehicle, ...]]:
    """Give what else there may be: others' directions, one less, one more."""
    vehicles = fit.vehicles
    several = range(len(vehicles))
    for turned in [*combinations(several, 1), *combinations(several, 2)]:
        yield tuple(_turned(v) if i in turned else v for i, v in enumerate(vehicles))
    for i, k in combinations(several, 2):
        rest = tuple(v for j, v in enumerate(vehicles) if j not in (i, k))
        yield (*rest, *_exchanged(stretch.observed, vehicles[i], vehicles[k]))
    for i in several:
        rest = (*vehicles[:i], *vehicles[i + 1 :])
        yield rest
        for signs in product((1, -1), repeat=2):
            yield (*rest, *_split(stretch, vehicles[i], signs))
    for more in _missing(stretch, fit):
        yield (*vehicles, more)


def _turned(vehicle: Vehicle) -> Vehicle:
    return replace(vehicle, direction=-vehicle.direction)


def _exchanged(observed: RoadPowers, one: Vehicle, other: Vehicle) -> Iterator[Vehicle]:
    """Give two vehicles with their passes at the last station exchanged."""
    first, last = int(observed.along_m.argmin()), int(observed.along_m.argmax())
    length = observed.centred_m[last] - observed.centred_m[first]
    for here, there in ((one, other), (other, one)):
        start = observed.moments(here)[first]
        slowness = (observed.moments(there)[last] - start) / length
        values = here.values.copy()
        values[MOMENT] = start - slowness * observed.centred_m[first]
        values[SLOWNESS] = np.log(max(abs(slowness), _LEAST_SLOWNESS))
        yield Vehicle(values, 1 if slowness > 0 else -1)


def _split(stretch: Stretch, vehicle: Vehicle, signs: tuple[int, ...]) -> Iterator[Vehicle]:
    usual = stretch.observed.usual
    for sign, late_s in zip(signs, (-_APART_S, _APART_S), strict=True):
        values = vehicle.values.copy()
        values[[SLOWNESS, DISTANCE]] = usual[[SLOWNESS, DISTANCE]]
        values[MOMENT] += late_s
        values[PEAK] -= _HALF
        yield Vehicle(values, sign)


def _missing(stretch: Stretch, fit: TrafficFit) -> Iterator[Vehicle]:
    """Give vehicles where the powers of a station exceed the fitted mean most."""
    observed, rows = stretch.observed, stretch.rows
    times, known = observed.times_s[rows], observed.known[rows]
    inside = (times >= times[0] + _INSIDE_S) & (times <= times[-1] - _INSIDE_S)
    if not inside.any():
        return
    excess = np.log(np.where(known, observed.powers[rows], fit.mean) / fit.mean)
    for station, along in enumerate(observed.centred_m):
        high = np.where(inside, smoothed(excess[:, station], _SMOOTH), -np.inf)
        cycle = int(high.argmax())
        more = fit.mean[cycle, station] * max(float(np.expm1(high[cycle])), 0.1)
        for speed, sign in product(_TRIED_MPS, (1, -1)):
            values = observed.usual.copy()
            values[:DISTANCE] = times[cycle] - sign * along / speed, -np.log(speed), np.log(more)
            yield Vehicle(values, sign)
