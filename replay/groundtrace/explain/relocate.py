"""Locating again: the same localizer on stored picks, with something changed.

A parameter, the positions of sensors or single arrivals may be changed. Without a change the
locations are those that were stored.

The arrival curve of a recording judges arrivals apart from any localizer: t = t0 + k d^p with one k
and p, and one t0 a step. The exponent lies between 1 (a front that does not disperse) and 4/3
(thesis, equation (4.24)); of a few in between the one that fits best is taken.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Fix, Pick, StepEvent
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.signals import NS_PER_S

from ..dsp.robust import HUBER, MAD_SIGMA
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.picks import ANSWER_S
from ..evaluation.positions import found_places, match_places, true_places
from ..localizers import tdoa
from ..localizers.base import EXPONENT, PlacedSensors, first_arrivals, place_candidate
from ..localizers.tdoa import distances
from ..pipeline.gates import Candidates, decided_block
from ..pipeline.parameters import build
from ..pipeline.plugins import stage_named
from .reasons import accepted_picks, before, locating, onsets_of, readings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import TrackPoint

    from ..evaluation.positions import Places
    from ..pipeline.results import Evidence, StageEvidence
    from .reasons import GateReading
    from .redecide import Outcome

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What a localizer is given.

    Attributes
    ----------
    step_ns
        Shape (m,): times of the steps [ns].
    times_s
        Shape (m, n): first arrival at each sensor after each step [s]; NaN where there is none.
    """

    step_ns: NDArray[np.int64]
    times_s: Array

    def without(self, channel: int, row: int | None = None) -> Arrivals:
        """Return the same without a channel, in one step or in all."""
        return self.shifted(channel, float("nan"), row)

    def shifted(self, channel: int, by_s: float, row: int | None = None) -> Arrivals:
        """Return the same with a channel moved in time, in one step or in all."""
        times = self.times_s.copy()
        times[slice(None) if row is None else row, channel] += by_s
        return Arrivals(self.step_ns, times)


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Places of all steps.

    Attributes
    ----------
    block
        The candidates of the localizer, decided, one a step.
    ties
        Shape (m,): how many regions or nodes explain the arrivals equally well.
    """

    block: CandidateBlock
    ties: NDArray[np.int64]

    @property
    def xy(self) -> Array:
        """Shape (m, 2): places, decided or not [m]; NaN where there are too few arrivals."""
        places: Array = self._columns("x", "y")
        return places

    @property
    def sigma_m(self) -> Array:
        """Shape (m,): how sure each place is, as the localizer says [m]."""
        sigmas_m: Array = self._columns("sigma")[:, 0]
        return sigmas_m

    @property
    def residual(self) -> Array:
        """Shape (m,): what each place leaves unexplained, in the localizer's unit."""
        residuals: Array = self._columns("residual")[:, 0]
        return residuals

    def _columns(self, *wanted: str) -> Array:
        names = [column.name for column in self.block.spec.columns]
        return self.block.value[:, [names.index(name) for name in wanted]].astype(np.float64)

    def failed(self, row: int) -> GateReading | None:
        """Return the first gate that a place failed, or None."""
        return next((r for r in readings(self.block, row) if not r.passed), None)


