"""Bearings: the direction of a step's wave at stations of three axes, and where bearings cross.

Source: the thesis on footstep localisation, appendix A. A Rayleigh wave, and the bending wave of a
floor, move the surface in an ellipse in the plane of the vertical and the direction of propagation:
the radial motion is a quarter period from the vertical. Two equations are corrected here:

- (A.1) has sine and cosine of the direction interchanged against (A.3), which as printed returns 90
  degrees minus the direction; here x goes with the cosine.
- (A.4) is the covariance of the real signals; there the quarter period makes vertical and radial
  motion uncorrelated, so that the azimuth of the eigenvector is noise. Here it is the covariance of
  the analytic signals, which sees the quarter period as a phase.

Unless the sense of rotation of the ellipse is known, the direction has an ambiguity of pi. Rayleigh
waves in a homogeneous ground and bending waves of a floor are retrograde.

The location where bearings cross has the least sum of distances to their lines, equations (A.10)
and (A.11), in the norms L1, which bears outliers, and L2, which averages noise: as printed, or
each distance over its own error, which grows with the way from the station.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from groundtrace_codecs.events import Bearing, Fix, Quantity, StepEvent
from groundtrace_codecs.signals import NS_PER_S, SEISMIC_QUANTITIES

from ..pipeline.buffers import KEEP_NS
from ..pipeline.gates import Candidates, Level
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Input, LocationEstimate, Memory, Stage, no_location
from .array_method import ArrayMethod, ArrayParameters, takes_steps
from .base import place_candidate

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event
    from groundtrace_codecs.geometry import Geometry
    from groundtrace_codecs.signals import Stream

    from ..pipeline.stage import Output
    from .array_method import Window

    Array = NDArray[np.float64]

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
    position: tuple[float, float]


def stations(stream: Stream, geometry: Geometry) -> tuple[Station, ...]:
    """Return the places where sensors of all three axes stand, in the geometry's order."""
    column = {c.name: i for i, c in enumerate(stream.channels)}
    return tuple(
        Station(name, (column[axes["x"]], column[axes["y"]], column[axes["z"]]), position)
        for name, (axes, position) in _triples(geometry).items()
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

    @property
    def memory(self) -> Memory:
        """The signal of a step, and the picks that are kept to look back at."""
        p = self.parameters
        return Memory(p.before_s + 2 * KEEP_NS / NS_PER_S, p.after_s)

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
            motion = polarization(signal, p.method)
            azimuth = motion.azimuth_rad + (np.pi if p.motion == "prograde" else 0.0)
            azimuth = float(np.angle(np.exp(1j * azimuth)))
            unknown = float(p.motion == "unknown")
            rows.append([motion.degree, motion.sigma_rad, azimuth, motion.ellipticity, unknown])
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
        finite = arrivals[np.isfinite(arrivals)]
        first_s = finite.min() if len(finite) else self.parameters.before_s
        return max(0, int(first_s * window.rate_hz))


Method = Literal["covariance", "surface-wave"]
#: Parts of the window that are left out one at a time, for the error of the direction. Chosen by
#: judgement: a jackknife of eight tells a deviation to about a quarter.
PARTS = 8


@dataclass(frozen=True, slots=True)
class Polarization:
    """The motion of the ground at one station.

    Attributes
    ----------
    azimuth_rad
        Towards the source of a retrograde wave, counter-clockwise from x [rad].
    sigma_rad
        Its standard deviation, by leaving out parts of the window [rad].
    degree
        Degree of polarisation: 1 for one wave, 0 for noise of three equal axes.
    ellipticity
        Radial over vertical amplitude.
    """

    azimuth_rad: float
    sigma_rad: float
    degree: float
    ellipticity: float


def analytic(values: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the analytic signals of columns, each less its mean, shape (n, 3)."""
    n = len(values)  # scipy.signal has this, but takes longer to load than a short replay
    spectrum = np.fft.fft(values - values.mean(axis=0), axis=0)
    spectrum[1 : (n + 1) // 2] *= 2.0
    spectrum[n // 2 + 1 :] = 0.0
    return np.asarray(np.fft.ifft(spectrum, axis=0))


def polarization(values: NDArray[np.float64], method: Method = "covariance") -> Polarization:
    """Return the polarisation of a window of signal.

    Parameters
    ----------
    values
        Shape (n, 3): x, y and z (up), n at least 2 * :data:`PARTS`.
    method
        ``covariance``: the eigenvector of the analytic covariance (AMC, (A.4) to (A.8)).
        ``surface-wave``: the vertical, a quarter period on, against the horizontal (AOS, (A.2)
        and (A.3)).

    Notes
    -----
    ``surface-wave`` averages out transverse (Love) waves whose frequencies differ by more than the
    inverse of the window; ``covariance`` does so only while they are the weaker motion. A
    transverse wave in step with the vertical turns both.
    """
    signal = analytic(values)
    # motion of axis i with axis j is part.T @ conj(part); the parts add up to the whole
    parts = np.array([p.T @ p.conj() for p in np.array_split(signal, PARTS)])
    total = parts.sum(axis=0)
    azimuth, radial = _direction(total, method)
    others = np.array([_direction(total - part, method)[0] for part in parts])
    turns = np.angle(np.exp(1j * (others - azimuth)))
    sigma = float(np.sqrt((PARTS - 1) / PARTS * np.sum(turns**2)))
    trace = float(np.trace(total).real)
    if trace <= 0:
        return Polarization(0.0, np.pi, 0.0, 0.0)
    squares = float(np.trace(total @ total).real)
    degree = float(np.sqrt(max((3 * squares / trace**2 - 1) / 2, 0.0)))
    vertical = float(np.sqrt(total[2, 2].real))
    return Polarization(azimuth, sigma, degree, radial / vertical if vertical > 0 else np.inf)


def _direction(covariance: NDArray[np.complex128], method: Method) -> tuple[float, float]:
    """Return the azimuth of a retrograde wave's source, and the radial amplitude.

    Up is cos(w t) and away from the source -sin(w t), whose analytic signal is i exp(i w t): so
    with the vertical's phase taken off, the imaginary part points away from the source.
    """
    if method == "surface-wave":
        away = covariance[:2, 2].imag
        scale = max(float(covariance[2, 2].real), np.finfo(float).tiny)
        return float(np.arctan2(-away[1], -away[0])), float(np.hypot(*away) / np.sqrt(scale))
    values, vectors = np.linalg.eigh(covariance)
    main = vectors[:, -1] * np.sqrt(max(values[-1], 0.0))
    away = (main[:2] * np.exp(-1j * np.angle(main[2]))).imag
    return float(np.arctan2(-away[1], -away[0])), float(np.hypot(*away))


Norm = Literal["l1", "l2"]
Weights = Literal["errors", "none"]
#: Reweightings of crossing lines at most. Chosen by judgement: they settle in fewer.
PASSES = 30
#: Lines whose directions differ by less cross nowhere in particular: a condition number. Chosen by
#: judgement: lines within about a degree of each other.
MAX_CONDITION = 1e4
#: Distances below count as this one in the weights [m]. Chosen by judgement: nobody stands nearer
#: to a sensor than its own size.
LEAST_M = 1e-3


def intersect(
    positions: Array,
    azimuths_rad: Array,
    sigmas_rad: Array,
    norm: Norm,
    weights: Weights = "errors",
) -> LocationEstimate:
    """Return the place nearest to all bearings.

    Parameters
    ----------
    positions
        Shape (n, 2): stations [m].
    azimuths_rad
        Shape (n,): bearings [rad]; NaN where a station has none. The sense along the line does
        not matter, so that an ambiguity of pi does no harm.
    sigmas_rad
        Shape (n,): their standard deviations [rad].
    norm
        ``l1`` or ``l2`` of the distances to the lines.
    weights
        ``errors``: each distance over its own error; ``none``: as (A.10) is printed.

    Returns
    -------
    The place, with the covariance by the bearings' errors there, larger where three or more
    miss each other by more than these, and as residual the root mean square of what the bearings
    are off [rad]. Nowhere with fewer than two bearings, or parallel.
    """
    valid = np.isfinite(azimuths_rad)
    count = int(valid.sum())
    if count < 2:
        return no_location(count)
    stations, azimuths = positions[valid], azimuths_rad[valid]
    sigmas = np.maximum(sigmas_rad[valid], 1e-3)
    normals = np.stack([-np.sin(azimuths), np.cos(azimuths)], axis=1)
    offsets = np.sum(normals * stations, axis=1)
    if np.linalg.cond(normals.T @ normals) > MAX_CONDITION:
        return no_location(count)
    position = np.linalg.lstsq(normals, offsets, rcond=None)[0]
    for _ in range(PASSES):
        errors = np.ones(count) if weights == "none" else _across(sigmas, stations, position)
        weight = 1 / errors**2
        if norm == "l1":
            weight /= np.maximum(np.abs(normals @ position - offsets) / errors, 1e-6)
        information = normals.T @ (normals * weight[:, None])
        moved = np.linalg.solve(information, normals.T @ (weight * offsets))
        if np.hypot(*(moved - position)) < LEAST_M:
            break
        position = moved
    errors = _across(sigmas, stations, position)
    if weights == "errors":  # the least that lines with such errors allow, whatever the norm
        weight = 1 / errors**2
        information = normals.T @ (normals * weight[:, None])
    gain = np.asarray(np.linalg.solve(information, normals.T * weight))
    return _located(position, stations, normals, errors, gain)


def _across(sigmas: Array, stations: Array, position: Array) -> Array:
    """Return the errors of the distances of lines from a place, shape (n,) [m]."""
    errors: Array = sigmas * np.maximum(np.hypot(*(stations - position).T), LEAST_M)
    return errors


def _located(
    position: Array, stations: Array, normals: Array, errors: Array, gain: Array
) -> LocationEstimate:
    """Return a place whose lines have such errors across, which the gain takes to the place."""
    away = position - stations
    covariance = (gain * errors**2) @ gain.T
    left = np.eye(len(stations)) - normals @ gain
    expected = float(np.sum((left * errors) ** 2 / errors[:, None] ** 2))
    across = np.sum(normals * away, axis=1)
    if len(stations) > 2:  # lines that miss each other by more than they claim
        covariance *= max(1.0, float(np.sum((across / errors) ** 2)) / expected)
    along = np.abs(away[:, 0] * normals[:, 1] - away[:, 1] * normals[:, 0])
    off = np.arctan2(np.abs(across), along)
    residual = float(np.sqrt(np.mean(off**2)))
    return LocationEstimate(
        float(position[0]), float(position[1]), covariance, residual, len(stations)
    )


@dataclass(frozen=True, slots=True)
class CrossingParameters:
    """Parameters of :class:`Crossing`."""

    norm: Annotated[Norm, measured("", "l1 bears outlying bearings, l2 averages noise.")] = "l1"
    weights: Annotated[
        Weights, measured("", "Each distance over its own error, or none, as (A.10) is printed.")
    ] = "errors"
    min_bearings: Annotated[int, gate("1", "Least number of bearings.", ge=2)] = 2
    max_residual_rad: Annotated[
        float, gate("rad", "Largest root mean square that bearings are off.", gt=0)
    ] = 0.5


class Crossing(Stage):
    """The place that a step's bearings point to."""

    Parameters = CrossingParameters
    takes = (Input(Bearing), Input(StepEvent))
    gives = (Fix,)
    scope = "recording"
    ends_at = "clock step"
    columns = (
        Quantity("bearings", "1"),
        Quantity("residual", "rad"),
        Quantity("x", "m"),
        Quantity("y", "m"),
        Quantity("sigma", "m"),
    )
    gates = (
        Level("bearings", "1", "min_bearings"),
        Level("residual", "rad", "max_residual_rad", at_least=False),
    )

    def __init__(self, parameters: CrossingParameters) -> None:
        self.parameters = parameters
        self._latest: dict[str, Bearing] = {}

    @property
    def memory(self) -> Memory:
        """The bearings of one step, which have one time."""
        return Memory(0.0, 0.0)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with the stations that give bearings, and none of these."""
        self._context = context
        self._stations = placed(context.source.channels, context.geometry)
        self._latest.clear()
        return ("all",)

    def process(self, item: Bearing | StepEvent) -> Iterator[Output]:
        """Gather the latest bearing of each station; cross those at the very time of a step."""
        if isinstance(item, Bearing):
            self._latest[item.station] = item
            return
        bearings = [
            b
            for b in self._latest.values()
            if b.time_ns == item.time_ns and b.station in self._stations
        ]
        places = np.array([self._stations[b.station] for b in bearings], np.float64).reshape(-1, 2)
        azimuths = np.array([b.azimuth_rad for b in bearings], np.float64)
        sigmas = np.array([b.sigma_rad for b in bearings], np.float64)
        self._latest_estimate = item.time_ns, self.locate(places, azimuths, sigmas)
        yield place_candidate(*self._latest_estimate)

    def decided(self, block: CandidateBlock) -> Iterator[Event]:
        """Yield the place just found where it counts."""
        if block.accepted[0]:
            time_ns, location = self._latest_estimate
            yield location.fix(time_ns, self._context.plugin, self._context.stage)

    def locate(self, stations: Array, azimuths_rad: Array, sigmas_rad: Array) -> LocationEstimate:
        """Return the place for bearings, shapes (n, 2), (n,) and (n,)."""
        p = self.parameters
        return intersect(stations, azimuths_rad, sigmas_rad, p.norm, p.weights)
