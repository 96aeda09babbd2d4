"""Comparison: two results of one recording, decision by decision, and what set them apart."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..score import match, match_steps
from .differences import ParameterChange, PlaceComparison, changed_parameters, compare_places
from .evidence import evidence_of
from .reasons import reason_at
from .redecide import Counts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.labels import Label

    from ..results import Results
    from ..score import StepMatch
    from .evidence import Evidence

#: What can become of a decision: the first seven with truth, the last three without.
VERDICTS = (
    "both right",
    "only A right",
    "only B right",
    "both missed",
    "both false",
    "only A false",
    "only B false",
    "both",
    "only A",
    "only B",
)
#: Decisions that A has right and B wrong, and the other way round.
A_RIGHT, B_RIGHT = ("only A right", "only B false"), ("only B right", "only A false")
SideName = Literal["A", "B"]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Why one side has no step where the other has one.

    Attributes
    ----------
    side
        The side without the step.
    cause, text, stage, topic, gate
        As in :class:`~groundtrace.explain.Reason`; ``gate`` is the first that failed, or empty.
    parameter
        Of that gate; empty where no gate was reached.
    value, threshold, margin
        Of the first gate that failed; None where there was no candidate.
    """

    side: SideName
    cause: str
    text: str
    stage: str
    topic: str
    gate: str = ""
    parameter: str = ""
    value: float | None = None
    threshold: float | None = None
    margin: float | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """One step, true or detected.

    Attributes
    ----------
    time_s
        Of the true step, else of the detection [s since the first sample].
    step
        Number of the true step among the scored ones, from 1; None where it is none.
    verdict
        One of :data:`VERDICTS`.
    obstacle
        What set the two apart; None where they agree.
    """

    time_s: float
    step: int | None
    verdict: str
    obstacle: Obstacle | None


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two results: its file, its pipeline, its steps, and with truth its score."""

    name: str
    pipeline: str
    steps: int
    counts: Counts | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two results of one recording.

    Attributes
    ----------
    recording
        File name.
    tolerance_s
        Largest distance of a match [s].
    a, b
        The two.
    parameters
        Those that differ.
    verdicts
        How many decisions have each verdict.
    p_value
        McNemar's exact test: how probable such a difference, or a larger one, is where both are
        equally good; None without truth, or where they differ in no decision.
    decisions
        In the order of time.
    places
        Of fixes; None where a side has none.
    """

    recording: str
    tolerance_s: float
    a: Side
    b: Side
    parameters: tuple[ParameterChange, ...]
    verdicts: dict[str, int]
    p_value: float | None
    decisions: tuple[Decision, ...]
    places: PlaceComparison | None


def compare(
    a: Results, b: Results, labels: tuple[Label, ...], tolerance_s: float = 0.12
) -> Comparison:
    """Compare two results of one recording.

    Parameters
    ----------
    a, b
        The results.
    labels
        The truth; without steps in it the two are compared with each other alone.
    tolerance_s
        Largest distance between a step and its detection, and between two detections [s].

    Raises
    ------
    RecordingError
        Where they are not of the same recording, or of different parts of it.
    """
    _check_alike(a, b)
    sides = evidence_of(a, labels), evidence_of(b, labels)
    matches = None
    if any(label.kind == "step" for label in labels):
        matches = matched(sides[0], tolerance_s), matched(sides[1], tolerance_s)
        decisions = _against_truth(sides, matches, tolerance_s)
    else:
        decisions = _against_each_other(sides, tolerance_s)
    verdicts = Counter(decision.verdict for decision in decisions)
    return Comparison(
        a.provenance.recording,
        tolerance_s,
        _side(a.name, sides[0], matches and matches[0]),
        _side(b.name, sides[1], matches and matches[1]),
        changed_parameters(sides[0].config, sides[1].config),
        {name: verdicts[name] for name in VERDICTS if verdicts[name]},
        exact_p(verdicts) if matches else None,
        tuple(sorted(decisions, key=lambda d: d.time_s)),
        compare_places(a.events, b.events, labels, sides[0].start_ns, tolerance_s),
    )


def _check_alike(a: Results, b: Results) -> None:
    one, other = a.provenance, b.provenance
    if one.sha256 != other.sha256:
        raise RecordingError(
            f"{a.name} and {b.name}: expected results of one recording, found "
            f"{one.recording} ({one.sha256[:12]}) and {other.recording} ({other.sha256[:12]})"
        )
    if (one.from_ns, one.to_ns) != (other.from_ns, other.to_ns):
        raise RecordingError(
            f"{a.name} and {b.name}: expected results of the same part of {one.recording}, "
            f"found different --from or --to"
        )


