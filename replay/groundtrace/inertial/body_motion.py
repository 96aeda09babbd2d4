"""Motion of a worn sensor in level axes, and the walking axis that walking shows.

Level axes do not turn. The orientation is that of :mod:`.attitude` without its compass: level,
turned about the vertical by an unknown angle, and drifting slowly. The field is used elsewhere,
where it can be weighed against everything else that is known.

The walking axis gives the angle about the vertical between the sensor and the way its wearer walks.
Source: EPFL, where the sensor's place on the trunk is free and only its inclination is taken from
the accelerometers; here the remaining rotation is taken from the walk. Whatever repeats with every
step of a walk ahead or back swings along the walking axis, while the sway to the sides repeats with
every second step. So of the horizontal acceleration the part that goes with the vertical one at the
frequency of the steps is taken, and its principal axis is the walking axis.

The sign of the axis: the body is slowed down while it rises from double support to mid stance and
driven on while it falls. The acceleration ahead therefore goes against the velocity upward, a
quarter of a step before the acceleration upward. Down a stair little is left of that; there the
body is slowed down where the foot lands. Of steps that swing more than usual the sign is therefore
that of what lies between the two, three eighths of a step before the acceleration upward. A
runner's leg is a spring, not a strut: the body is slowed down while it sinks and driven on while it
rises, all the other way round (Cavagna, Heglund and Taylor, American Journal of Physiology 233,
1977), and the vertical swing tells that somebody runs. Who walks backward does the same as who
walks ahead the other way round, so that by accelerations alone a walk back is a walk ahead in a
sensor turned by half a turn. Where a nominal direction is known it gives the sign; else people are
assumed to walk ahead in most of the last hundred steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from groundtrace_codecs.signals import G0_MPS2, NS_PER_S

from .. import kernels
from .attitude import Attitude, AttitudeNoise, HeadingFrames, HeadingParameters
from .carried_iron import FieldWindows
from .frames import Samples
from .heading import HeadingEstimator
from .rotations import rotated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .attitude import HeadingFrame

    Array = NDArray[np.float64]

#: Bias that a gyroscope may have at the start [rad/s]: more lets the turns of a walk pass for it.
#: Chosen by judgement: 0.2 deg/s, what is left of an offset after standing still.
BIAS = 0.004
#: Steps come no later than this after the signal [s]. Chosen by judgement: it bounds memory, with
#: room for the windows of the slowest detector (12 s).
MEMORY_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LevelFrameMotion:
    """Consecutive samples in level axes.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    orientation
        Quaternions that turn the sensor's axes into the level ones, shape (n, 4).
    acceleration
        Without gravity, in level axes, shape (n, 3) [m/s2].
    field
        Magnetic field, shape (n, 3) [T]; NaN where there is none.
    rested_s
        How long the sensor has been at rest since the start, shape (n,) [s].
    unseen_rad2
        Variance of how far it may have turned about the vertical since the start beside what lines
        between its samples say, shape (n,) [rad2].
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    acceleration: Array
    field: Array
    rested_s: Array
    unseen_rad2: Array

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def between(self, start_ns: int, stop_ns: int) -> LevelFrameMotion:
        """Return the samples in ``[start_ns, stop_ns)``; the nearest one where there is none."""
        rows = self.rows(start_ns, stop_ns)
        return LevelFrameMotion(
            self.time_ns[rows],
            self.orientation[rows],
            self.acceleration[rows],
            self.field[rows],
            self.rested_s[rows],
            self.unseen_rad2[rows],
        )

    def by_end(self, start_ns: int, stop_ns: int) -> tuple[float, float]:
        """Return ``rested_s`` and ``unseen_rad2`` by the end of what is between."""
        last = self.rows(start_ns, stop_ns).stop - 1
        return float(self.rested_s[last]), float(self.unseen_rad2[last])

    def rows(self, start_ns: int, stop_ns: int) -> slice:
        """Return where the samples in ``[start_ns, stop_ns)`` are; that of one that is near."""
        first = min(int(self.time_ns.searchsorted(start_ns)), len(self.time_ns) - 1)
        return slice(first, max(int(self.time_ns.searchsorted(stop_ns)), first + 1))


