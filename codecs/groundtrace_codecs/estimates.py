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
