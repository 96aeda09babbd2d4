"""Self-calibration: the floor and the clocks estimated from arrivals, with their uncertainty.

A value is identifiable where its covariance is finite and small; any other is left as it was, and
reported. The spread over robust losses and a bootstrap over impacts stand beside the covariance.

Clocks are estimated from known locations alone, and only where impacts at locations that were left
out are likelier with offsets than without, while both may take any smooth law of distance: without
known locations, or under a wave law of another shape, offsets fit what no clock has done.

Clocks may be so far apart that waveforms cannot be compared. Arrivals by correlation are an order
finer than onsets, but presume that a delay is one that a wave can take and turns phases as a wave
does. A clock that is off by milliseconds does neither. Onsets do not depend on the clock: so they
give the clocks roughly, and correlation then finely, closer with each replay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from groundtrace_codecs.events import Pick, StageSpec, StepEvent
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.robust import HUBER, medians
from ..errors import PipelineError, RecordingError
from ..explain.sensors import swap_notes
from ..localizers import tdoa
from ..localizers.base import EXPONENT, first_arrivals, reference_distance
from ..localizers.joint_calibration import (
    LEAST_SIGMA_S,
    LOSS_WEIGHTS,
    LOSSES,
    TELLING,
    FreeParameters,
    Impacts,
    bounds_of,
    fit,
    known_start,
    places_on,
    start,
)
from ..localizers.tdoa import calibrated_velocity, distances
from ..pipeline.stage import LEAST_PICKS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event, Label
    from groundtrace_codecs.geometry import Geometry, Sensor

    from ..localizers.joint_calibration import JointCalibration, Loss

    Array = NDArray[np.float64]

#: Fewest impacts to calibrate with, of unknown and of known places.
#: Chosen by judgement: twice the unknowns of a floor, so that its error can be told.
LEAST_IMPACTS, LEAST_KNOWN = 6, 3
#: Deviations above which nothing is said to be known: of log k at the reference, of the exponent.
#: Chosen by judgement: a quarter of the velocity, and a third of the way from a constant velocity
#: to a plate.
PACE_LIMIT, EXPONENT_LIMIT = 0.25, 0.12
#: Samples of the bootstrap, and its seed. Chosen by judgement: a deviation is then told to a tenth.
SAMPLES, SEED = 50, 0
#: Clocks are identifiable where the log likelihood of held-out places is higher with them by more
#: than so much, and by more than its standard error; and the largest is so many deviations of an
#: arrival. Chosen by trial on, and reported on, simulated arrivals (bench/place_causes.py): of 480
#: recordings without offsets none passes (10 of 960 the first two), of 960 with 2 and 3 ms all do.
LEAST_GAIN, LEAST_SIGMAS = 2.0, 2.0
#: Places are held out in so many turns; there are at least as many. Impacts nearer to each other
#: than this part of the layout's reference are repeats at one place. Chosen by judgement: ten folds
#: are usual.
FOLDS, SAME_PART = 10, 0.05
#: Powers of distance that make any smooth law, and passes of reweighting. Chosen by judgement: they
#: bend as a plate does and as a half space does; passes settle in fewer.
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
        Ignore known impact positions.
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
    room = _room(geometry)
    held_out, clocks = _clocks(impacts, offsets)
    notes = [] if clocks or offsets == "no" else [NO_OFFSETS]
    if not clocks:
        gathered = _on_stated_clocks(gathered, geometry)
        impacts = _impacts(gathered, geometry, ignore_places=ignore_places)
    base = _begun(impacts, room, exponent, clocks=clocks)
    best, exponent_notes = _exponent(impacts, base)
    notes += exponent_notes
    pace_known = best.deviations[0] <= PACE_LIMIT
    notes += [] if pace_known else [_unknown_scale(best)]
    times_s = impacts.times_s - best.floor.offsets_s
    notes += swap_notes(gathered.channels, impacts.positions, times_s, best.places)
    spread = _spread(impacts, best, held_out if clocks else None)
    return Calibration(
        impacts=len(impacts.times_s),
        sensors=len(impacts.positions),
        arrivals=int(np.isfinite(impacts.times_s).sum()),
        known_places=impacts.true_places is not None,
        unit=geometry.length_unit,
        scale=Estimate(best.floor.scale, float(spread[0]), bool(pace_known)),
        exponent=Estimate(best.floor.exponent, float(spread[1]), best.free.exponent),
        reference=best.floor.reference_m,
        pace_s=best.floor.pace_s,
        velocity=_velocity(impacts, best) if pace_known else None,
        arrival_sigma_s=best.sigma_s,
        offsets_estimated=best.free.offsets,
        held_out_gain=None if held_out is None else held_out.gain,
        held_out_error=None if held_out is None else held_out.error,
        offsets=_clock_offsets(gathered.channels, best, spread[2:]) if clocks else (),
        losses=tuple(_by_loss(impacts, best, loss) for loss in LOSSES),
        positions=place_errors(gathered, best, room),
        notes=tuple(notes),
    )


def _room(geometry: Geometry) -> Array | None:
    """Return the outline, shape (n, 2); None without one."""
    outline = np.array(geometry.outline, np.float64).reshape(-1, 2)
    return outline if len(outline) else None


def _clocks(impacts: Impacts, offsets: str) -> tuple[HeldOut | None, bool]:
    """Return what held-out places say of the clocks, and whether offsets are to be estimated."""
    held_out = _held_out(impacts) if offsets != "no" else None
    clocks = held_out is not None and held_out.identifiable
    if offsets == "yes" and not clocks:
        raise RecordingError(_wanted(held_out))
    return held_out, clocks


def _on_stated_clocks(gathered: Gathered, geometry: Geometry) -> Gathered:
    """Return arrivals with the clocks as the geometry has them."""
    ahead = {s.channel: s.clock_offset_s for s in geometry.sensors}
    stated_s = np.array([ahead.get(name, 0.0) for name in gathered.channels])
    return replace(gathered, times_s=gathered.times_s - stated_s)


def _spread(impacts: Impacts, best: JointCalibration, held_out: HeldOut | None) -> Array:
    """Return the deviations of scale, exponent and offsets, shape (2 + n,)."""
    spread: Array = np.maximum(_bootstrap(impacts, best).std(axis=0), _deviations(best))
    if held_out is not None:  # another law of distance tells other clocks
        spread[2:] = np.maximum(spread[2:], np.abs(held_out.offsets_s - best.floor.offsets_s))
    if not best.free.exponent:
        spread[1] = np.nan
    return spread


def _unknown_scale(best: JointCalibration) -> str:
    """Say that and why the scale is not told."""
    return (
        f"scale: not identifiable from these impacts and sensors (deviation "
        f"{best.deviations[0]:.0%} of itself, {PACE_LIMIT:.0%} allowed)"
    )


def _clock_offsets(
    channels: Sequence[str], best: JointCalibration, deviations: Array
) -> tuple[ClockOffset, ...]:
    """Return each channel's clock offset with its deviation."""
    rows = zip(channels, best.floor.offsets_s, deviations, strict=True)
    return tuple(ClockOffset(name, float(value), float(sigma)) for name, value, sigma in rows)


