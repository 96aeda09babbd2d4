"""Frames with nothing out of the ordinary, all in one call of compiled functions.

That is, the filter is the error-state one and has begun, no other iron is believed in, and the
field is as expected or there is none. What else there is goes frame by frame.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from .api import HeadingFrames
from .compass import DERIVATIVE_S, DEVIATION_S, GATES, TESLA, TESTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .estimator import HeadingEstimator
    from .inertial_frames import Samples
    from .parameters import HeadingParameters
    from .rotations import Array

#: A sensor rests that turns and shakes by less than this for a time [rad/s], [m/s2], [s].
REST_RATE, REST_SPREAD, REST_FORCE, REST_S = 0.05, 0.02, 0.15, 1.0
#: Velocity left at rest [m/s].
REST_SPEED = 0.02


def ordinary_frames(one: HeadingEstimator, samples: Samples) -> HeadingFrames | None:
    """Go on by the next whole frames as far as they are ordinary; None where the first is not."""
    ordinary = one.scalar is None and one.compass.clean is None and one.calibration.idle
    if not (one.attitude.started and ordinary):
        return None
    # compiled functions are not imported where pipelines are only listed
    from . import attitude_kernels as at
    from .filter_kernels import frames

    state, covariance = _state(one), one.attitude.covariance.copy()
    length_s = one.length / one.rate_hz
    recent, counts = _recent(one, length_s)
    count, orientation, heading, told = frames(
        np.ascontiguousarray(samples.rate),
        np.ascontiguousarray(samples.force),
        np.ascontiguousarray(one.calibration.corrected(samples.field)),
        one.length,
        state,
        covariance,
        recent,
        counts,
        one.axis,
        _settings(one, length_s),
        limits_of(one.parameters),
    )
    if not count:
        return None
    compass = np.isfinite(told[:count, at.VALUES])
    one.calibration.pass_by(samples.field[one.length // 2 :: one.length][:count][compass])
    _take(one, state, covariance, recent, counts, passed=bool(compass.any()))
    rows = count * one.length
    return HeadingFrames(
        time_ns=samples.time_ns[:rows],
        orientation=orientation[:rows],
        heading_rad=heading[:rows],
        first=np.arange(0, rows + 1, one.length),
        sigma_rad=told[:count, at.SIGMA],
        bias=told[:count, at.TOLD_BIAS : at.VALUES],
        values=told[:count, at.VALUES :],
        undisturbed=np.ones(count, np.bool_),
        compass=compass,
        resting=told[:count, at.RESTING] > 0,
        notes={},
    )


def _state(one: HeadingEstimator) -> Array:
    """Return the state as compiled functions lay it out."""
    a, g = one.attitude, one.gyroscope
    return np.concatenate(
        [
            *(a.orientation, a.velocity, a.bias, a.iron, a.earth),
            (one.rested_s, *one.delay_sums, g.offset_rad),
            *(g.bias, (g.rests, one.compass.newcomer.verified_rad)),
        ]
    )


def _recent(one: HeadingEstimator, length_s: float) -> tuple[Array, NDArray[np.int64]]:
    """Return norms and azimuths of the last frames, and how many there are and may be."""
    most = [max(round(span_s / length_s), 2) for span_s in (DEVIATION_S, DERIVATIVE_S)]
    recent = np.zeros((2, max(most)))
    rows = (one.compass.norms, one.compass.azimuths)
    for row, values in zip(recent, rows, strict=True):
        row[: len(values)] = values
    return recent, np.array([[len(x), m] for x, m in zip(rows, most, strict=True)])


def _settings(one: HeadingEstimator, length_s: float) -> Array:
    """Return the settings as compiled functions lay them out."""
    from . import attitude_kernels as at

    p = one.parameters
    sigma_t = p.field_sigma_ut * TESLA * math.sqrt(2 * p.field_memory_s / length_s)
    row = one.attitude.noise.row
    rest = (REST_RATE, REST_SPREAD, REST_FORCE, REST_S, REST_SPEED)
    row[at.REST_RATE : at.GRAVITY] = rest
    last = (sigma_t, p.drift_factor, float(one.attitude.free), 1 / one.rate_hz)
    return np.array([*row, *last])


def limits_of(parameters: HeadingParameters) -> Array:
    """Return the threshold of each test, shape (8,)."""
    by_name = {gate.name: float(getattr(parameters, gate.parameter)) for gate in GATES}
    return np.array([by_name[test.name] for test in TESTS])


def _take(
    one: HeadingEstimator,
    state: Array,
    covariance: Array,
    recent: Array,
    counts: NDArray[np.int64],
    *,
    passed: bool,
) -> None:
    """Take over what the frames left behind."""
    from . import attitude_kernels as at

    a, g, compass = one.attitude, one.gyroscope, one.compass
    parts = np.split(state, [at.VELOCITY, at.BIAS, at.IRON, at.EARTH, at.RESTED])
    a.orientation, a.velocity, a.bias, a.iron, a.earth = parts[:5]
    a.covariance = covariance
    one.rested_s = float(state[at.RESTED])
    one.delay_sums = (float(state[at.DELAY]), float(state[at.DELAY + 1]))
    g.offset_rad, g.bias = float(state[at.OFFSET]), state[at.ALONE : at.RESTS]
    g.rests = int(state[at.RESTS])
    compass.norms, compass.azimuths = (
        deque(row[:count].tolist()) for row, count in zip(recent, counts[:, 0], strict=True)
    )
    if passed:
        compass.newcomer.passed(float(state[at.VERIFIED]) - compass.newcomer.verified_rad)
