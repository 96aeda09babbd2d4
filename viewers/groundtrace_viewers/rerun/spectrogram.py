"""Spectrogram of one channel as coloured squares at their time and frequency.

Squares in a plot share the linked time axis and the cursor with every other plot; an image could
not. Levels are coloured when the replay ends, by percentiles of the whole recording. The viewer
draws every square in view in every frame. So the overview of a long recording has the widest
columns that can be told apart, and a second plot has columns of 50 ms around the cursor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from groundtrace.dsp.spectral import WindowPower
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES, SignalBlock

from .context import View
from .timeline import Entity, colour_column, heat, scalar_column

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rerun as rr
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import Stream

    from .context import ViewContext
    from .timeline import Timeline

#: Most squares of the overview, and of the plot around the cursor.
MAX_POINTS, MAX_FINE_POINTS = 240_000, 1_000_000
BANDS = 32
#: Shortest columns of long recordings [s], and how much of them is shown around the cursor [s].
COLUMN_S, AROUND_S = 0.05, 5.0
#: The viewer opens long recordings with about this much in view.
IN_VIEW_S = 60.0
#: Percentiles of the levels that get the darkest and the lightest colour.
SHOWN = (8.0, 99.7)
#: Colours told apart: fewer compress better.
SHADES = 64
COLUMNS_IN_VIEW = 240
#: A signal is averaged down to no less than so many times the highest frequency shown.
OVERSAMPLED = 8.0


@dataclass(frozen=True, slots=True)
class Resolution:
    """How a spectrogram is cut.

    Attributes
    ----------
    window
        Samples per transform.
    hop
        Samples from one transform to the next.
    transform
        Length of the zero-padded transform.
    edges
        Shape (n_bands + 1,): bounds of the bands as indices of the transform.
    pool
        Transforms per shown column, pooled by their maximum.
    """

    window: int
    hop: int
    transform: int
    edges: NDArray[np.intp]
    pool: int

    def power(self, taper: NDArray[np.float64]) -> WindowPower:
        """Return what transforms windows with such weights, as far up as there are bands."""
        return WindowPower(taper, self.transform, int(self.edges[-1]), mean_removed=True)

    def frequencies_hz(self, rate_hz: float) -> NDArray[np.float64]:
        """Return the bands' centres [Hz]."""
        return (self.edges[:-1] + self.edges[1:] - 1) / 2.0 * rate_hz / self.transform


def resolution(rate_hz: float, window_s: float, top_hz: float, duration_s: float) -> Resolution:
    """Choose windows and bands so that the picture is neither coarse nor too heavy to draw.

    Parameters
    ----------
    rate_hz
        Of the signal.
    window_s
        Length of a transform [s].
    top_hz
        Highest frequency shown [Hz].
    duration_s
        Of the recording [s].
    """
    column_s = max(
        min(duration_s, IN_VIEW_S) / COLUMNS_IN_VIEW, duration_s * BANDS / MAX_POINTS, 0.0125
    )
    fine_s = max(COLUMN_S, duration_s * BANDS / MAX_FINE_POINTS)
    hop = max(1, round((fine_s if column_s >= 2 * fine_s else column_s) * rate_hz))
    window = max(8, round(window_s * rate_hz))
    transform = 2 * window
    last = min(window + 1, 2 + round(top_hz * transform / rate_hz))
    edges = np.unique(np.linspace(1, last, min(BANDS, last - 1) + 1).astype(np.intp))
    # A hop is rounded to samples: a column a little wider than its hop is still one hop.
    pool = max(1, int(np.ceil(column_s * rate_hz / hop - 0.1)))
    return Resolution(window, hop, transform, edges, pool)


