"""Strapdown integration of a foot's motion, with an error-state Kalman filter.

Positions are in a frame with z up; x is the horizontal direction that the sensor was levelled to.
The error state is a small rotation in that frame (the true orientation is the estimate turned by
it), errors of velocity and position, and of the biases of gyroscope and accelerometer in the
sensor's axes.

Source: Foxlin, IEEE Computer Graphics and Applications 25(6), 2005, and Skog, Nilsson and Haendel,
Indoor Positioning and Indoor Navigation, 2010, for zero-velocity updates. How sure a standing foot
is of its velocity depends on how still it stands: it rolls over the ball of the foot, and the
sensor is above the sole. So a fast walker's short stances count, but count less.

Samples are taken in segments of equal length, in each of which the foot stands still or not. The
statistic is that of :mod:`.detectors.zero_velocity`; its window is centred, so the samples wait for
half a window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, overload

import numpy as np

from groundtrace_codecs.signals import G0_MPS2, NS_PER_S

from .. import kernels
from ..detectors.zero_velocity import RecentPeak, ZeroVelocityStatistic
from ..pipeline.parameters import gate, measured
from .lost_samples import FOOT_SIGMA, StraightLines
from .rotations import normalised, product

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..detectors.zero_velocity import ZeroVelocityParameters

    Array = NDArray[np.float64]

#: Rows of the error state.
TURN, SPEED, PLACE, GYRO, FORCE = (slice(first, first + 3) for first in range(0, 15, 3))
#: Source: definition.
STATES = 15


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the sensor is, how it is turned and moves, and the biases it is taken to have.

    Attributes
    ----------
    orientation
        Unit quaternion, body to earth, shape (4,).
    velocity, position
        Shape (3,) [m/s], [m].
    gyro_bias, force_bias
        In the sensor's axes, shape (3,) [rad/s], [m/s2].
    """

    orientation: Array
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    position: Array = field(default_factory=lambda: np.zeros(3))
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    force_bias: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def row(self) -> Array:
        """All of it, one after the other, shape (16,)."""
        parts = (self.orientation, self.velocity, self.position, self.gyro_bias, self.force_bias)
        return np.concatenate(parts)

    @classmethod
    def of(cls, row: Array) -> Pose:
        """Return the pose of a row, shape (16,)."""
        return cls(*np.split(row, [4, 7, 10, 13]))

    def moved(self, error: Array) -> Pose:
        """Return the pose that an error state, shape (15,), says is the true one."""
        half = 0.5 * float(np.linalg.norm(error[TURN]))
        turn = np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * error[TURN])])
        return Pose(
            normalised(product(turn, self.orientation)),
            self.velocity + error[SPEED],
            self.position + error[PLACE],
            self.gyro_bias + error[GYRO],
            self.force_bias + error[FORCE],
        )


@dataclass(frozen=True, slots=True, eq=False)
class StrapdownIncrement:
    """One segment integrated.

    Attributes
    ----------
    pose
        At its end.
    transition
        What an error at its start is at its end, shape (15, 15).
    """

    pose: Pose
    transition: Array


def integrate(pose: Pose, segment: Segment) -> StrapdownIncrement:
    """Go from the end of the segment before to the end of this one.

    Rates and forces are taken as straight between samples.
    """
    state, settings = filter_state(pose), np.zeros((), kernels.navigation.SETTINGS)
    settings["gravity_mps2"] = G0_MPS2
    kernels.navigation.propagate(state[()], *segment.motion, settings[()])
    return StrapdownIncrement(Pose.of(state["pose"]), state["step"])


def filter_state(pose: Pose, covariance: Array | None = None) -> NDArray[Any]:
    """Return a pose as :data:`.kernels.navigation.STATE` has it, a record of shape ()."""
    state = np.zeros((), kernels.navigation.STATE)
    state["pose"], state["transition"] = pose.row, np.eye(STATES)
    if covariance is not None:
        state["covariance"] = covariance
    return state


