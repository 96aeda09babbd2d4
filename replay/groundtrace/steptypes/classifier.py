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

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from groundtrace_codecs.events import Quantity

from ..gates import Candidates, Level
from ..parameters import gate, measured

# read at run time, where the parameters are described
from .axes import Axis  # noqa: TC001
from .chains import PHASE, Frontal, Lateral, frontal, lateral, strip_of
from .heading_axis import HeadingAxis, step_swing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..detector import Emits
    from ..gates import Carry

TYPES = ("forward", "backward", "left", "right")
FRONTAL, LATERAL = frozenset({0, 1}), frozenset({2, 3})
#: Steps further apart than this many step times are of two walks.
LINKED = 1.8
#: Slopes confirm an order where they differ by at least this logarithm; not that of a maximum
#: about half a step away, which may be a neighbour's [steps].
_CONFIRMS, _FAR = 0.3, 0.4


@dataclass(frozen=True, slots=True)
class StepTypeParameters:
    """Parameters of :class:`StepTypes`."""

    forward: Annotated[
        Axis, measured("", "Axis of the sensor that looks ahead, within 35 degrees or so.")
    ] = "x"
    gravity_s: Annotated[float, measured("s", "Time constant of gravity.", gt=0)] = 2.0
    cutoff_hz: Annotated[float, measured("Hz", "Corner of the low-pass.", gt=0)] = 4.0
    late_s: Annotated[
        float, measured("s", "Longest time by which steps are announced late.", ge=2)
    ] = 12.0
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


class Shape(NamedTuple):
    """What one step looks like by itself.

    Attributes
    ----------
    time_ns
        Contact [ns].
    step_s
        Step time around it [s].
    frontal, lateral
        Its patterns.
    mounting_rad
        How far the sensor is turned, as known then [rad].
    """

    time_ns: int
    step_s: float
    frontal: Frontal
    lateral: Lateral
    mounting_rad: float


@dataclass(frozen=True, slots=True)
class Applies:
    """A level that only some types must reach; the others pass whatever it is."""

    level: Level
    types: frozenset[int]

    @property
    def name(self) -> str:
        """Name of the level."""
        return self.level.name

    @property
    def unit(self) -> str:
        """Unit of the level."""
        return self.level.unit

    @property
    def parameter(self) -> str:
        """Parameter of the level."""
        return self.level.parameter

    @property
    def at_least(self) -> bool:
        """Whether the level must be reached, or not exceeded."""
        return self.level.at_least

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: Carry,
    ) -> NDArray[np.float64]:
        """Return the measured column; infinitely good where the level does not apply."""
        seen = self.level.values(candidates, columns, alive, threshold, carry)
        applies = np.isin(candidates.channel, list(self.types))
        return np.where(applies, seen, np.inf if self.at_least else -np.inf)


@dataclass(frozen=True, slots=True)
class Duplicate:
    """Where a step has a pattern in both chains, the lateral one is its own."""

    parameter: str = "share"
    name: str = "duplicate"
    unit: str = "1"
    at_least: bool = False

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: Carry,  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Return the lateral share of frontal candidates whose step passed the lateral tests."""
        share = candidates.value[:, [c.name for c in columns].index("share")]
        aside = np.isin(candidates.channel, list(LATERAL))
        twice = np.isin(candidates.time_ns, candidates.time_ns[aside & alive])
        # just the threshold would pass
        return np.where(twice & ~aside, np.nextafter(share, np.float32(np.inf)), -np.inf)


class StepTypes:
    """A step is forward, backward, to the left or to the right by the order of its movements."""

    Parameters = StepTypeParameters
    emits: Emits = "step"
    channels = TYPES
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
        self.axis = HeadingAxis()

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

    def candidates(
        self, before: Sequence[Shape], step: Shape, after: Sequence[Shape]
    ) -> Candidates:
        """Return the four candidates of a step among those before and after it, by time."""
        own_share = step.lateral.share
        earlier, later = linked(step, before[:-3:-1]), linked(step, after[:2])
        order = corrected_lead(
            [x.frontal for x in earlier], step.frontal, [x.frontal for x in later]
        )
        near = [step, *earlier[:1], *later[:1]]
        # of two, neither is the odd one out
        share = float(np.median([x.lateral.share for x in near])) if len(near) == 3 else own_share
        common = {
            "share": share,
            "window": max(x.frontal.window for x in near),
            "density": max(x.frontal.density for x in near),
            "lobe": step.lateral.lobe,
            "leading": step.lateral.inside,
            "own_share": own_share,
            "own_lead": step.frontal.lead,
            "step_time": step.step_s,
            "mounting": step.mounting_rad,
        }
        slope = step.lateral.slopes
        rows = []
        for sign, place in ((1, 0), (-1, 1), (-1, 2), (1, 3)):
            signed = {"order": _signed(order, sign), "slope": _signed(slope, sign)}
            evidence = signed["order" if place in FRONTAL else "slope"]
            row = {**common, **signed, "evidence": evidence}
            rows.append([row[c.name] for c in self.columns])
        times = np.full(4, step.time_ns, np.int64)
        return Candidates(times, np.arange(4, dtype=np.int32), np.array(rows, np.float32))


def linked(step: Shape, others: Sequence[Shape]) -> list[Shape]:
    """Return those of the next steps that belong to the same walk as ``step``."""
    found: list[Shape] = []
    last = step
    for other in others:
        apart_s = abs(other.time_ns - last.time_ns) / 1e9
        if apart_s > LINKED * min(last.step_s, other.step_s):
            break
        found.append(other)
        last = other
    return found


def corrected_lead(before: Sequence[Frontal], own: Frontal, after: Sequence[Frontal]) -> float:
    """Return by how much a step's frontal maximum leads, put right by its neighbours [steps].

    Parameters
    ----------
    before, after
        The nearest first, up to two.
    own
        The step's own pattern.
    """
    against = [pair for pair in (before, after) if _agree_against(pair, own.lead)]
    confirmed = own.lead * own.slopes > 0 and abs(own.slopes) >= _CONFIRMS
    if not against or (confirmed and abs(own.lead) <= _FAR):
        return own.lead
    return float(np.median([x.lead for pair in against for x in pair]))


def _agree_against(pair: Sequence[Frontal], lead: float) -> bool:
    """Return whether two neighbours agree on an order that is not that of ``lead``."""
    signs = {np.sign(x.lead) for x in pair}
    return len(pair) == 2 and len(signs) == 1 and np.sign(lead) not in signs


def _signed(value: float, sign: int) -> float:
    """Return a value for one of two opposite types; 0 is for the first alone."""
    return value if sign > 0 else -value if value else -1e-6