def _impacts(gathered: Gathered, geometry: Geometry, *, ignore_places: bool) -> Impacts:
    """Return the impacts that tell something; those of known places alone where they suffice."""
    picks = np.isfinite(gathered.times_s).sum(axis=1)
    bounds = bounds_of(gathered.positions, _room(geometry))
    placed = np.isfinite(gathered.true_places).all(axis=1) & (picks >= 2)
    if not ignore_places and placed.sum() >= LEAST_KNOWN:
        return Impacts(
            gathered.positions, gathered.times_s[placed], bounds, gathered.true_places[placed]
        )
    enough = picks >= TELLING
    if enough.sum() < LEAST_IMPACTS:
        raise RecordingError(
            f"calibrate: expected {LEAST_IMPACTS} or more impacts with {TELLING} or more "
            f"arrivals (or {LEAST_KNOWN} of known places), found {int(enough.sum())}"
        )
    return Impacts(gathered.positions, gathered.times_s[enough], bounds)


def _wanted(held_out: HeldOut | None) -> str:
    """Say what clocks would need to be told."""
    text = f"fewer than {FOLDS}"
    if held_out is not None:
        text = (
            f"a log likelihood {held_out.gain:+.1f} with a standard error of {held_out.error:.1f}"
        )
    return (
        f"calibrate: --offsets yes: expected impacts at {FOLDS} or more known places whose log "
        f"likelihood offsets raise by more than {LEAST_GAIN:g} and its standard error, found "
        f"{text}"
    )


