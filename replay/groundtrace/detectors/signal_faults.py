"""Faults of a channel, summed up by windows: rails, wrong rates, samples that are not finite."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream


@dataclass(frozen=True, slots=True)
class Finding:
    """One kind of fault of one channel.

    Attributes
    ----------
    topic, channel
        Where; the channel is empty where the whole stream is meant, and a quantity where its three
        axes are.
    kind
        ``not finite``, ``late``, ``constant``, ``clipped``, ``dropouts``, ``spikes``, ``offset``,
        ``hum``, ``rate``, ``axes``, ``unit`` or ``zero``.
    start_ns, end_ns
        Half-open span from the first to the last time it is so [ns].
    events
        How many times.
    share
        Part of the samples that are concerned, 0 to 1; for hum the part of the quiet power.
    what, effect, remedy
        The same for people: what was found, what it does to results, and what to do.
    """

    topic: str
    channel: str
    kind: str
    start_ns: int
    end_ns: int
    events: int
    share: float
    what: str
    effect: str
    remedy: str


class FaultDetector(Protocol):
    """Looks for one kind of fault in all channels of a stream."""

    def update(self, window: Window) -> None:
        """Take the next window of the run."""

    def gap(self) -> None:
        """End the run: what comes next does not follow."""

    def findings(self) -> Iterator[Finding]:
        """Yield what was found; after the last :meth:`gap`."""


@dataclass(slots=True)
class FaultSpans:
    """Spans of one fault of one channel, summed up.

    Attributes
    ----------
    events, samples
        How many spans, of how many samples together.
    start_ns, end_ns
        Half-open span from the beginning of the first to the end of the last [ns].
    """

    events: int = 0
    samples: int = 0
    start_ns: int = 0
    end_ns: int = 0

    def add(self, start_ns: int, end_ns: int, samples: int) -> None:
        """Add a span."""
        if not self.events:
            self.start_ns = start_ns
        self.events += 1
        self.samples += samples
        self.end_ns = max(end_ns, self.end_ns)


def percent(share: float) -> str:
    """Return a part as a percentage for people."""
    return f"{100 * share:.2g} %" if share >= 1e-4 else "under 0.01 %"


def times(count: int) -> str:
    """Return ``once`` or how many times."""
    return "once" if count == 1 else f"{count} times"


#: Samples of context on both sides of a window. Chosen by judgement: more than the 8 samples of
#: context that is looked at beside a run or a spike.
MARGIN = 16
#: A window is so long, whatever the blocks: the mean of so many samples is not moved by one. Chosen
#: by judgement.
LENGTH_S, LEAST_SAMPLES = 2.0, 512


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A stretch of a run.

    Attributes
    ----------
    values
        Shape (n_channels, left + n + right), as stored, as floats that hold every stored value;
        NaN where a sample is not finite.
    left, right
        Samples of context before and after; fewer than the margin at the ends of a run.
    first
        Index in the run of the first sample after the context.
    start_ns
        Its time [ns].
    period_ns
        Time between two samples [ns].
    """

    values: NDArray[np.floating]
    left: int
    right: int
    first: int
    start_ns: int
    period_ns: float

    def __len__(self) -> int:
        return int(self.values.shape[1]) - self.left - self.right

    @property
    def core(self) -> NDArray[np.floating]:
        """The values without context, shape (n_channels, n)."""
        return self.values[:, self.left : self.left + len(self)]

    def time_ns(self, index: float) -> int:
        """Return the time of sample ``index`` of the core [ns]."""
        return self.start_ns + round(index * self.period_ns)


