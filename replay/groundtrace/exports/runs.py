"""Contiguous runs of a stream, in pieces of bounded length."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from groundtrace_codecs.recording import Recording
    from groundtrace_codecs.signals import SignalBlock, Stream


def pieces_of(recording: Recording, stream: Stream, longest_s: float) -> Iterator[SignalBlock]:
    """Yield the samples of a uniform stream as stored, joined as far as none is missing.

    Parameters
    ----------
    recording, stream
        What to read.
    longest_s
        About the longest piece [s].
    """
    waiting: list[SignalBlock] = []
    samples = 0
    for _, block in recording.blocks([stream.topic]):
        full = samples >= longest_s * stream.rate_hz
        if waiting and (full or not _continues(waiting[-1], block)):
            yield _joined(waiting)
            waiting, samples = [], 0
        waiting.append(block)
        samples += len(block)
    if waiting:
        yield _joined(waiting)


def _continues(before: SignalBlock, block: SignalBlock) -> bool:
    """Whether a block starts where one ended, to half a sample, with samples of its type."""
    off_ns = abs(block.start_ns - before.last_ns - before.stream.period_ns)
    same = block.samples.dtype == before.samples.dtype
    return same and off_ns < before.stream.period_ns / 2


def _joined(blocks: list[SignalBlock]) -> SignalBlock:
    return replace(blocks[0], samples=np.concatenate([b.samples for b in blocks]))
