"""The analysis as one document: what ``groundtrace analyze room --json`` prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from .error_maps import SMALL_M

if TYPE_CHECKING:
    from .advice import Advice
    from .error_maps import ErrorMap
    from .room import RoomAnalysis


@dataclass(frozen=True, slots=True)
class SensorReport:
    """A sensor, and by how much the mean error rises without it [m]; None with three sensors."""

    name: str
    x_m: float
    y_m: float
    contribution_m: dict[str, float] | None


@dataclass(frozen=True, slots=True)
class ErrorReport:
    """Root mean square errors of a localizer over the room [m]."""

    localizer: str
    mean_m: float
    p95_m: float
    max_m: float
    worst_x_m: float
    worst_y_m: float
    below_1_m: float
    rmse_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SignReport:
    """Wrong signs: their mean number over the room, and the law at the worst place."""

    mean: float
    max: float
    x_m: float
    y_m: float
    variance_there: float
    most_of_95_percent: int


@dataclass(frozen=True, slots=True)
class RegionReport:
    """A region, the rival it is most like, and how often it is taken for one beyond neighbours."""

    x_m: float
    y_m: float
    area_m2: float
    rival: int | None
    rival_signs: int | None
    rival_m: float | None
    confusion: float | None
    ambiguous: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AdviceReport:
    """A change of the layout, and the mean errors without and with it [m]."""

    change: str
    sensor: str | None
    x_m: float
    y_m: float
    localizer: str
    before_m: dict[str, float]
    after_m: dict[str, float]
    better: bool
    places_tried: int


@dataclass(frozen=True, slots=True)
class RoomReport:
    """All that is known of a layout."""

    geometry: str
    sigma_s: float
    theta_s: float
    thickness_m: float | None
    area_m2: float
    lattice: int
    draws: int
    seed: int
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    sensors: tuple[SensorReport, ...]
    errors: tuple[ErrorReport, ...]
    pairs: int
    signs_physical: SignReport
    signs_independent: SignReport
    regions: tuple[RegionReport, ...]
    advice: tuple[AdviceReport, ...]
    remarks: tuple[str, ...]


def report(found: RoomAnalysis) -> RoomReport:
    """Return an analysis as a document; numbers of its arrays stand in the order of its nodes."""
    layout, how, signs = found.layout, found.settings, found.signs
    independent = (signs.independent, signs.variance_independent, signs.most_independent)
    x, y = (tuple(axis.tolist()) for axis in found.grid.nodes.T)
    return RoomReport(
        layout.name,
        layout.sigma_s,
        layout.theta_s,
        layout.thickness_m,
        float(shapely.area(layout.room)),
        how.lattice,
        how.draws,
        how.seed,
        x,
        y,
        _sensors(found),
        tuple(_errors(found, errors) for errors in found.errors),
        signs.pairs,
        _signs(found, signs.physical, signs.variance, signs.most),
        _signs(found, *independent),
        tuple(_region(found, i) for i in range(len(found.ambiguity.regions))),
        tuple(_advice(found, advice) for advice in found.advice),
        found.remarks,
    )


def _sensors(found: RoomAnalysis) -> tuple[SensorReport, ...]:
    spared = found.contributions or (None,) * len(found.layout.sensors)
    rows = zip(found.layout.sensors, found.layout.positions.tolist(), spared, strict=True)
    return tuple(SensorReport(name, x, y, without) for name, (x, y), without in rows)


def _errors(found: RoomAnalysis, errors: ErrorMap) -> ErrorReport:
    rmse = errors.rmse_m
    return ErrorReport(
        errors.method,
        errors.mean_m,
        float(np.quantile(rmse, 0.95)),
        float(rmse.max()),
        *found.worst(errors),
        float(np.mean(rmse < SMALL_M)),
        tuple(rmse.tolist()),
    )


def _signs(found: RoomAnalysis, mean: np.ndarray, variance: float, most: int) -> SignReport:
    x, y = found.sign_grid.nodes[mean.argmax()]
    return SignReport(float(mean.mean()), float(mean.max()), float(x), float(y), variance, most)


def _region(found: RoomAnalysis, index: int) -> RegionReport:
    a = found.ambiguity
    (x, y), rival = a.regions.centres[index], int(a.rival[index])
    confusion = float(a.confusion[index])
    return RegionReport(
        float(x),
        float(y),
        float(a.regions.areas[index]),
        rival if rival >= 0 else None,
        round(float(a.rival_signs[index])) if rival >= 0 else None,
        float(a.rival_m[index]) if rival >= 0 else None,
        confusion if np.isfinite(confusion) else None,
        a.reasons(index),
    )


def _advice(found: RoomAnalysis, advice: Advice) -> AdviceReport:
    moved = None if advice.moved is None else found.layout.sensors[advice.moved]
    return AdviceReport(
        "add" if moved is None else "move",
        moved,
        *advice.place,
        advice.method,
        advice.before_m,
        advice.after_m,
        advice.gain_m > 0,
        advice.tried,
    )
