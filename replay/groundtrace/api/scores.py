"""Scores of results: the figures by kind of truth, for ``groundtrace score`` and the API."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..errors import RecordingError
from ..evaluation.report import score_events
from ..evaluation.truth import kinds_of
from .tables import EventTable, plain_document, rows_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from ..evaluation.report import Score as Figures
    from ..evaluation.steps import StepScore
    from ..evaluation.truth import ScoredTruth
    from ..pipeline.results import Results as Decided
    from ..pipeline.warned import Warned


def scored(
    result: Decided, truth: ScoredTruth, tolerance_s: float, stages: Sequence[str] = ()
) -> Figures:
    """Score a result.

    Parameters
    ----------
    result
        What was decided.
    truth
        Of :func:`~.known_truth.scored_truth_of`.
    tolerance_s
        Largest distance between a step and its detection [s].
    stages
        Stages whose answers count in the place of others' of their kind.

    Raises
    ------
    RecordingError
        Where there is no truth that the result answers, or no such stage.
    """
    origin = result.provenance
    end_ns = origin.end_ns if origin.to_ns is None else min(origin.end_ns, origin.to_ns)
    start_ns, labels = origin.start_ns, truth.labels
    figures = score_events(labels, result.events, start_ns, end_ns, tolerance_s, tuple(stages))
    if not figures.parts:
        unanswered = f"{kinds_of(labels)}, to which its stages say nothing" if labels else "none"
        raise RecordingError(
            f"{result.name}: expected truth to score against (in the recording, or --truth FILE), "
            f"found {unanswered}"
        )
    return figures


def score_document(figures: Figures, truth: ScoredTruth, warnings: Sequence[Warned]) -> Any:
    """Return a score as one document; with what was left out of the truth, where there is any."""
    left_out: dict[str, object] = {}
    if truth.remarks:
        truth_document = {
            "waypoints_given": truth.given,
            "foot": truth.foot,
            "remarks": truth.remarks,
        }
        left_out = {"truth": truth_document}
    return plain_document(figures.parts | left_out, warnings)


@dataclass(frozen=True, eq=False, repr=False)
class Score:
    """How well a result answers the truth; made by ``results.score()``.

    Attributes
    ----------
    recording
        File name.
    details
        The figures by kind of truth: ``details.steps``, ``details.positions``, ...
    tolerance_s
        Largest distance between a step and its detection [s].
    truth
        What was scored against.
    remarks
        What a person should know of the truth, a line each.
    warnings
        What the replay warned of.

    Examples
    --------
    >>> import groundtrace as gt
    >>> score = gt.replay("waist-walk", "waist-steps").score()
    >>> score.f1
    1.0
    """

    recording: str
    details: Figures
    tolerance_s: float
    truth: ScoredTruth
    remarks: tuple[str, ...] = ()
    warnings: tuple[Warned, ...] = ()

    @property
    def steps(self) -> StepScore:
        """The figures of steps.

        Raises
        ------
        Error
            Where no steps were scored.
        """
        if self.details.steps is None:
            there = ", ".join(self.details.parts)
            raise RecordingError(f"{self.recording}: expected scored steps, found {there}")
        return self.details.steps

    @property
    def f1(self) -> float:
        """F1 of steps."""
        return self.steps.f1

    @property
    def precision(self) -> float:
        """Part of the detected steps that are true ones."""
        return self.steps.precision

    @property
    def recall(self) -> float:
        """Part of the true steps that are detected."""
        return self.steps.recall

    @property
    def latency(self) -> float:
        """Median of how late true steps are detected [s]; NaN where none is."""
        spread = self.steps.latency_ms
        return float("nan") if spread is None else spread.median / 1e3

    @property
    def chance(self) -> dict[str, float]:
        """F1 of as many detections at random, and of a metronome of the same rate."""
        return {"random": self.steps.chance_f1, "metronome": self.steps.chance_f1_metronome}

    @property
    def table(self) -> EventTable:
        """Every figure that is one number: its part, name and value."""
        header: dict[str, Any] = {"part": "text", "figure": "text", "value": "float"}
        return rows_table("score", header, list(numbers_of(self.details.parts)))

    @property
    def document(self) -> Any:
        """What ``groundtrace score --json`` prints."""
        return score_document(self.details, self.truth, self.warnings)

    def __repr__(self) -> str:
        steps = self.details.steps
        if steps is None:
            return f"Score({self.recording}, {', '.join(self.details.parts)})"
        false = steps.detected - steps.matched
        counts = f"{steps.matched}/{steps.truth} steps, {false} false"
        return f"Score({self.recording}, F1 {steps.f1:.3f}, {counts})"

    def _repr_html_(self) -> str:
        title = f"{self.recording}: score at {self.tolerance_s:g} s"
        return self.table.html(title)


def numbers_of(parts: Mapping[str, object]) -> Iterator[tuple[str, str, float]]:
    """Yield the numbers of the parts of a score: the part, the name, the value."""
    for part, value in plain_document(dict(parts)).items():
        waiting = [("", value)]
        while waiting:
            name, item = waiting.pop(0)
            if isinstance(item, dict):
                waiting = [(f"{name}.{k}".strip("."), v) for k, v in item.items()] + waiting
            elif isinstance(item, int | float) and not isinstance(item, bool):
                yield part, name, float(item)
