"""The replay clock: turns recorded time into waiting time. It returns the wait, it never sleeps."""

from __future__ import annotations

import math

from groundtrace_codecs.signals import NS_PER_S


class Clock:
    """Paces a replay.

    Parameters
    ----------
    rate
        Recorded seconds per wall second; 0 means as fast as possible.

    Notes
    -----
    All wall times are given by the caller [s, any monotonic clock], so a test needs no waiting.
    """

    def __init__(self, rate: float = 0.0) -> None:
        if not (math.isfinite(rate) and rate >= 0):
            raise ValueError(f"rate: expected a number >= 0, found {rate}")
        self.rate = rate
        self._origin: tuple[int, float] | None = None

    def wait_s(self, time_ns: int, now_s: float) -> float:
        """Return how long to wait [s] before ``time_ns`` is due.

        The first call sets the origin: that recorded time is due now.
        """
        if self.rate == 0:
            return 0.0
        if self._origin is None:
            self._origin = (time_ns, now_s)
        origin_ns, origin_s = self._origin
        due_s = origin_s + (time_ns - origin_ns) / NS_PER_S / self.rate
        return max(0.0, due_s - now_s)
