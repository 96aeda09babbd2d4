"""The loop of gates, compiled: what a candidate is let through by is who came before it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from .compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray


@compiled
def time_since_passed(
    time_ns: NDArray[np.int64],
    channel: NDArray[np.int32],
    alive: NDArray[np.bool_],
    spacing_s: float,
    last_ns: NDArray[np.int64],
    known: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return for every candidate the time since the last of its channel that passed [s], (n,).

    Parameters
    ----------
    time_ns, channel, alive
        Shape (n,): candidates in their order; those not alive never pass.
    spacing_s
        A candidate passes where at least this time is over.
    last_ns, known
        Shape (n_channels,): when the last one passed, and whether there was one; brought up to
        date. Without one the time is infinite.
    """
    since_s = np.full(len(time_ns), np.inf)
    for i in range(len(time_ns)):
        own = channel[i]
        if known[own]:
            since_s[i] = (time_ns[i] - last_ns[own]) / NS_PER_S
        if alive[i] and since_s[i] >= spacing_s:
            last_ns[own] = time_ns[i]
            known[own] = True
    return since_s
