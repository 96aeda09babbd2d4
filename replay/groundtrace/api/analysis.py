"""Analyses of results: explanations, comparisons and sweeps.

The functions take decisions and truth; command line and :class:`~.results.Results` both call them.
The classes are what the functions of the API return: each holds the details as one dataclass, and
``document`` is what ``--json`` prints of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..explain.reasons import StepReasons, matched
from ..explain.redecide import OfflineDecider
from ..explain.remedies import RemedySearch
from ..explain.unfiltered import with_recording
from ..explain.why import Moment, StepExplanation, explain_steps, moment, remedy_of
from ..explain.why_picks import PickAccount, PickMoment, pick_account, pick_moment
from ..explain.why_places import FixMoment, PlaceAccount, PlaceExplainer
from ..explain.why_vehicles import VehicleAccount, VehicleMoment, vehicle_account, vehicle_moment
from ..pipeline.parameters import parse_value
from ..pipeline.results import evidence_of
from .known_truth import kinds_of
from .tables import EventTable, html_table, plain_document, rows_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from groundtrace_codecs.events import Label

    from ..explain.compare import Comparison as Compared
    from ..explain.reasons import Chain
    from ..explain.redecide import Counts
    from ..explain.remedies import Remedy
    from ..explain.sweep import Ranking
    from ..pipeline.results import Evidence
    from ..pipeline.results import Results as Decided
    from ..pipeline.warned import Warned


Kind = Literal["steps", "picks", "fixes", "vehicles"]
#: What is explained of a result, or of one moment of it.
Details = (
    StepExplanation
    | Moment
    | PickAccount
    | PickMoment
    | PlaceAccount
    | FixMoment
    | VehicleAccount
    | VehicleMoment
)
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
class Question:
    """What is to be explained: everything of a kind, one of a number, or a moment.

    Attributes
    ----------
    kind
        Steps, picks, fixes or vehicles; None stands for what a number is given of, else for what
        the pipeline finds.
    step, fix, pick
        Number of a true step, a place or a bad pick, from 1.
    at_s
        A moment [s since the first sample].
    tolerance_s
        Largest distance between a step and its detection [s].
    tolerance_m, pick_tolerance_s
        Largest error of a right place [m] and of a right pick [s].
    stage
        Whose places or picks; empty for the last one that gives them.
    """

    kind: Kind | None = None
    step: int | None = None
    fix: int | None = None
    pick: int | None = None
    at_s: float | None = None
    tolerance_s: float = STEP_TOLERANCE_S
    tolerance_m: float = 1.0
    pick_tolerance_s: float = 2e-3
    stage: str = ""

    def checked_kind(self) -> Kind:
        """Return what is asked for.

        Raises
        ------
        RecordingError
            Where a number is of something else.
        """
        numbers: dict[Kind, int | None] = {
            "steps": self.step,
            "fixes": self.fix,
            "picks": self.pick,
        }
        given = [name for name, number in numbers.items() if number is not None]
        wanted = self.kind or (given[0] if given else "steps")
        if any(name != wanted for name in given):
            options = {"steps": "--step", "fixes": "--fix", "picks": "--pick"}
            found = " and ".join(options[name] for name in given)
            raise RecordingError(f"--kind {wanted}: expected {options[wanted]}, found {found}")
        return wanted


@dataclass(frozen=True, slots=True)
class Answer:
    """What was found of a question.

    Attributes
    ----------
    kind
        What was explained.
    details
        All of it, or the one moment.
    time_ns
        Of the moment [ns]; None of everything.
    step
        Number of the true step that was asked for.
    remedy
        The smallest change that finds that step; None where there is none.
    sought
        Whether a remedy was sought.
    reference
        What places were judged by.
    """

    kind: Kind
    details: Details
    time_ns: int | None = None
    step: int | None = None
    remedy: Remedy | None = None
    sought: bool = False
    reference: str = ""


def explained(evidence: Evidence, name: str, asked: Question) -> Answer:
    """Explain a result, or one moment of it.

    Parameters
    ----------
    evidence
        Of :func:`evidence_with`.
    name
        Of the result, for errors.
    asked
        What.

    Raises
    ------
    RecordingError
        Where there is nothing to explain, no truth that it takes, or no such number.
    """
    chosen = asked.checked_kind()
    at_ns = None if asked.at_s is None else evidence.start_ns + round(asked.at_s * NS_PER_S)
    if chosen == "steps" and asked.kind is None and asked.step is None:
        chosen = "vehicles" if evidence.config.application == "vehicle" else chosen
    return EXPLAINERS[chosen](evidence, name, asked, at_ns)


def _explained_steps(evidence: Evidence, name: str, asked: Question, at_ns: int | None) -> Answer:
    if asked.step is None and at_ns is None:
        if not any(label.kind == "step" for label in evidence.labels):
            raise RecordingError(
                f"{name}: expected true steps (in the recording, or --truth FILE), found "
                f"{kinds_of(evidence.labels)}; --at SECONDS explains a moment without truth"
            )
        return Answer("steps", explain_steps(evidence, asked.tolerance_s))
    tolerance_s = asked.tolerance_s
    step = asked.step if at_ns is None else None
    time_ns = _time_of(evidence, name, asked) if at_ns is None else at_ns
    found = moment(evidence, time_ns, tolerance_s)
    redecider = OfflineDecider(evidence)
    sought = step is not None and found.reason is not None and not redecider.untried
    remedy = None
    if sought:
        reasons = StepReasons(evidence, tolerance_s)
        remedy = remedy_of(RemedySearch(redecider, tolerance_s), reasons, time_ns)
    return Answer("steps", found, time_ns, step, remedy, sought)


def _time_of(evidence: Evidence, name: str, asked: Question) -> int:
    steps = matched(evidence, asked.tolerance_s).truth_ns
    if asked.step is None or not 1 <= asked.step <= len(steps):
        raise RecordingError(f"{name}: --step: expected 1 to {len(steps)}, found {asked.step}")
    return int(steps[asked.step - 1])


def _explained_place(evidence: Evidence, _name: str, asked: Question, at_ns: int | None) -> Answer:
    explainer = PlaceExplainer(evidence, asked.tolerance_m, asked.stage)
    steps_ns, fix = explainer.relocator.arrivals.step_ns, asked.fix
    reference = explainer.reference.kind
    if fix is None and at_ns is None:
        return Answer("fixes", explainer.account(), reference=reference)
    if not 0 < (1 if fix is None else fix) <= len(steps_ns):
        raise RecordingError(f"{evidence.name}: --fix: expected 1 to {len(steps_ns)}, found {fix}")
    row = fix - 1 if fix is not None else int(np.abs(steps_ns - (at_ns or 0)).argmin())
    one = explainer.moment(row)
    time_ns = evidence.start_ns + round(one.fix.time_s * NS_PER_S)
    return Answer("fixes", one, time_ns, reference=reference)


def _explained_picks(evidence: Evidence, _name: str, asked: Question, at_ns: int | None) -> Answer:
    if at_ns is not None:
        return Answer("picks", pick_moment(evidence, at_ns, None, asked.stage), at_ns)
    found = pick_account(evidence, asked.pick_tolerance_s, asked.stage)
    if asked.pick is None:
        return Answer("picks", found)
    if not 1 <= asked.pick <= len(found.bad):
        expected = f"1 to {len(found.bad)}" if found.bad else "none, as no pick is bad"
        raise RecordingError(f"{evidence.name}: --pick: expected {expected}, found {asked.pick}")
    bad = found.bad[asked.pick - 1]
    time_ns = evidence.start_ns + round(bad.time_s * NS_PER_S)
    return Answer("picks", pick_moment(evidence, time_ns, bad, asked.stage), time_ns)


def _explained_vehicles(
    evidence: Evidence, _name: str, _asked: Question, at_ns: int | None
) -> Answer:
    if at_ns is not None:
        return Answer("vehicles", vehicle_moment(evidence, at_ns), at_ns)
    return Answer("vehicles", vehicle_account(evidence))


#: What explains a kind: given the evidence, the name for errors, the question and its moment [ns].
EXPLAINERS: Mapping[Kind, Callable[[Evidence, str, Question, int | None], Answer]] = {
    "steps": _explained_steps,
    "picks": _explained_picks,
    "fixes": _explained_place,
    "vehicles": _explained_vehicles,
}


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


def misses_of(evidence: Evidence, tolerance_s: float = STEP_TOLERANCE_S) -> tuple[Miss, ...]:
    """Return the missed steps with the reason of each, by time; no change is sought."""
    reasons = StepReasons(evidence, tolerance_s)
    matching = reasons.matching
    times = matching.truth_ns[matching.missed].tolist()
    found = [(reasons.at(time_ns), time_ns) for time_ns in times]
    return tuple(
        Miss(int(index) + 1, (time_ns - evidence.start_ns) / NS_PER_S, why.cause, why.text)
        for index, (why, time_ns) in zip(matching.missed, found, strict=True)
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

    Examples
    --------
    >>> import groundtrace as gt
    >>> results = gt.replay("waist-walk", "waist-steps", {"steps.swing": 1.5})
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

    def plot(self) -> Any:
        """Draw the signal about the moment with its candidates, and below their gates.

        Returns
        -------
        Two ``matplotlib.axes.Axes``, as an array: signal, gates.

        Raises
        ------
        Error
            Where it explains no one moment, or the recording is not at hand.
        """
        from .plots import plot_moment, recording_at

        if self.answer.time_ns is None:
            raise RecordingError(
                f"{self.recording}: expected the explanation of one moment to draw, found that of "
                f"everything; why(STEP) explains one"
            )
        chain: tuple[Chain, ...] = getattr(self.details, "chain", ())
        recording = recording_at(self.recording, self.sha256, self.places)
        return plot_moment(recording, self.time_s, chain, self.text)

    def __repr__(self) -> str:
        if self.answer.time_ns is None:
            return f"Explanation({self.recording}, {self._summary()})"
        what = f"step {self.step} at" if self.step is not None else "at"
        said = f"{self.cause}: {self.text}" if self.cause else self._summary()
        return f"Explanation({self.recording}, {what} {self.time_s:.3f} s: {said})"

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
        said = ", ".join(f"{n} {verdict}" for verdict, n in self.verdicts.items())
        p = "" if self.p_value is None else f", p = {self.p_value:.2g}"
        return f"Comparison({self.details.recording}, {said or 'no decisions'}{p})"

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
