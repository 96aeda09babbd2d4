"""Hammer shots of one line as one recording.

Shots lie in the order they were fired (acquisition time, then file name), each a contiguous run at
its own time, or laid end to end where their headers tell no different times, see
:mod:`.end_to_end`. Receivers are
named ``G01``, ``G02``, ... by place along the whole line: where the spread is moved between shots
each spread is a stream of its own, and a receiver place keeps its name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SchemaError
from ..geometry import Geometry, Sensor
from ..labels import Label
from ..signals import NS_PER_S, Channel, SignalBlock, Stream
from .api import Imported
from .end_to_end import Part, lay_out
from .mapped import sample_format

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Position = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One shot record.

    Attributes
    ----------
    name
        Of the file, without suffix.
    start_ns
        Acquisition time as the header has it (whole seconds in most files) [ns].
    rate_hz
        Sampling rate.
    delay_s
        From the shot to the first sample [s]; negative where the record starts before the shot.
    source
        Place of the shot [m], or None.
    receivers
        Places of the channels [m]; None where the header has none.
    scales_v
        Volts at the instrument's input for a sample of one; None where unknown.
    samples
        Shape (n_samples, n_channels), as recorded.
    """

    name: str
    start_ns: int
    rate_hz: float
    delay_s: float
    source: Position | None
    receivers: tuple[Position, ...] | None
    scales_v: tuple[float, ...] | None
    samples: NDArray[Any]


def lay(shots: Sequence[Shot]) -> Imported:
    """Return shots as one recording with geometry and an ``impact`` label at each time zero.

    Raises
    ------
    SchemaError
        Where the shots do not share a sampling rate, or only some have positions or scales.
    """
    shots = sorted(shots, key=lambda s: s.start_ns)  # stable: files come in natural order
    _check_one_line(shots)
    shots, starts, note = _in_time(shots)
    start_ns, rate_hz = starts[0], shots[0].rate_hz
    firsts = [round((t - start_ns) * rate_hz / NS_PER_S) for t in starts]
    names = _names(shots)
    spreads: dict[tuple[str, ...], list[int]] = {}
    for i, shot_names in enumerate(names):
        spreads.setdefault(shot_names, []).append(i)
    sources = []
    for number, (spread, members) in enumerate(spreads.items(), start=1):
        topic = "/seismic" if len(spreads) == 1 else f"/seismic/{number}"
        offsets = [firsts[i] - firsts[members[0]] for i in members]
        own = [shots[i] for i in members]
        sources.append(_spread(topic, spread, own, offsets, [starts[i] for i in members]))
    moved = f"the spread was moved: {len(spreads)} streams, receivers named by place"
    return Imported(
        sources=tuple(sources),
        start_ns=start_ns,
        geometry=_geometry(shots, names),
        labels=tuple(_impact(s, t) for s, t in zip(shots, starts, strict=True)),
        warnings=(moved,) if len(spreads) > 1 else (),
        remarks=note,
        files=tuple((s.name, t) for s, t in zip(shots, starts, strict=True)),
    )


def _check_one_line(shots: Sequence[Shot]) -> None:
    first = shots[0]
    for shot in shots[1:]:
        if shot.rate_hz != first.rate_hz:
            raise SchemaError(
                f"{shot.name}: sampling rate: expected {first.rate_hz:g} Hz as in {first.name}, "
                f"found {shot.rate_hz:g} Hz"
            )
        for what in ("receivers", "scales_v"):
            if (getattr(shot, what) is None) != (getattr(first, what) is None):
                raise SchemaError(
                    f"{shot.name}: {what}: expected in every shot or in none, as {first.name}"
                )
        if shot.receivers is None and shot.samples.shape[1] != first.samples.shape[1]:
            raise SchemaError(
                f"{shot.name}: expected {first.samples.shape[1]} channels as in {first.name}, "
                f"which have no positions to tell them by, found {shot.samples.shape[1]}"
            )


