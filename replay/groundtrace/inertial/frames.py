"""Samples of an inertial sensor, and frames of about 0.1 s turned to their start by the gyroscope.

Samples are angular velocity, specific force and magnetic field on one clock. The gyroscope's
samples set the times; the others are interpolated to them. A field may come in a stream of its own,
at another rate, or not at all.

The short-term rotation by the gyroscope is far better than any orientation, so that specific force
and field can be averaged over a frame however fast the sensor turns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from groundtrace_codecs.signals import NS_PER_S, UNKNOWN_UNITS

from .. import kernels
from ..pipeline.source import NonFiniteHold
from .lost_samples import StraightLines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Gap
    from groundtrace_codecs.signals import SignalBlock, Stream

    from .rotations import Array


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Consecutive samples of one body-worn sensor.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    rate
        Angular velocity, shape (n, 3) [rad/s].
    force
        Specific force, shape (n, 3) [m/s2].
    field
        Magnetic field, shape (n, 3) [T]; NaN where there is none.
    unseen
        How far straight lines between samples, and in place of lost ones, may be off: variances of
        the turn and of the velocity, shape (n, 6) [rad2, m2/s2].
    """

    time_ns: NDArray[np.int64]
    rate: Array
    force: Array
    field: Array
    unseen: Array

    def __len__(self) -> int:
        return int(self.time_ns.shape[0])

    def rows(self, start: int, stop: int) -> Samples:
        """Return samples ``[start, stop)``."""
        part = slice(start, stop)
        return Samples(
            self.time_ns[part],
            self.rate[part],
            self.force[part],
            self.field[part],
            self.unseen[part],
        )

    def less_sure(self, row: int, turned_rad2: Array) -> Samples:
        """Return the samples, one of which may have turned as far as these variances say [rad2]."""
        unseen = self.unseen.copy()
        unseen[row, :3] += turned_rad2
        return replace(self, unseen=unseen)

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Return consecutive samples as one; at least one part."""
        if len(parts) == 1:
            return parts[0]
        return Samples(
            np.concatenate([p.time_ns for p in parts]),
            np.concatenate([p.rate for p in parts]),
            np.concatenate([p.force for p in parts]),
            np.concatenate([p.field for p in parts]),
            np.concatenate([p.unseen for p in parts]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class InertialFrame:
    """What one frame says, in the body axes at its start.

    Attributes
    ----------
    turns
        Rotation from the body at the end of each sample to the frame's start, shape (n, 4).
    length_s
        Length of the frame [s].
    record
        The rest, a record of shape (), as :data:`.kernels.attitude.FRAME` names its fields.
    """

    turns: Array
    length_s: float
    record: NDArray[Any]


def frame_of(samples: Samples, step_s: float, bias: Array, delay_s: float) -> InertialFrame:
    """Average one frame.

    Parameters
    ----------
    samples
        All samples of the frame.
    step_s
        Time between samples [s].
    bias
        Bias of the gyroscope, shape (3,) [rad/s].
    delay_s
        How much later than the gyroscope the magnetometer answers [s].
    """
    turns, record = np.empty((len(samples), 4)), np.zeros((), kernels.attitude.FRAME)
    kernels.attitude.integrate_frame(
        np.ascontiguousarray(samples.rate),
        np.ascontiguousarray(samples.force),
        np.ascontiguousarray(samples.field),
        tuple(bias.tolist()),
        delay_s,
        step_s,
        turns,
        np.empty((len(samples), 6)),
        record[()],
    )
    record["unseen"] = samples.unseen.sum(axis=0)
    return InertialFrame(turns, len(samples) * step_s, record)


#: What a sensor may measure; only the last may be missing.
QUANTITIES = ("angular_velocity", "acceleration", "magnetic_field")
#: After this long without a field the sensor goes on without one [ns]. Chosen by judgement:
#: magnetometers come at 1 Hz and faster.
PATIENCE_NS = 2 * NS_PER_S
#: A field is not interpolated over more than this, nor held for longer [ns]. Chosen by judgement: a
#: walker turns by up to 20 degrees in it.
HOLD_NS = NS_PER_S // 5
#: Of a field in unknown units, the median length over its first second is taken for this [ns, T]:
#: the earth's is 22 to 67 uT (IGRF-13), 50 at middle latitudes. Source: IGRF-13 for the field; the
#: second chosen by judgement.
UNIT_NS, EARTH_T = NS_PER_S, 50e-6


@dataclass(slots=True)
class _Series:
    """Samples that wait: times, shape (n,), and values, shape (n, 3)."""

    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    values: Array = field(default_factory=lambda: np.empty((0, 3)))
    began: bool = False

    def add(self, time_ns: NDArray[np.int64], values: Array) -> None:
        self.time_ns = np.concatenate([self.time_ns, time_ns])
        self.values = np.concatenate([self.values, values])
        self.began = self.began or bool(len(time_ns))

    def discard_before(self, time_ns: int) -> None:
        """Forget what lies before a time, but for the last sample."""
        keep = max(int(np.searchsorted(self.time_ns, time_ns, side="right")) - 1, 0)
        self.time_ns, self.values = self.time_ns[keep:], self.values[keep:]

    @property
    def until_ns(self) -> int:
        """Time of the last sample, or long ago [ns]."""
        return int(self.time_ns[-1]) if len(self.time_ns) else -(2**62)

    def at(self, times: NDArray[np.int64], hold_ns: int | None) -> Array:
        """Return the values at times by straight lines; NaN farther than ``hold_ns`` from any."""
        if not len(self.time_ns):
            return np.full((len(times), 3), np.nan)
        start = self.time_ns[0]
        knots, wanted = (self.time_ns - start).astype(float), (times - start).astype(float)
        values = np.stack([np.interp(wanted, knots, column) for column in self.values.T], axis=1)
        if hold_ns is not None:
            index = np.searchsorted(self.time_ns, times)
            last = len(self.time_ns) - 1
            before, after = np.clip(index - 1, 0, last), np.clip(index, 0, last)
            before_ns, after_ns = times - self.time_ns[before], self.time_ns[after] - times
            # what ends such a gap may be heard of too late to be taken in
            broken = before_ns + after_ns > PATIENCE_NS
            nearer = np.where(before_ns <= hold_ns, before, after)
            values[broken] = self.values[nearer[broken]]
            far = (np.abs(before_ns) > hold_ns) & (np.abs(after_ns) > hold_ns)
            values[far] = np.nan
        return values


def columns_of_axes(stream: Stream, quantity: str) -> list[int]:
    """Return the columns of a quantity's axes x, y, z; none where one of them lacks.

    Of turning and force in unknown units nothing can be integrated: these are none. A field tells
    its direction in any unit.
    """
    columns = {
        stream.channels[c].axis: c
        for c in stream.columns_of({quantity})
        if quantity == "magnetic_field" or stream.channels[c].unit not in UNKNOWN_UNITS
    }
    return [columns[axis] for axis in "xyz"] if columns.keys() >= set("xyz") else []


def _earth_scale(first: Array) -> float:
    """Return what takes the median length of the first samples, shape (n, 3), to the earth's."""
    length = float(np.median(np.linalg.norm(first, axis=1)))
    return EARTH_T / length if length > 0 else 0.0


