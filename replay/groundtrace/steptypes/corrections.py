"""Late corrections: what the steps before and after one say of it.

Source: EPFL, last part of the section on the recognition of steps. A step that is ordered otherwise
than both steps before it or both after it is looked at again: its slopes are asked, and where they
do not confirm it, it is ordered as the others. The document corrects the frontal chain alone; that
one step among others of its walk does not go aside by itself is ours.
"""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .chains import Frontal, Lateral

#: Steps further apart than this many step times are of two walks.
LINKED = 1.8
#: Slopes confirm an order where they differ by at least this logarithm; not that of a maximum
#: about half a step away, which may be a neighbour's [steps].
_CONFIRMS, _FAR = 0.3, 0.4


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


def linked(step: Shape, others: Sequence[Shape]) -> list[Shape]:
    """Return those of the next steps that belong to the same walk as ``step``."""
    found: list[Shape] = []
    last = step
    for other in others:
        apart_s = abs(other.time_ns - last.time_ns) / NS_PER_S
        if apart_s > LINKED * min(last.step_s, other.step_s):
            break
        found.append(other)
        last = other
    return found


def common_share(before: Sequence[Lateral], own: Lateral, after: Sequence[Lateral]) -> float:
    """Return the median lateral share of three neighbouring steps, the own one in the middle.

    At the ends of a walk it is the first or last of them; with fewer than three steps the share
    is its own.

    Parameters
    ----------
    before, after
        The nearest first, up to two.
    own
        The step's own pattern.
    """
    three = [*before[:1], own, *after[:1]]
    if len(three) < 3:
        three = [own, *(before or after)]
    return median(x.share for x in three) if len(three) == 3 else own.share


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
    return median(x.lead for pair in against for x in pair)


def _agree_against(pair: Sequence[Frontal], lead: float) -> bool:
    """Return whether two neighbours agree on an order that is not that of ``lead``."""
    signs = {_sign(x.lead) for x in pair}
    return len(pair) == 2 and len(signs) == 1 and _sign(lead) not in signs


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)
