"""Alignment of the clocks of two recordings, by the times of events that both have recorded.

Steps are nearly periodic: shifted by one step two walks still fit. The right shift shows in what is
not periodic: intervals that vary, starts, stops. Every possible shift is judged by how much
likelier its coincidences are than chance; where the second best is nearly as good, the alignment is
reported as ambiguous.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from groundtrace_codecs.device_clocks import DeviceClock, robust_line
from groundtrace_codecs.events import StepEvent
from groundtrace_codecs.recording import Recording
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from ..dsp.robust import MAD_SIGMA
from ..errors import RecordingError
from ..explain.suitability import with_placements
from ..pipeline.chain import build_pipeline
from ..pipeline.config import load_pipeline
from ..pipeline.engine import EventList, replay
from ..pipeline.plugins import stage_named
from ..pipeline.results import RUN, file_sha256, read_results
from ..pipeline.source import Source
from ..pipeline.stage import associates, detects

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event, Label

    Array = NDArray[np.float64]

#: Fewest moments that agree. Chosen by judgement: four agree by chance too often, as their shift
#: and drift take two.
LEAST_MATCHED = 5
#: The drift is estimated where its deviation is at most this [1e-6]: crystals differ by more.
#: Chosen by judgement.
DRIFT_SIGMA_PPM = 15.0
#: Two shifts nearer than this are one [s]. Chosen by judgement: as near as a step is matched.
_APART_S = 0.12
#: Moments further apart on the whole are taken to be so far apart [s]. Chosen by judgement: pauses
#: are no intervals of steps.
_LONGEST_S = 2.0
#: A shift without a second one must be this much likelier than chance. Source: definition: exp(8)
#: is 3000.
_CHANCE = 8.0
#: Scatter of moments that is taken for known before any are compared [s], and its weight. Chosen by
#: judgement: what pickers of steps scatter by, held like four moments.
_USUAL_S, _USUAL_WEIGHT = 0.015, 4


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentEvents:
    """What happened in a recording, and when it recorded.

    Attributes
    ----------
    times_ns
        Shape (n,), ascending [ns].
    start_ns, end_ns
        Of the recording [ns].
    """

    times_ns: NDArray[np.int64]
    start_ns: int
    end_ns: int

    @property
    def times_s(self) -> Array:
        """The moments since the recording's start, shape (n,) [s]."""
        since: Array = (self.times_ns - self.start_ns) / NS_PER_S
        return since

    @property
    def length_s(self) -> float:
        """Length of the recording [s]."""
        return (self.end_ns - self.start_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class Alignment:
    """The clock of a recording against that of another.

    Attributes
    ----------
    clock
        The clock.
    best, second
        The shift taken and the best other one; None where there is none.
    """

    clock: DeviceClock
    best: ClockShift
    second: ClockShift | None

    @property
    def margin(self) -> float:
        """Logarithm of how much likelier the best shift is than the second best, or than chance."""
        return self.best.score - (self.second.score if self.second is not None else 0.0)

    @property
    def needed(self) -> float:
        """What the margin must be, where as many moments agree with the second best."""
        return needed(self.best)

    @property
    def ambiguous(self) -> bool:
        """True where another shift, or chance, is nearly as good."""
        if self.second is None:
            return self.best.score < _CHANCE
        return not self.best.beats(self.second)


def align(
    reference: AlignmentEvents, other: AlignmentEvents, least: int = LEAST_MATCHED
) -> Alignment | None:
    """Find the clock of ``other`` against that of ``reference``.

    Parameters
    ----------
    reference, other
        Moments of the same events, some of which either may lack or have alone.
    least
        Fewest moments that must agree.

    Returns
    -------
    Alignment or None
        None where no shift makes ``least`` moments agree.
    """
    a, b = reference.times_s, other.times_s
    if min(len(a), len(b)) < least:
        return None
    steps = np.concatenate([np.diff(a), np.diff(b)])
    interval_s = min(float(np.median(steps)), _LONGEST_S)
    pair = _Pair(a, b, reference.length_s, other.length_s, interval_s)
    judged = [j for lag, drift in coinciding(a, b) if (j := pair.judged(lag, drift)) is not None]
    judged = [j for j in judged if j.shift.matched >= least]
    if not judged:
        return None
    most = max(judged, key=lambda j: j.shift.matched)
    shifts = sorted((j.with_alone(most.missing) for j in judged), key=lambda s: -s.score)
    best = shifts[0]
    apart = [s for s in shifts[1:] if abs(s.ahead_s - best.ahead_s) > _APART_S]
    rivals = [s for s in apart if not best.beats(s)]
    ahead_ns = other.start_ns - reference.start_ns + round(best.ahead_s * NS_PER_S)
    clock = DeviceClock(ahead_ns, best.drift_ppm, other.start_ns)
    return Alignment(clock, best, next(iter(rivals or apart), None))


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Moments of two recordings since their starts, shapes (n,), (m,) [s].

    ``a_length_s`` and ``b_length_s`` are the recordings' lengths, ``interval_s`` is the usual time
    from one moment to the next.
    """

    a: Array
    b: Array
    a_length_s: float
    b_length_s: float
    interval_s: float

    def judged(self, lag_s: float, drift_ppm: float) -> ShiftEvaluation | None:
        """Return what comes of a shift once it is refined; None where nothing agrees."""
        tolerance_s = min(0.35 * self.interval_s, 0.15)
        gained = drift_ppm * 1e-6
        i, j = self._pairs(lag_s, gained, tolerance_s)
        for _ in range(4):
            if len(i) < 2:
                break
            residual = self.b[j] * (1 - gained) - self.a[i]
            lag_s = float(np.median(residual))
            i, j = self._pairs(lag_s, gained, tolerance_s)
        return self._scored(lag_s, gained, i, j)

    def _pairs(
        self, lag_s: float, gained: float, tolerance_s: float
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return which moments are each other's nearest within the tolerance."""
        moved = self.b * (1 - gained) - lag_s
        to_a = _nearest(self.a, moved)
        to_b = _nearest(moved, self.a)
        mutual = to_b[to_a] == np.arange(len(moved))
        near = np.abs(moved - self.a[to_a]) <= tolerance_s
        j = np.flatnonzero(mutual & near)
        return to_a[j], j

    def _scored(
        self, lag_s: float, gained: float, i: NDArray[np.intp], j: NDArray[np.intp]
    ) -> ShiftEvaluation | None:
        if len(i) < 2:
            return None
        ahead = self.b[j] - self.a[i]
        line = robust_line(self.b[j], ahead)
        fitted = line.slope_sigma * 1e6 <= DRIFT_SIGMA_PPM
        fitted &= abs(line.slope) * 1e6 <= 2 * DRIFT_MAX_PPM
        residual = ahead - lag_s - gained * self.b[j]
        if fitted:
            gained, lag_s = line.slope, line.at - line.slope * line.about
            residual = ahead - line.value(self.b[j])
        else:
            gained = 0.0
            lag_s = float(np.median(ahead))
        sigma_s = _scatter(residual)
        count = len(i)
        far = line.slope_sigma * line.about if fitted else 0.0
        inside_a, inside_b = self._inside(lag_s)
        shift = ClockShift(
            ahead_s=lag_s,
            drift_ppm=gained / (1 - gained) * 1e6,
            matched=count,
            possible=int(min(inside_a.sum(), inside_b.sum())),
            sigma_s=sigma_s,
            ahead_sigma_s=float(np.hypot(1.25 * sigma_s / np.sqrt(count), far)),
            drift_sigma_ppm=line.slope_sigma * 1e6,
            drift_fitted=fitted,
            alone=0.0,
            worth=float(np.log(self.interval_s / (sigma_s * np.sqrt(2 * np.pi * math.e)))),
        )
        runs = _runs_alone(inside_a, i), _runs_alone(inside_b, j)
        return ShiftEvaluation(shift, runs, (int(inside_a.sum()), int(inside_b.sum())))

    def _inside(self, lag_s: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which moments of each, (n,) and (m,), lie where the other recorded too."""
        a = (self.a + lag_s >= 0) & (self.a + lag_s <= self.b_length_s)
        b = (self.b - lag_s >= 0) & (self.b - lag_s <= self.a_length_s)
        return a, b


def _runs_alone(inside: NDArray[np.bool_], partnered: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the lengths of runs of moments (n,) inside that lack a partner."""
    alone = inside.copy()
    alone[partnered] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alone[inside].astype(np.int8), [0]])))
    lengths: NDArray[np.intp] = edges[1::2] - edges[::2]
    return lengths


