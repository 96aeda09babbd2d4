"""Parameters of the heading filters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ..parameters import measured


@dataclass(frozen=True, slots=True)
class HeadingParameters:
    """Parameters of :class:`~groundtrace.heading.estimator.HeadingEstimator`.

    The thresholds decide which fields the filter learns from, so that to change one is to filter
    again: none of them can be tried on stored candidates.
    """

    filter: Annotated[
        Literal["error-state", "exponential", "kalman"],
        measured("1", "How gyroscope and compass are combined."),
    ] = "error-state"
    axis: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"],
        measured("1", "Sensor axis whose horizontal direction is the heading."),
    ] = "x"
    output_hz: Annotated[float, measured("Hz", "Headings per second.", gt=0)] = 50.0
    frame_s: Annotated[float, measured("s", "Length of a frame.", ge=0.02, le=0.5)] = 0.1
    gyro_scale: Annotated[
        float,
        measured("sqrt(rad)", "Error of a turn over the square root of what was turned.", ge=0),
    ] = 0.015
    field_sigma_ut: Annotated[
        float, measured("uT", "What an undisturbed field is off by.", gt=0)
    ] = 1.0
    field_memory_s: Annotated[
        float, measured("s", "For how long it is off the same way.", gt=0)
    ] = 2.0
    drift_factor: Annotated[
        float, measured("1", "Standard deviations of drift that an azimuth may be off.", ge=0)
    ] = 2.0
    join_s: Annotated[
        float, measured("s", "Disturbances no further apart than this are one.", ge=0)
    ] = 0.1
    norm_ut: Annotated[float, measured("uT", "Most difference of the norm.", ge=0)] = 5.0
    deviation_ut: Annotated[float, measured("uT", "Most moving deviation of the norm.", ge=0)] = 5.0
    planimetric_ut: Annotated[
        float, measured("uT", "Most difference of the planimetric norm.", ge=0)
    ] = 5.0
    azimuth_deg: Annotated[
        float, measured("deg", "Most difference of the azimuths beyond the drift.", ge=0)
    ] = 15.0
    derivative_dps: Annotated[
        float, measured("deg/s", "Most difference of the azimuths' derivatives.", ge=0)
    ] = 60.0
    dip_deg: Annotated[float, measured("deg", "Most difference of the inclination.", ge=0)] = 8.0
    field_ut: Annotated[
        float, measured("uT", "Most difference of the field beyond the drift.", ge=0)
    ] = 4.5
    iron_ut: Annotated[
        float, measured("uT", "Most change of the field that turns with the sensor.", ge=0)
    ] = 2.5
