"""Signals that step detectors on the body share: norm, part along gravity, and pairs of peaks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundtrace_codecs.signals import G0_MPS2, NS_PER_S, UNKNOWN_UNITS

from ..dsp.filters import (
    StreamingFilter,
    UnbiasedMean,
    bessel,
    butterworth,
    corner,
    forgotten_s,
    phase_delay_s,
    planar,
)
from ..dsp.resample import CentredFilter, ColumnBuffer, GridPart, UniformResampler, gaussian

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from groundtrace_codecs.events import Quantity
    from groundtrace_codecs.signals import SignalBlock, Stream

    from ..pipeline.gates import Candidates, GateState

#: Corners that leave every step as it was recorded [Hz]: the low-pass as high as the rate allows,
#: the high-pass so low that it takes out gravity alone, of which 20 s of it leave 0.2 %. Source:
#: definition of the first, arithmetic for the second.
OPEN_CUTOFF_HZ, OPEN_GRAVITY_HZ = 1e9, 0.05
#: Step frequency at which the filter's delay is taken out of the times [Hz]. Chosen by judgement:
#: steps of a usual walk, 0.55 s each.
NOMINAL_CADENCE_HZ = 1.8


#: Times of steps are taken back by at most this, the filter's delay and what a peak comes after the
#: contact [s]. Chosen by judgement: more than both together, at any rate.
SHIFTED_S = 1.0


def walking_forgotten_s(cutoff_hz: float, gravity_hz: float) -> float:
    """Return after how long a :class:`WalkingSignal` has forgotten what was before [s]."""
    return forgotten_s(0.0, cutoff_hz) + forgotten_s(gravity_hz, 0.0, order=1)


class WalkingSignal:
    """Norm of the acceleration without gravity, low-passed, with the delay known.

    A Bessel low-pass keeps the delay the same for all step frequencies; a first-order high-pass
    takes gravity away. Both are derived from the rate, so that 6 Hz recordings work too.

    Parameters
    ----------
    rate_hz
        Sampling rate [Hz].
    cutoff_hz
        Corner of the low-pass [Hz]; lowered where the rate does not allow it.
    gravity_hz
        Corner of the high-pass [Hz].
    """

    def __init__(self, rate_hz: float, cutoff_hz: float, gravity_hz: float) -> None:
        low = bessel(corner(cutoff_hz, rate_hz), rate_hz)
        high = butterworth(1, (corner(gravity_hz, rate_hz),), rate_hz, highpass=True)
        sos = np.concatenate([low, high])
        self._filter = StreamingFilter(sos)
        self.delay_ns = round(phase_delay_s(sos, NOMINAL_CADENCE_HZ, rate_hz) * NS_PER_S)

    def __call__(self, block: SignalBlock) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the norm and the filtered signal of a block [m/s2], shape (1, n_samples) each."""
        values = planar(block)
        norm = np.sqrt(np.einsum("cn,cn->n", values, values))
        return norm[None, :], self._filter(norm[None, :])


class Activity:
    """Level of the walking signal in the time around a sample, which tells walking from rest.

    Parameters
    ----------
    reach
        Samples before and after that count; fewer at the ends of a run.
    """

    def __init__(self, reach: int) -> None:
        self.reach = reach
        self.first = 0  # index in the run of the first value kept
        self._power = np.empty(0)

    @property
    def end(self) -> int:
        """Index in the run just after the last value taken."""
        return self.first + len(self._power)

    def add(self, values: NDArray[np.float64]) -> None:
        """Take the next values."""
        self._power = np.concatenate([self._power, values * values])

    def around(self, index: int) -> float:
        """Return the level around a sample of the run; its reach must have been taken."""
        low = max(index - self.reach - self.first, 0)
        return float(np.sqrt(self._power[low : index + self.reach + 1 - self.first].mean()))

    def discard_before(self, index: int) -> None:
        """Drop what no sample from ``index`` on reaches back to."""
        cut = max(0, index - self.reach - self.first)
        self._power = self._power[cut:]
        self.first += cut


#: Standard deviation of the Gaussian that averages the movement away [s]: a walker's stride takes
#: about a second, a sensor turns in its pocket more slowly. Chosen by trial on mobgap: over half
#: and over twice the time F1 falls from 0.945 to 0.929 and stays (HA/001), 0.886 to 0.888 and 0.881
#: (MS/001; docs/notebook/steps.md).
AVERAGE_S = 1.0
#: Memory of the mean that gives an uncalibrated sensor its scale [s]. Chosen by judgement: several
#: strides, so that no step moves the scale, and short beside a walk.
SCALE_S = 10.0


