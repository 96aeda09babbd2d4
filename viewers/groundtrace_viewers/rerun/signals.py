"""Signals on the timeline: envelopes for the overview, and samples at full rate around moments."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from .context import View
from .samples import FULL_RATE_HZ, curves_of, enveloped
from .timeline import NORM, SINGLES, Entity

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rerun as rr
    from numpy.typing import NDArray
    from rerun.components import AggregationPolicy

    from groundtrace_codecs.signals import Stream

    from .context import ViewContext
    from .samples import Curves, Piece, Plan
    from .timeline import SensorColours, Timeline

    #: A block, or the time at which a curve ends [ns].
    Part = SignalBlock | int

#: Envelopes: the finest, and for a recording that is longer than the viewer shows at first those of
#: what it shows, and of all of it.
ENVELOPE_HZ, OVERVIEW_HZ, WHOLE_HZ = 100.0, 20.0, 2.0
IN_VIEW_NS = 60 * NS_PER_S
#: A chunk of a fast stream lasts this long: about 2 MB, which the viewer reads best.
CHUNK_S = 1.0
SLOW_CHUNK_S = 10.0
#: Periods without samples that end a curve of a stream whose samples come at their own times.
IRREGULAR_PERIODS = 20.0


class SignalViews(View):
    """All streams: envelopes, and every sample where that is asked for."""

    def __init__(self, context: ViewContext) -> None:
        self._context = context
        self._streams: dict[str, SignalView] = {}
        for stream in context.session.streams:
            self._begin(stream)

    def _begin(self, stream: Stream) -> SignalView:
        context = self._context
        self._streams[stream.topic] = view = SignalView(
            context.timeline, stream, context.colours, context.plan, context.chunk_s
        )
        return view

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        (self._streams.get(block.topic) or self._begin(block.stream)).write(block)

    def close_up(self, start_ns: int, end_ns: int) -> None:
        """Show every sample of a half-open span."""
        for topic, view in self._streams.items():
            view.close_up(self._context.traces.blocks(topic, start_ns, end_ns))

    def close(self) -> None:
        """Log what is pending and the envelopes' last buckets."""
        for view in self._streams.values():
            view.close()

    kinds: ClassVar = {SignalBlock: signal}


