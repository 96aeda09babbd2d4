"""The floor and the clocks that the arrivals of a recording tell, with how sure that is.

A value is identifiable where its covariance is finite and small; what is not is left as it was,
and said. The spread over robust losses and a bootstrap over impacts stand beside the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import PipelineError, RecordingError
from ..explain.swaps import swap_notes
from ..localizers.floor import EXPONENT
from ..localizers.hyperbolic import calibrated_velocity
from ..localizers.joint_fit import LOSSES, Free, Impacts, fit
from ..localizers.joint_start import bounds_of, known_start, start
from .places import PlaceErrors, place_errors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from ..localizers.joint_fit import JointFit, Loss
    from .arrivals import Gathered

    Array = NDArray[np.float64]

#: Fewest impacts to calibrate with; an unknown place needs an arrival more than its unknowns.
LEAST_IMPACTS, TELLING, LEAST_KNOWN = 6, 4, 3
#: Deviations above which nothing is said to be known: of log k at the reference, of the exponent.
PACE_LIMIT, EXPONENT_LIMIT = 0.25, 0.12
#: Samples of the bootstrap, and its seed.
SAMPLES, SEED = 50, 0


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value, its standard deviation, and whether it is identifiable.

    The deviation is the larger of that over bootstrapped impacts and that of the covariance; of a
    value that is not identifiable, and so kept, it is NaN.
    """

    value: float
    deviation: float
    identifiable: bool


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """How far the clock of a channel is ahead, and the deviation as of an estimate [s]."""

    channel: str
    offset_s: float
    deviation_s: float


@dataclass(frozen=True, slots=True)
class LossFigures:
    """What one robust loss makes of the same arrivals."""

    loss: str
    scale: float
    exponent: float
    sigma_s: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """What the arrivals tell.

    Attributes
    ----------
    impacts, sensors, arrivals
        How many were used.
    known_places
        Whether the places of the impacts were known.
    unit
        Of lengths: ``m`` or ``units``.
    scale, exponent
        k [s/unit^p] and p of t = t0 + k d^p.
    reference, pace_s
        A distance typical of the layout [unit], and how long a wave takes over it [s].
    velocity
        For hyperbolas [unit/s]; None where the scale is not identifiable.
    arrival_sigma_s
        Standard deviation of an arrival, robust [s].
    offsets_estimated
        Whether the clocks differ by more than chance; else the offsets are 0.
    offsets
        Of each channel; their sum is 0.
    losses
        The same by other robust losses.
    positions
        Errors of the places before and after; None where no truth is known.
    notes
        What could not be told, and what was done then.
    """

    impacts: int
    sensors: int
    arrivals: int
    known_places: bool
    unit: str
    scale: Estimate
    exponent: Estimate
    reference: float
    pace_s: float
    velocity: float | None
    arrival_sigma_s: float
    offsets_estimated: bool
    offsets: tuple[ClockOffset, ...]
    losses: tuple[LossFigures, ...]
    positions: PlaceErrors | None
    notes: tuple[str, ...]


def calibrate(
    gathered: Gathered,
    geometry: Geometry,
    *,
    ignore_places: bool = False,
    offsets: str = "auto",
    exponent: float = EXPONENT,
) -> Calibration:
    """Estimate scale, exponent, velocity, clock offsets and the error of arrivals.

    Parameters
    ----------
    gathered
        The arrivals.
    geometry
        Outline and unit of the site.
    ignore_places
        Take no notice of known places of impacts.
    offsets
        ``yes`` and ``no`` say whether the clocks may differ, ``auto`` lets the arrivals say it.
    exponent
        Kept where the arrivals do not tell it.

    Raises
    ------
    RecordingError
        Where there are too few impacts with enough arrivals.
    """
    impacts = _impacts(gathered, geometry, ignore_places=ignore_places)
    outline = np.array(geometry.outline, np.float64).reshape(-1, 2)
    room = outline if len(outline) else None
    base, notes = _clocks(impacts, room, offsets, exponent)
    best, told = _exponent(impacts, base)
    notes += told
    again = _bootstrap(impacts, best)
    pace_known = best.deviations[0] <= PACE_LIMIT
    notes += [] if pace_known else [_unknown_scale(best)]
    right_s = impacts.times_s - best.floor.offsets_s
    notes += swap_notes(gathered.channels, impacts.positions, right_s, best.places)
    free = best.free
    velocity = _velocity(impacts, best) if pace_known else None
    spread = np.maximum(again.std(axis=0), _deviations(best))
    if not free.exponent:
        spread[1] = np.nan
    return Calibration(
        impacts=len(impacts.times_s),
        sensors=len(impacts.positions),
        arrivals=int(np.isfinite(impacts.times_s).sum()),
        known_places=impacts.known is not None,
        unit=geometry.length_unit,
        scale=Estimate(best.floor.scale, float(spread[0]), bool(pace_known)),
        exponent=Estimate(best.floor.exponent, float(spread[1]), free.exponent),
        reference=best.floor.reference_m,
        pace_s=best.floor.pace_s,
        velocity=velocity,
        arrival_sigma_s=best.sigma_s,
        offsets_estimated=free.offsets,
        offsets=_clock_offsets(gathered.channels, best, spread[2:]),
        losses=tuple(_by_loss(impacts, best, loss) for loss in LOSSES),
        positions=place_errors(gathered, best, room),
        notes=tuple(notes),
    )