def _begun(
    impacts: Impacts, room: Array | None, exponent: float, *, clocks: bool
) -> JointCalibration:
    """Return a first fit with the exponent kept, with offsets where clocks may differ."""
    if impacts.true_places is not None:
        return known_start(impacts, offsets=clocks, exponent=exponent)
    return start(impacts, room, exponent=exponent)


def _held_out(impacts: Impacts) -> HeldOut | None:
    """Fit without some places, with and without offsets, and compare how likely those are.

    None where no places are known, or fewer than are held out in turns.
    """
    if impacts.true_places is None:
        return None
    reference = reference_distance(impacts.positions)
    cells = np.rint(impacts.true_places / (SAME_PART * reference))
    _, place_index = np.unique(cells, axis=0, return_inverse=True)
    place_index, count = place_index.reshape(-1), int(place_index.max()) + 1
    if count < FOLDS:
        return None
    columns = _law_columns(impacts, reference)
    turn = np.random.default_rng(SEED).permutation(count) % FOLDS
    gains = np.zeros(count)
    for fold in range(FOLDS):
        out = turn[place_index] == fold
        for sign, width in ((-1, len(LAW)), (1, columns.shape[2])):
            used = columns[..., :width]
            slopes, sigma = _law_fit(used[~out], impacts.times_s[~out])
            likely = _log_likelihood(used[out] @ slopes, impacts.times_s[out], sigma)
            for which in np.unique(place_index[out]):  # repeats at a place are no new evidence
                gains[which] += sign * likely[place_index[out] == which].mean()
    slopes, sigma = _law_fit(columns, impacts.times_s)
    offsets_s = np.append(slopes[len(LAW) :], -slopes[len(LAW) :].sum())
    error = float(np.sqrt(count) * gains.std(ddof=1))
    return HeldOut(count, float(gains.sum()), error, offsets_s, sigma)


def _law_columns(impacts: Impacts, reference: float) -> Array:
    """Return powers of distance, and a column for each offset but the last, shape (m, n, p)."""
    assert impacts.true_places is not None
    apart = distances(impacts.true_places, impacts.positions) / reference
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
    valid = np.isfinite(times_s)
    times, weight = np.where(valid, times_s, 0.0), valid.astype(np.float64)
    for _ in range(PASSES):
        weight_sum = np.maximum(weight.sum(axis=1), 1e-12)
        x = (
            columns
            - (weight[..., None] * columns).sum(axis=1, keepdims=True) / weight_sum[:, None, None]
        )
        y = times - ((weight * times).sum(axis=1) / weight_sum)[:, None]
        scaled = x * weight[..., None]
        matrix = np.einsum("mnp,mnq->pq", scaled, x)
        slopes = np.linalg.lstsq(matrix, np.einsum("mnp,mn->p", scaled, y), rcond=1e-10)[0]
        left = y - x @ slopes
        sigma = max(float(np.median(np.abs(left[valid]))) / 0.6745, LEAST_SIGMA_S)
        weight = valid * LOSS_WEIGHTS["huber"](left / sigma)
    return slopes, sigma


def _log_likelihood(expected_s: Array, times_s: Array, sigma: float) -> Array:
    """Return the log likelihood of each impact by Huber's law about its best moment, shape (m,)."""
    left = times_s - expected_s
    left = left - medians(left)[:, None]
    size = np.abs(left) / sigma
    loss = np.where(size <= HUBER, size**2 / 2, HUBER * (size - HUBER / 2))
    likely: Array = -np.where(np.isfinite(left), loss + np.log(sigma), 0.0).sum(axis=1)
    return likely


def _exponent(impacts: Impacts, base: JointCalibration) -> tuple[JointCalibration, list[str]]:
    """Return the fit with the exponent free where the arrivals tell it, else with it kept."""
    free = FreeParameters(exponent=True, offsets=base.free.offsets)
    free_fit = fit(impacts, base.floor, base.places, free=free)
    deviation = free_fit.deviations[1]
    if deviation <= EXPONENT_LIMIT and 0.5 < free_fit.floor.exponent < 2:
        return free_fit, []
    return base, [
        f"exponent: not identifiable from these distances (deviation {deviation:.2g}, "
        f"{EXPONENT_LIMIT} allowed): kept at {base.floor.exponent:.4g}"
    ]


