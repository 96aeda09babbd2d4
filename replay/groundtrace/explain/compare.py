"""Comparison of two results of one recording, decision by decision, with the gates that differ."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groundtrace_codecs.events import Fix, Label
from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S, match, match_steps
from ..evaluation.positions import found_places, match_places, true_places
from ..evaluation.report import answers_of, last_word
from ..pipeline.results import evidence_of, step_times
from .reasons import StepReasons, WrongTime
from .redecide import Counts
from .unfiltered import with_recording

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from ..evaluation.matching import StepMatch
    from ..pipeline.config import PipelineConfig
    from ..pipeline.parameters import StageConfig
    from ..pipeline.results import Evidence, Results

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
#: Without truth the side that has a step is what the other one is asked for.
ONE_SIDED = ("only A", "only B")
SideName = Literal["A", "B"]


@dataclass(frozen=True, slots=True)
class RejectionCause:
    """Why one side has no step where the other has one.

    Attributes
    ----------
    side
        The side without the step.
    cause, text, stage, topic, gate
        As in :class:`~.reasons.Reason`; ``gate`` is the first that failed, or empty.
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
class SidePair:
    """A true step that one side found at the wrong time."""

    side: SideName
    pair: WrongTime


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
    pairs
        The sides that found the step at the wrong time, or whose false step it is.
    """

    time_s: float
    step: int | None
    verdict: str
    obstacle: RejectionCause | None
    pairs: tuple[SidePair, ...] = ()


@dataclass(frozen=True, slots=True)
class ComparedResult:
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
    a: ComparedResult
    b: ComparedResult
    parameters: tuple[ParameterChange, ...]
    verdicts: dict[str, int]
    p_value: float | None
    decisions: tuple[Decision, ...]
    places: PlaceComparison | None


def compare(
    a: Results,
    b: Results,
    labels: tuple[Label, ...],
    tolerance_s: float = STEP_TOLERANCE_S,
    places: Sequence[Path] = (),
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
    places
        Where the recording may be, to tell whether a filter took a step out.

    Raises
    ------
    RecordingError
        Where they are not of the same recording, or of different parts of it.
    """
    _check_alike(a, b)
    sides = (
        with_recording(evidence_of(a, labels), a.provenance.sha256, places),
        with_recording(evidence_of(b, labels), b.provenance.sha256, places),
    )
    matches = None
    if any(label.kind == "step" for label in labels):
        reasons = StepReasons(sides[0], tolerance_s), StepReasons(sides[1], tolerance_s)
        matches = reasons[0].matching, reasons[1].matching
        decisions = _against_truth(reasons)
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


def _side(name: str, evidence: Evidence, matching: StepMatch | None) -> ComparedResult:
    counts = None if matching is None else Counts.of(matching)
    return ComparedResult(name, evidence.config.name, len(step_times(evidence)), counts)


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


def _against_truth(reasons: tuple[StepReasons, StepReasons]) -> list[Decision]:
    a, b = reasons[0].matching, reasons[1].matching
    right_a, right_b = set(a.pairs[:, 0].tolist()), set(b.pairs[:, 0].tolist())
    decisions = []
    for index, time_ns in enumerate(a.truth_ns.tolist()):
        detected = (index in right_a, index in right_b)
        verdict = _by_side(detected, "both right", "only A right", "only B right", "both missed")
        decisions.append(_decision(reasons, time_ns, index + 1, verdict, detected))
    false = a.found_ns[a.false], b.found_ns[b.false]
    for time_ns, detected in _paired(*false, reasons[0].evidence.start_ns, a.tolerance_s):
        verdict = _by_side(detected, "both false", "only A false", "only B false")
        decisions.append(_decision(reasons, time_ns, None, verdict, detected))
    return decisions


def _against_each_other(sides: tuple[Evidence, Evidence], tolerance_s: float) -> list[Decision]:
    """Compare two sides without truth: each is asked for the steps of the other."""
    times = step_times(sides[0]), step_times(sides[1])
    reasons = (
        StepReasons(sides[0], tolerance_s, _answering(sides[0], times[1], tolerance_s)),
        StepReasons(sides[1], tolerance_s, _answering(sides[1], times[0], tolerance_s)),
    )
    return [
        _decision(reasons, time_ns, None, _by_side(detected, "both", "only A", "only B"), detected)
        for time_ns, detected in _paired(*times, sides[0].start_ns, tolerance_s)
    ]


def _answering(evidence: Evidence, true_ns: NDArray[np.int64], tolerance_s: float) -> StepMatch:
    """Match the steps of a result to those of another."""
    labels = [Label(time_ns, "step") for time_ns in true_ns.tolist()]
    e = evidence
    return match_steps(labels, step_times(e), e.start_ns, e.end_ns, tolerance_s)


def _by_side(
    detected: tuple[bool, bool], both: str, only_a: str, only_b: str, none: str = ""
) -> str:
    return {(True, True): both, (True, False): only_a, (False, True): only_b}.get(detected, none)


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
    reasons: tuple[StepReasons, StepReasons],
    time_ns: int,
    step: int | None,
    verdict: str,
    detected: tuple[bool, bool],
) -> Decision:
    time_s = (time_ns - reasons[0].evidence.start_ns) / NS_PER_S
    names: tuple[SideName, SideName] = ("A", "B")
    pairs = tuple(
        SidePair(name, pair)
        for name, side, has in zip(names, reasons, detected, strict=True)
        if (pair := side.wrong_time(time_ns)) is not None and not (has and verdict in ONE_SIDED)
    )
    if detected[0] == detected[1]:
        return Decision(time_s, step, verdict, None, pairs)
    lacks: SideName = "B" if detected[0] else "A"
    obstacle = _obstacle(lacks, reasons[1] if detected[0] else reasons[0], time_ns)
    return Decision(time_s, step, verdict, obstacle, pairs)