@dataclass(slots=True)
class LevelFrameTracker:
    """Follows one sensor and remembers the last half minute.

    Attributes
    ----------
    rate_hz
        Its sampling rate [Hz].
    field_windows
        What tells iron on it.
    """

    rate_hz: float
    field_windows: FieldWindows = field(init=False)
    _estimator: HeadingEstimator = field(init=False)
    _waiting: list[Samples] = field(default_factory=list)
    _motion: LevelFrameMotion | None = None

    def __post_init__(self) -> None:
        self.field_windows = FieldWindows(self.rate_hz)
        self._estimator = HeadingEstimator(HeadingParameters(), self.rate_hz)
        self._estimator.attitude = Attitude(AttitudeNoise(bias_start=BIAS), free=True)

    def resume(self, before: LevelFrameTracker) -> None:
        """Know of the sensor what was known before a gap."""
        self._estimator.resume(before._estimator)

    @property
    def end_ns(self) -> int:
        """Time of the last sample; long ago where there is none [ns]."""
        return -(2**62) if self._motion is None else int(self._motion.time_ns[-1])

    @property
    def history(self) -> LevelFrameMotion:
        """What is remembered; there must be some."""
        assert self._motion is not None  # a frame was taken
        return self._motion

    def add(self, samples: Samples) -> None:
        """Take samples of any number."""
        frames = self._estimator.add(_without_field(samples))
        self._waiting = [Samples.joined([*self._waiting, self._less_sure(samples)])]
        self._take(frames)

    def _less_sure(self, samples: Samples) -> Samples:
        """Return samples with how far the sensor may have turned where its bias became another."""
        jumps, self._estimator.turned_rad2 = self._estimator.turned_rad2, {}
        for time_ns, turned_rad2 in jumps.items():
            samples = samples.less_sure(int(samples.time_ns.searchsorted(time_ns)), turned_rad2)
        return samples

    def flush(self) -> None:
        """Take in what was held back."""
        self._take(self._estimator.flush())

    def _take(self, given: Sequence[HeadingFrame]) -> None:
        if not given:
            return
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        count = len(frames.time_ns)
        waiting = self._waiting[0]
        self._waiting = [waiting.rows(count, len(waiting))]
        samples = waiting.rows(0, count)
        force, field_ = (rotated(frames.orientation, x) for x in (samples.force, samples.field))
        force[:, 2] -= G0_MPS2
        rested_s = self._rested(frames)
        unseen_rad2 = self._unseen(frames.orientation, samples.unseen)
        new = LevelFrameMotion(
            samples.time_ns, frames.orientation, force, field_, rested_s, unseen_rad2
        )
        self.field_windows.add(new.time_ns, new.orientation, new.field)
        self._motion = new if self._motion is None else _joined(self._recent(new), new)

    def _rested(self, frames: HeadingFrames) -> Array:
        """Return how long the sensor has been at rest by each sample [s]."""
        before_s = 0.0 if self._motion is None else float(self._motion.rested_s[-1])
        each_s = np.repeat(frames.resting / self.rate_hz, frames.lengths)
        return np.cumsum(np.concatenate([[before_s], each_s]))[1:]

    def _unseen(self, orientation: Array, unseen: Array) -> Array:
        """Return the variance of the turn about the vertical by each sample [rad2]."""
        before = 0.0 if self._motion is None else float(self._motion.unseen_rad2[-1])
        if not unseen.any():
            return np.full(len(unseen), before)
        inverse = orientation * np.array([1.0, -1.0, -1.0, -1.0])
        up = rotated(inverse, np.array([0.0, 0.0, 1.0]))  # in the sensor's axes
        each = (up**2 * unseen[:, :3]).sum(axis=1)
        return np.cumsum(np.concatenate([[before], each]))[1:]

    def _recent(self, new: LevelFrameMotion) -> LevelFrameMotion:
        """Return what is not older than any step to come, by when the newest portion begins."""
        assert self._motion is not None  # something came before
        oldest_ns = int(new.time_ns[0]) - round(MEMORY_S * NS_PER_S)
        return self._motion.between(oldest_ns, 2**62)