def _bootstrap(impacts: Impacts, best: JointCalibration) -> Array:
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


def _deviations(best: JointCalibration) -> Array:
    """Return the deviations of scale, exponent and offsets by the covariance, shape (2 + n,)."""
    out = best.deviations
    # k = pace / reference^p
    slope = np.array([1.0, -np.log(best.floor.reference_m)])
    shared = best.covariance[:2, :2]
    is_finite = np.isfinite(shared).all()
    out[0] = best.floor.scale * (np.sqrt(max(slope @ shared @ slope, 0)) if is_finite else np.inf)
    return out


def _velocity(impacts: Impacts, best: JointCalibration) -> float | None:
    """Return the velocity for hyperbolas, by the places found and the arrivals that fit them."""
    inliers = np.abs(np.nan_to_num(best.residuals_s)) <= 3 * best.sigma_s
    times = np.where(inliers, impacts.times_s - best.floor.offsets_s, np.nan)
    telling = np.isfinite(times).sum(axis=1) >= 2
    try:
        return calibrated_velocity(best.places[telling], impacts.positions, times[telling])
    except PipelineError:
        return None


def _by_loss(impacts: Impacts, best: JointCalibration, loss: Loss) -> LossFigures:
    loss_fit = fit(impacts, best.floor, best.places, loss=loss, free=best.free)
    return LossFigures(loss, loss_fit.floor.scale, loss_fit.floor.exponent, loss_fit.sigma_s)


E = TypeVar("E", Pick, StepEvent)


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Arrivals of the impacts of one topic.

    Attributes
    ----------
    channels
        Those with a place and arrivals, n of them: a dead sensor tells nothing of its clock.
    positions
        Shape (n, 2) [m].
    times_s
        Shape (m, n): by the clocks as they are [s]; NaN where a sensor has no arrival.
    true_places
        Shape (m, 2): true places [m]; NaN where unknown.
    """

    channels: tuple[str, ...]
    positions: Array
    times_s: Array
    true_places: Array


def gather(
    events: Sequence[Event],
    geometry: Geometry,
    labels: Sequence[Label],
    window_s: float = 0.05,
    tolerance_s: float = 0.12,
    stage: str = "",
) -> Gathered:
    """Gather the arrivals of the steps and impacts that a replay found.

    Parameters
    ----------
    events
        Of a replay; the last stage that picks and the last that finds steps count.
    geometry
        Where the sensors are, and the sources of controlled impacts.
    labels
        Truth: steps and impacts with places, or impacts that name a source of the geometry.
    window_s
        Longest time after a step that arrivals belong to it [s].
    tolerance_s
        Largest distance between a step and its truth [s].
    stage
        The stage that picks; empty: the last one.

    Raises
    ------
    RecordingError
        Where there are no picks, no steps, or fewer than three placed sensors.
    """
    picking = _last(events, ("pick",), stage)
    stepping = _last(events, ("step", "impact"))
    if picking is None or stepping is None:
        what = "picks" if picking is None else "steps"
        raise RecordingError(f"calibrate: expected a pipeline that gives {what}, found none")
    rows, positions = geometry.placed(picking.channels)
    if len(np.unique(positions, axis=0)) < LEAST_PICKS:
        raise RecordingError(
            f"calibrate: geometry: expected three or more sensors at {picking.topic}, "
            f"found {len(positions)}"
        )
    picks = _events_of(events, Pick, picking.stage, picking.topic)
    steps = [e.time_ns for e in _events_of(events, StepEvent, stepping.stage, picking.topic)]
    arrivals = _arrivals_of(sorted(picks, key=lambda p: p.time_ns), steps, rows, window_s)
    columns = np.flatnonzero(np.isfinite(arrivals).any(axis=0))
    names = tuple(list(rows)[index] for index in columns)
    true_places = _true_places(steps, labels, geometry, tolerance_s)
    return Gathered(names, positions[columns], arrivals[:, columns], true_places)


def _events_of(events: Sequence[Event], kind: type[E], stage: str, topic: str) -> list[E]:
    """Return the events of a kind that one stage made of one topic."""
    return [e for e in events if isinstance(e, kind) and (e.stage, e.topic) == (stage, topic)]


def _arrivals_of(
    picks: Sequence[Pick], steps: Sequence[int], rows: dict[str, int], window_s: float
) -> Array:
    """Return each step's first arrival at each sensor [s after the step], NaN without one."""
    times = np.array([p.time_ns for p in picks], np.int64)
    arrivals = []
    for step in steps:
        first, last = np.searchsorted(times, [step, step + round(window_s * NS_PER_S) + 1])
        arrivals.append(first_arrivals(picks[first:last], rows, step, window_s))
    return np.array(arrivals, np.float64).reshape(-1, len(rows))