def _scatter(residual: Array) -> float:
    """Return the deviation of residuals (n,), few of them wrong, drawn to the usual one [s]."""
    residual = residual - np.median(residual)
    limit = 3 * MAD_SIGMA * float(np.median(np.abs(residual)))
    square = float(np.mean(residual[np.abs(residual) <= limit] ** 2))
    count, prior = len(residual), _USUAL_WEIGHT
    return float(np.sqrt((count * square + prior * _USUAL_S**2) / (count + prior)))


def _nearest(sorted_: Array, values: Array) -> NDArray[np.intp]:
    """Return which of ``sorted_`` (n,) is nearest to each of ``values`` (m,)."""
    right = np.clip(np.searchsorted(sorted_, values), 1, max(len(sorted_) - 1, 1))
    right = np.minimum(right, len(sorted_) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(values - sorted_[left]) <= np.abs(sorted_[right] - values)
    index: NDArray[np.intp] = np.where(nearer, left, right)
    return index


#: Clocks differ by no more than this [1e-6]. Chosen by judgement: crystals are sold with up to 100
#: ppm.
DRIFT_MAX_PPM = 100.0
#: Length of a bin in which moments are counted, and deviation of the Gaussian that smooths them
#: [s]. Chosen by judgement: below the scatter of moments; about twice it.
_BIN_S = 0.01
_SMOOTH_S = 0.03
#: Drift may move a moment by this over what both recorded without being searched for [s]. Chosen by
#: judgement: as much as the Gaussian smooths away anyhow.
_SMEAR_S = 0.04
#: Shifts that are tried in full. Chosen by judgement: it bounds the cost; a rhythm has a shift
#: every half second.
_CANDIDATES = 40
#: Candidates nearer than this are one [s]. Chosen by judgement: a refinement goes from one to the
#: other.
_ONE_S = 0.05


def coinciding(a: Array, b: Array) -> list[tuple[float, float]]:
    """Return the shifts [s] and drifts [1e-6] under which most moments coincide.

    The maxima of the cross-correlation of the two trains in bins of 10 ms, smoothed; where a drift
    would smear them, for drifts up to 100e-6 in steps that do not.

    Parameters
    ----------
    a, b
        Moments since the start of each recording, ascending, shapes (n,), (m,) [s].
    """
    shared_s = max(min(np.ptp(a), np.ptp(b)), 1.0)
    drifts = [0.0]
    if DRIFT_MAX_PPM * 1e-6 * shared_s > _SMEAR_S:
        count = int(np.ceil(DRIFT_MAX_PPM * 1e-6 * shared_s / _SMEAR_S))
        drifts = np.linspace(-DRIFT_MAX_PPM, DRIFT_MAX_PPM, 2 * count + 1).tolist()
    peaks = sorted((p for drift in drifts for p in _peaks(a, b, drift * 1e-6)), reverse=True)
    chosen: list[tuple[float, float]] = []
    for _, lag, gained in peaks:
        if len(chosen) < _CANDIDATES and all(abs(lag - other) > _ONE_S for other, _ in chosen):
            chosen.append((lag, gained * 1e6))
    return chosen


def _peaks(a: Array, b: Array, gained: float) -> list[tuple[float, float, float]]:
    """Return height, shift [s] and gain of the highest maxima of the correlation of two trains."""
    b = b * (1 - gained)
    size = int(max(np.ptp(a), np.ptp(b)) / _BIN_S) + 2
    offset_s = b[0] - a[0]
    trains = [
        np.bincount(np.rint((t - t[0]) / _BIN_S).astype(np.int64), minlength=size).astype(float)
        for t in (a, b)
    ]
    length = 1 << int(np.ceil(np.log2(2 * max(map(len, trains)))))
    spectra = [np.fft.rfft(t, length) for t in trains]
    together = np.fft.irfft(np.conj(spectra[0]) * spectra[1], length)
    together = np.fft.fftshift(together)
    half = round(3 * _SMOOTH_S / _BIN_S)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * _BIN_S / _SMOOTH_S) ** 2)
    smooth = np.convolve(together, kernel, "same")
    inner = smooth[1:-1]
    tops = np.flatnonzero((inner >= smooth[:-2]) & (inner > smooth[2:]) & (inner > 0.5)) + 1
    highest = tops[np.argsort(-smooth[tops], kind="stable")][:_CANDIDATES]
    return [
        (float(smooth[k]), (k - length // 2) * _BIN_S + offset_s, gained) for k in highest.tolist()
    ]


#: What the best shift must have over the second best, as a logarithm of likelihoods: a little, and
#: this many deviations of what two scatters of n moments that are alike differ by, the root of n.
#: Chosen by judgement: rather no shift than a wrong one: 3.5 deviations are chance once in 2000
#: times.
_MARGIN, _MARGIN_DEVIATIONS = 4.0, 3.5
#: Or this much by the number of moments that agree alone: two starts or stops that do not. Chosen
#: by judgement: a factor of three million.
_MARGIN_COUNTED = 15.0
#: Least and largest probability that a recording lacks a moment of the other, and the logarithm of
#: that it lacks any number in a row: a room hears nothing of a walk outside. Chosen by judgement:
#: no detector finds all, and where most is missed nothing is aligned.
_MISSED, _UNHEARD = (0.1, 0.6), -5.0


class ClockShift(NamedTuple):
    """One way to lay two recordings over each other.

    ``ahead_s`` is what the other's seconds since its start exceed those of the reference by, at its
    start; ``matched`` moments of ``possible`` agree with a scatter of ``sigma_s``, ``alone`` is
    the logarithm of how likely it is that so many of either have no partner where both recorded,
    ``worth`` of how much likelier than by chance one moment agrees so well.
    """

    ahead_s: float
    drift_ppm: float
    matched: int
    possible: int
    sigma_s: float
    ahead_sigma_s: float
    drift_sigma_ppm: float
    drift_fitted: bool
    alone: float
    worth: float

    @property
    def score(self) -> float:
        """Logarithm of how much likelier than by chance so many moments agree so well.

        By chance the nearest moment is anywhere within an interval; of one that agrees the
        distance is normal. Those that are alone were missed, or not heard for a while.
        """
        return self.matched * self.worth + self.alone

    def beats(self, other: ClockShift) -> bool:
        """Whether another shift is out of the question."""
        margin = self.score - other.score
        counted = (self.matched - other.matched) * self.worth + self.alone - other.alone
        return margin >= needed(self) or min(margin, counted) >= _MARGIN_COUNTED


class ShiftEvaluation(NamedTuple):
    """A shift, and the lengths of runs without a partner and the numbers of moments, of both."""

    shift: ClockShift
    runs: tuple[NDArray[np.intp], NDArray[np.intp]]
    counts: tuple[int, int]

    @property
    def missing(self) -> tuple[float, float]:
        """How likely it is that a moment of each recording lacks a partner."""
        low, high = _MISSED
        a, b = (min(max(1 - self.shift.matched / max(n, 1), low), high) for n in self.counts)
        return a, b

    def with_alone(self, missing: tuple[float, float]) -> ClockShift:
        """Return the shift with how likely its moments without partner are."""
        alone = sum(
            float(np.maximum(runs * np.log(each), _UNHEARD).sum())
            for runs, each in zip(self.runs, missing, strict=True)
        )
        return self.shift._replace(alone=alone)


def needed(best: ClockShift) -> float:
    """Return what its margin must be over a shift under which as many moments agree."""
    return _MARGIN + _MARGIN_DEVIATIONS * float(np.sqrt(best.matched))


#: Length of a bin of the strength of a signal [s]. Chosen by judgement: finer than an onset is
#: told.
_EVENT_BIN_S = 0.005
#: Impacts nearer than this are one [s], and how far before its peak one begins at most. Chosen by
#: judgement: an impact rings for less than 0.3 s and rises in less than 0.1 s.
_EVENTS_APART_S, _RISE_S = 0.3, 0.1
#: An impact reaches this part of the third strongest, and begins where this part of it is reached.
#: Chosen by judgement: the third strongest, so that two knocks on the sensor hide no step.
_STRONG, _ONSET = 0.5, 0.3
#: Impacts that are compared at most. Chosen by judgement: it bounds the cost.
_MOST = 40
_ACCELERATION = frozenset({"acceleration", "acceleration_magnitude"})


def steps_by_replay(
    recording: Recording, pipeline: str, progress: Callable[[int], None] | None = None
) -> AlignmentEvents:
    """Return the steps that a pipeline finds; its stages that place and track are left out.

    Parameters
    ----------
    recording
        What is replayed.
    pipeline
        Name or TOML file.
    progress
        Told the time reached [ns].
    """
    config, _, _ = with_placements(load_pipeline(pipeline), recording)
    kinds = {s.use: stage_named(s.use) for s in config.stage}
    finding = tuple(s for s in config.stage if detects(kinds[s.use]) or associates(kinds[s.use]))
    event_list = EventList()
    chain = build_pipeline(replace(config, stage=finding), labels=recording.labels)
    source = Source(recording, bridge_s=chain.bridge_s)
    replay(source, chain, [event_list], progress=progress)
    return AlignmentEvents(_steps(event_list.events), recording.start_ns, recording.end_ns)


def steps_of_results(path: Path, recording: Recording) -> AlignmentEvents:
    """Return the steps in results of a recording."""
    return AlignmentEvents(_steps(read_results(path).events), recording.start_ns, recording.end_ns)


def steps_of_labels(labels: Sequence[Label], recording: Recording) -> AlignmentEvents:
    """Return the steps and impacts that are labelled."""
    times = sorted({x.time_ns for x in labels if x.kind in ("step", "impact")})
    return AlignmentEvents(np.array(times, np.int64), recording.start_ns, recording.end_ns)


def results_beside(path: Path) -> Path | None:
    """Return the results of the whole of a recording that lie beside it or here, if any do."""
    name = f"{path.stem}.results.mcap"
    for candidate in dict.fromkeys((path.with_name(name), Path(name))):
        if not candidate.is_file():
            continue
        with Recording.open(candidate) as opened:
            if RUN not in opened.metadata:
                continue
        origin = read_results(candidate).provenance
        is_full = (origin.from_ns, origin.to_ns) == (None, None)
        if is_full and origin.sha256 == file_sha256(path):
            return candidate
    return None


def impacts(recording: Recording) -> AlignmentEvents:
    """Return the strongest impacts: of the seismic signals, or else of an accelerometer.

    An impact is a maximum, in bins of 5 ms, of the largest deviation of a channel from its median,
    of an accelerometer of that of its length, that reaches half of the third strongest. Its moment
    is where that first reaches 0.3 of the maximum.

    Raises
    ------
    RecordingError
        Where the recording has neither.
    """
    strength, start_ns, bin_ns = _strength(recording)
    times = [start_ns + round(k * bin_ns) for k in _standing_out(strength, bin_ns / NS_PER_S)]
    return AlignmentEvents(np.array(times, np.int64), recording.start_ns, recording.end_ns)


def _steps(events: Iterable[Event]) -> NDArray[np.int64]:
    """Return the steps of the stage that found most, by time; without any its impacts."""
    steps_by_stage: dict[tuple[bool, str, str], set[int]] = defaultdict(set)
    for event in events:
        if isinstance(event, StepEvent):
            steps_by_stage[event.kind == "step", event.stage, event.topic].add(event.time_ns)
    best = max(steps_by_stage, key=lambda key: (key[0], len(steps_by_stage[key])), default=None)
    return np.array(sorted(steps_by_stage[best]) if best is not None else [], np.int64)


def _strength(recording: Recording) -> tuple[Array, int, float]:
    """Return the strength in bins, shape (n,), the first one's time and their length [ns]."""
    streams = recording.streams
    chosen = [s for s in streams if s.columns_of(SEISMIC_QUANTITIES)]
    chosen = chosen or [s for s in streams if s.columns_of(_ACCELERATION)]
    if not chosen:
        raise RecordingError(
            f"{recording.name}: expected seismic signals or an accelerometer, found none"
        )
    stream = chosen[0]
    seismic = stream.columns_of(SEISMIC_QUANTITIES)
    columns = seismic or stream.columns_of(_ACCELERATION)
    bin_ns = max(_EVENT_BIN_S * NS_PER_S, stream.period_ns)
    peaks = np.zeros(int((recording.end_ns - recording.start_ns) / bin_ns) + 2)
    for item in Source(recording, topics=[stream.topic]):
        if isinstance(item, SignalBlock) and len(item):
            values = np.nan_to_num(item.values[:, columns])
            bins = ((item.sample_times() - recording.start_ns) / bin_ns).astype(np.int64)
            inside = (bins >= 0) & (bins < len(peaks))
            np.maximum.at(peaks, bins[inside], _height(values, seismic=bool(seismic))[inside])
    return peaks, recording.start_ns, bin_ns


def _height(values: Array, *, seismic: bool) -> Array:
    """Return how far each sample (n, n_channels) stands out, shape (n,)."""
    if not seismic:
        values = np.linalg.norm(values, axis=1, keepdims=True)
    values = values - np.median(values, axis=0)
    height: Array = np.abs(values).max(axis=1)
    return height


def _standing_out(strength: Array, bin_s: float) -> list[int]:
    """Return the bins in which the strongest impacts begin, in order."""
    apart, rise = max(1, round(_EVENTS_APART_S / bin_s)), max(1, round(_RISE_S / bin_s))
    taken: list[int] = []
    order = np.argsort(-strength, kind="stable")
    least = 0.0
    for k in order.tolist():
        if strength[k] <= least or len(taken) >= _MOST:
            break
        if all(abs(k - other) > apart for other in taken):
            taken.append(k)
            if len(taken) == 3:
                least = _STRONG * float(strength[k])
    starts = []
    for k in sorted(taken):
        before = strength[max(0, k - rise) : k + 1]
        reached = np.flatnonzero(before >= _ONSET * strength[k])
        starts.append(k - len(before) + 1 + int(reached[0]))
    return starts
