"""The page of a score: one HTML file that needs no other file and no network."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PureWindowsPath
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from . import figures
from .headings import heading_errors
from .matching import STEP_TOLERANCE_S, best_shift, found_text, match_steps, timing_pairs
from .page import rendered
from .picks import pick_residuals
from .positions import answerable_places, matched_fixes, true_places
from .report import answers_of, last_word
from .tracks import moments
from .truth import ScoredTruth

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from markupsafe import Markup
    from numpy.typing import NDArray

    from groundtrace_codecs.events import Label
    from groundtrace_codecs.geometry import Geometry

    from ..pipeline.results import Results
    from .matching import StepMatch
    from .picks import PickResiduals
    from .report import ResultEvents, Score
    from .steps import Confusion
    from .tracks import Moment

#: So many unmatched steps and impacts are listed; the figures show all.
LISTED = 60


def score_page(
    result: Results,
    labels: Sequence[Label] | ScoredTruth,
    score: Score,
    tolerance_s: float = STEP_TOLERANCE_S,
    stages: Collection[str] = (),
) -> str:
    """Return a score as an HTML page with figures.

    The page asks nothing of any server, runs no script and names no folder.

    Parameters
    ----------
    result
        What was scored.
    labels
        The truth, perhaps with remarks on it.
    score
        The result's score against it.
    tolerance_s
        The score's tolerance [s].
    stages
        Those chosen for the score.
    """
    origin = result.provenance
    remarks = labels.remarks if isinstance(labels, ScoredTruth) else ()
    truth = labels.labels if isinstance(labels, ScoredTruth) else labels
    answers = answers_of(result.events, stages)
    it = Scored(truth, answers, result.geometry, origin.start_ns, origin.end_ns, tolerance_s)
    seconds = (origin.end_ns - origin.start_ns) / NS_PER_S
    return rendered(
        "score.html.jinja",
        kind="score",
        name=PureWindowsPath(origin.recording).name,
        subtitle=f"{seconds:.1f} s recorded, steps matched within {1e3 * tolerance_s:.0f} ms",
        warnings=result.warnings,
        remarks=remarks,
        versions=", ".join(f"{name} {number}" for name, number in origin.versions.items()),
        origin=origin,
        score=score,
        it=it,
        figures=figures,
        listed=LISTED,
        wrong_times=[] if score.steps is None else _wrong_times(it.matching, origin.start_ns),
        unmatched=[] if score.steps is None else _unmatched(it.matching, origin.start_ns),
        confusion_rows=_confusion_rows,
    )


@dataclass(frozen=True, slots=True)
class Scored:
    """What a score is about: truth, what the result says, and how both are put side by side."""

    labels: Sequence[Label]
    answers: ResultEvents
    geometry: Geometry | None
    start_ns: int
    end_ns: int
    tolerance_s: float

    @property
    def matching(self) -> StepMatch:
        """Which steps answer which true ones."""
        found_ns = np.array([step.time_ns for step in self.answers.steps], np.int64)
        return match_steps(self.labels, found_ns, self.start_ns, self.end_ns, self.tolerance_s)

    def position_errors(self, stage: str) -> NDArray[np.float64]:
        """Return the errors of a stage's fixes [m], shape (n, 2)."""
        fixes = [fix for fix in self.answers.fixes if fix.stage == stage]
        truth = answerable_places(self.labels, self.answers.fixes)
        return matched_fixes(truth, fixes, self.tolerance_s)[1]

    @property
    def map(self) -> Markup:
        """The figure of truth, fixes, tracks and sensors."""
        fixes = last_word(self.answers.fixes)
        return figures.map_figure(
            true_places(self.labels), fixes, self.answers.points, self.geometry
        )

    @property
    def map_keys(self) -> dict[str, str]:
        """What the colours of the map stand for."""
        there = {"hit": "truth"} | ({"random": "fixes"} if self.answers.fixes else {})
        there |= {"result": "tracks"} if self.answers.points else {}
        return there | ({"soft": "sensors"} if self.geometry is not None else {})

    @property
    def moments(self) -> Sequence[Moment]:
        """Truth and tracks at the true times."""
        return moments(true_places(self.labels), self.answers.points, self.tolerance_s)

    @property
    def residuals(self) -> PickResiduals:
        """Errors of the first picks."""
        return pick_residuals(self.labels, self.answers.picks)

    @property
    def heading_errors(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """True times [ns] and errors [rad] of the headings."""
        return heading_errors(self.labels, self.answers.headings, self.tolerance_s)


def _wrong_times(matching: StepMatch, start_ns: int) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Return missed and false steps that are one error each, and the shift that mends most.

    It is a table's title and rows, or nothing where there are none.
    """
    pairs = timing_pairs(matching)
    if not pairs:
        return []
    title = f"Missed and false steps that are one, found at the wrong time: {len(pairs)}"
    shift = best_shift(matching, pairs)
    if shift is not None:
        title += (
            f"; all detections {shift.late_ms:+.0f} ms from the truth: without that {shift.mends} "
            f"of them would be right, {shift.right} steps in all"
        )
    rows: list[tuple[str, ...]] = [
        (
            str(pair.step),
            f"{(pair.truth_ns - start_ns) / NS_PER_S:.3f}",
            f"{(pair.found_ns - start_ns) / NS_PER_S:.3f}",
            found_text(pair, matching.tolerance_s),
        )
        for pair in pairs[:LISTED]
    ]
    return [(title + (f" (the first {LISTED})" if len(pairs) > LISTED else ""), rows)]


def _unmatched(matching: StepMatch, start_ns: int) -> list[tuple[str, str, str]]:
    """Return how many steps are missed and false, and when the first of them are."""
    rows = []
    for name, times, alone in (
        ("missed", matching.truth_ns, matching.missed),
        ("false", matching.found_ns, matching.false),
    ):
        if len(alone):
            seconds = (times[alone[:LISTED]] - start_ns) / NS_PER_S
            more = f" and {len(alone) - LISTED} more" if len(alone) > LISTED else ""
            rows.append((name, str(len(alone)), ", ".join(f"{t:.2f}" for t in seconds) + more))
    return rows


def _confusion_rows(c: Confusion) -> list[tuple[Any, ...]]:
    """Return the rows of a confusion matrix: rows are truth, columns detections."""
    return [(word, *counts) for word, counts in zip(c.words, c.counts, strict=True)]