#: Deviation of a foot's velocity at the start, where it stands [m/s]. Chosen by judgement: as it is
#: put down.
START_MPS = 0.1
#: Velocity of a foot of which nothing is known [m/s]. Chosen by judgement: a foot in its swing has
#: 2 to 4 m/s.
LOST_MPS = 2.0


#: Random walks of the biases, by name.
BIAS_WALKS = ("gyro_bias_walk", "force_bias_walk")


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """What the filter takes its sensors for.

    Attributes
    ----------
    gyro_walk, force_walk
        Random walk of the integrated rate [rad/sqrt(s)] and specific force [m/s/sqrt(s)].
    gyro_scale, force_scale
        Unknown part of a turn or push (scale, axes, bandwidth), as white noise: error over the
        square root of what was turned [sqrt(rad)] or pushed [sqrt(m/s)].
    gyro_bias, force_bias
        Biases at the start [rad/s], [m/s2].
    gyro_bias_walk, force_bias_walk
        Their random walks [rad/s/sqrt(s)], [m/s2/sqrt(s)].
    tilt
        Of the levelling at the start [rad].
    """

    gyro_walk: float = 5e-4
    force_walk: float = 0.03
    gyro_scale: float = 5e-3
    force_scale: float = 0.01
    gyro_bias: float = 0.01
    force_bias: float = 0.1
    gyro_bias_walk: float = 1e-5
    force_bias_walk: float = 1e-4
    tilt: float = 0.035

    def settings(self) -> NDArray[Any]:
        """Return what compiled functions need of it, and gravity.

        A record of shape (), as :data:`.kernels.navigation.SETTINGS` names its fields.
        """
        settings = np.zeros((), kernels.navigation.SETTINGS)
        settings["gravity_mps2"] = G0_MPS2
        for name in (*("gyro_walk", "force_walk", "gyro_scale", "force_scale"), *BIAS_WALKS):
            settings[name] = getattr(self, name)
        settings["missed_part"], settings["missed_sigma"] = MISSED_PART, MISSED_SIGMA
        return settings


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """What a measurement says that the filter did not expect.

    Attributes
    ----------
    value, spread
        Shape (n,), and its covariance, shape (n, n).
    pick, noise
        Shape (n, 15): what it sees of the error state; and its covariance, shape (n, n).
    """

    value: Array
    spread: Array
    pick: Array
    noise: Array

    @property
    def distance(self) -> float:
        """Mahalanobis distance."""
        return float(np.sqrt(self.value @ np.linalg.solve(self.spread, self.value)))


class ErrorStateFilter:
    """A pose and the covariance of its error.

    Parameters
    ----------
    noise
        What the sensors are taken for.
    orientation
        At the start, shape (4,); its heading is the frame's, so without error.

    Attributes
    ----------
    state, settings
        Records, shape (), as :data:`.kernels.navigation.STATE` and ``SETTINGS`` name their fields.
    """

    def __init__(self, noise: SensorNoise, orientation: Array) -> None:
        sigma = np.zeros(STATES)
        sigma[TURN] = noise.tilt, noise.tilt, 0.0
        sigma[SPEED] = START_MPS
        sigma[GYRO], sigma[FORCE] = noise.gyro_bias, noise.force_bias
        self.state = filter_state(Pose(orientation), np.diag(sigma**2))
        self.settings = noise.settings()

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.of(self.state["pose"].copy())

    @pose.setter
    def pose(self, pose: Pose) -> None:
        self.state["pose"] = pose.row

    @property
    def covariance(self) -> Array:
        """Covariance of its error, shape (15, 15)."""
        return np.array(self.state["covariance"])

    @covariance.setter
    def covariance(self, covariance: Array) -> None:
        self.state["covariance"] = covariance

    def predict(self, segment: Segment) -> Array:
        """Go on to the end of a segment; return its transition, shape (15, 15)."""
        kernels.navigation.propagate(self.state[()], *segment.motion, self.settings[()])
        return np.array(self.state["step"])

    def still(self, sigma_mps: float) -> Innovation:
        """Return what a velocity of zero says."""
        return self._innovation(SPEED, -self.pose.velocity, sigma_mps)

    def vertical_turn(self, angle_rad: float, sigma_rad: float) -> Innovation:
        """Return what it says that the frame has turned by an angle about the vertical."""
        pick = np.zeros((1, STATES))
        pick[0, TURN.stop - 1] = 1.0
        noise = np.array([[sigma_rad**2]])
        spread = pick @ self.covariance @ pick.T + noise
        return Innovation(np.array([angle_rad]), spread, pick, noise)

    def update(self, seen: Innovation) -> None:
        """Correct the pose by a measurement."""
        gain = np.linalg.solve(seen.spread, seen.pick @ self.covariance).T
        left = np.eye(STATES) - gain @ seen.pick
        # Joseph's form: the states' units lie far apart
        self.covariance = left @ self.covariance @ left.T + gain @ seen.noise @ gain.T
        self.pose = self.pose.moved(gain @ seen.value)

    def _innovation(self, rows: slice, value: Array, sigma: float) -> Innovation:
        pick = np.zeros((3, STATES))
        pick[:, rows] = np.eye(3)
        noise = np.eye(3) * sigma**2
        return Innovation(value, self.covariance[rows, rows] + noise, pick, noise)


