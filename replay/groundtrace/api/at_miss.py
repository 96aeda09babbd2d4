"""A replay about a missed step: which moment that is, and what of the replay lies around it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, StageSpec, TraceBlock
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.truth import kinds_of
from ..explain.reasons import matched
from ..pipeline.results import evidence_of, read_results, replayed_labels
from .files import unheard
from .known_truth import truth_beside

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Event

    from ..pipeline.engine import ReplaySession, Sink
    from .files import Report

#: What is shown before and after the step [s]. Chosen by judgement: some steps to either side.
AROUND_S = 5.0


def missed_step(results: Path, number: int, report: Report = unheard) -> int:
    """Return the time of a missed step of a result [ns]; the first has the number 1.

    Parameters
    ----------
    results
        The file.
    number
        Of the step among those that were missed.
    report
        Told what a person should know of the truth.

    Raises
    ------
    RecordingError
        Where there is no truth, or there are not so many.
    """
    result = read_results(results)
    labels = truth_beside(result, results, report=report)
    name = result.provenance.recording
    if not any(label.kind == "step" for label in labels):
        raise RecordingError(
            f"{name}: --at-miss: expected true steps in the recording, found {kinds_of(labels)}"
        )
    found = matched(evidence_of(result, labels), tolerance_s=STEP_TOLERANCE_S)
    if not 1 <= number <= len(found.missed):
        raise RecordingError(
            f"{name}: --at-miss: expected one of the {len(found.missed)} missed steps, "
            f"found {number}"
        )
    return int(found.truth_ns[found.missed[number - 1]])


class TimeWindowSink:
    """Passes on what lies around a moment; it is decided by a replay of the whole recording.

    Parameters
    ----------
    sink
        Where to.
    at_ns
        The moment [ns].
    """

    def __init__(self, sink: Sink, at_ns: int) -> None:
        self._sink = sink
        reach = round(AROUND_S * NS_PER_S)
        self._start_ns, self._end_ns = at_ns - reach, at_ns + reach

    def open(self, session: ReplaySession) -> None:
        """Begin, with the labels and annotations of the window."""
        shown_ns = (max(self._start_ns, session.start_ns), min(self._end_ns, session.end_ns))
        labels = replayed_labels(session.labels, *shown_ns)
        annotations = tuple(
            replace(annotation, label=label)
            for annotation in session.annotations
            for label in replayed_labels((annotation.label,), *shown_ns)
        )
        window = replace(session, labels=labels, annotations=annotations, shown_ns=shown_ns)
        self._sink.open(window)

    def write(self, item: SignalBlock | Event) -> None:
        """Pass on the part of an item that lies in the window."""
        part = self._part(item)
        if part is not None:
            self._sink.write(part)

    def abandon(self) -> None:
        """End the replay without an output."""
        abandon = getattr(self._sink, "abandon", self._sink.close)
        abandon()

    def close(self) -> None:
        """End the replay."""
        self._sink.close()

    def _part(self, item: SignalBlock | Event) -> SignalBlock | Event | None:
        if isinstance(item, StageSpec):
            return item
        if isinstance(item, SignalBlock):
            times = item.sample_times()
            first, last = np.searchsorted(times, (self._start_ns, self._end_ns))
            return item.slice(int(first), int(last)) if last > first else None
        if isinstance(item, CandidateBlock | TraceBlock):
            return _rows(item, (item.time_ns >= self._start_ns) & (item.time_ns < self._end_ns))
        return item if self._start_ns <= item.time_ns < self._end_ns else None


def _rows(block: Any, rows: NDArray[np.bool_]) -> CandidateBlock | TraceBlock | None:
    """Return some rows of a block of columns; None of none."""
    if not rows.any():
        return None
    names = [f for f in type(block).__dataclass_fields__ if f != "spec"]
    part: CandidateBlock | TraceBlock = replace(
        block, **{name: getattr(block, name)[rows] for name in names}
    )
    return part