def picking_stages(events: Sequence[Event]) -> tuple[str, ...]:
    """Return the names of the stages that pick, in order."""
    specs = (e for e in events if isinstance(e, StageSpec) and e.emits == "pick")
    return tuple(dict.fromkeys(spec.stage for spec in specs))


def _last(events: Sequence[Event], emits: tuple[str, ...], stage: str = "") -> StageSpec | None:
    """Return the last stage that emits something, or the one of a name."""
    specs = [e for e in events if isinstance(e, StageSpec) and e.emits in emits]
    named = [spec for spec in specs if spec.stage == (stage or spec.stage)]
    return named[-1] if named else None


def _true_places(
    steps: Sequence[int], labels: Sequence[Label], geometry: Geometry, tolerance_s: float
) -> Array:
    """Return the true place of each step, by the nearest label in time, shape (m, 2)."""
    sources = {name: (x, y) for name, x, y in geometry.sources}
    placed = [(label.time_ns, _position_of(label, sources)) for label in labels]
    true = [(time_ns, position) for time_ns, position in placed if position is not None]
    out = np.full((len(steps), 2), np.nan)
    if true:
        times = np.array([time_ns for time_ns, _ in true], np.int64)
        for row, step in enumerate(steps):
            nearest = int(np.argmin(np.abs(times - step)))
            if abs(int(times[nearest]) - step) <= tolerance_s * NS_PER_S:
                out[row] = true[nearest][1]
    return out


def _position_of(
    label: Label, sources: dict[str, tuple[float, float]]
) -> tuple[float, float] | None:
    if label.kind not in ("step", "impact"):
        return None
    if label.x_m is not None and label.y_m is not None:
        return label.x_m, label.y_m
    return sources.get(label.label)


#: Most replays more, and the part of an arrival's deviation that settled clocks move by at most.
#: Chosen by judgement: clocks settle in two or three.
MOST_REPLAYS, SETTLED = 6, 0.5
AGAIN = (
    "scale, exponent: of onsets, which tell clocks so far apart better than {stage}: left as they "
    "were; replay with the geometry found, then calibrate again"
)


@dataclass(frozen=True, slots=True)
class Choices:
    """What to presume, see :func:`calibrate`; ``exponent`` is of the last arrivals."""

    ignore_places: bool = False
    offsets: str = "auto"
    exponent: float = EXPONENT


def calibrate_once(
    events: Sequence[Event], geometry: Geometry, labels: Sequence[Label], choices: Choices
) -> Calibration:
    """Calibrate by the last stage that picks; only the clocks by one before where that is better.

    Parameters
    ----------
    events, labels
        As of :func:`gather`.
    geometry
        Outline and unit of the site.
    choices
        What to presume.

    Raises
    ------
    RecordingError
        As :func:`gather` and :func:`calibrate`.
    """
    calibration = _by_stage(events, geometry, labels, choices)
    stages = picking_stages(events)
    for stage in stages[:-1] if choices.offsets != "no" else ():
        try:
            other = _by_stage(events, geometry, labels, replace(choices, exponent=EXPONENT), stage)
        except RecordingError:
            continue
        if other.offsets_estimated and other.arrival_sigma_s < calibration.arrival_sigma_s:
            calibration = _clocks_alone(other, stages[-1])
    return calibration


