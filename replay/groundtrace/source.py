"""The source: typed blocks of every topic in one time order, gaps as events, joined for speed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .runs import IrregularRuns, UniformRuns, run_tracker

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from groundtrace_codecs.recording import Stamped
    from groundtrace_codecs.signals import Stream

#: Length to which unpaced blocks are joined [s].
BLOCK_S = 0.5
#: Longest gap that is filled instead of ending the run [s].
BRIDGE_S = 0.1


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
        Contiguous blocks are joined to about this length [s]; 0 leaves them as recorded.
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
        block_s: float = BLOCK_S,
        bridge_s: float = BRIDGE_S,
    ) -> None:
        self.recording = recording
        self.topics = topics
        self.start_ns = start_ns
        self.stop_ns = stop_ns
        self.block_ns = round(block_s * NS_PER_S)
        self.bridge_s = bridge_s

    @property
    def streams(self) -> tuple[Stream, ...]:
        """The streams as they come: uniform."""
        chosen = self.recording.streams
        if self.topics is not None:
            chosen = tuple(s for s in chosen if s.topic in self.topics)
        return tuple(replace(s, irregular=False) for s in chosen)

    def __iter__(self) -> Iterator[SignalBlock | Gap]:
        """Yield blocks and gaps."""
        waiting: dict[str, list[SignalBlock | Gap]] = {}
        window = None
        for log_ns, item in self._runs():
            if self.block_ns == 0:
                yield item
                continue
            if window is None:
                window = log_ns // self.block_ns
            elif log_ns // self.block_ns > window:
                window = log_ns // self.block_ns
                yield from self._drain(waiting)
            waiting.setdefault(item.topic, []).append(item)
        yield from self._drain(waiting)

    def _runs(self) -> Iterator[tuple[int, SignalBlock | Gap]]:
        trackers: dict[str, UniformRuns | IrregularRuns] = {}
        for log_ns, block in self.recording.blocks(self.topics, self.start_ns, self.stop_ns):
            if block.topic not in trackers:
                trackers[block.topic] = run_tracker(block.stream, self.bridge_s)
            for item in trackers[block.topic].add(block):
                yield log_ns, item

    def _drain(self, waiting: dict[str, list[SignalBlock | Gap]]) -> Iterator[SignalBlock | Gap]:
        for stream in self.recording.streams:
            yield from joined(waiting.pop(stream.topic, []))


def joined(items: list[SignalBlock | Gap]) -> Iterator[SignalBlock | Gap]:
    """Yield the items of one stream with contiguous blocks of one run made into one."""
    together: list[SignalBlock] = []
    for item in items:
        if together and not (isinstance(item, SignalBlock) and _continues(together[-1], item)):
            yield _one(together)
            together = []
        if isinstance(item, Gap):
            yield item
        else:
            together.append(item)
    if together:
        yield _one(together)


def _continues(before: SignalBlock, after: SignalBlock) -> bool:
    return after.anchor_ns == before.anchor_ns and after.first == before.first + len(before)


def _one(blocks: list[SignalBlock]) -> SignalBlock:
    if len(blocks) == 1:
        return blocks[0]
    # the planar layout of the parts is kept: filters run along each channel
    planar = np.concatenate([b.samples.T for b in blocks], axis=1)
    return replace(blocks[0], samples=planar.T)
