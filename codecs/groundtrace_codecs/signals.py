"""Sampled signals: what a channel is, what a stream is, and a block of samples of one stream.

A block of 16 geophones and a block of an accelerometer's three axes are the same type with other
channels. Algorithms choose channels by quantity, never by position in a file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
#: Epoch times before this are boot clocks, not dates [ns]: 1980-01-01.
FIRST_DATE_NS = 315_532_800_000_000_000

#: Quantities a seismic channel may carry, whatever its sensor and digitiser.
SEISMIC_QUANTITIES = frozenset(
    {"ground_velocity", "ground_acceleration", "ground_displacement", "voltage", "seismic"}
)


@dataclass(frozen=True, slots=True)
class Channel:
    """One scalar signal of a stream.

    Attributes
    ----------
    name
        Unique within its stream, e.g. ``"G1"`` or ``"acc_x"``.
    quantity
        What is measured: ``acceleration``, ``angular_velocity``, ``magnetic_field``, ``pressure``,
        ``temperature``, ``latitude``, ``longitude``, ``altitude``, ``ground_velocity``,
        ``voltage``, ``seismic`` (uncalibrated), ``acceleration_magnitude``, ...
    unit
        Unit of ``samples * scale``: SI (``m/s2``, ``rad/s``, ``T``, ``Pa``, ``m/s``), or ``count``
        or ``a.u.`` (arbitrary units) where the sensitivity is unknown.
    axis
        ``x``, ``y``, ``z`` or empty.
    scale
        Factor from a stored sample to ``unit``.
    position_m
        Where the sensor stands in the site's frame, or None.
    """

    name: str
    quantity: str
    unit: str
    axis: str = ""
    scale: float = 1.0
    position_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class Stream:
    """Static description of one sampled stream.

    Attributes
    ----------
    topic
        Name of the stream in its recording, e.g. ``/seismic`` or ``/imu/waist``.
    channels
        The scalar signals, in the order of the columns of a block.
    rate_hz
        Sampling rate; for an irregular stream the rate of the grid it is brought to (the inverse
        of the median interval).
    placement
        Where on the body a worn sensor sits: ``waist``, ``trunk``, ``foot``, ``wrist``, ``phone``.
    irregular
        True where samples carry their own times.
    """

    topic: str
    channels: tuple[Channel, ...]
    rate_hz: float
    placement: str = ""
    irregular: bool = False

    @property
    def scales(self) -> NDArray[np.float64]:
        """Scale of each channel, shape (n_channels,)."""
        return np.array([c.scale for c in self.channels], np.float64)

    @property
    def period_ns(self) -> float:
        """Time between two samples [ns]."""
        return NS_PER_S / self.rate_hz

    def columns_of(self, quantities: frozenset[str] | set[str]) -> list[int]:
        """Return the columns whose quantity is one of ``quantities``."""
        return [i for i, c in enumerate(self.channels) if c.quantity in quantities]

    def select(self, columns: Sequence[int]) -> Stream:
        """Return the stream of some of the columns."""
        return replace(self, channels=tuple(self.channels[i] for i in columns))


@dataclass(frozen=True, slots=True, eq=False)
class SignalBlock:
    """Consecutive samples of one stream.

    Sample ``i`` of a uniform block lies at ``anchor_ns + round((first + i) * period)``: the anchor
    is the time of sample 0 of the contiguous run, so that times do not depend on how the run was
    cut into blocks.

    Attributes
    ----------
    stream
        What the columns are.
    anchor_ns
        Time of sample 0 of the contiguous run [ns since the recording's epoch].
    first
        Index in the run of the block's first sample.
    samples
        Shape (n_samples, n_channels), as stored; any integer or floating type.
    times_ns
        Shape (n_samples,), only for irregular streams: the samples' own times.
    """

    stream: Stream
    anchor_ns: int
    first: int
    samples: NDArray[Any]
    times_ns: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return int(self.samples.shape[0])

    @property
    def topic(self) -> str:
        """Topic of the block's stream."""
        return self.stream.topic

    @property
    def values(self) -> NDArray[np.float64]:
        """The samples in the channels' units, shape (n_samples, n_channels), a new array."""
        scaled: NDArray[np.float64] = self.samples * self.stream.scales
        return scaled

    @property
    def start_ns(self) -> int:
        """Time of the first sample [ns]."""
        return self.time_of(0)

    @property
    def last_ns(self) -> int:
        """Time of the last sample [ns]."""
        return self.time_of(len(self) - 1)

    @property
    def end_ns(self) -> int:
        """Time just after the block, one period after its last sample [ns]."""
        return self.last_ns + round(self.stream.period_ns)

    def time_of(self, index: int) -> int:
        """Return the time of sample ``index`` of the block [ns]."""
        if self.times_ns is not None:
            return int(self.times_ns[index])
        return self.anchor_ns + round((self.first + index) * self.stream.period_ns)

    def sample_times(self) -> NDArray[np.int64]:
        """Return the time of every sample [ns], shape (n_samples,)."""
        if self.times_ns is not None:
            return self.times_ns
        index = np.arange(self.first, self.first + len(self), dtype=np.float64)
        return self.anchor_ns + np.rint(index * self.stream.period_ns).astype(np.int64)

    def index_of(self, time_ns: int) -> int:
        """Return the index of the first sample at a time or later; the length if there is none."""
        if self.times_ns is not None:
            return int(np.searchsorted(self.times_ns, time_ns))
        near = round((time_ns - self.anchor_ns) / self.stream.period_ns) - self.first
        index = min(max(near, 0), len(self))
        while index > 0 and self.time_of(index - 1) >= time_ns:
            index -= 1
        while index < len(self) and self.time_of(index) < time_ns:
            index += 1
        return index

    def slice(self, start: int, stop: int) -> SignalBlock:
        """Return samples ``[start, stop)`` as a block of the same run."""
        times = None if self.times_ns is None else self.times_ns[start:stop]
        return replace(
            self, first=self.first + start, samples=self.samples[start:stop], times_ns=times
        )

    def between(self, start_ns: int | None, stop_ns: int | None) -> SignalBlock:
        """Return the samples with times in ``[start_ns, stop_ns)``; None is no bound."""
        if start_ns is None and stop_ns is None:
            return self
        if self.times_ns is None:
            first = 0 if start_ns is None else self.index_of(start_ns)
            stop = len(self) if stop_ns is None else self.index_of(stop_ns)
            return self.slice(first, stop) if first < stop else self.slice(0, 0)
        inside = np.ones(len(self), np.bool_)
        if start_ns is not None:
            inside &= self.times_ns >= start_ns
        if stop_ns is not None:
            inside &= self.times_ns < stop_ns
        return replace(self, samples=self.samples[inside], times_ns=self.times_ns[inside])

    def select(self, columns: Sequence[int]) -> SignalBlock:
        """Return the block of some of the columns."""
        if list(columns) == list(range(len(self.stream.channels))):
            return self
        return replace(
            self, stream=self.stream.select(columns), samples=self.samples[:, list(columns)]
        )

    def continues(self, before: SignalBlock) -> bool:
        """Return whether the block goes on, in the same run, where another one ends."""
        same = self.times_ns is not None or self.anchor_ns == before.anchor_ns
        return same and self.first == before.first + len(before)


def as_one(blocks: Sequence[SignalBlock]) -> SignalBlock:
    """Return blocks, each of which continues the one before, as one."""
    first = blocks[0]
    if len(blocks) == 1:
        return first
    # channel by channel, as samples are stored and filters run
    samples = np.concatenate([b.samples.T for b in blocks], axis=1).T
    times = [b.times_ns for b in blocks if b.times_ns is not None]
    joined = np.concatenate(times) if times else None
    return SignalBlock(first.stream, first.anchor_ns, first.first, samples, joined)