#: Length of a segment [s]; at low rates it is one sample. Chosen by judgement: forty updates a
#: second follow the covariance of a stride.
SEGMENT_S = 0.025


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Consecutive samples, with the last one before them.

    Attributes
    ----------
    time_ns
        Of its last sample.
    interval_s
        Times between the samples, shape (n,) [s].
    rate, force
        Shape (n + 1, 3) [rad/s], [m/s2].
    field
        Mean magnetic field, shape (3,) [T]; NaN where the stream has none.
    statistic, peak
        Largest of the zero-velocity statistic in it, and in the stride that ends with it.
    length_s
        How long it lasts [s].
    missed
        About how much of a turn the gyroscope missed at its limits, shape (3,) [rad].
    unseen
        How far straight lines between its samples may be off: variances of the turn and of the
        velocity, shape (6,) [rad2, m2/s2].
    held_s
        How long it was held at one, until a moment in the segment [s]; else 0.
    """

    time_ns: int
    interval_s: Array
    rate: Array
    force: Array
    field: Array
    statistic: float
    peak: float
    length_s: float
    missed: Array
    unseen: Array
    held_s: float

    @property
    def motion(self) -> tuple[Array, Array, Array, float, Array, Array]:
        """What the navigation goes on by."""
        samples = (self.interval_s, self.rate, self.force)
        return (*samples, self.length_s, self.missed, self.unseen)


@dataclass(frozen=True, slots=True, eq=False)
class SegmentRun(Sequence[Segment]):
    """Consecutive segments of equal length in columns.

    Attributes
    ----------
    time_ns, interval_s, field, statistic, peak, length_s, missed, unseen, held_s
        Of each, shapes (n,), (n, m), (n, 3), (n,), (n,), (n,), (n, 3), (n, 6), (n,), as those of a
        segment.
    rate, force
        Of all samples, shape (n * m + 1, 3) [rad/s], [m/s2]: neighbours share one.
    """

    time_ns: NDArray[np.int64]
    interval_s: Array
    rate: Array
    force: Array
    field: Array
    statistic: Array
    peak: Array
    length_s: Array
    missed: Array
    unseen: Array
    held_s: Array

    def __len__(self) -> int:
        return len(self.time_ns)

    @overload
    def __getitem__(self, index: int) -> Segment: ...

    @overload
    def __getitem__(self, index: slice) -> list[Segment]: ...

    def __getitem__(self, index: int | slice) -> Segment | list[Segment]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        segment_index, samples = range(len(self))[index], self.interval_s.shape[1]
        both = slice(segment_index * samples, (segment_index + 1) * samples + 1)
        return Segment(
            int(self.time_ns[segment_index]),
            self.interval_s[segment_index],
            self.rate[both],
            self.force[both],
            self.field[segment_index],
            float(self.statistic[segment_index]),
            float(self.peak[segment_index]),
            float(self.length_s[segment_index]),
            self.missed[segment_index],
            self.unseen[segment_index],
            float(self.held_s[segment_index]),
        )


#: A plateau of a gyroscope: samples within this part of an axis's extreme so far, so many of them,
#: with steps on both sides so many times those of a smooth top. Chosen by those who asked for it
#: (1.5 %, 3 samples), and as of a limit near full scale (detectors/clipping.py).
WITHIN, SHORTEST, CORNER = 0.015, 3, 3.0
#: What is made good of the turn that it missed there, and its deviation, both as parts of it.
#: Chosen by judgement: the flanks tell about how high it went, and no more.
MISSED_PART, MISSED_SIGMA = 1.0, 1.0


class GyroPlateaus:
    """Finds, as samples come, where a gyroscope is held at its limit.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._state = np.zeros((), kernels.navigation.PLATEAUS)

    def __call__(self, rate: Array) -> tuple[Array, Array]:
        """Return what the gyroscope missed at each sample, and how long it was held before it.

        Parameters
        ----------
        rate
            Shape (n, 3) [rad/s].

        Returns
        -------
        Shapes (n, 3) [rad] and (n,) [s]; 0 but at the first sample after a plateau.
        """
        missed, durations = np.empty((len(rate), 3)), np.empty(len(rate))
        given = (np.ascontiguousarray(rate), self._state[()], WITHIN, SHORTEST, CORNER)
        kernels.navigation.plateaus(*given, missed, durations)
        return missed * self._period_s, durations * self._period_s


