"""Axes of a worn sensor: the walking axis by the spread of the horizontal acceleration, its sign.

The body swings forward and back at every step and from side to side only once a stride, so that the
first principal axis of the horizontal acceleration is the walking axis (Steinhoff and Schiele,
IPIN 2010). Its sign: while the body rises from its lowest point, at mid double support, to
mid stance it is slowed down, and it is driven on while it falls. So forward acceleration lags the
upward one by a quarter of a step: upward velocity and forward acceleration have opposite signs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .rotations import Array


@dataclass(frozen=True, slots=True)
class WalkingAxis:
    """The direction of walking against the earth frame that the accelerations were given in.

    Attributes
    ----------
    heading_rad
        Direction of the walking axis, forward, counter-clockwise from the frame's x [rad].
    prominence
        1 - (second / first principal variance): 0 where no axis stands out.
    sign_ratio
        Correlation that chose the sign, in [-1, 1]; near 0 the sign is a guess.
    """

    heading_rad: float
    prominence: float
    sign_ratio: float


def walking_axis(acceleration: Array, rate_hz: float) -> WalkingAxis:
    """Find the walking axis.

    Parameters
    ----------
    acceleration
        Without gravity, shape (n, 3), x, y horizontal, z up [m/s2]; a few strides of one heading.
    rate_hz
        Sampling rate [Hz].

    Raises
    ------
    ValueError
        For fewer than three samples.
    """
    if len(acceleration) < 3:
        raise ValueError(f"acceleration: expected at least 3 samples, found {len(acceleration)}")
    moved = acceleration - acceleration.mean(axis=0)
    flat, up = moved[:, :2], moved[:, 2]
    values, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    axis = vectors[:, 1]
    prominence = 1 - float(values[0] / values[1]) if values[1] > 0 else 0.0
    velocity = np.cumsum(up - up.mean()) / rate_hz
    line = np.arange(len(velocity)) - (len(velocity) - 1) / 2
    velocity = velocity - velocity.mean() - line * (line @ velocity) / (line @ line)
    along = flat @ axis
    scale = math.sqrt(float(along @ along) * float(velocity @ velocity))
    ratio = -float(along @ velocity) / scale if scale > 0 else 0.0
    sign = 1.0 if ratio >= 0 else -1.0
    heading = math.atan2(sign * axis[1], sign * axis[0])
    return WalkingAxis(heading, prominence, abs(ratio))