class Relocator:
    """Locates the steps of one result again.

    Parameters
    ----------
    evidence
        What was stored.
    stage
        Name of the stage that locates; empty stands for the last one.

    Raises
    ------
    RecordingError
        Where no such stage located anything.
    """

    def __init__(self, evidence: Evidence, stage: str = "") -> None:
        self.evidence = evidence
        self.part = locating(evidence, stage)
        key = self.part.spec.stage
        self.config = next(s for s in evidence.config.stage if s.key == key)
        self.kind: Any = stage_named(self.config.use)
        self.parameters = build(self.kind.Parameters, self.config.parameters, key)
        self.picking = before(evidence, self.part, ("pick",))
        self.stepping = before(evidence, self.part, ("step", "impact"))
        self.geometry = evidence.geometry or Geometry()
        self.channels, self.positions = self.geometry.placed(self.picking.spec.channels)
        self.names = tuple(self.channels)
        self._ahead: Any = None
        self._seen = 0
        self.arrivals = self._stored(self.picking)
        onsets = onsets_of(evidence, self.picking)
        #: What was picked channel by channel; the arrivals themselves without an array method.
        self.onsets = self.arrivals if onsets is self.picking else self._stored(onsets)
        self.located = self.locate()

    def locate(
        self,
        arrivals: Arrivals | None = None,
        positions: Array | None = None,
        parameters: Any = None,
    ) -> Located:
        """Locate all steps, with other arrivals, places of sensors or parameters where given."""
        arrivals = self.arrivals if arrivals is None else arrivals
        parameters = self.parameters if parameters is None else parameters
        worker = self._worker(self.positions if positions is None else positions, parameters)
        return self._decided(worker, parameters, arrivals)

    def _decided(self, worker: Any, parameters: Any, arrivals: Arrivals) -> Located:
        steps = zip(arrivals.step_ns.tolist(), arrivals.times_s, strict=True)
        locations = [worker.locate_step(time_ns, times) for time_ns, times in steps]
        rows = [
            place_candidate(int(t), f) for t, f in zip(arrivals.step_ns, locations, strict=True)
        ]
        none = Candidates.empty(len(worker.columns))
        candidates = Candidates.concatenate([none, *rows])
        block, _ = decided_block(self.part.spec, candidates, worker, parameters)
        return Located(block, np.array([f.ties for f in locations], np.int64))

    def locate_row(self, row: int, times_s: Array, positions: Array | None = None) -> Located:
        """Locate one step from other arrivals, after the steps before it as they are.

        Parameters
        ----------
        row
            The step.
        times_s
            Shape (n,): its arrivals [s]; NaN where there is none.
        positions
            Shape (n, 2): other places of the sensors [m], for all steps so far.
        """
        worker = self._worker_before(row, positions)
        step_ns = self.arrivals.step_ns[row : row + 1]
        return self._decided(worker, self.parameters, Arrivals(step_ns, times_s[None]))

    def _worker_before(self, row: int, positions: Array | None = None) -> Any:
        """Return a localizer that has seen the steps before one: it may learn from them."""
        if positions is not None and not np.array_equal(positions, self.positions):
            worker = self._worker(positions, self.parameters)
            self._advance(worker, 0, row)
            return worker
        if self._ahead is None or row < self._seen:
            self._ahead, self._seen = self._worker(self.positions, self.parameters), 0
        self._advance(self._ahead, self._seen, row)
        self._seen = row
        return copy.deepcopy(self._ahead)

    def _advance(self, worker: Any, first: int, stop: int) -> None:
        """Let a localizer see some steps, from which it may learn."""
        for row in range(first, stop):
            worker.locate_step(int(self.arrivals.step_ns[row]), self.arrivals.times_s[row])

    def arrivals_of(self, outcome: Outcome) -> Arrivals:
        """Return the arrivals that a pipeline decided with other settings would give."""
        topic = self.part.spec.topic
        picks = [
            e
            for e in outcome.events
            if isinstance(e, Pick) and (e.stage, e.topic) == (self.picking.spec.stage, topic)
        ]
        steps = [
            e.time_ns
            for e in outcome.events
            if isinstance(e, StepEvent) and (e.stage, e.topic) == (self.stepping.spec.stage, topic)
        ]
        return self._gathered(np.array(steps, np.int64), picks)

    @property
    def correlated(self) -> bool:
        """Whether the arrivals are those of an array method, not onsets."""
        return self.arrivals is not self.onsets

    @property
    def nothing(self) -> Arrivals:
        """No steps at all."""
        return Arrivals(np.empty(0, np.int64), np.empty((0, len(self.channels))))

    def _stored(self, picking: StageEvidence) -> Arrivals:
        return self._gathered(self.part.candidates.time_ns, accepted_picks(picking))

    def _gathered(self, step_ns: NDArray[np.int64], picks: Sequence[Pick]) -> Arrivals:
        """Gather the arrivals of each step; only picks of its window are looked at."""
        ordered = sorted(picks, key=lambda pick: pick.time_ns)
        times = np.array([pick.time_ns for pick in ordered], np.int64)
        window_s, ahead = self.parameters.window_s, self.geometry.clock_offsets(self.channels)
        first = np.searchsorted(times, step_ns, side="left")
        last = np.searchsorted(times, step_ns + round(window_s * NS_PER_S), side="right")
        rows = [
            first_arrivals(ordered[a:b], self.channels, int(t), window_s, ahead)
            for a, b, t in zip(first, last, step_ns, strict=True)
        ]
        times_s = np.array(rows, np.float64).reshape(len(step_ns), len(self.channels))
        return Arrivals(step_ns, times_s)

    def _worker(self, positions: Array, parameters: Any) -> Any:
        outline = np.array(self.geometry.outline, np.float64)
        worker = self.kind(parameters)
        room, medium = outline if len(outline) else None, self.geometry.medium
        worker.begin(PlacedSensors(positions, room, medium, self.geometry.length_unit))
        return worker


