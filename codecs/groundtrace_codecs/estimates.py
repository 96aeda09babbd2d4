"""Estimates: events that say where and whereto: fixes, tracks, headings, disturbances."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Fix:
    """A place found for one moment.

    Attributes
    ----------
    time_ns, x_m, y_m
        When and where.
    covariance
        (xx, xy, yy) of the place [m^2]; NaN where unknown.
    residual
        What the method leaves unexplained, in its own unit; NaN where it has none.
    method, picks, stage
        How it was found, from how many arrivals, and the stage that found it.
    """

    time_ns: int
    x_m: float
    y_m: float
    covariance: tuple[float, float, float]
    residual: float
    method: str
    picks: int
    stage: str


#: What the name of a stage gets appended for its smoothed tracks.
SMOOTHED = ".smoothed"


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """Where a tracked target is at one moment.

    Attributes
    ----------
    time_ns, track
        When, and the number of the track.
    x_m, y_m, vx_mps, vy_mps, covariance
        Place, velocity, and (xx, xy, yy) of the place [m^2]; NaN where unknown.
    stage
        The stage that tracks.
    nis
        Normalised innovation squared of the update (2 degrees of freedom); NaN without an update.
    """

    time_ns: int
    track: int
    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    covariance: tuple[float, float, float]
    stage: str
    nis: float = float("nan")


@dataclass(frozen=True, slots=True)
class Heading:
    """A direction [rad] and its standard deviation [rad; NaN where unknown] at one moment."""

    time_ns: int
    heading_rad: float
    sigma_rad: float
    stage: str


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A half-open span [ns] in which a sensor is disturbed; ``value`` says how much."""

    time_ns: int
    end_ns: int
    value: float
    stage: str


@dataclass(frozen=True, slots=True)
class Bearing:
    """The direction that a wave came from, at one station.

    Attributes
    ----------
    time_ns, station
        When, and the name of the station of three axes.
    azimuth_rad
        From the station towards the source, counter-clockwise from x [rad].
    sigma_rad
        One standard deviation [rad]; NaN where unknown.
    value
        What the method's decision rests on, e.g. the degree of polarisation.
    ambiguous
        True where the direction is an axis: the source may as well lie at ``azimuth_rad + pi``.
    stage
        The stage that found it.
    """

    time_ns: int
    station: str
    azimuth_rad: float
    sigma_rad: float
    value: float
    ambiguous: bool
    stage: str


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Localizers that place one step apart.

    Attributes
    ----------
    time_ns
        The step's.
    distance_m
        Between the two places that are farthest apart for their uncertainty [m].
    value
        That distance in standard deviations.
    methods
        The two stages, as ``one, other``.
    stage
        The stage that compares.
    """

    time_ns: int
    distance_m: float
    value: float
    methods: str
    stage: str
