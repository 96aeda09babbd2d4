"""The heading estimator: samples in, orientation, heading and tests of the field out.

It can be used without a pipeline::

    estimator = HeadingEstimator(HeadingParameters(), rate_hz=100.0)
    for frame in [*estimator.add(samples), *estimator.finish()]:
        frame.orientation, frame.heading_rad, frame.sigma_rad, frame.undisturbed
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.events import Disturbance, Heading, Note
from groundtrace_codecs.signals import NS_PER_S, SignalBlock

from ..later import Later
from ..pipeline.gates import Candidates
from ..pipeline.stage import CannotStart, Context, Input, Stage
from .attitude import Attitude, AttitudeNoise, HeadingFrame, HeadingFrames, HeadingParameters
from .frames import Samples, SensorAligner, columns_of_axes, frame_of
from .heading_baselines import AzimuthKalman, Exponential, GyroscopeAlone
from .magnetometer import (
    COLUMNS,
    GATES,
    TESLA,
    TESTS,
    TOO_LITTLE,
    Calibration,
    Compass,
    DisturbedSpans,
)
from .rotations import matrix, wrap_angle

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import CandidateBlock, Event

    from ..kernels import attitude as attitude_kernels
    from ..pipeline.stage import Output
    from .attitude import HeadingFilter
    from .frames import InertialFrame
    from .heading_baselines import ScalarFilter
    from .rotations import Array
else:
    attitude_kernels = Later("groundtrace.kernels.attitude")

#: What is known of a magnetometer's delay before anything turned: 0, to 20 ms, by a noise of 1 uT.
#: Chosen by judgement: two samples at 100 Hz.
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
        orientation, heading = attitude_kernels.headings(
            attitude.orientation, frame.turns, self.axis
        )
        sigma = attitude.heading_sigma_rad
        resting = self._move(frame, scalar)
        self.gyroscope.go_on(frame, axes, bias, resting=resting)
        moved = attitude.orientation
        tests, undisturbed = self._look(frame, axes, scalar)
        self.gyroscope.leave_out(moved, attitude.orientation)
        compass = bool(np.isfinite(tests).all())
        alone = (offset, self.compass.turn_rad if compass else math.nan)
        values = [*tests, *(math.degrees(wrap_angle(heading[0] + turn)) for turn in alone)]
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
        undisturbed = attitude_kernels.passes(values, limits_of(self.parameters))
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


#: A sensor rests that turns and shakes by less than this for a time [rad/s], [m/s2], [s]. Chosen by
#: judgement: over the offset and noise of cheap sensors, under what a person who stands does.
REST_RATE, REST_SPREAD, REST_FORCE, REST_S = 0.05, 0.02, 0.15, 1.0
#: Velocity left at rest [m/s]. Chosen by judgement: who stands sways by some 0.01 m/s.
REST_SPEED = 0.02


def fused_frames(one: HeadingEstimator, samples: Samples, length: int) -> HeadingFrames:
    """Go on by frames of so many samples, at least one, until a calibration changes anything.

    What they begin with, tilt and earth's field, must be known.
    """
    compass, calibration = one.compass, one.calibration
    compass.last(length / one.rate_hz)
    state, watched = _state(one), calibration.watched
    count, orientation, heading, told = attitude_kernels.frames(
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
    seen, passed = (
        np.isfinite(told[:, attitude_kernels.VALUES]),
        told[:, attitude_kernels.PASSED] > 0,
    )
    return HeadingFrames(
        time_ns=samples.time_ns[:rows],
        orientation=orientation[:rows],
        heading_rad=heading[:rows],
        first=np.arange(0, rows + 1, length),
        sigma_rad=told[:, attitude_kernels.SIGMA],
        bias=told[:, attitude_kernels.TOLD_BIAS : attitude_kernels.VALUES],
        values=told[:, attitude_kernels.VALUES : attitude_kernels.PASSED],
        undisturbed=passed,
        compass=seen,
        resting=told[:, attitude_kernels.RESTING] > 0,
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
    row[attitude_kernels.REST_RATE : attitude_kernels.GRAVITY] = rest
    last = (p.drift_factor, float(one.attitude.free), 1 / one.rate_hz)
    return np.array([*row, lasting_t, plain_t, noise.iron_start, *last])


def limits_of(parameters: HeadingParameters) -> Array:
    """Return the threshold of each test, shape (8,)."""
    by_name = {gate.name: float(getattr(parameters, gate.parameter)) for gate in GATES}
    return np.array([by_name[test.name] for test in TESTS])


def _take(one: HeadingEstimator, state: Array) -> None:
    """Take over what the frames left behind."""
    a, g = one.attitude, one.gyroscope
    parts = np.split(
        state,
        [
            attitude_kernels.VELOCITY,
            attitude_kernels.BIAS,
            attitude_kernels.IRON,
            attitude_kernels.EARTH,
            attitude_kernels.RESTED,
        ],
    )
    a.orientation, a.velocity, a.bias, a.iron, a.earth = parts[:5]
    one.rested_s = float(state[attitude_kernels.RESTED])
    one.delay_sums = (
        float(state[attitude_kernels.DELAY]),
        float(state[attitude_kernels.DELAY + 1]),
    )
    g.offset_rad, g.bias = (
        float(state[attitude_kernels.OFFSET]),
        state[attitude_kernels.ALONE : attitude_kernels.RESTS],
    )
    g.rests = int(state[attitude_kernels.RESTS])


class HeadingStage(Stage):
    """Runs a heading filter on every sensor with a gyroscope and an accelerometer.

    Streams of one placement are one sensor: its magnetometer may have a topic of its own. Each
    frame is a candidate, accepted where the field is undisturbed. A gap of the gyroscope that is
    not bridged, and a step of its clock, begin anew; other gaps leave the field or the force out.

    Notes
    -----
    ``Parameters`` has ``output_hz`` and ``join_s``.
    """

    takes = (
        Input(SignalBlock, frozenset({"angular_velocity"}), hold=False),
        Input(SignalBlock, frozenset({"acceleration"}), hold=False),
        Input(SignalBlock, frozenset({"magnetic_field"}), hold=False, required=False),
    )
    gives = (Heading, Disturbance)
    scope = "placement"
    rounds = ("angular_velocity",)

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def filter(self, rate_hz: float) -> HeadingFilter:
        """Return a filter of samples at a rate [Hz]."""
        raise NotImplementedError

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin with a gyroscope."""
        if not columns_of_axes(context.stream, "angular_velocity"):
            raise CannotStart
        self._stage, self._topic = context.stage, context.topic
        self._period_ns = context.stream.period_ns
        self._filter = self.filter(context.stream.rate_hz)
        self._spans = DisturbedSpans(context.stage, round(self.parameters.join_s * NS_PER_S))
        self._aligner = SensorAligner()
        self._due_ns: int | None = None
        self._told: frozenset[str] = frozenset()
        self._turning = False
        return ("field",)

    def process(self, block: SignalBlock) -> Iterator[Output]:
        """Take what a stream measures; the first of the gyroscope begins it all."""
        self._aligner.update(block)
        if not self._turning and not columns_of_axes(block.stream, "angular_velocity"):
            return
        self._turning = True
        remark = self._aligner.remark
        if remark and remark not in self._told:
            self._told |= {remark}
            yield Note(block.start_ns, remark, "WARN", self._stage)
        yield from self._frames(self._filter.add(self._aligner.take()))

    def flush(self) -> Iterator[Output]:
        """End the run."""
        yield from self._frames([*self._filter.add(self._aligner.finish()), *self._filter.finish()])
        yield from self._spans.finish()

    def decided(self, block: CandidateBlock) -> Sequence[Event]:  # noqa: ARG002
        """Yield nothing: whether the field is undisturbed is known to the filter already."""
        return ()

    def _frames(self, given: Sequence[HeadingFrame]) -> Iterator[Output]:
        """Yield what frames say: the tests of the field, disturbances, headings, notes."""
        if not given:
            return
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        tested = np.flatnonzero(frames.compass)
        if len(tested):
            yield Candidates(
                frames.time_ns[frames.first[tested]],
                np.zeros(len(tested), np.int32),
                frames.values[tested].astype(np.float32),
            )
        yield from self._disturbances(frames)
        yield from self._headings(frames)
        yield from self._notes(frames)

    def _disturbances(self, frames: HeadingFrames) -> Iterator[Event]:
        """Yield the disturbances that are over."""
        disturbed = frames.compass & ~frames.undisturbed
        if not (disturbed.any() or self._spans.under_way):
            return
        starts_ns = frames.time_ns[frames.first[:-1]].tolist()
        ends_ns = (frames.time_ns[frames.first[1:] - 1] + self._period_ns).astype(np.int64).tolist()
        offs = np.where(frames.compass, frames.values[:, 0], np.nan).tolist()
        for start_ns, end_ns, off, bad in zip(
            starts_ns, ends_ns, offs, disturbed.tolist(), strict=True
        ):
            yield from self._spans.add(start_ns, end_ns, off, disturbed=bad)

    def _headings(self, frames: HeadingFrames) -> Iterator[Heading]:
        """Return the headings that are due."""
        every_ns = max(NS_PER_S / self.parameters.output_hz, self._period_ns)
        due_ns = -1 if self._due_ns is None else self._due_ns
        due, self._due_ns = attitude_kernels.due_places(
            frames.time_ns, due_ns, every_ns, self._period_ns
        )
        sigma = np.repeat(frames.sigma_rad, frames.lengths)[due]
        columns = (frames.time_ns[due], frames.heading_rad[due], sigma)
        return map(Heading, *(x.tolist() for x in columns), repeat(self._stage))

    def _notes(self, frames: HeadingFrames) -> Iterator[Note]:
        """Yield what a person should know, each once."""
        for place, texts in frames.notes.items():
            for text in texts:
                if text not in self._told:
                    self._told |= {text}
                    time_ns = int(frames.time_ns[frames.first[place + 1] - 1])
                    yield Note(time_ns, f"{self._topic}: {text}", "INFO", self._stage)


class CompassHeading(HeadingStage):
    """Fuses gyroscope, specific force and magnetic field of one body-worn sensor."""

    Parameters = HeadingParameters
    columns = COLUMNS
    gates = GATES

    def filter(self, rate_hz: float) -> HeadingEstimator:
        """Return an estimator at a rate [Hz]."""
        return HeadingEstimator(self.parameters, rate_hz)