class SignalView:
    """Logs the blocks of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        What the blocks hold.
    colours
        Of the sensors.
    plan
        What is shown at full rate.
    chunk_s
        Duration of a chunk [s]; None chooses by the rate.
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        colours: SensorColours,
        plan: Plan,
        chunk_s: float | None = None,
    ) -> None:
        fast = stream.rate_hz > FULL_RATE_HZ
        seconds = chunk_s or (CHUNK_S if fast else SLOW_CHUNK_S)
        self._timeline = timeline
        self._stream = stream
        self._plan = plan
        self._rows = max(1, round(seconds * stream.rate_hz))
        self._curves = curves_of(stream)
        self._declared: set[Curves] = set()
        self._styles = CurveStyles(stream, colours)
        self._levels = [
            EnvelopeView(
                timeline, stream, curves, self._styles, role, 1.0 / rate_hz, chunk_s or SLOW_CHUNK_S
            )
            for curves in self._curves
            if enveloped(stream, curves.quantity)
            for role, rate_hz in envelopes_of(plan)
        ]
        coarsest = self._levels[len(envelopes_of(plan)) - 1 :: len(envelopes_of(plan))]
        for level in coarsest:
            level.rows = ChannelRows.of(timeline, stream, level.curves, self._styles)
        self._parts: list[Part] = []
        self._pending = 0
        self._end_ns: int | None = None
        self._patience_ns = stream.period_ns * (IRREGULAR_PERIODS if stream.irregular else 1.0)
        self._slow = not all(enveloped(stream, curves.quantity) for curves in self._curves)
        for curves in self._curves:
            if plan.shows_all or not enveloped(stream, curves.quantity):
                self._declare(curves)

    def _declare(self, curves: Curves) -> None:
        if curves in self._declared:
            return
        self._declared.add(curves)
        around = f" around {self._plan.subject}" if self._plan.close_ups else ""
        where = around if enveloped(self._stream, curves.quantity) else ""
        self._timeline.declare(*self._styles.samples(curves, where))
        if has_norm(curves):
            self._timeline.declare(*self._styles.norm(curves))

    def write(self, block: SignalBlock) -> None:
        """Take a block."""
        start = 0
        while start < len(block):
            stop = min(len(block), start + self._rows - self._pending)
            self._take(block.slice(start, stop))
            start = stop

    def close_up(self, blocks: Sequence[SignalBlock]) -> None:
        """Log samples that were asked for later."""
        if not blocks:
            return
        ended = blocks[-1].last_ns + 1  # the viewer would draw a line to the next
        for curves in self._curves:
            if enveloped(self._stream, curves.quantity):
                self._log(curves, [*blocks, ended])

    def _take(self, block: SignalBlock) -> None:
        if self._end_ns is not None and block.start_ns - self._end_ns > self._patience_ns:
            self._break(self._end_ns)
        self._end_ns = block.end_ns
        for level in self._levels:
            level.push(block)
        first_ns, end_ns = self._plan.span_ns
        if self._slow or (block.start_ns < end_ns and block.last_ns >= first_ns):
            self._parts.append(block)
            self._pending += len(block)
        if self._pending >= self._rows:
            self.flush()

    def _break(self, end_ns: int) -> None:
        """End the curves at an interruption: the viewer would draw a line across it."""
        self._parts.append(end_ns)
        self._pending += 1
        for level in self._levels:
            level.end(end_ns)

    def flush(self) -> None:
        """Log what is pending, of fast curves what lies in the span that is shown."""
        parts, self._parts, self._pending = self._parts, [], 0
        inside = _within(parts, *self._plan.span_ns)
        for curves in self._curves:
            self._log(curves, inside if enveloped(self._stream, curves.quantity) else parts)

    def _log(self, curves: Curves, parts: Sequence[Part]) -> None:
        if not parts:
            return
        self._declare(curves)
        times = np.concatenate([_times_of(part) for part in parts])
        path, columns = entity_path("signal", curves), list(curves.columns)
        scales = self._stream.scales[columns]
        if enveloped(self._stream, curves.quantity):
            singles = np.full((len(times), len(columns)), np.nan, np.float32)
            _fill(singles, parts, columns, scales * curves.factor)
            self._timeline.singles(path, times, singles)
            return
        shown = np.full((len(times), len(columns)), np.nan)
        _fill(shown, parts, columns, scales)
        shown *= curves.factor
        self._timeline.scalars(path, times, shown)
        if has_norm(curves):
            norm = np.linalg.norm(shown, axis=1, keepdims=True)
            self._timeline.scalars(entity_path("norm", curves), times, norm)

    def close(self) -> None:
        """Log what is pending and the envelopes' last buckets."""
        self.flush()
        for level in self._levels:
            level.close()


def _times_of(part: Part) -> NDArray[np.int64]:
    return part.sample_times() if isinstance(part, SignalBlock) else np.array([part])


def _within(parts: Sequence[Part], start_ns: int, end_ns: int) -> list[Part]:
    """Return what of blocks and ends lies in a half-open span."""
    clipped: list[Part] = []
    for part in parts:
        if isinstance(part, SignalBlock):
            inside = part.between(start_ns, end_ns)
            clipped += [inside] if len(inside) else []
        elif start_ns <= part < end_ns:
            clipped.append(part)
    return clipped


def _fill(
    values: NDArray[np.floating],
    parts: Sequence[Part],
    columns: list[int],
    scales: NDArray[np.float64],
) -> None:
    """Write some columns of blocks in the units of scales, one after another; an end is no row."""
    start, every = 0, len(columns)
    for part in parts:
        if not isinstance(part, SignalBlock):
            start += 1
            continue
        samples = part.samples if every == part.samples.shape[1] else part.samples[:, columns]
        stop = start + len(part)
        np.multiply(samples, scales, out=values[start:stop], casting="same_kind")
        start = stop