def _without_field(samples: Samples) -> Samples:
    return replace(samples, field=np.full_like(samples.field, np.nan))


def _joined(before: LevelFrameMotion, after: LevelFrameMotion) -> LevelFrameMotion:
    return LevelFrameMotion(
        np.concatenate([before.time_ns, after.time_ns]),
        np.concatenate([before.orientation, after.orientation]),
        np.concatenate([before.acceleration, after.acceleration]),
        np.concatenate([before.field, after.field]),
        np.concatenate([before.rested_s, after.rested_s]),
        np.concatenate([before.unseen_rad2, after.unseen_rad2]),
    )


Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
#: What looks ahead: an axis of the sensor, or what the walk tells.
Ahead = Literal["walk", "x", "-x", "y", "-y", "z", "-z"]


class Swing(NamedTuple):
    """Swing of the body at the frequency of the steps.

    Attributes
    ----------
    ahead, right
        Complex parts of the vertical one.
    up_mps2
        Amplitude of the vertical one [m/s2].
    """

    ahead: complex
    right: complex
    up_mps2: float


#: An axis nearer than the first to the vertical says nothing about ahead; where the walk tells it,
#: an axis farther than the second is the reference, so that no bow makes it steep [cosine]. Chosen
#: by judgement: 26 and 46 degrees off the vertical.
STEEP, LEVEL = 0.9, 0.7
#: Weight of what was known before a step, for the axis unless said otherwise and for its sign: the
#: axis follows a sensor that slips, the sign outlasts a walk back of some dozens of steps. Chosen
#: by judgement: 0.97 is 33 steps, 0.99 a hundred.
KEEP, _KEEP_SIGN = 0.97, 0.99
#: Weight of the nominal direction at the start: that of a step or two whose horizontal swing is
#: half the vertical one. Source: definition: half of the swing, squared.
_PRIOR = 0.25
#: Who swings up and down by more than the first runs. What swings by more than the second may be of
#: a stair, and tells as much more [m/s2]. Chosen by trial on the even numbers of 30 people on level
#: ground and stairs and of 15 who jog (docs/accuracy/step-types.md): 98 of 100 steps down a stair
#: swing by up to 5.5, 98 of 100 jogged ones by more than 5.7; usual steps by 2.
RUNS_MPS2, USUAL_MPS2 = 5.5, 2.0
#: Standard deviation of a direction that may be any [rad]. Source: definition, a uniform one.
ANYHOW_RAD = math.pi / math.sqrt(3)
#: With a nominal direction, a step tells the axis where its swing lies so near to it [rad]. Chosen
#: by judgement: phones lie 8 to 20 degrees off in eight traces of nine (docs/pedestrian.md), a
#: wrong axis 90.
_REACH_RAD = math.radians(35.0)


