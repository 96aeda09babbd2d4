"""Stations of three axes: at each step the ground's motion, and where its wave came from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from groundtrace.direction.bearings import stations
from groundtrace.direction.polarization import PARTS, polarization
from groundtrace_codecs.signals import NS_PER_S

from .bearings import BearingLog
from .excerpts import Excerpts
from .hodogram import LENGTH_S, HodogramLog

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Bearing, Pick
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .excerpts import Piece
    from .palette import SensorColours
    from .timeline import Timeline

#: Arrivals of a step come at most this long after it [s].
LATEST_S = 0.05
#: Bearings of so many steps wait for their step's signal.
MOST_STEPS = 64


class StationViews:
    """Logs hodograms and bearings of the stations of one stream.

    Parameters
    ----------
    timeline
        Where to.
    stream
        Of their channels.
    geometry
        Where they stand.
    colours
        Of the sensors; a station has its vertical channel's.
    """

    def __init__(
        self, timeline: Timeline, stream: Stream, geometry: Geometry, colours: SensorColours
    ) -> None:
        self._stations = stations(stream, geometry)
        self._columns = [column for s in self._stations for column in s.columns]
        self._channels = [
            tuple(stream.channels[column].name for column in s.columns) for s in self._stations
        ]
        names = [s.name for s in self._stations]
        shades = [colours.of(channels[2]) for channels in self._channels]
        places = {s.name: s.place for s in self._stations}
        known = np.array([*((s.x, s.y) for s in geometry.sensors), *geometry.outline])
        box = np.stack([known.min(axis=0), known.max(axis=0)])
        self._hodograms = HodogramLog(timeline, names, shades)
        self._rays = BearingLog(timeline, places, dict(zip(names, shades, strict=True)), box)
        self._excerpts = Excerpts(0.0, LATEST_S + LENGTH_S)
        self._bearings: dict[int, dict[str, Bearing]] = {}

    @staticmethod
    def fits(stream: Stream, geometry: Geometry) -> bool:
        """Whether a stream has stations of three axes."""
        return bool(stations(stream, geometry))

    def signal(self, block: SignalBlock) -> None:
        """Take a block."""
        if len(block):
            self._excerpts.push(block.sample_times(), block.select(self._columns).values)

    def expect(self, time_ns: int) -> None:
        """Take an arrival, which may become a step."""
        self._excerpts.expect(time_ns)

    def bearing(self, bearing: Bearing) -> None:
        """Take a bearing."""
        self._bearings.setdefault(bearing.time_ns, {})[bearing.station] = bearing
        while len(self._bearings) > MOST_STEPS:
            self._bearings.pop(min(self._bearings))

    def step(self, time_ns: int, picks: Sequence[Pick]) -> None:
        """Show a step."""
        found = self._bearings.pop(time_ns, {})
        self._rays.step(time_ns, found)
        piece = self._excerpts.around(time_ns)
        if piece is None:
            return
        moved = {}
        for index, station in enumerate(self._stations):
            own = [p.time_ns for p in picks if p.channel in self._channels[index]]
            values = _from(piece, min(own, default=time_ns), index)
            if len(values) < 2 * PARTS or not np.ptp(values, axis=0).all():
                continue
            known = found.get(station.name)
            azimuth = known.azimuth_rad if known else polarization(values).azimuth_rad
            moved[index] = values, azimuth
        self._hodograms.step(time_ns, moved)

    def flush(self) -> None:
        """Log what is pending."""
        self._hodograms.flush()
        self._rays.flush()

    def clear(self, time_ns: int) -> None:
        """Show no bearings any more."""
        self._rays.clear(time_ns)


def _from(piece: Piece, start_ns: int, index: int) -> NDArray[np.float64]:
    """Return the motion of a station from a time on, shape (n, 3)."""
    times, values = piece
    end_ns = start_ns + round(LENGTH_S * NS_PER_S)
    first, last = np.searchsorted(times, [start_ns, end_ns])
    return values[first:last, 3 * index : 3 * index + 3].astype(np.float64)
