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
    loop
        Half-open span of recorded time [ns] to repeat, or None.

    Notes
    -----
    All wall times are given by the caller [s, any monotonic clock], so a test needs no waiting.
    """

    def __init__(self, rate: float = 0.0, loop: tuple[int, int] | None = None) -> None:
        self.rate = _checked(rate)
        self.loop = loop
        self._origin: tuple[int, float] | None = None
        self._paused_at: float | None = None
        self._steps = 0

    @property
    def paused(self) -> bool:
        """Whether recorded time stands still."""
        return self._paused_at is not None

    def wait_s(self, time_ns: int, now_s: float) -> float:
        """Return how long to wait [s] before ``time_ns`` is due; inf while paused.

        The first call sets the origin: that recorded time is due now.
        """
        if self._paused_at is not None:
            if self._steps == 0:
                return math.inf
            self._steps -= 1
            self._origin = (time_ns, self._paused_at)
            return 0.0
        if self.rate == 0:
            return 0.0
        if self._origin is None:
            self._origin = (time_ns, now_s)
        origin_ns, origin_s = self._origin
        due_s = origin_s + (time_ns - origin_ns) / NS_PER_S / self.rate
        return max(0.0, due_s - now_s)

    def pause(self, now_s: float) -> None:
        """Stop recorded time."""
        if self._paused_at is None:
            self._paused_at = now_s

    def resume(self, now_s: float) -> None:
        """Go on from where the clock was paused."""
        if self._paused_at is not None and self._origin is not None:
            origin_ns, origin_s = self._origin
            self._origin = (origin_ns, origin_s + now_s - self._paused_at)
        self._paused_at = None
        self._steps = 0

    def step(self) -> None:
        """Let exactly one item pass while paused; nothing while running."""
        if self._paused_at is not None:
            self._steps += 1

    def set_rate(self, rate: float, time_ns: int, now_s: float) -> None:
        """Change the rate at recorded time ``time_ns``, without a jump."""
        self.rate = _checked(rate)
        self.seek(time_ns, now_s)

    def seek(self, time_ns: int, now_s: float) -> None:
        """Make ``time_ns`` due now, or at once when a paused clock resumes."""
        # resume() adds the whole pause, so that what happens in it counts from its beginning
        self._origin = (time_ns, now_s if self._paused_at is None else self._paused_at)

    def next_start_ns(self, time_ns: int) -> int | None:
        """Return where to go on once ``time_ns`` is reached: the loop's start, or None."""
        if self.loop is not None and time_ns >= self.loop[1]:
            return self.loop[0]
        return None


def _checked(rate: float) -> float:
    if not (math.isfinite(rate) and rate >= 0):
        raise ValueError(f"rate: expected a number >= 0, found {rate}")
    return rate
