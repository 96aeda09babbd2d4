"""Locating again: the same localizer on stored picks, with something changed.

What may be changed: a parameter, the places of sensors, single arrivals. Without a change the
places are those that were stored.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import CandidateBlock, Pick, StepEvent
from groundtrace_codecs.geometry import Geometry
from groundtrace_codecs.signals import NS_PER_S

from ..gates import Candidates, decided_block
from ..localizers.api import Site, first_arrivals, place_candidate
from ..parameters import build
from ..plugins import stage_named
from .parts import accepted_picks, before, locating, onsets_of
from .readings import readings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .evidence import Evidence, StageEvidence
    from .readings import GateReading
    from .redecide import Outcome

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Arrivals:
    """What a localizer is given.

    Attributes
    ----------
    step_ns
        Shape (m,): times of the steps [ns].
    times_s
        Shape (m, n): first arrival at each sensor after each step [s]; NaN where there is none.
    """

    step_ns: NDArray[np.int64]
    times_s: Array

    def without(self, channel: int, row: int | None = None) -> Arrivals:
        """Return the same without a channel, in one step or in all."""
        return self.shifted(channel, float("nan"), row)

    def shifted(self, channel: int, by_s: float, row: int | None = None) -> Arrivals:
        """Return the same with a channel moved in time, in one step or in all."""
        times = self.times_s.copy()
        times[slice(None) if row is None else row, channel] += by_s
        return Arrivals(self.step_ns, times)


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Places of all steps.

    Attributes
    ----------
    block
        The candidates of the localizer, decided, one a step.
    ties
        Shape (m,): how many regions or nodes explain the arrivals equally well.
    """

    block: CandidateBlock
    ties: NDArray[np.int64]

    @property
    def xy(self) -> Array:
        """Shape (m, 2): places, decided or not [m]; NaN where there are too few arrivals."""
        found: Array = self._columns("x", "y")
        return found

    @property
    def sigma_m(self) -> Array:
        """Shape (m,): how sure each place is, as the localizer says [m]."""
        found: Array = self._columns("sigma")[:, 0]
        return found

    @property
    def residual(self) -> Array:
        """Shape (m,): what each place leaves unexplained, in the localizer's unit."""
        found: Array = self._columns("residual")[:, 0]
        return found

    def _columns(self, *wanted: str) -> Array:
        names = [column.name for column in self.block.spec.columns]
        return self.block.value[:, [names.index(name) for name in wanted]].astype(np.float64)

    def failed(self, row: int) -> GateReading | None:
        """Return the first gate that a place failed, or None."""
        return next((r for r in readings(self.block, row) if not r.passed), None)