def _by_stage(
    events: Sequence[Event],
    geometry: Geometry,
    labels: Sequence[Label],
    choices: Choices,
    stage: str = "",
) -> Calibration:
    c, gathered = choices, gather(events, geometry, labels, stage=stage)
    return calibrate(
        gathered,
        geometry,
        ignore_places=c.ignore_places,
        offsets=c.offsets,
        exponent=c.exponent,
    )


def _clocks_alone(calibration: Calibration, stage: str) -> Calibration:
    """Return what arrivals tell of the clocks; the floor of ``stage``'s arrivals is another."""
    scale = replace(calibration.scale, identifiable=False)
    notes = (*calibration.notes, AGAIN.format(stage=stage))
    return replace(calibration, scale=scale, velocity=None, notes=notes)


def calibrate_replaying(
    replayed: Callable[[Geometry], Sequence[Event]],
    geometry: Geometry,
    labels: Sequence[Label],
    choices: Choices,
) -> tuple[Calibration, Geometry]:
    """Calibrate as :func:`calibrate_once`, and replay with what was found until clocks settle.

    Parameters
    ----------
    replayed
        Returns the events of a replay with a geometry.
    geometry, labels, choices
        As of :func:`calibrate_once`.

    Returns
    -------
    The last calibration, and the geometry that it was made with.
    """
    events = replayed(geometry)
    calibration = calibrate_once(events, geometry, labels, choices)
    for _ in range(MOST_REPLAYS if len(picking_stages(events)) > 1 else 0):
        after = calibrated_geometry(geometry, calibration)
        if _moved_s(geometry, after) <= SETTLED * calibration.arrival_sigma_s:
            break
        geometry = after
        finer = _by_stage(replayed(geometry), geometry, labels, choices)
        if finer.arrival_sigma_s > calibration.arrival_sigma_s:
            break
        calibration = finer
    return calibration, geometry


def _moved_s(before: Geometry, after: Geometry) -> float:
    """Return by how much two geometries differ in a clock at most [s]."""
    pairs = zip(before.sensors, after.sensors, strict=True)
    moved = [a.clock_offset_s - b.clock_offset_s for b, a in pairs]
    return float(np.abs(moved).max())


@dataclass(frozen=True, slots=True)
class PlaceErrors:
    """Errors of the places of impacts whose true places are known.

    Attributes
    ----------
    n
        How many.
    rmse_before
        By the power law with a scale of its own for each impact, clocks as they are [unit].
    rmse_after
        By the floor and the clocks found [unit].
    """

    n: int
    rmse_before: float
    rmse_after: float


def place_errors(
    gathered: Gathered, best: JointCalibration, room: Array | None
) -> PlaceErrors | None:
    """Locate the impacts without and with a calibration; None where no true place is known."""
    picks = np.isfinite(gathered.times_s).sum(axis=1)
    rows = np.flatnonzero(
        np.isfinite(gathered.true_places).all(axis=1) & (picks >= tdoa.POWER_LAW_UNKNOWNS)
    )
    if not len(rows):
        return None
    times, true = gathered.times_s[rows], gathered.true_places[rows]
    before = [tdoa.locate_power_law(gathered.positions, row, room) for row in times]
    impacts = Impacts(gathered.positions, times, bounds_of(gathered.positions, room))
    after = places_on(impacts, best.floor, room, HUBER * best.sigma_s)
    return PlaceErrors(
        len(rows), _rms(np.array([(p.x, p.y) for p in before]) - true), _rms(after - true)
    )


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def calibrated_geometry(geometry: Geometry, calibration: Calibration) -> Geometry:
    """Return a geometry with what was found; what is not identifiable stays as it was."""
    medium = replace(geometry.medium, arrival_sigma_s=calibration.arrival_sigma_s)
    if calibration.scale.identifiable:
        medium = replace(
            medium,
            arrival_scale=calibration.scale.value,
            arrival_exponent=calibration.exponent.value,
            velocity_mps=calibration.velocity or medium.velocity_mps,
        )
    ahead = {o.channel: o.offset_s for o in calibration.offsets}
    sensors = tuple(_with_offset(sensor, ahead) for sensor in geometry.sensors)
    return replace(geometry, medium=medium, sensors=sensors)


def _with_offset(sensor: Sensor, ahead: dict[str, float]) -> Sensor:
    return replace(sensor, clock_offset_s=ahead.get(sensor.channel, sensor.clock_offset_s))
