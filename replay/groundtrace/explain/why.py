"""The account of a result: every wrong decision with its reason and its smallest remedy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..evaluation.matching import STEP_TOLERANCE_S, TimeShift, best_shift, match
from ..evaluation.steps import usual_latency_s
from .reasons import Chain, GateReading, Reason, StepReasons, WrongTime, links, readings
from .redecide import Counts, OfflineDecider
from .remedies import Remedy, RemedySearch
from .why_picks import bad_picks
from .why_places import bad_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..evaluation.matching import StepMatch
    from ..pipeline.results import Evidence


@dataclass(frozen=True, slots=True)
class Missed:
    """A true step that no detection answers.

    Attributes
    ----------
    step
        Its number among the scored true steps, from 1.
    time_s
        Its time [s since the first sample].
    reason
        Why.
    remedy
        The smallest change of one parameter that finds it, or the best pair; None without any.
    pair
        The false step that it is, found at the wrong time; None where there is none.
    """

    step: int
    time_s: float
    reason: Reason
    remedy: Remedy | None
    pair: WrongTime | None = None


@dataclass(frozen=True, slots=True)
class FalseDetection:
    """A detection that answers no true step.

    Attributes
    ----------
    time_s
        Its time [s since the first sample].
    narrowest
        The gate it passed by the smallest margin, relative to the threshold; None if unknown.
    remedy
        The smallest change of one parameter that makes it go, or the best pair; None without any.
    pair
        The missed step that it is, found at the wrong time; None where there is none.
    """

    time_s: float
    narrowest: GateReading | None
    remedy: Remedy | None
    pair: WrongTime | None = None


@dataclass(frozen=True, slots=True)
class Mended:
    """How many wrong decisions a change of one parameter mends, a pair of them, or none."""

    one: int
    two: int
    none: int

    @classmethod
    def of(cls, wrong: Sequence[Missed] | Sequence[FalseDetection]) -> Mended:
        """Count remedies."""
        remedy_sizes = Counter(len(w.remedy.changes) if w.remedy is not None else 0 for w in wrong)
        return cls(remedy_sizes[1], remedy_sizes[2], remedy_sizes[0])


@dataclass(frozen=True, slots=True)
class StepExplanation:
    """All wrong decisions of a result.

    Attributes
    ----------
    recording
        File name.
    tolerance_s
        Of the match [s].
    counts
        Steps right, false and missed.
    causes
        How many misses have each cause.
    latency_ms
        By how much detections usually come after the truth [ms].
    found_without_latency
        How many steps would be right if that were taken out of their times.
    bad_picks, bad_fixes
        Picks late, early or missed, and places far off, rejected or missing; None where there is
        nothing to tell by.
    mended_missed, mended_false
        For how many missed, and false, steps there is a remedy.
    missed, false
        In the order of time.
    shift
        The one shift of all detections that mends most steps found at the wrong time; None where
        none mends most of them.
    untried
        The stage for which no changes were tried: what it makes of them takes a replay.
    """

    recording: str
    tolerance_s: float
    counts: Counts
    causes: dict[str, int]
    latency_ms: float
    found_without_latency: int
    bad_picks: int | None
    bad_fixes: int | None
    mended_missed: Mended
    mended_false: Mended
    missed: tuple[Missed, ...]
    false: tuple[FalseDetection, ...]
    shift: TimeShift | None = None
    untried: str = ""


def explain_steps(
    evidence: Evidence, tolerance_s: float = STEP_TOLERANCE_S, mended: int | None = None
) -> StepExplanation:
    """Explain every missed and every false step of a result.

    Parameters
    ----------
    evidence
        Of the result.
    tolerance_s
        Of the match [s].
    mended
        Remedies are looked for of so many missed, and so many false steps, the first ones; None
        stands for all.
    """
    healer = RemedySearch(OfflineDecider(evidence), tolerance_s)
    matching = healer.matching
    reasons = StepReasons(evidence, tolerance_s, matching)

    def remedy(rank: int, time_ns: int, *, false: bool = False) -> Remedy | None:
        looked_for = mended is None or rank < mended
        return remedy_of(healer, reasons, time_ns, false=false) if looked_for else None

    missed = tuple(
        Missed(
            int(index) + 1,
            _seconds(evidence, time_ns),
            reasons.at(time_ns),
            remedy(rank, time_ns),
            reasons.wrong_time(time_ns),
        )
        for rank, (index, time_ns) in enumerate(
            zip(matching.missed, matching.truth_ns[matching.missed].tolist(), strict=True)
        )
    )
    false = tuple(
        FalseDetection(
            _seconds(evidence, time_ns),
            narrowest(evidence, time_ns),
            remedy(rank, time_ns, false=True),
            reasons.wrong_time(time_ns),
        )
        for rank, time_ns in enumerate(matching.found_ns[matching.false].tolist())
    )
    causes = dict(Counter(m.reason.cause for m in missed))
    latency_s, right = _without_latency(matching, evidence.start_ns, tolerance_s)
    return StepExplanation(
        evidence.name,
        tolerance_s,
        healer.before,
        causes,
        latency_s * 1e3,
        right,
        bad_picks(evidence),
        bad_places(evidence),
        Mended.of(missed),
        Mended.of(false),
        missed,
        false,
        best_shift(matching, reasons.pairs),
        healer.untried,
    )


def remedy_of(
    healer: RemedySearch, reasons: StepReasons, time_ns: int, *, false: bool = False
) -> Remedy | None:
    """Return the remedy of the missed step at a time, or of the false one.

    Where the two are one step found at the wrong time, what mends the one mends the other: the
    step is found and that detection is false no longer.
    """
    pair = reasons.pair_of(time_ns)
    if pair is not None:
        return healer.recover(pair.truth_ns, pair.found_ns)
    return healer.remove(time_ns) if false else healer.recover(time_ns)


def _without_latency(matching: StepMatch, start_ns: int, tolerance_s: float) -> tuple[float, int]:
    """Return the usual latency [s], and how many steps match without it."""
    truth, detected = ((t - start_ns) / NS_PER_S for t in (matching.truth_ns, matching.found_ns))
    latency_s = usual_latency_s(truth, detected)
    return latency_s, len(match(truth, detected - latency_s, tolerance_s))


def _seconds(evidence: Evidence, time_ns: int) -> float:
    return (time_ns - evidence.start_ns) / NS_PER_S


def narrowest(evidence: Evidence, time_ns: int) -> GateReading | None:
    """Return the gate that an accepted candidate passed by the smallest relative margin."""
    for part in reversed(evidence.stages):
        rows = np.flatnonzero((part.candidates.time_ns == time_ns) & part.accepted)
        if part.spec.emits == "step" and len(rows):
            passed = [r for r in readings(part, int(rows[0])) if np.isfinite(r.margin)]
            return min(passed, key=_relative, default=None)
    return None


def _relative(reading: GateReading) -> float:
    return reading.margin / max(abs(reading.threshold), 1e-9)


@dataclass(frozen=True, slots=True)
class Moment:
    """What every stage had at a moment.

    Attributes
    ----------
    time_s
        The moment [s since the first sample].
    reason
        Why no step was accepted there; None where one was.
    chain
        All candidates around it, stage by stage.
    pair
        The true step and the detection at the wrong time, one of which is there; None where
        neither is.
    """

    time_s: float
    reason: Reason | None
    chain: tuple[Chain, ...]
    pair: WrongTime | None = None


def moment(evidence: Evidence, time_ns: int, tolerance_s: float = STEP_TOLERANCE_S) -> Moment:
    """Say what was and was not decided around a moment; needs no truth.

    Of a true step that was missed, why it was, though a detection near it answers another step.
    """
    reach = round(tolerance_s * NS_PER_S)
    reasons = StepReasons(evidence, tolerance_s)
    missed = time_ns in reasons.matching.truth_ns[reasons.matching.missed]
    reason = reasons.at(time_ns)
    if reason.candidate_s is not None:  # what is at the wrong time lies further away
        off_ns = abs(round((reason.candidate_s - _seconds(evidence, time_ns)) * NS_PER_S))
        shown = max(reach, off_ns + 1000)
    else:
        shown = reach
    chain = tuple(
        link
        for part in evidence.stages
        for link in links(evidence, part, time_ns - shown, time_ns + shown)
    )
    final = {part.spec.stage for part in evidence.stages if part.spec.emits == "step"}
    at_s = _seconds(evidence, time_ns)
    near = [link for link in chain if abs(link.time_s - at_s) * NS_PER_S <= reach]
    detected = any(link.accepted and link.stage in final for link in near)
    missed_reason = reason if missed or not detected else None
    return Moment(at_s, missed_reason, chain, _pair_about(reasons, time_ns, reach))


def _pair_about(reasons: StepReasons, time_ns: int, reach: int) -> WrongTime | None:
    """Return the pair whose true step is there, else whose detection is nearest within reach."""
    there = reasons.wrong_time(time_ns)
    near = [p.found_ns for p in reasons.pairs if abs(p.found_ns - time_ns) <= reach]
    if there is not None or not near:
        return there
    return reasons.wrong_time(min(near, key=lambda found_ns: abs(found_ns - time_ns)))