@dataclass(slots=True)
class WalkingAxis:
    """Principal axis of the horizontal swing of the steps so far, and its sign.

    Attributes
    ----------
    nominal
        Whether "ahead" of the swings is the nominal direction, right to 35 degrees or so; else it
        is any direction, and the walk alone tells axis and sign.
    keep
        Weight of what was known of the axis before a step.
    scatter
        Weighted sums of the products of the swing: ahead twice, ahead and right, right twice.
    drive
        Weighted sums of the swing that has the sign of the way, ahead and to the right.
    steps
        How many steps have told the axis.
    """

    nominal: bool = True
    keep: float = KEEP
    scatter: tuple[float, float, float] = (_PRIOR, 0.0, 0.0)
    drive: tuple[float, float] = (_PRIOR, 0.0)
    steps: int = 0

    @property
    def angle_rad(self) -> float:
        """Return the walking direction against the nominal one, positive to the right [rad]."""
        angle = _principal(*self.scatter)
        if self.nominal or self._driven(angle) >= 0:
            return angle
        return angle - math.copysign(math.pi, angle)

    def _driven(self, angle_rad: float) -> float:
        """Return how far the drive goes in a direction; less than 0 against it."""
        return self.drive[0] * math.cos(angle_rad) + self.drive[1] * math.sin(angle_rad)

    @property
    def sigma_rad(self) -> float:
        """Return the standard deviation of that direction where the walk alone tells it [rad].

        The axis is as sure as a principal one of so many steps can be. Its sign is wrong as often
        as so many votes of this size, each for either side, come out at least as clear.
        """
        if not self.steps:
            return ANYHOW_RAD
        aa, ar, rr = self.scatter
        mean, apart = 0.5 * (aa + rr), math.hypot(0.5 * (aa - rr), ar)
        least, most = max(mean - apart, 0.0), mean + apart
        count = (1 - self.keep**self.steps) / (1 - self.keep)
        axis = min(least * most / max(count * (most - least) ** 2, 1e-300), ANYHOW_RAD**2 / 4)
        driven = abs(self._driven(_principal(aa, ar, rr)))
        wrong = 0.5 * math.erfc(driven / math.sqrt(2 * (aa + rr)))
        return math.sqrt(axis + wrong * math.pi**2)

    def add(self, swing: Swing) -> None:
        """Take a step's swing."""
        ahead, right, up_mps2 = swing
        size = (1 + abs(ahead) ** 2 + abs(right) ** 2) / max(1.0, up_mps2 / USUAL_MPS2)
        a, r = ahead.imag / size, right.imag / size
        if self.nominal and abs(_principal(a * a, a * r, r * r)) > _REACH_RAD:
            return
        self.steps += 1
        aa, ar, rr = self.scatter
        self.scatter = (self.keep * aa + a * a, self.keep * ar + a * r, self.keep * rr + r * r)
        if up_mps2 > USUAL_MPS2:  # it may be of a stair, or of a run
            sign = (-1 if up_mps2 > RUNS_MPS2 else 1) / size
            a, r = sign * (ahead.imag - ahead.real), sign * (right.imag - right.real)
        self.drive = (_KEEP_SIGN * self.drive[0] + a, _KEEP_SIGN * self.drive[1] + r)

    def rotated(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations ahead, to the right and up about the axis, shape (3, n)."""
        angle, out = self.angle_rad, values.copy()
        cos, sin = math.cos(angle), math.sin(angle)
        out[0], out[1] = cos * values[0] + sin * values[1], cos * values[1] - sin * values[0]
        return out


def _principal(aa: float, ar: float, rr: float) -> float:
    """Return the direction of the principal axis of a symmetric matrix, within a quarter turn."""
    return 0.5 * math.atan2(2 * ar, aa - rr)


def step_swing(values: NDArray[np.float64], phase: NDArray[np.float64]) -> Swing | None:
    """Return the swing ahead and to the right at the frequency of the steps.

    Parameters
    ----------
    values
        Accelerations ahead, to the right and up, shape (3, n).
    phase
        Of each sample, in steps about the one looked at, shape (n,).

    Returns
    -------
    The swing, or None where there is none upward.
    """
    parts = np.empty((3, 2))
    kernels.strides.swing(np.ascontiguousarray(values), phase, parts)
    ahead, right, up = parts.view(np.complex128)[:, 0].tolist()
    if not abs(up) > 0:
        return None
    back = up.conjugate() / abs(up) ** 2
    count = np.count_nonzero((phase >= -1) & (phase < 1))
    return Swing(ahead * back, right * back, 2 * abs(up) / count)


def level_axis(up: Sequence[float] | NDArray[np.float64]) -> Axis:
    """Return the first axis that is level enough, up being a unit vector, shape (3,)."""
    if abs(up[0]) < LEVEL:
        return "x"
    # of two axes at right angles to an upright one at least this one is level
    return "y"