class Relocator:
    """Locates the steps of one result again.

    Parameters
    ----------
    evidence
        What was stored.
    stage
        Name of the stage that locates; empty stands for the last one.

    Raises
    ------
    RecordingError
        Where no such stage located anything.
    """

    def __init__(self, evidence: Evidence, stage: str = "") -> None:
        self.evidence = evidence
        self.part = locating(evidence, stage)
        key = self.part.spec.stage
        self.config = next(s for s in evidence.config.stage if s.key == key)
        self.kind: Any = stage_named(self.config.use)
        self.parameters = build(self.kind.Parameters, self.config.parameters, key)
        self.picking = before(evidence, self.part, ("pick",))
        self.stepping = before(evidence, self.part, ("step", "impact"))
        self.geometry = evidence.geometry or Geometry()
        self.channels, self.positions = self.geometry.placed(self.picking.spec.channels)
        self.names = tuple(self.channels)
        self._ahead: Any = None
        self._seen = 0
        self.arrivals = self._stored(self.picking)
        onsets = onsets_of(evidence, self.picking)
        #: What was picked channel by channel; the arrivals themselves without an array method.
        self.onsets = self.arrivals if onsets is self.picking else self._stored(onsets)
        self.located = self.locate()

    def locate(
        self,
        arrivals: Arrivals | None = None,
        positions: Array | None = None,
        parameters: Any = None,
    ) -> Located:
        """Locate all steps, with other arrivals, places of sensors or parameters where given."""
        arrivals = self.arrivals if arrivals is None else arrivals
        parameters = self.parameters if parameters is None else parameters
        worker = self._worker(self.positions if positions is None else positions, parameters)
        return self._decided(worker, parameters, arrivals)

    def _decided(self, worker: Any, parameters: Any, arrivals: Arrivals) -> Located:
        found = [worker.locate(times) for times in arrivals.times_s]
        rows = [place_candidate(int(t), f) for t, f in zip(arrivals.step_ns, found, strict=True)]
        none = Candidates.empty(len(worker.columns))
        candidates = Candidates.concatenate([none, *rows])
        block, _ = decided_block(self.part.spec, candidates, worker, parameters)
        return Located(block, np.array([f.ties for f in found], np.int64))

    def locate_row(self, row: int, times_s: Array, positions: Array | None = None) -> Located:
        """Locate one step from other arrivals, after the steps before it as they are.

        Parameters
        ----------
        row
            The step.
        times_s
            Shape (n,): its arrivals [s]; NaN where there is none.
        positions
            Shape (n, 2): other places of the sensors [m], for all steps so far.
        """
        worker = self._worker_before(row, positions)
        step_ns = self.arrivals.step_ns[row : row + 1]
        return self._decided(worker, self.parameters, Arrivals(step_ns, times_s[None]))

    def _worker_before(self, row: int, positions: Array | None = None) -> Any:
        """Return a localizer that has seen the steps before one: it may learn from them."""
        if positions is not None and not np.array_equal(positions, self.positions):
            worker = self._worker(positions, self.parameters)
            for times in self.arrivals.times_s[:row]:
                worker.locate(times)
            return worker
        if self._ahead is None or row < self._seen:
            self._ahead, self._seen = self._worker(self.positions, self.parameters), 0
        for times in self.arrivals.times_s[self._seen : row]:
            self._ahead.locate(times)
        self._seen = row
        return copy.deepcopy(self._ahead)

    def arrivals_of(self, outcome: Outcome) -> Arrivals:
        """Return the arrivals that a pipeline decided with other settings would give."""
        topic = self.part.spec.topic
        picks = [
            e
            for e in outcome.events
            if isinstance(e, Pick) and (e.stage, e.topic) == (self.picking.spec.stage, topic)
        ]
        steps = [
            e.time_ns
            for e in outcome.events
            if isinstance(e, StepEvent) and (e.stage, e.topic) == (self.stepping.spec.stage, topic)
        ]
        return self._gathered(np.array(steps, np.int64), picks)

    @property
    def correlated(self) -> bool:
        """Whether the arrivals are those of an array method, not onsets."""
        return self.arrivals is not self.onsets

    @property
    def nothing(self) -> Arrivals:
        """No steps at all."""
        return Arrivals(np.empty(0, np.int64), np.empty((0, len(self.channels))))

    def _stored(self, picking: StageEvidence) -> Arrivals:
        return self._gathered(self.part.candidates.time_ns, accepted_picks(picking))

    def _gathered(self, step_ns: NDArray[np.int64], picks: Sequence[Pick]) -> Arrivals:
        """Gather the arrivals of each step; only picks of its window are looked at."""
        ordered = sorted(picks, key=lambda pick: pick.time_ns)
        times = np.array([pick.time_ns for pick in ordered], np.int64)
        window_s, ahead = self.parameters.window_s, self.geometry.clock_offsets(self.channels)
        first = np.searchsorted(times, step_ns, side="left")
        last = np.searchsorted(times, step_ns + round(window_s * NS_PER_S), side="right")
        rows = [
            first_arrivals(ordered[a:b], self.channels, int(t), window_s, ahead)
            for a, b, t in zip(first, last, step_ns, strict=True)
        ]
        found = np.array(rows, np.float64).reshape(len(step_ns), len(self.channels))
        return Arrivals(step_ns, found)

    def _worker(self, positions: Array, parameters: Any) -> Any:
        outline = np.array(self.geometry.outline, np.float64)
        worker = self.kind(parameters)
        room, medium = outline if len(outline) else None, self.geometry.medium
        worker.prepare(Site(positions, room, medium, self.geometry.length_unit))
        return worker


def stored(part: StageEvidence) -> Located:
    """Return the places of a stage as decided; how many regions tied is not kept: 0."""
    c = part.candidates
    block = CandidateBlock(
        part.spec, c.time_ns, c.channel, c.value, part.gate_value, part.margin, part.accepted
    )
    return Located(block, np.zeros(len(c), np.int64))