class Windows:
    """Makes windows of the blocks of one run after the other."""

    def __init__(self, rate_hz: float) -> None:
        self._length = max(LEAST_SAMPLES, round(LENGTH_S * rate_hz))
        self.reset()

    def reset(self) -> None:
        """Begin a new run."""
        self._context: NDArray[np.floating] | None = None
        self._waiting: list[NDArray[np.floating]] = []
        self._count = 0
        self._first = 0

    def add(self, block: SignalBlock) -> Iterator[Window]:
        """Take a block; yield the windows that it completes."""
        self._waiting.append(_floats(block))
        self._count += len(block)
        self._end_ns = block.end_ns
        self._period_ns = block.stream.period_ns
        while self._count >= self._length + MARGIN:
            yield self._window(self._count - self._length)

    def flush(self) -> Iterator[Window]:
        """Yield what is left and begin a new run."""
        if self._count:
            yield self._window(0)
        self.reset()

    def _window(self, rest: int) -> Window:
        """Return all that waits but its last ``rest`` samples, with context."""
        parts = self._waiting if self._context is None else [self._context, *self._waiting]
        values = np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]
        left = 0 if self._context is None else self._context.shape[1]
        size, right = self._count - rest, min(rest, MARGIN)
        start_ns = self._end_ns - round(self._count * self._period_ns)
        shown = values[:, : left + size + right]
        window = Window(shown, left, right, self._first, start_ns, self._period_ns)
        self._context = values[:, max(0, left + size - MARGIN) : left + size]
        self._waiting, self._count = [values[:, left + size :]], rest
        self._first += size
        return window


class FaultDetectors:
    """Detectors of several kinds of faults, which take a stream window by window.

    Parameters
    ----------
    stream
        The stream.
    detectors
        Which ones; of a channel that several call clipped, the first is believed.
    """

    def __init__(self, stream: Stream, *detectors: FaultDetector) -> None:
        self._windows = Windows(stream.rate_hz)
        self._detectors = detectors

    def update(self, block: SignalBlock) -> None:
        """Take the next block of the run."""
        self._update(self._windows.add(block))

    def gap(self) -> None:
        """End the run."""
        self._update(self._windows.flush())
        for detector in self._detectors:
            detector.gap()

    def findings(self) -> Iterator[Finding]:
        """Yield what was found; after the last :meth:`gap`."""
        clipped = set()
        for detector in self._detectors:
            for finding in detector.findings():
                if finding.kind != "clipped" or finding.channel not in clipped:
                    yield finding
                clipped |= {finding.channel} if finding.kind == "clipped" else set()

    def _update(self, windows: Iterable[Window]) -> None:
        for window in windows:
            for detector in self._detectors:
                detector.update(window)


def _floats(block: SignalBlock) -> NDArray[np.floating]:
    """Return samples channel by channel in a type that holds each of them exactly."""
    kind = block.samples.dtype
    small = (kind.kind in "iu" and kind.itemsize <= 2) or (kind.kind == "f" and kind.itemsize <= 4)
    values: NDArray[np.floating] = np.array(
        block.samples.T, np.float32 if small else np.float64, order="C"
    )
    if kind.kind == "f" and not np.isfinite(values).all():
        values[~np.isfinite(values)] = np.nan
    return values


#: Flat tops so near to each other are of the same rail, as a part of the channel's range. Chosen by
#: judgement: a rail is one value but for noise (docs/faults.md).
SAME = 0.002
#: So many flat tops, or one of so many samples, are no chance. Chosen by judgement: a smooth signal
#: has one flat top of three samples now and then.
TOPS, LONG_TOP = 2, 5
#: A channel of fewer steps of its digitiser from end to end rests at its extremes by nature. Chosen
#: by judgement: a sinusoid of 32 steps is within half a step of its maximum for 8 % of its period.
LEAST_STEPS = 32
#: A signal that goes beyond in more than this part of its flat tops is not held back there. Chosen
#: by judgement: spikes and rounding go beyond a rail, a signal does not.
BEYOND = 0.1


@dataclass(slots=True)
class _Rail:
    """One side; ``level`` counts upwards on both. ``beyond`` counts windows that go beyond it."""

    level: float = float("-inf")
    extreme: float = float("-inf")
    beyond: int = 0
    tops: FaultSpans = field(default_factory=FaultSpans)
    longest: int = 0

    def reach(self, value: float, near: float) -> None:
        self.extreme = max(self.extreme, value)
        self.beyond += int(value > self.level + near)

    def takes(self, value: float, near: float) -> bool:
        return value >= self.extreme - near or abs(value - self.level) <= near

    def add(self, value: float, near: float, span_ns: tuple[int, int], samples: int) -> None:
        if value > self.level + near:
            self.level, self.beyond, self.longest, self.tops = value, 0, 0, FaultSpans()
        self.tops.add(*span_ns, samples)
        self.longest = max(self.longest, samples)

    @property
    def real(self) -> bool:
        enough = self.tops.events >= TOPS or self.longest >= LONG_TOP
        return enough and self.beyond <= BEYOND * self.tops.events


