"""The account of a result: every wrong decision with its reason and its smallest remedy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..score import match
from ..score.steps import usual_latency_s
from .arrivals import bad_picks
from .candidates import Chain, links
from .places import bad_places
from .readings import GateReading, readings
from .reasons import Reason, reason_at
from .redecide import Counts, Redecider
from .remedies import Healer, Remedy

if TYPE_CHECKING:
    from ..score import StepMatch
    from .evidence import Evidence


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
        The smallest change of one parameter that finds it; None where there is none.
    """

    step: int
    time_s: float
    reason: Reason
    remedy: Remedy | None


@dataclass(frozen=True, slots=True)
class False_:  # noqa: N801  # False is taken
    """A detection that answers no true step.

    Attributes
    ----------
    time_s
        Its time [s since the first sample].
    narrowest
        The gate it passed by the smallest margin, relative to the threshold; None if unknown.
    remedy
        The smallest change of one parameter that makes it go; None where there is none.
    """

    time_s: float
    narrowest: GateReading | None
    remedy: Remedy | None


@dataclass(frozen=True, slots=True)
class Account:
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
    missed, false
        In the order of time.
    """

    recording: str
    tolerance_s: float
    counts: Counts
    causes: dict[str, int]
    latency_ms: float
    found_without_latency: int
    bad_picks: int | None
    bad_fixes: int | None
    missed: tuple[Missed, ...]
    false: tuple[False_, ...]


def account(evidence: Evidence, tolerance_s: float = 0.12) -> Account:
    """Explain every missed and every false step of a result."""
    healer = Healer(Redecider(evidence), tolerance_s)
    matching = healer.matching
    missed = tuple(
        Missed(
            int(index) + 1,
            _seconds(evidence, int(matching.truth_ns[index])),
            reason_at(evidence, int(matching.truth_ns[index]), tolerance_s),
            healer.recover(int(matching.truth_ns[index])),
        )
        for index in matching.missed
    )
    false = tuple(
        False_(
            _seconds(evidence, int(matching.found_ns[index])),
            narrowest(evidence, int(matching.found_ns[index])),
            healer.remove(int(matching.found_ns[index])),
        )
        for index in matching.false
    )
    causes = dict(Counter(m.reason.cause for m in missed))
    latency_s, right = _without_latency(matching, evidence.start_ns, tolerance_s)
    return Account(
        evidence.name,
        tolerance_s,
        healer.before,
        causes,
        latency_s * 1e3,
        right,
        bad_picks(evidence),
        bad_places(evidence),
        missed,
        false,
    )


def _without_latency(matching: StepMatch, start_ns: int, tolerance_s: float) -> tuple[float, int]:
    """Return the usual latency [s], and how many steps match without it."""
    truth, found = ((t - start_ns) / NS_PER_S for t in (matching.truth_ns, matching.found_ns))
    latency_s = usual_latency_s(truth, found)
    return latency_s, len(match(truth, found - latency_s, tolerance_s))


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
    """

    time_s: float
    reason: Reason | None
    chain: tuple[Chain, ...]


def moment(evidence: Evidence, time_ns: int, tolerance_s: float = 0.12) -> Moment:
    """Say what was and was not decided around a moment; needs no truth."""
    reach = round(tolerance_s * NS_PER_S)
    chain = tuple(
        link
        for part in evidence.stages
        for link in links(evidence, part, time_ns - reach, time_ns + reach)
    )
    final = {part.spec.stage for part in evidence.stages if part.spec.emits == "step"}
    found = any(link.accepted and link.stage in final for link in chain)
    reason = None if found else reason_at(evidence, time_ns, tolerance_s)
    return Moment(_seconds(evidence, time_ns), reason, chain)