class SensorAligner:
    """Brings the parts of a sensor together; what is complete can be taken, in any portions.

    Attributes
    ----------
    remark
        What was assumed of the field's unit; empty where it is known.
    """

    def __init__(self) -> None:
        self.remark = ""
        self._rate, self._force, self._field = _Series(), _Series(), _Series()
        self._offered_ns = -(2**62)
        self._unscaled = _Series()
        self._field_scale: float | None = None
        self._holders: dict[str, NonFiniteHold] = {}
        self._lines: StraightLines | None = None
        self._period_ns = 0.0
        self._filled: list[Gap] = []

    def lose(self, gap: Gap) -> None:
        """Take it that samples of the gyroscope were lost, and that straight lines fill the gap."""
        self._filled.append(gap)

    def update(self, block: SignalBlock) -> None:
        """Take the quantities of a block, every sample finite."""
        finite = self._holders.setdefault(block.topic, NonFiniteHold()).fill(block)
        values, times = finite.values, finite.sample_times()
        for quantity in QUANTITIES:
            if columns := columns_of_axes(block.stream, quantity):
                if quantity == "angular_velocity" and self._lines is None:
                    self._lines = StraightLines(block.stream.rate_hz)
                    self._period_ns = block.stream.period_ns
                unit = block.stream.channels[columns[0]].unit
                if unit in UNKNOWN_UNITS:
                    self.remark = (
                        f"{block.topic}: the magnetic field is in {unit}: its length over the "
                        f"first second is taken for {EARTH_T * 1e6:g} uT"
                    )
                    self._hear_unscaled(times, values[:, columns])
                else:
                    self.add(quantity, times, values[:, columns])

    def _hear_unscaled(self, time_ns: NDArray[np.int64], field: Array) -> None:
        """Take a field in unknown units; it waits until its scale is known."""
        if self._field_scale is None:
            self._unscaled.add(time_ns, field)
            time_ns, field = self._unscaled.time_ns, self._unscaled.values
            if time_ns[-1] - time_ns[0] >= UNIT_NS:
                self._field_scale = _earth_scale(field[time_ns - time_ns[0] < UNIT_NS])
        if self._field_scale is not None:
            self.add("magnetic_field", time_ns, field * self._field_scale)

    @property
    def held_count(self) -> int:
        """How many samples were not finite."""
        return sum(holder.count for holder in self._holders.values())

    @property
    def has_field(self) -> bool:
        """Whether there was a magnetic field."""
        return self._field.began

    def add(self, quantity: str, time_ns: NDArray[np.int64], values: Array) -> None:
        """Take samples of ``angular_velocity``, ``acceleration`` or ``magnetic_field``."""
        series = {
            "angular_velocity": self._rate,
            "acceleration": self._force,
            "magnetic_field": self._field,
        }[quantity]
        if series is self._rate:
            # what this block brings may get its field from a block that is yet to come
            self._offered_ns = max(self._offered_ns, series.until_ns)
        series.add(time_ns, values)

    def take(self) -> Samples:
        """Return the samples whose force and field are known, or waited for long enough."""
        complete = self._rate.time_ns <= self._force.until_ns
        waited = self._rate.time_ns <= self._offered_ns - PATIENCE_NS
        complete &= (self._rate.time_ns <= self._field.until_ns) | waited
        return self._taken(int(complete.sum()))

    def flush(self) -> Samples:
        """Return what still waits."""
        if self._field_scale is None and self._unscaled.began:
            waiting = self._unscaled
            scale = self._field_scale = _earth_scale(waiting.values)
            self.add("magnetic_field", waiting.time_ns, waiting.values * scale)
        return self._taken(len(self._rate.time_ns) if self._force.began else 0)

    def _taken(self, count: int) -> Samples:
        times, rate = self._rate.time_ns[:count], self._rate.values[:count]
        force = self._force.at(times, None)
        samples = Samples(
            times, rate, force, self._field.at(times, HOLD_NS), self._unseen(times, rate, force)
        )
        self._rate.time_ns, self._rate.values = (
            self._rate.time_ns[count:],
            self._rate.values[count:],
        )
        if count:
            self._force.discard_before(int(times[-1]))
            self._field.discard_before(int(times[-1]))
        return samples

    def _unseen(self, times: NDArray[np.int64], rate: Array, force: Array) -> Array:
        """Return what :attr:`Samples.unseen` is of samples that follow those taken before."""
        if self._lines is None or not len(times):
            return np.zeros((len(times), 6))
        lost = np.zeros(len(times), np.bool_)
        for gap in self._filled:
            after_ns = gap.end_ns - self._period_ns / 2
            first, stop = np.searchsorted(times, [after_ns - gap.lost * self._period_ns, after_ns])
            lost[first:stop] = True
        self._filled = [gap for gap in self._filled if gap.end_ns > times[-1]]
        return self._lines(np.concatenate([rate, force], axis=1), lost)
