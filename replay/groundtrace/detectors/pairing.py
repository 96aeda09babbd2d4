"""Pairing: a pair of peak and valley may not begin before the last one has ended."""

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
class Pairing:
    """A minimum time from the end of the last pair that passed this gate, per channel.

    Two peaks that fall into one valley thus make one step. ``length`` is the column that holds how
    long a pair lasts [s].
    """

    length: str = "fall"
    parameter: str = "pause_s"
    name: str = "pairing"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: Carry,
    ) -> NDArray[np.float64]:
        """Return the time since the last pair ended [s]; inf where there was none."""
        column = [c.name for c in columns].index(self.length)
        lengths = candidates.value[:, column].astype(np.float64)
        ends = candidates.time_ns + np.rint(np.nan_to_num(lengths) * NS_PER_S).astype(np.int64)
        last = carry.last_ns.setdefault(self.name, {})
        out = np.full(len(candidates), np.inf)
        rows = zip(
            candidates.channel.tolist(),
            candidates.time_ns.tolist(),
            ends.tolist(),
            alive.tolist(),
            strict=True,
        )
        for row, (channel, begin, end, before) in enumerate(rows):
            since = (begin - last[channel]) / NS_PER_S if channel in last else np.inf
            out[row] = since
            if before and since >= threshold:
                last[channel] = end
        return out
