"""Samples with times of their own, as files of loggers and phones hold them, become streams."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FormatError
from ..mcap.set_backs import set_backs
from ..signals import NS_PER_S, Channel, Stream
from . import grid
from .api import Imported
from .mapped import sample_format

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..geometry import Geometry
    from ..labels import Label
    from .api import Source

#: Times further from the epoch than this are no times [ns].
MAX_NS = 2**62


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Samples of one stream in the order of the file.

    Attributes
    ----------
    topic, placement, channels
        Of the stream.
    times_ns
        Shape (n,), int64: any order, repeats allowed.
    values
        Shape (n, n_channels), as the channels' scales take them.
    """

    topic: str
    placement: str
    channels: tuple[Channel, ...]
    times_ns: NDArray[np.int64]
    values: NDArray[np.float64]


def in_order(sampled: Sampled) -> tuple[Sampled, tuple[str, ...]]:
    """Return the samples by time without repeats, and a line for each thing that took.

    Samples that came late are put where their time says, but those after a clock was set back, of
    which the order of the file tells. Of samples with one time and the same values one is kept;
    with other values all are, for which is right is not known here.
    """
    times, values = sampled.times_ns, sampled.values
    set_back = set_backs(times)
    remarks = [f"{sampled.topic}: {line}" for line in grid.set_back_lines(set_back)]
    on = times + grid.earlier_by(set_back, len(times))
    late = int((np.diff(on) < 0).sum())
    if late:
        worst_s = float((np.maximum.accumulate(on) - on).max()) / NS_PER_S
        remarks.append(
            f"{sampled.topic}: {late} times go back, by up to {worst_s:g} s: sorted by time"
        )
        order = np.argsort(on, kind="stable")
        times, values = times[order], values[order]
    same = np.diff(times) == 0
    if same.any():
        alike = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        copies = same & alike.all(axis=1)
        kept = np.concatenate(([True], ~copies))
        times, values = times[kept], values[kept]
        if copies.any():
            remarks.append(f"{sampled.topic}: {int(copies.sum())} samples come twice: one kept")
        if others := int(same.sum() - copies.sum()):
            remarks.append(f"{sampled.topic}: {others} samples are not later than the one before")
    return replace(sampled, times_ns=times, values=values), tuple(remarks)


def together(
    found: Sequence[Sampled],
    *,
    geometry: Geometry | None = None,
    labels: tuple[Label, ...] = (),
    warnings: tuple[str, ...] = (),
) -> Imported:
    """Return streams as one import, on one clock that starts no earlier than zero.

    Parameters
    ----------
    found
        At least one stream, each with at least one sample.
    geometry, labels, warnings
        As in :class:`~groundtrace_codecs.importers.api.Imported`.

    Raises
    ------
    FormatError
        Where a time is out of the range of times.
    """
    for each in found:
        if np.abs(each.times_ns).max() > MAX_NS:
            raise FormatError(f"{each.topic}: expected times within 146 years, found others")
    ordered = [in_order(each) for each in found]
    remarks = [line for _, lines in ordered for line in lines]
    earliest = min(int(each.times_ns.min()) for each, _ in ordered)
    shift_ns = max(0, -earliest)
    if shift_ns:
        remarks.append(f"times start {shift_ns} ns before the clock's zero: shifted to zero")
    return Imported(
        sources=tuple(_source(each, shift_ns) for each, _ in ordered),
        start_ns=earliest + shift_ns,
        geometry=geometry,
        labels=labels,
        warnings=(*warnings, *remarks),
    )


def _source(sampled: Sampled, shift_ns: int) -> Source:
    times = sampled.times_ns + shift_ns
    timing = grid.fit(times) if np.ptp(times) > 0 else _moment(times)
    stream = Stream(
        sampled.topic, sampled.channels, timing.rate_hz, sampled.placement, timing.index is None
    )
    form, samples = sample_format(sampled.values)
    return stream, form, timing.blocks(stream, samples)


def _moment(times_ns: NDArray[np.int64]) -> grid.Timing:
    """Return the timing of samples all of one time, such as a single fix."""
    return grid.Timing(1.0, int(times_ns[0]), None, times_ns)
