"""Reasons: why there is no step at a time, in the words of the stage that decided."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from groundtrace_codecs.events import Pick, StepEvent, readable, unit_after
from groundtrace_codecs.signals import NS_PER_S

from ..detectors.trace import FRAME_S
from ..errors import RecordingError
from ..evaluation.matching import (
    STEP_TOLERANCE_S,
    TrueSteps,
    answers_text,
    found_text,
    later_text,
    match,
    match_steps,
    off_text,
    step_reach_s,
    timing_pairs,
)
from ..evaluation.positions import ignored
from ..evaluation.vehicles import PASS_TOLERANCE_S
from ..localizers.base import LocalizerParameters
from ..pipeline.parameters import build
from ..pipeline.plugins import stage_named
from ..pipeline.results import step_times
from ..pipeline.stage import emitted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Gap, Label, StageSpec

    from ..evaluation.matching import StepMatch, TimingPair
    from ..pipeline.config import PipelineConfig
    from ..pipeline.gates import Candidates
    from ..pipeline.parameters import StageConfig
    from ..pipeline.results import Evidence, StageEvidence, Unmuted


@dataclass(frozen=True, slots=True)
class Chain:
    """One candidate and everything the gates said of it."""

    stage: str
    topic: str
    channel: str
    time_s: float
    accepted: bool
    readings: tuple[GateReading, ...]


def links(evidence: Evidence, part: StageEvidence, start_ns: int, end_ns: int) -> tuple[Chain, ...]:
    """Return the candidates of a stage with start <= time <= end and what the gates said."""
    return tuple(
        Chain(
            part.spec.stage,
            part.spec.topic,
            part.spec.channels[int(part.candidates.channel[row])],
            (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S,
            bool(part.accepted[row]),
            readings(part, int(row)),
        )
        for row in part.between(start_ns, end_ns)
    )


def locating(evidence: Evidence, stage: str = "") -> StageEvidence:
    """Return the evidence of a stage that locates by arrivals: the named one, else the last.

    Where the last stage of all that locates makes one place of what others found, the last is that
    of these others.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    configs = {config.key: config for config in evidence.config.stage}
    fixing = [p for p in evidence.stages if p.spec.emits == "fix"]
    parts = [p for p in fixing if by_arrivals(configs[p.spec.stage].use)]
    names = list(dict.fromkeys(p.spec.stage for p in parts))
    members = configs[fixing[-1].spec.stage].source if fixing else ()
    made_of = [name for name in names if name in members] or names
    wanted = stage or (made_of[-1] if made_of else "")
    stage_parts = [p for p in parts if p.spec.stage == wanted]
    if not stage_parts:
        expected = f"one of {', '.join(names)}" if names else "a stage that located steps"
        missing_text = "none (without the sensors' places nothing is located)"
        raise RecordingError(f"{evidence.name}: expected {expected}, found {stage or missing_text}")
    return max(stage_parts, key=lambda part: len(part.candidates))


def by_arrivals(plugin: str) -> bool:
    """Whether a plugin locates by arrivals: others give places by directions."""
    kind: Any = stage_named(plugin)
    return issubclass(kind.Parameters, LocalizerParameters)


def before(evidence: Evidence, part: StageEvidence, emits: tuple[str, ...]) -> StageEvidence:
    """Return the evidence of the last stage before one, on its topic, that emits a kind of event.

    Raises
    ------
    RecordingError
        Where there is none.
    """
    order = [stage.key for stage in evidence.config.stage]
    earlier = order[: order.index(part.spec.stage)]
    earlier_parts = [
        p
        for p in evidence.stages
        if p.spec.stage in earlier and p.spec.emits in emits and p.spec.topic == part.spec.topic
    ]
    if not earlier_parts:
        raise RecordingError(
            f"{evidence.name}: {part.spec.stage}: expected a stage that gives "
            f"{' or '.join(emits)} before it, found none"
        )
    return max(earlier_parts, key=lambda p: earlier.index(p.spec.stage))


def accepted_picks(part: StageEvidence) -> list[Pick]:
    """Return the picks of a stage on one topic, as decided."""
    c, spec = part.candidates, part.spec
    return [
        Pick(
            int(c.time_ns[row]),
            spec.channels[int(c.channel[row])],
            spec.topic,
            spec.stage,
            float("nan"),
            float(c.value[row, 0]),
        )
        for row in np.flatnonzero(part.accepted)
    ]


def onsets_of(evidence: Evidence, picking: StageEvidence) -> StageEvidence:
    """Return the stage whose onsets a picking stage has: itself, or of an array method its source.

    An array method mends the arrivals of a step by each other, which hides in part what is wrong
    with one channel; onsets are picked channel by channel.
    """
    uses = {config.key: config.use for config in evidence.config.stage}
    while any(n.buffered for n in stage_named(uses[picking.spec.stage]).takes):
        picking = before(evidence, picking, ("pick",))
    return picking


#: What is counted, by what the deciding stage emits; a later one here goes before an earlier.
CountedKind = Literal["presence", "pass", "step"]
KINDS: tuple[CountedKind, ...] = ("presence", "pass", "step")
#: Default tolerance of a match [s]. Source: those of the scores, and for presence that of a pass.
TOLERANCE_S: dict[CountedKind, float] = {
    "step": STEP_TOLERANCE_S,
    "pass": PASS_TOLERANCE_S,
    "presence": 1.0,
}
#: Cycles in which a station hears a vehicle, no further apart, are of one stay [s]; a stay that is
#: this far from any pass is of no vehicle that came by [s]. Chosen by judgement: a fading vehicle
#: is silent for less, and is heard for less before its pass.
_BRIDGE_S, _AWAY_S = 1.0, 15.0


class Truth(Protocol):
    """The truth of a recording, made ready once for many settings."""

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Return how the candidates that passed all gates, topic by topic, answer it."""


def scored_event(config: PipelineConfig) -> CountedKind:
    """Return what a sweep of a pipeline counts; steps where it has nothing else."""
    given = {emitted(stage_named(s.use)) for s in config.stage}
    return next((kind for kind in reversed(KINDS) if kind in given), "step")


def event_noun(kind: CountedKind) -> str:
    """Return how what is counted is called."""
    return "steps" if kind == "step" else "passes"


def matched(evidence: Evidence, tolerance_s: float) -> StepMatch:
    """Match the steps of a result, as decided, to its truth."""
    e = evidence
    return match_steps(e.labels, step_times(e), e.start_ns, e.end_ns, tolerance_s)


def truth_for(evidence: Evidence, labels: Sequence[Label], tolerance_s: float) -> Truth:
    """Return the truth of what a pipeline's sweep counts."""
    kind = scored_event(evidence.config)
    if kind == "step":
        steps = TrueSteps.of(labels, evidence.start_ns, evidence.end_ns, tolerance_s)
        return StepTruth(steps)
    stations = {}
    if evidence.geometry is not None:
        site = evidence.geometry.stations()
        stations = {channel: site.names[index] for channel, index in site.of_channel.items()}
    times: dict[str, list[int]] = {}
    true = [x for x in labels if x.kind == "pass"]
    left_out = ignored(labels, np.array([x.time_ns for x in true], np.int64))
    for label, no in zip(true, left_out, strict=True):
        if not no:
            times.setdefault(label.channel, []).append(label.time_ns)
    truth = {name: np.array(sorted(those), np.int64) for name, those in sorted(times.items())}
    return PassTruth(truth, stations, tuple(labels), tolerance_s, while_present=kind == "presence")


