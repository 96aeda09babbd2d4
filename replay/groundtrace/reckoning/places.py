"""Known places: waypoints and satellite fixes, in metres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.earth import metres_per_radian

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.labels import Label
    from groundtrace_codecs.signals import SignalBlock, Stream


@dataclass(frozen=True, slots=True)
class KnownPlace:
    """Where the walker was at a time: ``x_m`` to the east, ``y_m`` to the north [m]."""

    time_ns: int
    x_m: float
    y_m: float
    sigma_m: float


def waypoints_of(labels: Sequence[Label], sigma_m: float) -> list[KnownPlace]:
    """Return the waypoints that a reckoning is given as known places."""
    return [
        KnownPlace(x.time_ns, x.x_m, x.y_m, sigma_m)
        for x in labels
        if x.x_m is not None and x.y_m is not None
    ]


@dataclass(slots=True)
class TangentPlane:
    """Turns latitude and longitude into metres east and north of the first fix.

    Attributes
    ----------
    at
        Where the first fix lies on the map [m].
    origin
        Its latitude and longitude [rad]; None before.
    """

    at: tuple[float, float] = (0.0, 0.0)
    origin: tuple[float, float] | None = None

    def place(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Return the place of a fix on the map [m]; angles in rad."""
        if self.origin is None:
            self.origin = (latitude, longitude)
        start, meridian = self.origin
        across, along = metres_per_radian(start)
        turned = (longitude - meridian + math.pi) % (2 * math.pi) - math.pi
        return self.at[0] + across * turned, self.at[1] + along * (latitude - start)

    def position(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return latitude and longitude of a place on the map [rad]; the first fix comes before.

        Raises
        ------
        ValueError
            Before the first fix.
        """
        if self.origin is None:
            raise ValueError("plane: expected a first fix, found none")
        start, meridian = self.origin
        across, along = metres_per_radian(start)
        return start + (y_m - self.at[1]) / along, meridian + (x_m - self.at[0]) / across


def satellite_columns(stream: Stream) -> tuple[int, int] | None:
    """Return the columns of latitude and longitude, or None."""
    found = [stream.columns_of({name}) for name in ("latitude", "longitude")]
    return (found[0][0], found[1][0]) if all(found) else None


def satellite_fixes(block: SignalBlock, plane: TangentPlane, sigma_m: float) -> list[KnownPlace]:
    """Return the finite fixes of a block of degrees."""
    columns = satellite_columns(block.stream)
    if columns is None:
        return []
    degrees = np.radians(block.values[:, list(columns)])
    times = block.sample_times().tolist()
    return [
        KnownPlace(time_ns, *plane.place(float(lat), float(lon)), sigma_m)
        for time_ns, (lat, lon) in zip(times, degrees, strict=True)
        if math.isfinite(lat + lon)
    ]