@dataclass(slots=True)
class Rails:
    """Both sides of a channel."""

    _high: _Rail = field(default_factory=_Rail)
    _low: _Rail = field(default_factory=_Rail)

    def reach(self, highest: float, lowest: float) -> None:
        """Say how far the signal of a window goes."""
        self._high.extreme = max(self._high.extreme, highest)
        self._low.extreme = max(self._low.extreme, -lowest)
        near = SAME * self.span
        self._high.reach(highest, near)
        self._low.reach(-lowest, near)

    @property
    def span(self) -> float:
        """How far it is from the lowest to the highest sample."""
        return self._high.extreme + self._low.extreme

    def near(self, values: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which values lie at an extreme, or at a level that may be a rail."""
        near, low, high = SAME * self.span, self._low, self._high
        out: NDArray[np.bool_] = (values >= high.extreme - near) | (-values >= low.extreme - near)
        for level in (high.level, -low.level):
            out |= np.abs(values - level) <= near
        return out

    def take(self, value: float, span_ns: tuple[int, int], samples: int, step: float) -> bool:
        """Take a flat stretch with corners; return whether it is one at an extreme."""
        near = SAME * self.span
        if self.span < LEAST_STEPS * step:
            return False
        for rail, sign in ((self._high, 1), (self._low, -1)):
            if rail.takes(sign * value, near):
                rail.add(sign * value, near, span_ns, samples)
                return True
        return False

    def clipped_sides(self) -> Iterator[tuple[float, FaultSpans]]:
        """Yield the level and the flat tops of each side that is clipped."""
        for rail, sign in ((self._high, 1), (self._low, -1)):
            if rail.real:
                yield sign * rail.level, rail.tops


#: Clocks of digitisers are within this of each other, cheap ones too [ppm]; more is another rate.
#: Chosen by judgement: crystals are sold with up to 100 ppm.
TOLERANCE_PPM = 200.0
#: A rate is told by so long a run, and by times so much further off than they may jitter [s].
#: Chosen by judgement: blocks are stamped by an operating system, as unevenly as that.
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

    def update(self, block: SignalBlock) -> None:
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


class NonFinite:
    """Counts samples that are not finite, in every channel of a stream."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._spans = [FaultSpans() for _ in stream.channels]
        self._open = np.zeros(len(stream.channels), np.bool_)
        self._sample_count = 0

    def update(self, window: Window) -> None:
        """Take the next window."""
        self._sample_count += len(window)
        bad = np.isnan(window.core)
        for c in np.flatnonzero(bad.any(axis=1) | self._open):
            edges = np.flatnonzero(np.diff(bad[c], prepend=False, append=False))
            for first, end in edges.reshape(-1, 2).tolist():
                goes_on = first == 0 and self._open[c]
                span = window.time_ns(first), window.time_ns(end)
                self._spans[c].add(*span, end - first)
                self._spans[c].events -= int(goes_on)
        self._open = bad[:, -1].copy()

    def gap(self) -> None:
        """Forget that a span was open."""
        self._open[:] = False

    def findings(self) -> Iterator[Finding]:
        """Yield one finding for each channel that has such samples."""
        for channel, spans in zip(self.stream.channels, self._spans, strict=True):
            if not spans.events:
                continue
            share = spans.samples / self._sample_count
            yield Finding(
                self.stream.topic,
                channel.name,
                "not finite",
                spans.start_ns,
                spans.end_ns,
                spans.events,
                share,
                f"NaN or infinite {times(spans.events)}, {spans.samples} samples "
                f"({percent(share)})",
                "the last finite value is held there, no onset is seen",
                "look for overflows in what wrote the file",
            )
