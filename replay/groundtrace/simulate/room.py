"""People walking on a concrete floor under seismic sensors.

The floor is the plate of :mod:`.plate`, a step the force of :mod:`.footfall`: waves are dispersive;
:mod:`.walls` sends them back. Without options one person walks a U through a room of 5.4 m x 5.4 m,
the size of the thesis's test room (section 6.2), to and fro, at 0.5 to 0.6 s a step, and the floor
has no end.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import Channel, Stream

from .drawing import drawn
from .faults import Faults
from .floor import Floor, extent_m
from .options import RoomOptions
from .room_signal import Channels, RoomSignal, Wavefield, synthesis_of
from .room_truth import labels_of
from .sensors import Mounting, site_of, stations_of
from .simulation import Simulation, described
from .walkers import course_of
from .walls import Walls

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .walkers import Strike

_NOISE_COUNTS = 4.0  # of the digitiser: real noise, yet half of every sample compresses away
#: A step beside a sensor reaches 1.8 times the peak at 1 m, a wall or a mounting adds to it: the
#: digitiser's range is this many times the peak.
_HEADROOM, _RESONANT = 2.5, 3.0
_CLIPPED_AT = 0.5  # of the median strike's peak: where a channel with too much gain clips


def simulate_room(options: RoomOptions | None = None) -> Simulation:
    """Simulate a walk through the room, two walks that cross, or single impacts.

    The truth: ``step`` with place and foot at each heel's contact, or ``impact`` with its place;
    ``pick`` per strike and channel at the arrival by :class:`.footfall.ArrivalLaw`, as late as the
    channel's clock, none where the channel is dead; and one ``walking`` span per walker. Where two
    walk, ``target`` of each label says who. The metadata record ``clock_offset_s`` holds clocks
    that are off.

    Raises
    ------
    SimulationError
        Where an option is out of its range, people cannot walk within the outline, or the steps do
        not fit in the duration.
    """
    options = options or RoomOptions()
    options.check()
    if options.random:
        options = drawn(options)
    site = site_of(options)
    floor, faults = Floor.of(options, site), Faults.of(options, site)
    course = course_of(options, site.outline, floor.shoes)
    site = replace(site, start=course.start, medium=floor.medium)
    field = _field(options, site, floor, faults)
    peak_mps = floor.laws[0].peak_mps
    sigma_mps = peak_mps / options.snr
    scale = max(sigma_mps / _NOISE_COUNTS, _headroom(options) * peak_mps / 32767)
    scales = np.full(len(site.sensors), scale)
    if faults.clipped.any():
        scales[faults.clipped] = _clipping(field, course.strikes)[faults.clipped]
    channels = tuple(
        Channel(s.channel, "ground_velocity", "m/s", s.axis, float(per_count), (s.x, s.y, s.z))
        for s, per_count in zip(site.sensors, scales, strict=True)
    )
    stream = Stream("/seismic", channels, options.rate_hz)
    signal = RoomSignal(
        stream, options.seed, course.duration_s, course.strikes, field, sigma_mps, faults.dead
    )
    said = replace(options, geometry=None, channels=len(field.channels.stations))
    return Simulation(
        sources=[(stream, "i16le", signal)],
        geometry=site,
        labels=labels_of(course.strikes, site, floor, faults),
        metadata=described("room", said) | faults.described(site),
    )


def _field(options: RoomOptions, site: Geometry, floor: Floor, faults: Faults) -> Wavefield:
    stations, station = stations_of(site)
    axes = tuple(s.axis for s in site.sensors)
    channels = Channels(stations, station, axes, faults.offset_s)
    corners = np.array(list(dict.fromkeys(site.outline)), np.float64)
    walls = Walls(corners, options.walls or 0.0)
    farthest = 1 if not walls.reflection else 3 if walls.rectangular else 2
    spread_s = float(np.ptp(faults.offset_s))
    reach_m = farthest * extent_m(site)
    synthesis = synthesis_of(floor.plate, options.rate_hz, reach_m, spread_s)
    mounting = None
    if options.resonances:
        mounting = Mounting.drawn(len(stations), options.seed).response(synthesis.frequency_hz)
    return Wavefield(synthesis, channels, walls, mounting)


def _headroom(options: RoomOptions) -> float:
    """Return full scale over the peak of a mean step at 1 m: no channel clips by itself."""
    corner = (1 + (options.walls or 0.0)) ** 2  # of two walls
    return _HEADROOM * corner * (_RESONANT if options.resonances else 1.0)


def _clipping(field: Wavefield, strikes: Sequence[Strike]) -> NDArray[np.float64]:
    """Return for each channel the scale with which most strikes clip, shape (n_channels,)."""
    some = strikes[:: max(len(strikes) // 20, 1)]
    peaks = [np.abs(field.waves(strike)).max(axis=0) for strike in some]
    scale: NDArray[np.float64] = _CLIPPED_AT * np.median(peaks, axis=0) / 32767
    return scale
