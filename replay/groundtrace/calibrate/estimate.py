"""The floor and the clocks that the arrivals of a recording tell, with how sure that is.

A value is identifiable where its covariance is finite and small; what is not is left as it was,
and said. The spread over robust losses and a bootstrap over impacts stand beside the covariance.

Clocks are told by known places alone, and only where impacts at places that were left out are
likelier with offsets than without, while both may take any smooth law of distance: without known
places, or under a wave law of another shape, offsets fit what no clock has done.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import PipelineError, RecordingError
from ..explain.swaps import swap_notes
from ..localizers.arrival_fit import distances
from ..localizers.floor import EXPONENT, reference_distance
from ..localizers.hyperbolic import calibrated_velocity
from ..localizers.joint_fit import LEAST_SIGMA_S, LOSSES, WEIGHTS, Free, Impacts, fit
from ..localizers.joint_start import bounds_of, known_start, start
from ..localizers.power_law import HUBER
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
#: Clocks are identifiable where the log likelihood of held-out places is higher with them by more
#: than so much, and by more than its standard error; and the largest is so many deviations of an
#: arrival. Chosen and reported on simulated arrivals (bench/place_causes.py): of 480 recordings
#: without offsets none passes (10 of 960 the first two), of 960 with 2 and 3 ms all do.
LEAST_GAIN, LEAST_SIGMAS = 2.0, 2.0
#: Places are held out in so many turns; there are at least as many. Impacts nearer to each other
#: than this part of the layout's reference are repeats at one place.
FOLDS, SAME_PART = 10, 0.05
#: Powers of distance that make any smooth law, and passes of reweighting.
LAW, PASSES = (1, 2, 3), 8
#: What is said where no offsets are written.
NO_OFFSETS = "clock offsets are not identifiable from this recording: none written"


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
class HeldOut:
    """Whether clock offsets explain impacts at places that were left out of the fit.

    Attributes
    ----------
    places
        How many; repeats at one count once.
    gain, error
        By how much their log likelihood is higher with offsets, and its standard error over places.
    offsets_s
        Shape (n,): the offsets by all places, under any smooth law of distance [s].
    sigma_s
        Standard deviation of an arrival with them [s].
    """

    places: int
    gain: float
    error: float
    offsets_s: Array
    sigma_s: float

    @property
    def identifiable(self) -> bool:
        """Whether the offsets are shown to be more than chance, and more than arrivals err."""
        large = np.abs(self.offsets_s).max() > LEAST_SIGMAS * self.sigma_s
        return bool(large and self.gain > max(LEAST_GAIN, self.error))


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
        Whether the clocks' offsets are identifiable; else none are told, and those of the geometry
        stand.
    held_out_gain, held_out_error
        By how much the log likelihood of held-out places is higher with offsets, and its standard
        error; None where no place is known, or too few are.
    offsets
        Of each channel; their sum is 0. Empty where they are not identifiable.
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
    held_out_gain: float | None
    held_out_error: float | None
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
        ``no`` takes the clocks of the geometry; ``auto`` and ``yes`` estimate them where they are
        identifiable, and ``yes`` is an error where they are not.
    exponent
        Kept where the arrivals do not tell it.

    Raises
    ------
    RecordingError
        Where there are too few impacts with enough arrivals, or no clocks told that must be.
    """
    impacts = _impacts(gathered, geometry, ignore_places=ignore_places)
    outline = np.array(geometry.outline, np.float64).reshape(-1, 2)
    room = outline if len(outline) else None
    held = _held_out(impacts) if offsets != "no" else None
    clocks = held is not None and held.identifiable
    if offsets == "yes" and not clocks:
        raise RecordingError(_wanted(held))
    notes = [] if clocks or offsets == "no" else [NO_OFFSETS]
    if not clocks:  # the clocks are as the geometry has them
        ahead = {s.channel: s.clock_offset_s for s in geometry.sensors}
        stated_s = np.array([ahead.get(name, 0.0) for name in gathered.channels])
        gathered = replace(gathered, times_s=gathered.times_s - stated_s)
        impacts = replace(impacts, times_s=impacts.times_s - stated_s)
    base = _begun(impacts, room, exponent, clocks=clocks)
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
    if clocks and held is not None:  # another law of distance tells other clocks
        spread[2:] = np.maximum(spread[2:], np.abs(held.offsets_s - best.floor.offsets_s))
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
        held_out_gain=None if held is None else held.gain,
        held_out_error=None if held is None else held.error,
        offsets=_clock_offsets(gathered.channels, best, spread[2:]) if clocks else (),
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


