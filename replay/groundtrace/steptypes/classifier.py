"""Types of steps: what is measured of each step, and the gates its four possible types must pass.

Source: EPFL, sections on preprocessing, recognition of steps, and corrections. Every step has four
candidates, one for each type; a candidate is accepted where it passes all tests of its chain:

- both chains: the lateral swing against the frontal and vertical ones, which leaves one chain where
  a step has a pattern in both (the document compares amplitudes for the lateral axis alone);
- frontal chain: the vertical window, the area density, the order of the maxima (forward: the
  frontal before the vertical one; backward: after it);
- lateral chain: the lobe, the slopes (left: the rise to the right is the steeper one, which ends
  the push to the left; right: the fall is), and whether the contact ends the push. The second
  contact of a side step, with which the feet are closed, is no step of its own.

The late corrections of the document work on the frontal chain, with two steps before and two after
in the same walk: a degenerate pattern begins or ends with a neighbour's, so that its density is
that of the neighbour; and where a step is ordered otherwise than both steps before it or both
after it, its slopes are asked, and where they do not confirm it, it is ordered as the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Quantity, StepEvent
from groundtrace_codecs.signals import SignalBlock

from ..gates import Candidates, Level

# Ahead is read at run time, where the parameters are described
from ..heading.walking_axis import Ahead, WalkingAxis, step_swing
from ..parameters import gate, measured
from ..stage import CannotStart, Context, Input, Stage
from .chains import PHASE, frontal, lateral, strip_of
from .corrections import Shape, common_share, corrected_lead, linked
from .type_gates import FRONTAL, LATERAL, TYPES, Applies, Duplicate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock

    from .follower import Follower


@dataclass(frozen=True, slots=True)
class StepTypeParameters:
    """Parameters of :class:`StepTypes`."""

    forward: Annotated[
        Ahead,
        measured("", "Sensor axis that looks ahead to 35 degrees; walk: the walk tells."),
    ] = "walk"
    gravity_s: Annotated[float, measured("s", "Time constant of gravity.", gt=0)] = 2.0
    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 4.0
    late_s: Annotated[
        float, measured("s", "Longest time by which steps are announced late.", ge=2)
    ] = 20.0
    share: Annotated[
        float,
        gate(
            "1", "Lateral range over the frontal and vertical from which on steps go aside.", ge=0
        ),
    ] = 1.8
    window: Annotated[
        float, gate("steps", "Least time that the vertical signal is above its mean.", ge=0)
    ] = 0.15
    density: Annotated[float, gate("1", "Least area density of the frontal pattern.", ge=0)] = 0.01
    order: Annotated[float, gate("steps", "Least distance of the two maxima.", ge=0)] = 0.0
    lobe: Annotated[
        float, gate("1", "Least distance of the lateral maximum from the middle.", ge=0)
    ] = 0.02
    slope: Annotated[float, gate("1", "Least logarithm of the steeper slope's excess.", ge=0)] = 0.0
    leading: Annotated[
        float, gate("1", "Least distance of the contact into the lateral pattern's steep side.")
    ] = -0.05


class StepTypes(Stage):
    """A step is forward, backward, to the left or to the right by the order of its movements.

    Each step has one candidate for each type. That of the accepted one is given as a step again,
    with its type and of this stage; a step without an accepted type is not given again. Steps come
    out in the order of time. A gap that is not bridged ends all walks.
    """

    Parameters = StepTypeParameters
    takes = (Input(SignalBlock, hold=False), Input(StepEvent))
    gives = (StepEvent,)
    columns = (
        Quantity("evidence", "1"),
        Quantity("share", "1"),
        Quantity("window", "steps"),
        Quantity("density", "1"),
        Quantity("order", "steps"),
        Quantity("lobe", "1"),
        Quantity("slope", "1"),
        Quantity("leading", "1"),
        Quantity("own_share", "1"),
        Quantity("own_lead", "steps"),
        Quantity("step_time", "s"),
        Quantity("mounting", "rad"),
    )
    gates = (
        Applies(Level("window", "steps", "window"), FRONTAL),
        Applies(Level("density", "1", "density"), FRONTAL),
        Applies(Level("order", "steps", "order"), FRONTAL),
        Applies(Level("share", "1", "share"), LATERAL),
        Applies(Level("lobe", "1", "lobe"), LATERAL),
        Applies(Level("slope", "1", "slope"), LATERAL),
        Duplicate(),
        Applies(Level("leading", "1", "leading"), LATERAL),
    )

    def __init__(self, parameters: StepTypeParameters) -> None:
        self.parameters = parameters
        self.axis = WalkingAxis(parameters.forward != "walk")
        self._follower: Follower | None = None
        self._decided: list[StepEvent] = []  # those whose candidates were yielded last

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin; what is known of the mounting stays."""
        from .axes import BodyAxes
        from .follower import Follower

        if not BodyAxes.fits(context.stream):
            text = "no types of steps: expected accelerations along x, y and z"
            raise CannotStart(text)
        self._stage = context.stage
        if self._follower is None:
            self._follower = Follower(self)
        return TYPES

    def process(self, item: SignalBlock | StepEvent) -> Iterator[Candidates]:
        """Take signal and steps; yield the candidates of steps whose types are known."""
        assert self._follower is not None  # it was started
        if isinstance(item, SignalBlock):
            self._follower.hear(item)
            yield from self._complete(self._follower)
        else:
            self._follower.step(item)

    def flush(self) -> Iterator[Candidates]:
        """Yield those of the steps that waited for others; forget signal and steps."""
        if self._follower is not None:
            yield from self._complete(self._follower, final=True)
            self._follower.end()

    def decided(self, block: CandidateBlock) -> Iterator[StepEvent]:
        """Yield the steps just decided again, with the first type that was accepted of each."""
        last = -1
        for row in np.flatnonzero(block.accepted).tolist():
            index = row // len(TYPES)
            if index > last:
                kind = TYPES[int(block.channel[row])]
                yield self._typed(self._decided[index], kind, float(block.value[row, 0]))
            last = index

    def _complete(self, follower: Follower, *, final: bool = False) -> Iterator[Candidates]:
        """Yield the candidates of the steps around which all is known."""
        told = list(follower.told(final=final))
        self._decided = [step for step, _ in told]
        if told:
            yield Candidates(
                np.repeat([step.time_ns for step in self._decided], len(TYPES)),
                np.tile(np.arange(len(TYPES), dtype=np.int32), len(told)),
                np.array([row for _, rows in told for row in rows], np.float32),
            )

    def _typed(self, step: StepEvent, kind: str, value: float) -> StepEvent:
        """Return a step again, with its type."""
        return replace(step, stage=self._stage, value=value, type=kind)

    def shape(
        self,
        time_ns: int,
        step_s: float,
        times_s: NDArray[np.float64],
        values: NDArray[np.float64],
    ) -> Shape:
        """Measure the next step; steps come in the order of time.

        Parameters
        ----------
        time_ns, step_s
            Its contact [ns] and the step time around it [s].
        times_s, values
            Times about the contact, shape (n,) [s], and accelerations ahead, to the right and up,
            shape (3, n) [m/s2].
        """
        strip = strip_of(times_s, values, step_s)
        swing = step_swing(strip, PHASE)
        if swing is not None:
            self.axis.add(swing)
        strip = self.axis.turned(strip)
        angle = self.axis.angle_rad
        return Shape(time_ns, step_s, frontal(strip, swing), lateral(strip), angle)

    def rows(
        self, before: Sequence[Shape], step: Shape, after: Sequence[Shape]
    ) -> list[tuple[float, ...]]:
        """Return the columns of a step's four candidates, among those before and after it."""
        earlier, later = linked(step, before[:-3:-1]), linked(step, after[:2])
        lead = corrected_lead(
            [x.frontal for x in earlier], step.frontal, [x.frontal for x in later]
        )
        near = [step.frontal, *(x.frontal for x in (*earlier[:1], *later[:1]))]
        share = common_share([x.lateral for x in earlier], step.lateral, [x.lateral for x in later])
        window, density = max(x.window for x in near), max(x.density for x in near)
        lobe, inside = step.lateral.lobe, step.lateral.inside
        own = (step.lateral.share, step.frontal.lead, step.step_s, step.mounting_rad)
        found: list[tuple[float, ...]] = []
        for sign, place in ((1, 0), (-1, 1), (-1, 2), (1, 3)):
            order, slope = _signed(lead, sign), _signed(step.lateral.slopes, sign)
            evidence = order if place in FRONTAL else slope
            patterns = (share, window, density, order, lobe, slope, inside)
            found.append((evidence, *patterns, *own))
        return found


def _signed(value: float, sign: int) -> float:
    """Return a value for one of two opposite types; 0 is for the first alone."""
    return value if sign > 0 else -value if value else -1e-6