def _side(name: str, evidence: Evidence, matching: StepMatch | None) -> Side:
    counts = None if matching is None else Counts.of(matching)
    return Side(name, evidence.config.name, len(step_times(evidence)), counts)


def step_times(evidence: Evidence) -> NDArray[np.int64]:
    """Return the times of the steps of the last stage that emits them, sorted [ns]."""
    stages = [part for part in evidence.stages if part.spec.emits == "step"]
    last = stages[-1].spec.stage if stages else ""
    times = [p.candidates.time_ns[p.accepted] for p in stages if p.spec.stage == last]
    return np.sort(np.concatenate([np.empty(0, np.int64), *times]))


def matched(evidence: Evidence, tolerance_s: float) -> StepMatch:
    """Match the steps of a result, as decided, to its truth."""
    e = evidence
    return match_steps(e.labels, step_times(e), e.start_ns, e.end_ns, tolerance_s)


def exact_p(verdicts: Counter[str]) -> float | None:
    """Return McNemar's exact p-value of the decisions that one side has right and the other not.

    A two-sided binomial test of the discordant pairs (McNemar 1947, in its exact form): missed
    and false steps count alike. None where there is no such pair.
    """
    from scipy.stats import binomtest

    for_a, for_b = (sum(verdicts[name] for name in names) for names in (A_RIGHT, B_RIGHT))
    if for_a + for_b == 0:
        return None
    return float(binomtest(for_a, for_a + for_b).pvalue)


def _against_truth(
    sides: tuple[Evidence, Evidence], matches: tuple[StepMatch, StepMatch], tolerance_s: float
) -> list[Decision]:
    a, b = matches
    right_a, right_b = set(a.pairs[:, 0].tolist()), set(b.pairs[:, 0].tolist())
    decisions = []
    for index, time_ns in enumerate(a.truth_ns.tolist()):
        found = (index in right_a, index in right_b)
        verdict = _said(found, "both right", "only A right", "only B right", "both missed")
        decisions.append(_decision(sides, time_ns, index + 1, verdict, found, tolerance_s))
    false = a.found_ns[a.false], b.found_ns[b.false]
    for time_ns, found in _paired(*false, sides[0].start_ns, tolerance_s):
        verdict = _said(found, "both false", "only A false", "only B false")
        decisions.append(_decision(sides, time_ns, None, verdict, found, tolerance_s))
    return decisions


def _against_each_other(sides: tuple[Evidence, Evidence], tolerance_s: float) -> list[Decision]:
    times = step_times(sides[0]), step_times(sides[1])
    return [
        _decision(
            sides, time_ns, None, _said(found, "both", "only A", "only B"), found, tolerance_s
        )
        for time_ns, found in _paired(*times, sides[0].start_ns, tolerance_s)
    ]


def _said(found: tuple[bool, bool], both: str, only_a: str, only_b: str, none: str = "") -> str:
    return {(True, True): both, (True, False): only_a, (False, True): only_b}.get(found, none)


def _paired(
    a_ns: NDArray[np.int64], b_ns: NDArray[np.int64], start_ns: int, tolerance_s: float
) -> list[tuple[int, tuple[bool, bool]]]:
    """Return the times [ns] of two sorted lists and who has each; a pair counts once, at A's."""
    pairs = match((a_ns - start_ns) / NS_PER_S, (b_ns - start_ns) / NS_PER_S, tolerance_s)
    with_b = set(pairs[:, 0].tolist())
    only_b = np.delete(b_ns, pairs[:, 1])
    out = [(t, (True, i in with_b)) for i, t in enumerate(a_ns.tolist())]
    return out + [(t, (False, True)) for t in only_b.tolist()]


def _decision(
    sides: tuple[Evidence, Evidence],
    time_ns: int,
    step: int | None,
    verdict: str,
    found: tuple[bool, bool],
    tolerance_s: float,
) -> Decision:
    time_s = (time_ns - sides[0].start_ns) / NS_PER_S
    if found[0] == found[1]:
        return Decision(time_s, step, verdict, None)
    lacks: SideName = "B" if found[0] else "A"
    evidence = sides[1] if found[0] else sides[0]
    return Decision(time_s, step, verdict, _obstacle(lacks, evidence, time_ns, tolerance_s))


def _obstacle(side: SideName, evidence: Evidence, time_ns: int, tolerance_s: float) -> Obstacle:
    reason = reason_at(evidence, time_ns, tolerance_s)
    first = next((r for r in reason.readings if r.gate == reason.gate), None)
    place = (side, reason.cause, reason.text, reason.stage, reason.topic)
    if first is None:
        return Obstacle(*place)
    return Obstacle(*place, first.gate, first.parameter, first.value, first.threshold, first.margin)
