"""Frames of about 0.1 s: all samples of a frame brought to its start by the gyroscope.

The short-term rotation by the gyroscope is far better than any orientation, so that specific force
and field can be averaged over a frame however fast the sensor turns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import frame_kernels as at

    Array = NDArray[np.float64]
else:
    at = Later("groundtrace.heading.frame_kernels")


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Consecutive samples of one body-worn sensor.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    rate
        Angular velocity, shape (n, 3) [rad/s].
    force
        Specific force, shape (n, 3) [m/s2].
    field
        Magnetic field, shape (n, 3) [T]; NaN where there is none.
    """

    time_ns: NDArray[np.int64]
    rate: Array
    force: Array
    field: Array

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def rows(self, start: int, stop: int) -> Samples:
        """Return samples ``[start, stop)``."""
        part = slice(start, stop)
        return Samples(self.time_ns[part], self.rate[part], self.force[part], self.field[part])


@dataclass(frozen=True, slots=True, eq=False)
class InertialFrame:
    """What one frame says, in the body axes at its start.

    Attributes
    ----------
    turns
        Rotation from the body at the end of each sample to the frame's start, shape (n, 4).
    mean_turn
        Mean of these rotations as a matrix, shape (3, 3): what it makes of a constant in the
        turning body.
    length_s
        Length of the frame [s].
    force, field
        Means, shape (3,) [m/s2], [T]; the field is NaN where a sample has none.
    rate
        Mean angular velocity as measured, in moving body axes, shape (3,) [rad/s].
    speed
        Root mean square angular velocity [rad/s].
    rate_spread, force_spread
        Root mean square deviation from the mean in the frame [rad/s], [m/s2].
    delay_sums
        Products (x y, x x) that tell how late the field is [T^2/s], [T^2/s^2].
    """

    turns: Array
    mean_turn: Array
    length_s: float
    force: Array
    field: Array
    rate: Array
    speed: float
    rate_spread: float
    force_spread: float
    delay_sums: tuple[float, float]


def frame_of(samples: Samples, step_s: float, bias: Array, delay_s: float) -> InertialFrame:
    """Average one frame.

    Parameters
    ----------
    samples
        All samples of the frame.
    step_s
        Time between samples [s].
    bias
        Bias of the gyroscope, shape (3,) [rad/s].
    delay_s
        How much later than the gyroscope the magnetometer answers [s].
    """
    turns, said = np.empty((len(samples), 2, 4)), np.empty(at.FRAME)
    at.sum_up(
        np.ascontiguousarray(samples.rate),
        np.ascontiguousarray(samples.force),
        np.ascontiguousarray(samples.field),
        bias,
        delay_s,
        step_s,
        turns,
        np.empty((len(samples) + 1, 6)),
        said,
    )
    field = said[at.FIELD : at.RATE]
    seen = bool(np.isfinite(field).all())
    return InertialFrame(
        turns=np.ascontiguousarray(turns[:, 0]),
        mean_turn=said[at.MEAN_TURN : at.FORCE].reshape(3, 3),
        length_s=len(samples) * step_s,
        force=said[at.FORCE : at.FIELD],
        field=field,
        rate=said[at.RATE : at.SPEED],
        speed=float(said[at.SPEED]),
        rate_spread=float(said[at.RATE_SPREAD]),
        force_spread=float(said[at.FORCE_SPREAD]),
        # a field that comes late by d is too far on by d (rate x field): in the axes of the
        # frame's start, where a constant field stands still, its samples move along that
        delay_sums=(float(said[at.ACROSS]), float(said[at.ALONG])) if seen else (0.0, 0.0),
    )