class Segments:
    """Cuts blocks of any length into segments, counted from the run's first sample.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    parameters
        Of the statistic, and the length of a stride.
    """

    def __init__(self, rate_hz: float, parameters: ZeroVelocityParameters) -> None:
        self._peak = RecentPeak(rate_hz, parameters.stride_s)
        self._statistic = ZeroVelocityStatistic(rate_hz, parameters)
        self._length = max(1, round(SEGMENT_S * rate_hz))
        self._late = round(self._statistic.delay_ns * rate_hz / NS_PER_S)
        self._times = np.empty(0, np.int64)
        self._plateaus = GyroPlateaus(rate_hz)
        self._lines = StraightLines(rate_hz, FOOT_SIGMA)
        self._lost = 0  # of the next samples
        self._samples = np.empty((0, 19))
        self._values = np.empty((0, 2))
        self._skip = self._late

    def lose(self, count: int) -> None:
        """Take it that so many of the next samples were lost, and lie on straight lines."""
        self._lost += count

    def add(self, times: NDArray[np.int64], samples: Array) -> SegmentRun:
        """Take samples, shapes (n,) and (n, 9); return the segments that are complete by now.

        The columns are rate [rad/s], force [m/s2] and field [T], NaN where there is none.
        """
        statistic = self._statistic(samples[:, 3:6].T.copy(), samples[:, :3].T.copy())
        values = np.stack([statistic, self._peak(statistic)], axis=1)
        skipped = min(self._skip, len(values))
        self._skip -= skipped
        self._times = np.concatenate([self._times, times])
        missed, held_s = self._plateaus(samples[:, :3])
        lost = min(self._lost, len(samples))
        self._lost -= lost
        unseen = self._lines(samples[:, :6], np.arange(len(samples)) < lost)
        rows = np.concatenate([samples, missed, unseen, held_s[:, None]], axis=1)
        self._samples = np.concatenate([self._samples, rows])
        self._values = np.concatenate([self._values, values[skipped:]])
        return self._cut(self._length)

    def flush(self) -> list[SegmentRun]:
        """Return what is left; the statistic of the last samples is that of the last window.

        The last segment may be shorter than the others.
        """
        missing = len(self._times) - len(self._values)
        if not (missing and len(self._values)):
            return []
        self._values = np.pad(self._values, ((0, missing), (0, 0)), mode="edge")
        segments = self._cut(self._length)
        left = len(self._times) - 1
        return [segments, self._cut(left)] if left > 0 else [segments]

    def _cut(self, length: int) -> SegmentRun:
        """Return all whole segments; the sample that ends one also begins the next."""
        count = max(0, len(self._values) - 1) // length
        end = count * length
        times, values = self._times[: end + 1], self._values[: end + 1]
        intervals = (np.diff(times) / NS_PER_S).reshape(count, length)
        inner = self._samples[1 : end + 1, 6:].reshape(count, length, 13)
        statistic = values[1:, 0].reshape(count, length).max(axis=1, initial=0.0)
        # each contiguous, as compiled functions take them
        rate, force = (np.ascontiguousarray(self._samples[: end + 1, k : k + 3]) for k in (0, 3))
        self._times, self._samples = self._times[end:], self._samples[end:]
        self._values = self._values[end:]
        return SegmentRun(
            np.ascontiguousarray(times[length::length]),
            intervals,
            rate,
            force,
            inner[:, :, :3].mean(axis=1),
            # of both its ends, the first of which is the last of the segment before
            np.maximum(statistic, values[:end:length, 0]),
            np.ascontiguousarray(values[length::length, 1]),
            intervals.sum(axis=1),
            inner[:, :, 3:6].sum(axis=1),
            inner[:, :, 6:12].sum(axis=1),
            inner[:, :, 12].max(axis=1, initial=0.0),
        )


