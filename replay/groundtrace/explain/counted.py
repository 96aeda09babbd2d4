"""What a sweep counts: steps, or passes of vehicles at stations, told or merely heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..plugins import stage_named
from ..score.matching import match
from ..score.passes import PASS_TOLERANCE_S
from ..score.places import ignored
from ..score.step_matching import TrueSteps, match_steps
from ..stage import emitted
from .bootstrap import Verdicts
from .evidence import step_times

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import StageSpec
    from groundtrace_codecs.labels import Label

    from ..gates import Candidates
    from ..pipeline import PipelineConfig
    from ..score import StepMatch
    from .evidence import Evidence

#: What is counted, by what the deciding stage emits; a later one here goes before an earlier.
CountedKind = Literal["presence", "pass", "step"]
KINDS: tuple[CountedKind, ...] = ("presence", "pass", "step")
#: Default tolerance of a match [s].
TOLERANCE_S: dict[CountedKind, float] = {"step": 0.12, "pass": PASS_TOLERANCE_S, "presence": 1.0}
#: Cycles in which a station hears a vehicle, no further apart, are of one stay [s]; a stay that is
#: this far from any pass is of no vehicle that came by [s].
_BRIDGE_S, _AWAY_S = 1.0, 15.0


class Truth(Protocol):
    """The truth of a recording, made ready once for many settings."""

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Return how the candidates that passed all gates, topic by topic, answer it."""


def counted_kind(config: PipelineConfig) -> CountedKind:
    """Return what a sweep of a pipeline counts; steps where it has nothing else."""
    given = {emitted(stage_named(s.use)) for s in config.stage}
    return next((kind for kind in reversed(KINDS) if kind in given), "step")


def noun_of(kind: CountedKind) -> str:
    """Return how what is counted is called."""
    return "steps" if kind == "step" else "passes"


def matched(evidence: Evidence, tolerance_s: float) -> StepMatch:
    """Match the steps of a result, as decided, to its truth."""
    e = evidence
    return match_steps(e.labels, step_times(e), e.start_ns, e.end_ns, tolerance_s)


def truth_for(evidence: Evidence, labels: Sequence[Label], tolerance_s: float) -> Truth:
    """Return the truth of what a pipeline's sweep counts."""
    kind = counted_kind(evidence.config)
    if kind == "step":
        steps = TrueSteps.of(labels, evidence.start_ns, evidence.end_ns, tolerance_s)
        return StepTruth(steps)
    stations = {}
    if evidence.geometry is not None:
        site = evidence.geometry.stations()
        stations = {channel: site.names[index] for channel, index in site.of_channel.items()}
    times: dict[str, list[int]] = {}
    true = [x for x in labels if x.kind == "pass"]
    left_out = ignored(labels, np.array([x.time_ns for x in true], np.int64))
    for label, no in zip(true, left_out, strict=True):
        if not no:
            times.setdefault(label.channel, []).append(label.time_ns)
    truth = {name: np.array(sorted(those), np.int64) for name, those in sorted(times.items())}
    return PassTruth(truth, stations, tuple(labels), tolerance_s, heard=kind == "presence")


@dataclass(frozen=True, slots=True, eq=False)
class StepTruth:
    """True steps.

    Attributes
    ----------
    steps
        Those that are scored.
    """

    steps: TrueSteps

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Match the times of all topics."""
        found = self.steps.match(times_of(passed))
        hit = np.zeros(len(found.truth_ns), np.bool_)
        hit[found.pairs[:, 0]] = True
        return Verdicts(hit, found.found_ns[found.false])


@dataclass(frozen=True, slots=True, eq=False)
class PassTruth:
    """True passes at stations.

    Attributes
    ----------
    times_ns
        Of each station, sorted [ns].
    stations
        The station of each channel; one that is not there is a station itself.
    labels
        All truth: what is to be ignored.
    tolerance_s
        Of the match [s].
    heard
        Whether it is enough that the station hears a vehicle at the moment; what it hears a
        quarter of a minute from any pass, without a break, then counts as one false.
    """

    times_ns: dict[str, NDArray[np.int64]]
    stations: dict[str, str]
    labels: tuple[Label, ...]
    tolerance_s: float
    heard: bool

    def verdicts(self, passed: Sequence[tuple[StageSpec, Candidates]]) -> Verdicts:
        """Match station by station."""
        found = self._found(passed)
        none = np.empty(0, np.int64)
        hits, false = [np.empty(0, np.bool_)], [none]
        judge = self._overheard if self.heard else self._told
        for station in sorted({*self.times_ns, *found}):
            truth = self.times_ns.get(station, none)
            hit, wrong = judge(truth, found.get(station, none))
            hits.append(hit)
            false.append(wrong)
        wrong = np.concatenate(false)
        return Verdicts(np.concatenate(hits), wrong[~ignored(self.labels, wrong)])

    def _found(
        self, passed: Sequence[tuple[StageSpec, Candidates]]
    ) -> dict[str, NDArray[np.int64]]:
        parts: dict[str, list[NDArray[np.int64]]] = {}
        for spec, candidates in passed:
            for number, channel in enumerate(spec.channels):
                station = self.stations.get(channel, channel)
                rows = candidates.channel == number
                parts.setdefault(station, []).append(candidates.time_ns[rows])
        return {name: np.sort(np.concatenate(times)) for name, times in parts.items()}

    def _told(
        self, truth: NDArray[np.int64], found: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        origin = truth[0] if len(truth) else 0
        pairs = match((truth - origin) / NS_PER_S, (found - origin) / NS_PER_S, self.tolerance_s)
        hit, right = np.zeros(len(truth), np.bool_), np.zeros(len(found), np.bool_)
        hit[pairs[:, 0]], right[pairs[:, 1]] = True, True
        return hit, found[~right]

    def _overheard(
        self, truth: NDArray[np.int64], found: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        hit = _away(truth, found) <= self.tolerance_s
        new = np.diff(found, prepend=-(2**62)) > _BRIDGE_S * NS_PER_S
        stays = found[new]
        far = _away(found, truth) > _AWAY_S
        # a stay is false where all of it is far from any pass
        number = np.cumsum(new) - 1
        near = np.bincount(number[~far], minlength=len(stays)) > 0
        return hit, stays[~near]


def _away(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how far each time is from the nearest other, shape (n,) [s]."""
    if not len(others):
        return np.full(len(times), np.inf)
    after = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
    after = np.minimum(after, len(others) - 1)
    apart = np.minimum(np.abs(times - others[after]), np.abs(times - others[after - 1]))
    return np.asarray(apart / NS_PER_S, np.float64)


def times_of(passed: Sequence[tuple[StageSpec, Candidates]]) -> NDArray[np.int64]:
    """Return the times of candidates of all topics [ns]."""
    if len(passed) == 1:
        return passed[0][1].time_ns
    return np.concatenate([np.empty(0, np.int64), *(found.time_ns for _, found in passed)])
