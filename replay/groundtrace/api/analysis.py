"""Analyses of results: explanations, comparisons and sweeps.

The functions take decisions and truth; command line and :class:`~.results.Results` both call them.
The classes are what the functions of the API return: each holds the details as one dataclass, and
``document`` is what ``--json`` prints of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S, StepTimes
from ..explain.reasons import StepReasons
from ..explain.unfiltered import with_recording
from ..explain.why import Moment, StepExplanation
from ..pipeline.parameters import parse_value
from ..pipeline.results import evidence_of
from .tables import EventTable, html_table, plain_document, rows_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Label

    from ..explain.compare import Comparison as Compared
    from ..explain.questions import Answer, Details, Kind
    from ..explain.reasons import Chain
    from ..explain.redecide import Counts
    from ..explain.remedies import Remedy
    from ..explain.sweep import Ranking
    from ..pipeline.results import Evidence
    from ..pipeline.results import Results as Decided
    from ..pipeline.warned import Warned


#: Columns of a table of gates.
GATES: dict[str, Any] = {
    "time_s": "float",
    "stage": "text",
    "topic": "text",
    "channel": "text",
    "accepted": "bool",
    "gate": "text",
    "parameter": "text",
    "unit": "text",
    "value": "float",
    "threshold": "float",
    "margin": "float",
    "passed": "bool",
}
#: Columns of a table of wrong decisions.
WRONG: dict[str, Any] = {
    "time_s": "float",
    "verdict": "text",
    "step": "int",
    "cause": "text",
    "text": "text",
    "remedy": "text",
}


def evidence_with(result: Decided, labels: tuple[Label, ...], places: Sequence[Path]) -> Evidence:
    """Return what decisions are explained by; ``places`` are where the recording may be."""
    return with_recording(evidence_of(result, labels), result.provenance.sha256, places)


@dataclass(frozen=True, slots=True)
class Miss:
    """A true step that no detection answers.

    Attributes
    ----------
    step
        Its number among the scored true steps, from 1.
    time_s
        Its time [s since the first sample].
    cause
        Why, in a word.
    text
        Why, for people.
    """

    step: int
    time_s: float
    cause: str
    text: str


def misses_of(evidence: Evidence) -> tuple[Miss, ...]:
    """Return the missed steps with the reason of each, by time; no change is sought."""
    reasons = StepReasons(evidence, STEP_TOLERANCE_S)
    matching = reasons.matching
    times = matching.truth_ns[matching.missed].tolist()
    misses = [(reasons.at(time_ns), time_ns) for time_ns in times]
    return tuple(
        Miss(int(index) + 1, (time_ns - evidence.start_ns) / NS_PER_S, why.cause, why.text)
        for index, (why, time_ns) in zip(matching.missed, misses, strict=True)
    )


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """Why it was decided so; made by ``results.why()``.

    Attributes
    ----------
    recording
        File name.
    answer
        What was found, with everything that belongs to it.
    warnings
        What the replay warned of.
    start_ns, sha256, places
        Of the recording: its first sample [ns], its bytes, and where it may be.
    steps
        When steps were found, missed and false, for :meth:`plot`.

    Examples
    --------
    >>> import groundtrace as gt
    >>> results = gt.replay("waist-walk", "waist-steps", {"steps.score": 0.8})
    >>> why = results.why(results.misses[0].step)
    >>> why.cause
    'threshold'
    """

    recording: str
    answer: Answer
    warnings: tuple[Warned, ...] = ()
    start_ns: int = 0
    sha256: str = ""
    places: tuple[Path, ...] = ()
    steps: StepTimes = field(default_factory=StepTimes)

    @property
    def details(self) -> Details:
        """All wrong decisions, or what there is at one moment: what ``document`` is made of."""
        return self.answer.details

    @property
    def kind(self) -> Kind:
        """What is explained: steps, picks, fixes or vehicles."""
        return self.answer.kind

    @property
    def step(self) -> int | None:
        """Number of the true step, from 1; None of anything else."""
        return self.answer.step

    @property
    def time_s(self) -> float:
        """The moment [s since the first sample]; NaN of everything."""
        time_ns = self.answer.time_ns
        return float("nan") if time_ns is None else (time_ns - self.start_ns) / NS_PER_S

    @property
    def cause(self) -> str:
        """Why there is no step at the moment, in a word; empty where there is one."""
        reason = getattr(self.details, "reason", None)
        return "" if reason is None else str(reason.cause)

    @property
    def text(self) -> str:
        """Why there is no step at the moment, for people; empty where there is one."""
        reason = getattr(self.details, "reason", None)
        return "" if reason is None else str(reason.text)

    @property
    def remedy(self) -> dict[str, Any]:
        """The smallest change that finds the step, for ``set=`` of a replay; empty without one."""
        remedy = self.answer.remedy
        return {} if remedy is None else _settings(remedy)

    @property
    def before(self) -> Counts | None:
        """Steps right, false and missed as decided; None without a remedy."""
        return None if self.answer.remedy is None else self.answer.remedy.before

    @property
    def after(self) -> Counts | None:
        """The same with the remedy; None without one."""
        return None if self.answer.remedy is None else self.answer.remedy.after

    @property
    def gates(self) -> EventTable:
        """Every gate of every candidate about the moment, a row each; of everything none."""
        chain: tuple[Chain, ...] = getattr(self.details, "chain", ())
        rows = [
            (
                link.time_s,
                link.stage,
                link.topic,
                link.channel,
                link.accepted,
                r.gate,
                r.parameter,
                r.unit,
                r.value,
                r.threshold,
                r.margin,
                r.passed,
            )
            for link in chain
            for r in link.readings
        ]
        return rows_table("gates", GATES, rows)

    @property
    def table(self) -> EventTable:
        """The wrong decisions about steps, a row each; of one moment its :attr:`gates`."""
        if not isinstance(self.details, StepExplanation):
            return self.gates
        rows: list[tuple[Any, ...]] = [
            (m.time_s, "missed", m.step, m.reason.cause, m.reason.text, _remedy_text(m.remedy))
            for m in self.details.missed
        ]
        rows += [
            (
                f.time_s,
                "false",
                0,
                "",
                "" if f.pair is None else f.pair.text,
                _remedy_text(f.remedy),
            )
            for f in self.details.false
        ]
        return rows_table("wrong decisions", WRONG, sorted(rows, key=lambda row: row[0]))

    @property
    def document(self) -> Any:
        """What ``groundtrace why --json`` prints."""
        return plain_document(self.details, self.warnings)

    @property
    def heading(self) -> str:
        """What is explained and when, and the cause: ``step 2 at 7.910 s: no step (threshold)``."""
        what = f"step {self.step} at" if self.step is not None else "at"
        return f"{what} {self.time_s:.3f} s" + (f": no step ({self.cause})" if self.cause else "")

    def plot(self, around_s: float | None = None) -> Any:
        """Draw the signal about the moment with its steps, and below the gates of the candidate.

        Parameters
        ----------
        around_s
            Signal that is drawn on each side [s]; 2 s without it.

        Returns
        -------
        Two ``matplotlib.axes.Axes``, as an array: signal, gates.

        Raises
        ------
        Error
            Where it explains no one moment, or the recording is not at hand.
        """
        from .plots import AROUND_S, plot_moment, recording_at

        if self.answer.time_ns is None:
            raise RecordingError(
                f"{self.recording}: expected the explanation of one moment to draw, found that of "
                f"everything; why(STEP) explains one"
            )
        chain: tuple[Chain, ...] = getattr(self.details, "chain", ())
        recording = recording_at(self.recording, self.sha256, self.places)
        reason = "\n".join(filter(None, (self.text, self._mended())))
        texts = (f"{self.recording}: {self.heading}", reason)
        around = AROUND_S if around_s is None else around_s
        return plot_moment(recording, self.time_s, chain, texts, self.steps, around)

    def _mended(self) -> str:
        """Return the remedy, and what it does to the recording; empty without one."""
        remedy = self.answer.remedy
        if remedy is None:
            return ""
        return f"{remedy.options}: {remedy.effect}"

    def __repr__(self) -> str:
        if self.answer.time_ns is None:
            return f"Explanation({self.recording}, {self._summary()})"
        what = f"step {self.step} at" if self.step is not None else "at"
        description = f"{self.cause}: {self.text}" if self.cause else self._summary()
        return f"Explanation({self.recording}, {what} {self.time_s:.3f} s: {description})"

    def _summary(self) -> str:
        if isinstance(self.details, StepExplanation):
            counts = self.details.counts
            return f"{counts.tp} right, {counts.fn} missed, {counts.fp} false"
        if isinstance(self.details, Moment):
            return "a step was accepted"
        return self.kind

    def _repr_html_(self) -> str:
        return self.table.html(repr(self))


def _settings(remedy: Remedy) -> dict[str, Any]:
    """Return the changes as values by ``stage.parameter``, as the command line reads them."""
    pairs = (change.setting.partition("=") for change in remedy.changes)
    return {name: parse_value(value) for name, _, value in pairs}


def _remedy_text(remedy: Remedy | None) -> str:
    return "" if remedy is None else " ".join(remedy.settings)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Two results of one recording, decision by decision; made by ``compare``.

    Attributes
    ----------
    details
        Everything, as one dataclass.
    """

    details: Compared

    @property
    def p_value(self) -> float | None:
        """McNemar's exact test; None without truth, or where the two differ in no decision."""
        return self.details.p_value

    @property
    def verdicts(self) -> dict[str, int]:
        """How many decisions have each verdict, e.g. ``only A right``."""
        return self.details.verdicts

    @property
    def differing(self) -> EventTable:
        """The decisions that differ, a row each, with what set them apart."""
        header: dict[str, Any] = {
            "time_s": "float",
            "step": "int",
            "verdict": "text",
            "without": "text",
            "cause": "text",
            "text": "text",
        }
        rows = [
            (d.time_s, d.step or 0, d.verdict, d.obstacle.side, d.obstacle.cause, d.obstacle.text)
            for d in self.details.decisions
            if d.obstacle is not None
        ]
        return rows_table("differing decisions", header, rows)

    @property
    def document(self) -> Any:
        """What ``groundtrace compare --json`` prints."""
        return plain_document(self.details)

    def __repr__(self) -> str:
        verdicts = ", ".join(f"{n} {verdict}" for verdict, n in self.verdicts.items())
        p = "" if self.p_value is None else f", p = {self.p_value:.2g}"
        return f"Comparison({self.details.recording}, {verdicts or 'no decisions'}{p})"

    def _repr_html_(self) -> str:
        table = self.differing
        rows = (tuple(row.values()) for row in table.rows())
        return html_table(repr(self), list(table.columns), rows, len(table))


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """Many settings, and which of them are best; made by ``sweep``.

    Attributes
    ----------
    details
        Everything, as one dataclass.
    """

    details: Ranking

    @property
    def best(self) -> dict[str, Any]:
        """The middle of the settings of the highest F1, for ``set=`` of a replay."""
        return dict(self.details.best.settings)

    @property
    def f1(self) -> float:
        """F1 of the best settings, on the recordings that were swept."""
        return self.details.best.f1

    @property
    def table(self) -> EventTable:
        """The highest F1 there are, a row each with the middle of its settings."""
        header: dict[str, Any] = {p.name: "float" for p in self.details.parameters}
        first = self.details.best.settings
        for name in header:
            if not isinstance(first[name], int | float) or isinstance(first[name], bool):
                header[name] = "text"
        header |= {"tp": "int", "fp": "int", "fn": "int", "f1": "float", "same": "int"}
        rows = [
            (*self._values(x.settings, header), x.tp, x.fp, x.fn, x.f1, x.same)
            for x in self.details.top
        ]
        return rows_table("settings", header, rows)

    def _values(self, settings: dict[str, Any], header: dict[str, Any]) -> Iterator[Any]:
        for name, value in settings.items():
            yield str(value) if header[name] == "text" else value

    @property
    def document(self) -> Any:
        """What ``groundtrace sweep --json`` prints."""
        return plain_document(self.details)

    def __repr__(self) -> str:
        d = self.details
        best = ", ".join(f"{name} {value}" for name, value in self.best.items())
        names = ", ".join(d.recordings)
        return f"Sweep({names}, {d.rate.settings} settings, best F1 {self.f1:.3f} at {best})"

    def _repr_html_(self) -> str:
        return self.table.html(repr(self))
