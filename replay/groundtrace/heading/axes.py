"""The walking axis of a worn sensor: the principal axis of the swing of the steps, and its sign.

The trunk swings forward and back at every step, from side to side only once a stride. So of the
horizontal acceleration the part that goes with the vertical one at the frequency of the steps is
taken; its principal axis is the walking axis. Sign: the body is slowed down while it rises from
double support to mid stance and driven on while it falls. The acceleration ahead therefore goes
against the velocity upward, a quarter of a step before the acceleration upward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .rotations import Array

#: Frequencies that steps have, and how far from the strongest one still belongs to it [Hz].
STEPS_HZ, NEAR_HZ = (1.2, 3.0), 0.35
#: Shortest signal that tells an axis [s].
SHORTEST_S = 1.5


@dataclass(frozen=True, slots=True)
class WalkingAxis:
    """The direction of walking in the frame that the accelerations were given in.

    Attributes
    ----------
    heading_rad
        Direction ahead, counter-clockwise from the frame's x [rad].
    prominence
        1 - (second / first principal variance): 0 where no axis stands out.
    sign_ratio
        How much of the swing has the phase that chose the sign, 0 (a guess) to 1.
    """

    heading_rad: float
    prominence: float
    sign_ratio: float


def walking_axis(acceleration: Array, rate_hz: float) -> WalkingAxis:
    """Find the walking axis.

    Parameters
    ----------
    acceleration
        Shape (n, 3), x, y horizontal, z up [m/s2]; a few strides of one heading.
    rate_hz
        Sampling rate [Hz].

    Raises
    ------
    ValueError
        For less than 1.5 s.
    """
    if len(acceleration) < SHORTEST_S * rate_hz:
        raise ValueError(
            f"acceleration: expected {SHORTEST_S:g} s, found {len(acceleration) / rate_hz:g} s"
        )
    window = np.hanning(len(acceleration))[:, None]
    spectrum = np.fft.rfft((acceleration - acceleration.mean(axis=0)) * window, axis=0)
    hz = np.fft.rfftfreq(len(acceleration), 1 / rate_hz)
    allowed = (hz >= STEPS_HZ[0]) & (hz <= STEPS_HZ[1])
    peak = hz[np.argmax(np.where(allowed, np.abs(spectrum[:, 2]), 0.0))]
    near = np.abs(hz - peak) <= NEAR_HZ
    swing = spectrum[near, :2].T @ spectrum[near, 2].conj()
    values, vectors = np.linalg.eigh(np.outer(swing, swing.conj()).real)
    along = complex(swing @ vectors[:, 1])
    axis = vectors[:, 1] * (1.0 if along.imag >= 0 else -1.0)
    prominence = 1 - float(max(values[0], 0.0) / values[1]) if values[1] > 0 else 0.0
    ratio = abs(along.imag) / abs(along) if along else 0.0
    return WalkingAxis(math.atan2(axis[1], axis[0]), prominence, ratio)
