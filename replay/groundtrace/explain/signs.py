"""Signs: which orders of arrival contradict where somebody was."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..localizers.regions import pairs

if TYPE_CHECKING:
    from .reference import Reference
    from .relocate import Relocator

#: So many contradictory signs are named, those with the largest differences.
NAMED = 3


def contradictions(relocator: Relocator, row: int, reference: Reference) -> list[str]:
    """Name the pairs of sensors of which the farther one heard a step first, in a phrase.

    Parameters
    ----------
    relocator
        The sensors and their arrivals.
    row
        The step.
    reference
        Where somebody was; where that is unknown nothing is said.
    """
    times, place = relocator.arrivals.times_s[row], reference.xy[row]
    first, second = pairs(len(times))
    apart = np.hypot(*(relocator.positions - place).T)
    late = times[first] - times[second]
    wrong = np.flatnonzero(late * (apart[first] - apart[second]) < 0)
    if not len(wrong):
        return []
    count, names = int(np.isfinite(late).sum()), relocator.names
    largest = sorted(wrong, key=lambda k: -abs(late[k]))[:NAMED]
    named = ", ".join(
        f"{names[first[k]]}/{names[second[k]]} by {abs(late[k]) * 1e3:.2f} ms" for k in largest
    )
    return [f"{len(wrong)} of {count} signs contradict the {reference.kind}: {named}"]
