"""TOA-CV: arrivals by detection of a change of variance, refined by AIC.

Source: thesis on footstep localisation, equations (3.9) and (3.15): the decision function is the
geometric moving average q_k = (1 - alpha) q_(k-1) + alpha y_k^2, q_0 = 0, and an arrival is where
it exceeds a multiple of its maximum over noise. Corrected against the print: t_1/10 of 10 samples
belongs to alpha = 0.2 (3.3 samples for the printed 0.5), so the memory is given as a time; (3.14)
and (3.15) differ by a start-up transient, which is kept out of the noise by the warm-up. The noise
maximum runs along with the signal, ending a gap before the sample it is compared with. The
threshold crossing comes late by an amount that depends on the signal-to-noise ratio; the AIC
refinement takes that out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np

from groundtrace_codecs.events import Pick, Quantity
from groundtrace_codecs.signals import SEISMIC_QUANTITIES, SignalBlock

from .. import kernels
from ..dsp.filters import FORGOTTEN, bandpass, forgotten_s, steady_state
from ..dsp.noise import CompleteCells, RunningMaximum, cell_length
from ..pipeline.gates import Level, Refractory
from ..pipeline.parameters import gate, measured
from ..pipeline.stage import Context, Input, Memory, Stage
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

    from groundtrace_codecs.signals import Stream

    from ..dsp.filters import SampleHistory
    from ..dsp.noise import SignalFrames
    from ..pipeline.stage import Curve, Measured


@dataclass(frozen=True, slots=True)
class VarianceChangeParameters:
    """Parameters of :class:`VarianceChange`."""

    low_hz: Annotated[float, measured("Hz", "Lower corner of the band-pass; 0: none.", ge=0)] = 20.0
    high_hz: Annotated[float, measured("Hz", "Upper corner of the band-pass; 0: none.", ge=0)] = (
        2000.0
    )
    memory_s: Annotated[float, measured("s", "t_1/10 of the moving average.", gt=0)] = 0.0005
    noise_s: Annotated[float, measured("s", "Time over which noise is maximal.", gt=0)] = 0.05
    gap_s: Annotated[float, measured("s", "Time between noise and signal.", ge=0)] = 0.01
    warm_up_s: Annotated[float, measured("s", "Noise needed to trust its level.", ge=0)] = 0.01
    refine: Annotated[
        Refine,
        measured("", "Onset by Akaike's criterion, or none: the first sample over the floor."),
    ] = "aic"
    floor: Annotated[float, measured("1", "Lowest ratio kept as a candidate.", ge=0)] = 2.0
    separation_s: Annotated[float, measured("s", "Least time between candidates.", ge=0)] = 0.02
    ratio: Annotated[float, gate("1", "Lowest multiple of the noise maximum.", ge=0)] = 5.0
    refractory_s: Annotated[float, gate("s", "Least time between two arrivals.", ge=0)] = 0.25


class _Variance:
    """Band-pass and moving average of the square, reduced to cells: the decision function.

    Parameters
    ----------
    stream
        What is filtered.
    sos
        Of the band-pass, at most two sections.
    alpha
        Coefficient of the moving average.
    """

    def __init__(self, stream: Stream, sos: NDArray[np.float64], alpha: float) -> None:
        self._sos = sos
        self._sections = kernels.picker.sections_of(sos)
        self._alpha = alpha
        self._count = len(stream.channels)
        self._length = cell_length(stream.rate_hz)
        self._filled = self._first = 0  # samples of the open cell, which cell of the run it is
        self._channels: NDArray[np.void] | None = None
        self._before: NDArray[np.float64] = np.zeros(0)  # the average before the last block's cells

    def __call__(
        self, block: SignalBlock, history: SampleHistory, frames: SignalFrames
    ) -> CompleteCells:
        """Take a block; add it, filtered, to the history and return the cells it completes."""
        n = len(block)
        history.extend(n)
        if self._channels is None:
            scales = block.stream.scales
            memory = self._steady(block.samples[0] * scales)
            self._channels = kernels.picker.channels_of(scales, memory)
        self._before = self._channels["at_cell"].ravel()[: self._count].copy()
        filled, first, columns = self._filled, self._first, frames.filled
        complete = (filled + n) // self._length
        levels, values = np.empty((self._count, complete)), frames.completed_by(complete)
        samples = block.samples
        if samples.dtype not in kernels.picker.STORED:
            samples = samples.astype(np.float64)
        kernels.picker.variance_cells(samples.dtype)(
            samples,
            self._sections,
            self._alpha,
            self._channels,
            filled,
            self._length,
            frames.open_frame,
            columns,
            frames.length,
            history.recent(n),
            levels,
            values,
        )
        self._filled, self._first = (filled + n) % self._length, first + complete
        return CompleteCells(first, levels, values)

    def level(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the moving average over the filtered samples of the last block's cells."""
        levels = np.empty(rows.shape)
        kernels.picker.variance_levels(rows, self._alpha, self._before, levels)
        return levels

    def _steady(self, first: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the filter's memory in the steady state of the first samples."""
        memory = np.zeros((2 * kernels.picker.SECTIONS, len(first)))
        memory[: 2 * len(self._sos)] = steady_state(self._sos).reshape(-1, 1) * first
        return memory


@dataclass(slots=True)
class _State:
    variance: _Variance
    tracker: ArrivalTracker


class VarianceChange(Stage):
    """An arrival is where the short-time variance rises over all that noise has shown."""

    Parameters = VarianceChangeParameters
    takes = (Input(SignalBlock, SEISMIC_QUANTITIES),)
    gives = (Pick,)
    bridges_s = BRIDGED_S
    compiles = ("frames", "maxima", "picker")
    columns = COLUMNS
    trace = trace_of(Quantity("ratio", "1"), "signal", "signal")
    gates = (Level("ratio", "1", "ratio"), Refractory())

    @classmethod
    def unfiltered(
        cls, parameters: VarianceChangeParameters
    ) -> tuple[type[VarianceChange], VarianceChangeParameters]:
        """Return what measures the same without the band-pass."""
        return cls, replace(parameters, low_hz=0.0, high_hz=0.0)

    def __init__(self, parameters: VarianceChangeParameters) -> None:
        self.parameters = parameters

    @property
    def memory(self) -> Memory:
        """That of the band-pass, the moving average, the noise, and the refractory time."""
        p = self.parameters
        average_s = p.memory_s * FORGOTTEN / float(np.log(10))
        held_s = forgotten_s(p.low_hz, p.high_hz) + average_s + p.noise_s
        return picker_memory(p, held_s, p.gap_s, RISE_WINDOWS_S)

    def start(self, context: Context) -> tuple[str, ...]:
        """Begin a run; every channel is picked on its own."""
        stream = context.stream
        p, rate, n = self.parameters, stream.rate_hz, len(stream.channels)
        settings = ArrivalSettings.of(p, "rise", p.gap_s, RISE_WINDOWS_S, correlation_s=0.0)
        alpha = -np.expm1(-np.log(10) / (p.memory_s * rate))
        variance = _Variance(stream, bandpass(p.low_hz, p.high_hz, rate), alpha)
        noise = partial(_noise, p.noise_s)
        self.state = _State(variance, ArrivalTracker(rate, n, settings, noise))
        return tuple(c.name for c in stream.channels)

    def process(self, block: SignalBlock) -> Measured:
        """Average the squared signal and look for arrivals."""
        tracker = self.state.tracker
        block = tracker.begun(block)
        if not len(block):
            return tracker.nothing()
        return tracker.take(
            self.state.variance(block, tracker.history, tracker.frames), self._levels
        )

    def _levels(self, start: int, stop: int) -> NDArray[np.float64]:
        """Return the moving average over samples of the last block's cells."""
        return self.state.variance.level(self.state.tracker.history.between(start, stop))

    def curve(self) -> Curve | None:
        """Return the ratio over the samples that the last ``process`` completed."""
        return self.state.tracker.curve(self._levels)

    def flush(self) -> Measured:
        """End the run."""
        return self.state.tracker.flush()


def _noise(noise_s: float, cell_s: float) -> RunningMaximum:
    return RunningMaximum(max(1, round(noise_s / cell_s)))
