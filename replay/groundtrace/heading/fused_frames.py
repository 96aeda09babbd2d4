"""Many frames of the error-state filter in one call of compiled functions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later
from .api import HeadingFrames
from .compass import GATES, TESLA, TESTS

if TYPE_CHECKING:
    from . import attitude_kernels as at
    from . import filter_kernels
    from .estimator import HeadingEstimator
    from .inertial_frames import Samples
    from .parameters import HeadingParameters
    from .rotations import Array
else:
    at = Later("groundtrace.heading.attitude_kernels")
    filter_kernels = Later("groundtrace.heading.filter_kernels")

#: A sensor rests that turns and shakes by less than this for a time [rad/s], [m/s2], [s].
REST_RATE, REST_SPREAD, REST_FORCE, REST_S = 0.05, 0.02, 0.15, 1.0
#: Velocity left at rest [m/s].
REST_SPEED = 0.02


def fused_frames(one: HeadingEstimator, samples: Samples, length: int) -> HeadingFrames:
    """Go on by frames of so many samples, at least one, until a calibration changes anything.

    What they begin with, tilt and earth's field, must be known.
    """
    compass, calibration = one.compass, one.calibration
    compass.last(length / one.rate_hz)
    state, watched = _state(one), calibration.watched
    count, orientation, heading, told = filter_kernels.frames(
        np.ascontiguousarray(samples.rate),
        np.ascontiguousarray(samples.force),
        np.ascontiguousarray(calibration.corrected(samples.field)),
        length,
        state,
        one.attitude.covariance,
        (compass.belief, compass.fields, compass.recent, compass.counts),
        watched,
        calibration.tries,
        one.axis,
        _settings(one, length / one.rate_hz),
        limits_of(one.parameters),
    )
    told, rows = told[:count], count * length
    _take(one, state)
    seen, passed = np.isfinite(told[:, at.VALUES]), told[:, at.PASSED] > 0
    return HeadingFrames(
        time_ns=samples.time_ns[:rows],
        orientation=orientation[:rows],
        heading_rad=heading[:rows],
        first=np.arange(0, rows + 1, length),
        sigma_rad=told[:, at.SIGMA],
        bias=told[:, at.TOLD_BIAS : at.VALUES],
        values=told[:, at.VALUES : at.PASSED],
        undisturbed=passed,
        compass=seen,
        resting=told[:, at.RESTING] > 0,
        notes=one.calibrate(samples.field[length // 2 : rows : length], seen, passed),
    )


def _state(one: HeadingEstimator) -> Array:
    """Return the state as compiled functions lay it out."""
    a, g = one.attitude, one.gyroscope
    return np.concatenate(
        [
            *(a.orientation, a.velocity, a.bias, a.iron, a.earth),
            (one.rested_s, *one.delay_sums, g.offset_rad),
            *(g.bias, (g.rests,)),
        ]
    )


def _settings(one: HeadingEstimator, length_s: float) -> Array:
    """Return the settings as compiled functions lay them out."""
    p, noise = one.parameters, one.attitude.noise
    plain_t = p.field_sigma_ut * TESLA
    lasting_t = plain_t * math.sqrt(2 * p.field_memory_s / length_s)
    row = noise.row
    rest = (REST_RATE, REST_SPREAD, REST_FORCE, REST_S, REST_SPEED)
    row[at.REST_RATE : at.GRAVITY] = rest
    last = (p.drift_factor, float(one.attitude.free), 1 / one.rate_hz)
    return np.array([*row, lasting_t, plain_t, noise.iron_start, *last])


def limits_of(parameters: HeadingParameters) -> Array:
    """Return the threshold of each test, shape (8,)."""
    by_name = {gate.name: float(getattr(parameters, gate.parameter)) for gate in GATES}
    return np.array([by_name[test.name] for test in TESTS])


def _take(one: HeadingEstimator, state: Array) -> None:
    """Take over what the frames left behind."""
    a, g = one.attitude, one.gyroscope
    parts = np.split(state, [at.VELOCITY, at.BIAS, at.IRON, at.EARTH, at.RESTED])
    a.orientation, a.velocity, a.bias, a.iron, a.earth = parts[:5]
    one.rested_s = float(state[at.RESTED])
    one.delay_sums = (float(state[at.DELAY]), float(state[at.DELAY + 1]))
    g.offset_rad, g.bias = float(state[at.OFFSET]), state[at.ALONE : at.RESTS]
    g.rests = int(state[at.RESTS])
