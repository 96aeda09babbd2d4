"""The heading estimator: samples in, orientation, heading and verdicts on the field out.

Usable without a pipeline::

    estimator = HeadingEstimator(HeadingParameters(), rate_hz=100.0)
    for frame in [*estimator.add(samples), *estimator.finish()]:
        frame.orientation, frame.heading_rad, frame.sigma_rad, frame.undisturbed
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ..later import Later
from .alone import GyroscopeAlone
from .api import HeadingFrame, HeadingFrames
from .attitude import Attitude, AttitudeNoise
from .calibration import TOO_LITTLE, Calibration
from .compass import TESLA, TESTS, Compass
from .fused_frames import (
    REST_FORCE,
    REST_RATE,
    REST_S,
    REST_SPEED,
    REST_SPREAD,
    fused_frames,
    limits_of,
)
from .inertial_frames import Samples, frame_of
from .rotations import matrix, wrapped
from .scalar_filters import AzimuthKalman, Exponential

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from . import compass_kernels, frame_kernels
    from .inertial_frames import InertialFrame
    from .parameters import HeadingParameters
    from .rotations import Array
    from .scalar_filters import ScalarFilter
else:
    compass_kernels = Later("groundtrace.heading.compass_kernels")
    frame_kernels = Later("groundtrace.heading.frame_kernels")

#: What is known of a magnetometer's delay before anything turned: 0, to 20 ms, by a noise of 1 uT.
DELAY_PRIOR = (TESLA / 0.02) ** 2


class HeadingEstimator:
    """Fuses gyroscope, specific force and magnetic field of one body-worn sensor.

    Parameters
    ----------
    parameters
        As documented there.
    rate_hz
        Sampling rate [Hz].

    Attributes
    ----------
    attitude, compass, gyroscope, calibration
        What it is made of.
    scalar
        The filter of one angle, if there is one.
    rested_s
        How long the sensor has rested [s].
    delay_sums
        Of all fields so far, as those of a frame.
    """

    def __init__(self, parameters: HeadingParameters, rate_hz: float) -> None:
        self.parameters = parameters
        self.rate_hz = rate_hz
        self.length = max(2, round(parameters.frame_s * rate_hz))
        self.axis = axis_of(parameters.axis)
        self.attitude = Attitude(AttitudeNoise(scale=parameters.gyro_scale))
        self.compass = Compass(parameters, self.length / rate_hz)
        self.gyroscope = GyroscopeAlone()
        self.scalar = _scalar_filter(parameters)
        self.calibration = Calibration()
        self._waiting: list[Samples] = []
        self.rested_s = 0.0
        self.delay_sums = (0.0, DELAY_PRIOR)

    @property
    def delay_s(self) -> float:
        """How much later than the gyroscope the magnetometer answers [s]."""
        return self.delay_sums[0] / self.delay_sums[1]

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""
        whole = joined([*self._waiting, samples])
        count = len(whole) // self.length * self.length
        self._waiting = [whole.rows(count, len(whole))]
        found: list[HeadingFrames] = []
        at = 0
        while at < count:
            found.append(self._next(whole.rows(at, count), self.length))
            at += len(found[-1]) * self.length
        return HeadingFrames.concatenate(found) if found else []

    def finish(self) -> Sequence[HeadingFrame]:
        """Return the last, shorter frame."""
        left, self._waiting = self._waiting, []
        found = [self._next(part, len(part)) for part in left if len(part)]
        return HeadingFrames.concatenate(found) if found else []

    def _next(self, samples: Samples, length: int) -> HeadingFrames:
        """Go on by the next frames, at least one."""
        first = samples.rows(0, length)
        if self.scalar is not None:
            return HeadingFrames.of([self._frame(first, self.scalar)])
        if not self.attitude.started or np.isnan(self.attitude.earth[0]):
            self._begin(first)
        return fused_frames(self, samples, length)

    def _begin(self, samples: Samples) -> InertialFrame:
        """Begin with what the next frame is the first to tell; return that frame."""
        attitude = self.attitude
        samples = replace(samples, field=self.calibration.corrected(samples.field))
        frame = frame_of(samples, 1.0 / self.rate_hz, attitude.bias, self.delay_s)
        if not attitude.started:
            attitude.start(frame)
        if np.isnan(attitude.earth[0]) and np.isfinite(frame.field).all():
            self._meet(matrix(attitude.orientation) @ frame.field)
        return frame

    def _frame(self, samples: Samples, scalar: ScalarFilter) -> HeadingFrame:
        """Go on by one frame, the heading by a filter of one angle."""
        attitude = self.attitude
        frame = self._begin(samples)
        axes, bias, offset = matrix(attitude.orientation), attitude.bias, self.gyroscope.offset_rad
        orientation, heading = frame_kernels.headings(attitude.orientation, frame.turns, self.axis)
        sigma = attitude.heading_sigma_rad
        resting = self._move(frame, scalar)
        self.gyroscope.go_on(frame, axes, bias, resting=resting)
        moved = attitude.orientation
        tests, undisturbed = self._look(frame, axes, scalar)
        self.gyroscope.leave_out(moved, attitude.orientation)
        compass = bool(np.isfinite(tests).all())
        alone = (offset, self.compass.turn_rad if compass else math.nan)
        values = [*tests, *(math.degrees(wrapped(heading[0] + turn)) for turn in alone)]
        raw = samples.field[len(samples) // 2 : len(samples) // 2 + 1]
        notes = self.calibrate(raw, np.array([compass]), np.array([undisturbed]))
        return HeadingFrame(
            time_ns=samples.time_ns,
            orientation=orientation,
            heading_rad=heading,
            sigma_rad=min(sigma, math.pi),
            bias=attitude.bias.copy(),
            values=np.array(values),
            undisturbed=undisturbed,
            compass=compass,
            resting=resting,
            notes=notes.get(0, ()),
        )

    def _meet(self, field: Array) -> None:
        """Take the first field, earth frame [T], for the earth's."""
        sigma_t = self.parameters.field_sigma_ut * TESLA
        self.attitude.take_earth(math.hypot(field[0], field[1]), float(field[2]), sigma_t)
        before = self.attitude.orientation
        self.attitude.face(field, sigma_t)
        self.gyroscope.meet(before, self.attitude.orientation)

    def _move(self, frame: InertialFrame, scalar: ScalarFilter) -> bool:
        """Go on to the frame's end by gyroscope and specific force; say whether it rests."""
        attitude, before = self.attitude, float(self.attitude.covariance[2, 2])
        attitude.predict(frame)
        still = (
            float(np.linalg.norm(frame.rate)) < REST_RATE
            and frame.rate_spread < REST_SPREAD
            and frame.force_spread < REST_FORCE
        )
        self.rested_s = self.rested_s + frame.length_s if still else 0.0
        resting = self.rested_s > REST_S
        attitude.hold_velocity(frame.length_s, REST_SPEED if resting else None)
        if resting:
            attitude.hold_bias(frame.rate)
        grown = max(float(attitude.covariance[2, 2]) - before, 0.0)
        turn = scalar.advance(frame.length_s, grown)
        attitude.turn_heading(turn)
        self.gyroscope.offset_rad -= turn
        return resting

    def _look(self, frame: InertialFrame, axes: Array, scalar: ScalarFilter) -> tuple[Array, bool]:
        """Test the frame's field and learn from it; return the tests' values and the verdict."""
        if not np.isfinite(frame.field).all():
            return np.full(len(TESTS), np.nan), True
        values = self.compass.examine(self.attitude, frame, axes)
        undisturbed = compass_kernels.passes(values, limits_of(self.parameters))
        if undisturbed:
            seen = axes @ frame.field
            north = self.attitude.earth[0]
            sigma = self.parameters.field_sigma_ut * TESLA / max(north, TESLA)
            sigma *= math.sqrt(2 * self.parameters.field_memory_s / frame.length_s)
            self.attitude.turn_heading(scalar.correct(math.atan2(seen[0], seen[1]), sigma))
            late, moved = frame.delay_sums
            late += self.delay_s * moved
            self.delay_sums = (self.delay_sums[0] + late, self.delay_sums[1] + moved)
        self.attitude.reset_heading(scalar.sigma_rad)
        return values, undisturbed

    def calibrate(
        self, raws: Array, seen: NDArray[np.bool_], passed: NDArray[np.bool_]
    ) -> dict[int, tuple[str, ...]]:
        """Watch fields as measured; begin anew with the field where it is now calibrated.

        Parameters
        ----------
        raws
            One of each frame, shape (n, 3) [T].
        seen, passed
            Frames that have a field, and those whose field passed its tests, shape (n,).

        Returns
        -------
        What a person should know at some of the frames.
        """
        calibration, places = self.calibration, np.flatnonzero(seen).tolist()
        if not places:
            return {}
        notes: dict[int, tuple[str, ...]] = {}
        if calibration.wanting:
            notes = dict.fromkeys(places[:-1], (TOO_LITTLE,))
        if calibration.take(raws[seen], int(np.count_nonzero(seen & ~passed))):
            notes[places[-1]] = (self._calibrated(),)
        elif calibration.wanting:
            notes[places[-1]] = (TOO_LITTLE,)
        return notes

    def _calibrated(self) -> str:
        """Begin anew with a field that is calibrated; return what a person should know."""
        assert self.calibration.ellipsoid is not None
        self.compass = Compass(self.parameters, self.length / self.rate_hz)
        self.attitude.forget_field()
        x, y, z = (self.calibration.ellipsoid.centre / TESLA).tolist()
        return f"magnetometer calibrated: hard iron {x:.1f}, {y:.1f}, {z:.1f} uT taken out"


@cache
def axis_of(name: str) -> Array:
    """Return the unit vector of a body axis such as ``x`` or ``-z``, shape (3,), to read only."""
    unit = np.eye(3)["xyz".index(name[-1])]
    return np.asarray(-unit if name.startswith("-") else unit)


def joined(parts: list[Samples]) -> Samples:
    """Return consecutive samples as one; at least one part."""
    if len(parts) == 1:
        return parts[0]
    return Samples(
        np.concatenate([p.time_ns for p in parts]),
        np.concatenate([p.rate for p in parts]),
        np.concatenate([p.force for p in parts]),
        np.concatenate([p.field for p in parts]),
    )


def _scalar_filter(parameters: HeadingParameters) -> ScalarFilter | None:
    if parameters.filter == "exponential":
        return Exponential()
    if parameters.filter == "kalman":
        return AzimuthKalman()
    return None
