"""A gate on how long candidates have been passing: what lasts is no impact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity

    from ..gates import Candidates, Carry


@dataclass(frozen=True, slots=True)
class Lasting:
    """A minimum time for which candidates of a channel have passed all gates before this one.

    Parameters
    ----------
    bridge_s
        A run goes on over candidates that fail while two that pass are no further apart [s].
    """

    parameter: str = "lasting_s"
    bridge_s: float = 1.0
    name: str = "lasting"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],  # noqa: ARG002
        alive: NDArray[np.bool_],
        threshold: float,  # noqa: ARG002
        carry: Carry,
    ) -> NDArray[np.float64]:
        """Return the time since the run began [s]; 0 for candidates that failed before."""
        first = carry.last_ns.setdefault(f"{self.name} since", {})
        last = carry.last_ns.setdefault(self.name, {})
        out = np.zeros(len(candidates))
        for channel in set(candidates.channel.tolist()):
            rows = np.flatnonzero(alive & (candidates.channel == channel))
            if not len(rows):
                continue
            times = candidates.time_ns[rows]
            known = channel in last
            before = np.concatenate([[last[channel] if known else times[0]], times[:-1]])
            late = times - before
            begins = (late > self.bridge_s * NS_PER_S) | (late < 0)
            begins[0] |= not known
            starts = np.where(begins, times, 0)
            group = np.maximum.accumulate(np.where(begins, np.arange(len(rows)), -1))
            began = np.where(group >= 0, starts[group], first.get(channel, times[0]))
            out[rows] = (times - began) / NS_PER_S
            first[channel], last[channel] = int(began[-1]), int(times[-1])
        return out
