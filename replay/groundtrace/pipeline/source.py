"""The source: typed blocks of every topic in one time order, gaps as events, joined for speed.

Recorded blocks become contiguous runs, so that stages see uniform signals. Rules, the same for
every stream:

- samples that follow each other continue the run;
- up to ``bridge_s`` of missing samples are filled by straight lines and reported as bridged;
- more than that ends the run: a gap, then a new run;
- samples at or before the last one are duplicates, dropped and counted;
- a recorded time that leaves the sample counter by more than the tolerance is a clock step: the run
  goes on with its times moved, unless the step is longer than ``bridge_s``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from groundtrace_codecs.events import Gap
from groundtrace_codecs.recording import BATCH_NS, Recording
from groundtrace_codecs.signals import NS_PER_S, SignalBlock, as_one

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.recording import CountedMessages, LoggedBlock
    from groundtrace_codecs.signals import Stream

#: Samples of the fastest stream that unpaced blocks are joined to: what a block costs, whatever its
#: length, then hardly counts. Chosen by judgement.
BLOCK_SAMPLES = 3000
#: Shortest such block, also where one stream is alone and waits for no other, and longest one [s].
#: Chosen by judgement: what a viewer shows at once, and what memory holds.
BLOCK_S, ALONE_BLOCK_S, LONGEST_BLOCK_S = 0.5, 2.0, 30.0
#: Longest gap that is filled instead of ending the run [s], where no stage says otherwise. Chosen
#: by judgement: a foot that stands is as still as a line, but for longer.
BRIDGE_S = 0.1
#: It is at least this many sampling intervals. Chosen by judgement: one lost sample is no gap.
BRIDGE_PERIODS = 2.5


def block_length_s(streams: Sequence[Stream]) -> float:
    """Return the length to which unpaced blocks of these streams are joined [s]."""
    shortest_s = ALONE_BLOCK_S if len(streams) == 1 else BLOCK_S
    fastest_hz = max((s.rate_hz for s in streams), default=1.0)
    batches = BLOCK_SAMPLES / fastest_hz * NS_PER_S // BATCH_NS
    return min(max(batches * BATCH_NS / NS_PER_S, shortest_s), LONGEST_BLOCK_S)


class Readable(Protocol):
    """What a source needs of a recording."""

    @property
    def streams(self) -> tuple[Stream, ...]:
        """The sampled streams."""

    def blocks(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        joined_ns: int = 0,
    ) -> Iterator[LoggedBlock]:
        """Yield recorded blocks in the order of the file."""


class Source:
    """Iterates over the blocks and gaps of a recording.

    Parameters
    ----------
    recording
        Where the blocks come from.
    topics
        Which streams; None means all.
    start_ns, stop_ns
        Half-open span of sample times [ns]; None means from the beginning, to the end.
    block_s
        Contiguous blocks are joined to about this length [s]; 0 leaves them as recorded, None is
        :func:`block_length_s`.
    bridge_s
        Longest gap that is filled [s].
    in_whole
        Runs, their sample counts and the blocks are those of the whole recording. Where a run
        began is found by the index of the file (:func:`run_before`); where that does not tell it,
        what comes before ``start_ns`` is read, though not given.
    runs
        Where runs stand that were begun before ``start_ns``, by topic, known from elsewhere.

    Notes
    -----
    Blocks come in the order of the recording, (log_time, channel id, sequence, offset); joined,
    all streams' blocks of one window of recorded time come together, in the order of the streams.
    """

    def __init__(
        self,
        recording: Readable,
        *,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        block_s: float | None = None,
        bridge_s: float = BRIDGE_S,
        in_whole: bool = False,
        runs: Mapping[str, RunBefore] | None = None,
    ) -> None:
        self.recording = recording
        self.topics = topics
        self.start_ns = start_ns
        self.stop_ns = stop_ns
        length_s = block_length_s(self.streams) if block_s is None else block_s
        self.block_ns = round(length_s * NS_PER_S)
        self.bridge_s = bridge_s
        self._in_whole = in_whole
        self._runs = runs
        self._trackers: Trackers = {}

    @property
    def streams(self) -> tuple[Stream, ...]:
        """The streams as they come: uniform."""
        chosen = self.recording.streams
        if self.topics is not None:
            chosen = tuple(s for s in chosen if s.topic in self.topics)
        return tuple(replace(s, irregular=False) for s in chosen)

    def __iter__(self) -> Iterator[SignalBlock | Gap]:
        """Yield blocks and gaps."""
        for _, items in self.windows():
            yield from items

    def windows(self) -> Iterator[tuple[int, Iterable[SignalBlock | Gap]]]:
        """Yield the number of each window of log time, and what it has; see :attr:`width_ns`.

        A window is given before a sample of a later one is looked at.
        """
        self._trackers = {}
        waiting: dict[str, list[SignalBlock | Gap]] = {}
        window = 0
        read_ns = self._begin()
        wanted = (self.topics, read_ns, self.stop_ns, self.block_ns)
        for log_ns, block in self.recording.blocks(*wanted):
            block_window = log_ns // self.width_ns
            if block_window > window:
                if waiting:
                    yield window, self._drain(waiting)
                window = block_window
            for item in map(self._begun, self._followed(block)):
                if item is None:
                    continue
                if self.block_ns == 0:
                    yield window, (item,)
                else:
                    waiting.setdefault(item.topic, []).append(item)
        if waiting:
            yield window, self._drain(waiting)

    @property
    def width_ns(self) -> int:
        """Length of a window of log time; they are counted from 1970 on [ns]."""
        return self.block_ns or BATCH_NS

    @property
    def states(self) -> dict[str, Any]:
        """Where the runs of all topics stand after the window that was given last, to compare."""
        return {topic: tracker.state for topic, tracker in self._trackers.items()}

    def _begin(self) -> int | None:
        """Return from where on to read, and take runs as begun that were begun before [ns]."""
        start_ns, topics = self.start_ns, [stream.topic for stream in self.streams]
        runs = self._runs
        if runs is None and self._in_whole and start_ns is not None:
            counted = isinstance(self.recording, Recording)
            runs = runs_before(self.recording, topics, start_ns, self.bridge_s) if counted else None
            if runs is None:
                return None
        if runs is None or start_ns is None:
            return start_ns
        for stream in self.recording.streams:
            if stream.topic in runs:
                self._trackers[stream.topic] = tracker = run_tracker(stream, self.bridge_s)
                tracker.resume(runs[stream.topic])
        return min([start_ns, *(run.time_ns for run in runs.values())])

    def _followed(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Yield what a recorded block adds to the run of its stream."""
        if block.topic not in self._trackers:
            self._trackers[block.topic] = run_tracker(block.stream, self.bridge_s)
        yield from self._trackers[block.topic].add(block)

    def _begun(self, item: SignalBlock | Gap) -> SignalBlock | Gap | None:
        """Return what of an item is to be given, by when the source is to begin."""
        start_ns = self.start_ns
        if start_ns is None or not (self._in_whole or self._runs):
            return item
        if isinstance(item, Gap):
            return item if item.end_ns >= start_ns else None
        if item.start_ns >= start_ns:
            return item
        part = item.slice(item.index_of(start_ns), len(item))
        return part if len(part) else None

    def _drain(self, waiting: dict[str, list[SignalBlock | Gap]]) -> list[SignalBlock | Gap]:
        """Take what waits, stream by stream, with what continues each other joined."""
        items: list[SignalBlock | Gap] = []
        for stream in self.recording.streams:
            items += joined(waiting.pop(stream.topic, []))
        return items


