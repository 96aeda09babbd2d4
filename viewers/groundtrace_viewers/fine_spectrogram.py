"""Spectrogram around steps with short windows: Hamming of 3 ms, overlapping by half."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .excerpts import Excerpts
from .palette import heat
from .spectrogram import BANDS, SHADES, Resolution, band_levels
from .timeline import Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

    from .timeline import Timeline

WINDOW_S = 0.003
#: Highest frequency shown [Hz]: footsteps on floors have little above.
TOP_HZ = 2000.0
#: How much is shown around a moment [s].
BEFORE_S, AFTER_S = 0.5, 0.5
#: What is shown lies within this of a step's loudest band [dB].
RANGE_DB = 45.0
#: Slower streams have no spectrum in 3 ms.
LEAST_RATE_HZ = 4000.0


class FineSpectrogram:
    """Logs the spectrogram of one channel around steps.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the channel.
    channel
        Its name.
    """

    def __init__(self, timeline: Timeline, stream: Stream, channel: str) -> None:
        self._timeline = timeline
        self._rate_hz = stream.rate_hz
        window = 2 * round(WINDOW_S * stream.rate_hz / 2)
        transform = 2 * window
        last = min(window + 1, 2 + round(TOP_HZ * transform / stream.rate_hz))
        edges = np.unique(np.linspace(1, last, min(BANDS, last - 1) + 1).astype(np.intp))
        self._cut = Resolution(window, window // 2, transform, edges, 1)
        self._power = self._cut.power(np.hamming(window))
        self._frequencies = self._cut.frequencies_hz(stream.rate_hz)
        self._path = f"/spectrum/{stream.topic.strip('/')}/{channel}"
        self._title = f"Spectrogram of {channel} at steps, Hamming 3 ms, 50 % overlap [Hz]"

    def show(self, times_ns: NDArray[np.int64], samples: NDArray[np.float32]) -> None:
        """Log the spectrogram of an excerpt: times and samples, shape (n,)."""
        import rerun as rr

        cut, bands = self._cut, len(self._frequencies)
        starts = np.arange(0, len(samples) - cut.window + 1, cut.hop)
        if not len(starts):
            return
        levels = band_levels(samples.astype(np.float64), 0, len(starts), cut, self._power)
        self._declare(bands)
        shade = np.clip(1.0 + (levels - levels.max()) / RANGE_DB, 0.0, 1.0)
        colours = heat(np.round(shade * SHADES) / SHADES)
        rows = np.full(len(starts), bands)
        columns = [
            *rr.Scalars.columns(scalars=np.tile(self._frequencies, len(starts))).partition(rows),
            *rr.SeriesPoints.columns(colors=colours.ravel()).partition(rows),
        ]
        self._timeline.send(self._path, times_ns[starts + cut.window // 2], columns)

    def _declare(self, bands: int) -> None:
        import rerun as rr

        # the panel shows some 54 columns on 900 points, on 110 points of height
        size = float(np.clip(max(110.0 / bands, 17.0) + 1.0, 2.0, 20.0))
        style = rr.SeriesPoints(markers=["square"] * bands, marker_sizes=[size] * bands)
        top = float(self._frequencies[-1] + self._frequencies[0])
        self._timeline.declare(Entity(self._path, "spectrum", self._title, bands, top=top), style)


class SpectrumViews:
    """The spectrograms of the chosen channels of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the channels.
    channels
        Names, those of other streams among them; empty takes the first seismic channel.
    """

    def __init__(self, timeline: Timeline, stream: Stream, channels: Sequence[str]) -> None:
        self._columns = chosen(stream, channels)
        names = [stream.channels[column].name for column in self._columns]
        self._parts = [FineSpectrogram(timeline, stream, name) for name in names]
        self._excerpts = Excerpts(BEFORE_S, AFTER_S)
        self._shown_to_ns = 0

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        if self._columns and len(block):
            self._excerpts.push(block.sample_times(), block.select(self._columns).values)

    def expect(self, time_ns: int) -> None:
        """Take an arrival, which may become a step, or a true step, which may be missed."""
        self._excerpts.expect(time_ns)

    def show(self, time_ns: int) -> None:
        """Log the spectrograms around a moment, without what was shown around others."""
        piece = self._excerpts.around(time_ns)
        if piece is None:
            return
        new = piece[0] >= self._shown_to_ns
        times, values = piece[0][new], piece[1][new]
        if not len(times):
            return
        self._shown_to_ns = int(times[-1])
        for column, part in enumerate(self._parts):
            part.show(times, values[:, column])


def chosen(stream: Stream, channels: Sequence[str]) -> list[int]:
    """Return the columns of the chosen channels: of none, the first seismic one."""
    seismic = stream.columns_of(SEISMIC_QUANTITIES)
    if not channels:
        return seismic[:1]
    return [column for column in seismic if stream.channels[column].name in channels]
