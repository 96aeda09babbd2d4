"""Small streams, blocks and splits that the tests of the replay engine share."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from hypothesis import strategies as st

from groundtrace_codecs.events import Gap
from groundtrace_codecs.signals import Channel, SignalBlock, Stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

START_NS = 1_700_000_000_000_000_000


def stream_of(
    channels: int = 1, rate_hz: float = 1000.0, *, topic: str = "/s", irregular: bool = False
) -> Stream:
    names = tuple(Channel(f"G{i + 1}", "seismic", "count") for i in range(channels))
    return Stream(topic, names, rate_hz, irregular=irregular)


def block_of(
    stream: Stream, first: int, samples: Iterable[float], anchor_ns: int = START_NS
) -> SignalBlock:
    """A uniform block; a list of numbers becomes one column per channel."""
    column = np.asarray(list(samples), np.float64)
    return SignalBlock(stream, anchor_ns, first, np.tile(column[:, None], len(stream.channels)))


def irregular_of(stream: Stream, times_ns: Sequence[int], samples: Sequence[float]) -> SignalBlock:
    times = np.asarray(times_ns, np.int64)
    values = np.asarray(samples, np.float64)[:, None]
    return SignalBlock(stream, START_NS, 0, values, times)


def split(block: SignalBlock, cuts: Iterable[int]) -> list[SignalBlock]:
    """Cut a block at some of its samples; equal cuts give empty blocks."""
    edges = [0, *sorted(min(c, len(block)) for c in cuts), len(block)]
    return [block.slice(a, b) for a, b in pairwise(edges)]


def cuts_of(length: int) -> st.SearchStrategy[list[int]]:
    return st.lists(st.integers(0, length), max_size=8)


def parts_of(x: NDArray, cuts: Iterable[int]) -> list[NDArray]:
    """Cut an array along its last axis."""
    return np.split(x, sorted(cuts), axis=-1)


def gaps_in(items: Iterable[SignalBlock | Gap]) -> list[Gap]:
    return [item for item in items if isinstance(item, Gap)]


def blocks_in(items: Iterable[SignalBlock | Gap]) -> list[SignalBlock]:
    return [item for item in items if isinstance(item, SignalBlock)]


def times_in(items: Iterable[SignalBlock | Gap]) -> NDArray:
    return np.concatenate([b.sample_times() for b in blocks_in(items)] or [np.empty(0, np.int64)])


def samples_in(items: Iterable[SignalBlock | Gap]) -> NDArray:
    return np.concatenate([b.samples for b in blocks_in(items)] or [np.empty((0, 1))])
