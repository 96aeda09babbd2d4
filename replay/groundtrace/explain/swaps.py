"""Sensors that stand in each other's place: cables plugged in the wrong order."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .relocate import Arrivals
from .sensors import Judge, found_faults

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .sensors import Fault

    Array = NDArray[np.float64]

#: Two sensors are swapped where each seems to stand within this part of their distance of where
#: the other is said to stand.
NEAR_PART = 0.25


def swapped(faults: Sequence[Fault], positions: Array) -> tuple[tuple[int, int], ...]:
    """Return pairs of displaced sensors that stand in each other's place, by their rows.

    Parameters
    ----------
    faults
        Of the sensors that were found wrong.
    positions
        Shape (n, 2): where the geometry has them [m].
    """
    moved = {fault.channel: fault.place for fault in faults if fault.cause == "position"}
    pairs = []
    for one in moved:
        for other in moved:
            apart = float(np.hypot(*(positions[one] - positions[other])))
            off = max(
                float(np.hypot(*(moved[one] - positions[other]))),
                float(np.hypot(*(moved[other] - positions[one]))),
            )
            if one < other and off <= NEAR_PART * apart:
                pairs.append((one, other))
    return tuple(pairs)


def swap_notes(
    names: Sequence[str], positions: Array, times_s: Array, sources: Array
) -> tuple[str, ...]:
    """Say which sensors seem to be swapped, one line a pair.

    Parameters
    ----------
    names
        Of the n channels.
    positions
        Shape (n, 2): of the sensors [m].
    times_s
        Shape (m, n): arrivals by clocks set right [s]; NaN where there is none.
    sources
        Shape (m, 2): places of the impacts [m].
    """
    arrivals = Arrivals(np.zeros(len(times_s), np.int64), times_s)
    faults = found_faults(Judge(sources, None), arrivals, arrivals, positions, correlated=False)
    return tuple(
        f"sensors: {names[one]} and {names[other]} seem to be swapped: each fits the arrivals of "
        f"the other; exchange their places in the geometry, or their cables"
        for one, other in swapped(faults, positions)
    )