class BandLevels:
    """Band levels of a channel, transform by transform, whatever the blocks' bounds.

    Transform ``k`` of a contiguous run covers samples ``[k * hop, k * hop + window)`` of the run
    and lies at the time of its middle.
    """

    def __init__(self, cut: Resolution) -> None:
        self._cut = cut
        self._power = cut.power(np.hanning(cut.window))
        self._anchor_ns: int | None = None
        self._tail: NDArray[np.float64] = np.empty(0)
        self._first = 0

    def push(
        self, block: SignalBlock, samples: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Take samples, shape (n,), and return the transforms they complete.

        Returns
        -------
        times_ns, levels_db
            Shape (m,) and (m, n_bands).
        """
        cut = self._cut
        if (block.anchor_ns, block.first) != (self._anchor_ns, self._first + len(self._tail)):
            self._anchor_ns, self._tail = block.anchor_ns, np.empty(0)
            self._first = block.first
        run = np.concatenate([self._tail, samples])
        begin = -(-self._first // cut.hop)
        end = (self._first + len(run) - cut.window) // cut.hop + 1
        keep = max(begin, end) * cut.hop
        frames = np.arange(begin, max(begin, end)) * cut.hop
        start = begin * cut.hop - self._first
        levels = band_levels(run, start, len(frames), cut, self._power)
        drop = min(max(0, keep - self._first), len(run))
        self._tail, self._first = run[drop:], self._first + drop
        middle = (frames + cut.window / 2) * block.stream.period_ns
        return block.anchor_ns + np.rint(middle).astype(np.int64), levels


def band_levels(
    run: NDArray[np.float64], start: int, count: int, cut: Resolution, power: WindowPower
) -> NDArray[np.float32]:
    """Return the levels of bands [dB], shape (count, n_bands).

    Parameters
    ----------
    run
        Shape (m,): samples.
    start, count
        Where the first transform begins in it, and how many there are, a hop apart.
    cut
        How it is cut.
    power
        Of each transform: :meth:`Resolution.power`.
    """
    if count <= 0:
        return np.empty((0, len(cut.edges) - 1), np.float32)
    spectra = power(run, start, cut.hop, count)
    bands = np.add.reduceat(spectra, cut.edges[:-1], axis=1) / np.diff(cut.edges)
    return (10.0 * np.log10(bands + 1e-30)).astype(np.float32)


class Averaged:
    """Means of so many samples each, whatever the blocks' bounds: a slower signal to transform.

    Mean ``k`` of a contiguous run is of samples ``[k * every, (k + 1) * every)`` and lies at the
    time of their middle. At a rate of :data:`OVERSAMPLED` times the highest frequency shown, means
    take 0.2 dB from that, and what folds back onto it from above is 17 dB weaker.
    """

    def __init__(self, every: int) -> None:
        self._every = every
        self._anchor_ns: int | None = None
        self._rest: NDArray[np.float64] = np.empty(0)
        self._next = 0  # sample of the run that comes after the rest

    def push(self, block: SignalBlock, samples: NDArray[np.float64]) -> SignalBlock:
        """Take samples, shape (n,), and return the means that they complete."""
        every, stream = self._every, block.stream
        if (block.anchor_ns, block.first) != (self._anchor_ns, self._next):
            self._anchor_ns, self._rest, self._next = block.anchor_ns, np.empty(0), block.first
        if not len(self._rest):
            skipped = min(-self._next % every, len(samples))
            self._next, samples = self._next + skipped, samples[skipped:]
        run = np.concatenate([self._rest, samples])
        first = (self._next - len(self._rest)) // every
        self._next += len(samples)
        count = len(run) // every
        self._rest = run[count * every :]
        means = run[: count * every].reshape(count, every).mean(axis=1)
        middle_ns = round((every - 1) / 2 * stream.period_ns)
        slower = replace(stream, rate_hz=stream.rate_hz / every)
        return SignalBlock(slower, block.anchor_ns + middle_ns, first, means[:, np.newaxis])


def squares(
    shade: NDArray[np.floating], frequencies_hz: NDArray[np.float64]
) -> list[rr.ComponentColumn]:
    """Return squares at frequencies, of shades within [0, 1]: shape (n, n_bands)."""
    return [
        scalar_column(np.broadcast_to(frequencies_hz, shade.shape)),
        colour_column(_palette()[np.rint(shade * SHADES).astype(np.intp)]),
    ]


@cache
def _palette() -> NDArray[np.uint32]:
    return heat(np.arange(SHADES + 1) / SHADES)


class Spectrogram:
    """Logs the spectrogram of one signal of a stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the signal.
    duration_s
        Of the recording [s].
    column
        Of a seismic channel; None takes the magnitude of the acceleration.
    """

    def __init__(
        self, timeline: Timeline, stream: Stream, duration_s: float, column: int | None
    ) -> None:
        seismic = [] if column is None else [column]
        self._columns = seismic or stream.columns_of({"acceleration"})
        window_s, top_hz = (0.1, 250.0) if seismic else (1.28, 15.0)
        self._timeline = timeline
        every = max(1, int(stream.rate_hz / (OVERSAMPLED * top_hz)))
        rate_hz = stream.rate_hz / every
        self._averaged = Averaged(every)
        self._cut = resolution(rate_hz, window_s, top_hz, duration_s)
        self._hop_ns = self._cut.hop * NS_PER_S / rate_hz
        self._column_ns = self._hop_ns * self._cut.pool
        self._bands = BandLevels(self._cut)
        self._frequencies = self._cut.frequencies_hz(rate_hz)
        self._times: list[NDArray[np.int64]] = []
        self._levels: list[NDArray[np.float32]] = []
        what = stream.channels[seismic[0]].name if seismic else "|acceleration|"
        self._tail = stream.topic.strip("/") + (f"/{what}" if seismic else "")
        self._title = f"Spectrogram of {what} {stream.topic}"
        self._fine = bool(seismic) and self._cut.pool > 1
        shown_s = min(duration_s, IN_VIEW_S)
        self._declare("spectrogram", f"{self._title} [Hz]", shown_s / self._cut.pool)
        if self._fine:
            column_ms = self._hop_ns / 1e6
            title = f"{self._title}: columns of {column_ms:.0f} ms, cursor ± {AROUND_S:g} s [Hz]"
            self._declare("tones", title, 2 * AROUND_S)

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Whether a stream has something worth a spectrogram."""
        worn = bool(stream.columns_of({"acceleration"})) and stream.rate_hz >= 50.0
        return not stream.irregular and (worn or bool(stream.columns_of(SEISMIC_QUANTITIES)))

    def _declare(self, role: str, title: str, hops_s: float) -> None:
        """Announce a plot; ``hops_s`` is what is in view, as time of as many hops as columns."""
        import rerun as rr

        bands = len(self._frequencies)
        top = float(self._frequencies[-1])
        columns = hops_s * NS_PER_S / self._hop_ns
        # Markers are sized in screen points: large enough to close a panel of 960 x 120 points.
        size = float(np.clip(max(120.0 / bands, 960.0 / max(columns, 1.0)) + 0.8, 2.0, 9.0))
        style = rr.SeriesPoints(markers=["square"] * bands, marker_sizes=[size] * bands)
        self._timeline.declare(Entity(f"/{role}/{self._tail}", role, title, bands, top=top), style)

    def write(self, block: SignalBlock) -> None:
        """Take a block."""
        values = block.select(self._columns).values
        signal = values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)
        slower = self._averaged.push(block, signal)
        times, levels = self._bands.push(slower, slower.samples[:, 0])
        if len(times):
            self._times.append(times)
            self._levels.append(levels)

    def close(self) -> None:
        """Colour and log what was taken."""
        if not self._times:
            return
        times, levels = np.concatenate(self._times), np.concatenate(self._levels)
        order = np.argsort(times, kind="stable")
        times, levels = times[order], levels[order]
        pooled = self._pooled(times, levels)
        self._log("spectrogram", *pooled, np.percentile(pooled[1], SHOWN))
        if self._fine:
            self._log("tones", times, levels, np.percentile(levels, SHOWN))

    def _log(
        self,
        role: str,
        times: NDArray[np.int64],
        levels: NDArray[np.float32],
        ends: NDArray[np.floating],
    ) -> None:
        """Log columns; ``ends`` are the levels of the darkest and the lightest colour [dB]."""
        low, high = float(ends[0]), float(ends[1])
        shade = np.clip((levels - low) / max(high - low, 1e-6), 0.0, 1.0)
        columns = squares(shade, self._frequencies)
        self._timeline.send(f"/{role}/{self._tail}", times, columns)

    def _pooled(
        self, times: NDArray[np.int64], levels: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        column = (times - times[0] + self._hop_ns / 2) // self._column_ns
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        return times[starts], np.maximum.reduceat(levels, starts, axis=0)


class SpectrogramViews(View):
    """The spectrograms of one stream: of the chosen channels, else the first seismic one."""

    def __init__(self, context: ViewContext) -> None:
        # its colours are those of the whole, which nobody knows while it grows
        streams = () if context.session.live else context.session.streams
        fitting = [s for s in streams if Spectrogram.fits(s)]
        asked = (s for s in fitting if chosen(s, context.channels))
        stream = next(asked, next(iter(fitting), None))
        self._topic = stream.topic if stream is not None else ""
        self._parts: list[Spectrogram] = []
        if stream is not None:
            duration_s = context.plan.duration_ns / NS_PER_S
            columns: list[int | None] = [*chosen(stream, context.channels)]
            for column in columns or [None]:
                self._parts.append(Spectrogram(context.timeline, stream, duration_s, column))

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        if block.topic == self._topic:
            for part in self._parts:
                part.write(block)

    def close(self) -> None:
        """Colour and log what was taken."""
        for part in self._parts:
            part.close()

    kinds: ClassVar = {SignalBlock: signal}


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
        self._declared = False
        self._path = f"/spectrum/{stream.topic.strip('/')}/{channel}"
        self._title = f"Spectrogram of {channel} at steps, Hamming 3 ms, 50 % overlap [Hz]"

    def show(self, times_ns: NDArray[np.int64], samples: NDArray[np.float64]) -> None:
        """Log the spectrogram of an excerpt: times and samples, shape (n,)."""
        cut, bands = self._cut, len(self._frequencies)
        starts = np.arange(0, len(samples) - cut.window + 1, cut.hop)
        if not len(starts):
            return
        levels = band_levels(np.ascontiguousarray(samples), 0, len(starts), cut, self._power)
        if not self._declared:
            self._declare(bands)
            self._declared = True
        shade = np.clip(1.0 + (levels - levels.max()) / RANGE_DB, 0.0, 1.0)
        columns = squares(shade, self._frequencies)
        self._timeline.send(self._path, times_ns[starts + cut.window // 2], columns)

    def _declare(self, bands: int) -> None:
        import rerun as rr

        # the panel shows some 54 columns on 900 points, on 110 points of height
        size = float(np.clip(max(110.0 / bands, 17.0) + 1.0, 2.0, 20.0))
        style = rr.SeriesPoints(markers=["square"] * bands, marker_sizes=[size] * bands)
        top = float(self._frequencies[-1] + self._frequencies[0])
        self._timeline.declare(Entity(self._path, "spectrum", self._title, bands, top=top), style)


class FineSpectrograms(View):
    """The spectrograms around steps of the chosen channels, by default the first seismic one."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._topics: set[str] = set()
        self._parts: list[StreamSpectra] = []
        for stream in context.session.streams:
            self._begin(stream)

    @staticmethod
    def fits(context: ViewContext) -> bool:
        """Whether anything is shown at every sample around steps in a room."""
        return context.session.application == "room" and context.plan.mode != "none"

    def signal(self, block: SignalBlock) -> None:
        """Take a block: it may be of a stream that the session did not name."""
        if block.topic not in self._topics:
            self._begin(block.stream)

    def _begin(self, stream: Stream) -> None:
        context = self._context
        self._topics.add(stream.topic)
        seismic = not stream.irregular and stream.columns_of(SEISMIC_QUANTITIES)
        if seismic and stream.rate_hz >= LEAST_RATE_HZ and (context.channels or not self._parts):
            self._parts.append(StreamSpectra(context, stream))

    def near(self, time_ns: int) -> None:
        """Log the spectrograms around a moment."""
        for part in self._parts:
            part.show(time_ns)

    kinds: ClassVar = {SignalBlock: signal}


class StreamSpectra:
    """The spectrograms of the chosen channels of one stream.

    Parameters
    ----------
    context
        Where to, and which channels.
    stream
        Of the channels.
    """

    def __init__(self, context: ViewContext, stream: Stream) -> None:
        self._columns = chosen(stream, context.channels)
        names = [stream.channels[column].name for column in self._columns]
        self._parts = [FineSpectrogram(context.timeline, stream, name) for name in names]
        self._traces = context.traces
        self._topic = stream.topic
        self._shown_to_ns = 0

    def show(self, time_ns: int) -> None:
        """Log the spectrograms around a moment, without what was shown around others."""
        start_ns = max(time_ns - round(BEFORE_S * NS_PER_S), self._shown_to_ns)
        end_ns = time_ns + round(AFTER_S * NS_PER_S)
        piece = self._traces.between(self._topic, start_ns, end_ns, self._columns)
        if piece is None:
            return
        times, values = piece
        self._shown_to_ns = int(times[-1])
        for column, part in enumerate(self._parts):
            part.show(times, values[:, column])


def chosen(stream: Stream, channels: Sequence[str]) -> list[int]:
    """Return the columns of the chosen channels: of none, the first seismic one."""
    seismic = stream.columns_of(SEISMIC_QUANTITIES)
    if not channels:
        return seismic[:1]
    return [column for column in seismic if stream.channels[column].name in channels]
