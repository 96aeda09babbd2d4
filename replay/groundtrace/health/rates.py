"""The declared rate against the recorded times."""

from __future__ import annotations

from typing import TYPE_CHECKING

from groundtrace_codecs.signals import NS_PER_S

from .finding import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.signals import SignalBlock, Stream

#: Clocks of digitisers are within this of each other, cheap ones too [ppm]; more is another rate.
TOLERANCE_PPM = 200.0
#: A rate is told by so long a run, and by times so much further off than they may jitter [s].
LEAST_S, JITTER_S = 5.0, 0.005


class Rate:
    """Compares the times of recorded blocks with the count of their samples.

    Parameters
    ----------
    stream
        Of a constant rate.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._first: SignalBlock | None = None
        self._best: tuple[float, int, int, int] = (0.0, 0, 0, 0)
        self._last, self._last_ns = 0, 0

    def hear(self, block: SignalBlock) -> None:
        """Take a recorded block."""
        first = self._first
        # the count begins again, or the clock does
        if first is None or block.first < self._last or block.start_ns < self._last_ns:
            first = self._first = block
        self._last, self._last_ns = block.first, block.start_ns
        count = block.first - first.first
        if count > self._best[1]:
            taken_ns = block.start_ns - first.start_ns
            self._best = (taken_ns / NS_PER_S, count, first.start_ns, block.start_ns)

    def findings(self) -> Iterator[Finding]:
        """Yield what the times say, where they say another rate."""
        taken_s, count, start_ns, end_ns = self._best
        declared_s = count / self.stream.rate_hz
        off_s = declared_s - taken_s
        if declared_s < LEAST_S or taken_s <= 0 or abs(off_s) <= JITTER_S:
            return
        ppm = 1e6 * off_s / taken_s
        if abs(ppm) <= TOLERANCE_PPM:
            return
        rate = count / taken_s
        yield Finding(
            self.stream.topic,
            "",
            "rate",
            start_ns,
            end_ns,
            1,
            1.0,
            f"the times of the samples say {rate:.6g} Hz, the declared rate is "
            f"{self.stream.rate_hz:g} Hz ({-ppm:+.0f} ppm)",
            "times follow the recorded clock in jumps, bands are off by as much",
            f"declare {rate:.6g} Hz where it was written or imported",
        )
