"""The loop of gates, compiled: what a candidate is let through by is who came before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Time of what did not happen [ns].
NEVER = np.iinfo(np.int64).min


@compiled
def time_since_passed(
    time_ns: NDArray[np.int64],
    channel: NDArray[np.int32],
    alive: NDArray[np.bool_],
    spacing_s: float,
    before: NDArray[np.int64],
    ns_per_s: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return for every candidate the time since the last of its channel that passed [s], (n,).

    Parameters
    ----------
    time_ns, channel, alive
        Shape (n,): candidates in their order; those not alive never pass.
    spacing_s
        A candidate passes where at least this time is over.
    before
        Shape (2 * k,): k channels of which one passed before, and when the last one did.
    ns_per_s
        Of all these times.

    Returns
    -------
    These times, infinite where there was none before; when the last one of each channel passed now,
    :data:`NEVER` where there is none.
    """
    known = len(before) // 2
    highest = 0
    for own in before[:known]:
        highest = max(highest, own)
    for own in channel:
        highest = max(highest, own)
    last_ns = np.full(highest + 1, NEVER)
    for i in range(known):
        last_ns[before[i]] = before[known + i]
    since_s = np.full(len(time_ns), np.inf)
    for i in range(len(time_ns)):
        own = channel[i]
        if last_ns[own] != NEVER:
            since_s[i] = (time_ns[i] - last_ns[own]) / ns_per_s
        if alive[i] and since_s[i] >= spacing_s:
            last_ns[own] = time_ns[i]
    return since_s, last_ns


@compiled
def judge(
    seen: NDArray[np.float64],
    threshold: float,
    at_least: bool,
    alive: NDArray[np.bool_],
    value: NDArray[np.float32],
    margin: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Write what a gate looked at, and margins; return which candidates passed it and all before.

    Parameters
    ----------
    seen, alive
        Shape (n,): what the gate looks at, and which candidates passed all gates before it.
    threshold, at_least
        Of the gate.
    value, margin
        Shape (n,): where to.
    """
    passed = np.empty(len(seen), np.bool_)
    for i in range(len(seen)):
        distance = seen[i] - threshold if at_least else threshold - seen[i]
        value[i], margin[i] = seen[i], distance
        passed[i] = alive[i] and distance >= 0.0
    return passed
