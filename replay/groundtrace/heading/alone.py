"""What the gyroscope alone and the compass alone say of the heading, to show beside the fused one.

Both share the tilt of the filter, which the field never changes, so that either differs from the
fused orientation by a turn about the vertical.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .rotations import wrapped

if TYPE_CHECKING:
    from .inertial_frames import InertialFrame
    from .rotations import Array


@dataclass(slots=True)
class GyroscopeAlone:
    """The turn from the fused heading to that of the gyroscope alone.

    It begins at the first field's heading. Of the bias it knows what the sensor showed at rest,
    nothing that the compass teaches.

    Attributes
    ----------
    offset_rad
        That turn, counter-clockwise [rad].
    bias
        Mean rate at rest so far, body frame, shape (3,) [rad/s]; 0 before any rest.
    rests
        Frames at rest so far.
    """

    offset_rad: float = 0.0
    bias: Array = field(default_factory=lambda: np.zeros(3))
    rests: int = 0
    _faces: bool = False

    def go_on(self, frame: InertialFrame, axes: Array, bias: Array, *, resting: bool) -> None:
        """Go on by a frame that the filter integrated with its own bias.

        Parameters
        ----------
        frame
            Gone on by.
        axes
            Rotation matrix of the body at the frame's start.
        bias
            Taken out of the frame by the filter, shape (3,) [rad/s].
        resting
            Whether the sensor stands still.
        """
        left = axes @ frame.mean_turn @ (bias - self.bias)
        self.offset_rad += float(left[2]) * frame.length_s
        if resting:
            self.rests += 1
            self.bias = self.bias + (frame.rate - self.bias) / self.rests

    def meet(self, before: Array, after: Array) -> None:
        """Face the first field as the filter does, and leave out what it makes of a later one."""
        self.leave_out(before, after)
        if not self._faces:
            self.offset_rad, self._faces = 0.0, True

    def leave_out(self, before: Array, after: Array) -> None:
        """Leave out a turn of the filter towards the compass, between two orientations (4,)."""
        self.offset_rad -= _turn_about_vertical(before, after)


def _turn_about_vertical(before: Array, after: Array) -> float:
    """Return by how much an orientation was turned about the vertical [rad]."""
    # w and z of after times the inverse of before; there is no x and y where the tilt is kept
    (bw, bx, by, bz), (aw, ax, ay, az) = before.tolist(), after.tolist()
    w = aw * bw + ax * bx + ay * by + az * bz
    z = -aw * bz - ax * by + ay * bx + az * bw
    return wrapped(2 * math.atan2(z, w))
