"""What a worn sensor felt, in axes that stay level and do not turn: acceleration and field.

The orientation is that of :mod:`groundtrace.heading` without its compass: level, turned about the
vertical by an unknown angle, and drifting slowly. What the field says is taken in elsewhere, where
it can be weighed against everything else that is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..heading.api import HeadingFrames
from ..heading.attitude import GRAVITY_MPS2, Attitude, AttitudeNoise
from ..heading.estimator import HeadingEstimator, joined
from ..heading.parameters import HeadingParameters
from ..heading.rotations import turned
from ..later import Later

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..heading.api import HeadingFrame
    from ..heading.inertial_frames import Samples
    from . import step_kernels

    Array = NDArray[np.float64]
else:
    step_kernels = Later("groundtrace.reckoning.step_kernels")

#: Bias that a gyroscope may have at the start [rad/s]: more lets the turns of a walk pass for it.
BIAS = 0.004
#: Steps come no later than this after the signal [s].
MEMORY_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
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
    """

    time_ns: NDArray[np.int64]
    orientation: Array
    acceleration: Array
    field: Array
    rested_s: Array

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def between(self, start_ns: int, stop_ns: int) -> Motion:
        """Return the samples in ``[start_ns, stop_ns)``; the nearest one where there is none."""
        rows = slice(*self._rows(start_ns, stop_ns))
        return Motion(
            self.time_ns[rows],
            self.orientation[rows],
            self.acceleration[rows],
            self.field[rows],
            self.rested_s[rows],
        )

    def rested_by(self, start_ns: int, stop_ns: int) -> float:
        """Return how long the sensor has been at rest by the end of what is between [s]."""
        return float(self.rested_s[self._rows(start_ns, stop_ns)[1] - 1])

    def _rows(self, start_ns: int, stop_ns: int) -> tuple[int, int]:
        return step_kernels.rows_between(self.time_ns, start_ns, stop_ns)


@dataclass(slots=True)
class LevelMotion:
    """Follows one sensor and remembers the last half minute.

    Attributes
    ----------
    rate_hz
        Its sampling rate [Hz].
    """

    rate_hz: float
    _estimator: HeadingEstimator = field(init=False)
    _waiting: list[Samples] = field(default_factory=list)
    _motion: Motion | None = None

    def __post_init__(self) -> None:
        self._estimator = HeadingEstimator(HeadingParameters(), self.rate_hz)
        self._estimator.attitude = Attitude(AttitudeNoise(bias_start=BIAS), free=True)

    @property
    def end_ns(self) -> int:
        """Time of the last sample; long ago where there is none [ns]."""
        return -(2**62) if self._motion is None else int(self._motion.time_ns[-1])

    @property
    def felt(self) -> Motion:
        """What is remembered; there must be some."""
        assert self._motion is not None  # a frame was taken
        return self._motion

    def add(self, samples: Samples) -> None:
        """Take samples of any number."""
        self._waiting = [joined([*self._waiting, samples])]
        self._take(self._estimator.add(_without_field(samples)))

    def finish(self) -> None:
        """Take in what was held back."""
        self._take(self._estimator.finish())

    def _take(self, given: Sequence[HeadingFrame]) -> None:
        if not given:
            return
        frames = given if isinstance(given, HeadingFrames) else HeadingFrames.of(given)
        count = len(frames.time_ns)
        waiting = self._waiting[0]
        self._waiting = [waiting.rows(count, len(waiting))]
        samples = waiting.rows(0, count)
        force, field_ = (turned(frames.orientation, x) for x in (samples.force, samples.field))
        force[:, 2] -= GRAVITY_MPS2
        rested_s = self._rested(frames)
        new = Motion(samples.time_ns, frames.orientation, force, field_, rested_s)
        self._motion = new if self._motion is None else _joined(self._kept(new), new)

    def _rested(self, frames: HeadingFrames) -> Array:
        """Return how long the sensor has been at rest by each sample [s]."""
        before_s = 0.0 if self._motion is None else float(self._motion.rested_s[-1])
        each_s = np.repeat(frames.resting / self.rate_hz, frames.lengths)
        return np.cumsum(np.concatenate([[before_s], each_s]))[1:]

    def _kept(self, new: Motion) -> Motion:
        """Return what is not older than any step to come, by when the newest portion begins."""
        assert self._motion is not None  # something came before
        oldest_ns = int(new.time_ns[0]) - round(MEMORY_S * NS_PER_S)
        return self._motion.between(oldest_ns, 2**62)


def _without_field(samples: Samples) -> Samples:
    return replace(samples, field=np.full_like(samples.field, np.nan))


def _joined(before: Motion, after: Motion) -> Motion:
    return Motion(
        np.concatenate([before.time_ns, after.time_ns]),
        np.concatenate([before.orientation, after.orientation]),
        np.concatenate([before.acceleration, after.acceleration]),
        np.concatenate([before.field, after.field]),
        np.concatenate([before.rested_s, after.rested_s]),
    )
