"""What goes wrong with sensors in the field: clocks that are off, dead ones, too much gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .options import LATEST_S, refused

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.geometry import Geometry

    from .options import RoomOptions


@dataclass(frozen=True, slots=True, eq=False)
class Faults:
    """What is wrong with each channel; all shapes are (n_channels,).

    Attributes
    ----------
    offset_s
        How late the samples are stamped [s]: the channel shows at t what it felt at t - offset.
    dead
        Gives 0 all the time.
    clipped
        Has too much gain.
    """

    offset_s: NDArray[np.float64]
    dead: NDArray[np.bool_]
    clipped: NDArray[np.bool_]

    @classmethod
    def of(cls, options: RoomOptions, site: Geometry) -> Faults:
        """Return the faults of the sensors that the options name; a name stands for its station.

        Raises
        ------
        SimulationError
            Where an option names a sensor that the site does not have.
        """
        offset_s = _clocks(options, site)
        for name, value in options.clock_offset_s:
            offset_s[_channels(site, "clock offset", name)] = value
        dead, clipped = (np.zeros(len(site.sensors), np.bool_) for _ in range(2))
        for flags, option, names in (
            (dead, "dead", options.dead),
            (clipped, "clipped", options.clipped),
        ):
            for name in names:
                flags[_channels(site, option, name)] = True
        return cls(offset_s, dead, clipped)

    def described(self, site: Geometry) -> dict[str, dict[str, str]]:
        """Return the metadata of the clocks: each channel's offset [s], none where all are 0."""
        if not self.offset_s.any():
            return {}
        offsets = zip(site.sensors, self.offset_s.tolist(), strict=True)
        return {"clock_offset_s": {sensor.channel: repr(value) for sensor, value in offsets}}


def _clocks(options: RoomOptions, site: Geometry) -> NDArray[np.float64]:
    """Return the offset of each channel's clock [s]: what the geometry knows, and a random part.

    Channels of a station share the random part, which is drawn to the microsecond.
    """
    rng = np.random.default_rng([options.seed, 6])
    stations = list(dict.fromkeys(s.name for s in site.sensors))
    spread_s = np.round(rng.normal(0, options.clock_spread_s or 0.0, len(stations)), 6)
    of_station = dict(zip(stations, spread_s.tolist(), strict=True))
    offset_s = [s.clock_offset_s + of_station[s.name] for s in site.sensors]
    return np.clip(np.array(offset_s, np.float64), -LATEST_S, LATEST_S)


def _channels(site: Geometry, option: str, name: str) -> list[int]:
    found = [i for i, s in enumerate(site.sensors) if name in (s.name, s.channel)]
    if not found:
        names = ", ".join(dict.fromkeys(s.name for s in site.sensors))
        raise refused(option, f"one of {names}", repr(name))
    return found