def _wanted(held: HeldOut | None) -> str:
    """Say what clocks would need to be told."""
    found = f"fewer than {FOLDS}"
    if held is not None:
        found = f"a log likelihood {held.gain:+.1f} with a standard error of {held.error:.1f}"
    return (
        f"calibrate: --offsets yes: expected impacts at {FOLDS} or more known places whose log "
        f"likelihood offsets raise by more than {LEAST_GAIN:g} and its standard error, found "
        f"{found}"
    )


def _begun(impacts: Impacts, room: Array | None, exponent: float, *, clocks: bool) -> JointFit:
    """Return a first fit with the exponent kept, with offsets where clocks may differ."""
    if impacts.known is not None:
        return known_start(impacts, offsets=clocks, exponent=exponent)
    return start(impacts, room, exponent=exponent)


def _held_out(impacts: Impacts) -> HeldOut | None:
    """Fit without some places, with and without offsets, and compare how likely those are.

    None where no places are known, or fewer than are held out in turns.
    """
    if impacts.known is None:
        return None
    reference = reference_distance(impacts.positions)
    cells = np.rint(impacts.known / (SAME_PART * reference))
    _, place = np.unique(cells, axis=0, return_inverse=True)
    place, count = place.reshape(-1), int(place.max()) + 1
    if count < FOLDS:
        return None
    columns = _law_columns(impacts, reference)
    turn = np.random.default_rng(SEED).permutation(count) % FOLDS
    own = np.zeros(count)
    for fold in range(FOLDS):
        out = turn[place] == fold
        for sign, width in ((-1, len(LAW)), (1, columns.shape[2])):
            used = columns[..., :width]
            slopes, sigma = _law_fit(used[~out], impacts.times_s[~out])
            likely = _log_likelihood(used[out] @ slopes, impacts.times_s[out], sigma)
            for which in np.unique(place[out]):  # repeats at a place are no new evidence
                own[which] += sign * likely[place[out] == which].mean()
    slopes, sigma = _law_fit(columns, impacts.times_s)
    found = np.append(slopes[len(LAW) :], -slopes[len(LAW) :].sum())
    error = float(np.sqrt(count) * own.std(ddof=1))
    return HeldOut(count, float(own.sum()), error, found, sigma)


def _law_columns(impacts: Impacts, reference: float) -> Array:
    """Return powers of distance, and a column for each offset but the last, shape (m, n, p)."""
    assert impacts.known is not None
    apart = distances(impacts.known, impacts.positions) / reference
    sensors = len(impacts.positions)
    clocks = np.vstack([np.eye(sensors - 1), -np.ones(sensors - 1)])
    powers = np.stack([apart**power for power in LAW], axis=-1)
    return np.concatenate([powers, np.broadcast_to(clocks, (len(apart), *clocks.shape))], axis=-1)


def _law_fit(columns: Array, times_s: Array) -> tuple[Array, float]:
    """Fit arrivals as columns and a moment for each impact by Huber's loss.

    Returns
    -------
    A slope for each column, shape (p,) [s], and the standard deviation of an arrival [s].
    """
    heard = np.isfinite(times_s)
    times, weight = np.where(heard, times_s, 0.0), heard.astype(np.float64)
    for _ in range(PASSES):
        whole = np.maximum(weight.sum(axis=1), 1e-12)
        x = (
            columns
            - (weight[..., None] * columns).sum(axis=1, keepdims=True) / whole[:, None, None]
        )
        y = times - ((weight * times).sum(axis=1) / whole)[:, None]
        scaled = x * weight[..., None]
        matrix = np.einsum("mnp,mnq->pq", scaled, x)
        slopes = np.linalg.lstsq(matrix, np.einsum("mnp,mn->p", scaled, y), rcond=1e-10)[0]
        left = y - x @ slopes
        sigma = max(float(np.median(np.abs(left[heard]))) / 0.6745, LEAST_SIGMA_S)
        weight = heard * WEIGHTS["huber"](left / sigma)
    return slopes, sigma


def _log_likelihood(expected_s: Array, times_s: Array, sigma: float) -> Array:
    """Return the log likelihood of each impact by Huber's law about its best moment, shape (m,)."""
    left = times_s - expected_s
    left = left - np.nanmedian(left, axis=1, keepdims=True)
    size = np.abs(left) / sigma
    loss = np.where(size <= HUBER, size**2 / 2, HUBER * (size - HUBER / 2))
    likely: Array = -np.where(np.isfinite(left), loss + np.log(sigma), 0.0).sum(axis=1)
    return likely


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
