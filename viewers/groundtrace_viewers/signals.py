"""Signals on the timeline: every sample at full rate, and an envelope for the overview."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from .envelope import Envelope
from .palette import NORM
from .timeline import Entity

if TYPE_CHECKING:
    import rerun as rr
    from numpy.typing import NDArray
    from rerun.components import AggregationPolicy

    from groundtrace_codecs.signals import SignalBlock, Stream

    from .palette import SensorColours
    from .timeline import Timeline

Role = Literal["signal", "envelope", "norm"]

#: Above this rate the overview shows an envelope, and the samples only around the cursor.
FULL_RATE_HZ = 500.0
ENVELOPE_HZ = 100.0
#: A chunk of a fast stream lasts this long: about 2 MB, which the viewer reads best.
CHUNK_S = 1.0
SLOW_CHUNK_S = 10.0
#: Periods without samples that end a curve of a stream whose samples come at their own times.
IRREGULAR_PERIODS = 20.0

#: Units in which people read a quantity, and the factor to them; other quantities stay in theirs.
_DISPLAY = {
    ("magnetic_field", "T"): ("µT", 1e6),
    ("pressure", "Pa"): ("hPa", 1e-2),
    ("ground_velocity", "m/s"): ("µm/s", 1e6),
    ("ground_displacement", "m"): ("µm", 1e6),
    ("ground_acceleration", "m/s2"): ("mm/s²", 1e3),
    ("voltage", "V"): ("mV", 1e3),
    ("acceleration", "m/s2"): ("m/s²", 1.0),
    ("acceleration_magnitude", "m/s2"): ("m/s²", 1.0),
}


@dataclass(frozen=True, slots=True)
class Curves:
    """Columns of a stream that share a plot.

    Attributes
    ----------
    path
        Tail of the entity path, e.g. ``/imu/waist/acceleration``.
    quantity
        Quantity of all of them.
    unit
        As shown.
    columns
        Which columns of a block.
    factor
        From the channels' unit to the one shown.
    """

    path: str
    quantity: str
    unit: str
    columns: tuple[int, ...]
    factor: float


def curves_of(stream: Stream) -> tuple[Curves, ...]:
    """Split a stream into plots by quantity; one of a single seismic quantity stays whole."""
    columns: dict[tuple[str, str], list[int]] = {}
    for i, channel in enumerate(stream.channels):
        columns.setdefault((channel.quantity, channel.unit), []).append(i)
    root = "/" + stream.topic.strip("/")
    alone = len(columns) == 1 and next(iter(columns))[0] in SEISMIC_QUANTITIES
    found = []
    for (quantity, unit), where in columns.items():
        shown, factor = _DISPLAY.get((quantity, unit), (unit, 1.0))
        path = root if alone else f"{root}/{quantity}"
        found.append(Curves(path, quantity, shown, tuple(where), factor))
    return tuple(found)


def has_norm(curves: Curves) -> bool:
    """Whether curves are the axes of an acceleration, whose magnitude steps are found in."""
    return curves.quantity == "acceleration" and len(curves.columns) == 3


class SignalLog:
    """Logs the blocks of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        What the blocks hold.
    colours
        Of the sensors.
    chunk_s
        Duration of a chunk [s]; None chooses by the rate.
    """

    def __init__(
        self,
        timeline: Timeline,
        stream: Stream,
        colours: SensorColours,
        chunk_s: float | None = None,
    ) -> None:
        fast = stream.rate_hz > FULL_RATE_HZ
        seconds = chunk_s or (CHUNK_S if fast else SLOW_CHUNK_S)
        self._timeline = timeline
        self._stream = stream
        self._rows = max(1, round(seconds * stream.rate_hz))
        self._curves = curves_of(stream)
        self._envelopes = [
            Envelope(round(stream.rate_hz / ENVELOPE_HZ)) if self._has_envelope(c) else None
            for c in self._curves
        ]
        self._times: list[NDArray[np.int64]] = []
        self._values: list[NDArray[np.float64]] = []
        self._pending = 0
        self._end_ns: int | None = None
        self._patience_ns = stream.period_ns * (IRREGULAR_PERIODS if stream.irregular else 1.0)
        for curves in self._curves:
            self._declare(curves, colours)

    def _has_envelope(self, curves: Curves) -> bool:
        return self._stream.rate_hz > FULL_RATE_HZ and curves.quantity in SEISMIC_QUANTITIES

    def _declare(self, curves: Curves, colours: SensorColours) -> None:
        import rerun as rr
        from rerun.components import AggregationPolicy

        heading = f"{curves.quantity.replace('_', ' ').capitalize()} {self._stream.topic}"
        title = f"{heading} [{curves.unit}]"
        # The viewer's default policy averages minimum and maximum, which hides impacts.
        lines = self._style(curves, colours, AggregationPolicy.MinMax)
        self._timeline.declare(self._entity("signal", title, curves), lines)
        if self._has_envelope(curves):
            envelope = f"{heading}: envelope, max |x| per 10 ms [{curves.unit}]"
            lines = self._style(curves, colours, AggregationPolicy.Max)
            self._timeline.declare(self._entity("envelope", envelope, curves), lines)
        if has_norm(curves):
            style = rr.SeriesLines(
                names=f"|{curves.quantity}| [{curves.unit}]",
                colors=np.array([NORM], np.uint32),
                widths=1.5,
                aggregation_policy=AggregationPolicy.MinMax,
            )
            self._timeline.declare(self._entity("norm", title, curves), style)

    def _style(
        self, curves: Curves, colours: SensorColours, policy: AggregationPolicy
    ) -> rr.SeriesLines:
        import rerun as rr

        channels = [self._stream.channels[i] for i in curves.columns]
        return rr.SeriesLines(
            names=[f"{c.name} [{curves.unit}]" for c in channels],
            colors=np.array([colours.of_channel(c) for c in channels], np.uint32),
            aggregation_policy=policy,
        )

    def _entity(self, role: Role, title: str, curves: Curves) -> Entity:
        root = {"signal": "/signals", "envelope": "/envelope", "norm": "/norm"}[role]
        return Entity(
            root + curves.path,
            role,
            title,
            series=len(curves.columns),
            rate_hz=self._stream.rate_hz,
            quantity=curves.quantity,
        )

    def write(self, block: SignalBlock) -> None:
        """Take a block."""
        start = 0
        while start < len(block):
            stop = min(len(block), start + self._rows - self._pending)
            self._take(block.slice(start, stop))
            start = stop

    def _take(self, block: SignalBlock) -> None:
        values = block.values
        if self._end_ns is not None and block.start_ns - self._end_ns > self._patience_ns:
            self._break(self._end_ns)
        self._end_ns = block.end_ns
        self._times.append(block.sample_times())
        self._values.append(values)
        self._pending += len(block)
        for curves, envelope in zip(self._curves, self._envelopes, strict=True):
            if envelope is not None:
                self._log_envelope(curves, envelope.push(block, values[:, curves.columns]))
        if self._pending >= self._rows:
            self.flush()

    def _break(self, end_ns: int) -> None:
        """End the curves at an interruption: the viewer would draw a line across it."""
        nothing = np.full((1, len(self._stream.channels)), np.nan)
        self._times.append(np.array([end_ns]))
        self._values.append(nothing)
        self._pending += 1
        for curves, envelope in zip(self._curves, self._envelopes, strict=True):
            if envelope is not None:
                self._log_envelope(curves, envelope.flush())
                path = f"/envelope{curves.path}"
                self._timeline.scalars(path, [end_ns], nothing[:, curves.columns])

    def flush(self) -> None:
        """Log what is pending."""
        if not self._pending:
            return
        times, values = np.concatenate(self._times), np.concatenate(self._values)
        self._times, self._values, self._pending = [], [], 0
        for curves in self._curves:
            shown = values[:, curves.columns] * curves.factor
            self._timeline.scalars(f"/signals{curves.path}", times, shown)
            if has_norm(curves):
                norm = np.linalg.norm(shown, axis=1, keepdims=True)
                self._timeline.scalars(f"/norm{curves.path}", times, norm)

    def close(self) -> None:
        """Log what is pending and the envelopes' last buckets."""
        self.flush()
        for curves, envelope in zip(self._curves, self._envelopes, strict=True):
            if envelope is not None:
                self._log_envelope(curves, envelope.flush())

    def _log_envelope(
        self, curves: Curves, piece: tuple[NDArray[np.int64], NDArray[np.float64]]
    ) -> None:
        times, peaks = piece
        if len(times):
            self._timeline.scalars(f"/envelope{curves.path}", times, peaks * curves.factor)