class Gravity:
    """Mean specific force around each point of the grid: gravity, while nobody falls.

    Parameters
    ----------
    sigma_s
        Standard deviation of the averaging Gaussian [s].
    """

    def __init__(self, sigma_s: float = AVERAGE_S) -> None:
        self._average = CentredFilter(gaussian(sigma_s, 2.5))
        self._force: ColumnBuffer | None = None

    def __call__(
        self, force: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Take the specific force on the grid [m/s2], shape (n_axes, n).

        Returns
        -------
        Specific force and gravity of the points that are complete by now, shape (n_axes, m) each.
        """
        if self._force is None:
            self._force = ColumnBuffer(force.shape[0])
        self._force.add(force)
        return self._paired(self._average(force))

    def flush(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the points that waited for what comes after the end."""
        if self._force is None:
            return np.empty((1, 0)), np.empty((1, 0))
        return self._paired(self._average.flush())

    def _paired(
        self, gravity: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        assert self._force is not None
        start = self._force.first
        force = self._force.between(start, start + gravity.shape[1])
        self._force.discard_before(start + gravity.shape[1])
        return force, gravity


def along(force: NDArray[np.float64], gravity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of ``force`` along ``gravity``, up positive, shape (1, n); 0 where none is.

    Both have the shape (n_axes, n) and one unit.
    """
    length = np.sqrt(np.einsum("cn,cn->n", gravity, gravity))
    dot = np.einsum("cn,cn->n", force, gravity)
    upward: NDArray[np.float64] = np.divide(dot, length, out=np.zeros_like(dot), where=length > 0)
    return upward[None, :]


class CountScale:
    """Scale of a specific force in unknown units: its mean length over a time is gravity's."""

    def __init__(self, rate_hz: float) -> None:
        self._mean = UnbiasedMean(SCALE_S * rate_hz)

    def __call__(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force in m/s2: all axes, or the magnitude alone, shape (n_axes, n)."""
        length = force if len(force) == 1 else np.sqrt(np.einsum("cn,cn->n", force, force))[None, :]
        mean = self._mean(length)
        return np.divide(G0_MPS2 * force, mean, out=np.zeros_like(force), where=mean > 0)


FORCE = frozenset({"acceleration"})
MAGNITUDE = frozenset({"acceleration_magnitude"})


@dataclass(frozen=True, slots=True, eq=False)
class UpwardPart:
    """Consecutive points of the grid.

    Attributes
    ----------
    time_ns
        Shape (n,), int64.
    up
        Specific force upward, low-passed, shape (1, n) [m/s2].
    recorded
        Norm of the specific force as recorded, shape (1, n) [m/s2].
    force, gravity
        Specific force, low-passed, and gravity, along the sensor's axes, shape (n_axes, n) [m/s2];
        no rows where the sensor gives a magnitude only.
    """

    time_ns: NDArray[np.int64]
    up: NDArray[np.float64]
    recorded: NDArray[np.float64]
    force: NDArray[np.float64]
    gravity: NDArray[np.float64]


class Upward:
    """Gives the specific force along gravity, however the sensor is turned.

    Of a sensor that gives a magnitude only, the magnitude. Where the unit is unknown, the mean of
    the length is taken to be gravity.

    Parameters
    ----------
    stream
        Its acceleration axes, or else its magnitude, are used.
    cutoff_hz
        Corner of the low-pass [Hz].
    """

    def __init__(self, stream: Stream, cutoff_hz: float) -> None:
        self._columns = stream.columns_of(FORCE) or stream.columns_of(MAGNITUDE)[:1]
        channels = stream.select(self._columns).channels
        unknown = channels[0].unit in UNKNOWN_UNITS
        self._scale = CountScale(stream.rate_hz) if unknown else None
        self._gravity = Gravity() if len(channels) > 1 else None
        self._grid = UniformResampler(stream.rate_hz, cutoff_hz)
        self._times = np.empty(0, np.int64)
        self._recorded = np.empty((1, 0))

    def __call__(self, block: SignalBlock) -> UpwardPart:
        """Take a block; return the points that are complete by now."""
        values = planar(block.select(self._columns))
        if self._scale is not None:
            values = self._scale(values)
        part = self._grid(block.sample_times(), values)
        if self._gravity is None:
            return _of_magnitude(part)
        self._wait(part)
        return self._waited(*self._gravity(part.values))

    def flush(self) -> UpwardPart:
        """Return the points up to the end of the run."""
        part = self._grid.flush()
        if self._gravity is None:
            return _of_magnitude(part)
        self._wait(part)
        now, last = self._gravity(part.values), self._gravity.flush()
        return self._waited(*(np.concatenate(two, axis=1) for two in zip(now, last, strict=True)))

    def _wait(self, part: GridPart) -> None:
        norm = np.sqrt(np.einsum("cn,cn->n", part.recorded, part.recorded))[None, :]
        self._times = np.concatenate([self._times, part.time_ns])
        self._recorded = np.concatenate([self._recorded, norm], axis=1)

    def _waited(self, force: NDArray[np.float64], gravity: NDArray[np.float64]) -> UpwardPart:
        count = force.shape[1]
        up, recorded = along(force, gravity), self._recorded[:, :count]
        part = UpwardPart(self._times[:count], up, recorded, force, gravity)
        self._times, self._recorded = self._times[count:], self._recorded[:, count:]
        return part


def _of_magnitude(part: GridPart) -> UpwardPart:
    none = part.values[:0]
    return UpwardPart(part.time_ns, part.values, np.abs(part.recorded), none, none)


@dataclass(frozen=True, slots=True)
class Pairing:
    """A minimum time from the end of the last pair that passed this gate, per channel.

    Two peaks that fall into one valley thus make one step. ``length`` is the column that holds how
    long a pair lasts [s].
    """

    length: str = "fall"
    parameter: str = "pause_s"
    name: str = "pairing"
    unit: str = "s"
    at_least: bool = True

    def values(
        self,
        candidates: Candidates,
        columns: Sequence[Quantity],
        alive: NDArray[np.bool_],
        threshold: float,
        carry: GateState,
    ) -> NDArray[np.float64]:
        """Return the time since the last pair ended [s]; inf where there was none."""
        column = [c.name for c in columns].index(self.length)
        lengths = candidates.value[:, column].astype(np.float64)
        ends = candidates.time_ns + np.rint(np.nan_to_num(lengths) * NS_PER_S).astype(np.int64)
        last = carry.last_ns.setdefault(self.name, {})
        out = np.full(len(candidates), np.inf)
        rows = zip(
            candidates.channel.tolist(),
            candidates.time_ns.tolist(),
            ends.tolist(),
            alive.tolist(),
            strict=True,
        )
        for row, (channel, begin, end, before) in enumerate(rows):
            since = (begin - last[channel]) / NS_PER_S if channel in last else np.inf
            out[row] = since
            if before and since >= threshold:
                last[channel] = end
        return out