def envelopes_of(plan: Plan) -> list[tuple[Role, float]]:
    """Return the envelopes that fast signals have: role, and buckets a second."""
    long = plan.duration_ns > IN_VIEW_NS
    finest: list[tuple[Role, float]] = [("envelope", ENVELOPE_HZ)]
    return [("overview", OVERVIEW_HZ), *finest, ("whole", WHOLE_HZ)] if long else finest


Role = Literal["signal", "envelope", "overview", "whole", "norm"]


def has_norm(curves: Curves) -> bool:
    """Whether curves are the axes of an acceleration, whose magnitude steps are found in."""
    return curves.quantity == "acceleration" and len(curves.columns) == 3


class CurveStyles:
    """What is logged once about the plots of a stream.

    Parameters
    ----------
    stream
        Of the channels.
    colours
        Of the sensors.
    """

    def __init__(self, stream: Stream, colours: SensorColours) -> None:
        self._stream = stream
        self._colours = colours

    def samples(self, curves: Curves, where: str = "") -> tuple[Entity, rr.SeriesLines]:
        """Return samples, and how they are drawn; ``where`` says which of them there are."""
        from rerun.components import AggregationPolicy

        title = f"{self._heading(curves)} [{curves.unit}]{where}{self._key(curves)}"
        # The viewer's default policy averages minimum and maximum, which hides impacts.
        lines = self._lines(curves, AggregationPolicy.MinMax)
        return self._entity("signal", title, curves), lines

    def envelope(
        self, curves: Curves, role: Role, bucket_s: float
    ) -> tuple[Entity, rr.SeriesLines]:
        """Return an envelope of buckets of a length, and how it is drawn."""
        from rerun.components import AggregationPolicy

        length = f"{bucket_s * 1e3:g} ms" if bucket_s < 0.1 else f"{bucket_s:g} s"
        what = "the whole recording" if role == "whole" else "envelope"
        title = f"{self._heading(curves)}: {what}, max |x| per {length} [{curves.unit}]"
        title += self._key(curves)
        lines = self._lines(curves, AggregationPolicy.Max)
        return self._entity(role, title, curves), lines

    def rows(self, curves: Curves, scale: str) -> tuple[Entity, rr.SeriesLines]:
        """Return a row for each channel, by a scale, and how it is drawn."""
        from rerun.components import AggregationPolicy

        channels = [self._stream.channels[i] for i in curves.columns]
        count = len(channels)
        named = f"1 {channels[0].name} to {count} {channels[-1].name}"
        entity = Entity(
            f"/rows/{scale.replace(' ', '-')}{curves.path}",
            "rows",
            f"Rows, {scale}: {named}",
            series=count,
            top=count + 1.0,
            bottom=0.8,
            component=SINGLES,
        )
        return entity, self._lines(curves, AggregationPolicy.Max)

    def norm(self, curves: Curves) -> tuple[Entity, rr.SeriesLines]:
        """Return the magnitude of axes, and how it is drawn."""
        import rerun as rr

        style = rr.SeriesLines(
            names=f"|{curves.quantity}| [{curves.unit}]",
            colors=np.array([NORM], np.uint32),
            widths=1.5,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
        )
        title = f"{self._heading(curves)} [{curves.unit}]"
        return self._entity("norm", title, curves), style

    def _heading(self, curves: Curves) -> str:
        return f"{curves.quantity.replace('_', ' ').capitalize()} {self._stream.topic}"

    def _key(self, curves: Curves) -> str:
        """Return which curve is which: in the title, where it hides no signal."""
        key = self._colours.key([self._stream.channels[i] for i in curves.columns])
        return f": {key}" if key else ""

    def _lines(self, curves: Curves, policy: AggregationPolicy) -> rr.SeriesLines:
        import rerun as rr

        channels = [self._stream.channels[i] for i in curves.columns]
        return rr.SeriesLines(
            names=[f"{c.name} [{curves.unit}]" for c in channels],
            colors=np.array([self._colours.of_channel(c) for c in channels], np.uint32),
            aggregation_policy=policy,
        )

    def _entity(self, role: Role, title: str, curves: Curves) -> Entity:
        single = enveloped(self._stream, curves.quantity)
        return Entity(
            entity_path(role, curves),
            role,
            title,
            series=len(curves.columns),
            rate_hz=self._stream.rate_hz,
            quantity=curves.quantity,
            component=SINGLES if single else "",
        )