@dataclass(frozen=True, slots=True, eq=False)
class StepTruth:
    """True steps.

    Attributes
    ----------
    steps
        Those that are scored.
    """

    steps: TrueSteps

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Match the times of all topics."""
        matching = self.steps.match(times_of(passed))
        hit = np.zeros(len(matching.truth_ns), np.bool_)
        hit[matching.pairs[:, 0]] = True
        return Verdicts(hit, matching.found_ns[matching.false])


@dataclass(frozen=True, slots=True, eq=False)
class PassTruth:
    """True passes at stations.

    Attributes
    ----------
    times_ns
        Of each station, sorted [ns].
    stations
        The station of each channel; one that is not there is a station itself.
    labels
        All truth: what is to be ignored.
    tolerance_s
        Of the match [s].
    while_present
        Whether it is enough that the station hears a vehicle at the moment; what it hears a
        quarter of a minute from any pass, without a break, then counts as one false.
    """

    times_ns: dict[str, NDArray[np.int64]]
    stations: dict[str, str]
    labels: tuple[Label, ...]
    tolerance_s: float
    while_present: bool

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Match station by station."""
        detected_ns = self._times_by_station(passed)
        none = np.empty(0, np.int64)
        hits, false = [np.empty(0, np.bool_)], [none]
        judge = self._by_presence if self.while_present else self._one_to_one
        for station in sorted({*self.times_ns, *detected_ns}):
            truth = self.times_ns.get(station, none)
            hit, wrong = judge(truth, detected_ns.get(station, none))
            hits.append(hit)
            false.append(wrong)
        wrong = np.concatenate(false)
        return Verdicts(np.concatenate(hits), wrong[~ignored(self.labels, wrong)])

    def _times_by_station(
        self, passed: Sequence[tuple[StageSpec, Candidates]]
    ) -> dict[str, NDArray[np.int64]]:
        parts: dict[str, list[NDArray[np.int64]]] = {}
        for spec, candidates in passed:
            for number, channel in enumerate(spec.channels):
                station = self.stations.get(channel, channel)
                rows = candidates.channel == number
                parts.setdefault(station, []).append(candidates.time_ns[rows])
        return {name: np.sort(np.concatenate(times)) for name, times in parts.items()}

    def _one_to_one(
        self, truth: NDArray[np.int64], detected_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        origin = truth[0] if len(truth) else 0
        pairs = match(
            (truth - origin) / NS_PER_S, (detected_ns - origin) / NS_PER_S, self.tolerance_s
        )
        hit, right = np.zeros(len(truth), np.bool_), np.zeros(len(detected_ns), np.bool_)
        hit[pairs[:, 0]], right[pairs[:, 1]] = True, True
        return hit, detected_ns[~right]

    def _by_presence(
        self, truth: NDArray[np.int64], detected_ns: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        hit = _away(truth, detected_ns) <= self.tolerance_s
        new = np.diff(detected_ns, prepend=-(2**62)) > _BRIDGE_S * NS_PER_S
        stays = detected_ns[new]
        far = _away(detected_ns, truth) > _AWAY_S
        # a stay is false where all of it is far from any pass
        number = np.cumsum(new) - 1
        near = np.bincount(number[~far], minlength=len(stays)) > 0
        return hit, stays[~near]


def _away(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how far each time is from the nearest other, shape (n,) [s]."""
    if not len(others):
        return np.full(len(times), np.inf)
    after = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
    after = np.minimum(after, len(others) - 1)
    apart = np.minimum(np.abs(times - others[after]), np.abs(times - others[after - 1]))
    return np.asarray(apart / NS_PER_S, np.float64)


def times_of(passed: Sequence[tuple[StageSpec, Candidates]]) -> NDArray[np.int64]:
    """Return the times of candidates of all topics [ns]."""
    if len(passed) == 1:
        return passed[0][1].time_ns
    return np.concatenate(
        [np.empty(0, np.int64), *(candidates.time_ns for _, candidates in passed)]
    )


@dataclass(frozen=True, slots=True)
class GateReading:
    """What one gate said of one candidate."""

    gate: str
    unit: str
    parameter: str
    value: float
    threshold: float
    margin: float
    passed: bool


def readings(part: StageEvidence | CandidateBlock, row: int) -> tuple[GateReading, ...]:
    """Return what every gate said of a candidate."""
    return tuple(
        GateReading(
            gate.name,
            gate.unit,
            gate.parameter,
            float(part.gate_value[row, i]),
            gate.threshold,
            float(part.margin[row, i]),
            bool(part.margin[row, i] >= 0),
        )
        for i, gate in enumerate(part.spec.gates)
    )


def closeness(part: StageEvidence, row: int, time_ns: int) -> tuple[int, float, int]:
    """Return what orders candidates: gates failed, then shortfall, then distance in time."""
    margin = part.margin[row]
    scale = [max(abs(g.threshold), 1e-9) for g in part.spec.gates]
    short = np.where(margin < 0, -margin / scale, 0.0)
    failed = int((~(margin >= 0)).sum())
    return failed, float(np.nansum(short)), abs(int(part.candidates.time_ns[row]) - time_ns)


def told_apart(value: float, other: float, digits: int = 4) -> tuple[str, str]:
    """Return two numbers with as many digits as show which is the larger, at least ``digits``."""
    for precision in range(digits, 18):
        texts = f"{value:.{precision}g}", f"{other:.{precision}g}"
        shown = float(texts[0]), float(texts[1])
        if (shown[0] < shown[1], shown[0] > shown[1]) == (value < other, value > other):
            return readable(value, precision), readable(other, precision)
    return f"{value!r}", f"{other!r}"


def below(reading: GateReading) -> str:
    """Return value, threshold and margin of a failed gate as a phrase that its numbers bear out."""
    unit = unit_after(reading.unit)
    if np.isnan(reading.value):
        return f"{reading.gate} is no number, the threshold is {readable(reading.threshold)}{unit}"
    # a time is stored rounded: one that just fails may read as the threshold itself
    at_threshold = reading.value == reading.threshold
    measured = reading.threshold - abs(reading.margin) if at_threshold else reading.value
    value, threshold = told_apart(measured, reading.threshold)
    sign = "<" if measured < reading.threshold else ">"
    margin = readable(reading.margin, 3)
    return f"{reading.gate} {value}{unit} {sign} {threshold}{unit} (margin {margin})"


def timed(off_s: float) -> str:
    """Return how late (> 0) or early something is as a phrase."""
    return f"{abs(off_s) * 1e3:.1f} ms {'late' if off_s > 0 else 'early'}"


#: Chosen by judgement: an end of an interval is then off by about a tenth of it.
DRAWS = 200
SEED = 20_170_319
#: Ends of the interval that holds nine of ten draws [%]. Source: definition.
ENDS = (5.0, 95.0)


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """How one setting did on one recording, step by step.

    Attributes
    ----------
    hit
        Shape (n_truth,), bool: which true steps are found.
    false_ns
        Times of the detections that answer no true step [ns].
    """

    hit: NDArray[np.bool_]
    false_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Interval:
    """An interval that holds nine of ten draws."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class TestedInterval(Interval):
    """An interval of a change, and how likely draws so far from no change are without one.

    Attributes
    ----------
    p
        Of the two sides; below 0.1 where the interval is on one side of no change.
    """

    p: float


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """How sure the F1 of settings is.

    Attributes
    ----------
    f1
        Of each setting.
    behind
        How far each setting is behind the first one.
    """

    f1: tuple[Interval, ...]
    behind: tuple[Interval, ...]

    def worse(self, row: int) -> bool:
        """Whether a setting is told apart from the first one, as the worse."""
        return self.behind[row].low > 0


@dataclass(frozen=True, slots=True, eq=False)
class RatioOfSums:
    """A figure of many recordings as the ratio of two sums: a pooled F1, or a mean.

    Attributes
    ----------
    top, bottom
        What each recording adds to either, shape (n,).
    """

    top: NDArray[np.float64]
    bottom: NDArray[np.float64]

    def value(self) -> float:
        """Return the figure; NaN where nothing is summed."""
        bottom = float(self.bottom.sum())
        return float(self.top.sum()) / bottom if bottom else float("nan")

    def by_group(self, groups: NDArray[np.intp]) -> RatioOfSums:
        """Return the same figure of whole groups.

        Parameters
        ----------
        groups
            Number of each recording's group, from 0, shape (n,).
        """
        top, bottom = (np.bincount(groups, part) for part in (self.top, self.bottom))
        return RatioOfSums(top.astype(np.float64), bottom.astype(np.float64))


def interval_of_change(before: RatioOfSums, after: RatioOfSums) -> TestedInterval | None:
    """Return the interval of a figure's change over n recordings, or groups of them.

    Those of both are in the same order. The change is computed n times, each time without one of
    them; how much these differ is its error (jackknife: Efron and Tibshirani 1993, An Introduction
    to the Bootstrap, eq. 11.5), and the interval is Student's with n - 1 degrees of freedom. It
    needs no draws, and holds the truth more often: ``bench: fleet_intervals.py``.

    Returns
    -------
    The interval of after minus before that holds nine of ten, and p; None where n < 2 or a figure
    hangs on one of them.
    """
    from scipy.special import stdtr, stdtrit

    n = len(before.top)
    bottoms = before.bottom.sum() - before.bottom, after.bottom.sum() - after.bottom
    if n < 2 or not (bottoms[0].all() and bottoms[1].all()):
        return None
    change = after.value() - before.value()
    without = (after.top.sum() - after.top) / bottoms[1]
    without = without - (before.top.sum() - before.top) / bottoms[0]
    error = float(np.sqrt((n - 1) * without.var()))
    half = float(stdtrit(n - 1, ENDS[1] / 100)) * error
    p = 2 * stdtr(n - 1, -abs(change) / error) if error else float(change == 0)
    return TestedInterval(change - half, change + half, float(p))


def bootstrap(settings: Sequence[Sequence[Verdicts]]) -> Confidence:
    """Return the confidence of settings, each a sequence of verdicts, one for each recording.

    True steps are drawn with replacement; every false detection counts as often as a Poisson
    number of mean 1 says. All settings see the same draws, so that two which err at the same steps
    are compared at the same steps. The seed is fixed: the same verdicts give the same intervals.
    """
    rng = np.random.default_rng(SEED)
    hit = np.array([np.concatenate([v.hit for v in s]) for s in settings], np.float64)
    false = _occurrence(settings)
    n = hit.shape[1]
    steps = rng.multinomial(n, np.full(n, 1 / n), size=DRAWS).astype(np.float64)
    right = steps @ hit.T
    wrong = rng.poisson(1.0, (DRAWS, false.shape[1])).astype(np.float64) @ false.T
    f1 = 2 * right / (n + right + wrong)
    return Confidence(_intervals(f1), _intervals(f1[:, :1] - f1))


def _occurrence(settings: Sequence[Sequence[Verdicts]]) -> NDArray[np.float64]:
    """Return which false detections each setting has, of all that any has."""
    keys = [[(r, t) for r, v in enumerate(s) for t in v.false_ns.tolist()] for s in settings]
    every = {key for false_keys in keys for key in false_keys}
    column = {key: i for i, key in enumerate(sorted(every))}
    out = np.zeros((len(settings), len(column)))
    for row, false_keys in enumerate(keys):
        for key in false_keys:
            out[row, column[key]] += 1
    return out


def _intervals(values: NDArray[np.float64]) -> tuple[Interval, ...]:
    low, high = np.percentile(values, ENDS, axis=0)
    return tuple(Interval(float(a), float(b)) for a, b in zip(low, high, strict=True))


#: The cause of a miss, in one word; ``score`` and fleets count them.
CAUSES = (
    "timing",
    "refractory",
    "threshold",
    "coincidence",
    "dead",
    "clipped",
    "filter",
    "quiet",
    "shape",
    "walking",
    "gap",
    "taken",
    "dropped",
    "undecided",
)


FILTERED = "attenuated by the filter (change the band and replay)"


@dataclass(frozen=True, slots=True)
class Reason:
    """Why nothing was accepted at a time.

    Attributes
    ----------
    cause
        One of :data:`CAUSES`.
    text
        The same for people.
    stage, topic, channel
        Where.
    candidate_s
        Time of the nearest candidate [s since the first sample], or None.
    gate
        Name of the first gate that failed, or empty.
    readings
        All gates of that candidate, in order.
    channels
        For a group of picks: why each missing channel is missing.
    """

    cause: str
    text: str
    stage: str
    topic: str
    channel: str = ""
    candidate_s: float | None = None
    gate: str = ""
    readings: tuple[GateReading, ...] = ()
    channels: tuple[str, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class WrongTime:
    """A true step found at the wrong time: a missed and a false step that are one error.

    Attributes
    ----------
    step
        Number of the true step among the scored ones, from 1.
    time_s, found_s
        Of the true step and of its detection [s since the first sample].
    late_ms
        By how much it was found late (> 0) or early [ms].
    text
        What the detection is, for people: ``answers step 12, 126 ms late``.
    """

    step: int
    time_s: float
    found_s: float
    late_ms: float
    text: str


class StepReasons:
    """Says why there is no step at a time; knows which steps were found at the wrong one.

    Parameters
    ----------
    evidence
        Of the result, as decided.
    tolerance_s
        Candidates up to this far away count.
    matching
        What the detections answer; by default the true steps of the evidence.
    """

    def __init__(
        self, evidence: Evidence, tolerance_s: float, matching: StepMatch | None = None
    ) -> None:
        self.evidence = evidence
        self.tolerance_s = tolerance_s
        self.matching = matched(evidence, tolerance_s) if matching is None else matching
        self.pairs = timing_pairs(self.matching)
        self._by_time = {p.found_ns: p for p in self.pairs} | {p.truth_ns: p for p in self.pairs}
        #: What the time of a step is told by: true steps, or where none are known those found.
        known_ns = self.matching.truth_ns if len(self.matching.truth_ns) else step_times(evidence)
        self._known_s = (known_ns - evidence.start_ns) / NS_PER_S

    def pair_of(self, time_ns: int) -> TimingPair | None:
        """Return the pair whose true step, or whose detection, is at a time."""
        return self._by_time.get(time_ns)

    def wrong_time(self, time_ns: int) -> WrongTime | None:
        """Return the pair whose true step, or whose detection, is at a time, as it is told."""
        pair = self.pair_of(time_ns)
        if pair is None:
            return None
        start_ns = self.evidence.start_ns
        return WrongTime(
            pair.step,
            (pair.truth_ns - start_ns) / NS_PER_S,
            (pair.found_ns - start_ns) / NS_PER_S,
            pair.late_ns / 1e6,
            answers_text(pair, self.tolerance_s),
        )

    def at(self, time_ns: int) -> Reason:
        """Say why there is no step at a time, that of a true step or any other."""
        evidence = self.evidence
        if not evidence.config.stage:
            return Reason("undecided", "the pipeline has no stage: nothing decides", "", "")
        within = round(self.tolerance_s * NS_PER_S)
        final = _last_stage(evidence, "step") or evidence.config.stage[-1].key
        near = self._candidates(final, time_ns, within)
        pair = self.pair_of(time_ns)
        if pair is not None and pair.truth_ns == time_ns:
            return self._last_stage_reason(final, pair, near)
        finder = _finder(evidence, final)
        if finder and not near:  # what found no step gave none to the stage that works on steps
            candidates = self._candidates(finder, time_ns, within)
            given = [(part, row) for part, row in candidates if part.accepted[row]]
            if given:
                part, row = min(given, key=lambda item: closeness(item[0], item[1], time_ns))
                text = f"{finder} finds it, {final} does not give it again"
                return replace(self._timing(part, row, text), cause="dropped")
            final, near = finder, candidates
        if near:
            part, row = min(near, key=lambda item: closeness(item[0], item[1], time_ns))
            return self._failed(part, row, time_ns, within)
        far = self._candidates(final, time_ns, self._reach_ns(time_ns))
        nearest = [item for item in far if self._is_nearest(item, time_ns)]
        accepted = any(part.accepted[row] for part, row in nearest)
        nothing = None if accepted else _nothing(evidence, final, time_ns, within)
        # a candidate farther off that is no step says little where there was no signal at all
        if nothing is not None and (not nearest or nothing.cause in {"gap", "dead"}):
            return nothing
        part, row = min(nearest, key=lambda item: closeness(item[0], item[1], time_ns))
        return self._off(part, row, time_ns)

    def _candidates(self, stage: str, time_ns: int, reach: int) -> list[tuple[StageEvidence, int]]:
        return [
            (part, int(row))
            for part in self.evidence.of(stage)
            for row in part.between(time_ns - reach, time_ns + reach)
        ]

    def _reach_ns(self, time_ns: int) -> int:
        at_s = np.array([(time_ns - self.evidence.start_ns) / NS_PER_S])
        return round(float(step_reach_s(self._known_s, at_s)[0]) * NS_PER_S)

    def _is_nearest(self, item: tuple[StageEvidence, int], time_ns: int) -> bool:
        """Whether a candidate is nearer to a time than to any true step that is not there."""
        part, row = item
        found_ns = int(part.candidates.time_ns[row])
        others = self.matching.truth_ns[self.matching.truth_ns != time_ns]
        return bool((np.abs(others - found_ns) >= abs(found_ns - time_ns)).all())

    def _last_stage_reason(
        self, stage: str, pair: TimingPair, near: list[tuple[StageEvidence, int]]
    ) -> Reason:
        """Say that a step was found at the wrong time, and what became of candidates in time."""
        text = found_text(pair, self.tolerance_s)
        rejected = [(part, row) for part, row in near if not part.accepted[row]]
        if rejected:
            part, row = min(rejected, key=lambda item: closeness(item[0], item[1], pair.truth_ns))
            off_ns = int(part.candidates.time_ns[row]) - pair.truth_ns
            first = next(r for r in readings(part, row) if not r.passed)
            text = f"{text}; a candidate {later_text(off_ns)} is rejected: {below(first)}"
        part, row = next(
            (part, int(row))
            for part in self.evidence.of(stage)
            for row in part.between(pair.found_ns, pair.found_ns)
            if part.accepted[row]
        )
        return self._timing(part, row, text)

    def _off(self, part: StageEvidence, row: int, time_ns: int) -> Reason:
        """Say that the candidate of a step lies beyond the tolerance, and what rejects it too."""
        found_ns = int(part.candidates.time_ns[row])
        off, tolerance = off_text(found_ns - time_ns, self.tolerance_s)
        first = next((r for r in readings(part, row) if not r.passed), None)
        other = self.pair_of(found_ns)
        if first is not None:
            text = f"a candidate {off} (tolerance {tolerance} ms), which {below(first)} rejects too"
            cut_short = _cut_short(self.evidence, part, first, time_ns)
            text = "; ".join(filter(None, (text, cut_short)))
            return self._timing(part, row, text, first.gate)
        if other is None:
            return self._timing(part, row, f"found {off}, tolerance {tolerance} ms")
        text = f"the detection {off} answers step {other.step}"
        return replace(self._timing(part, row, text), cause="taken")

    def _timing(self, part: StageEvidence, row: int, text: str, gate: str = "") -> Reason:
        spec = part.spec
        channel = spec.channels[int(part.candidates.channel[row])]
        at_s = (int(part.candidates.time_ns[row]) - self.evidence.start_ns) / NS_PER_S
        where = (spec.stage, spec.topic, channel, at_s)
        return Reason("timing", text, *where, gate, readings(part, row))

    def _failed(self, part: StageEvidence, row: int, time_ns: int, reach: int) -> Reason:
        """Say which gate a candidate failed first, or whose it is."""
        if not part.accepted[row]:
            return _failed(self.evidence, part, row, time_ns, reach)
        found_ns = int(part.candidates.time_ns[row])
        matching = self.matching
        answered = matching.truth_ns[
            matching.pairs[matching.found_ns[matching.pairs[:, 1]] == found_ns, 0]
        ]
        step = "another step"
        if len(answered):
            step = f"step {int(np.searchsorted(matching.truth_ns, answered[0])) + 1}"
        at_s = (found_ns - self.evidence.start_ns) / NS_PER_S
        text = f"its detection at {at_s:.3f} s answers {step}"
        return replace(self._timing(part, row, text), cause="taken")


def reason_at(evidence: Evidence, time_ns: int, tolerance_s: float) -> Reason:
    """Say why there is no step at one time; of several, ask one :class:`StepReasons`.

    Parameters
    ----------
    evidence
        Of the result, as decided.
    time_ns
        The moment.
    tolerance_s
        Candidates up to this far away count.
    """
    return StepReasons(evidence, tolerance_s).at(time_ns)


def _last_stage(evidence: Evidence, emits: str) -> str:
    stages = [part.spec.stage for part in evidence.stages if part.spec.emits == emits]
    return stages[-1] if stages else ""


def _finder(evidence: Evidence, stage: str) -> str:
    """Return whose steps a stage gives again, as one that tells their types; else nothing."""
    order = [each.key for each in evidence.config.stage]
    if stage not in order:
        return ""
    index = order.index(stage)
    if not any(
        need.kind is StepEvent for need in stage_named(evidence.config.stage[index].use).takes
    ):
        return ""
    before = [p.spec for p in evidence.stages if p.spec.stage in order[:index]]
    return next((spec.stage for spec in reversed(before) if spec.emits == "step"), "")


def _failed(evidence: Evidence, part: StageEvidence, row: int, time_ns: int, reach: int) -> Reason:
    """Say which gate a rejected candidate failed first."""
    all_readings = readings(part, row)
    at_s = (int(part.candidates.time_ns[row]) - evidence.start_ns) / NS_PER_S
    channel = part.spec.channels[int(part.candidates.channel[row])]
    spec = part.spec
    first = next(r for r in all_readings if not r.passed)
    cause, text, missing = _verdict(evidence, part, row, first, time_ns, reach)
    more = [r.gate for r in all_readings if not r.passed and r.gate != first.gate]
    if more:
        text = f"{text}; {' and '.join(more)} would fail too"
    return Reason(
        cause, text, spec.stage, spec.topic, channel, at_s, first.gate, all_readings, missing
    )


def _verdict(
    evidence: Evidence,
    part: StageEvidence,
    row: int,
    first: GateReading,
    time_ns: int,
    reach: int,
) -> tuple[str, str, tuple[str, ...]]:
    """Return cause, sentence and, for a group of picks, the missing channels."""
    if first.gate == "refractory":
        return "refractory", _merged(first), ()
    if not part.spec.trace:  # a group of picks: say what its channels lack
        return _group_short_of(evidence, part, row, first, time_ns, reach)
    if first.gate == "activity":
        return "walking", f"no walking detected: {below(first)}", ()
    channel = 0
    hint = silence(part, channel, time_ns - reach, time_ns + reach)
    if hint.cause in {"clipped", "dead"} and len(part.spec.channels) == 1:
        return hint.cause, f"{below(first)}; {hint.text}", ()
    if len(part.spec.channels) == 1 and evidence.unfiltered is not None:
        clipping = evidence.unfiltered.clipped(part, time_ns - reach, time_ns + reach)
        if clipping is not None:
            channel_text = f"{clipping[0]} is clipped: it stands still at its extreme"
            return "clipped", f"{below(first)}; {channel_text} for {clipping[1] * 1e3:.0f} ms", ()
    cut_short = _cut_short(evidence, part, first, time_ns)
    if cut_short:
        return "gap", f"{below(first)}; {cut_short}", ()
    return "threshold", below(first) + _of_usual(evidence, part, row), ()


def _cut_short(evidence: Evidence, part: StageEvidence, reading: GateReading, time_ns: int) -> str:
    """Say that less of the signal is heard between gaps than what a gate looks at is told by."""
    need_s = _said_by_kind(evidence, part, "told_by_s", {}).get(reading.gate, 0.0)
    gaps = [g for g in evidence.gaps if g.topic in (part.spec.topic, "") and not g.bridged]
    begin_ns = max((g.end_ns for g in gaps if g.end_ns <= time_ns), default=evidence.start_ns)
    end_ns = min((g.start_ns for g in gaps if g.start_ns >= time_ns), default=2**63)
    if end_ns - begin_ns >= need_s * NS_PER_S:
        return ""
    begin_s, end_s = ((t - evidence.start_ns) / NS_PER_S for t in (begin_ns, end_ns))
    return (
        f"the signal is heard from {begin_s:.3f} to {end_s:.3f} s, and {reading.gate} is told by "
        f"{need_s:g} s or more"
    )


def _said_by_kind(evidence: Evidence, part: StageEvidence, name: str, default: Any) -> Any:
    """Return what the class of a stage says by an attribute that it need not have."""
    stage = next((s for s in evidence.config.stage if s.key == part.spec.stage), None)
    return default if stage is None else getattr(stage_named(stage.use), name, default)


def _of_usual(evidence: Evidence, part: StageEvidence, row: int) -> str:
    """Say what there is of a usual step in a candidate, where its stage measures that."""
    shares = _said_by_kind(evidence, part, "of_usual", ())
    names = [column.name for column in part.spec.columns]
    measured = {n: float(part.candidates.value[row, names.index(n)]) for n in shares if n in names}
    if not measured or not np.isfinite(list(measured.values())).all():
        return ""
    return f"; {' and '.join(f'{n} {x:.2f}' for n, x in measured.items())} of a usual step"


def _group_short_of(
    evidence: Evidence,
    part: StageEvidence,
    row: int,
    first: GateReading,
    time_ns: int,
    reach: int,
) -> tuple[str, str, tuple[str, ...]]:
    """Say what the missing channels of a group of picks lack.

    A step is named by its coincidence where too few channels felt it. Those that are broken, lose
    it to the filter, or are held off by the refractory gate, as which only a candidate is that
    passes every level, say nothing against that: they are the cause where they would be enough.
    """
    missing = missing_channels(evidence, part, time_ns, reach, _span_of_group(part, row))
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    if first.gate != "channels":
        return "coincidence", below(first), names
    text = f"picked on {first.value:g} of {first.threshold:g} channels needed"
    cause = "coincidence"
    for other in ("refractory", "dead", "clipped", "filter"):
        if first.value + sum(m.cause == other for m in missing) >= first.threshold:
            cause = other
    source, signal = _upstream(evidence, part), evidence.unfiltered
    filtered = cause == "coincidence" and any(m.cause == "filter" for m in missing)
    if filtered and source is not None and signal is not None:
        group = signal.group(part, source, time_ns - reach, time_ns + reach)
        if group is not None:
            cause = "filter"
            text = f"{text}, by {group.value:g} without the filter (change the band and replay)"
    return cause, "; ".join([f"{text}: {names[0]}", *names[1:]]) if names else text, names


def _span_of_group(part: StageEvidence, row: int) -> tuple[int, int]:
    """Return first and last pick of a group [ns]; its candidate may hold how long it lasted."""
    begin = int(part.candidates.time_ns[row])
    names = [column.name for column in part.spec.columns]
    length_s = float(part.candidates.value[row, names.index("span")]) if "span" in names else 0.0
    return begin, begin + round(length_s * NS_PER_S) + 1000  # the stored length is rounded


def _merged(reading: GateReading) -> str:
    # a time is stored rounded: one that just fails may read as the threshold itself
    since_s = min(reading.value, reading.threshold - abs(reading.margin))
    since, least = told_apart(since_s * 1e3, reading.threshold * 1e3, 3)
    return f"merged with the step {since} ms earlier by the refractory gate ({least} ms)"


def _nothing(evidence: Evidence, stage: str, time_ns: int, reach: int) -> Reason:
    """Say why the final stage had no candidate at all."""
    parts = evidence.of(stage)
    if not parts:
        return Reason("quiet", "the stage ran on no stream", stage, "")
    part = parts[0]
    gap = _gap_at(evidence, part.spec.topic, time_ns - reach, time_ns + reach)
    if gap is not None:
        start_s, end_s = ((t - evidence.start_ns) / NS_PER_S for t in (gap.start_ns, gap.end_ns))
        text = f"no signal: {gap.reason} at {start_s:.3f} s"
        if gap.end_ns > gap.start_ns:
            lost = f"{gap.reason}, {gap.lost} samples"
            lines = ", straight lines in their place" if gap.bridged else ""
            text = f"no signal from {start_s:.3f} to {end_s:.3f} s: {lost}{lines}"
        return Reason("gap", text, stage, part.spec.topic)
    within_ms = f"{reach / 1e6:.6g} ms"
    if part.spec.trace:
        cause, text = silent(evidence, part, 0, time_ns, reach)
        nearest = _nearest_text(part, time_ns)
        text = f"no candidate within {within_ms}: {text}{nearest}"
        return Reason(cause, text, stage, part.spec.topic)
    missing = missing_channels(evidence, part, time_ns, reach)
    names = tuple(f"{m.channel} {m.text}" for m in missing)
    source = _upstream(evidence, part)
    signal = evidence.unfiltered
    if source is not None and signal is not None and signal.at_hand:
        group = signal.group(part, source, time_ns - reach, time_ns + reach)
        if group is not None:
            text = (
                f"{FILTERED}: without it {group.value:g} channels pick it "
                f"{later_text(group.time_ns - time_ns)}; no channel was picked: "
            )
            where = (stage, part.spec.topic)
            return Reason("filter", text + "; ".join(names), *where, channels=names)
    causes = [m.cause for m in missing]
    specific_causes = [cause for cause in causes if cause != "quiet"]
    # where most channels were quiet, what a few have of their own does not explain it
    quiet = 2 * len(specific_causes) < len(causes) or not specific_causes
    cause = "quiet" if quiet else max(specific_causes, key=specific_causes.count)
    picked = "taken" in causes or source is None or len(names) < len(source.spec.channels)
    text = f"no group of picks within {within_ms}" if picked else "no channel was picked"
    return Reason(
        cause,
        ": ".join(filter(None, (text, "; ".join(names)))),
        stage,
        part.spec.topic,
        channels=names,
    )


def _gap_at(evidence: Evidence, topic: str, start_ns: int, end_ns: int) -> Gap | None:
    """Return what took the signal of a span: a gap that ended a run, or filled ones of half of it.

    Filled ones are returned as one.
    """
    gaps = [g for g in evidence.gaps if g.topic in (topic, "")]
    gaps = [g for g in gaps if g.start_ns <= end_ns and g.end_ns >= start_ns]
    ended = next((g for g in gaps if not g.bridged), None)
    filled = [g for g in gaps if g.filled]
    lost_ns = sum(min(g.end_ns, end_ns) - max(g.start_ns, start_ns) for g in filled)
    if ended is not None or 2 * lost_ns < end_ns - start_ns:
        return ended
    first = min(filled, key=lambda g: g.start_ns)
    end_ns, lost = max(g.end_ns for g in filled), sum(g.lost for g in filled)
    return replace(first, end_ns=end_ns, lost=lost)


def _nearest_text(part: StageEvidence, time_ns: int) -> str:
    """Say where the nearest candidate is; it belongs to another step."""
    if not len(part.candidates):
        return "; there is no candidate at all"
    times = part.candidates.time_ns
    off_ns = int(times[np.argmin(np.abs(times - time_ns))]) - time_ns
    return f"; the nearest candidate comes {later_text(off_ns)}"


def silent(
    evidence: Evidence, part: StageEvidence, channel: int, time_ns: int, reach: int
) -> tuple[str, str]:
    """Return cause and sentence of a channel without a candidate around a time.

    The filter is named where the recording is at hand, and without the filter there is a candidate
    that passes all thresholds.
    """
    stage = next((s for s in evidence.config.stage if s.key == part.spec.stage), None)
    floor, sought = None, MAXIMUM
    if stage is not None:
        kind = stage_named(stage.use)
        decision = part.spec.trace[0].name if part.spec.trace else ""
        floor = getattr(kind, "floors", {}).get(decision, stage.parameters.get("floor"))
        sought = getattr(kind, "sought", MAXIMUM)
    quiet = silence(part, channel, time_ns - reach, time_ns + reach, floor, sought)
    if stage is None or quiet.cause not in {"quiet", "shape"}:
        return quiet.cause, quiet.text
    signal = evidence.unfiltered
    if signal is not None and signal.at_hand:
        unmuted = signal.nearest(part, channel, time_ns - reach, time_ns + reach)
        if unmuted is None:
            return quiet.cause, quiet.text
        levels = f"; {quiet.levels}" if quiet.levels else ""
        return "filter", f"{without_filter(part, unmuted, time_ns)}; {quiet.text}{levels}"
    if not quiet.levels or unfiltered_kind(stage) is None:
        return quiet.cause, quiet.text
    return quiet.cause, (
        f"{quiet.text}; {quiet.levels}: it takes the recording to tell whether the filter took a "
        f"step out (why --recording)"
    )


def unfiltered_kind(stage: StageConfig) -> tuple[type[Any], Any] | None:
    """Return a detector's class and parameters without its filter; None where it has none."""
    kind: Any = stage_named(stage.use)
    hook = getattr(kind, "unfiltered", None)
    if hook is None:
        return None
    worker: tuple[type[Any], Any] = hook(build(kind.Parameters, stage.parameters, stage.key))
    return worker


def without_filter(part: StageEvidence, unmuted: Unmuted, time_ns: int) -> str:
    """Say that the filter takes something out, by the candidate that is there without it."""
    first = part.spec.columns[0]
    unit = unit_after(first.unit)
    return (
        f"{FILTERED}: without it a candidate {later_text(unmuted.time_ns - time_ns)} passes every "
        f"threshold ({first.name} {readable(unmuted.value)}{unit})"
    )


def _upstream(evidence: Evidence, part: StageEvidence) -> StageEvidence | None:
    """Return the picking stage before an associator, on the same topic."""
    order = [stage.key for stage in evidence.config.stage]
    before = order[: order.index(part.spec.stage)]
    sources = [
        e
        for key in before
        for e in evidence.of(key)
        if e.spec.emits == "pick" and e.spec.topic == part.spec.topic
    ]
    return sources[-1] if sources else None


@dataclass(frozen=True, slots=True)
class MissingChannel:
    """A channel without a pick, and why."""

    channel: str
    cause: str
    text: str


def missing_channels(
    evidence: Evidence,
    part: StageEvidence,
    time_ns: int,
    reach: int,
    group_ns: tuple[int, int] | None = None,
) -> tuple[MissingChannel, ...]:
    """Say for each channel without a pick in a group, or around a time, why it has none."""
    source = _upstream(evidence, part)
    if source is None:
        return ()
    rows = source.between(time_ns - reach, time_ns + reach)
    group = source.between(*(group_ns or (time_ns - reach, time_ns + reach)))
    picked = set(source.candidates.channel[group[source.accepted[group]]].tolist())
    return tuple(
        MissingChannel(name, *channel_verdict(source, rows, channel, time_ns, reach, evidence))
        for channel, name in enumerate(source.spec.channels)
        if channel not in picked
    )


def channel_verdict(
    source: StageEvidence,
    rows: NDArray[np.intp],
    channel: int,
    time_ns: int,
    reach: int,
    evidence: Evidence | None = None,
) -> tuple[str, str]:
    """Return cause and sentence for one channel without a pick; ``rows`` are candidates near."""
    channel_rows = rows[source.candidates.channel[rows] == channel]
    if not len(channel_rows) and evidence is not None:
        return silent(evidence, source, channel, time_ns, reach)
    quiet = silence(source, channel, time_ns - reach, time_ns + reach)
    if quiet.cause in {"dead", "clipped"} or not len(channel_rows):
        return quiet.cause, quiet.text
    row = int(min(channel_rows, key=lambda r: closeness(source, int(r), time_ns)))
    first = next((r for r in readings(source, row) if not r.passed), None)
    if first is None:
        later_ms = (int(source.candidates.time_ns[row]) - time_ns) / 1e6
        return "taken", f"was picked {later_ms:+.0f} ms from it, in another group"
    return ("refractory" if first.gate == "refractory" else "threshold"), below(first)


#: From here on a recorded signal stands out of its noise [dB]. Chosen by judgement: four times the
#: noise is seen by eye.
CLEAR_DB = 12.0
FRAME_NS = round(FRAME_S * NS_PER_S)
#: From here on the signal-to-noise ratios as recorded and after the filter differ [dB]. Chosen by
#: judgement: a factor of two.
TAKEN_DB = 6.0
#: A signal that stands still for this part of a span, counted in the frames that overlap it, is
#: dead, for less it is clipped. Source: definition, more than half.
DEAD_PART = 0.5
#: What a detector looks for that says nothing else.
MAXIMUM = "a local maximum"
#: So many candidates at most, this near, tell how long after them the decision function reaches
#: their value, which it does at most so long before or after [s]. Chosen by judgement: a median of
#: twenty does not follow one of them.
LAG_FROM, LAG_FROM_S, LAG_BEFORE_S, LAG_AFTER_S = 20, 30.0, 0.2, 1.0


@dataclass(frozen=True, slots=True)
class Silence:
    """Why a channel gave no candidate.

    Attributes
    ----------
    cause
        ``dead``, ``clipped``, ``gap``, ``quiet``, or ``shape``: the decision function rose above
        the floor without what a candidate is.
    text
        The same for people.
    recorded_db, filtered_db
        What the signal rose above its noise, as recorded and after the filter [dB]; None where
        that is not known.
    """

    cause: str
    text: str
    recorded_db: float | None = None
    filtered_db: float | None = None

    @property
    def levels(self) -> str:
        """What the filter left of the signal, where that is much less than was recorded."""
        recorded, filtered = self.recorded_db, self.filtered_db
        if recorded is None or filtered is None or recorded < max(CLEAR_DB, filtered + TAKEN_DB):
            return ""
        return f"{recorded:.0f} dB over its noise as recorded, {filtered:.0f} dB after the filter"


def _db(level: float, noise: float) -> float | None:
    """Return a level over noise [dB], or None where either is not known."""
    return 20 * float(np.log10(level / noise)) if level > 0 and noise > 0 else None


def silence(
    part: StageEvidence,
    channel: int,
    start_ns: int,
    end_ns: int,
    floor: float | None = None,
    sought: str = MAXIMUM,
) -> Silence:
    """Say what a channel's trace shows between two times.

    A frame counts where it overlaps the span; one of the decision function and of the filtered
    signal where it overlaps what candidates in the span would be made of, which may come later by
    a filter's delay. Dead means that nothing moved for most of the time; clipped, that a signal
    that stands out stood still at its extreme; quiet, that the decision function stayed below the
    floor, or where there is none that nothing stood out; shape, that it did not.

    Parameters
    ----------
    part
        The stage and topic.
    channel
        Index of the channel.
    start_ns, end_ns
        First and last moment.
    floor
        Least value of the decision function that makes a candidate; None where there is none.
    sought
        What makes a candidate of it, above the floor.
    """
    names = [q.name for q in part.spec.trace]
    rows = _frames(part, channel, start_ns, end_ns)
    if not len(rows):
        return Silence("gap", "no signal was recorded")
    swing, quiet, flat = (rows[:, names.index(name)] for name in ("swing", "quiet", "flat"))
    length_s = _frame_ns(part) / NS_PER_S
    # of a signal that is driven from rail to rail most samples stand still, but no frame does
    span_s, still_s = length_s * len(rows), float(flat[swing == 0].sum())
    if still_s >= DEAD_PART * min(span_s, (end_ns - start_ns) / NS_PER_S):
        text = f"is dead: the signal stands still for {still_s * 1e3:.0f} of {span_s * 1e3:.0f} ms"
        return Silence("dead", text)
    top = float(swing.max())
    recorded = _db(top, float(quiet.min()))
    flat_s = float(flat[swing >= top / 2].max())
    if flat_s > 0 and recorded is not None and recorded >= CLEAR_DB:
        return Silence("clipped", f"is clipped for {flat_s * 1e3:.0f} ms of a frame", recorded)
    lag_ns = _lag_ns(part, channel, (start_ns + end_ns) // 2)
    later = _frames(part, channel, start_ns + lag_ns, end_ns + lag_ns)
    later = later if len(later) else rows
    peak, noise = (later[:, names.index(name)] for name in ("peak", "noise"))
    filtered = _db(float(peak.max()), float(noise.min()) * np.sqrt(2))
    reached, other_ns = float(later[:, 0].max()), None
    if floor is not None and reached > floor:
        reached, other_ns = _own_value(part, channel, later[:, 0], (start_ns, end_ns))
    but = ""
    if other_ns is not None:
        but = f" but for the candidate {later_text(other_ns - (start_ns + end_ns) // 2)}"
    cause, text = _reached(part, reached, floor, sought, recorded, but)
    return Silence(cause, text, recorded, filtered)


def _own_value(
    part: StageEvidence, channel: int, values: NDArray[np.float64], span: tuple[int, int]
) -> tuple[float, int | None]:
    """Return what the decision function reached in frames about a span, and whose is left out [ns].

    A frame at the edge holds what lies beside the span too. Where its largest value is that of a
    candidate outside, it is that one's, and says nothing of the span.
    """
    around = round(LAG_AFTER_S * NS_PER_S)
    rows = part.between(span[0] - around, span[1] + around)
    times = part.candidates.time_ns[rows]
    outside = (part.candidates.channel[rows] == channel) & ((times < span[0]) | (times > span[1]))
    times, peaks = times[outside], part.candidates.value[rows[outside], 0].astype(np.float64)
    inside = ~np.isin(values, peaks)
    reached = float(values[inside].max()) if inside.any() else float(values.max())
    if reached >= values.max():
        return reached, None
    return reached, int(times[peaks == values.max()][0])


def _reached(
    part: StageEvidence,
    reached: float,
    floor: float | None,
    sought: str,
    recorded: float | None,
    but: str,
) -> tuple[str, str]:
    """Return cause and sentence of what the decision function reached."""
    name, unit = part.spec.trace[0].name, part.spec.trace[0].unit
    unit = unit_after(unit)
    if floor is None:
        clear = recorded is not None and recorded >= CLEAR_DB
        return (
            "shape" if clear else "quiet"
        ), f"{name} reached {readable(reached, 3)}{unit}, not {sought}"
    value, least = told_apart(reached, floor, 3)
    if reached <= floor:
        text = f"the signal never rose above the floor{but}: {name} reached {value}{unit}, "
        return "quiet", f"{text}floor {least}{unit}"
    frame_ms = _frame_ns(part) / 1e6
    return "shape", (
        f"{name} reached {value}{unit} in a frame of {frame_ms:.0f} ms there, above the floor of "
        f"{least}{unit}, but without {sought}"
    )


def _frame_ns(part: StageEvidence) -> int:
    """Return the length of a frame [ns]: 50 ms, or a sample where those are further apart."""
    times = part.frames.time_ns
    return max(FRAME_NS, round(float(np.median(np.diff(times))))) if len(times) > 1 else FRAME_NS


def _frames(part: StageEvidence, channel: int, start_ns: int, end_ns: int) -> NDArray[np.float64]:
    """Return the frames of a channel that overlap a span, shape (n, n_quantities)."""
    times = part.frames.time_ns
    first = int(np.searchsorted(times, start_ns - _frame_ns(part), side="right"))
    last = int(np.searchsorted(times, end_ns, side="right"))
    return part.frames.value[first:last, channel].astype(np.float64)


def _lag_ns(part: StageEvidence, channel: int, time_ns: int) -> int:
    """Return how long after a candidate its peak usually lies in the trace [ns].

    The first column of a candidate is the peak of the decision function, which the frame that
    holds it has as well: the filter's delay, and how far a candidate is timed before its peak. 0
    where no candidate is near.
    """
    around = round(LAG_FROM_S * NS_PER_S)
    rows = part.between(time_ns - around, time_ns + around)
    rows = rows[part.candidates.channel[rows] == channel]
    rows = rows[np.argsort(np.abs(part.candidates.time_ns[rows] - time_ns))[:LAG_FROM]]
    length, times = _frame_ns(part), part.frames.time_ns
    value = part.frames.value[:, channel, 0]
    lags = []
    for row in rows:
        found_ns = int(part.candidates.time_ns[row])
        first, last = np.searchsorted(
            times, (found_ns - LAG_BEFORE_S * NS_PER_S, found_ns + LAG_AFTER_S * NS_PER_S)
        )
        same = np.flatnonzero(value[first:last] == part.candidates.value[row, 0])
        if len(same):
            lags.append(int(times[first + same[0]]) + length // 2 - found_ns)
    return int(np.median(lags)) if lags else 0
