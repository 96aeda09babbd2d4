"""Attitude: an error-state Kalman filter over orientation, velocity, gyroscope bias and iron.

Gravity is separated from movement by what a movement cannot do: go on accelerating. The specific
force, turned to the earth frame, is integrated to a velocity, and the velocity is held near zero by
a weak measurement; what would let it run away is tilt. The field corrects heading, bias and what is
known of the field itself, never the tilt (the principle of Laidig and Seel, Information Fusion 91,
2023: magnetic disturbances must not reach the inclination).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, overload

import numpy as np

from .. import kernels
from ..pipeline.parameters import measured
from .rotations import levelled, normalised, product

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .frames import Samples
    from .rotations import Array

#: Rows of the error state: field of the iron, field of the earth. Source:
#: definition.
BIAS, IRON, EARTH = slice(6, 9), slice(9, 12), slice(12, 14)
#: What is known of a magnetometer's delay before anything turned: 0, to 20 ms, by a noise of 1 uT.
#: Chosen by judgement: two samples at 100 Hz.
DELAY_PRIOR = (1e-6 / 0.02) ** 2

#: How far the first frame's specific force may be off the vertical, of a sensor that is still and
#: of one that moves [rad]. Chosen by judgement: cheap accelerometers are 0.3 m/s2 off; who moves
#: is pushed by some m/s2, and 20 or 45 degrees do as well (bench: heading_accuracy.py --begin).
STILL_RAD, MOVING_RAD = math.radians(2.0), math.radians(30.0)
#: How well the tilt must be known before a field is taken for the earth's, a deviation [rad].
#: Bench: heading_accuracy.py --begin, of 2, 3, 4, 6 and 8 degrees on the seven trials at hand: less
#: takes too long, with more the reference is wrong.
LEVEL_RAD = math.radians(4.0)


@dataclass(frozen=True, slots=True)
class AttitudeNoise:
    """What the filter takes its sensors for.

    Attributes
    ----------
    gyro_walk
        Random walk of the integrated gyroscope [rad/sqrt(s)].
    gyro_scale
        Unknown part of a turn that the gyroscope misses (scale, axes), as white noise: error of
        the turn over the square root of a radian turned [sqrt(rad)].
    bias_start, bias_walk
        Bias at the start [rad/s] and its random walk [rad/s/sqrt(s)].
    force_walk
        Random walk of the integrated specific force [m/s/sqrt(s)].
    speed_mps
        Velocity that a wearer has about the mean, its correlation time taken as 1 s [m/s].
    rest_rate_left
        Angular velocity left at rest, per frame [rad/s].
    iron_start, iron_walk
        Field of iron on the sensor that its calibration left [T], and its random walk
        [T/sqrt(s)].
    earth_walk
        Random walk of the earth's field about the place [T/sqrt(s)].
    """

    gyro_walk: float = 5e-4
    gyro_scale: float = 0.015
    bias_start: float = 0.02
    bias_walk: float = 1e-5
    force_walk: float = 0.1
    speed_mps: float = 0.5
    rest_rate_left: float = 0.005
    iron_start: float = 1.5e-6
    iron_walk: float = 2e-8
    earth_walk: float = 2e-8


def _unknown() -> NDArray[Any]:
    """Return the state of a filter that knows nothing yet."""
    state = np.zeros((), kernels.attitude.STATE)
    state["orientation"][0], state["earth_field"] = 1.0, np.nan
    state["delay_sums"] = 0.0, DELAY_PRIOR
    return state


@dataclass(slots=True)
class Attitude:
    """Orientation and what is known of it; starts level at the first frame, heading unknown.

    Attributes
    ----------
    noise
        What the sensors are taken for.
    state
        A record, shape (), as :data:`.kernels.attitude.STATE` names its fields.
    started
        Whether there was a frame.
    free
        Whether the heading is the gyroscope's alone: about the vertical it only integrates. That a
        walker's velocity stays near its mean tells the tilt. About the vertical it would tell
        something as well, as far as the heading is uncertain, and wrongly at every corner.
    earth_before
        Field of the earth before a gap: north and up, shape (2,) [T]; NaN where there was none.
    """

    noise: AttitudeNoise
    state: NDArray[Any] = field(default_factory=_unknown)
    started: bool = False
    free: bool = False
    earth_before: Array = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def orientation(self) -> Array:
        """Body to earth at the end of the last frame, shape (4,)."""
        return np.array(self.state["orientation"])

    @property
    def bias(self) -> Array:
        """Bias of the gyroscope, body frame, shape (3,) [rad/s]."""
        return np.array(self.state["gyro_bias"])

    @property
    def bias_sigma(self) -> Array:
        """Its standard deviations, shape (3,) [rad/s]."""
        return np.sqrt(np.diag(self.state["covariance"])[BIAS])

    @property
    def earth(self) -> Array:
        """Field of the earth: north and up, shape (2,) [T]; NaN until there was one."""
        return np.array(self.state["earth_field"])

    @property
    def knows_field(self) -> bool:
        """Whether a field was taken for the earth's: before, nothing tells north."""
        return not np.isnan(self.state["earth_field"][0])

    @property
    def heading_sigma_rad(self) -> float:
        """Standard deviation of the heading, at most half a turn [rad]."""
        sigma = float(np.sqrt(max(self.state["covariance"][2, 2], 0.0)))
        return min(sigma, math.pi) if self.knows_field else math.pi

    @property
    def tilt_rad(self) -> float:
        """Standard deviation of the tilt about the axis that is known less well [rad]."""
        return float(np.sqrt(np.diag(self.state["covariance"])[:2].max()))

    def start(self, force: Array, *, still: bool) -> None:
        """Level by the first frame's specific force; the heading is the body's x axis for now.

        Of a sensor that moves, it is gravity and an acceleration that nothing tells. Bias and iron
        may be known from before a gap.
        """
        tilt, speed = STILL_RAD if still else MOVING_RAD, self.noise.speed_mps
        bias, iron = self.noise.bias_start, self.noise.iron_start
        sigma = [tilt, tilt, np.pi] + 3 * [speed] + 3 * [bias] + 3 * [iron] + 2 * [0.0]
        variances, before = np.array(sigma) ** 2, np.diag(self.state["covariance"])
        self.state["orientation"] = levelled(force)
        self.state["covariance"] = np.diag(np.where(before > 0, before, variances))
        self.started = True

    def resume(self, before: Attitude) -> None:
        """Know of the sensor and the field what was known before a gap, not where it points."""
        if not before.started:
            return
        variances = np.diag(before.state["covariance"])
        self.state["gyro_bias"], self.state["hard_iron"] = before.bias, before.state["hard_iron"]
        for rows in (BIAS, IRON):
            self.reset(rows, np.diag(variances[rows]))
        self.earth_before = before.earth if before.knows_field else before.earth_before

    def face(self, field: Array, sigma_t: float) -> None:
        """Turn north to where a field points, earth frame, shape (3,) [T]."""
        self.turn_heading(math.atan2(field[0], field[1]))
        flat = max(math.hypot(field[0], field[1]), 1e-9)
        # a tilt turns what points up or down aside
        aside_t = self.tilt_rad * float(field[2])
        self.reset_heading(math.hypot(sigma_t, self.noise.iron_start, aside_t) / flat)

    def take_earth(self, north_t: float, up_t: float, sigma_t: float) -> None:
        """Take a field for the earth's, by its horizontal and vertical part [T]."""
        self.state["earth_field"] = north_t, up_t
        self.reset(EARTH, np.eye(2) * sigma_t**2)

    def take_bias(self, bias: Array, sigma: Array) -> None:
        """Take the gyroscope's bias to be another one, with standard deviations, shape (3,)."""
        self.state["gyro_bias"] = bias
        self.reset(BIAS, np.diag(sigma**2))

    def reset_heading(self, sigma_rad: float) -> None:
        """Take the heading to be known to ``sigma_rad``, by what this filter does not see."""
        self.reset(slice(2, 3), np.array([[sigma_rad**2]]))

    def turn_heading(self, angle_rad: float) -> None:
        """Turn the whole estimate about the vertical, counter-clockwise."""
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        half = np.array([math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)])
        state, turn = self.state, np.array([[c, -s], [s, c]])
        state["orientation"] = normalised(product(half, state["orientation"]))
        state["velocity"][:2] = turn @ state["velocity"][:2]
        covariance = state["covariance"]
        for rows in (slice(0, 2), slice(3, 5)):
            covariance[rows] = turn @ covariance[rows]
        for rows in (slice(0, 2), slice(3, 5)):
            covariance[:, rows] = covariance[:, rows] @ turn.T

    def forget_field(self) -> None:
        """Know nothing of earth and iron again: the magnetometer became another one."""
        for name in ("hard_iron", "doubted", "verified_rad", "fields"):
            self.state[name] = 0
        self.state["earth_field"], self.earth_before = np.nan, np.full(2, np.nan)
        self.reset(IRON, np.eye(3) * self.noise.iron_start**2)

    def reset(self, rows: slice, covariance: Array) -> None:
        """Let some of the errors be independent of the others, with this covariance."""
        state_covariance = self.state["covariance"]
        state_covariance[rows, :] = state_covariance[:, rows] = 0.0
        state_covariance[rows, rows] = covariance


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
        frame_index = range(len(self))[index]
        rows = slice(int(self.first[frame_index]), int(self.first[frame_index + 1]))
        return HeadingFrame(
            self.time_ns[rows],
            self.orientation[rows],
            self.heading_rad[rows],
            float(self.sigma_rad[frame_index]),
            self.bias[frame_index],
            self.values[frame_index],
            bool(self.undisturbed[frame_index]),
            bool(self.compass[frame_index]),
            bool(self.resting[frame_index]),
            self.notes.get(frame_index, ()),
        )


class HeadingFilter(Protocol):
    """A heading filter: samples in, frames out, in any portions.

    Notes
    -----
    A frame is undisturbed where all gates of its stage pass. All state can be deep-copied.
    """

    def add(self, samples: Samples) -> Sequence[HeadingFrame]:
        """Take samples of any number; return the frames that are complete by now."""

    def flush(self) -> Sequence[HeadingFrame]:
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
    direction_deg: Annotated[
        float,
        measured(
            "deg",
            "What the field itself may point aside from north; 0 where one was measured.",
            ge=0,
        ),
    ] = 10.0
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
    place_ut: Annotated[
        float, measured("uT", "What the first field may be off that of the recording.", gt=0)
    ] = 3.0
    plain_s: Annotated[
        float,
        measured("s", "A field that passes for so long is the place's, unless iron turned.", gt=0),
    ] = 0.5
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
