"""The body's axes: acceleration ahead, aside and up, from a worn sensor in any orientation.

Up is against gravity. Ahead is what a reference axis of the sensor leaves in the horizontal plane;
how far the way is turned from it is found by :mod:`groundtrace.heading.walking_axis`. The reference
is the axis that the wearer says looks ahead, or any that is horizontal enough.

Gravity is a low-passed specific force. Where there is a gyroscope, its turns are followed at once
and the specific force only corrects what drifts (a complementary filter, linear in the small
turns within its time constant), so that the nodding and rolling of the trunk within a step do not
turn gravity into acceleration. All is causal, and the same whatever the blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..detectors.filters import planar
from ..heading.aligned import columns_of_axes
from ..heading.walking_axis import STEEP, level_axis
from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from groundtrace_codecs.signals import SignalBlock, Stream

    from ..heading.walking_axis import Ahead, Axis
    from . import axis_kernels
else:
    axis_kernels = Later("groundtrace.steptypes.axis_kernels")

#: Time over which a gyroscope's offset is told from the turns of a body that stays upright [s].
_OFFSET_S = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class BodyPart:
    """Consecutive samples in the body's axes.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    values
        Acceleration ahead, to the right and up, without gravity, shape (3, n) [m/s2].
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]


def axis_vector(axis: Axis) -> NDArray[np.float64]:
    """Return the unit vector of an axis' name, shape (3,)."""
    vector = np.zeros(3)
    vector["xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
    return vector


class BodyAxes:
    """Turns the samples of one sensor into the body's axes.

    Parameters
    ----------
    stream
        Three axes of acceleration, by their names x, y and z; those of angular velocity are used
        where there are three.
    forward
        The sensor's axis that looks ahead, up to the mounting; ``walk``: the first of x, y, z that
        is level enough at the start. Where it turns out to be vertical, the axis that follows it
        in x, y, z takes its place.
    gravity_s
        Time constant of gravity [s].

    Attributes
    ----------
    forward
        The reference; ``walk`` until the first sample.
    """

    def __init__(self, stream: Stream, forward: Ahead = "x", gravity_s: float = 2.0) -> None:
        self._force = columns_of_axes(stream, "acceleration")
        self._turning = columns_of_axes(stream, "angular_velocity")
        self.forward = forward
        self._gravity_s = gravity_s
        self._keep = math.exp(-1 / (gravity_s * stream.rate_hz))
        self._keep_offset = math.exp(-1 / (_OFFSET_S * stream.rate_hz))
        self._state = np.zeros((4, 3))

    @staticmethod
    def fits(stream: Stream) -> bool:
        """Return whether a stream has three axes of acceleration."""
        return bool(columns_of_axes(stream, "acceleration"))

    def __call__(self, block: SignalBlock) -> BodyPart:
        """Take a block; return its samples in the body's axes."""
        values = planar(block)
        force = np.ascontiguousarray(values[self._force])
        rate = np.ascontiguousarray(values[self._turning])
        keeps = (self._keep, self._keep_offset, self._gravity_s)
        gravity = axis_kernels.directions(force, rate, self._state, keeps)
        if self.forward == "walk":
            self.forward = level_axis(gravity[:, 0] / max(math.hypot(*gravity[:, 0]), 1e-300))
        nominal = axis_vector(self.forward)
        return BodyPart(block.sample_times(), axis_kernels.resolved(force, gravity, nominal, STEEP))
