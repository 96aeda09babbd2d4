"""How far the sensor is turned about the vertical from its nominal direction, told by walking.

Source: EPFL, the sensor's place on the trunk is free and only its inclination is taken from the
accelerometers; here the remaining rotation is taken from the walk. What repeats with every step of
a walk ahead or back swings along the walking axis, while the sway to the sides repeats with every
second step. So of the horizontal acceleration the part that goes with the vertical one at the
frequency of the steps is taken, and its principal axis is the walking axis. An axis has no sign;
it is that of the nominal direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Weight of what was known before a step, and of the nominal direction at the start: that of some
#: steps whose horizontal swing is half the vertical one.
_KEEP, _PRIOR = 0.97, 1.0
#: A step tells the axis where its swing lies nearer to the nominal direction than this [rad].
_REACH_RAD = math.radians(35.0)


@dataclass(slots=True)
class HeadingAxis:
    """Principal axis of the horizontal swing of the steps so far.

    Attributes
    ----------
    scatter
        Weighted sum of the products of the swing ahead and to the right, shape (2, 2).
    """

    scatter: NDArray[np.float64] = field(
        default_factory=lambda: np.array([[_PRIOR, 0.0], [0.0, 0.0]])
    )

    @property
    def angle_rad(self) -> float:
        """Return the walking axis against the nominal one, positive to the right [rad]."""
        (aa, ar), (_, rr) = self.scatter.tolist()
        return 0.5 * math.atan2(2 * ar, aa - rr)

    def add(self, swing: NDArray[np.complex128]) -> None:
        """Take a step's swing ahead and to the right, as parts of the vertical one, shape (2,)."""
        products = np.outer(swing, swing.conj()).real
        angle = 0.5 * math.atan2(2 * products[0, 1], products[0, 0] - products[1, 1])
        if abs(angle) <= _REACH_RAD:
            self.scatter = _KEEP * self.scatter + products

    def turned(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations ahead, to the right and up about the axis, shape (3, n)."""
        cos, sin = math.cos(self.angle_rad), math.sin(self.angle_rad)
        ahead, right, up = values
        return np.stack([cos * ahead + sin * right, cos * right - sin * ahead, up])


def step_swing(
    values: NDArray[np.float64], phase: NDArray[np.float64]
) -> NDArray[np.complex128] | None:
    """Return the swing ahead and to the right at the frequency of the steps, shape (2,).

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
    # over two whole steps, in which what repeats with every second step adds up to nothing
    inside = (phase >= -1.0) & (phase < 1.0)
    swing = values[:, inside] @ np.exp(-2j * np.pi * phase[inside])
    size = abs(swing[2])
    if not size > 0:
        return None
    return np.asarray(swing[:2] * np.conj(swing[2]) / size**2)
