"""Contiguous runs: what the source makes of recorded blocks, so that stages see uniform signals.

Rules, the same for every stream:

- samples that follow each other continue the run;
- up to ``bridge_s`` of missing samples are filled by straight lines and said to be bridged;
- more than that ends the run: a gap, then a new run;
- samples at or before the last one are duplicates, dropped and counted;
- a recorded time that leaves the sample counter by more than the tolerance is a clock step: the
  run goes on with its times moved, unless the step is longer than ``bridge_s``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

#: Recorded times may jitter by this much without being a clock step [s].
CLOCK_TOLERANCE_S = 0.005


def run_tracker(stream: Stream, bridge_s: float) -> UniformRuns | IrregularRuns:
    """Return what makes runs of a stream's blocks."""
    kind = IrregularRuns if stream.irregular else UniformRuns
    return kind(stream, bridge_s)


@dataclass(slots=True)
class _Counter:
    """Where a uniform run stands: its anchor, the recorded index of its sample 0, the next one."""

    anchor_ns: int
    base: int
    next: int
    last: NDArray[Any]


class UniformRuns:
    """Runs of a stream with a constant rate and counted samples."""

    def __init__(self, stream: Stream, bridge_s: float) -> None:
        self.stream = stream
        self.bridge_ns = round(bridge_s * NS_PER_S)
        self.tolerance_ns = max(1.5 * stream.period_ns, CLOCK_TOLERANCE_S * NS_PER_S)
        self._run: _Counter | None = None

    def add(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Take a recorded block; yield blocks of runs and the gaps between them."""
        run = self._run
        if not len(block):
            return
        if run is not None and self._follows(block, run):
            run.next += len(block)
            run.last = block.samples[-1]
            yield self._of_run(block, run)
            return
        if run is not None and (gap := self._ending(block, run)) is not None:
            yield gap
            run = None
        if run is None:
            run = self._run = _Counter(block.start_ns, block.first, block.first, block.samples[-1])
        if block.first < run.next:
            repeated = min(len(block), run.next - block.first)
            at = block.start_ns
            yield Gap(block.topic, at, at, "duplicate", repeated, bridged=True)
            block = block.slice(repeated, len(block))
            if not len(block):
                return
        yield from self._bridge(block, run)
        yield self._of_run(block, run)
        run.next = block.first + len(block)
        run.last = block.samples[-1]

    def _follows(self, block: SignalBlock, run: _Counter) -> bool:
        """Return whether a block goes on where the run stands, as nearly all do."""
        if block.first != run.next:
            return False
        if run.base == 0 and block.anchor_ns == run.anchor_ns:
            return True
        step_ns = block.start_ns - self._expected_ns(run, block.first)
        return abs(step_ns) <= self.tolerance_ns

    def _of_run(self, block: SignalBlock, run: _Counter) -> SignalBlock:
        if run.base == 0 and block.anchor_ns == run.anchor_ns:
            return block
        return SignalBlock(block.stream, run.anchor_ns, block.first - run.base, block.samples)

    def _expected_ns(self, run: _Counter, index: int) -> int:
        return run.anchor_ns + round((index - run.base) * self.stream.period_ns)

    def _ending(self, block: SignalBlock, run: _Counter) -> Gap | None:
        """Return the gap that ends the run before ``block``, or None where the run goes on."""
        end_ns = self._expected_ns(run, run.next)
        step_ns = block.start_ns - self._expected_ns(run, block.first)
        lost = max(0, block.first - run.next)
        if abs(step_ns) <= self.bridge_ns and lost * self.stream.period_ns <= self.bridge_ns:
            return None
        if block.start_ns < end_ns:
            return Gap(block.topic, block.start_ns, block.start_ns, "clock step", 0)
        lost = lost or round((block.start_ns - end_ns) / self.stream.period_ns)
        return Gap(block.topic, end_ns, block.start_ns, "missing", lost)

    def _bridge(self, block: SignalBlock, run: _Counter) -> Iterator[SignalBlock | Gap]:
        """Fill a short gap by straight lines, follow a small step of the clock."""
        lost = block.first - run.next
        if lost:
            end_ns = self._expected_ns(run, run.next)
            yield Gap(block.topic, end_ns, block.start_ns, "missing", lost, bridged=True)
            weight = np.arange(1, lost + 1)[:, None] / (lost + 1)
            filled = run.last + weight * (block.samples[0] - run.last.astype(np.float64))
            if block.samples.dtype.kind in "iu":
                filled = np.rint(filled)
            samples = filled.astype(block.samples.dtype)
            yield SignalBlock(self.stream, run.anchor_ns, run.next - run.base, samples)
        step_ns = block.start_ns - self._expected_ns(run, block.first)
        if abs(step_ns) > self.tolerance_ns:
            at = block.start_ns
            yield Gap(block.topic, at, at, "clock step", 0, bridged=True)
            run.anchor_ns += step_ns


class IrregularRuns:
    """Runs of a stream whose samples carry their own times: a grid, linearly interpolated."""

    def __init__(self, stream: Stream, bridge_s: float) -> None:
        self.stream = replace(stream, irregular=False)
        self.bridge_ns = max(bridge_s * NS_PER_S, 2.5 * stream.period_ns)
        self._anchor_ns: int | None = None
        self._next = 0
        self._time_ns = 0
        self._value: NDArray[np.float64] = np.empty(0)

    def add(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Take a recorded block; yield blocks of runs and the gaps between them."""
        times = block.sample_times()
        samples = np.asarray(block.samples, np.float64)
        start = 0
        while start < len(times):
            if repeated := self._repeated(times[start:]):
                at = int(times[start])
                yield Gap(block.topic, at, at, "duplicate", repeated, bridged=True)
                start += repeated
                continue
            gap = self._interruption(int(times[start]))
            if gap is not None:
                yield gap
                if not gap.bridged:
                    self._anchor_ns = None
            stop = start + self._following(times[start:])
            yield from self._grid(times[start:stop], samples[start:stop])
            start = stop

    def _repeated(self, times: NDArray[np.int64]) -> int:
        """Return how many of the first times are duplicates: at or a little before the last one."""
        if self._anchor_ns is None:
            return 0
        step = times - self._time_ns
        new = np.flatnonzero((step > 0) | (step < -self.bridge_ns))
        return int(new[0]) if len(new) else len(times)

    def _following(self, times: NDArray[np.int64]) -> int:
        """Return how many of the times follow each other, from the first one on."""
        step = np.diff(times)
        broken = np.flatnonzero((step <= 0) | (step > 1.5 * self.stream.period_ns))
        return int(broken[0]) + 1 if len(broken) else len(times)

    def _interruption(self, time_ns: int) -> Gap | None:
        """Say what lies between the last sample taken and one at ``time_ns``."""
        if self._anchor_ns is None:
            return None
        step = time_ns - self._time_ns
        if step < 0:
            return Gap(self.stream.topic, time_ns, time_ns, "clock step", 0)
        lost = round(step / self.stream.period_ns) - 1
        if lost < 1:
            return None
        bridged = step <= self.bridge_ns
        return Gap(self.stream.topic, self._time_ns, time_ns, "missing", lost, bridged)

    def _grid(
        self, times: NDArray[np.int64], samples: NDArray[np.float64]
    ) -> Iterator[SignalBlock]:
        """Interpolate the grid points up to the last sample."""
        if self._anchor_ns is None:
            self._anchor_ns, self._next = int(times[0]), 0
        else:
            times = np.concatenate([[self._time_ns], times])
            samples = np.concatenate([self._value[None, :], samples])
        self._time_ns, self._value = int(times[-1]), samples[-1]
        knots = self._snapped(times - self._anchor_ns)
        period = self.stream.period_ns
        last = round(knots[-1] / period)
        last -= int(round(last * period) > knots[-1])
        if last < self._next:
            return
        index = np.arange(self._next, last + 1)
        grid = np.rint(index * period)
        values = np.column_stack([np.interp(grid, knots, column) for column in samples.T])
        first, self._next = self._next, last + 1
        yield SignalBlock(self.stream, self._anchor_ns, first, values)

    def _snapped(self, times: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return times since the anchor [ns], those that only rounding keeps off the grid on it."""
        period = self.stream.period_ns
        index = np.rint(times / period)
        near = np.abs(times - index * period) <= np.maximum(1e-6 * period, 1.0)
        return np.where(near, np.rint(index * period), times)
