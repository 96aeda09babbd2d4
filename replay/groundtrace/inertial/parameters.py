"""Parameters of the navigator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ..parameters import gate, measured


@dataclass(frozen=True, slots=True)
class FootNavigatorParameters:
    """Parameters of :class:`groundtrace.inertial.navigator.FootNavigator`."""

    window_s: Annotated[float, measured("s", "Length of the statistic's window.", gt=0)] = 0.05
    acceleration_sigma: Annotated[
        float, measured("m/s2", "Off gravity by this, the statistic is 1.", gt=0)
    ] = 1.7
    rotation_sigma: Annotated[
        float, measured("rad/s", "Turning by this, the statistic is 1.", gt=0)
    ] = 0.3
    sure: Annotated[
        float, measured("1", "The foot stands where the statistic is at most this.", gt=0)
    ] = 2.0
    share: Annotated[
        float, measured("1", "Or at most this part of its largest in the last stride.", ge=0, lt=1)
    ] = 0.03
    stride_s: Annotated[float, measured("s", "A stride takes at most so long.", gt=0)] = 1.5
    align_s: Annotated[
        float, measured("s", "Standing so long is enough to level the sensor.", gt=0)
    ] = 0.1
    sole_m: Annotated[
        float, measured("m", "Height of the sensor over what the foot rolls on.", ge=0)
    ] = 0.1
    still_mps: Annotated[float, measured("m/s", "Speed of a foot that stands.", gt=0)] = 0.01
    still_radps: Annotated[float, measured("rad/s", "Turning of a foot at rest.", gt=0)] = 0.005
    rest_s: Annotated[
        float, measured("s", "A foot that has stood so long is at rest and does not turn.", ge=0)
    ] = 0.5
    lost_s: Annotated[
        float, measured("s", "A foot under way for so long has a velocity that is wrong.", gt=0)
    ] = 2.0
    magnetometer: Annotated[
        bool, measured("", "Hold the heading by the field where it is that of the start.")
    ] = False
    point_s: Annotated[float, measured("s", "Time between points of the track.", gt=0)] = 0.1
    smooth: Annotated[bool, measured("", "Also give the track smoothed, when it ends.")] = True
    smooth_s: Annotated[
        float, measured("s", "Longest piece of a track that is smoothed at once.", gt=0)
    ] = 600.0
    stillness: Annotated[float, gate("1", "Least stillness of a stance.", ge=0, le=1)] = 0.01
    max_distance: Annotated[
        float, gate("1", "Largest Mahalanobis distance of the velocity from zero.", gt=0)
    ] = 7.0
    max_speed_mps: Annotated[
        float, gate("m/s", "Fastest that a foot may seem to move that stands.", gt=0)
    ] = 1.5