def stored(part: StageEvidence) -> Located:
    """Return the places of a stage as decided; how many regions tied is not kept: 0."""
    c = part.candidates
    block = CandidateBlock(
        part.spec, c.time_ns, c.channel, c.value, part.gate_value, part.margin, part.accepted
    )
    return Located(block, np.zeros(len(c), np.int64))


#: A track tells nothing about steps further than this from its points [s]. Chosen by judgement: a
#: walker goes a metre and a half in it.
REACH_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where somebody was.

    Attributes
    ----------
    kind
        ``truth``, ``track`` (where the tracker has them) or ``none``.
    xy
        Shape (m, 2) [m]; NaN where unknown.
    """

    kind: str
    xy: Array

    def errors_m(self, located: Located) -> Array:
        """Return how far each place is off, rejected or not, shape (m,) [m]; NaN if unknown."""
        off: Array = np.hypot(*(located.xy - self.xy).T)
        return off

    def rmse_m(self, located: Located) -> float:
        """Return the root mean square of the errors of accepted places [m]; NaN without any."""
        errors = self.errors_m(located)[located.block.accepted]
        finite = errors[np.isfinite(errors)]
        return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")


def reference_of(evidence: Evidence, located: Located) -> Reference:
    """Return the truth about places, else what the track says, for each step located."""
    times = located.block.time_ns
    truth = true_places(evidence.labels)
    if len(truth):
        return Reference("truth", true_at(truth, times, located.xy, STEP_TOLERANCE_S))
    if evidence.track:
        return Reference("track", tracked_at(evidence.track, times, located.xy))
    return Reference("none", np.full((len(times), 2), np.nan))


def true_at(truth: Places, time_ns: NDArray[np.int64], xy: Array, tolerance_s: float) -> Array:
    """Return the true place that each step answers, shape (m, 2) [m]; NaN where it answers none.

    Parameters
    ----------
    truth
        True places.
    time_ns
        Shape (m,): of the steps, in order.
    xy
        Shape (m, 2): where they were located [m]; NaN where nowhere.
    tolerance_s
        Largest distance in time [s].
    """
    somewhere = np.where(np.isfinite(xy), xy, truth.xy.mean(axis=0))
    unknown = (float("nan"),) * 3
    found_at = [
        Fix(int(t), float(x), float(y), unknown, float("nan"), "", 0, "")
        for t, (x, y) in zip(time_ns, somewhere, strict=True)
    ]
    pairs = match_places(truth, found_places(found_at), tolerance_s)
    true_xy = np.full((len(time_ns), 2), np.nan)
    true_xy[pairs[:, 1]] = truth.xy[pairs[:, 0]]
    return true_xy


def tracked_at(track: Sequence[TrackPoint], time_ns: NDArray[np.int64], xy: Array) -> Array:
    """Return where the nearest track is at each step, shape (m, 2) [m]; NaN far from any."""
    track_xy = np.full((len(time_ns), 2), np.nan)
    nearest = np.full(len(time_ns), np.inf)
    for number in sorted({point.track for point in track}):
        points = sorted((p.time_ns, p.x_m, p.y_m) for p in track if p.track == number)
        times = np.array([row[0] for row in points], np.int64)
        places = np.array([row[1:] for row in points], np.float64)
        there = np.column_stack([np.interp(time_ns, times, places[:, k]) for k in (0, 1)])
        away_s = np.abs(time_ns[:, None] - times).min(axis=1) / NS_PER_S
        apart = np.nan_to_num(np.hypot(*(xy - there).T), nan=0.0)
        better = (away_s <= REACH_S) & (apart < nearest)
        track_xy[better], nearest[better] = there[better], apart[better]
    return track_xy


def true_pick_errors(evidence: Evidence, relocator: Relocator) -> Array:
    """Return arrival minus true arrival, shape (m, n) [s]; NaN where none is within 50 ms.

    NaN everywhere where the arrivals are those of an array method: of one frequency of waves that
    disperse, which come after the first ones by more, the farther they went.
    """
    step_ns, times_s = relocator.arrivals.step_ns, relocator.arrivals.times_s
    errors_s = np.full(times_s.shape, np.nan)
    if relocator.correlated:
        return errors_s
    for channel, name in enumerate(relocator.names):
        truth = np.sort(
            [x.time_ns for x in evidence.labels if (x.kind, x.channel) == ("pick", name)]
        )
        if not len(truth):
            continue
        rows = np.flatnonzero(np.isfinite(times_s[:, channel]))
        picked = step_ns[rows] + np.rint(times_s[rows, channel] * NS_PER_S).astype(np.int64)
        after = np.clip(np.searchsorted(truth, picked), 1, max(len(truth) - 1, 1))
        near = [truth[np.minimum(k, len(truth) - 1)] for k in (after - 1, after)]
        off = np.stack([picked - t for t in near]) / NS_PER_S
        least = np.take_along_axis(off, np.abs(off).argmin(axis=0)[None], axis=0)[0]
        errors_s[rows, channel] = np.where(np.abs(least) <= ANSWER_S, least, np.nan)
    return errors_s


#: Exponents of distance that are tried. Source: a constant velocity, the thesis's plate (4.24), and
#: half way between.
EXPONENTS = (1.0, 7 / 6, EXPONENT)
#: Passes of reweighting. Chosen by judgement: they settle in fewer.
PASSES = 8
#: The least error of an arrival reckoned with [s]: no picker is better. Chosen by judgement: a
#: sample at 20 kHz.
LEAST_NOISE_S = 5e-5


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A fitted curve.

    Attributes
    ----------
    exponent, slope
        p, and k [s/m^p].
    origin_s
        Shape (m,): t0 of each step [s]; NaN where it has no arrival.
    noise_s
        Standard deviation of an arrival, robust [s].
    """

    exponent: float
    slope: float
    origin_s: Array
    noise_s: float

    def misfit_s(self, sources: Array, position: Array, times_s: Array) -> Array:
        """Return by how much arrivals at one sensor come after the curve, shape (m,) [s].

        Parameters
        ----------
        sources
            Shape (m, 2): places of the steps [m].
        position
            Shape (2,): the sensor's [m].
        times_s
            Shape (m,): arrivals there [s]; NaN where there is none.
        """
        apart = np.hypot(*(sources - position).T)
        late: Array = times_s - self.origin_s - self.slope * apart**self.exponent
        return late