def _obstacle(side: SideName, reasons: StepReasons, time_ns: int) -> RejectionCause:
    reason = reasons.at(time_ns)
    first = next((r for r in reason.readings if r.gate == reason.gate), None)
    fields = (side, reason.cause, reason.text, reason.stage, reason.topic)
    if first is None:
        return RejectionCause(*fields)
    return RejectionCause(
        *fields, first.gate, first.parameter, first.value, first.threshold, first.margin
    )


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of a stage that differs; None where a side does not have it.

    ``parameter`` is ``use`` or ``topics`` where the stage itself runs something else, or elsewhere.
    """

    stage: str
    parameter: str
    a: Any
    b: Any


def changed_parameters(a: PipelineConfig, b: PipelineConfig) -> tuple[ParameterChange, ...]:
    """Return what differs between two pipelines as their results keep them: in full.

    Of a stage that only one has, or that runs another plugin, the parameters are not compared.
    """
    one, other = ({stage.key: stage for stage in config.stage} for config in (a, b))
    changes = []
    for key in dict.fromkeys([*one, *other]):
        values = _values(one.get(key)), _values(other.get(key))
        names = list(dict.fromkeys([*values[0], *values[1]]))
        if values[0].get("use") != values[1].get("use"):
            names = ["use"]
        for name in names:
            pair = values[0].get(name), values[1].get(name)
            if pair[0] != pair[1]:
                changes.append(ParameterChange(key, name, *pair))
    return tuple(changes)


def _values(stage: StageConfig | None) -> dict[str, Any]:
    if stage is None:
        return {}
    return {"use": stage.use, "topics": list(stage.topics), **stage.parameters}


@dataclass(frozen=True, slots=True)
class PlacePair:
    """What both say about one moment.

    Attributes
    ----------
    time_s
        Of A's fix [s since the first sample].
    apart_m
        Between the two places [m].
    error_a_m, error_b_m
        Distances to the true place [m]; None where there is none.
    """

    time_s: float
    apart_m: float
    error_a_m: float | None
    error_b_m: float | None


@dataclass(frozen=True, slots=True)
class PlaceComparison:
    """Fixes of both sides, of the last stage that gives any.

    Attributes
    ----------
    a, b
        How many each has.
    median_apart_m, largest_apart_m
        Between the places of one moment [m]; None where no moment has both.
    rmse_a_m, rmse_b_m
        Of the moments that both fixed and that have a true place [m]; None where there is none.
    pairs
        Moment by moment.
    """

    a: int
    b: int
    median_apart_m: float | None
    largest_apart_m: float | None
    rmse_a_m: float | None
    rmse_b_m: float | None
    pairs: tuple[PlacePair, ...]


def compare_places(
    a: Iterable[Event],
    b: Iterable[Event],
    labels: Sequence[Label],
    start_ns: int,
    tolerance_s: float,
) -> PlaceComparison | None:
    """Compare the fixes of two results; None where one of them has none.

    Parameters
    ----------
    a, b
        All events of each.
    labels
        The truth.
    start_ns
        First sample [ns].
    tolerance_s
        Largest distance in time between two fixes of a moment, and to its truth [s].
    """
    one, other = (_fixes(events) for events in (a, b))
    if not one or not other:
        return None
    here, there, truth = found_places(one), found_places(other), true_places(labels)
    pairs = match_places(here, there, tolerance_s)
    apart = np.hypot(*(here.xy[pairs[:, 0]] - there.xy[pairs[:, 1]]).T)
    truth_index = (
        dict(match_places(truth, here, tolerance_s)[:, ::-1].tolist()) if len(truth) else {}
    )
    rows = []
    for (i, j), distance in zip(pairs.tolist(), apart.tolist(), strict=True):
        at = truth.xy[truth_index[i]] if i in truth_index else None
        errors = (_error(here.xy[i], at), _error(there.xy[j], at))
        rows.append(PlacePair((one[i].time_ns - start_ns) / NS_PER_S, distance, *errors))
    return PlaceComparison(
        len(one),
        len(other),
        float(np.median(apart)) if len(apart) else None,
        float(apart.max()) if len(apart) else None,
        _rms([row.error_a_m for row in rows]),
        _rms([row.error_b_m for row in rows]),
        tuple(rows),
    )


def _error(xy: NDArray[np.float64], at: NDArray[np.float64] | None) -> float | None:
    return None if at is None else float(np.hypot(*(xy - at)))


def _fixes(events: Iterable[Event]) -> list[Fix]:
    return sorted(last_word(answers_of(events).fixes), key=lambda fix: fix.time_ns)


def _rms(errors: Sequence[float | None]) -> float | None:
    valid: NDArray[np.float64] = np.array([e for e in errors if e is not None], np.float64)
    return float(np.sqrt(np.mean(valid**2))) if len(valid) else None
