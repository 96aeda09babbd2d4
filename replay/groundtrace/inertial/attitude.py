"""Attitude: an error-state Kalman filter over orientation, velocity, gyroscope bias and iron.

Gravity is separated from movement by what a movement cannot do: go on accelerating. The specific
force, turned to the earth frame, is integrated to a velocity, and the velocity is held near zero by
a weak measurement; what would let it run away is tilt. The field corrects heading, bias and what is
known of the field itself, never the tilt (the principle of Laidig and Seel, Information Fusion 91,
2023: magnetic disturbances must not reach the inclination).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, overload

import numpy as np

from groundtrace_codecs.signals import G0_MPS2

from ..later import Later
from ..pipeline.parameters import measured
from .rotations import levelled, matrix

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from ..kernels import attitude as attitude_kernels
    from .frames import InertialFrame, Samples
    from .rotations import Array
else:
    attitude_kernels = Later("groundtrace.kernels.attitude")

#: Rows of the error state: rotation in the earth frame, velocity, bias in the body frame, field of
#: the iron that turns with the body, and the earth's field: north and up.
TURN, SPEED, BIAS, IRON, EARTH = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 12),
    slice(12, 14),
)
#: Source: definition.
SIZE = 14
_ONE = np.eye(SIZE)
_PICK_SPEED, _PICK_BIAS = _ONE[SPEED], _ONE[BIAS]


@dataclass(frozen=True, slots=True)
class AttitudeNoise:
    """What the filter takes its sensors for.

    Attributes
    ----------
    walk
        Random walk of the integrated gyroscope [rad/sqrt(s)].
    scale
        Unknown part of a turn that the gyroscope misses (scale, axes), as white noise: error of
        the turn over the square root of a radian turned [sqrt(rad)].
    bias_start, bias_walk
        Bias at the start [rad/s] and its random walk [rad/s/sqrt(s)].
    force_walk
        Random walk of the integrated specific force [m/s/sqrt(s)].
    speed
        Velocity that a wearer has about the mean, its correlation time taken as 1 s [m/s].
    rest_rate
        Angular velocity left at rest, per frame [rad/s].
    iron_start, iron_walk
        Field of iron on the sensor that its calibration left [T], and its random walk
        [T/sqrt(s)].
    earth_walk
        Random walk of the earth's field about the place [T/sqrt(s)].
    """

    walk: float = 5e-4
    scale: float = 0.015
    bias_start: float = 0.02
    bias_walk: float = 1e-5
    force_walk: float = 0.1
    speed: float = 0.5
    rest_rate: float = 0.005
    iron_start: float = 1.5e-6
    iron_walk: float = 2e-8
    earth_walk: float = 2e-8

    @property
    def row(self) -> Array:
        """As compiled functions lay the beginning of their settings out, and gravity after it."""
        noise = (self.walk, self.scale, self.bias_walk, self.force_walk, self.speed)
        walks = (self.rest_rate, self.iron_walk, self.earth_walk)
        return np.array([*noise, *walks, *[0.0] * 5, G0_MPS2])


@dataclass(slots=True)
class Attitude:
    """Orientation and what is known of it; starts level at the first frame, heading unknown.

    Attributes
    ----------
    noise
        What the sensors are taken for.
    orientation
        Body to earth at the end of the last frame, shape (4,).
    velocity
        About the mean velocity, earth frame, shape (3,) [m/s].
    bias
        Of the gyroscope, body frame, shape (3,) [rad/s].
    iron
        Field of the iron on the sensor, body frame, shape (3,) [T].
    earth
        Field of the earth: north and up, shape (2,) [T]; NaN until there was one.
    covariance
        Of the error state, shape (14, 14).
    free
        Whether the heading is the gyroscope's alone: about the vertical it only integrates. That a
        walker's velocity stays near its mean tells the tilt. About the vertical it would tell
        something as well, as far as the heading is uncertain, and wrongly at every corner.
    """

    noise: AttitudeNoise
    orientation: Array = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    bias: Array = field(default_factory=lambda: np.zeros(3))
    iron: Array = field(default_factory=lambda: np.zeros(3))
    earth: Array = field(default_factory=lambda: np.full(2, np.nan))
    covariance: Array = field(default_factory=lambda: np.zeros((SIZE, SIZE)))
    started: bool = False
    free: bool = False

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation of the heading [rad]."""
        return float(np.sqrt(max(self.covariance[2, 2], 0.0)))

    def start(self, frame: InertialFrame) -> None:
        """Level by the first frame's specific force; the heading is the body's x axis for now."""
        self.orientation = levelled(frame.force)
        tilt, speed = np.radians(5.0), self.noise.speed
        bias, iron = self.noise.bias_start, self.noise.iron_start
        sigma = [tilt, tilt, np.pi] + 3 * [speed] + 3 * [bias] + 3 * [iron] + 2 * [0.0]
        self.covariance = np.diag(np.array(sigma) ** 2)
        self.started = True

    def predict(self, frame: InertialFrame) -> None:
        """Go on to the end of a frame."""
        axes = matrix(self.orientation)
        x, y, z = (axes @ frame.force).tolist()
        self._go_on(
            attitude_kernels.predict,
            axes @ frame.mean_turn,
            (x, y, z),
            frame.turns[-1],
            frame.speed,
            frame.length_s,
            self.noise.row,
        )

    def hold_velocity(self, dt_s: float, sigma_mps: float | None = None) -> None:
        """Take it that the velocity is near its mean: within the noise's, or at rest ``sigma``."""
        if self.free:
            self.reset_heading(0.0)
        variance = self.noise.speed**2 * 2.0 / dt_s if sigma_mps is None else sigma_mps**2
        self._update(_PICK_SPEED, -self.velocity, variance)

    def hold_bias(self, rate: Array) -> None:
        """Take the mean rate of a frame at rest for the bias."""
        self._update(_PICK_BIAS, rate - self.bias, self.noise.rest_rate**2)

    def face(self, field: Array, sigma_t: float) -> None:
        """Turn north to where a field points, earth frame, shape (3,) [T]."""
        x, y, z = field.tolist()
        self._go_on(attitude_kernels.face, (x, y, z), sigma_t, self.noise.iron_start)

    def take_earth(self, north_t: float, up_t: float, sigma_t: float) -> None:
        """Take a field for the earth's, by its horizontal and vertical part [T]."""
        self._go_on(attitude_kernels.take_earth, north_t, up_t, sigma_t)

    def reset_heading(self, sigma_rad: float) -> None:
        """Take the heading to be known to ``sigma_rad``, by what this filter does not see."""
        attitude_kernels.know_heading(self.covariance, sigma_rad)

    def turn_heading(self, angle_rad: float) -> None:
        """Turn the whole estimate about the vertical, counter-clockwise."""
        self._go_on(attitude_kernels.turn_heading, angle_rad)

    def forget_field(self) -> None:
        """Know nothing of earth and iron again: the magnetometer became another one."""
        self.earth, self.iron = np.full(2, np.nan), np.zeros(3)
        self.covariance[IRON, :] = self.covariance[:, IRON] = 0.0
        self.covariance[IRON, IRON] = np.eye(3) * self.noise.iron_start**2

    def _update(
        self,
        pick: Array,
        innovation: Array,
        variance: float,
        frozen: NDArray[np.bool_] | None = None,
    ) -> None:
        """Update by a measurement of three values (Joseph's form: the states' units lie far apart).

        Parameters
        ----------
        pick
            Measurement matrix, shape (3, 14).
        innovation, variance
            The measurement against what was expected, shape (3,), and its noise.
        frozen
            Rows that keep their estimate (Schmidt); the covariance stays that of what is done.
        """
        x, y, z = innovation.tolist()
        kept = attitude_kernels.NONE if frozen is None else frozen
        self._go_on(
            attitude_kernels.update,
            pick,
            (x, y, z),
            variance,
            kept,
            np.empty((attitude_kernels.ROOM, SIZE)),
        )

    def _go_on(self, change: Callable[..., None], *given: Any) -> None:
        """Let a compiled function change state and covariance."""
        state = self._state()
        self.covariance = self.covariance.copy()  # others may hold what is known of a moment
        change(state, self.covariance, *given)
        self._take(state)

    def _state(self) -> Array:
        """Return all but the covariance as compiled functions lay it out, shape (15,)."""
        parts = (self.orientation, self.velocity, self.bias, self.iron, self.earth)
        return np.concatenate(parts)

    def _take(self, state: Array) -> None:
        """Take over what :meth:`_state` gave."""
        self.orientation, self.velocity, self.bias = state[:4], state[4:7], state[7:10]
        self.iron, self.earth = state[10:13], state[13:15]


