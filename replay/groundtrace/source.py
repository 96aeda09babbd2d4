"""The source: typed blocks of every topic in one time order, gaps as events, joined for speed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from groundtrace_codecs.events import Gap
from groundtrace_codecs.recording import BATCH_NS
from groundtrace_codecs.signals import NS_PER_S, SignalBlock, as_one

from .runs import IrregularRuns, UniformRuns, run_tracker

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from groundtrace_codecs.recording import Stamped
    from groundtrace_codecs.signals import Stream

    #: What makes runs of each topic's blocks.
    Trackers = dict[str, UniformRuns | IrregularRuns]

#: Samples of the fastest stream that unpaced blocks are joined to: what a block costs, whatever its
#: length, then hardly counts.
BLOCK_SAMPLES = 3000
#: Shortest such block, also where one stream is alone and waits for no other, and longest one [s].
BLOCK_S, ALONE_BLOCK_S, LONGEST_BLOCK_S = 0.5, 2.0, 30.0
#: Longest gap that is filled instead of ending the run [s].
BRIDGE_S = 0.1


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
    ) -> Iterator[Stamped]:
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
    ) -> None:
        self.recording = recording
        self.topics = topics
        self.start_ns = start_ns
        self.stop_ns = stop_ns
        length_s = block_length_s(self.streams) if block_s is None else block_s
        self.block_ns = round(length_s * NS_PER_S)
        self.bridge_s = bridge_s
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
        self._trackers = {}
        waiting: dict[str, list[SignalBlock | Gap]] = {}
        width_ns = self.block_ns or BATCH_NS
        window = None
        wanted = (self.topics, self.start_ns, self.stop_ns, self.block_ns)
        for log_ns, block in self.recording.blocks(*wanted):
            if window is not None and log_ns // width_ns > window:
                yield from self._drain(waiting)
            window = max(window or 0, log_ns // width_ns)
            for item in self._followed(block):
                if self.block_ns == 0:
                    yield item
                else:
                    waiting.setdefault(item.topic, []).append(item)
        yield from self._drain(waiting)

    def _followed(self, block: SignalBlock) -> Iterator[SignalBlock | Gap]:
        """Yield what a recorded block adds to the run of its stream."""
        if block.topic not in self._trackers:
            self._trackers[block.topic] = run_tracker(block.stream, self.bridge_s)
        yield from self._trackers[block.topic].add(block)

    def _drain(self, waiting: dict[str, list[SignalBlock | Gap]]) -> Iterator[SignalBlock | Gap]:
        for stream in self.recording.streams:
            yield from joined(waiting.pop(stream.topic, []))


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