def entity_path(role: Role, curves: Curves) -> str:
    """Return where curves are logged."""
    root = "/signals" if role == "signal" else f"/{role}"
    return root + curves.path


class Envelope:
    """Reduces blocks of a uniform stream to max |x| per bucket.

    Bucket ``k`` of a contiguous run holds samples ``[k * factor, (k + 1) * factor)`` of the run, so
    the result does not depend on how the run was cut into blocks. A bucket lies at the time of its
    first sample.

    Parameters
    ----------
    factor
        Samples per bucket.
    stream
        Of the blocks.
    columns
        Which of its channels.
    """

    def __init__(self, factor: int, stream: Stream, columns: Sequence[int]) -> None:
        self._factor = factor
        self._columns = None if len(columns) == len(stream.channels) else list(columns)
        self._scales = np.abs(stream.scales[list(columns)])
        self._anchor_ns: int | None = None
        self._period_ns = 0.0
        self._bucket = 0
        self._peak: NDArray[np.float64] | None = None

    def push(self, block: SignalBlock) -> Piece:
        """Take a block and return the buckets it completes.

        Returns
        -------
        times_ns, peaks
            Shape (m,) and (m, n_channels).
        """
        before = [] if block.anchor_ns == self._anchor_ns else [self.flush()]
        self._anchor_ns, self._period_ns = block.anchor_ns, block.stream.period_ns
        index = np.arange(
            block.first // self._factor, -(-(block.first + len(block)) // self._factor)
        )
        starts = np.maximum(index * self._factor - block.first, 0)
        # of samples as stored, as converters' integers are several times faster than their values
        samples = block.samples if self._columns is None else block.samples[:, self._columns]
        ends = (ufunc.reduceat(samples, starts, axis=0) for ufunc in (np.maximum, np.minimum))
        high, low = (np.abs(end.astype(np.float64)) for end in ends)
        peaks = np.maximum(high, low) * self._scales
        if self._peak is not None:
            if index[0] == self._bucket:
                peaks[0] = np.maximum(peaks[0], self._peak)
            else:
                before.append(self._emit(np.array([self._bucket]), self._peak[np.newaxis]))
        self._bucket, self._peak = int(index[-1]), peaks[-1]
        parts = [*before, self._emit(index[:-1], peaks[:-1])]
        filled = [p for p in parts if len(p[0])] or parts[-1:]
        return np.concatenate([p[0] for p in filled]), np.concatenate([p[1] for p in filled])

    def flush(self) -> Piece:
        """Return the last, unfinished bucket, if any."""
        if self._peak is None:
            return np.empty(0, np.int64), np.empty((0, 0))
        piece = self._emit(np.array([self._bucket]), self._peak[np.newaxis])
        self._peak = None
        return piece

    def _emit(self, bucket: NDArray[np.int64], peaks: NDArray[np.float64]) -> Piece:
        first = bucket * self._factor * self._period_ns
        return (self._anchor_ns or 0) + np.rint(first).astype(np.int64), peaks


