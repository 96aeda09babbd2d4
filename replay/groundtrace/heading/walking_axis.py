"""How far the sensor is turned about the vertical from the way its wearer walks, told by walking.

Source: EPFL, the sensor's place on the trunk is free and only its inclination is taken from the
accelerometers; here the remaining rotation is taken from the walk. What repeats with every step of
a walk ahead or back swings along the walking axis, while the sway to the sides repeats with every
second step. So of the horizontal acceleration the part that goes with the vertical one at the
frequency of the steps is taken, and its principal axis is the walking axis.

Its sign: the body is slowed down while it rises from double support to mid stance and driven on
while it falls. The acceleration ahead therefore goes against the velocity upward, a quarter of a
step before the acceleration upward. Who walks backward does the same the other way round, so that
of accelerations alone a walk back is a walk ahead in a sensor turned by half a turn. Where a
nominal direction is known it gives the sign; else people are taken to walk ahead in most of the
last hundred steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..later import Later

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..reckoning import step_kernels
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
#: What looks ahead: an axis of the sensor, or what the walk tells.
Ahead = Literal["walk", "x", "-x", "y", "-y", "z", "-z"]
#: Swing of a step ahead and to the right, as complex parts of the vertical one.
Swing = tuple[complex, complex]
#: An axis nearer than the first to the vertical says nothing about ahead; where the walk tells it,
#: an axis farther than the second is the reference, so that no bow makes it steep [cosine].
STEEP, LEVEL = 0.9, 0.7
#: Weight of what was known before a step, for the axis unless said otherwise and for its sign: the
#: axis follows a sensor that slips, the sign outlasts a walk back of some dozens of steps.
KEEP, _KEEP_SIGN = 0.97, 0.99
#: Weight of the nominal direction at the start: that of a step or two whose horizontal swing is
#: half the vertical one.
_PRIOR = 0.25
#: With a nominal direction, a step tells the axis where its swing lies so near to it [rad].
_REACH_RAD = math.radians(35.0)


@dataclass(slots=True)
class WalkingAxis:
    """Principal axis of the horizontal swing of the steps so far, and its sign.

    Attributes
    ----------
    nominal
        Whether "ahead" of the swings is the nominal direction, right to 35 degrees or so; else it
        is any direction, and the walk alone tells axis and sign.
    keep
        Weight of what was known of the axis before a step.
    scatter
        Weighted sums of the products of the swing: ahead twice, ahead and right, right twice.
    drive
        Weighted sums of the swing that goes against the velocity upward, ahead and to the right.
    """

    nominal: bool = True
    keep: float = KEEP
    scatter: tuple[float, float, float] = (_PRIOR, 0.0, 0.0)
    drive: tuple[float, float] = (_PRIOR, 0.0)

    @property
    def angle_rad(self) -> float:
        """Return the walking direction against the nominal one, positive to the right [rad]."""
        angle = _principal(*self.scatter)
        ahead = self.drive[0] * math.cos(angle) + self.drive[1] * math.sin(angle)
        if self.nominal or ahead >= 0:
            return angle
        return angle - math.copysign(math.pi, angle)

    def add(self, swing: Swing) -> None:
        """Take a step's swing."""
        ahead, right = swing
        size = 1 + abs(ahead) ** 2 + abs(right) ** 2
        a, r = ahead.imag / size, right.imag / size
        if self.nominal and abs(_principal(a * a, a * r, r * r)) > _REACH_RAD:
            return
        aa, ar, rr = self.scatter
        self.scatter = (self.keep * aa + a * a, self.keep * ar + a * r, self.keep * rr + r * r)
        self.drive = (_KEEP_SIGN * self.drive[0] + a, _KEEP_SIGN * self.drive[1] + r)

    def turned(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations ahead, to the right and up about the axis, shape (3, n)."""
        angle, out = self.angle_rad, values.copy()
        cos, sin = math.cos(angle), math.sin(angle)
        out[0], out[1] = cos * values[0] + sin * values[1], cos * values[1] - sin * values[0]
        return out


def _principal(aa: float, ar: float, rr: float) -> float:
    """Return the direction of the principal axis of a symmetric matrix, within a quarter turn."""
    return 0.5 * math.atan2(2 * ar, aa - rr)


def step_swing(values: NDArray[np.float64], phase: NDArray[np.float64]) -> Swing | None:
    """Return the swing ahead and to the right at the frequency of the steps.

    Parameters
    ----------
    values
        Accelerations ahead, to the right and up, shape (3, n).
    phase
        Of each sample, in steps about the one looked at, shape (n,).

    Returns
    -------
    Complex parts of the vertical swing, or None where there is no vertical swing.
    """
    found, ahead, right = step_kernels.swing(np.ascontiguousarray(values), phase)
    return (ahead, right) if found else None


def level_axis(up: Sequence[float] | NDArray[np.float64]) -> Axis:
    """Return the first axis that is level enough, up being a unit vector, shape (3,)."""
    if abs(up[0]) < LEVEL:
        return "x"
    # of two axes at right angles to an upright one at least this one is level
    return "y"