@dataclass(frozen=True, slots=True)
class FootNavigatorParameters:
    """Parameters of :class:`.ins.FootNavigator`."""

    window_s: Annotated[float, measured("s", "Length of the statistic's window.", gt=0)] = 0.05
    acceleration_sigma: Annotated[
        float, measured("m/s2", "Off gravity by this, the statistic is 1.", gt=0)
    ] = 1.7
    rotation_sigma: Annotated[
        float, measured("rad/s", "Turning by this, the statistic is 1.", gt=0)
    ] = 0.3
    sure: Annotated[
        float, measured("1", "The foot stands where the statistic is at most this.", gt=0)
    ] = 2.0
    share: Annotated[
        float, measured("1", "Or at most this part of its largest in the last stride.", ge=0, lt=1)
    ] = 0.03
    stride_s: Annotated[float, measured("s", "A stride takes at most so long.", gt=0)] = 1.5
    align_s: Annotated[
        float, measured("s", "Standing so long is enough to level the sensor.", gt=0)
    ] = 0.1
    sole_m: Annotated[
        float, measured("m", "Height of the sensor over what the foot rolls on.", ge=0)
    ] = 0.1
    still_mps: Annotated[float, measured("m/s", "Speed of a foot that stands.", gt=0)] = 0.01
    still_radps: Annotated[float, measured("rad/s", "Turning of a foot at rest.", gt=0)] = 0.005
    rest_s: Annotated[
        float, measured("s", "A foot that has stood so long is at rest and does not turn.", ge=0)
    ] = 0.5
    settle_s: Annotated[
        float, measured("s", "A foot still for so long stands, whatever its velocity seems.", gt=0)
    ] = 0.2
    lost_s: Annotated[
        float, measured("s", "A foot under way for so long has a velocity that is wrong.", gt=0)
    ] = 2.0
    magnetometer: Annotated[
        bool, measured("", "Hold the heading by the field where it is that of the start.")
    ] = False
    point_s: Annotated[float, measured("s", "Time between points of the track.", gt=0)] = 0.1
    smooth: Annotated[bool, measured("", "Also give the track smoothed, when it ends.")] = True
    smooth_s: Annotated[
        float, measured("s", "Longest piece of a track that is smoothed at once.", gt=0)
    ] = 600.0
    stillness: Annotated[float, gate("1", "Least stillness of a stance.", ge=0, le=1)] = 0.01
    max_distance: Annotated[
        float, gate("1", "Largest Mahalanobis distance of the velocity from zero.", gt=0)
    ] = 7.0
    max_speed: Annotated[
        float,
        gate("1", "Fastest that a foot may seem to stand, in parts of its usual swing.", gt=0),
    ] = 0.4