def _in_time(shots: Sequence[Shot]) -> tuple[list[Shot], list[int], tuple[str, ...]]:
    """Return the shots in order, when the first sample of each is [ns], and of several why then.

    A shot takes its time from the hammer's blow, where that comes before the first sample.
    """
    leads = [max(0, round(s.delay_s * NS_PER_S)) for s in shots]
    period_ns = NS_PER_S / shots[0].rate_hz
    parts = []
    for shot, lead_ns in zip(shots, leads, strict=True):
        # a file without a date starts at the clock's zero, its shot no earlier
        first_ns = max(shot.start_ns, lead_ns)
        end_ns = first_ns + round(len(shot.samples) * period_ns)
        parts.append(Part(shot.name, first_ns - lead_ns, end_ns))
    laid = lay_out(parts, "shots")
    starts = [t + leads[i] for i, t in zip(laid.order, laid.starts_ns, strict=True)]
    return [shots[i] for i in laid.order], starts, (laid.note,) if len(shots) > 1 else ()


def _names(shots: Sequence[Shot]) -> list[tuple[str, ...]]:
    """Return the channel names of each shot: receivers numbered by place as they first appear."""
    keys = [_keys(shot) for shot in shots]
    numbers: dict[tuple[Any, int], int] = {}
    for key in (k for shot in keys for k in shot):
        numbers.setdefault(key, len(numbers) + 1)
    width = max(2, len(str(len(numbers))))
    return [tuple(f"G{numbers[k]:0{width}d}" for k in shot) for shot in keys]


def _keys(shot: Shot) -> list[tuple[Any, int]]:
    """Return what tells receivers apart: place, and count where a place has several."""
    if shot.receivers is None:
        return [(None, i) for i in range(shot.samples.shape[1])]
    return [(p, shot.receivers[:i].count(p)) for i, p in enumerate(shot.receivers)]


def _spread(
    topic: str,
    names: tuple[str, ...],
    shots: Sequence[Shot],
    offsets: Sequence[int],
    starts: Sequence[int],
) -> Any:
    """Return the shots of one spread as a stream; gains are brought to the first shot's."""
    first = shots[0]
    scales = first.scales_v
    rows = [s.samples * (np.array(s.scales_v) / scales) if scales else s.samples for s in shots]
    name, samples = sample_format(np.concatenate(rows).astype(np.float64))
    positions = first.receivers or (None,) * len(names)
    channels = tuple(
        Channel(g, "voltage", "V", "z", scale, position)
        if scales
        else Channel(g, "seismic", "count", "z", 1.0, position)
        for g, scale, position in zip(names, scales or (1.0,) * len(names), positions, strict=True)
    )
    stream = Stream(topic, channels, first.rate_hz)
    ends = np.cumsum([len(s.samples) for s in shots]).tolist()
    blocks = [
        SignalBlock(
            stream,
            start_ns - round(offset * stream.period_ns),
            offset,
            samples[end - len(s.samples) : end],
        )
        for s, offset, start_ns, end in zip(shots, offsets, starts, ends, strict=True)
    ]
    return stream, name, blocks


def _geometry(shots: Sequence[Shot], names: Sequence[tuple[str, ...]]) -> Geometry | None:
    places: dict[str, Position] = {}
    for shot, shot_names in zip(shots, names, strict=True):
        places.update(zip(shot_names, shot.receivers or (), strict=False))
    points = tuple((s.name, s.source[0], s.source[1]) for s in shots if s.source is not None)
    if not places and not points:
        return None
    sensors = tuple(Sensor(name, name, *place) for name, place in places.items())
    return Geometry(sensors=sensors, sources=points)


def _impact(shot: Shot, first_sample_ns: int) -> Label:
    """Return the label of the shot's time zero."""
    time_ns = first_sample_ns - round(shot.delay_s * NS_PER_S)
    x, y, _ = shot.source or (None, None, None)
    return Label(time_ns, "impact", x_m=x, y_m=y, label=shot.name)
