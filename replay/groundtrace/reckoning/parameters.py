"""Parameters of dead reckoning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ..parameters import Updates, gate, measured


@dataclass(frozen=True, slots=True)
class ReckoningParameters:
    """Parameters of :class:`groundtrace.reckoning.reckoner.DeadReckoner`."""

    axis: Annotated[
        Literal["", "walk", "x", "y", "z", "-x", "-y", "-z"],
        measured(
            "",
            "Sensor axis that looks ahead, or walk: the walk tells; "
            "empty: y of a phone, x of foot and wrist, walk elsewhere.",
        ),
    ] = ""
    azimuth: Annotated[
        Literal["fused", "compass", "gyroscope"],
        measured("", "What the azimuth of steps rests on."),
    ] = "fused"
    updates: Annotated[
        Updates,
        measured("", "Known places taken in: satellite fixes, two waypoints or all of them."),
    ] = "gnss"
    step_length: Annotated[
        Literal["fixed", "calibrated", "height", "weinberg", "pendulum"],
        measured("", "Model of the length of a step."),
    ] = "weinberg"
    length_m: Annotated[float, measured("m", "Of a step, model fixed.", gt=0)] = 0.65
    calibrated_m: Annotated[float, measured("m", "Distance walked to calibrate.", gt=0)] = 65.0
    calibrated_steps: Annotated[int, measured("1", "Steps it took.", gt=0)] = 100
    height_m: Annotated[float, measured("m", "Of the walker.", gt=0)] = 1.7
    height_part: Annotated[
        float, measured("1", "Part of the height that a step is, model height.", gt=0)
    ] = 0.4
    weinberg: Annotated[
        float, measured("m^(3/4) s^(1/2)", "Length over the fourth root of the swing.", gt=0)
    ] = 0.38
    pendulum: Annotated[float, measured("1", "Step over that of an inverted pendulum.", gt=0)] = (
        1.25
    )
    backward: Annotated[float, measured("1", "A step back in steps ahead.", gt=0)] = 0.7
    sideways: Annotated[float, measured("1", "A step aside in steps ahead.", gt=0)] = 0.5
    pause_s: Annotated[
        float, measured("s", "Two steps further apart are not of one walk.", gt=0)
    ] = 2.0
    mount_deg: Annotated[
        float, measured("deg", "How far the axis may look away from the way.", ge=0)
    ] = 5.0
    drift_dps: Annotated[
        float, measured("deg/s", "Bias left in the gyroscope about the vertical.", ge=0)
    ] = 0.1
    compass_deg: Annotated[
        float, measured("deg", "What an undisturbed magnetic azimuth is off by.", gt=0)
    ] = 10.0
    compass_memory_m: Annotated[
        float, measured("m", "For how far it is off the same way.", ge=0)
    ] = 3.0
    declination_deg: Annotated[
        float, measured("deg", "Of magnetic north, positive to the east of y.")
    ] = 0.0
    length_error: Annotated[float, measured("1", "Part that a single step is off by.", gt=0)] = 0.15
    scale_error: Annotated[
        float, measured("1", "Part that all lengths are off by together.", ge=0)
    ] = 0.1
    way_deg: Annotated[
        float, measured("deg", "How far a single step strays from the azimuth.", ge=0)
    ] = 6.0
    waypoint_m: Annotated[float, measured("m", "Standard deviation of a waypoint.", gt=0)] = 1.0
    gnss_m: Annotated[float, measured("m", "Standard deviation of a satellite fix.", gt=0)] = 5.0
    smooth: Annotated[bool, measured("", "Also give the track smoothed, when it ends.")] = True
    smooth_s: Annotated[
        float, measured("s", "Longest piece of a track that is smoothed at once.", gt=0)
    ] = 3600.0
    cadence_hz: Annotated[float, gate("Hz", "Most steps a second.", gt=0)] = 3.5
    speed_mps: Annotated[float, gate("m/s", "Fastest walk.", gt=0)] = 3.0
