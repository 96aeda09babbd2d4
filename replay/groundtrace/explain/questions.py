"""Questions about a result, and what explains each kind of thing that may be asked about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import RecordingError, UsageError
from ..evaluation.matching import STEP_TOLERANCE_S
from ..evaluation.truth import kinds_of
from ..pipeline.plugins import stage_named
from ..pipeline.stage import emitted
from .reasons import StepReasons, matched
from .redecide import OfflineDecider
from .remedies import RemedySearch
from .why import Moment, StepExplanation, explain_steps, moment, remedy_of
from .why_picks import PickAccount, PickMoment, pick_account, pick_moment
from .why_places import FixMoment, PlaceAccount, PlaceExplainer
from .why_vehicles import VehicleAccount, VehicleMoment, vehicle_account, vehicle_moment

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ..pipeline.results import Evidence
    from .remedies import Remedy

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
        UsageError
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
            given_options = " and ".join(options[name] for name in given)
            raise UsageError(f"--kind {wanted}: expected {options[wanted]}, found {given_options}")
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
    if at_ns is not None and not evidence.start_ns <= at_ns <= evidence.end_ns:
        length_s = (evidence.end_ns - evidence.start_ns) / NS_PER_S
        raise UsageError(f"--at: expected 0 to {length_s:.3f} s, found {asked.at_s:g} s")
    if chosen == "steps" and asked.kind is None and asked.step is None:
        chosen = _kind_of(evidence, name, at_ns)
    return EXPLAINERS[chosen](evidence, name, asked, at_ns)


def _kind_of(evidence: Evidence, name: str, at_ns: int | None) -> Kind:
    """Return what results have that can be explained, where nobody asks for a kind."""
    if evidence.config.application == "vehicle":
        return "vehicles"
    given = {emitted(stage_named(stage.use)) for stage in evidence.config.stage}
    kinds: dict[str, Kind] = {"step": "steps", "fix": "fixes", "pick": "picks"}
    chosen = next((kind for event, kind in kinds.items() if event in given), None)
    if given and chosen is None and at_ns is None:
        event_names = ", ".join(sorted(given))
        raise RecordingError(
            f"{name}: expected steps, picks, fixes or passes to explain, found {event_names}; "
            f"--at SECONDS explains a moment"
        )
    return chosen or "steps"


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
    step_moment = moment(evidence, time_ns, tolerance_s)
    redecider = OfflineDecider(evidence)
    sought = step is not None and step_moment.reason is not None and not redecider.untried
    remedy = None
    if sought:
        reasons = StepReasons(evidence, tolerance_s)
        remedy = remedy_of(RemedySearch(redecider, tolerance_s), reasons, time_ns)
    return Answer("steps", step_moment, time_ns, step, remedy, sought)


def _time_of(evidence: Evidence, name: str, asked: Question) -> int:
    steps = matched(evidence, asked.tolerance_s).truth_ns
    if asked.step is None or not 1 <= asked.step <= len(steps):
        raise UsageError(f"{name}: --step: expected 1 to {len(steps)}, found {asked.step}")
    return int(steps[asked.step - 1])


def _explained_place(evidence: Evidence, _name: str, asked: Question, at_ns: int | None) -> Answer:
    explainer = PlaceExplainer(evidence, asked.tolerance_m, asked.stage)
    steps_ns, fix = explainer.relocator.arrivals.step_ns, asked.fix
    reference = explainer.reference.kind
    if fix is None and at_ns is None:
        return Answer("fixes", explainer.account(), reference=reference)
    if not 0 < (1 if fix is None else fix) <= len(steps_ns):
        raise UsageError(f"{evidence.name}: --fix: expected 1 to {len(steps_ns)}, found {fix}")
    row = fix - 1 if fix is not None else int(np.abs(steps_ns - (at_ns or 0)).argmin())
    one = explainer.moment(row)
    time_ns = evidence.start_ns + round(one.fix.time_s * NS_PER_S)
    return Answer("fixes", one, time_ns, reference=reference)


def _explained_picks(evidence: Evidence, _name: str, asked: Question, at_ns: int | None) -> Answer:
    if at_ns is not None:
        return Answer("picks", pick_moment(evidence, at_ns, None, asked.stage), at_ns)
    account = pick_account(evidence, asked.pick_tolerance_s, asked.stage)
    if asked.pick is None:
        return Answer("picks", account)
    if not 1 <= asked.pick <= len(account.bad):
        expected = f"1 to {len(account.bad)}" if account.bad else "none, as no pick is bad"
        raise UsageError(f"{evidence.name}: --pick: expected {expected}, found {asked.pick}")
    bad = account.bad[asked.pick - 1]
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