@dataclass(frozen=True, slots=True, eq=False)
class HeadingFrame:
    """What is known at the samples of one frame; causal: later samples change nothing of it.

    Attributes
    ----------
    time_ns
        Of the samples, shape (n,), int64.
    orientation
        Body to earth (x east, y magnetic north, z up), shape (n, 4), (w, x, y, z).
    heading_rad
        Direction of the chosen axis in the horizontal plane, counter-clockwise from east,
        shape (n,) [rad].
    sigma_rad
        Its standard deviation [rad].
    bias
        Of the gyroscope, shape (3,) [rad/s].
    values
        The filter's columns, first how much the field is off; NaN without a field.
    undisturbed
        Whether all tests of the field passed; True where there is no field to be disturbed.
    compass
        Whether the frame has a field.
    resting
        Whether the sensor stands still.
    notes
        What a person should know, a line each.
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    heading_rad: Array
    sigma_rad: float
    bias: Array
    values: Array
    undisturbed: bool
    compass: bool
    resting: bool
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class HeadingFrames(Sequence[HeadingFrame]):
    """Consecutive frames in columns.

    Attributes
    ----------
    time_ns, orientation, heading_rad
        Of the samples of all frames, shapes (m,), (m, 4), (m,), as those of a frame.
    first
        Where each frame begins among them, and where the last ends, shape (n + 1,), int64.
    sigma_rad, bias, values, undisturbed, compass, resting
        Of each frame, shapes (n,), (n, 3), (n, n_columns), (n,), (n,), (n,).
    notes
        Of each frame that has some.
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    heading_rad: Array
    first: NDArray[np.int64]
    sigma_rad: Array
    bias: Array
    values: Array
    undisturbed: NDArray[np.bool_]
    compass: NDArray[np.bool_]
    resting: NDArray[np.bool_]
    notes: dict[int, tuple[str, ...]]

    @classmethod
    def of(cls, frames: Sequence[HeadingFrame]) -> HeadingFrames:
        """Return frames, at least one, in columns."""
        return cls(
            np.concatenate([f.time_ns for f in frames]),
            np.concatenate([f.orientation for f in frames]),
            np.concatenate([f.heading_rad for f in frames]),
            np.cumsum([0, *(len(f.time_ns) for f in frames)], dtype=np.int64),
            np.array([f.sigma_rad for f in frames]),
            np.stack([f.bias for f in frames]),
            np.stack([f.values for f in frames]),
            np.array([f.undisturbed for f in frames], np.bool_),
            np.array([f.compass for f in frames], np.bool_),
            np.array([f.resting for f in frames], np.bool_),
            {i: f.notes for i, f in enumerate(frames) if f.notes},
        )

    @classmethod
    def concatenate(cls, parts: Sequence[HeadingFrames]) -> HeadingFrames:
        """Return all frames of some parts, at least one."""
        if len(parts) == 1:
            return parts[0]
        begins = np.cumsum([0, *(len(p.time_ns) for p in parts)])
        frames = np.cumsum([0, *(len(p) for p in parts)]).tolist()
        firsts = [p.first[:-1] + at for p, at in zip(parts, begins[:-1], strict=True)]
        return cls(
            np.concatenate([p.time_ns for p in parts]),
            np.concatenate([p.orientation for p in parts]),
            np.concatenate([p.heading_rad for p in parts]),
            np.concatenate([*firsts, begins[-1:]]),
            np.concatenate([p.sigma_rad for p in parts]),
            np.concatenate([p.bias for p in parts]),
            np.concatenate([p.values for p in parts]),
            np.concatenate([p.undisturbed for p in parts]),
            np.concatenate([p.compass for p in parts]),
            np.concatenate([p.resting for p in parts]),
            {at + i: n for p, at in zip(parts, frames, strict=False) for i, n in p.notes.items()},
        )

    @property
    def lengths(self) -> NDArray[np.int64]:
        """How many samples each frame has, shape (n,)."""
        return np.diff(self.first)

    def __len__(self) -> int:
        return len(self.sigma_rad)

    @overload
    def __getitem__(self, index: int) -> HeadingFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[HeadingFrame]: ...

    def __getitem__(self, index: int | slice) -> HeadingFrame | list[HeadingFrame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = range(len(self))[index]
        rows = slice(int(self.first[place]), int(self.first[place + 1]))
        return HeadingFrame(
            self.time_ns[rows],
            self.orientation[rows],
            self.heading_rad[rows],
            float(self.sigma_rad[place]),
            self.bias[place],
            self.values[place],
            bool(self.undisturbed[place]),
            bool(self.compass[place]),
            bool(self.resting[place]),
            self.notes.get(place, ()),
        )


class HeadingFilter(Protocol):
    """A heading filter: samples in, frames out, in any portions.

    Notes
    -----
    A frame is undisturbed where all gates of its stage pass. All state can be deep-copied.
    """

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""

    def finish(self) -> Sequence[HeadingFrame]:
        """Return what was held back."""


@dataclass(frozen=True, slots=True)
class HeadingParameters:
    """Parameters of :class:`~.heading.HeadingEstimator`.

    The thresholds decide which fields the filter learns from, so that to change one is to filter
    again: none of them can be tried on stored candidates.
    """

    filter: Annotated[
        Literal["error-state", "exponential", "kalman"],
        measured("1", "How gyroscope and compass are combined."),
    ] = "error-state"
    axis: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"],
        measured("1", "Sensor axis whose horizontal direction is the heading."),
    ] = "x"
    output_hz: Annotated[float, measured("Hz", "Headings per second.", gt=0)] = 50.0
    frame_s: Annotated[float, measured("s", "Length of a frame.", ge=0.02, le=0.5)] = 0.1
    gyro_scale: Annotated[
        float,
        measured("sqrt(rad)", "Error of a turn over the square root of what was turned.", ge=0),
    ] = 0.015
    field_sigma_ut: Annotated[
        float, measured("uT", "What an undisturbed field is off by.", gt=0)
    ] = 1.0
    field_memory_s: Annotated[
        float, measured("s", "For how long it is off the same way.", gt=0)
    ] = 2.0
    drift_factor: Annotated[
        float, measured("1", "Standard deviations of drift that an azimuth may be off.", ge=0)
    ] = 2.0
    join_s: Annotated[
        float, measured("s", "Disturbances no further apart than this are one.", ge=0)
    ] = 0.1
    norm_ut: Annotated[float, measured("uT", "Most difference of the norm.", ge=0)] = 5.0
    deviation_ut: Annotated[float, measured("uT", "Most moving deviation of the norm.", ge=0)] = 5.0
    planimetric_ut: Annotated[
        float, measured("uT", "Most difference of the planimetric norm.", ge=0)
    ] = 5.0
    azimuth_deg: Annotated[
        float, measured("deg", "Most difference of the azimuths beyond the drift.", ge=0)
    ] = 15.0
    derivative_dps: Annotated[
        float, measured("deg/s", "Most difference of the azimuths' derivatives.", ge=0)
    ] = 60.0
    dip_deg: Annotated[float, measured("deg", "Most difference of the inclination.", ge=0)] = 8.0
    field_ut: Annotated[
        float, measured("uT", "Most difference of the field beyond the drift.", ge=0)
    ] = 4.5
    iron_ut: Annotated[
        float, measured("uT", "Most change of the field that turns with the sensor.", ge=0)
    ] = 2.5
