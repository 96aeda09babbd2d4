"""TOA-SB: arrivals by the statistics of noise, refined by AIC.

Source: thesis on footstep localisation, section 3.4.1 b: with the standard deviation sigma of the
noise before, an arrival is the first sample beyond 3 sigma after which at least 50 % of 10 ms, 75 %
of 1 ms and 50 % of 0.5 ms of the samples are beyond it too. That a part p of a stretch is beyond a
threshold is the same as that its (1 - p) quantile is: the decision function is the least of the
sample's size and those three quantiles, over sigma. It so tells by how much an arrival passes, or
fails. The rule of 10 ms misses impacts shorter than 5 ms, such as those of dropped balls. The noise
runs along with the signal, ending a gap before the sample it is compared with. The first
sample beyond comes late, the more the weaker the signal; the AIC refinement takes that out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from ..dsp.filters import (
    FORGOTTEN,
    StreamingFilter,
    UnbiasedMean,
    bandpass,
    forgotten_s,
    planar,
)
from ..dsp.noise import CellReducer
from ..pipeline.gates import Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Curve, Input, Measured, Memory, Stage, joined
from .arrivals import (
    BRIDGED_S,
    COLUMNS,
    RISE_WINDOWS_S,
    ArrivalSettings,
    ArrivalTracker,
    Refine,
    picker_memory,
)
from .trace import trace_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..dsp.noise import NoiseLevel

#: Lengths of the stretches after an arrival [s], and the parts of them beyond the threshold.
#: Source: thesis, section 3.4.1 b.
STRETCHES = ((0.01, 0.5), (0.001, 0.75), (0.0005, 0.5))


@dataclass(frozen=True, slots=True)
class NoiseStatisticsParameters:
    """Parameters of :class:`NoiseStatistics`."""

    low_hz: Annotated[float, measured("Hz", "Lower corner of the band-pass; 0: none.", ge=0)] = 20.0
    high_hz: Annotated[float, measured("Hz", "Upper corner of the band-pass; 0: none.", ge=0)] = (
        2000.0
    )
    noise_s: Annotated[float, measured("s", "Memory of the noise's deviation.", gt=0)] = 0.05
    gap_s: Annotated[float, measured("s", "Time between noise and signal.", ge=0)] = 0.01
    warm_up_s: Annotated[float, measured("s", "Noise needed to trust its level.", ge=0)] = 0.01
    refine: Annotated[
        Refine,
        measured("", "Onset by Akaike's criterion, or none: the first sample over the floor."),
    ] = "aic"
    floor: Annotated[float, measured("1", "Lowest level kept as a candidate.", ge=0)] = 1.5
    separation_s: Annotated[float, measured("s", "Least time between candidates.", ge=0)] = 0.02
    level: Annotated[
        float, gate("1", "Standard deviations of noise that the stretches exceed.", ge=0)
    ] = 3.0
    refractory_s: Annotated[float, gate("s", "Least time between two arrivals.", ge=0)] = 0.25


class _Stretches:
    """The least of a signal's size and the quantiles of what follows, once that is there."""

    def __init__(self, rate_hz: float, channels: int) -> None:
        lengths = [(max(1, round(s * rate_hz)), part) for s, part in STRETCHES]
        #: Length of each stretch, and which of its samples in ascending order is the quantile.
        self.ranks = [(n, n - int(np.ceil(part * n))) for n, part in lengths]
        self.ahead = max(n for n, _ in lengths)
        self._rows = np.empty((2, channels, 0))

    def add(
        self, recorded: NDArray[np.float64], band: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Take samples.

        Returns
        -------
        Signals as recorded and filtered (2, n_channels, n) and level (n_channels, n) of the samples
        that all of what follows is known of.
        """
        self._rows = np.concatenate([self._rows, np.stack([recorded, band])], axis=2)
        # in steps of that length: the quantiles of a few samples cost as much as those of many
        count = max(0, self._rows.shape[2] // self.ahead - 1) * self.ahead
        stretch = self._rows[:, :, :count], self._levels(count)
        self._rows = self._rows[:, :, count:]
        return stretch

    def flush(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the last samples: nothing follows them, so that no arrival is among them."""
        return self._rows, np.zeros(self._rows.shape[1:])

    def _levels(self, count: int) -> NDArray[np.float64]:
        from scipy.ndimage import rank_filter

        size = np.abs(self._rows[1])
        level = size[:, :count].copy()
        if not count:
            return np.asarray(level)
        for n, rank in self.ranks:
            for row, channel in zip(level, size, strict=True):
                centred = rank_filter(channel, rank, size=n, mode="nearest")
                first = 1 + n // 2  # the stretch after sample 0 is samples 1 ... n
                np.minimum(row, centred[first : first + count], out=row)
        return np.asarray(level)


@dataclass(slots=True)
class _State:
    band: StreamingFilter
    stretches: _Stretches
    power: UnbiasedMean
    delayed: NDArray[np.float64]
    unknown: int  # samples to come whose noise is not known yet
    cells: CellReducer
    tracker: ArrivalTracker


def _noise(cell_s: float) -> NoiseLevel:  # noqa: ARG001
    return _steady


def _steady(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return noise of 1: the level is given in standard deviations already."""
    return np.ones_like(level)


class NoiseStatistics(Stage):
    """An arrival is where the signal leaves the noise and stays outside for a while."""

    Parameters = NoiseStatisticsParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Pick,)
    bridges_s = BRIDGED_S
    compiles = ("filters", "frames", "picker")
    columns = (Quantity("level", "1"), *COLUMNS[1:])
    trace = trace_of(Quantity("level", "1"), "signal", "signal")
    gates = (Level("level", "1", "level"), Refractory())

    @classmethod
    def unfiltered(
        cls, parameters: NoiseStatisticsParameters
    ) -> tuple[type[NoiseStatistics], NoiseStatisticsParameters]:
        """Return what measures the same without the band-pass."""
        return cls, replace(parameters, low_hz=0.0, high_hz=0.0)

    def __init__(self, parameters: NoiseStatisticsParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """That of the band-pass, the noise, and the refractory time; and what follows a sample."""
        p = self.parameters
        held_s = forgotten_s(p.low_hz, p.high_hz) + FORGOTTEN * p.noise_s + p.warm_up_s
        ahead_s = 2 * max(length_s for length_s, _ in STRETCHES)
        return picker_memory(p, held_s, p.gap_s, RISE_WINDOWS_S, ahead_s)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is picked on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        settings = ArrivalSettings.of(p, "rise", p.gap_s, RISE_WINDOWS_S, correlation_s=0.0)
        gap = max(1, round(p.gap_s * rate))
        tracker = ArrivalTracker(rate, n, settings, _noise)
        self.state = _State(
            StreamingFilter(bandpass(p.low_hz, p.high_hz, rate)),
            _Stretches(rate, n),
            UnbiasedMean(p.noise_s * rate),
            np.zeros((n, gap)),
            gap + round(p.warm_up_s * rate),
            CellReducer(rate, tracker.frames),
            tracker,
        )
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Compare what follows each sample with the noise before it, and look for arrivals."""
        block = self.state.tracker.begun(block)
        if not len(block):
            return self.state.tracker.nothing()
        recorded = planar(block)
        band = self.state.band(recorded)
        return self._measure(*self.state.stretches.add(recorded, band))

    def curve(self) -> Curve | None:
        """Return the level over the samples that the last ``process`` or ``flush`` completed."""
        return self.state.tracker.curve(self.state.cells.samples)

    def flush(self) -> Measured:
        """End the run."""
        last = self._measure(*self.state.stretches.flush())
        return joined(last, self.state.tracker.flush())

    def _measure(self, rows: NDArray[np.float64], level: NDArray[np.float64]) -> Measured:
        state = self.state
        recorded, band = rows
        count = level.shape[1]
        line = np.concatenate([state.delayed, state.power(band * band)], axis=1)
        state.delayed = line[:, count:]
        power = line[:, :count].copy()
        power[:, : state.unknown] = 0.0
        state.unknown = max(0, state.unknown - count)
        # before any noise is known, and over digital silence, nothing is beyond it
        sigmas = np.divide(level, np.sqrt(power), out=np.zeros_like(level), where=power > 0)
        state.tracker.history.append(band)
        return state.tracker.take(state.cells.add(recorded, band, sigmas), state.cells.samples)
