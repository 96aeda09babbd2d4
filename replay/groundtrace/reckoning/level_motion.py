"""What a worn sensor felt, in axes that stay level and do not turn: acceleration and field.

The orientation is that of :mod:`groundtrace.heading` without its compass: level, turned about the
vertical by an unknown angle, and drifting slowly. What the field says is taken in elsewhere, where
it can be weighed against everything else that is known.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import NS_PER_S

from ..heading.attitude import GRAVITY_MPS2, Attitude, AttitudeNoise
from ..heading.estimator import HeadingEstimator, joined
from ..heading.parameters import HeadingParameters
from ..heading.rotations import turned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..heading.api import HeadingFrame
    from ..heading.inertial_frames import Samples

    Array = NDArray[np.float64]

#: Bias that a gyroscope may have at the start [rad/s]: more lets the turns of a walk pass for it.
BIAS = 0.004
#: Steps come no later than this after the signal [s].
MEMORY_S = 30.0


class FreeAttitude(Attitude):
    """An attitude whose heading is the gyroscope's alone: about the vertical it only integrates.

    That a walker's velocity stays near its mean tells the tilt. About the vertical it would tell
    something as well, as far as the heading is uncertain, and wrongly at every corner.
    """

    def hold_velocity(self, dt_s: float, sigma_mps: float | None = None) -> None:
        """Take it that the velocity is near its mean, whatever the heading."""
        self.reset_heading(0.0)
        Attitude.hold_velocity(self, dt_s, sigma_mps)


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
        first, last = np.searchsorted(self.time_ns, (start_ns, stop_ns)).tolist()
        first = min(first, len(self) - 1)
        rows = slice(first, max(last, first + 1))
        return Motion(
            self.time_ns[rows],
            self.orientation[rows],
            self.acceleration[rows],
            self.field[rows],
            self.rested_s[rows],
        )


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
    _parts: list[Motion] = field(default_factory=list)
    _rested_s: float = 0.0

    def __post_init__(self) -> None:
        self._estimator = HeadingEstimator(HeadingParameters(), self.rate_hz)
        self._estimator.attitude = FreeAttitude(AttitudeNoise(bias_start=BIAS))

    @property
    def end_ns(self) -> int:
        """Time of the last sample; long ago where there is none [ns]."""
        return int(self._parts[-1].time_ns[-1]) if self._parts else -(2**62)

    def between(self, start_ns: int, stop_ns: int) -> Motion:
        """Return the samples in ``[start_ns, stop_ns)``, at least one; there must be some.

        A step later than what is remembered gets the oldest sample.
        """
        ends = [int(part.time_ns[-1]) for part in self._parts]
        first = min(bisect_left(ends, start_ns), len(ends) - 1)
        last = min(bisect_left(ends, stop_ns), len(ends) - 1)
        return _joined(self._parts[first : last + 1]).between(start_ns, stop_ns)

    def add(self, samples: Samples) -> None:
        """Take samples of any number."""
        self._waiting = [joined([*self._waiting, samples])]
        self._take(self._estimator.add(_without_field(samples)))

    def finish(self) -> None:
        """Take in what was held back."""
        self._take(self._estimator.finish())

    def _take(self, frames: Sequence[HeadingFrame]) -> None:
        if not len(frames):
            return
        count = sum(len(frame.time_ns) for frame in frames)
        waiting = self._waiting[0]
        self._waiting = [waiting.rows(count, len(waiting))]
        orientation = np.concatenate([frame.orientation for frame in frames])
        samples = waiting.rows(0, count)
        # one turn for all frames: each of a few samples would cost as much
        force, field_ = (turned(orientation, x) for x in (samples.force, samples.field))
        force[:, 2] -= GRAVITY_MPS2
        first = 0
        for frame in frames:
            rows = slice(first, first + len(frame.time_ns))
            rested = self._rested(frame)
            self._parts.append(
                Motion(samples.time_ns[rows], orientation[rows], force[rows], field_[rows], rested)
            )
            first = rows.stop
        self._forget()

    def _rested(self, frame: HeadingFrame) -> Array:
        """Return how long the sensor has been at rest by each sample of a frame [s]."""
        each_s = float(frame.resting) / self.rate_hz
        rested: Array = self._rested_s + each_s * np.arange(1.0, len(frame.time_ns) + 1)
        self._rested_s = float(rested[-1])
        return rested

    def _forget(self) -> None:
        """Forget what is older than any step to come."""
        oldest_ns = self.end_ns - round(MEMORY_S * NS_PER_S)
        while len(self._parts) > 1 and self._parts[0].time_ns[-1] < oldest_ns:
            self._parts.pop(0)


def _without_field(samples: Samples) -> Samples:
    return replace(samples, field=np.full_like(samples.field, np.nan))


def _joined(parts: Sequence[Motion]) -> Motion:
    columns = [(p.time_ns, p.orientation, p.acceleration, p.field, p.rested_s) for p in parts]
    return Motion(*(np.concatenate(column) for column in zip(*columns, strict=True)))
