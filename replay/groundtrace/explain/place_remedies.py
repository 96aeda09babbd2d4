"""Remedies of places: the smallest single change that brings one under the tolerance.

Each is tried by locating again from stored picks, and says what it does to all other places. One
that does harm is not offered: :meth:`Figures.harmed_by`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..errors import PipelineError
from ..parameters import describe
from .reference import Reference, reference_of
from .relocate import Located
from .remedies import INFLUENCE_S, NEARBY_S, thresholds

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from .redecide import Redecider
    from .relocate import Arrivals, Relocator
    from .sensors import Fault

#: Thresholds of one gate of the stages before that are tried.
TRIES = 3


@dataclass(frozen=True, slots=True)
class Figures:
    """How the places of a recording are.

    Attributes
    ----------
    right, far, rejected, missing
        Accepted within the tolerance, accepted farther off, rejected by a gate, too few arrivals.
    rmse_m
        Root mean square of the errors of the accepted ones [m]; NaN where nothing is known.
    residual
        Median of what the places leave unexplained, in the localizer's unit; NaN without any.
    """

    right: int
    far: int
    rejected: int
    missing: int
    rmse_m: float
    residual: float

    @property
    def bad(self) -> int:
        """Places that are far off, rejected or missing."""
        return self.far + self.rejected + self.missing

    def harmed_by(self, after: Figures) -> bool:
        """Whether a change does harm: more bad places, or more right ones lost than bad ones gone.

        Other picks may make more or fewer places, so that the one does not follow from the other.
        """
        return after.bad > self.bad or self.right - after.right > self.bad - after.bad


@dataclass(frozen=True, slots=True)
class PlaceRemedy:
    """A change and what it does.

    Attributes
    ----------
    change
        What to do, as ``--set stage.parameter=value`` where that does it.
    error_m
        Error of the place in question with it [m]; NaN where unknown.
    before, after
        All places without and with it.
    """

    change: str
    error_m: float
    before: Figures
    after: Figures


def figures(located: Located, reference: Reference, tolerance_m: float) -> Figures:
    """Count places; where no reference says how far off one is, an accepted one is right."""
    accepted, errors = located.block.accepted, reference.errors_m(located)
    somewhere = np.isfinite(located.xy).all(axis=1)
    far = accepted & (errors > tolerance_m)
    return Figures(
        int((accepted & ~far).sum()),
        int(far.sum()),
        int((somewhere & ~accepted).sum()),
        int((~somewhere).sum()),
        reference.rmse_m(located),
        float(np.median(located.residual[somewhere])) if somewhere.any() else float("nan"),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Again:
    """Everything picked and located again: the places, their errors, shape (m,) [m], figures."""

    located: Located
    errors_m: NDArray[np.float64]
    figures: Figures


class PlaceHealer:
    """Looks for remedies of the bad places of one result.

    Parameters
    ----------
    relocator, redecider
        Locate again, and decide the stages before again.
    reference
        Where somebody was.
    tolerance_m
        Largest error of a right place [m].
    """

    def __init__(
        self,
        relocator: Relocator,
        redecider: Redecider,
        reference: Reference,
        tolerance_m: float,
    ) -> None:
        self.relocator = relocator
        self.redecider = redecider
        self.reference = reference
        self.tolerance_m = tolerance_m
        self.before = figures(relocator.located, reference, tolerance_m)
        self._mended: dict[tuple[int, ...], Located] = {}
        self._relocated: dict[tuple[str, float], Located] = {}
        self._again: dict[tuple[str, str, float], _Again] = {}

    def without_faults(self, faults: Sequence[Fault]) -> Located:
        """Locate all steps with sensors' faults mended; what was asked last is remembered."""
        key = tuple(fault.channel for fault in faults)
        if key not in self._mended:
            arrivals, positions = self.relocator.arrivals, self.relocator.positions
            for fault in faults:
                arrivals, positions = fault.mended(arrivals, positions)
            self._mended[key] = self.relocator.locate(arrivals, positions)
        return self._mended[key]

    def by_fault(self, row: int, fault: Fault) -> PlaceRemedy | None:
        """Return the mending of one sensor, where that helps a place."""
        located = self.without_faults((fault,))
        return self._tried(row, mending(fault, self.relocator), located)

    def by_gate(self, row: int) -> PlaceRemedy | None:
        """Return the smallest change of the localizer's own gate that rejects a place."""
        failed = self.relocator.located.failed(row)
        if failed is None or not self._near(self.relocator.located, row):
            return None
        names = [gate.name for gate in self.relocator.part.spec.gates]
        gate = self.relocator.part.spec.gates[names.index(failed.gate)]
        for value in self._thresholds(gate.parameter, gate, np.array([failed.value])):
            remedy = self._tried(
                row,
                f"--set {self.relocator.part.spec.stage}.{gate.parameter}={value:.10g}",
                self._with(gate.parameter, value),
            )
            if remedy is not None:
                return remedy
        return None

    def by_pick(self, row: int, channels: Sequence[int]) -> PlaceRemedy | None:
        """Return the leaving out of one arrival that helps most, of some channels."""
        best: tuple[float, int, Located] | None = None
        for channel in channels:
            others = self.relocator.arrivals.without(channel, row).times_s[row]
            located = self.relocator.locate_row(row, others)
            if located.block.accepted[0]:
                error = self._error(located, 0, row)
                rank = error if np.isfinite(error) else float(located.residual[0])
                if best is None or rank < best[0]:
                    best = (rank, channel, located)
        if best is None:
            return None
        name = self.relocator.names[best[1]]
        whole = self._with_row(row, best[2])
        return self._tried(row, f"leave {name} out of this step", whole)

    def by_picking(self, row: int, channels: Sequence[int]) -> PlaceRemedy | None:
        """Return the smallest change of the picker's gates that gives a place more arrivals.

        None behind an array method: with other picks it would have to look at the signal again.
        """
        if self.relocator.correlated:
            return None
        time_ns = int(self.relocator.arrivals.step_ns[row])
        for stage, parameter, value in self._picker_changes(row, channels):
            if not self._helps(time_ns, row, self._near_by(stage, parameter, value, time_ns)):
                continue
            again = self._picked_again(stage, parameter, value)
            if self.before.harmed_by(again.figures):
                continue
            index = int(np.abs(again.located.block.time_ns - time_ns).argmin())
            change = f"--set {stage}.{parameter}={value:.10g}"
            return PlaceRemedy(change, float(again.errors_m[index]), self.before, again.figures)
        return None

    def _near_by(self, stage: str, parameter: str, value: float, time_ns: int) -> Arrivals:
        """Pick again with one parameter changed, about one time."""
        reach = round(NEARBY_S * NS_PER_S)
        try:
            near = self.redecider.outcome(
                {(stage, parameter): value}, (time_ns - reach, time_ns + reach)
            )
        except PipelineError:
            return self.relocator.nothing
        return self.relocator.arrivals_of(near)

    def _picked_again(self, stage: str, parameter: str, value: float) -> _Again:
        """Pick and locate everything again; what was asked is remembered."""
        key = (stage, parameter, value)
        if key not in self._again:
            arrivals = self.relocator.arrivals_of(
                self.redecider.outcome({(stage, parameter): value})
            )
            located = self.relocator.locate(arrivals)
            reference = reference_of(self.relocator.evidence, located)
            self._again[key] = _Again(
                located,
                reference.errors_m(located),
                figures(located, reference, self.tolerance_m),
            )
        return self._again[key]

    def _helps(self, time_ns: int, row: int, arrivals: Arrivals) -> bool:
        """Whether a step near a time, with other arrivals, is placed well."""
        if not len(arrivals.step_ns):
            return False
        index = int(np.abs(arrivals.step_ns - time_ns).argmin())
        late_s = abs(int(arrivals.step_ns[index]) - time_ns) / NS_PER_S
        if late_s > self.relocator.parameters.window_s:
            return False
        located = self.relocator.locate_row(row, arrivals.times_s[index])
        error = self._error(located, 0, row)
        return bool(located.block.accepted[0]) and not error > self.tolerance_m

    def _picker_changes(
        self, row: int, channels: Sequence[int]
    ) -> Iterator[tuple[str, str, float]]:
        """Yield thresholds that let in candidates of channels near a step."""
        part = self.relocator.picking
        time_ns = int(self.relocator.arrivals.step_ns[row])
        reach = round(min(INFLUENCE_S, self.relocator.parameters.window_s) * NS_PER_S)
        rows = part.between(time_ns - reach, time_ns + reach)
        names = [part.spec.channels.index(self.relocator.names[c]) for c in channels]
        rows = rows[np.isin(part.candidates.channel[rows], names) & ~part.accepted[rows]]
        whole = self.redecider.whole_numbers(part.spec.stage)
        for column, gate in enumerate(part.spec.gates):
            found = np.unique(part.gate_value[rows, column].astype(np.float64))
            values = thresholds(gate, found, whole=gate.parameter in whole)
            for value in values[:TRIES]:
                yield part.spec.stage, gate.parameter, value

    def _thresholds(self, parameter: str, gate: object, found: NDArray[np.float64]) -> list[float]:
        infos = {info.name: info for info in describe(self.relocator.kind.Parameters)}
        whole = isinstance(infos[parameter].default, int)
        return thresholds(gate, found, whole=whole)  # type: ignore[arg-type]

    def _with(self, parameter: str, value: float) -> Located:
        """Locate with one parameter changed; what was asked is remembered."""
        key = (parameter, value)
        if key not in self._relocated:
            changed = replace(self.relocator.parameters, **{parameter: value})
            self._relocated[key] = self.relocator.locate(parameters=changed)
        return self._relocated[key]

    def _with_row(self, row: int, one: Located) -> Located:
        """Return all places with one of them replaced."""
        whole, single = self.relocator.located, one.block
        block = whole.block
        value, accepted = block.value.copy(), block.accepted.copy()
        gate_value, margin = block.gate_value.copy(), block.margin.copy()
        value[row], accepted[row] = single.value[0], single.accepted[0]
        gate_value[row], margin[row] = single.gate_value[0], single.margin[0]
        changed = replace(
            block, value=value, gate_value=gate_value, margin=margin, accepted=accepted
        )
        return Located(changed, whole.ties)

    def _tried(self, row: int, change: str, located: Located) -> PlaceRemedy | None:
        if not located.block.accepted[row] or not self._near(located, row):
            return None
        after = figures(located, self.reference, self.tolerance_m)
        if self.before.harmed_by(after):
            return None
        return PlaceRemedy(change, self._error(located, row, row), self.before, after)

    def _near(self, located: Located, row: int) -> bool:
        return not self._error(located, row, row) > self.tolerance_m

    def _error(self, located: Located, index: int, row: int) -> float:
        """Return how far a place is from where somebody was at a step [m]; NaN if unknown."""
        return float(np.hypot(*(located.xy[index] - self.reference.xy[row])))


def mending(fault: Fault, relocator: Relocator) -> str:
    """Return in words how a sensor's fault is mended."""
    name = relocator.names[fault.channel]
    if fault.cause == "clock":
        known = {s.channel: s.clock_offset_s for s in relocator.geometry.sensors}
        return f"clock_offset_s = {known[name] + fault.offset_s:.4f} for {name} in the geometry"
    x, y = fault.place
    return f"x = {x:.2f}, y = {y:.2f} for {name} in the geometry"