def joined(items: list[SignalBlock | Gap]) -> Iterator[SignalBlock | Gap]:
    """Yield the items of one stream with contiguous blocks of one run made into one."""
    together: list[SignalBlock] = []
    for item in items:
        if together and not (isinstance(item, SignalBlock) and item.continues(together[-1])):
            yield as_one(together)
            together = []
        if isinstance(item, Gap):
            yield item
        else:
            together.append(item)
    if together:
        yield as_one(together)


#: Recorded times may jitter by this much without being a clock step [s]. Chosen by judgement: an
#: operating system stamps blocks as unevenly.
CLOCK_TOLERANCE_S = 0.005


def run_tracker(stream: Stream, bridge_s: float) -> UniformRuns | IrregularRuns:
    """Return what makes runs of a stream's blocks."""
    kind = IrregularRuns if stream.irregular else UniformRuns
    return kind(stream, bridge_s)


@dataclass(frozen=True, slots=True)
class RunBefore:
    """A run that goes on in the middle of a recording.

    Attributes
    ----------
    time_ns
        From here on the run goes on [ns]; what is earlier is left out.
    anchor_ns
        Time of its sample 0 [ns].
    base
        The recorded index of that; 0 where samples carry times of their own.
    """

    time_ns: int
    anchor_ns: int
    base: int = 0


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
        self._resumed: RunBefore | None = None

    @property
    def state(self) -> object:
        """Where the run stands, to compare; None before there is one."""
        run = self._run
        return None if run is None else (run.anchor_ns, run.base, run.next, run.last.tobytes())

    @property
    def begin(self) -> tuple[int, int]:
        """Time and recorded index of sample 0 of the run under way [ns]."""
        assert self._run is not None  # a block was taken
        return self._run.anchor_ns, self._run.base

    def resume(self, run: RunBefore) -> None:
        """Go on with a run that was begun before."""
        self._resumed = run

    def add(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Take a recorded block; yield blocks of runs and the gaps between them."""
        if (resumed := self._resumed) is not None:
            block = block.between(resumed.time_ns, None)
            if len(block):
                begin = resumed.anchor_ns, resumed.base
                self._run, self._resumed = _Counter(*begin, block.first, block.samples[0]), None
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
        self.bridge_ns = max(bridge_s * NS_PER_S, BRIDGE_PERIODS * stream.period_ns)
        self._anchor_ns: int | None = None
        self._next = 0
        self._time_ns = 0
        self._value: NDArray[np.float64] = np.empty(0)
        self._resumed: RunBefore | None = None

    @property
    def state(self) -> object:
        """Where the run stands, to compare; None before there is one."""
        if self._anchor_ns is None:
            return None
        return self._anchor_ns, self._next, self._time_ns, self._value.tobytes()

    def resume(self, run: RunBefore) -> None:
        """Go on with a run that was begun before, from the first sample on that is then given."""
        self._resumed = run

    def add(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Take a recorded block; yield blocks of runs and the gaps between them."""
        if (resumed := self._resumed) is not None:
            block = block.between(resumed.time_ns, None)
            if len(block):
                self._resumed, self._anchor_ns = None, resumed.anchor_ns
                self._time_ns = int(block.sample_times()[0])
                self._value = np.asarray(block.samples[0], np.float64)
                self._next = self._last(np.array([self._time_ns])) + 1
                block = block.slice(1, len(block))
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
        last = self._last(times)
        if last < self._next:
            return
        index = np.arange(self._next, last + 1)
        grid = np.rint(index * period)
        values = np.column_stack([np.interp(grid, knots, column) for column in samples.T])
        first, self._next = self._next, last + 1
        yield SignalBlock(self.stream, self._anchor_ns, first, values)

    def _last(self, times: NDArray[np.int64]) -> int:
        """Return the index of the last grid point up to the last of some times."""
        assert self._anchor_ns is not None  # a run is on
        period, knot = self.stream.period_ns, self._snapped(times[-1:] - self._anchor_ns)[-1]
        last = round(float(knot) / period)
        return last - int(round(last * period) > knot)

    def _snapped(self, times: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return times since the anchor [ns], those that only rounding keeps off the grid on it."""
        period = self.stream.period_ns
        index = np.rint(times / period)
        near = np.abs(times - index * period) <= np.maximum(1e-6 * period, 1.0)
        return np.where(near, np.rint(index * period), times)


if TYPE_CHECKING:
    #: What makes runs of each topic's blocks.
    Trackers = dict[str, UniformRuns | IrregularRuns]


#: A run's begin is given up, and all before is read, after so many looks into the recording. Chosen
#: by judgement: a gap among a million chunks is found by 20, and each is a chunk to be fetched.
LOOKS = 64


def runs_before(
    recording: object, topics: Collection[str], start_ns: int, bridge_s: float = BRIDGE_S
) -> dict[str, RunBefore] | None:
    """Return the runs that go on at a time, by the index of the file and a few of its chunks.

    Parameters
    ----------
    recording, topics
        Of which recording, and which of its streams.
    start_ns
        The time [ns]; runs are given from where they are sure to be before it.
    bridge_s
        Longest gap that is filled [s].

    Returns
    -------
    By topic; a stream that begins later has none. None where they are not to be known without
    reading all that is before, or that is nothing, and of what is no file.
    """
    runs: dict[str, RunBefore] = {}
    if not isinstance(recording, Recording):
        return None
    for topic in topics:
        counted = recording.counted(topic)
        if counted is None:
            return None
        if counted.first_ns < start_ns:
            run = run_before(counted, start_ns, bridge_s)
            if run is None:
                return None
            runs[topic] = run
    return runs or None


def run_before(counted: CountedMessages, start_ns: int, bridge_s: float) -> RunBefore | None:
    """Return the run that a stream is in before a time [ns], None where nothing tells it.

    All messages of a run have as many samples: so many messages before a chunk leave a recorded
    index that is known, unless samples are missing. Where they are, the gap is found by halves.
    Samples whose times are not exactly those of the run, as of clocks that drift, tell nothing.
    """
    looked: dict[int, SignalBlock] = {}

    def first_of(chunk_index: int) -> SignalBlock:
        if chunk_index not in looked:
            block = next(counted.blocks(chunk_index), None) if chunk_index >= 0 else None
            if block is None or len(looked) >= LOOKS:
                raise LookupError
            looked[chunk_index] = block
        return looked[chunk_index]

    def lost(chunk_index: int) -> int:
        """Return how many samples are missing before a chunk."""
        return first_of(chunk_index).first - len(first_of(0)) * int(counted.before[chunk_index])

    chunk = counted.chunk_at(start_ns)
    try:
        while first_of(chunk).start_ns >= start_ns:
            chunk -= 1
        begin, wanted = _last_begin(counted, chunk, bridge_s, first_of, lost), first_of(chunk)
    except LookupError:
        return None
    anchor_ns, base = begin
    expected_ns = anchor_ns + round((wanted.first - base) * counted.stream.period_ns)
    return RunBefore(wanted.start_ns, *begin) if wanted.start_ns == expected_ns else None


def _last_begin(
    counted: CountedMessages,
    chunk: int,
    bridge_s: float,
    first_of: Callable[[int], SignalBlock],
    lost: Callable[[int], int],
) -> tuple[int, int]:
    """Return time and recorded index of sample 0 of the run that a chunk's first message is of.

    Raises
    ------
    LookupError
        Where messages have other lengths than the first one, without a gap.
    """
    while lost(chunk) != lost(0):
        low, high, missing = 0, chunk, lost(chunk)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if lost(middle) == missing else (middle, high)
        runs, gaps = UniformRuns(counted.stream, bridge_s), list[Gap]()
        for block in counted.blocks(low):
            gaps += [item for item in runs.add(block) if isinstance(item, Gap)]
            if block.first >= first_of(high).first:
                break
        if not gaps:
            raise LookupError
        if not all(gap.bridged for gap in gaps):
            return runs.begin
        chunk = low
    return first_of(0).start_ns, first_of(0).first


@dataclass(slots=True)
class NonFiniteHold:
    """Replaces NaN and infinities by each channel's last finite value (0 before the first).

    Attributes
    ----------
    count
        How many samples were replaced.
    last_ns
        Time of the last one [ns].
    """

    count: int = 0
    last_ns: int = 0
    _last: NDArray[Any] | None = None

    def fill(self, block: SignalBlock) -> SignalBlock:
        """Return the block with every sample finite; the same object where it was."""
        samples = block.samples
        if samples.dtype.kind != "f" or not len(block):
            return block
        finite = np.isfinite(samples)
        before = np.zeros(samples.shape[1], samples.dtype) if self._last is None else self._last
        if not finite.all():
            self.count += int((~finite).sum())
            self.last_ns = block.time_of(int(np.flatnonzero(~finite.all(axis=1))[-1]))
            extended = np.concatenate([before[None, :], samples])
            valid = np.concatenate([np.ones((1, samples.shape[1]), np.bool_), finite])
            rows = np.arange(len(extended))[:, None]
            source = np.maximum.accumulate(np.where(valid, rows, 0), axis=0)
            samples = np.take_along_axis(extended, source, axis=0)[1:]
            block = replace(block, samples=samples)
        self._last = samples[-1].copy()
        return block