def _unknown_scale(best: JointFit) -> str:
    """Say that and why the scale is not told."""
    return (
        f"scale: not identifiable from these impacts and sensors (deviation "
        f"{best.deviations[0]:.0%} of itself, {PACE_LIMIT:.0%} allowed)"
    )


def _clock_offsets(
    channels: Sequence[str], best: JointFit, deviations: Array
) -> tuple[ClockOffset, ...]:
    """Return each channel's clock offset with its deviation."""
    found = zip(channels, best.floor.offsets_s, deviations, strict=True)
    return tuple(ClockOffset(name, float(value), float(sigma)) for name, value, sigma in found)


def _impacts(gathered: Gathered, geometry: Geometry, *, ignore_places: bool) -> Impacts:
    """Return the impacts that tell something; those of known places alone where they suffice."""
    picks = np.isfinite(gathered.times_s).sum(axis=1)
    outline = np.array(geometry.outline, np.float64).reshape(-1, 2)
    bounds = bounds_of(gathered.positions, outline if len(outline) else None)
    placed = np.isfinite(gathered.known).all(axis=1) & (picks >= 2)
    if not ignore_places and placed.sum() >= LEAST_KNOWN:
        return Impacts(gathered.positions, gathered.times_s[placed], bounds, gathered.known[placed])
    enough = picks >= TELLING
    if enough.sum() < LEAST_IMPACTS:
        raise RecordingError(
            f"calibrate: expected {LEAST_IMPACTS} or more impacts with {TELLING} or more "
            f"arrivals (or {LEAST_KNOWN} of known places), found {int(enough.sum())}"
        )
    return Impacts(gathered.positions, gathered.times_s[enough], bounds)


def _clocks(
    impacts: Impacts, room: Array | None, offsets: str, exponent: float
) -> tuple[JointFit, list[str]]:
    """Return the fit with equal clocks, or with offsets where they explain far more."""

    def begun(*, clocks: bool) -> JointFit:
        if impacts.known is not None:
            return known_start(impacts, offsets=clocks, exponent=exponent)
        return start(impacts, room, offsets=clocks, exponent=exponent)

    together = begun(clocks=False)
    spare = impacts.times_s.size - impacts.owned * len(impacts.times_s) - len(impacts.positions)
    if offsets == "no":
        return together, []
    if spare < len(impacts.positions):
        return together, ["offsets: not identifiable from so few impacts: taken as 0"]
    apart = begun(clocks=True)
    count, sensors = np.isfinite(impacts.times_s).sum(), len(impacts.positions)
    # the criterion of Bayes and Schwarz for n - 1 unknowns more
    gain = count * 2 * np.log(together.sigma_s / apart.sigma_s) - (sensors - 1) * np.log(count)
    largest = np.abs(apart.floor.offsets_s).max()
    if offsets == "auto" and not (gain > 0 and largest > 2 * apart.sigma_s):
        return together, []
    if not np.all(apart.deviations[2:] < largest):
        return together, ["offsets: not identifiable from these impacts: taken as 0"]
    return apart, []


def _exponent(impacts: Impacts, base: JointFit) -> tuple[JointFit, list[str]]:
    """Return the fit with the exponent free where the arrivals tell it, else with it kept."""
    free = Free(exponent=True, offsets=base.free.offsets)
    found = fit(impacts, base.floor, base.places, free=free)
    deviation = found.deviations[1]
    if deviation <= EXPONENT_LIMIT and 0.5 < found.floor.exponent < 2:
        return found, []
    return base, [
        f"exponent: not identifiable from these distances (deviation {deviation:.2g}, "
        f"{EXPONENT_LIMIT} allowed): kept at {base.floor.exponent:.4g}"
    ]


def _bootstrap(impacts: Impacts, best: JointFit) -> Array:
    """Return scale, exponent and offsets of impacts drawn again, shape (SAMPLES, 2 + n)."""
    rng = np.random.default_rng(SEED)
    out = []
    for _ in range(SAMPLES):
        rows = rng.integers(0, len(impacts.times_s), len(impacts.times_s))
        floor = fit(
            impacts.rows(rows), best.floor, best.places[rows], free=best.free, rounds=4
        ).floor
        out.append([floor.scale, floor.exponent, *floor.offsets_s])
    return np.array(out)


def _deviations(best: JointFit) -> Array:
    """Return the deviations of scale, exponent and offsets by the covariance, shape (2 + n,)."""
    out = best.deviations
    # k = pace / reference^p
    slope = np.array([1.0, -np.log(best.floor.reference_m)])
    shared = best.covariance[:2, :2]
    known = np.isfinite(shared).all()
    out[0] = best.floor.scale * (np.sqrt(max(slope @ shared @ slope, 0)) if known else np.inf)
    return out


def _velocity(impacts: Impacts, best: JointFit) -> float | None:
    """Return the velocity for hyperbolas, by the places found and the arrivals that fit them."""
    kept = np.abs(np.nan_to_num(best.residuals_s)) <= 3 * best.sigma_s
    times = np.where(kept, impacts.times_s - best.floor.offsets_s, np.nan)
    telling = np.isfinite(times).sum(axis=1) >= 2
    try:
        return calibrated_velocity(best.places[telling], impacts.positions, times[telling])
    except PipelineError:
        return None


def _by_loss(impacts: Impacts, best: JointFit, loss: Loss) -> LossFigures:
    found = fit(impacts, best.floor, best.places, loss=loss, free=best.free)
    return LossFigures(loss, found.floor.scale, found.floor.exponent, found.sigma_s)