def fit_curve(sources: Array, positions: Array, times_s: Array) -> Curve | None:
    """Return the curve that fits arrivals best; None where they do not grow with distance.

    Parameters
    ----------
    sources
        Shape (m, 2): places of the steps [m]; NaN where unknown.
    positions
        Shape (n, 2): of the sensors [m].
    times_s
        Shape (m, n): arrivals [s]; NaN where there is none.
    """
    apart = distances(sources, positions)
    valid = np.isfinite(times_s) & np.isfinite(apart)
    if valid.sum() < 2 * len(positions):
        return None
    curves = [_fitted(apart, times_s, valid, exponent) for exponent in EXPONENTS]
    good = [curve for curve in curves if curve.slope > 0]
    return min(good, key=lambda curve: curve.noise_s, default=None)


def _fitted(apart: Array, times_s: Array, valid: NDArray[np.bool_], exponent: float) -> Curve:
    """Fit by reweighting: residuals beyond :data:`HUBER` standard deviations count linearly."""
    u = np.where(valid, apart, 0.0) ** exponent
    t = np.where(valid, times_s, 0.0)
    weight = valid.astype(np.float64)
    for _ in range(PASSES):
        total_weight = np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        u_off = u - (weight * u).sum(axis=1, keepdims=True) / total_weight
        t_off = t - (weight * t).sum(axis=1, keepdims=True) / total_weight
        slope = float((weight * u_off * t_off).sum() / max((weight * u_off**2).sum(), 1e-12))
        left = t_off - slope * u_off
        noise_s = max(MAD_SIGMA * float(np.median(np.abs(left[valid]))), LEAST_NOISE_S)
        bound = HUBER * noise_s
        weight = valid * np.minimum(1.0, bound / np.maximum(np.abs(left), bound))
    received = valid.any(axis=1)
    origin = np.where(received, (t - slope * u - left)[:, 0], np.nan)
    return Curve(exponent, slope, origin, noise_s)


def blind_sources(positions: Array, arrivals: Arrivals, outline: Array | None) -> Array:
    """Return places of the steps from their arrivals alone, shape (m, 2) [m]; NaN with too few.

    By :mod:`~.localizers.tdoa`, which needs no calibration; with no more arrivals
    than it has unknowns there is no telling an arrival that is off.
    """
    sources = np.full((len(arrivals.step_ns), 2), np.nan)
    for row, times in enumerate(arrivals.times_s):
        if np.isfinite(times).sum() > tdoa.POWER_LAW_UNKNOWNS:
            location = tdoa.locate_power_law(positions, times, outline)
            sources[row] = location.x, location.y
    return sources
