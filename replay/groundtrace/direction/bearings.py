"""Bearings: at every station of three axes, where a step's wave comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from groundtrace_codecs.events import Bearing, Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES

from ..array_method import ArrayMethod, ArrayParameters, takes_steps
from ..gates import Candidates, Level
from ..parameters import gate, measured
from .polarization import PARTS, Method, polarization

if TYPE_CHECKING:
    from collections.abc import Sequence

    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..array_method import Window

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class BearingsParameters(ArrayParameters):
    """Parameters of :class:`Bearings`."""

    method: Annotated[
        Method, measured("", "Eigenvector of the analytic covariance, or quarter-period shift.")
    ] = "covariance"
    motion: Annotated[
        Literal["retrograde", "prograde", "unknown"],
        measured("", "Which way round the ground moves; unknown leaves an ambiguity of pi."),
    ] = "retrograde"
    length_s: Annotated[
        float, measured("s", "Signal used from a station's first arrival on.", gt=0)
    ] = 0.02
    min_degree: Annotated[float, gate("1", "Least degree of polarisation.", ge=0, le=1)] = 0.6
    max_sigma_rad: Annotated[float, gate("rad", "Largest error of a bearing.", gt=0)] = 0.5


@dataclass(frozen=True, slots=True)
class Station:
    """Three channels at one place [m]: their columns in the order x, y, z."""

    name: str
    columns: tuple[int, int, int]
    place: tuple[float, float]


def stations(stream: Stream, geometry: Geometry) -> tuple[Station, ...]:
    """Return the places where sensors of all three axes stand, in the geometry's order."""
    column = {c.name: i for i, c in enumerate(stream.channels)}
    return tuple(
        Station(name, (column[axes["x"]], column[axes["y"]], column[axes["z"]]), place)
        for name, (axes, place) in _triples(geometry).items()
        if all(axes[axis] in column for axis in AXES)
    )


def placed(names: Sequence[str], geometry: Geometry) -> dict[str, tuple[float, float]]:
    """Return where the stations of some names stand [m]."""
    return {name: at for name, (_, at) in _triples(geometry).items() if name in names}


def _triples(geometry: Geometry) -> dict[str, tuple[dict[str, str], tuple[float, float]]]:
    """Return channel by axis, and place, of the stations of three axes, by name."""
    places: dict[tuple[float, float, float], dict[str, str]] = {}
    for sensor in geometry.sensors:
        places.setdefault((sensor.x, sensor.y, sensor.z), {})[sensor.axis] = sensor.channel
    return {
        _name(axes): (axes, (x, y)) for (x, y, _), axes in places.items() if set(AXES) <= set(axes)
    }


def _name(axes: dict[str, str]) -> str:
    """Return what the names of a station's channels begin with, else the vertical's name."""
    vertical = axes["z"]
    stem = vertical[:-1].rstrip("_-.")
    return stem if stem and all(name.startswith(stem) for name in axes.values()) else vertical


class Bearings(ArrayMethod):
    """Directions of arrival by polarisation, one candidate a station and step."""

    Parameters = BearingsParameters
    takes = takes_steps(SEISMIC_QUANTITIES)
    needs = "stations of three axes in the geometry"
    gives = (Bearing,)
    columns = (
        Quantity("degree", "1"),
        Quantity("sigma", "rad"),
        Quantity("azimuth", "rad"),
        Quantity("ellipticity", "1"),
        Quantity("ambiguous", "1"),
    )
    gates = (
        Level("degree", "1", "min_degree"),
        Level("sigma", "rad", "max_sigma_rad", at_least=False),
    )

    def __init__(self, parameters: BearingsParameters) -> None:
        self.parameters = parameters
        self.stations: tuple[Station, ...] = ()

    def prepare(self, stream: Stream, geometry: Geometry) -> tuple[str, ...]:
        """Find the stations; there are none where no place has all three axes."""
        self.stations = stations(stream, geometry)
        return tuple(station.name for station in self.stations)

    def examine(self, window: Window) -> Candidates:
        """Return a candidate for each station with enough signal."""
        p = self.parameters
        rows, channels = [], []
        for index, station in enumerate(self.stations):
            signal = window.values[self._from(window, station) :, list(station.columns)]
            signal = signal[: max(round(p.length_s * window.rate_hz), 2 * PARTS)]
            if len(signal) < 2 * PARTS or not np.ptp(signal, axis=0).all():
                continue
            found = polarization(signal, p.method)
            azimuth = found.azimuth_rad + (np.pi if p.motion == "prograde" else 0.0)
            azimuth = float(np.angle(np.exp(1j * azimuth)))
            unknown = float(p.motion == "unknown")
            rows.append([found.degree, found.sigma_rad, azimuth, found.ellipticity, unknown])
            channels.append(index)
        count = len(rows)
        return Candidates(
            np.full(count, window.step_ns, np.int64),
            np.array(channels, np.int32),
            np.array(rows, np.float32).reshape(count, len(self.columns)),
        )

    def _from(self, window: Window, station: Station) -> int:
        """Return the sample of a station's first arrival; of the step's where it has none."""
        arrivals = window.arrivals_s[list(station.columns)]
        known = arrivals[np.isfinite(arrivals)]
        first_s = known.min() if len(known) else self.parameters.before_s
        return max(0, int(first_s * window.rate_hz))