class EnvelopeView:
    """Logs the envelope of the curves of a plot.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the curves.
    curves
        The plot.
    styles
        How it is drawn.
    role
        What it is for: ``envelope`` or ``whole``.
    bucket_s
        Length of a bucket [s].
    chunk_s
        Duration of a chunk [s].
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        curves: Curves,
        styles: CurveStyles,
        role: Role,
        bucket_s: float,
        chunk_s: float,
    ) -> None:
        self._timeline = timeline
        self.curves = curves
        self.rows: ChannelRows | None = None
        self._pending: list[Piece] = []
        self._rows = 0
        self._most = max(1, round(chunk_s / bucket_s))
        self._path = entity_path(role, curves)
        factor = max(1, round(stream.rate_hz * bucket_s))
        self._envelope = Envelope(factor, stream, curves.columns)
        timeline.declare(*styles.envelope(curves, role, bucket_s))

    def push(self, block: SignalBlock) -> None:
        """Take a block."""
        self._take(self._envelope.push(block))
        if self._rows >= self._most:
            self._log()

    def end(self, end_ns: int) -> None:
        """End the curves at an interruption: the viewer would draw a line across it."""
        self._take(self._envelope.flush())
        self._take((np.array([end_ns]), np.full((1, len(self.curves.columns)), np.nan)))

    def close(self) -> None:
        """Log what is pending and the last bucket."""
        self._take(self._envelope.flush())
        self._log()
        if self.rows is not None:
            self.rows.close()

    def _take(self, piece: Piece) -> None:
        if len(piece[0]):
            self._pending.append(piece)
            self._rows += len(piece[0])
            if self.rows is not None:
                self.rows.take(piece)

    def _log(self) -> None:
        if self._pending:
            times = np.concatenate([piece[0] for piece in self._pending])
            peaks = np.concatenate([piece[1] for piece in self._pending])
            self._timeline.singles(
                self._path, times, (peaks * self.curves.factor).astype(np.float32)
            )
        self._pending, self._rows = [], 0


#: So many channels lie on each other in one plot; so many columns are as wide as a screen. Chosen
#: by judgement.
LEAST_ROWS, MOST_COLUMNS = 5, 600
#: A row's height in distances between rows, and in how many steps it is drawn: about a pixel each.
ROW_HEIGHT, ROW_STEPS = 0.9, 32


class ChannelRows:
    """Logs a row for each of many channels: all scaled together, and each to itself.

    Rows are those of the whole recording: envelopes of so many columns as a screen has.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of the channels.
    curves
        Which of them.
    styles
        How they are drawn.
    """

    def __init__(
        self, timeline: Timeline, stream: Stream, curves: Curves, styles: CurveStyles
    ) -> None:
        self._timeline, self._stream = timeline, stream
        self._curves, self._styles = curves, styles
        self._pieces: list[Piece] = []
        self._count = 0

    @classmethod
    def of(
        cls, timeline: Timeline, stream: Stream, curves: Curves, styles: CurveStyles
    ) -> ChannelRows | None:
        """Return rows, where there are many channels."""
        many = len(curves.columns) >= LEAST_ROWS
        return cls(timeline, stream, curves, styles) if many else None

    def take(self, piece: Piece) -> None:
        """Take buckets: times, and the largest |x| of each channel."""
        self._pieces.append(piece)
        self._count += len(piece[0])
        if self._count >= 2 * MOST_COLUMNS:
            self._halve()

    def _halve(self) -> None:
        """Make one column of two."""
        times, peaks = self._joined_pieces()
        even = len(times) // 2 * 2
        halved = np.fmax(peaks[0:even:2], peaks[1:even:2])
        self._pieces = [(times[0:even:2], halved), (times[even:], peaks[even:])]
        self._count = even // 2 + len(times) - even

    def _joined_pieces(self) -> Piece:
        times = np.concatenate([piece[0] for piece in self._pieces])
        return times, np.concatenate([piece[1] for piece in self._pieces])

    def close(self) -> None:
        """Log the rows."""
        if not self._count:
            return
        times, peaks = self._joined_pieces()
        if not np.isfinite(peaks).any():
            return
        channel_peaks = np.nanmax(peaks, axis=0)
        numbers = np.arange(1.0, peaks.shape[1] + 1)
        for scale, top in (
            ("one scale", np.full_like(channel_peaks, channel_peaks.max())),
            ("each its own", channel_peaks),
        ):
            height = ROW_HEIGHT * peaks / np.where(top > 0, top, 1.0)
            rows = numbers + np.rint(height * ROW_STEPS) / ROW_STEPS
            entity, style = self._styles.rows(self._curves, scale)
            self._timeline.declare(entity, style)
            self._timeline.singles(entity.path, times, rows.astype(np.float32))
